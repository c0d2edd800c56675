"""Which episodes are fitted and which are judged on."""

import numpy as np
import pytest

from idapt_pl.diagnosis.prepare import split_episodes


def test_split_holds_every_fourth_episode_out_and_never_shares():
    fit, held = split_episodes(np.ones(9), None, None)
    assert len(held) >= 2 and sorted([*fit, *held]) == list(range(9))
    assert split_episodes(np.ones(4), None, [1])[0].tolist() == [0, 2, 3]
    with pytest.raises(ValueError, match="both to be fitted and held out"):
        split_episodes(np.ones(4), [0, 1], [1])
    with pytest.raises(ValueError, match="no episode 7"):
        split_episodes(np.ones(4), [7], None)
    with pytest.raises(ValueError, match="at least two are needed"):
        split_episodes(np.ones(1), None, None)


def test_both_parts_have_calm_and_lively_episodes():
    """Recordings often take turns: every fourth in order would hold out one kind of motion."""
    _, held = split_episodes(np.tile([1.0, 2.0, 3.0, 0.1], 4), None, None)
    assert {int(e) % 4 for e in held} == {0, 1, 2, 3}
