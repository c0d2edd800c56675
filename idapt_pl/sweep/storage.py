"""Where runs are kept between stages when the machines of a cluster share no file system.

A run is worked on in a folder of the machine it is on, and copied to the storage after each stage. If the machine is
lost, another one fetches the copy and goes on from there. Files of a run are renamed when they are whole, so what is
copied is whole too.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

from idapt_pl.files import write_atomically

CHUNK = 2**22
"""Bytes that are copied at a time."""


class RunStorage:
    """A folder, on a disk or in an object store, that mirrors parts of a sweep's folder.

    Args:
        address: a folder, or what pyarrow takes, such as ``s3://bucket/sweep``.

    Raises:
        ValueError: if it cannot be opened.
    """

    def __init__(self, address: str) -> None:
        try:
            from pyarrow import fs
        except ImportError:
            raise ValueError("storage: it is read and written by pyarrow; pip install 'idapt[ray]'") from None
        try:
            where = address if "://" in address else str(Path(address).resolve())
            self._files, self._root = fs.FileSystem.from_uri(where)
            self._files.create_dir(self._root, recursive=True)
        except (OSError, ValueError) as error:
            raise ValueError(f"storage {address}: cannot be opened ({error})") from None
        self._select, self._file = fs.FileSelector, fs.FileType.File
        self._sent: dict[Path, tuple[float, int]] = {}

    def put(self, folder: Path, parts: Iterable[str]) -> int:
        """Copy files of a sweep's folder that are new or changed, remove those that are gone. Returns how many it sent.

        Args:
            folder: of the sweep, on this machine.
            parts: files and folders in it.
        """
        sent = 0
        for part in parts:
            there = set(self._listed(part))
            for name in sorted(kept_files(folder, part)):
                state = (folder / name).stat()
                mark = (state.st_mtime, state.st_size)
                if name not in there or self._sent.get(folder / name) != mark:
                    self._send(folder / name, name)
                    self._sent[folder / name] = mark
                    sent += 1
                there.discard(name)
            for name in there:
                self._files.delete_file(self._path(name))
        return sent

    def get(self, folder: Path, parts: Iterable[str]) -> None:
        """Copy files from the storage to a sweep's folder on this machine; others that are there are removed."""
        for part in parts:
            there = set(self._listed(part))
            for name in kept_files(folder, part) - there:
                (folder / name).unlink()
            for name in there:
                write_atomically(folder / name, partial(self._receive, name))
                state = (folder / name).stat()
                self._sent[folder / name] = (state.st_mtime, state.st_size)

    def has(self, part: str) -> bool:
        """Whether there is anything of a part."""
        return bool(self._listed(part))

    def _path(self, name: str) -> str:
        return str(PurePosixPath(self._root) / name)

    def _listed(self, part: str) -> list[str]:
        one = self._files.get_file_info(self._path(part))
        if one.type == self._file:
            return [part]
        select = self._select(self._path(part), allow_not_found=True, recursive=True)
        found = [info for info in self._files.get_file_info(select) if info.type == self._file]
        names = [str(PurePosixPath(info.path).relative_to(self._root)) for info in found]
        return [name for name in names if not PurePosixPath(name).name.startswith(".")]

    def _send(self, source: Path, name: str) -> None:
        target = PurePosixPath(self._path(name))
        temporary = str(target.with_name(f".{target.name}.part"))
        self._files.create_dir(str(target.parent), recursive=True)
        with source.open("rb") as f, self._files.open_output_stream(temporary) as out:
            while chunk := f.read(CHUNK):
                out.write(chunk)
        self._files.move(temporary, str(target))

    def _receive(self, name: str, target: Path) -> Any:
        with self._files.open_input_stream(self._path(name)) as f, target.open("wb") as out:
            while chunk := f.read(CHUNK):
                out.write(chunk)


def kept_files(folder: Path, part: str) -> set[str]:
    """Files of a part of a folder, without hidden ones: those are locks, and files that are not whole yet."""
    path = folder / part
    found = [path] if path.is_file() else [p for p in path.rglob("*") if p.is_file()]
    return {p.relative_to(folder).as_posix() for p in found if not p.name.startswith(".")}


def parts_of(name: str) -> tuple[str, ...]:
    """What of a sweep's folder is of one run."""
    return (f"runs/{name}", f"logs/{name}.log", f"status/{name}.json")
