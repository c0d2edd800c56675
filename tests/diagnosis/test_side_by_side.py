"""Simulations side by side: the same answers with any number of threads."""

import threading
from dataclasses import replace

import mujoco
import numpy as np
import psutil
import pytest
from arm import ARM, record

from idapt_pl.diagnosis.search import diagnose
from idapt_pl.diagnosis.state.settings import DEFAULT_SETTINGS
from idapt_pl.effects.joints import JointDamping, JointStribeck
from idapt_pl.prediction.data import as_recordings, sample_windows
from idapt_pl.prediction.side_by_side import SideBySide
from idapt_pl.prediction.simulator import Simulator, silence_mujoco


def test_calls_run_in_threads_and_come_back_in_their_order():
    together = threading.Barrier(3, timeout=20)  # three calls wait for each other, so none comes after another

    def call(k):
        together.wait()
        return k, threading.get_ident()

    numbers, threads = zip(*SideBySide(3).map(call, range(3)), strict=True)
    assert numbers == (0, 1, 2)
    assert len({*threads, threading.get_ident()}) == 4


def test_calls_within_calls_stay_in_their_thread():
    each = SideBySide(2)

    def inner(_):
        return each.within, threading.get_ident()

    def outer(_):
        return {(True, threading.get_ident()), *each.map(inner, range(3))}

    assert all(len(seen) == 1 for seen in each.map(outer, range(4)))
    assert not each.within


@pytest.mark.parametrize("threads", [1, 2])
def test_an_error_is_raised_and_what_has_not_begun_is_left(threads):
    begun, go_on = [], threading.Event()

    def call(k):
        begun.append(k)
        if k == 0:
            raise ValueError("the first")
        go_on.wait(0.05)

    with pytest.raises(ValueError, match="the first"):
        SideBySide(threads).map(call, range(500))
    assert len(begun) < 500


def test_predictions_do_not_depend_on_threads():
    data, velocities = as_recordings(mujoco.MjSpec.from_string(ARM).compile(), record(episodes=3))
    windows = sample_windows(data, np.arange(3), 5, 5, 100, 0)
    others = [
        effect
        for k in range(6)
        for effect in (JointDamping("*", 0.1 * k), JointStribeck("shoulder", coulomb=0.01 * k, static=0.1))
    ]

    def residuals(threads):
        sim = Simulator(mujoco.MjSpec.from_string(ARM), data, velocities, threads)
        return sim.side_by_side.map(lambda e: sim.residual((e,), windows), others * 2), sim.calls

    alone, once = residuals(1)
    for threads in (2, 5):
        beside, _ = residuals(threads)
        assert all(np.array_equal(a, b) for a, b in zip(alone, beside, strict=True))
    assert once == len(others), "what is asked for again is not simulated again"
    assert np.ptp([np.abs(r).mean() for r in alone]) > 0


def test_as_many_threads_as_the_process_may_use_cores(monkeypatch):
    monkeypatch.setattr(psutil.Process, "cpu_affinity", lambda self: [3, 5, 6], raising=False)
    data, velocities = as_recordings(mujoco.MjSpec.from_string(ARM).compile(), record(episodes=3))
    assert Simulator(mujoco.MjSpec.from_string(ARM), data, velocities).threads == 3


def test_a_diagnosis_does_not_depend_on_threads():
    damped = ARM.replace('damping="0.05"', 'damping="0.6"')
    data = record(damped, push=lambda time: 0.2 * np.sin(9 * time), episodes=4, steps=60)  # of which no effect knows
    kinds = ["joint_damping", "joint_stribeck", "joint_armature", "actuator_gain"]

    few = replace(DEFAULT_SETTINGS, max_effects=3, fit_windows=60, screen_windows=60, held_out_windows=60)

    def found(threads):
        spec = mujoco.MjSpec.from_string(ARM)
        report = diagnose(spec, data, candidates=kinds, threads=threads, settings=few).report
        del report["runtime_s"], report["laws"]["seconds"]
        return report

    one, four = found(1), found(4)
    assert one == four
    assert {"joint_damping(shoulder)"} <= {f"{e['effect']}({e['target']})" for e in one["effects"]}


def test_warnings_are_back_when_the_last_wants_no_silence_any_more():
    before, inner, outer = mujoco.get_mju_user_warning(), silence_mujoco(), silence_mujoco()
    inner.__enter__()
    outer.__enter__()
    inner.__exit__(None, None, None)  # the first to come is the first to go, as in threads
    assert mujoco.get_mju_user_warning() is not before, "somebody still wants silence"
    outer.__exit__(None, None, None)
    assert mujoco.get_mju_user_warning() is before
