"""``idapt doctor``: what works on this machine, and how to cure what does not."""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from importlib import metadata
from typing import Literal

import torch
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from torchvision.extension import _has_ops as torchvision_has_ops

from cli.arguments import parser
from idapt_pl.modules.manual import computes_bfloat16

BACKENDS = ("egl", "osmesa")
FREE_GB = 5
"""Disk space below which a run may not fit: trajectory files, checkpoints and logs."""

GL_CURE = "Debian/Ubuntu: apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri libosmesa6"
COLORS = {"ok": "green", "warn": "yellow", "fail": "red"}

RENDER = """
import time
import mujoco
from idapt_pl.rendering.classic import FrameRenderer
from idapt_pl.tasks import make_task

model = make_task("inverted_pendulum").domain("source").compile()
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
render = FrameRenderer(model, 100)
if render(data).std() == 0:
    raise RuntimeError("the frame is of one colour")
started = time.perf_counter()
for _ in range(100):
    render(data)
print(100 / (time.perf_counter() - started))
"""
"""Prints frames per second; a program of its own because MUJOCO_GL must be set before mujoco is imported."""


@dataclass(frozen=True)
class Check:
    """One row: what was looked at, whether it works, what was found, what to do about it."""

    name: str
    status: Literal["ok", "warn", "fail"]
    found: str
    cure: str = ""


def main(args: list[str]) -> int:
    """Run ``idapt doctor``. Returns 0 if some backend renders, else 1."""
    p = parser("doctor", __doc__)
    p.add_argument("--json", action="store_true", help="print JSON instead of a table")
    o = p.parse_args(args)
    rendering = [check_rendering(backend) for backend in BACKENDS]
    renders = any(c.status == "ok" for c in rendering)
    if renders:  # one backend is enough
        rendering = [c if c.status == "ok" else replace(c, status="warn") for c in rendering]
    software = [check_python(), *check_packages(), check_torchvision()]
    machine = [check_filament(), check_gpu(), check_bfloat16(), check_threads(), check_disk()]
    checks = [*software, *rendering, *machine]
    if o.json:
        print(json.dumps([asdict(c) for c in checks], indent=2))
    else:
        print_table(checks)
    return 0 if renders else 1


def print_table(checks: list[Check]) -> None:
    """The checks, one a row."""
    table = Table("check", "", "found", "cure")
    for c in checks:
        table.add_row(c.name, f"[{COLORS[c.status]}]{c.status}[/]", escape(c.found), escape(c.cure))
    Console().print(table)


def check_python() -> Check:
    """The interpreter against what the package requires."""
    wanted, found = metadata.metadata("idapt")["Requires-Python"], platform.python_version()
    if SpecifierSet(wanted).contains(found, prereleases=True):
        return Check("Python", "ok", found)
    return Check("Python", "fail", f"{found}, expected {wanted}", "make an environment with a newer Python")


def check_packages() -> Iterator[Check]:
    """Each dependency against the range it is known to work in."""
    for requirement in map(Requirement, metadata.requires("idapt") or ()):
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": ""}):
            continue
        name, wanted = requirement.name, requirement.specifier
        cure = f"pip install '{name}{wanted}'"
        try:
            found = metadata.version(name)
        except metadata.PackageNotFoundError:
            yield Check(name, "fail", f"not installed, expected {wanted}", cure)
            continue
        if wanted.contains(found, prereleases=True):
            yield Check(name, "ok", found)
        else:
            yield Check(name, "warn", f"{found}, known to work: {wanted}", cure)


def check_torchvision() -> Check:
    """Whether torchvision's compiled operators loaded; that it can be imported is why this module runs."""
    if torchvision_has_ops():
        return Check("torchvision operators", "ok", "compiled operators loaded")
    found = "imports, but without its compiled operators"
    return Check("torchvision operators", "ok", f"{found}; nothing here needs them")


def check_rendering(backend: str) -> Check:
    """Render with a MuJoCo GL backend, as the environments do."""
    name = f"rendering, MUJOCO_GL={backend}"
    command = [sys.executable, "-W", "ignore", "-c", RENDER]
    try:
        done = subprocess.run(
            command, env=os.environ | {"MUJOCO_GL": backend}, capture_output=True, text=True, timeout=120
        )
    except subprocess.TimeoutExpired:
        return Check(name, "fail", "no frame after 120 s", GL_CURE)
    if done.returncode == 0:
        return Check(name, "ok", f"{float(done.stdout):.0f} frames/s at 100 pixels")
    last = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
    why = last.partition("RenderingUnavailable: ")[2].partition(". Install")[0] or last
    return Check(name, "fail", why, f"{GL_CURE}; or set MUJOCO_GL to one that works")


def check_filament() -> Check:
    """Whether the hard manipulation domains can be drawn by Filament."""
    from idapt_pl.rendering import filament

    why, name = filament.why_unavailable(), "rendering by Filament (fetch_reach and sawyer_push, hard)"
    if why is None:
        return Check(name, "ok", "there is a Vulkan device")
    return Check(name, "warn", f"{why}; the classic renderer stands in", filament.CURE)


def check_gpu() -> Check:
    """Whether torch sees a GPU; none is fine unless there is one."""
    if torch.cuda.is_available():
        memory = torch.cuda.get_device_properties(0).total_memory / 2**30
        return Check("GPU", "ok", f"{torch.cuda.get_device_name(0)}, {memory:.0f} GiB")
    if shutil.which("nvidia-smi"):
        found = f"torch {torch.__version__} does not see the NVIDIA GPU"
        return Check(
            "GPU", "warn", found, "install a CUDA build of torch that the driver supports: https://pytorch.org"
        )
    return Check("GPU", "ok", "none; training runs on the CPU")


def check_bfloat16() -> Check:
    """Whether training uses bfloat16; either is fine."""
    if computes_bfloat16("cuda" if torch.cuda.is_available() else "cpu"):
        return Check("bfloat16", "ok", "the device computes in it, and convolutions use it")
    return Check("bfloat16", "ok", "the device has no instructions for it; all is computed in float32")


def check_threads() -> Check:
    """CPU threads of the machine and those torch uses."""
    used, there = torch.get_num_threads(), os.cpu_count()
    return Check("CPU threads", "ok", f"{there}, torch uses {used}")


def check_disk() -> Check:
    """Free space where runs are written by default."""
    free = shutil.disk_usage(".").free / 1e9
    found = f"{free:.1f} GB here"
    if free >= FREE_GB:
        return Check("free disk", "ok", found)
    return Check("free disk", "warn", found, "free some space, or give --run_dir on another disk")
