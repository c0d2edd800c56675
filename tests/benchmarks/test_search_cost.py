"""What a diagnosis simulates is counted, and versions stand side by side."""

import mujoco
import numpy as np

from benchmarks.search_cost import FIELDS, counted
from benchmarks.tables import search_cost, write_rows
from datamodules import Episode, Trajectories
from idapt_pl.prediction.data import Windows, as_recordings
from idapt_pl.prediction.simulator import Simulator

SWING = """<mujoco><option timestep="0.01"/>
<worldbody><body><joint name="hinge" axis="0 1 0"/><geom size="0.1"/></body></worldbody>
<actuator><motor joint="hinge"/></actuator></mujoco>"""


def test_time_steps_of_all_windows_are_counted_once():
    spec, rest = mujoco.MjSpec.from_string(SWING), {"qpos": np.zeros((41, 1)), "qvel": np.zeros((41, 1))}
    data, measured = as_recordings(
        spec.copy().compile(), Trajectories((Episode(np.zeros((40, 1), np.float32), rest),), 0.02)
    )
    sim, windows = Simulator(spec, data, measured, threads=1), Windows(np.zeros(3, int), np.arange(3), np.array([5]))
    plain = Simulator.states
    with counted() as counts:
        sim.predict((), windows)
        sim.predict((), windows)
    assert counts == [3 * 10], "three windows of five control steps of two time steps; the second time it is known"
    assert Simulator.states is plain


def test_the_earliest_version_stands_beside_the_latest(tmp_path):
    same = {"model": "arm", "hidden": "1", "seed": "0", "found": "a + b", "loss": "1.5", "cpu_s": "9"}
    rows = [
        same | {"steps_m": "8.0", "commit": "x"},
        same | {"steps_m": "5.0", "commit": "y", "found": "b + a", "loss": "1.25"},
        same | {"model": "leg", "steps_m": "1.0", "commit": "x"},
    ]
    write_rows(tmp_path / "search_cost.csv", rows, FIELDS)
    table = search_cost(tmp_path).splitlines()
    assert table[2:] == ["| arm | 1 | 0 | 8.0 to 5.0 | 9 to 9 | 1.500 to 1.250 | the same |"]
