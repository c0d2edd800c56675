"""Outcomes that a person wrote down."""

import pytest

from idapt_pl.evaluation.told_outcomes import read_told_outcomes

HEADER = "step,outcome,control_steps\n"


def test_successes_are_told_by_yes_and_no_or_one_and_zero(tmp_path):
    path = tmp_path / "seen.csv"
    path.write_text(f"{HEADER}direct, n, 50\n1,y,30\n1,0,50\n\n1,1,20\n1,YES,10\n")
    told = read_told_outcomes(path, success=True)
    assert (told["direct"].mean, told["1"].mean, told["1"].successes) == (0, 0.75, (True, False, True, True))
    assert told["1"].interactions == 110


@pytest.mark.parametrize(
    ("text", "success", "message"),
    [
        ("", False, "expected the columns step,outcome,control_steps and a row"),
        (HEADER, False, "and a row for each episode"),
        ("step,outcome\n1,2\n", False, "expected the columns"),
        (HEADER + "1,2\n", False, "row 2 is 1,2; expected step,outcome"),
        (HEADER + "1,2,3\n1,y,3\n", False, "row 3: the outcome is 'y'; expected a return"),
        (HEADER + "1,nan,3\n", False, "row 2: the outcome is 'nan'"),
        (HEADER + "1,0.5,3\n", True, "expected y or n"),
        (HEADER + "1,2,0\n", False, "control_steps is '0'"),
        (HEADER + "1,2,3.5\n", False, "control_steps is '3.5'"),
        ("\xff\xfe", False, "expected the columns"),
    ],
)
def test_tables_that_make_no_sense_are_named(tmp_path, text, success, message):
    path = tmp_path / "seen.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=rf"seen\.csv: .*{message}"):
        read_told_outcomes(path, success)


def test_a_table_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"seen\.csv: cannot be read"):
        read_told_outcomes(tmp_path / "seen.csv", success=False)
