"""Every benchmark can be started: what it imports is there."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_every_benchmark_imports_what_there_is():
    names = sorted(p.stem for p in (ROOT / "benchmarks").glob("*.py") if p.stem != "__init__")
    assert len(names) > 40
    program = f"""
import importlib, sys
sys.path[:0] = [{str(ROOT)!r}, {str(ROOT / "benchmarks")!r}]
broken = []
for name in {names!r}:
    try:
        importlib.import_module("benchmarks." + name)
    except ModuleNotFoundError as error:
        if error.name in ("stable_baselines3", "cma", "pybullet", "pygame"):
            continue  # extras
        broken.append((name, repr(error)))
    except ImportError as error:
        broken.append((name, repr(error)))
print(broken)
assert not broken
"""
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
