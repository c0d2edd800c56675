"""A sweep's YAML: what it makes, and what it says of what cannot be right before anything runs."""

import pytest
import yaml

from idapt_pl.sweep.folder import SweepFolder
from idapt_pl.sweep.plan import combinations, plan_sweep
from idapt_pl.sweep.settings import RunResources, read_sweep, settings_from

SMALL = {
    "tasks": ["inverted_pendulum"],
    "size": "quick",
    "targets": ["hard"],
    "methods": {"IDAPT": {}},
    "seeds": [0, 1],
}


def made(tmp_path, **changes):
    return settings_from(SMALL | changes, tmp_path / "sweep")


def pretend(arguments):
    """A complete config in no time: which arguments it was made of, and nothing opened."""
    return {"task": "inverted_pendulum", "target": "hard", "made_of": arguments, "seed": 0}


def test_every_combination_is_a_run(tmp_path):
    settings = made(
        tmp_path,
        tasks={"pendulum": "configs/pendulum_{target}.yaml", "cheetah": ["configs/cheetah_quick.yaml"]},
        targets=["easy", "hard"],
        methods={"IDAPT": {}, "no F": {"schedule.action_transformation": False}},
        seeds=[3, 5],
    )
    folder = SweepFolder(settings.folder)
    runs = plan_sweep(settings, folder, pretend)
    assert len(runs) == 2 * 2 * 2 * 2 and [r.index for r in runs] == list(range(16))
    assert runs[3].name == "pendulum_easy_no-F_5" and len({r.name for r in runs}) == 16
    assert [r.name for r in folder.read_plan()] == [r.name for r in runs]
    kept = yaml.safe_load(folder.config("pendulum_easy_no-F_5").read_text())
    assert kept["seed"] == 5 and kept["made_of"][0].endswith("configs/pendulum_easy.yaml")


def test_methods_lie_over_overrides_and_files_under_settings(tmp_path):
    (tmp_path / "mine.yaml").write_text("episodes: 3\n")
    settings = made(
        tmp_path,
        overrides={"episodes": 2, "schedule.images": 90},
        methods={"m": {"config": str(tmp_path / "mine.yaml"), "schedule": {"images": 30}, "schedule.interactions": 60}},
    )
    (((_, _, _, arguments, where)),) = combinations(settings)
    said = [a.partition("=")[2] for a in arguments]
    assert said[0].endswith("configs/pendulum_quick.yaml") and said[2] == str(tmp_path / "mine.yaml")
    assert yaml.safe_load(said[1]) == {"episodes": 2, "schedule": {"images": 90}}
    assert yaml.safe_load(said[3]) == {"schedule": {"images": 30, "interactions": 60}}
    assert arguments[-1] == "--target=hard" and where == "methods: m, on inverted_pendulum to hard"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"tasks": ["magic"]}, ["tasks", "unknown task 'magic'", "walker2d"]),
        ({"tasks": None}, ["tasks"]),
        ({"tasks": {"a": 3}}, ["tasks: a"]),
        ({"tasks": ["a/x.yaml", "b/x.yaml"]}, ["x stands twice"]),
        ({"size": "huge"}, ["size", "huge", "quick"]),
        ({"targets": 3}, ["targets"]),
        ({"targets": []}, ["targets"]),
        ({"targets": {"a": 3}}, ["targets: a"]),
        ({"methods": ["DR"]}, ["unknown method DR"]),
        ({"methods": 3}, ["methods"]),
        ({"methods": {"a": 3}}, ["methods: a"]),
        ({"methods": {"a": {"seed": 3}}}, ["methods: a", "seed"]),
        ({"methods": {"a": {"schedule": 3, "schedule.images": 3}}}, ["methods: a", "schedule.images"]),
        ({"methods": {"a": {"episodes": 3, "b": {}}, "a ": {}}, "seeds": [-1]}, ["seeds"]),
        ({"seeds": []}, ["seeds"]),
        ({"seeds": [1, 1]}, ["seeds"]),
        ({"seeds": ["x"]}, ["seeds"]),
        ({"seeds": 3}, ["seeds"]),
        ({"resources": {"cpus": 0}}, ["resources.cpus", "0"]),
        ({"resources": {"cores": 1}}, ["cores", "cpus"]),
        ({"resources": {"gpus": "all"}}, ["resources.gpus"]),
        ({"retries": -1}, ["retries"]),
        ({"normalise": "best"}, ["normalise", "best", "oracle"]),
        ({"references": {"x": {"oracle": 3}}}, ["references: x"]),
        ({"references": {"a/b": {"orakel": 3}}}, ["orakel"]),
        ({"storage": 3}, ["storage"]),
        ({"sedes": [1]}, ["unknown key sedes", "seeds"]),
    ],
)
def test_what_cannot_be_right_is_said(changes, words, tmp_path):
    with pytest.raises(ValueError) as error:
        made(tmp_path, **changes)
    assert all(word in str(error.value) for word in words) and "\n" not in str(error.value), error.value


def test_oracles_come_from_a_table_too(tmp_path):
    path = tmp_path / "bounds.csv"
    path.write_text(
        "task,domain,policy,metric,mean\nfetch_reach,hard,oracle,success,1.0\nfetch_reach,hard,oracle,return,-3\n"
        "walker2d,easy,oracle,return,2000\nwalker2d,easy,oracle,return,3000\nwalker2d,easy,direct transfer,return,5\n"
    )
    found = made(tmp_path, references=str(path)).references
    assert found == {"fetch_reach/hard": {"oracle": 1.0}, "walker2d/easy": {"oracle": 2500.0}}
    path.write_text("a,b\n1,2\n")
    with pytest.raises(ValueError, match=r"bounds\.csv is no table of oracles"):
        made(tmp_path, references=str(path))


def test_errors_name_the_file(tmp_path):
    (tmp_path / "s.yaml").write_text("- 1\n")
    with pytest.raises(ValueError, match=r"s\.yaml: it holds no keys"):
        read_sweep(tmp_path / "s.yaml")
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(SMALL | {"resources": {"gpus": 0.5}}))
    settings = read_sweep(tmp_path / "s.yaml")
    assert str(settings.folder) == "runs/sweeps/s" and settings.resources == RunResources(1, 0.5)


def test_files_that_are_not_there_and_targets_that_are_needed_are_said(tmp_path):
    with pytest.raises(ValueError, match=r"tasks: p: there is no file configs/none\.yaml"):
        plan_sweep(made(tmp_path, tasks={"p": "configs/none.yaml"}), SweepFolder(tmp_path), pretend)
    with pytest.raises(ValueError, match=r"methods: m, on inverted_pendulum to hard: there is no file none.yaml"):
        plan_sweep(made(tmp_path, methods={"m": "none.yaml"}), SweepFolder(tmp_path), pretend)
    with pytest.raises(ValueError, match="needs targets"):
        plan_sweep(
            made(tmp_path, tasks={"p": "configs/pendulum_{target}.yaml"}, targets=None), SweepFolder(tmp_path), pretend
        )


def test_what_a_run_cannot_begin_with_names_the_method(tmp_path):
    def refuse(arguments):
        raise ValueError("Group 'schedule' does not accept option 'imagez'")

    with pytest.raises(ValueError, match=r"methods: IDAPT, on inverted_pendulum to hard: Group 'schedule' .* 'imagez'"):
        plan_sweep(made(tmp_path), SweepFolder(tmp_path / "sweep"), refuse)
    assert not (tmp_path / "sweep").exists(), "nothing is written"


def test_a_plan_is_taken_over_until_its_settings_change(tmp_path):
    settings, calls = made(tmp_path), []

    def counted(arguments):
        calls.append(arguments)
        return pretend(arguments)

    folder = SweepFolder(settings.folder)
    first = plan_sweep(settings, folder, counted)
    assert plan_sweep(settings, folder, counted) == first and len(calls) == 1
    more = plan_sweep(made(tmp_path, seeds=[0, 1, 2]), folder, counted)
    assert more[:2] == first and len(calls) == 2
    plan_sweep(made(tmp_path, methods={"IDAPT": {"episodes": 3}}), folder, counted)
    assert len(calls) == 3


def test_a_run_that_was_begun_keeps_its_settings(tmp_path):
    settings = made(tmp_path)
    folder = SweepFolder(settings.folder)
    (run, _) = plan_sweep(settings, folder, lambda a: {"task": "t", "target": "hard", "schedule": {"images": 3}})
    folder.run(run.name).mkdir(parents=True)
    (folder.run(run.name) / "config.yaml").write_text(folder.config(run.name).read_text())
    with pytest.raises(ValueError, match=r"inverted_pendulum_hard_IDAPT_0 was begun .*schedule\.images differ"):
        plan_sweep(
            made(tmp_path, methods={"IDAPT": {"schedule.images": 4}}), folder,
            lambda a: {"task": "t", "target": "hard", "schedule": {"images": 4}},
        )  # fmt: skip


def test_a_file_that_a_setting_names_is_a_setting(tmp_path):
    ranges = tmp_path / "mine.yaml"
    ranges.write_text("[1]\n")

    def read(arguments):  # as a complete config holds the content of such a file
        return {"task": "inverted_pendulum", "target": "hard", "ranges": ranges.read_text()}

    methods = {"mine": {"randomisation.ranges": str(ranges)}}
    first = made(tmp_path, seeds=[0], methods=methods)
    folder = SweepFolder(first.folder)
    (run,) = plan_sweep(first, folder, read)
    assert plan_sweep(first, folder, read) == [run]
    ranges.write_text("[2]\n")
    assert plan_sweep(first, folder, read)[0].digest != run.digest


def test_references_are_of_cells_of_the_sweep(tmp_path):
    for cell in ("inverted_pendulum/hard", "half_cheetah/hard"):
        assert made(tmp_path, references={cell: {"oracle": 5}}).references == {cell: {"oracle": 5}}
    with pytest.raises(ValueError, match=r"half_cheeta/hard is no cell of this sweep; it has inverted_pendulum/hard"):
        made(tmp_path, references={"half_cheeta/hard": {"oracle": 5}})
    with pytest.raises(ValueError, match="inverted_pendulum/easy is no cell"):
        made(tmp_path, references={"inverted_pendulum/easy": {"oracle": 5}})


def test_one_run_of_an_array_is_planned_alone(tmp_path):
    settings, calls = made(tmp_path, methods={"a": {}, "b": {"episodes": 2}}), []
    folder = SweepFolder(settings.folder)
    runs = plan_sweep(settings, folder, lambda a: calls.append(a) or pretend(a), only=3)
    assert len(calls) == 1 and runs[3].name.endswith("b_1") and not folder.plan.exists()
    assert [p.stem for p in folder.path.glob("configs/*")] == [runs[3].name]
    with pytest.raises(ValueError, match="--index 4: the sweep has runs 0 to 3"):
        plan_sweep(settings, folder, pretend, only=4)


def test_names_that_clash_are_refused(tmp_path):
    with pytest.raises(ValueError, match="two runs would be called"):
        plan_sweep(made(tmp_path, methods={"a b": {}, "a/b": {}}), SweepFolder(tmp_path), pretend)
