"""Work of a run in a process of its own, beside the rest, started by ``idapt fit``.

The other process opens the run folder and goes through Algorithm 1 again. Everything that was done before is loaded, so
it is soon where the work was set aside; it does that and ends. It knows nothing that is not in the folder, which is why
the results are those of one process.
"""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from idapt_pl.cores import usable_threads
from idapt_pl.run_folder.kept_warnings import keeping_warnings
from idapt_pl.stages.aside import in_turn

log = logging.getLogger(__name__)
Outcome = TypeVar("Outcome")

PROGRAM = """
import os, sys, threading
def leave_with_parent():
    os.read(0, 1)
    os._exit(1)
threading.Thread(target=leave_with_parent, daemon=True).start()
from cli.aside import main
sys.exit(main(sys.argv[1:]))
"""
"""What the other process runs. It leaves at once when the process that started it is gone, also while it still imports
torch for seconds: what is started anew must not meet it. Nothing is ever written to it, so reading returns when the
other end closes, whatever closes it."""


class OtherProcesses:
    """Sets work of a run aside into other processes, as many as there are cores for them; further work is done in turn.

    Args:
        folder: the run folder, where everything that came before the work is done and kept.
        most: processes at a time.
    """

    def __init__(self, folder: Path, most: int) -> None:
        self.folder, self.most = folder, most
        self.running: list[subprocess.Popen] = []

    def __call__(self, name: str, last: Path, work: Callable[[], Outcome]) -> Callable[[], Outcome]:
        """Start the work; see :class:`~idapt_pl.stages.aside.Aside`."""
        self.running = [p for p in self.running if p.poll() is None]
        if last.exists() or len(self.running) >= self.most:
            return in_turn(name, last, work)
        log.info("beside the next stages: %s", name.replace("_", " "))
        process = subprocess.Popen(
            [sys.executable, "-W", "ignore", "-c", PROGRAM, str(self.folder), name],
            stdin=subprocess.PIPE,  # closes with this process, whatever ends it; then the other ends too
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
            start_new_session=True,  # a Ctrl-C is for this process to handle
        )
        self.running.append(process)

        def result() -> Outcome:
            assert process.stdout is not None  # a pipe
            told = process.stdout.read()
            if process.wait() != 0:
                raise RuntimeError(why(told, process.returncode, name))
            logging.disable(logging.INFO)  # it has said everything
            try:
                return work()  # which finds it done
            finally:
                logging.disable(logging.NOTSET)

        return result

    def close(self) -> None:
        """End what is still running."""
        for process in self.running:
            process.kill()
            process.wait()


def why(told: str, code: int, name: str) -> str:
    """What to say of work that failed."""
    try:  # a user's task may have printed before
        return str(json.loads(told.strip().splitlines()[-1])["error"])
    except (ValueError, KeyError, TypeError, IndexError):
        how = f"was ended by signal {-code}" if code < 0 else f"failed with exit code {code}"
        return f"the process for {name.replace('_', ' ')} {how}; the same command goes on from what is done"


class WorkIsDone(Exception):
    """There is nothing left for this process to do."""


def only(wanted: str) -> Callable:
    """Does the wanted work and ends there; other work is loaded where its result is asked for."""

    def aside(name: str, last: Path, work: Callable[[], Outcome]) -> Callable[[], Outcome]:
        if name != wanted:
            return work
        logging.disable(logging.NOTSET)
        work()
        raise WorkIsDone

    return aside


def processes_beside(wanted: bool | None) -> int:
    """How many processes to run beside the first, for ``side_by_side``."""
    import torch

    if wanted is None:
        wanted = usable_threads() > 1 and not torch.cuda.is_available()
    return max(1, usable_threads() - 1) if wanted else 0


def main(args: list[str]) -> int:
    """Do one piece of work of a run. What went wrong is told on standard output, as JSON."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s  %(message)s", datefmt="%H:%M:%S")
    for noisy in ("lightning.pytorch", "lightning.fabric", "OpenGL"):
        logging.getLogger(noisy).setLevel(logging.WARNING)
    logging.disable(logging.INFO)  # of what is done before, on the way to the work
    from cli.fit import open_aside

    folder, name = args
    try:
        with keeping_warnings(Path(folder)):
            open_aside(Path(folder), only(name)).grounding.run()
    except WorkIsDone:
        return 0
    except Exception as error:  # the process that waits says it in its own way
        print(json.dumps({"error": str(error) or type(error).__name__}))
        return 1
    print(json.dumps({"error": f"{folder}: there is no work called {name}"}))
    return 1
