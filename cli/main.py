"""The ``idapt`` command: dispatch and plain errors."""

from __future__ import annotations

import argparse
import importlib
import keyword
import logging
import re
import sys
import warnings

import wrapt

from cli.interrupt import Interrupted, interruptible, leave_within

COMMANDS = {
    "fit": "ground the source in the target and train the policy there (Algorithm 1)",
    "visual": "train and use the visual transformation alone, on any two sets of images",
    "check": "what source and target show, and whether they move alike, before a run",
    "collect": "write a trajectory file from a task, domain and policy",
    "gallery": "pictures of all tasks and domains, and a table of what differs",
    "ledger": "the target interactions of a run, checked against its files",
    "evaluate": "target and source returns of a finished run",
    "export": "the policy of a run as one ONNX file for the robot, and a program that plays it",
    "report": "the story of a run, finished or not, as one HTML page",
    "sweep": "tasks x targets x methods x seeds from one YAML, here or on a Ray cluster; resumable",
    "diagnose": "find the physical effects that a model lacks, from recordings",
    "excite": "the next recording: the motion that tells a diagnosis's remaining explanations apart",
    "import": "turn recordings (CSV, JSON lines, ROS bags, ULog, ...) into a trajectory file",
    "doctor": "what works on this machine, and how to cure what does not",
}

HARMLESS = (
    "(Experiment logs|Checkpoint) directory .* exists and is not empty",
    "`isinstance\\(treespec",
    "Your `IterableDataset` has `__len__`",
    "Found \\d+ module\\(s\\) in eval mode",  # the frozen ones
    "The '\\w+' does not have many workers",
    "Metric `Kernel Inception Distance` will save all extracted features",
    "You defined a `validation_step` but have no `val_dataloader`",
    "Total length of `list` across ranks is zero",  # there are no test images
    "The number of training batches \\(\\d+\\) is smaller than the logging interval",
    "\\(655\\d\\d\\) ",  # glfw, on a machine without a screen
    "compiler attribute 'settotalmass' is deprecated",  # of published models, at every compilation
)
"""Warnings of other packages that a user can do nothing about, as patterns of how they begin."""

LEAVING = 30.0
"""Seconds that a command may take to leave once it has said that it was stopped."""


def usage() -> str:
    """The overview that ``idapt --help`` prints."""
    lines = ["usage: idapt COMMAND [options]", ""]
    lines += ["Take a policy to a target that looks and moves differently.", ""]
    lines += [f"  {name:<10} {what}" for name, what in COMMANDS.items()]
    lines += ["", "`idapt COMMAND --help` explains a command. Start with:"]
    lines += ["  idapt fit --config configs/pendulum_quick.yaml"]
    return "\n".join(lines)


def main(argv: list[str] | None = None) -> int:
    """Run a command. Returns 0 (ok), 1 (failed), 2 (bad usage), 3 (waits for data), 130 (Ctrl-C) or 143 (SIGTERM)."""
    own_process, argv = argv is None, sys.argv[1:] if argv is None else argv
    if not argv or argv[0] in ("-h", "--help"):
        print(usage())
        return 0 if argv else 2
    name, *rest = argv
    if name not in COMMANDS:
        print(f"idapt: unknown command {name!r}; commands are: {', '.join(COMMANDS)}", file=sys.stderr)
        return 2
    try:
        with interruptible():
            return run_command(name, [a for a in rest if a != "--debug"], "--debug" in rest)
    except Interrupted as interrupted:
        print(f"idapt {name}: {interrupted}", file=sys.stderr, flush=True)
        if own_process:
            leave_within(LEAVING, interrupted.exit_code)
        return interrupted.exit_code
    except KeyboardInterrupt:  # where signals are not ours to handle
        print(f"idapt {name}: interrupted", file=sys.stderr)
        return 130


def run_command(name: str, args: list[str], debug: bool) -> int:
    """Run one of :data:`COMMANDS`, with errors on one line, or (to debug) as they are. Returns its exit code."""
    try:
        importlib.import_module("idapt_pl")  # before mujoco, for rendering; here, as `idapt --help` need not wait
        say_what_matters()
        wrapt.register_post_import_hook(lambda _: say_what_matters(), "lightning.pytorch")
        module = f"{name}_" if keyword.iskeyword(name) else name  # `import` is in cli/import_.py
        return importlib.import_module(f"cli.{module}").main(args)
    except Exception as error:
        if debug:
            raise
        print(f"idapt {name}: {in_words(name, error)}", file=sys.stderr)
        return 2 if isinstance(error, argparse.ArgumentError) else getattr(error, "exit_code", 1)


def say_what_matters() -> None:
    """Our log on the screen, and of others' what a user can act on; again once Lightning has set its own level."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s  %(message)s", datefmt="%H:%M:%S")
    for noisy in ("lightning.pytorch", "lightning.fabric", "OpenGL", "onnxscript", "onnx_ir"):
        logging.getLogger(noisy).setLevel(logging.WARNING)
    for message in HARMLESS:
        warnings.filterwarnings("ignore", message)
    logging.getLogger("absl").addFilter(may_matter)  # dm_control logs what MuJoCo warns of


def may_matter(record: logging.LogRecord) -> bool:
    """Whether a user can do something about what is logged."""
    return not any(re.match(pattern, record.getMessage()) for pattern in HARMLESS)


def in_words(name: str, error: Exception) -> str:
    """An error on one or two lines, that of a user's module whole; what no user can cause is called a bug."""
    if isinstance(error, argparse.ArgumentError):
        keys = "fit" if name == "check" else name  # whose config it reads
        return f"{plain(error)}. `idapt {keys} --help` lists what there is."
    if hasattr(error, "exit_code"):  # a WholeError, whose module loads torch, which may be what cannot be loaded
        return str(error)
    lines = [line for line in str(error).splitlines() if line.strip()]
    text = "\n".join(lines) if len(lines) < 3 else " ".join(" ".join(lines).split())[:1000]
    if isinstance(error, MemoryError):
        return f"out of memory; smaller images, batches or buffers need less ({text or 'no more is known'})"
    if isinstance(error, RecursionError):
        return "an input is nested too deeply to be read"
    if isinstance(error, (ValueError, OSError, RuntimeError)):
        return text or type(error).__name__
    return f"unexpected: {type(error).__name__}: {text}; this is a bug, --debug shows where"


def plain(error: argparse.ArgumentError) -> str:
    """A parser's error on one line and without its own vocabulary."""
    text = re.sub(r"<class '([\w.]+)'>", r"\1", " ".join(str(error).split()))
    return re.sub(r'^Parser key "(\S+)":', r"\1:", text).rstrip(".")
