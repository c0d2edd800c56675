"""What candidates change in predictions, kept from round to round while the model changes little."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from dataclasses import dataclass

import numpy as np

from idapt_pl.prediction.whitening import WhitenedWindows, moved_little, whiten

MOST_BYTES = 2**28


@dataclass(frozen=True, eq=False)
class Base:
    """A model under which responses were simulated: what it leaves of some windows.

    Attributes:
        windows: key of the windows.
        residual: of them, (n, j, channels).
    """

    windows: bytes
    residual: np.ndarray


class Responses:
    """Changes of predictions by candidates, each as it was last simulated.

    To simulate every candidate anew in every round takes most of a search's time, and as long as the model changes
    little, so do they. What was simulated under an earlier model counts until the model's own predictions have moved
    by more than what either model leaves to explain.
    """

    def __init__(self) -> None:
        self._kept: dict[Hashable, tuple[Base, np.ndarray]] = {}
        self._bytes, self._lock = 0, threading.Lock()

    def under(self, split: WhitenedWindows, residual: np.ndarray, any_model: bool = False) -> ResponsesNow:
        """Responses of windows under a model.

        Args:
            split: the windows.
            residual: that the model leaves of them, (n, j, channels).
            any_model: take what was simulated under whatever model.
        """
        w = split.windows
        key = type(split).__name__.encode() + b"".join(x.tobytes() for x in (w.episode, w.start, w.offsets))
        return ResponsesNow(self, split, Base(key, residual), any_model)

    def find(self, key: Hashable) -> tuple[Base, np.ndarray] | None:
        """A response (n, j, channels) and the model under which it was simulated, if it was."""
        return self._kept.get(key)

    def keep(self, key: Hashable, base: Base, response: np.ndarray) -> None:
        """Keep one, in place of an older one; where memory is full only what is kept already is renewed."""
        with self._lock:
            if key in self._kept or self._bytes + response.nbytes < MOST_BYTES:
                self._bytes += response.nbytes - (self._kept[key][1].nbytes if key in self._kept else 0)
                self._kept[key] = base, response


class ResponsesNow:
    """The same, seen from the current model."""

    def __init__(self, all_of_them: Responses, split: WhitenedWindows, now: Base, any_model: bool) -> None:
        self.all_of_them, self.split, self.now, self.any_model = all_of_them, split, now, any_model
        self._near: dict[Base, bool] = {now: True}

    def get(self, key: Hashable, simulate: Callable[[], np.ndarray]) -> np.ndarray:
        """A whitened response, (n, rows): an earlier one if it still counts, else one simulated now."""
        found = self.all_of_them.find(key)
        if found is None or not self.counts(found[0]):
            response = simulate().astype(np.float32)  # so that it is the same when it is found again
            self.all_of_them.keep(key, self.now, response)
        else:
            response = found[1]
        return whiten(self.split.W, response)

    def counts(self, base: Base) -> bool:
        """Whether the model's predictions are still near those of an earlier one."""
        if base not in self._near:
            self._near[base] = base.windows == self.now.windows and (
                self.any_model or moved_little(self.split.W, base.residual, self.now.residual)
            )
        return self._near[base]
