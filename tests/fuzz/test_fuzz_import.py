# ruff: noqa: E501 (inputs are read best one a line)
"""`idapt import` and `idapt diagnose` refuse what cannot be right; what import accepts can be read and is finite."""

import json

import h5py
import numpy as np
import pytest
import yaml
from fuzzing import NO_YAML, assert_refused, attempt, damaged

from datamodules import Episode, Trajectories, read_trajectories, write_trajectories
from datamodules.safe_yaml import read_yaml

MODEL = """<mujoco><worldbody><body><joint name="w"/><geom size="1"/></body></worldbody>
<actuator><motor name="m" joint="w"/></actuator></mujoco>"""
MAP = {
    "time": {"column": "t", "unit": "s"},
    "joints": {"w": {"position": {"column": "q", "unit": "rad"}}},
    "actuators": {"m": {"column": "u"}},
    "infos": {"current": "i"},
}
ROWS = 12
COLUMNS = {"t": np.arange(ROWS) * 0.01, "q": np.sin(np.arange(ROWS)), "u": np.cos(np.arange(ROWS)), "i": np.ones(ROWS)}


@pytest.fixture
def folder(tmp_path):
    """A recording in every format, its map and its model; too short to be diagnosed."""
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(MAP))
    (tmp_path / "model.xml").write_text(MODEL)
    rows = zip(*COLUMNS.values(), strict=True)
    rows = [dict(zip(COLUMNS, map(float, row), strict=True)) for row in rows]
    lines = [",".join(map(str, row.values())) for row in rows]
    (tmp_path / "a.csv").write_text(",".join(COLUMNS) + "\n" + "\n".join(lines) + "\n")
    (tmp_path / "a.jsonl").write_text("\n".join(map(json.dumps, rows)) + "\n")
    np.savez(tmp_path / "a.npz", **COLUMNS)
    return tmp_path


def imports(folder, *options, recording="a.csv"):
    return ["import", recording, "--map", "map.yaml", "--out", "out.h5", *options]


def assert_fine_or_refused(args, folder):
    """Refused, or what was written can be read and holds numbers."""
    code, said = attempt(args, folder)
    if code == 0:
        for episode in read_trajectories(folder / "out.h5"):
            assert np.isfinite(episode.observations["qpos"]).all()
    else:
        assert code in (1, 2) and 0 < len(said.splitlines()) <= 3 and not (folder / "out.h5").exists(), said


def test_what_is_right_is_accepted(folder):
    for recording in ("a.csv", "a.npz", "a.jsonl"):
        assert attempt(imports(folder, "--model", "model.xml", recording=recording), folder)[0] == 0
        assert read_trajectories(folder / "out.h5").total_steps == ROWS - 1


@pytest.mark.parametrize("kind", NO_YAML)
def test_files_that_are_no_map(kind, folder):
    (folder / "map.yaml").write_bytes(NO_YAML[kind])
    assert_refused(imports(folder), folder)


@pytest.mark.parametrize("kind", NO_YAML)
@pytest.mark.parametrize(
    "name", ["a.csv", "a.npz", "a.h5", "a.hdf5", "a.mcap", "a.parquet", "a.bag", "a.db3", "a.ulg", "a.jsonl"]
)
def test_files_that_are_no_recording(kind, name, folder):
    (folder / name).write_bytes(NO_YAML[kind])
    assert_refused(imports(folder, recording=name), folder)


WRONG_MAPS = [
    "{}", "time: t", "time: 3\ndt: 1", "dt: -1", "dt: .nan", "dt: 1e300", "dt: 1e-300", "dt: [1]", "dt: null",
    "time: {column: t, unit: years}", "time: {column: t, unit: ns}", "time: {column: nothing}", "time: {unit: s}",
    "time: q", "joints: []", "joints: {}", "joints: {w: 3}", "joints: {w: {position: {}}}", "joints: {w: {velocity: q}}",
    "joints: {w: {position: {column: q, unit: stone}}}", "joints: {w: {position: {column: q, unit: 'counts:0'}}}",
    "joints: {w: {position: {column: q, unit: 'counts:nan'}}}", "joints: {w: {position: {column: q, sign: 2}}}",
    "joints: {w: {position: {column: q, scale: .inf}}}", "joints: {w: {position: {column: q, offset: many}}}",
    "joints: {w: {position: {column: q, scale: 1e308, offset: 1e308}}}", "joints: {w: {position: {constant: 1}}}",
    "joints: {w: {position: {column: [a, b]}}}", "joints: {w: {position: {column: []}}}", "joints: {x: {position: q}}",
    "joints: {w: {position: {column: {a: 1}}}}", "actuators: {m: {column: u, scale: 1e300}}", "actuators: {}",
    "actuators: {m: {column: u, unit: furlong}}", "actuators: {m: [a, b]}", "actuators: {m: [[u]]}", "time: {column: [a, b]}", "time: {column: []}", "actuators: {n: u}", "infos: {a/b: u}",
    "infos: {'': u}", "infos: {a: nothing}", "infos: [u]", "infos: {.: u}", "infos: {a: {b: c}}", "episodes: t",
    "episodes: {column: t}", "episodes: {column: nothing}", "episodes: {}", "actions_at: middle", "skip_rows: -1",
    "skip_rows: 1000000000000", "skip_rows: 1e12", "skip_rows: x", "header: perhaps", "header: false",
    "delimiter: ''", "delimiter: '::'", "delimiter: ';'", "delimiter: [1]", "unknown: 3", "3: 4", "null: 3",
]  # fmt: skip


@pytest.mark.parametrize("part", WRONG_MAPS)
def test_maps_that_cannot_be_right(part, folder):
    changes = yaml.safe_load(part)
    content = {k: v for k, v in MAP.items() if not ({"dt"} & set(changes) and k == "time")} | changes
    if part in ("{}", "time: t", "time: 3\ndt: 1"):
        content = changes
    (folder / "map.yaml").write_text(yaml.safe_dump(content))
    assert_refused(imports(folder, "--model", "model.xml"), folder)


WRONG_TABLES = [
    "", "\n\n", "t,q,u,i\n", "t,q,u,i\n0,0,0,0\n", "t,q,u\n0,0,0\n1,1,1\n", "0,0,0,0\n1,1,1,1\n", "t,q,q,u,i\n0,0,0,0,0\n",
    "t,q,u,i\n0,0,0,0\n0,1,1,1\n", "t,q,u,i\n1,0,0,0\n0,1,1,1\n", "t,q,u,i\n0,0,0,0\n1,1\n", "t,q,u,i\n0,x,0,0\n1,1,1,1\n",
    "t,q,u,i\n0,,0,0\n1,1,1,1\n", "t,q,u,i\n0,nan,0,0\n1,1,1,1\n", "t,q,u,i\n0,1,inf,0\n1,1,1,1\n2,1,1,1\n",
    "t,q,u,i\n0,1e999,1,0\n1,1,1,1\n", "t,q,u,i\n0,1,1e39,0\n1,1,1,1\n", "t,q,u,i\n0,0,0,0\n1e300,1,1,1\n",
    "t,q,u,i\n0,0,0,0\n1e-300,1,1,1\n", "t,q,u,i\nnan,0,0,0\n1,1,1,1\n", "t,q,u,i\n0,'1,2',0,0\n1,1,1,1\n",
    "t;q;u;i\n0;0,5;0;0\n1;1,5;1;1\n", "t,q,u,i\n" + "9" * 5000 + ",0,0,0\n1,1,1,1\n", '"t,q,u,i\n0,0,0,0\n', ",,,\n,,,\n",
    "t,q,u,i\n0,0,0,0\n5000,1,1,1\n",
]  # fmt: skip


@pytest.mark.parametrize("number", range(len(WRONG_TABLES)))
def test_tables_that_cannot_be_right(number, folder):
    (folder / "a.csv").write_text(WRONG_TABLES[number])
    assert_refused(imports(folder, "--model", "model.xml"), folder)


@pytest.mark.parametrize("seed", range(40))
@pytest.mark.parametrize("name", ["map.yaml", "a.csv", "a.npz", "a.jsonl", "model.xml"])
def test_damaged_inputs(name, seed, folder):
    (folder / name).write_bytes(damaged((folder / name).read_bytes(), seed))
    recording = name if name.startswith("a.") else "a.csv"
    options = ["--model", "model.xml", *["--repair"] * (seed % 2)]
    assert_fine_or_refused(imports(folder, *options, recording=recording), folder)


@pytest.mark.parametrize("seed", range(40))
@pytest.mark.parametrize("name", ["a.csv", "a.npz", "a.jsonl", "model.xml"])
def test_drafts_of_damaged_inputs(name, seed, folder):
    """Refused, or a draft that is a map or says in comments what it lacks."""
    (folder / name).write_bytes(damaged((folder / name).read_bytes(), seed))
    recording = name if name.startswith("a.") else "a.csv"
    code, said = attempt(["import", recording, "--draft-map", "d.yaml", "--model", "model.xml"], folder)
    assert code in (0, 1) and len(said.splitlines()) <= 3 and (folder / "d.yaml").exists() == (code == 0), said
    if code == 0:
        assert set(read_yaml(folder / "d.yaml")) <= {"time", "joints", "actuators", "episodes", "header", "skip_rows"}


@pytest.mark.parametrize("args", [
    ["import"], ["import", "a.csv"], ["import", "a.csv", "--map", "map.yaml"],
    ["import", "none.csv", "--map", "map.yaml", "--out", "o.h5"], ["import", ".", "--map", "map.yaml", "--out", "o.h5"],
    ["import", "a.csv", "--map", ".", "--out", "o.h5"], ["import", "a.csv", "--map", "none.yaml", "--out", "o.h5"],
    ["import", "a.csv", "--map", "map.yaml", "--out", "a.csv"], ["import", "a.csv", "--map", "map.yaml", "--out", "map.yaml"],
    ["import", "a.csv", "--map", "map.yaml", "--model", "model.xml", "--out", "model.xml"],
    ["import", "a.csv", "--map", "map.yaml", "--model", "model.xml", "--out", "./x/../model.xml"],
    ["import", "a.csv", "--map", "map.yaml", "--out", "a.csv/o.h5"], ["import", "a.csv", "--map", "map.yaml", "--out", "."],
    ["import", "a.csv", "--map", "map.yaml", "--out", ""], ["import", "a.csv", "--map", "map.yaml", "--format", "xls", "--dry-run"],
    *(["import", "a.csv", "--map", "map.yaml", "--format", f, "--out", "o.h5"] for f in ("npz", "minari", "lerobot", "mcap", "rosbag1", "rosbag2", "ulog", "jsonl")),
    ["import", "a.csv", "--map", "map.yaml", "--draft-map", "d.yaml", "--model", "model.xml"],
    ["import", "a.csv", "--draft-map", "d.yaml"], ["import", "a.csv", "--draft-map", "map.yaml", "--model", "model.xml"],
    ["import", "none.csv", "--draft-map", "d.yaml", "--model", "model.xml"], ["import", "a.csv", "--draft-map", "a.csv/d.yaml", "--model", "model.xml"],
    ["import", "a.csv", "--draft-map", "d.yaml", "--model", "none.xml"], ["import", "a.csv", "--draft-map", "d.yaml", "--model", "model.xml", "--out", "o.h5"],
    ["import", "a.csv", "--draft-map", "d.yaml", "--model", "model.xml", "--dry-run"],
    ["import", ".", "--draft-map", "d.yaml", "--model", "model.xml"], ["import", "a.csv", "--draft-map", ".", "--model", "model.xml"],
    ["import", "door/human-v2", "--map", "map.yaml", "--out", "o.h5"], ["import", "a.csv", "--map", "map.yaml", "--model", "a.csv", "--out", "o.h5"],
    ["import", "\x00", "--map", "map.yaml", "--out", "o.h5"], ["import", "x" * 5000, "--map", "map.yaml", "--out", "o.h5"],
])  # fmt: skip
def test_wrong_arguments_of_import(args, folder):
    assert_refused(args, folder)


# --- diagnose -------------------------------------------------------------------------------------------


@pytest.fixture
def measured(folder):
    """A recording of ten steps, which are too few."""
    episode = Episode(np.zeros((10, 1), np.float32), {"qpos": np.zeros((11, 1)), "qvel": np.zeros((11, 1))})
    write_trajectories(folder / "m.h5", Trajectories((episode,), 0.01, "test"))
    (folder / "effects.yaml").write_text("- effect: joint_damping\n  target: w\n  parameters: {damping: 0.1}\n")
    return folder


def diagnose(*options, model="model.xml"):
    return ["diagnose", "--model", model, "--data", "m.h5", "--out", "found", *options]


def test_ten_steps_are_too_few(measured):
    assert "too few" in assert_refused(diagnose("--effects", "effects.yaml"), measured)


@pytest.mark.parametrize("seed", range(40))
@pytest.mark.parametrize("name", ["m.h5", "model.xml", "effects.yaml"])
def test_damaged_inputs_of_a_diagnosis(name, seed, measured):
    (measured / name).write_bytes(damaged((measured / name).read_bytes(), seed))
    assert_refused(diagnose("--effects", "effects.yaml"), measured)


@pytest.mark.parametrize("kind", NO_YAML)
@pytest.mark.parametrize("name", ["m.h5", "model.xml", "effects.yaml"])
def test_files_of_another_kind(name, kind, measured):
    (measured / name).write_bytes(NO_YAML[kind])
    assert_refused(diagnose("--effects", "effects.yaml"), measured)


WRONG_EFFECTS = [
    "3", "{}", "[3]", "[null]", "[[]]", "[{}]", "[{effect: nothing}]", "[{effect: [joint_damping], target: w}]",
    "[{effect: joint_damping}]", "[{effect: joint_damping, target: 3}]", "[{effect: joint_damping, target: x, parameters: {damping: 1}}]",
    "[{effect: joint_damping, target: w, parameters: 3}]", "[{effect: joint_damping, target: w, parameters: {damping: -1}}]",
    "[{effect: joint_damping, target: w, parameters: {damping: .nan}}]", "[{effect: joint_damping, target: w, parameters: {damping: x}}]",
    "[{effect: joint_damping, target: w, parameters: {damping: [1]}}]", "[{effect: joint_damping, target: w, parameters: {3: 4}}]",
    "[{effect: joint_damping, target: w, parameters: {damping: 1, x: 2}}]", "[{effect: joint_damping, target: w, more: 1}]",
    "[{effect: body_mass, target: w, parameters: {mass: null}}]", "[{effect: light, target: w, parameters: {kind: [1]}}]",
    "[{effect: camera_pose, target: w, parameters: {azimuth: 1, elevation: 1, distance: 1, lookat: 3}}]",
    "[{effect: learned_force, target: w, parameters: {expression: a*v}}]",
    "[{effect: color, target: w, parameters: {rgba: [1, 2]}}]", "[{effect: color, target: w, parameters: {rgba: [a, b, c, d]}}]",
]  # fmt: skip


@pytest.mark.parametrize("text", WRONG_EFFECTS)
def test_effects_that_cannot_be_right(text, measured):
    (measured / "effects.yaml").write_text(text)
    assert_refused(diagnose("--effects", "effects.yaml"), measured)


@pytest.mark.parametrize(
    ("changes", "formula", "said"),
    [
        ({'<motor name="m" joint="w"/>': ""}, "a*motor", "depends on motor, but no actuator acts on joint 'w'"),
        ({'<motor name="m" joint="w"/>': ""}, "a*u", "depends on u, but no actuator acts on joint 'w'"),
        ({'<joint name="w"/>': '<joint name="w" type="free"/>'}, "a*v", "a law needs a hinge or a slide"),
    ],
)
def test_laws_that_could_not_act(changes, formula, said, measured):
    model = MODEL
    for old, new in changes.items():
        model = model.replace(old, new)
    (measured / "other.xml").write_text(model)
    parameters = f"parameters: {{expression: {formula}, a: 1.0}}"
    (measured / "effects.yaml").write_text(f"[{{effect: learned_force, target: w, {parameters}}}]")
    assert said in assert_refused(diagnose("--effects", "effects.yaml", model="other.xml"), measured)


@pytest.mark.parametrize("change", [
    {"dt": 0.0}, {"dt": -1.0}, {"dt": np.nan}, {"dt": np.inf}, {"dt": 1e9}, {"dt": "many"}, {"dt": [1.0, 2.0]},
    {"total_episodes": -1}, {"total_episodes": 0}, {"total_episodes": 2**60}, {"total_episodes": "x"},
    {"total_episodes": np.nan},
])  # fmt: skip
def test_attributes_that_cannot_be_right(change, measured):
    with h5py.File(measured / "m.h5", "r+") as f:
        f.attrs.update(change)
    assert_refused(diagnose(), measured)


@pytest.mark.parametrize("value", [
    None, 3, "text", np.zeros(11), np.zeros((11, 5)), np.zeros((3, 1)), np.full((11, 1), np.nan), np.array([[b"x"]] * 11),
    np.zeros((11, 1), complex), np.zeros((0, 1)),
])  # fmt: skip
@pytest.mark.parametrize("name", ["actions", "observations/qpos", "observations/qvel", "observations", "timestamps"])
def test_arrays_that_cannot_be_right(name, value, measured):
    with h5py.File(measured / "m.h5", "r+") as f:
        if f"episode_0/{name}" in f:
            del f[f"episode_0/{name}"]
        if value is not None:
            f[f"episode_0/{name}"] = value
    assert_refused(diagnose(), measured)


WRONG_MODELS = [
    "", "<", "<mujoco/>", "<mujoco><worldbody/></mujoco>", "<html></html>", MODEL.replace("motor", "rocket"),
    MODEL.replace('size="1"', 'size="-1"'), MODEL.replace('size="1"', 'size="nan"'), MODEL.replace('joint="w"', 'joint="x"'),
    MODEL.replace("<joint", '<joint range="2 1" limited="true"'), MODEL.replace("<mujoco>", '<mujoco><option timestep="0"/>'),
    MODEL.replace("<mujoco>", '<mujoco><option timestep="-1"/>'), MODEL.replace("<mujoco>", '<mujoco><include file="model.xml"/>'),
    MODEL.replace("<mujoco>", '<mujoco><include file="none.xml"/>'), MODEL.replace('<geom size="1"/>', '<geom type="mesh" mesh="x"/>'),
    MODEL.replace('size="1"', 'size="1" mass="-5"'), MODEL.replace('size="1"', 'size="1" mass="1e400"'),
    "<mujoco><worldbody>" + "<body>" * 3000 + "</body>" * 3000 + "</worldbody></mujoco>",
]  # fmt: skip


@pytest.mark.parametrize("number", range(len(WRONG_MODELS)))
def test_models_that_cannot_be_right(number, measured):
    (measured / "model.xml").write_text(WRONG_MODELS[number])
    assert_refused(diagnose(), measured)


@pytest.mark.parametrize("args", [
    ["diagnose"], ["diagnose", "--model", "model.xml", "--data", "m.h5"], diagnose("--run", "."), diagnose("--looks"),
    diagnose("--max-effects", "0"), diagnose("--max-effects", "many"), diagnose("--seed", "-1"), diagnose("--seed", "1.5"),
    diagnose("--threads", "0"), diagnose("--threads", "-3"), diagnose("--fit", "9"), diagnose("--fit", "-1"),
    diagnose("--fit", "0", "--hold-out", "0"), diagnose("--fit"), diagnose("--candidates", "nothing"), diagnose("--effects", "."),
    diagnose("--effects", "none.yaml"), diagnose("--effects", "m.h5"), diagnose(model="none.xml"), diagnose(model="."),
    diagnose(model="m.h5"), ["diagnose", "--model", "model.xml", "--data", ".", "--out", "found"],
    ["diagnose", "--model", "model.xml", "--data", "none.h5", "--out", "found"],
    ["diagnose", "--model", "model.xml", "--data", "m.h5", "--out", "m.h5"],
    ["diagnose", "--model", "model.xml", "--data", "m.h5", "--out", ".", "--effects", "effects.yaml"],
    ["diagnose", "--run", ".", "--data", "m.h5", "--out", "found"], ["diagnose", "--run", "none", "--data", "m.h5", "--out", "found"],
])  # fmt: skip
def test_wrong_arguments_of_diagnose(args, measured):
    assert_refused(args, measured)


def test_a_recording_with_a_pause_of_hours_is_refused_at_once(measured):
    time = np.arange(41) * 0.01
    time[20:] += 10_000
    observations = {"qpos": np.zeros((41, 1)), "qvel": np.zeros((41, 1))}
    episode = Episode(np.zeros((40, 1), np.float32), observations, timestamps=time)
    write_trajectories(measured / "m.h5", Trajectories((episode,), 0.01, "test"))
    assert "a pause of 1e+04 s after row 19" in assert_refused(diagnose(), measured)
