"""Runs commands in this process on inputs that are wrong, and says what they must not do."""

from __future__ import annotations

import contextlib
import io
import os
import random
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from cli.fit import GroundingCLI
from cli.main import main
from cli.visual import VisualCLI

LONGEST = 10.0
"""Seconds that a wrong input may take to be refused."""
LINES = 2
"""Of stderr that a refusal may take; a parser's usage comes on top."""


def made_once(setup_parser: Callable) -> Callable:
    """Makes a command's parser once: that takes longer than to refuse an input, and every input meets the same one."""
    made: dict[str, object] = {}

    def setup(cli, *args) -> None:
        if not made:
            before = set(vars(cli))
            setup_parser(cli, *args)
            made.update((k, v) for k, v in vars(cli).items() if k not in before)
        vars(cli).update(made)

    return setup


PARSERS = {cli: made_once(cli.setup_parser) for cli in (GroundingCLI, VisualCLI)}


def attempt(args: list, folder: Path) -> tuple[int, str]:
    """Exit code and stderr of a command run in a folder, which must end soon and without a traceback."""
    err, started = io.StringIO(), time.perf_counter()
    with (
        contextlib.chdir(folder), contextlib.redirect_stderr(err), contextlib.redirect_stdout(io.StringIO()),
        pytest.MonkeyPatch.context() as patch,
    ):  # fmt: skip
        for cli, setup in PARSERS.items():
            patch.setattr(cli, "setup_parser", setup)
        try:
            code = main([str(a) for a in args])
        except SystemExit as end:  # parsers leave this way
            code = end.code
    seconds, said = time.perf_counter() - started, err.getvalue()
    assert seconds < LONGEST, f"took {seconds:.1f} s"
    assert "Traceback" not in said and "this is a bug" not in said, said
    return code, said


def assert_refused(args: list, folder: Path, may_write: str | None = None) -> str:
    """A command that fails with a short message and leaves the folder as it was (but for one). Returns the message."""
    before = tree(folder, may_write)
    code, said = attempt(args, folder)
    assert code in (1, 2), f"accepted with exit code {code}: {said}"
    told = said[said.rindex("idapt ") :] if said.startswith("usage:") else said
    lines = [line for line in told.splitlines() if line.strip()]
    assert 0 < len(lines) <= LINES, said
    after = tree(folder, may_write)
    assert after == before, f"wrote {sorted(after.keys() ^ before.keys())}"
    return said


def tree(folder: Path, but: str | None = None) -> dict[str, bytes | None]:
    """Everything in a folder, but for one: the content of files, None for folders."""
    ignored = {".lock", "MUJOCO_LOG.TXT"}  # the second is MuJoCo's own, in the folder that a program runs in
    paths = [p for p in sorted(folder.rglob("*")) if p.name not in ignored and p.relative_to(folder).parts[0] != but]
    return {os.path.relpath(p, folder): p.read_bytes() if p.is_file() else None for p in paths}


def damaged(content: bytes, seed: int) -> bytes:
    """The content with a few bytes changed, taken out, put in, or cut off; the same for the same seed."""
    rng, data = random.Random(seed), bytearray(content)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(max(1, len(data)))
        match rng.randrange(6):
            case 0:
                data[at : at + 1] = bytes([rng.randrange(256)])
            case 1:
                del data[at : at + rng.randint(1, 40)]
            case 2:
                data[at:at] = rng.choice(
                    [b"\x00", b"\xff\xfe", b"nan", b"-1e999", b"[", b"{", b"\t", b"!!x ", b"&a *a", b"\n"]
                )
            case 3:
                del data[at:]
            case 4:
                data[at:at] = data[at // 2 : at // 2 + rng.randint(1, 60)]
            case 5:
                data[at : at + 8] = bytes(rng.randrange(256) for _ in range(8))
    return bytes(data)


def leaves(entries: dict, prefix: str = "") -> dict[str, object]:
    """Values of a nested dict by dotted keys."""
    found: dict[str, object] = {}
    for key, value in entries.items():
        found |= leaves(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return found


NO_YAML = {
    "binary": bytes(range(256)),
    "latin1": "task: stra\xdfe\n".encode("latin-1"),
    "nul": b"task: a\x00b\n",
    "tab": b"\ttask: a\n",
    "number": b"3\n",
    "list": b"- 1\n- 2\n",
    "unclosed": b"task: {a: [1, 2\n",
    "deep": b"[" * 20_000,
    "deep_map": b"".join(b" " * i + b"a:\n" for i in range(1500)),
    "python_tag": b"task: !!python/object/apply:os.system ['true']\n",
    "unknown_tag": b"task: !secret x\n",
    "undefined_alias": b"task: *nothing\n",
    "key_of_a_list": b"? [1, 2]\n: 3\n",
    "key_of_a_dict": b"? {a: 1}\n: 3\n",
    "two_documents": b"task: a\n---\ntask: b\n",
    "recursive": b"task: &a [*a]\n",
    "huge_number": b"seed: " + b"9" * 5000 + b"\n",
    "date": b"seed: 2020-13-45\n",
    "directive": b"%YAML 9.9\n---\ntask: a\n",
    "zip": b"PK\x03\x04" + bytes(60),
    "hdf5": b"\x89HDF\r\n\x1a\n" + bytes(60),
}
"""What is no map or config, whatever it is read for."""
