"""Filament: another engine, the same images each time; and what happens without it. In a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from idapt_pl.effects.visual import engine_of
from idapt_pl.rendering import filament, make, vulkan
from idapt_pl.rendering.classic import FrameRenderer
from idapt_pl.rendering.make import make_renderer
from idapt_pl.tasks import make_task

PROGRAM = """
import hashlib, numpy as np, idapt_pl
from contextlib import closing
from idapt_pl.envs import VectorImageEnv
from idapt_pl.rendering import parallel
from idapt_pl.rendering.filament import FilamentRenderer
from idapt_pl.tasks import make_task
task = make_task("fetch_reach")
one, two = (VectorImageEnv(task, task.domain("hard"), 1, size, 1) for size in (32, 24))
first = one.reset(seed=0)[0]["pixels"]
second = two.reset(seed=0)[0]["pixels"]          # two alive at a time, in turn
with closing(FilamentRenderer(one.model, 32)) as here:
    assert (one.reset(seed=0)[0]["pixels"][0, 0] == here(one.data[0])).all(), "drawn here or there"
parallel.FRAMES_PER_PROCESS, pid = 3, parallel._others['filament'][0]._process.pid
again = one.reset(seed=0)[0]["pixels"]
assert parallel._others['filament'][0]._process.pid != pid, "Filament keeps every frame's memory, so they are replaced"
moved = one.step(np.ones((1, 4), np.float32))[0]["pixels"]
assert (first == again).all() and (first != moved).any() and first.std() > 10 and second.std() > 10
assert len(parallel._others['filament']) == 1 and not parallel._others['classic'], "one engine to a process"
print(hashlib.sha256(first.tobytes() + second.tobytes()).hexdigest())
"""


def run(program, **env):
    kept = {k: v for k, v in os.environ.items() if k != "IDAPT_RENDERER"}
    return subprocess.run([sys.executable, "-c", program], env=kept | env, capture_output=True, text=True, timeout=300)


WITH_VULKAN = pytest.mark.skipif(filament.why_unavailable() is not None, reason="no Vulkan device")


@WITH_VULKAN
def test_filament_draws_the_same_state_the_same_way_each_time():
    done = run(PROGRAM)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.split()) == 1, "what Filament prints stays off the output"


@WITH_VULKAN
@pytest.mark.slow
def test_filament_draws_the_same_state_the_same_way_in_each_process():
    assert run(PROGRAM).stdout == run(PROGRAM).stdout != ""


def test_without_filament_the_classic_renderer_draws_the_same_room_and_says_so(caplog):
    model = make_task("sawyer_push").domain("hard").compile()
    assert engine_of(model) == "filament" and engine_of(make_task("sawyer_push").domain("easy").compile()) == "classic"
    make._warn_once.cache_clear()  # other tests of this process may have been told
    with caplog.at_level("WARNING"):
        render = make_renderer(model, 16)
    assert isinstance(render, FrameRenderer) and "IDAPT_RENDERER=classic" in caplog.text
    render.close()


@pytest.mark.parametrize(
    ("program", "why"),
    [
        ("print('no Vulkan library (libvulkan.so.1)')", "no Vulkan library"),
        ("import os; os.abort()", "asking for Vulkan devices ended with code -6"),
    ],
)
def test_a_machine_without_vulkan_is_told_what_to_install(program, why, monkeypatch, caplog, tmp_path):
    (tmp_path / "asks.py").write_text(program)
    monkeypatch.delenv("IDAPT_RENDERER")
    monkeypatch.setattr(filament.vulkan, "__file__", str(tmp_path / "asks.py"))
    filament.why_unavailable.cache_clear()
    with caplog.at_level("WARNING"):
        render = make_renderer(make_task("fetch_reach").domain("hard").compile(), 16)
    filament.why_unavailable.cache_clear()
    assert isinstance(render, FrameRenderer)
    render.close()
    assert why in caplog.text and "apt-get install libvulkan1 mesa-vulkan-drivers" in caplog.text


def test_a_library_that_is_not_there_is_named(monkeypatch):
    def missing(name):
        raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.setattr(vulkan.ctypes, "CDLL", missing)
    assert vulkan.what_is_missing() == "no Vulkan library (libvulkan.so.1: cannot open shared object file)"


@WITH_VULKAN
def test_asking_for_vulkan_leaves_this_process_without_it():
    maps = Path("/proc/self/maps")
    if not maps.exists():
        pytest.skip("no list of loaded libraries here")
    program = (
        "from idapt_pl.rendering import filament\n"
        "filament.why_unavailable()\n"
        "print('libvulkan' in open('/proc/self/maps').read())"
    )
    done = run(program)
    assert done.stdout.strip() == "False", done.stderr
