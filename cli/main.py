"""The ``idapt`` command: dispatch and plain errors."""

from __future__ import annotations

import importlib
import logging
import sys

COMMANDS = {
    "fit": "ground the source in the target and train the policy there (Algorithm 1)",
    "collect": "write a trajectory file from a task, domain and policy",
    "evaluate": "target and source returns of a finished run",
    "doctor": "what works on this machine, and how to cure what does not",
}


def usage() -> str:
    """The overview that ``idapt --help`` prints."""
    lines = ["usage: idapt COMMAND [options]", "", "Take a policy to a target that looks and moves differently.", ""]
    lines += [f"  {name:<10} {what}" for name, what in COMMANDS.items()]
    lines += ["", "`idapt COMMAND --help` explains a command. Start with:", "  idapt fit --config configs/pendulum_quick.yaml"]
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
    try:
        return importlib.import_module(f"cli.{name}").main(rest)
    except (ValueError, OSError, RuntimeError) as error:
        if "--debug" in rest:
            raise
        print(f"idapt {name}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"idapt {name}: interrupted; the same command resumes it", file=sys.stderr)
        return 1
