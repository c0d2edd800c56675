"""The ledger: every interaction with the target, by grounding step and purpose."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from filelock import FileLock

from idapt_pl.files import DamagedFile, blaming, read_json, write_json

LOCK_SECONDS = 60.0
"""How long another process may take to write its entry, s."""


class Ledger:
    """Target interactions (control steps), kept in ``ledger.json``.

    The environment counts while it is stepped (:meth:`count`). An entry is made (:meth:`enter`) when the
    file that holds those interactions has been written, from what that file holds; so a run killed in
    between has both or neither, and nothing is counted twice. Several processes may make entries: each
    reads what is there, adds its own and writes, under a lock.

    Args:
        path: of the file; entries that it has are kept.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._counting: dict[tuple[int, str], int] = {}

    @property
    def entries(self) -> list[dict]:
        """What the file has now.

        Raises:
            DamagedFile: if it cannot be read.
        """
        if not self.path.exists():
            return []
        cure = f"Its entries come back from the run's files: idapt ledger --run {self.path.parent} --repair"
        with blaming(self.path, cure):
            listed = read_json(self.path, ("entries",), cure)["entries"]
            return [{"step": int(e["step"]), "purpose": str(e["purpose"]), "count": int(e["count"])} for e in listed]

    @property
    def damaged(self) -> bool:
        """Whether the file is there and cannot be read."""
        try:
            return self.entries is None
        except DamagedFile:
            return True

    @property
    def training_total(self) -> int:
        """Interactions the method has used: everything but evaluation and the oracle reference."""
        return training_interactions(self.entries)

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
            DamagedFile: if the file cannot be read.
        """
        counted = self._counting.pop((step, purpose), None)
        if counted is not None and counted != interactions:
            raise RuntimeError(
                f"ledger: {counted} target interactions were made for {purpose!r} in step {step}, "
                f"but the file that holds them has {interactions}"
            )
        entry = {"step": step, "purpose": purpose, "count": interactions}
        self.change(lambda entries: [e for e in entries if (e["step"], e["purpose"]) != (step, purpose)] + [entry])

    def change(self, new: Callable[[list[dict]], list[dict]], restore: bool = False) -> None:
        """Replace the entries by others, while no other process does.

        Args:
            new: entries to entries.
            restore: a file that cannot be read has no entries, and is written anew.

        Raises:
            DamagedFile: if the file cannot be read.
            TimeoutError: if another process keeps it locked.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(self.path.with_name(f".{self.path.name}.lock"), timeout=LOCK_SECONDS):
            anew = restore and self.damaged
            before = [] if anew else self.entries
            after = sorted(new(before), key=ledger_order)
            if anew or after != before:
                content = {"training_total": training_interactions(after), "entries": after}
                write_json(self.path, content, checked=True)


def training_interactions(entries: list[dict]) -> int:
    """Those that the method used."""
    return sum(e["count"] for e in entries if e["purpose"] == "training")


def ledger_order(entry: dict) -> tuple:
    """Where an entry stands: by step, the method's own first; what came after the run (step -1) last."""
    return entry["step"] < 0, entry["step"], entry["purpose"] != "training", entry["purpose"]
