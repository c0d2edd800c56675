"""`idapt doctor` finds what works and says how to cure what does not."""

import json
import os
import re

import pytest

from cli import doctor
from cli.doctor import Check


def test_the_backend_that_these_tests_render_with_renders():
    check = doctor.check_rendering(os.environ["MUJOCO_GL"])
    assert check.status == "ok" and re.fullmatch(r"\d+ frames/s at 100 pixels", check.found), check


def test_a_backend_that_does_not_render_fails_with_a_cure():
    check = doctor.check_rendering("none")
    assert check.status == "fail" and "apt-get install" in check.cure


@pytest.mark.parametrize(
    ("rendering", "told", "code"), [("ok fail", "ok warn", 0), ("fail ok", "warn ok", 0), ("fail fail", "fail fail", 1)]
)
def test_one_backend_that_renders_is_enough(monkeypatch, capsys, rendering, told, code):
    results = dict(zip(doctor.BACKENDS, rendering.split(), strict=True))
    monkeypatch.setattr(doctor, "check_rendering", lambda backend: Check(f"rendering {backend}", results[backend], ""))
    assert doctor.main(["--json"]) == code
    checks = {c["name"]: c for c in json.loads(capsys.readouterr().out)}
    assert [checks[f"rendering {backend}"]["status"] for backend in doctor.BACKENDS] == told.split()
    assert {"Python", "torch", "mujoco", "GPU", "free disk"} <= checks.keys()


def test_a_package_outside_its_range_is_a_warning_and_a_missing_one_a_failure(monkeypatch):
    def version(name):
        if name == "mujoco":
            raise doctor.metadata.PackageNotFoundError
        return {"torch": "1.0"}.get(name, installed(name))

    installed = doctor.metadata.version
    monkeypatch.setattr(doctor.metadata, "version", version)
    checks = {c.name: c for c in doctor.check_packages()}
    assert (checks["torch"].status, checks["mujoco"].status, checks["numpy"].status) == ("warn", "fail", "ok")
    assert checks["mujoco"].cure.startswith("pip install 'mujoco==") and checks["torch"].found.startswith("1.0, known")
