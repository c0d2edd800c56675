"""What may know what, and how long and how named things may be: read from the source, without importing it."""

import ast
import functools
import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("cli", "idapt_pl", "datamodules")
FILES = sorted(p for package in PACKAGES for p in (ROOT / package).rglob("*.py"))


parsed_text = functools.cache(ast.parse)


def parsed(path: Path) -> ast.Module:
    return parsed_text(path.read_text())


def imports(path: Path) -> set[str]:
    """Dotted names of all modules that a file imports: in functions and for type checkers too."""
    names = set()
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import; these checks read absolute ones"
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


# --- imports point one way ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Rule:
    """A folder or file that must not import some modules, or anything of them; its own modules are no offence."""

    where: str
    forbidden: str
    reason: str


RULES = (
    Rule("datamodules", "idapt_pl cli gymnasium mujoco", "data are read without a simulator or a method"),
    Rule("idapt_pl", "cli", "a library knows no command line"),
    Rule(
        "idapt_pl/losses.py",
        "idapt_pl datamodules cli lightning numpy mujoco gymnasium",
        "losses are equations: tensors in, tensors out",
    ),
    Rule("idapt_pl/files.py", "idapt_pl cli torch", "how files are written depends on nothing in them"),
    Rule("datamodules/atomic.py", "idapt_pl datamodules cli torch numpy", "likewise"),
    Rule(
        "datamodules/safe_yaml.py",
        "idapt_pl datamodules cli torch numpy",
        "YAML is read first of all",
    ),
    Rule("idapt_pl/memory.py", "idapt_pl datamodules cli torch", "it runs before torch is loaded"),
    Rule(
        "idapt_pl/nets",
        "lightning datamodules idapt_pl.modules idapt_pl.envs",
        "networks are plain torch, whoever trains them on whatever data",
    ),
    Rule(
        "idapt_pl/modules",
        "idapt_pl.envs idapt_pl.tasks idapt_pl.effects idapt_pl.worlds idapt_pl.rl idapt_pl.stages idapt_pl.grounding",
        "what is trained knows batches, not the worlds and stages that they come from",
    ),
    Rule(
        "idapt_pl/effects",
        "idapt_pl.tasks idapt_pl.envs torch lightning datamodules",
        "an effect is a change of any model",
    ),
    Rule("idapt_pl/rendering", "torch lightning", "processes that render start in a second, without torch"),
    Rule("idapt_pl/tasks", "torch lightning idapt_pl.envs idapt_pl.modules", "a task is a model, a reward and an end"),
    Rule("idapt_pl/envs", "torch lightning idapt_pl.modules", "environments simulate; what learns comes from outside"),
    Rule("idapt_pl/estimation", "idapt_pl datamodules mujoco lightning", "mathematics that all searches share"),
    Rule(
        "idapt_pl/prediction",
        "torch lightning idapt_pl.modules idapt_pl.nets idapt_pl.envs idapt_pl.tasks idapt_pl.diagnosis",
        "what a model predicts does not hang on who asks",
    ),
    Rule(
        "idapt_pl/diagnosis",
        "torch lightning idapt_pl.modules idapt_pl.nets idapt_pl.envs idapt_pl.tasks idapt_pl.rl idapt_pl.stages "
        "idapt_pl.report",
        "recordings and a model are enough to diagnose: nothing is trained, no page is drawn",
    ),
    Rule(
        "idapt_pl/image_diagnosis",
        "idapt_pl.grounding idapt_pl.stages idapt_pl.report",
        "it takes G and P as they are, from a run or elsewhere",
    ),
    Rule(
        "idapt_pl/rl",
        "idapt_pl.stages idapt_pl.grounding idapt_pl.evaluation idapt_pl.report",
        "acting and experience serve any algorithm",
    ),
    Rule(
        "idapt_pl/stages",
        "idapt_pl.grounding idapt_pl.report",
        "stages are steps of algorithms, which put them in order",
    ),
    Rule("idapt_pl/evaluation", "idapt_pl.grounding", "what measures a run does not drive it"),
    Rule("idapt_pl/report", "idapt_pl.grounding", "a page is made from a run's files, by idapt_pl.run"),
)


def within(name: str, modules: str) -> bool:
    """Whether a dotted name is one of the modules, or of them."""
    return any(name == m or name.startswith(f"{m}.") for m in modules.split())


def offenders(rule: Rule, root: Path = ROOT) -> list[str]:
    """``file imports module`` for each import that a rule forbids; the longest name that tells it."""
    folder = root / rule.where
    files = [folder] if folder.is_file() else sorted(folder.rglob("*.py"))
    assert files, f"{folder} has no Python files"
    own = ".".join(Path(rule.where).with_suffix("").parts)
    found = []
    for f in files:
        modules = {n for n in imports(f) if within(n, rule.forbidden) and not within(n, own)}
        roots = {n for n in modules if not any(m != n and n.startswith(f"{m}.") for m in modules)}
        found += [f"{f.relative_to(root)} imports {n}" for n in sorted(roots)]
    return found


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.where)
def test_imports_point_one_way(rule):
    assert offenders(rule) == [], f"{rule.where} must not know {rule.forbidden}: {rule.reason}"


def test_each_rule_is_stated_once():
    assert len({rule.where for rule in RULES}) == len(RULES) and all(rule.reason for rule in RULES)


def planted(folder: Path, files: dict[str, str]) -> Path:
    """A tree of files."""
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


@pytest.mark.parametrize(
    "text",
    [
        "import idapt_pl.modules",
        "from idapt_pl import modules",
        "from idapt_pl.modules import visual",
        "from idapt_pl.modules.visual import VisualTransformation",
        "def f():\n    import idapt_pl.modules.visual",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from idapt_pl.modules import visual",
    ],
)
def test_forbidden_imports_are_found_wherever_they_stand(tmp_path, text):
    planted(tmp_path, {"idapt_pl/nets/fine.py": "import torch\n", "idapt_pl/nets/bad.py": text})
    found = offenders(Rule("idapt_pl/nets", "idapt_pl.modules", "a test"), tmp_path)
    assert len(found) == 1 and found[0].startswith("idapt_pl/nets/bad.py imports idapt_pl.modules")


def test_a_package_may_import_itself(tmp_path):
    planted(tmp_path, {"idapt_pl/estimation/a.py": "from idapt_pl.estimation import b\n"})
    rule = Rule("idapt_pl/estimation", "idapt_pl", "a test")
    assert offenders(rule, tmp_path) == []
    planted(tmp_path, {"idapt_pl/estimation/b.py": "from idapt_pl import tasks\n"})
    assert offenders(rule, tmp_path) == ["idapt_pl/estimation/b.py imports idapt_pl"]


# --- the packages in layers -----------------------------------------------------------------------------


def package_graph(root: Path = ROOT, package: str = "idapt_pl") -> dict[str, set[str]]:
    """Which packages (and modules at the root) of a package, a dotted name, import which of the others."""
    graph: dict[str, set[str]] = {}
    folder, depth = root.joinpath(*package.split(".")), package.count(".") + 1
    for f in sorted(folder.rglob("*.py")):
        own = f.relative_to(folder).with_suffix("").parts[0]
        if own == "__init__":
            continue
        graph.setdefault(own, set())
        graph[own] |= {n.split(".")[depth] for n in imports(f) if n.startswith(f"{package}.")} - {own}
    return {own: others & graph.keys() for own, others in graph.items()}


def reached(graph: dict[str, set[str]], start: str) -> set[str]:
    """What ``start`` imports, and what that imports, and so on."""
    found: set[str] = set()
    ahead = set(graph[start])
    while ahead:
        found |= ahead
        ahead = {n for a in ahead for n in graph[a]} - found
    return found


def cycles(graph: dict[str, set[str]]) -> set[frozenset[str]]:
    """Sets of packages that import each other, directly or by way of others in the set."""
    reach = {p: reached(graph, p) for p in graph}
    return {frozenset(q for q in graph if q in reach[p] and p in reach[q]) for p in graph if p in reach[p]}


def test_no_packages_import_each_other():
    assert cycles(package_graph()) == set()


def test_planted_cycles_are_found(tmp_path):
    files = {
        "idapt_pl/a/x.py": "from idapt_pl.b import y",
        "idapt_pl/b/y.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from idapt_pl import c",
        "idapt_pl/c.py": "def f():\n    import idapt_pl.a.x",
        "idapt_pl/d.py": "import idapt_pl.a",
    }
    graph = package_graph(planted(tmp_path, files))
    assert graph == {"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}
    assert cycles(graph) == {frozenset("abc")}
    (tmp_path / "idapt_pl/c.py").write_text("")
    assert cycles(package_graph(tmp_path)) == set()


def test_diagnosis_reaches_nothing_that_learns():
    reach = {"prediction", "effects", "estimation", "files", "ranges", "usable_cores"}
    assert reached(package_graph(), "diagnosis") - {"diagnosis"} <= reach


def test_a_diagnosis_is_made_in_layers():
    layers = ["candidates", "state", "rounds", "laws", "answer"]
    graph = package_graph(package="idapt_pl.diagnosis")
    for k, layer in enumerate(layers):
        assert graph[layer] <= {*layers[:k]}, f"{layer} is told of by what comes after it"


ROOT_MODULES = {
    "grounding", "run", "run_config", "stage", "worlds", "losses", "files", "checkpoints", "memory", "cores",
    "health", "ranges", "usable_cores",
}  # fmt: skip


def test_modules_at_the_root_are_those_that_all_packages_share():
    found = {f.stem for f in (ROOT / "idapt_pl").glob("*.py")} - {"__init__"}
    assert found == ROOT_MODULES, "a module belongs to a package, unless it is on the list here"


# --- names ----------------------------------------------------------------------------------------------


def public_names(path: Path) -> Iterator[str]:
    """Functions, classes and constants that a module defines at its top level; each logs to a ``log`` of its own."""
    for node in parsed(path).body:
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        names = [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.append(node.name)
        yield from (n for n in names if not n.startswith("_") and n != "log")


def clashes(root: Path, package: str) -> dict[str, list[str]]:
    """Names that several modules of a package define, and where."""
    where = defaultdict(list)
    for f in sorted((root / package).rglob("*.py")):
        for name in public_names(f):
            where[name].append(str(f.relative_to(root)))
    return {name: files for name, files in where.items() if len(files) > 1}


@pytest.mark.parametrize("package", ["idapt_pl", "datamodules"])
def test_a_name_means_one_thing(package):
    found = clashes(ROOT, package)
    told = "; ".join(f"{name}: {', '.join(files)}" for name, files in found.items())
    assert not found, f"rename one of each, so that it says what it is: {told}"


def test_planted_clashes_are_found(tmp_path):
    files = {
        "p/a.py": "import logging\nlog = logging.getLogger()\nONE, _TWO = 1, 2\ndef f(): ...\n",
        "p/q/b.py": "log = None\nONE: int = 1\n_TWO = 2\nclass f: ...\ndef g(): ONE = 3\n",
    }
    assert clashes(planted(tmp_path, files), "p") == {"ONE": ["p/a.py", "p/q/b.py"], "f": ["p/a.py", "p/q/b.py"]}


MODULE = re.compile(r"\b(?:idapt_pl|datamodules)(?:\.[A-Za-z]\w*)+")
PAGE = re.compile(r"\bdocs/[\w./-]+\.md\b")


def bound_names(path: Path) -> set[str]:
    """What a module defines or imports at its top level, for type checkers alone or not."""
    body = parsed(path).body
    body = [*body, *(n for block in body if isinstance(block, ast.If) for n in block.body)]
    nodes = [n for n in body if isinstance(n, ast.Import | ast.ImportFrom)]
    imported = {alias.asname or alias.name for n in nodes for alias in n.names}
    return imported | set(public_names(path)) | {"log"}


def exists(name: str, root: Path = ROOT) -> bool:
    """Whether a dotted name is a module, or something that a module has."""
    path, parts = root, name.split(".")
    while parts and (path / parts[0]).is_dir():
        path /= parts.pop(0)
    if parts and (path / f"{parts[0]}.py").is_file():
        path /= f"{parts.pop(0)}.py"
    else:
        path /= "__init__.py"
    return not parts or parts[0] in bound_names(path)


def missing(path: Path) -> list[str]:
    """Modules and pages that a file names and that do not exist, each with its line."""
    wrong = []
    for number, line in enumerate(path.read_text().splitlines(), 1):
        names = [n for n in MODULE.findall(line) if not exists(n)]
        names += [page for page in PAGE.findall(line) if not (ROOT / page).is_file()]
        wrong += [f"{path}:{number}: {name}" for name in names]
    return wrong


@pytest.mark.parametrize("folder", [*PACKAGES, "tests", "benchmarks", "docs/guide", "docs/reference"])
def test_modules_and_pages_that_texts_name_exist(folder):
    files = [f for kind in ("py", "md") for f in sorted((ROOT / folder).rglob(f"*.{kind}")) if f != Path(__file__)]
    assert files and [told for f in files for told in missing(f)] == []


def test_planted_names_of_nothing_are_found(tmp_path):
    text = (
        "idapt_pl.files.write_json idapt_pl.rendering docs/index.md\nidapt_pl.gone idapt_pl.files.gone docs/gone.md\n"
    )
    found = missing(planted(tmp_path, {"a.md": text}) / "a.md")
    assert [told.split(": ")[1] for told in found] == ["idapt_pl.gone", "idapt_pl.files.gone", "docs/gone.md"]


# --- sizes ----------------------------------------------------------------------------------------------

FILE_LINES, FUNCTION_LINES = 400, 60
LONGER = {
    "idapt_pl/modules/visual.py: __init__": 63,
}
"""What is longer still, and how long; the list may only shrink, and so may the numbers."""


def too_long(path: Path, root: Path = ROOT) -> dict[str, int]:
    """The file, and functions in it, that are longer than they may be, and their lines."""
    name, tree = str(path.relative_to(root)), parsed(path)
    lines = {name: len(path.read_text().splitlines())} if len(path.read_text().splitlines()) > FILE_LINES else {}
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            length = node.end_lineno - node.lineno + 1
            if length > FUNCTION_LINES:
                lines[f"{name}: {node.name}"] = length
    return lines


def test_files_and_functions_can_be_overlooked():
    found = {what: lines for f in FILES for what, lines in too_long(f).items()}
    assert found == LONGER, (
        f"at most {FILE_LINES} lines a file, {FUNCTION_LINES} a function; split, or shorten the list"
    )


def test_planted_lengths_are_found(tmp_path):
    body = "    x = 1\n" * FUNCTION_LINES
    folder = planted(tmp_path, {"a.py": f"def f():\n{body}", "b.py": f"def f():\n{body[10:]}", "c.py": "x = 1\n" * 401})
    assert too_long(folder / "a.py", folder) == {"a.py: f": FUNCTION_LINES + 1}
    assert too_long(folder / "b.py", folder) == {} and too_long(folder / "c.py", folder) == {"c.py": 401}


# --- Algorithm 1 ----------------------------------------------------------------------------------------


def test_algorithm_1_branches_on_no_stage_name():
    stages = {"state_predictor", "visual", "dynamics", "policy", "source_policy"}
    for node in ast.walk(parsed(ROOT / "idapt_pl/grounding.py")):
        if isinstance(node, ast.Compare):
            constants = {c.value for c in ast.walk(node) if isinstance(c, ast.Constant) and isinstance(c.value, str)}
            assert not constants & stages


def test_only_stage_py_uses_a_trainer_in_the_library():
    for f in FILES:
        if f.is_relative_to(ROOT / "idapt_pl") and f.name != "stage.py":
            calls = {n.attr for n in ast.walk(parsed(f)) if isinstance(n, ast.Attribute)}
            assert "Trainer" not in calls, f"{f.relative_to(ROOT)} makes a Trainer"
