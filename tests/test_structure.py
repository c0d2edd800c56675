"""What may know what: read from the source, without importing it."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("cli", "idapt_pl", "datamodules")
FILES = sorted(p for package in PACKAGES for p in (ROOT / package).rglob("*.py"))


def imports(path):
    """Dotted names of all modules that a file imports, anywhere in it."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import; these checks read absolute ones"
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def offenders(folder, *forbidden):
    """``file imports module`` for each forbidden import below a folder (or in one file)."""
    folder = ROOT / folder
    files = [folder] if folder.is_file() else sorted(folder.rglob("*.py"))
    assert files, f"{folder} has no Python files"
    return [
        f"{f.relative_to(ROOT)} imports {name}"
        for f in files
        for name in sorted(imports(f))
        if any(name == bad or name.startswith(f"{bad}.") for bad in forbidden)
    ]


@pytest.mark.parametrize(
    ("folder", "forbidden"),
    [
        ("datamodules", ("idapt_pl", "cli", "gymnasium", "mujoco")),
        ("idapt_pl", ("cli",)),
        ("idapt_pl/nets", ("lightning", "datamodules", "idapt_pl.modules", "idapt_pl.envs")),
        ("idapt_pl/losses.py", ("lightning", "datamodules", "idapt_pl.modules", "idapt_pl.nets")),
        (
            "idapt_pl/modules",
            ("idapt_pl.envs", "idapt_pl.tasks", "idapt_pl.effects", "idapt_pl.worlds", "idapt_pl.rl"),
        ),
        ("idapt_pl/envs", ("idapt_pl.modules", "lightning", "torch")),
        ("idapt_pl/diagnosis", ("idapt_pl.modules", "idapt_pl.report", "idapt_pl.tasks", "lightning", "torch")),
        ("idapt_pl/estimation", ("idapt_pl.diagnosis", "idapt_pl.image_diagnosis", "idapt_pl.effects", "mujoco")),
        ("idapt_pl/effects", ("idapt_pl.tasks", "idapt_pl.envs", "lightning", "torch")),
    ],
)
def test_imports_point_one_way(folder, forbidden):
    assert offenders(folder, *forbidden) == []


def test_the_import_check_sees_what_it_should():
    assert offenders("cli/fit.py", "idapt_pl"), "the check finds nothing at all"


def names_used(path):
    """Every identifier, attribute and string constant of a file."""
    used = set()
    for node in ast.walk(ast.parse(path.read_text())):
        used |= {getattr(node, k) for k in ("id", "attr", "name", "arg") if isinstance(getattr(node, k, None), str)}
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            used.add(node.value)
    return used


def test_only_evaluation_and_references_reach_the_targets_reward():
    users = {str(f.relative_to(ROOT)) for f in FILES if "rewarded_target" in names_used(f)}
    assert users == {
        "idapt_pl/evaluation/evaluation.py",
        "idapt_pl/evaluation/paired.py",
        "idapt_pl/baselines/oracle.py",
        "idapt_pl/worlds.py",
        "cli/evaluate.py",
    }


def test_the_teacher_knows_no_target():
    forbidden = {"rewarded_target", "blind_target", "target_domain", "BlindTarget"}
    for name in ("stages/distillation.py", "rl/experts.py", "modules/imitation.py"):
        assert not forbidden & names_used(ROOT / "idapt_pl" / name)


def test_what_looks_for_effects_knows_no_target_but_its_recordings():
    forbidden = {"rewarded_target", "blind_target", "target_domain", "BlindTarget", "rewards"}
    files = list((ROOT / "idapt_pl/image_diagnosis").glob("*.py"))
    assert len(files) > 4
    assert [f.name for f in files if forbidden & names_used(f)] == []


def test_algorithm_1_branches_on_no_stage_name():
    stages = {"state_predictor", "visual", "dynamics", "policy", "source_policy"}
    for node in ast.walk(ast.parse((ROOT / "idapt_pl/grounding.py").read_text())):
        if isinstance(node, ast.Compare):
            constants = {c.value for c in ast.walk(node) if isinstance(c, ast.Constant) and isinstance(c.value, str)}
            assert not constants & stages


def test_only_stage_py_uses_a_trainer_in_the_library():
    for f in FILES:
        if f.is_relative_to(ROOT / "idapt_pl") and f.name != "stage.py":
            calls = {n.attr for n in ast.walk(ast.parse(f.read_text())) if isinstance(n, ast.Attribute)}
            assert "Trainer" not in calls, f"{f.relative_to(ROOT)} makes a Trainer"
