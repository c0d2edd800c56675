"""Processes that render: the same frames as here, and what happens when one ends."""

import os
import signal
import subprocess
import sys
import threading
from contextlib import closing

import mujoco
import numpy as np
import pytest

from idapt_pl.rendering import parallel
from idapt_pl.rendering.classic import FrameRenderer
from idapt_pl.rendering.parallel import ParallelRenderer
from idapt_pl.rendering.process import POSES, RenderProcess

SIZE = 16


@pytest.fixture
def model(cart):
    return cart.domain("hard").compile()


@pytest.fixture
def process():
    with closing(RenderProcess()) as process:
        yield process


@pytest.fixture
def file(model, tmp_path):
    mujoco.mj_saveModel(model, str(tmp_path / "model.mjb"))
    return tmp_path / "model.mjb"


def states(model, n):
    """Carts at n places."""
    data = [mujoco.MjData(model) for _ in range(n)]
    for i, d in enumerate(data):
        d.qpos[:] = 0.1 * i
        mujoco.mj_forward(model, d)
    return data


def drawn(process, file, data):
    frames = np.empty((len(data), SIZE, SIZE, 3), np.uint8)
    process.ask(file, SIZE, data)
    process.answer(frames)
    return frames


@pytest.fixture
def expected(model):
    with closing(FrameRenderer(model, SIZE)) as render:
        return np.stack([render(d) for d in states(model, 3)])


def test_frames_are_those_drawn_here_also_after_it_was_replaced(process, file, model, expected):
    assert (expected[0] != expected[2]).any()
    for _ in range(2):
        np.testing.assert_array_equal(drawn(process, file, states(model, 3)), expected)
        assert process.drawn == 3
        process.close()


def test_it_draws_several_models_in_turn(process, file, cart, model, expected, tmp_path):
    other = cart.domain("source").compile()
    mujoco.mj_saveModel(other, str(tmp_path / "other.mjb"))
    source = drawn(process, tmp_path / "other.mjb", states(other, 3))
    np.testing.assert_array_equal(drawn(process, file, states(model, 3)), expected)
    assert (source != expected).any()
    np.testing.assert_array_equal(drawn(process, tmp_path / "other.mjb", states(other, 3)), source)


def test_a_request_and_its_answer_may_both_be_larger_than_a_pipe_holds(process, file, model):
    data, found = states(model, 400), []
    assert 400 * SIZE * SIZE * 3 > 2**16 and 400 * sum(getattr(data[0], name).nbytes for name in POSES) > 2**16
    thread = threading.Thread(target=lambda: found.append(drawn(process, file, data)), daemon=True)
    thread.start()
    thread.join(timeout=60)
    if thread.is_alive():
        os.kill(process._process.pid, signal.SIGKILL)
    assert found and (found[0][0] != found[0][2]).any()


def test_a_process_that_was_killed_is_told_of_and_replaced(process, file, model, expected):
    drawn(process, file, states(model, 1))
    os.kill(process._process.pid, signal.SIGKILL)
    with pytest.raises(RuntimeError, match=r"ended with code -9 \(killed, perhaps for want of memory\)"):
        drawn(process, file, states(model, 1))
    np.testing.assert_array_equal(drawn(process, file, states(model, 3)), expected)


def test_answers_that_were_not_asked_for_are_refused(process):
    with pytest.raises(RuntimeError, match="ask before"):
        process.answer(np.empty((1, SIZE, SIZE, 3), np.uint8))


def test_a_closed_renderer_says_so(model):
    render = FrameRenderer(model, SIZE)
    render.close()
    with pytest.raises(RuntimeError, match="was closed"):
        render(mujoco.MjData(model))


def test_an_error_here_leaves_no_stale_frames_for_the_next_call(cart, model, expected, monkeypatch):
    with closing(ParallelRenderer(model, SIZE, processes=1)) as render:
        data = states(model, 3)
        with monkeypatch.context() as m, pytest.raises(KeyboardInterrupt):
            m.setattr(render, "_own", lambda *args, **kwargs: (_ for _ in ()).throw(KeyboardInterrupt))
            render(data[::-1])
        np.testing.assert_array_equal(render(data), expected)


def test_models_drawn_elsewhere_change_processes_after_their_lifetime(model, expected, monkeypatch):
    monkeypatch.setattr(parallel, "FRAMES_PER_PROCESS", 6)
    with closing(ParallelRenderer(model, SIZE)) as render:
        render._elsewhere, pids = True, []  # as where Filament draws
        monkeypatch.setattr(parallel, "_others", {"classic": [], "filament": []})
        for _ in range(4):
            np.testing.assert_array_equal(render(states(model, 3)), expected)
            pids.append(parallel._others["filament"][0]._process.pid)
        parallel._others["filament"][0].close()
    assert pids[0] == pids[1] != pids[2] == pids[3]


def test_such_a_process_loads_no_torch():
    program = "import sys, idapt_pl.rendering.process; print('torch' in sys.modules, 'mujoco' in sys.modules)"
    env = os.environ | {"IDAPT_ONLY_RENDERS": "1"}
    done = subprocess.run([sys.executable, "-c", program], env=env, capture_output=True, text=True)
    assert done.stdout.split() == ["False", "True"], done.stderr


def test_it_ends_with_the_program_that_started_it(file):
    program = f"""
import mujoco, numpy as np, os, signal, idapt_pl
from pathlib import Path
from idapt_pl.rendering.process import RenderProcess
model = mujoco.MjModel.from_binary_path({str(file)!r})
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
process, frame = RenderProcess(), np.empty((1, 8, 8, 3), np.uint8)
process.ask(Path({str(file)!r}), 8, [data])
process.answer(frame)
os.kill(os.getpid(), signal.SIGKILL)
"""
    # This waits until nobody holds the other end of stderr any more, so until both are gone.
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.returncode == -signal.SIGKILL and done.stderr == ""
