"""The ledger: every interaction with the target, by grounding step and purpose."""

from __future__ import annotations

import json
from pathlib import Path

from idapt_pl.files import write_json


class Ledger:
    """Target interactions (control steps), kept in ``ledger.json``.

    The environment counts while it is stepped (:meth:`count`). An entry is made (:meth:`enter`) when the
    file that holds those interactions has been written, from what that file holds; so a run killed in
    between has both or neither, and nothing is counted twice.

    Args:
        path: of the file; entries that it has are kept.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.entries: list[dict] = json.loads(path.read_text())["entries"] if path.exists() else []
        self._counting: dict[tuple[int, str], int] = {}

    def count(self, step: int, purpose: str, interactions: int) -> None:
        """Count interactions as they happen.

        Args:
            step: grounding step that they are for.
            purpose: what they are for; ``"training"`` is the method's own.
            interactions: control steps.
        """
        self._counting[step, purpose] = self._counting.get((step, purpose), 0) + interactions

    def enter(self, step: int, purpose: str, interactions: int) -> None:
        """Make or repeat an entry; arguments as of :meth:`count`.

        Raises:
            RuntimeError: if it disagrees with what was counted since the last entry.
        """
        counted = self._counting.pop((step, purpose), None)
        if counted is not None and counted != interactions:
            raise RuntimeError(
                f"ledger: {counted} target interactions were made for {purpose!r} in step {step}, "
                f"but the file that holds them has {interactions}"
            )
        entry = {"step": step, "purpose": purpose, "count": interactions}
        if entry not in self.entries:
            self.entries = [e for e in self.entries if (e["step"], e["purpose"]) != (step, purpose)] + [entry]
            write_json(self.path, {"training_total": self.training_total, "entries": self.entries})

    @property
    def training_total(self) -> int:
        """Interactions the method has used: everything but evaluation and the oracle reference."""
        return sum(e["count"] for e in self.entries if e["purpose"] == "training")
