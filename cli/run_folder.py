"""A run folder's own config resumes it wherever it is, and files with configs are read before a parser meets them."""

from __future__ import annotations

import argparse
from pathlib import Path

from idapt_pl.files import read_yaml
from idapt_pl.run_folder.kept_config import is_run_folder, read_kept_config
from idapt_pl.run_folder.shipped_configs import is_file, with_shipped_configs


def resumed_in_place(args: list[str]) -> list[str]:
    """Arguments of a fit; with the config of a run folder, the run is that folder, unless ``--run_dir`` is given.

    A run folder whose ``config.yaml`` was lost gets it back. Configs of the package are found from any folder.

    Raises:
        ValueError: if a config cannot be read.
    """
    args = with_shipped_configs(args)
    p = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    p.add_argument("-c", "--config", action="append", default=[])
    p.add_argument("--run_dir")
    try:
        given, _ = p.parse_known_args(args)
    except argparse.ArgumentError:
        return args  # the command's own parser says what is wrong
    folders = []
    for path in map(Path, given.config):
        if path.name == "config.yaml" and is_run_folder(path.parent):
            read_kept_config(path.parent)
            folders.append(path.parent)
        elif is_file(path):
            read_yaml(path)
    return [*args, f"--run_dir={folders[-1]}"] if folders and given.run_dir is None else args
