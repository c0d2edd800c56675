"""The ledger as a file that several processes write to, and that may be damaged."""

import json
import os
import subprocess
import sys

import pytest
from conftest import ROOT

from idapt_pl.envs.ledger import Ledger
from idapt_pl.files import DamagedFile

MANY = """
import sys
from pathlib import Path
from idapt_pl.envs.ledger import Ledger
ledger = Ledger(Path(sys.argv[1]))
print("ready", flush=True)
sys.stdin.readline()
for step in range(30):
    ledger.enter(step, f"evaluation by {sys.argv[2]}", step)
"""


@pytest.fixture
def ledger(tmp_path):
    return Ledger(tmp_path / "ledger.json")


@pytest.mark.slow
def test_entries_of_processes_that_write_at_the_same_time_are_all_kept(ledger):
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", MANY, str(ledger.path), name],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment,
        )
        for name in "abc"
    ]  # fmt: skip
    assert [p.stdout.readline() for p in processes] == ["ready\n"] * 3
    for p in processes:  # all at once
        p.stdin.write("\n")
        p.stdin.flush()
    assert [p.wait() for p in processes] == [0] * 3
    assert len(ledger.entries) == 90


def test_what_another_process_entered_is_seen_and_kept(ledger):
    other = Ledger(ledger.path)
    ledger.enter(0, "training", 60)
    other.enter(0, "evaluation", 500)
    ledger.enter(1, "training", 20)
    assert other.training_total == 80 and len(other.entries) == 3


def test_entries_stand_by_step_whatever_the_order_in_which_they_were_made(ledger):
    for step, purpose in ((-1, "evaluation of x"), (1, "training"), (0, "evaluation"), (0, "training")):
        ledger.enter(step, purpose, 1)
    made = [(e["step"], e["purpose"]) for e in ledger.entries]
    assert made == [(0, "training"), (0, "evaluation"), (1, "training"), (-1, "evaluation of x")]


@pytest.mark.parametrize("content", ["", "{", "[]", '{"entries": 3}', '{"entries": [{"step": 1}]}', '{"total": 1}'])
def test_a_damaged_ledger_is_named_with_the_command_that_repairs_it(ledger, content):
    ledger.path.write_text(content)
    for use in (lambda: ledger.entries, lambda: ledger.training_total, lambda: ledger.enter(0, "training", 1)):
        with pytest.raises(DamagedFile, match=r"ledger\.json: cannot be used .*idapt ledger --run .* --repair"):
            use()
    assert ledger.path.read_text() == content and ledger.damaged
    ledger.change(lambda entries: [*entries, {"step": 0, "purpose": "training", "count": 1}], restore=True)
    assert json.loads(ledger.path.read_text())["training_total"] == 1 and not ledger.damaged
