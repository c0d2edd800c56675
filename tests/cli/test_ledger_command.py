"""`idapt ledger`: the target interactions of a run, checked against its files and restored from them."""

import json
import shutil

import pytest

from cli.main import main
from idapt_pl.files import read_json


@pytest.fixture
def run(finished_run, tmp_path):
    return shutil.copytree(finished_run, tmp_path / "run")


def ledger(run, capsys, *options):
    code = main(["ledger", "--run", str(run), *options])
    return code, capsys.readouterr()


def test_a_table_by_step_and_purpose_and_the_methods_total(run, capsys):
    code, printed = ledger(run, capsys)
    kept = json.loads((run / "ledger.json").read_text())
    assert code == 0 and printed.err == ""
    lines = printed.out.splitlines()
    assert len(lines) == len(kept["entries"]) + 2 and lines[-1].split()[-1] == str(kept["training_total"])
    assert "evaluation of direct transfer" in printed.out


def test_as_json(run, capsys):
    code, printed = ledger(run, capsys, "--json")
    kept = read_json(run / "ledger.json")
    assert (code, json.loads(printed.out)) == (0, {"run": str(run), **kept, "disagreements": []})


def test_each_disagreement_is_a_line_until_it_is_repaired(run, capsys, caplog):
    caplog.set_level("INFO")
    before = (run / "ledger.json").read_bytes()
    content = read_json(run / "ledger.json")
    content["entries"][0]["count"] += 1
    content["entries"].append({"step": 9, "purpose": "training", "count": 50})
    (run / "ledger.json").write_text(json.dumps(content))
    code, printed = ledger(run, capsys)
    assert code == 1 and len(printed.err.splitlines()) == 2
    assert "step 9, training: the ledger says 50, no file holds them" in printed.err
    code, printed = ledger(run, capsys, "--json")
    assert code == 1 and len(json.loads(printed.out)["disagreements"]) == 2
    code, printed = ledger(run, capsys, "--repair")
    assert code == 0 and (run / "ledger.json").read_bytes() == before
    assert sum("corrected by the run's files: step" in record for record in caplog.messages) == 2
    assert ledger(run, capsys)[0] == 0


@pytest.mark.parametrize("content", [None, "", "{", '{"entries": [{"step": 0}]}'])
def test_a_lost_or_damaged_ledger_comes_back_from_the_files(run, content, capsys, caplog):
    caplog.set_level("INFO")
    before = (run / "ledger.json").read_bytes()
    (run / "ledger.json").unlink()
    if content is not None:
        (run / "ledger.json").write_text(content)
    code, printed = ledger(run, capsys)
    assert code == 0 and printed.out and (run / "ledger.json").read_bytes() == before
    assert [m.partition("corrected by ")[2] for m in caplog.messages] == [
        f"the run's files: it is {'missing' if content is None else 'damaged'}, and is made anew"
    ]


@pytest.mark.parametrize(
    "command", [["fit", "--config", "{}/config.yaml"], ["evaluate", "--run", "{}", "--episodes", "1"]]
)
def test_fit_and_evaluate_bring_it_back_too(run, command, capsys):
    before = json.loads((run / "ledger.json").read_text())["entries"]
    (run / "ledger.json").unlink()
    assert main([c.format(run) for c in command]) == 0
    after = json.loads((run / "ledger.json").read_text())["entries"]
    assert [e for e in after if e["step"] >= 0] == before
    assert ledger(run, capsys)[0] == 0


def test_a_recording_that_cannot_be_read_is_named_and_nothing_is_repaired_from_it(run, capsys):
    before = (run / "ledger.json").read_bytes()
    (run / "step_01/target.h5").write_bytes(b"short")
    for options in ((), ("--repair",)):
        code, printed = ledger(run, capsys, *options)
        assert code == 1 and f"{run / 'step_01/target.h5'}: cannot be used" in printed.err
        assert "Traceback" not in printed.err and (run / "ledger.json").read_bytes() == before
