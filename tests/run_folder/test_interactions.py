"""What the files of a run folder say was done in the target; the attributes of files count nothing."""

import json
import shutil

import h5py
import pytest
from conftest import TINY

from datamodules import write_trajectories
from idapt_pl.files import write_json
from idapt_pl.run import Run
from idapt_pl.run_folder.interactions import VIDEO, VIDEO_STEPS, disagreements, held_interactions, reconciled

STEPS = TINY["schedule.grounding_steps"]


def told(stage, step=0):
    """What every result says of itself."""
    return {"step": step, "stage": stage, "wall_s": 1.0}


@pytest.fixture
def run(tmp_path, numbered):
    """A folder with one recording of 7 steps, one evaluation and one that was made later."""
    write_trajectories(tmp_path / "step_00/target.h5", numbered([4, 3], state=False))
    write_json(
        tmp_path / "step_00/evaluation.json",
        told("evaluation") | {"target": {"interactions": 40}, "video_interactions": 5},
    )
    write_json(tmp_path / "step_00/direct_transfer.json", told("direct_transfer") | {"interactions": 30})
    policies = {"oracle": {"target": {"interactions": 9}}}
    write_json(tmp_path / "evaluation_2_7.json", {"episodes": 2, "seed": 7, "policies": policies})
    return tmp_path


HELD = {
    (0, "training"): 7,
    (0, "evaluation"): 45,
    (0, "evaluation of direct transfer"): 30,
    (-1, "evaluation of oracle, 2 episodes, seed 7"): 9,
}


def held(run):
    entries, unreadable = held_interactions(run, 4, 10)
    assert unreadable == []
    return {(e["step"], e["purpose"]): e["count"] for e in entries}


def test_every_file_that_holds_interactions_is_counted(run):
    assert held(run) == HELD


def test_actions_are_counted_whatever_the_attributes_say(run):
    with h5py.File(run / "step_00/target.h5", "a") as f:
        f.attrs["total_steps"] = 2
        f.attrs["total_episodes"] = 1
    assert held(run)[0, "training"] == 7


def test_the_video_of_a_run_that_did_not_count_it_is_counted(run):
    write_json(run / "step_00/evaluation.json", told("evaluation") | {"target": {"interactions": 40}})
    assert held(run)[0, "evaluation"] == 40
    (run / f"step_00/{VIDEO}.gif").write_bytes(b"GIF89a")
    assert held(run)[0, "evaluation"] == 40 + VIDEO_STEPS


def test_the_oracles_images_warm_up_and_training_are_counted_as_they_are_done(run, numbered):
    write_trajectories(run / "step_00/oracle.h5", numbered([6]))
    assert held(run)[0, "oracle reference"] == 6
    (run / "step_00/oracle").mkdir()
    write_json(run / "step_00/oracle/stage.json", {"batches": 100})
    (run / "step_00/oracle/final.ckpt").write_bytes(b"")
    assert held(run)[0, "oracle reference"] == 6 + 4 * 100 + 12, "10 steps of warm-up by 4 simulations are 12"


@pytest.mark.parametrize("other", [told("evaluation", step=1), told("direct_transfer")])
def test_the_result_of_another_step_or_stage_is_named(run, other):
    write_json(run / "step_00/evaluation.json", other | {"target": {"interactions": 40}})
    entries, unreadable = held_interactions(run, 4, 10)
    assert len(entries) == 3 and f"{run / 'step_00/evaluation.json'}: holds {other['stage']} of step" in unreadable[0]


def test_files_that_cannot_be_read_are_named(run):
    (run / "step_00/target.h5").write_bytes(b"none")
    (run / "step_00/evaluation.json").write_text("{}")
    entries, unreadable = held_interactions(run, 4, 10)
    assert len(entries) == 2 and [u.split(":")[0] for u in unreadable] == [
        str(run / "step_00" / name) for name in ("target.h5", "evaluation.json")
    ]


def test_entries_without_a_file_or_with_other_counts_do_not_count_and_unknown_purposes_stay(run):
    real, _ = held_interactions(run, 4, 10)
    own = {"step": 0, "purpose": "evaluation of holding still", "count": 11}
    stale = {"step": 3, "purpose": "training", "count": 1000}
    wrong = [{**real[0], "count": 6}, *real[1:], own, stale]
    assert reconciled(wrong, real) == [*real, own]
    assert disagreements(wrong, real) == [
        "step 0, training: the ledger says 6, the files hold 7",
        "step 3, training: the ledger says 1000, no file holds them",
    ]
    assert disagreements([*real, own], real) == []


def test_a_finished_run_s_ledger_is_what_its_files_hold(finished_run):
    ledger = json.loads((finished_run / "ledger.json").read_text())["entries"]
    found, unreadable = held_interactions(finished_run, TINY["feeding.num_envs"], TINY["feeding.warmup_steps"])
    assert unreadable == [] and disagreements(ledger, found) == []
    evaluated = {e["step"]: e["count"] for e in ledger if e["purpose"] == "evaluation"}
    for k in range(STEPS + 1):
        result = json.loads((finished_run / f"step_{k:02d}/evaluation.json").read_text())
        assert result["video_interactions"] == VIDEO_STEPS
        assert evaluated[k] == result["target"]["interactions"] + VIDEO_STEPS


@pytest.mark.slow
def test_a_run_killed_between_its_video_and_its_evaluation_makes_both_and_counts_once(
    finished_run, tmp_path, monkeypatch
):
    folder, last = tmp_path / "run", f"step_{STEPS:02d}"
    shutil.copytree(finished_run, folder)
    (folder / last / "evaluation.json").unlink()
    (folder / last / f"{VIDEO}.gif").unlink()
    Run.open(folder).restore_ledger()

    def kill(*args, **kwargs):
        raise KeyboardInterrupt

    def evaluated():
        entries = json.loads((folder / "ledger.json").read_text())["entries"]
        return [e["count"] for e in entries if (e["step"], e["purpose"]) == (STEPS, "evaluation")]

    assert evaluated() == []
    from cli.main import main

    with monkeypatch.context() as patch:
        patch.setattr("idapt_pl.stage.write_json", kill)
        assert main(["fit", "--config", str(folder / "config.yaml")]) != 0
    assert (folder / last / f"{VIDEO}.gif").exists() and not (folder / last / "evaluation.json").exists()
    assert main(["fit", "--config", str(folder / "config.yaml")]) == 0
    assert (folder / "ledger.json").read_bytes() == (finished_run / "ledger.json").read_bytes()
