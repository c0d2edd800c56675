"""The ``idapt`` command: dispatch and plain errors."""

from __future__ import annotations

import argparse
import importlib
import keyword
import logging
import re
import sys
import warnings

COMMANDS = {
    "fit": "ground the source in the target and train the policy there (Algorithm 1)",
    "visual": "train and use the visual transformation alone, on any two sets of images",
    "collect": "write a trajectory file from a task, domain and policy",
    "gallery": "pictures of all tasks and domains, and a table of what differs",
    "ledger": "the target interactions of a run, checked against its files",
    "evaluate": "target and source returns of a finished run",
    "report": "the story of a run, finished or not, as one HTML page",
    "diagnose": "find the physical effects that a model lacks, from recordings",
    "import": "turn recordings (CSV, NPZ, Minari, LeRobot, MCAP) into a trajectory file",
    "doctor": "what works on this machine, and how to cure what does not",
}

HARMLESS = (
    "Experiment logs directory .* exists and is not empty",
    "`isinstance\\(treespec",
    "Your `IterableDataset` has `__len__`",
    "Found \\d+ module\\(s\\) in eval mode",  # the frozen ones
    "The '\\w+' does not have many workers",
    "Metric `Kernel Inception Distance` will save all extracted features",
    "You defined a `validation_step` but have no `val_dataloader`",
    "Total length of `list` across ranks is zero",  # there are no test images
    "The number of training batches \\(\\d+\\) is smaller than the logging interval",
    "\\(655\\d\\d\\) ",  # glfw, on a machine without a screen
)
"""Warnings of other packages that a user can do nothing about, as patterns of how they begin."""

RESUMED = ("fit", "visual")
"""Commands that go on where they were interrupted."""


def usage() -> str:
    """The overview that ``idapt --help`` prints."""
    lines = ["usage: idapt COMMAND [options]", ""]
    lines += ["Take a policy to a target that looks and moves differently.", ""]
    lines += [f"  {name:<10} {what}" for name, what in COMMANDS.items()]
    lines += ["", "`idapt COMMAND --help` explains a command. Start with:"]
    lines += ["  idapt fit --config configs/pendulum_quick.yaml"]
    return "\n".join(lines)


def main(argv: list[str] | None = None) -> int:
    """Run a command. Returns 0 (ok), 1 (failed) or 2 (bad usage)."""
    argv = sys.argv[1:] if argv is None else argv
    if not argv or argv[0] in ("-h", "--help"):
        print(usage())
        return 0 if argv else 2
    name, *rest = argv
    if name not in COMMANDS:
        print(f"idapt: unknown command {name!r}; commands are: {', '.join(COMMANDS)}", file=sys.stderr)
        return 2
    logging.basicConfig(level=logging.INFO, format="%(asctime)s  %(message)s", datefmt="%H:%M:%S")
    for noisy in ("lightning.pytorch", "lightning.fabric", "OpenGL"):
        logging.getLogger(noisy).setLevel(logging.WARNING)
    debug = "--debug" in rest
    rest = [a for a in rest if a != "--debug"]
    for message in HARMLESS:
        warnings.filterwarnings("ignore", message)
    try:
        module = f"{name}_" if keyword.iskeyword(name) else name  # `import` is in cli/import_.py
        return importlib.import_module(f"cli.{module}").main(rest)
    except argparse.ArgumentError as error:
        print(f"idapt {name}: {plain(error)}. `idapt {name} --help` lists what there is.", file=sys.stderr)
        return 2
    except (ValueError, OSError, RuntimeError) as error:
        if debug:
            raise
        print(f"idapt {name}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        then = "the same command resumes it" if name in RESUMED else "nothing was finished; run it again"
        print(f"idapt {name}: interrupted; {then}", file=sys.stderr)
        return 1


def plain(error: argparse.ArgumentError) -> str:
    """A parser's error on one line and without its own vocabulary."""
    text = re.sub(r"<class '([\w.]+)'>", r"\1", " ".join(str(error).split()))
    return re.sub(r'^Parser key "(\S+)":', r"\1:", text).rstrip(".")
