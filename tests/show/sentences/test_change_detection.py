"""Golden texts of a change detection."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from greybox.base.values import Check, Finding, Severity
from greybox.extensions.changes.document import change_tables, constant_row, is_determined, merge_not_seen, p_text
from greybox.extensions.changes.result import ChangeCode, ChangeRule, ConstantChange, PopulationConstant
from greybox.show.sentences import sentence
from greybox.show.sentences.wording import spread_text

C = ChangeCode
MOVED = {"before": 5.0, "after": 4.5, "unit": "N/m", "low": -0.6, "high": -0.4}
GOLDEN = [
    (
        Finding(
            C.NOTHING_CHANGED,
            values={
                "constants": ["K", "B"],
                "widest": "B",
                "rate": 0.01,
                "smallest": 0.02,
                "before": 0.5,
                "unit": "N s/m",
            },
        ),
        "nothing has changed: each constant is what it was, within what the records can tell; a change of 4 % in B, the least certain,"
        " would have been seen. One healthy machine in 100 is called changed",
    ),
    (
        Finding(
            C.NOTHING_CHANGED,
            values={"constants": ["c"], "widest": "c", "rate": 0.01, "smallest": 0.02, "before": 0.0, "unit": "N"},
        ),
        "nothing has changed: c is what it was, within what the records can tell; a change of 0.02 N in c, the least certain, would have"
        " been seen. One healthy machine in 100 is called changed",
    ),
    (
        Finding(C.CONSTANT_MOVED, subject="K", values=MOVED),
        "K has fallen by 10.0 %, from 5 to 4.5 N/m (95 % interval of the change: 8.0 % to 12.0 %)",
    ),
    (
        Finding(C.COMBINATION_MOVED, values={"combination": {"K": 1.0, "M": -0.7}, "p": 0.0004}),
        "the constants have changed, and the records do not tell which: K and M together, none of them clearly by itself (p = 0.0004); a"
        " record that moves the machine more, or differently, will tell",
    ),
    (
        Finding(
            C.EFFECT_APPEARED,
            subject="coulomb_friction",
            values={"site": "force", "grade": "established", "parameters": {"F": {"value": 0.5, "unit": "N"}}},
        ),
        "an effect has appeared: coulomb_friction in force (F = 0.5 N), established; what is said of the constants holds with it",
    ),
    (
        Finding(C.NOISE_GREW, subject="x", values={"ratio": 2.0}),
        "the noise of output x has grown to 2.00 times what it was, and is as random as before: look at the sensor and its wiring",
    ),
    (
        Finding(C.UNEXPLAINED, subject="x", values={"ratio": 1.5}),
        "the model no longer describes output x: its residual is 1.50 times what the fit left, or no longer random, and no change of"
        " constants explains it. No effect of the catalogue is established; greybox discover with more records of today goes on from here",
    ),
    (
        Finding(C.CANNOT_TELL, values={"constants": ["B"]}),
        "the records cannot tell: B could have changed by half unnoticed. Nothing else has changed",
    ),
    (
        Finding(C.DIFFERENT_INPUT, values={"constants": ["K"], "p": 0.002}),
        "the records cannot tell: K would differ (p = 0.002), but the model lacks something already in the fit, and these records do"
        " not show by how much its constants vary where nothing has changed. Repeat the input of the fit, give three records or more, or"
        " find what the model lacks with greybox discover",
    ),
    (
        Finding(C.FIT_FAILED, values={"status": "it overflowed"}),
        "the records cannot tell: the model could not be fitted to them (it overflowed). Look at the record first, with greybox check",
    ),
    (
        Finding(C.CONSTANT_NOT_SEEN, subject="B", values={"share": None, "limit": 0.5}),
        "B: the records do not determine it (limit 50 %); take a record that excites it, greybox design says which",
    ),
    (
        Finding(C.CONSTANT_NOT_SEEN, subject="B", values={"share": 0.8, "limit": 0.5}),
        "B: only a change of 80 % or more would show (limit 50 %); take a record that excites it, greybox design says which",
    ),
    (
        Finding(C.CONSTANT_NOT_SEEN, subject="B and K", values={"share": None, "limit": 0.5, "names": ["B", "K"]}),
        "the records do not determine B and K (limit 50 %); take a record that excites them, greybox design says which",
    ),
    (
        Finding(C.CONSTANT_AT_BOUND, subject="B", values={"value": 0.0}),
        "B was stopped by its bound at 0: it is not compared; widen its bounds in the model and fit again",
    ),
    (
        Finding(C.MODEL_LACKS_SOMETHING),
        "the fit left more than noise: its constants depend on what the input does, and the size of the residual was not compared; greybox"
        " discover looks for what the model lacks",
    ),
    (
        Finding(C.BEYOND_MISSING_PART, subject="c", values={"constants": ["c"], "ratio": 1.64}),
        "c has changed by 1.6 times the most that what the model lacks could do to it, by what the fits leave and how the two motions"
        " differ in size; a smaller change could not be told from that under another motion",
    ),
    (
        Finding(C.SCATTER_ALLOWED, subject="K", values={"factor": 3.0, "degrees": 14}),
        "the constants scatter from piece to piece of the records by 3 times what their intervals say (K, 14 degrees of freedom); the"
        " comparison allows for that",
    ),
    (
        Finding(C.SCATTER_ALLOWED, subject="K", values={"factor": 3.0, "degrees": 4, "over": "records"}),
        "the constants scatter from record to record, where nothing has changed, by 3 times what their intervals say (K, 4 degrees of"
        " freedom); the comparison allows for that",
    ),
    (
        Finding(C.SCATTER_ALLOWED, subject="K", values={"factor": 0.5, "degrees": 7, "over": "paired_pieces"}),
        "the constants scatter in their change from piece to piece of the records by 0.5 times what their intervals say (K, 7 degrees of"
        " freedom); the comparison allows for that",
    ),
    (
        Finding(C.SPLIT_FOR_VALIDATION, subject="today"),
        "today is the only record of today: an effect was looked for in its first half and judged on its second; a further record, with"
        " --validate, is the better judge",
    ),
    (
        Finding(C.SAME_RECORD, subject="a.csv"),
        "a.csv is one of the records of the fit itself: it is no record of today",
    ),
    (
        Finding(
            C.MACHINE_FALLS_OUT,
            subject="m7",
            values={
                "constant": "K",
                "value": 4.0,
                "unit": "N/m",
                "mean": 5.0,
                "spread": 0.02,
                "relative": True,
                "p": 1e-5,
            },
        ),
        "m7 falls out: K is 4 N/m, and 5 N/m in the others, which differ by 2 % (standard deviation; p < 0.0001)",
    ),
    (
        Finding(C.MACHINE_NOT_FITTED, subject="m7", values={"status": "it overflowed"}),
        "m7 is left out: the model could not be fitted to its records (it overflowed)",
    ),
    (
        Finding(C.MACHINES_ALIKE, values={"machines": 8, "outside": 1, "spreads": {"K": [0.02, "N/m", True]}}),
        "the other 8 machines belong together; from one to the next they differ in K by 2 % (standard deviation)",
    ),
    (
        Finding(C.MACHINES_ALIKE, values={"machines": 8, "outside": 0, "spreads": {"K": [0.0, "N/m", True]}}),
        "all 8 machines belong together; from one to the next they do not differ visibly",
    ),
    (
        Finding(
            C.CHANGE_POINT,
            subject="K",
            values={"record": "day 9", "number": 9, "before": 5.0, "after": 5.5, "unit": "N/m", "p": 0.0002},
        ),
        "K rises with record 9 (day 9) by 10 %, from 5 to 5.5 N/m (p = 0.0002)",
    ),
    (
        Finding(C.RECORD_NOT_FITTED, subject="day 3", values={"status": "it overflowed"}),
        "record day 3 is left out: the model could not be fitted to it (it overflowed)",
    ),
    (
        Finding(C.NO_CHANGE_POINT, values={"records": 12}),
        "no change point in 12 records: what differs between them is chance",
    ),
    (
        Check.at_least(ChangeRule.CONSTANTS_AS_BEFORE, 0.2, 0.007),
        "the constants are as before: p = 0.2, limit 0.007, passed",
    ),
    (
        Check.at_least(ChangeRule.RESIDUAL_AS_LARGE, 1e-9, 0.001, "x"),
        "the residual of x is as large as before: p < 0.0001, limit 0.001, failed",
    ),
    (
        Check.at_least(ChangeRule.RESIDUAL_AS_WHITE, 0.5, 0.001, "x"),
        "the residual of x is as white as before: p = 0.5, limit 0.001, passed",
    ),
]


@pytest.mark.parametrize(("item", "text"), GOLDEN)
def test_a_change_detection_says(item: Finding | Check, text: str) -> None:
    assert sentence(item) == text


def test_every_code_is_here() -> None:
    codes = {item.code if isinstance(item, Finding) else item.rule for item, _ in GOLDEN}
    assert codes == {*ChangeCode, *ChangeRule}


def test_a_constant_as_a_row() -> None:
    change = ConstantChange(5.0, 4.5, "N/m", (-0.6, -0.4), 1e-7, True, 0.1)
    assert constant_row("K", change) == [
        "K",
        "5.000 N/m",
        "4.500 N/m",
        "-10.0 %",
        "-12.0 % to -8.0 %",
        "< 0.0001",
        "changed",
    ]
    assert constant_row("K", ConstantChange(5.0, 4.5, "N/m", None, None, False, None))[2] == "not determined"
    assert (p_text(None), p_text(0.031), spread_text(0.5, "N", False)) == ("", "0.031", "0.5 N")


def test_constants_that_are_not_determined_share_one_warning_and_have_no_huge_figures():
    values = {"share": None, "limit": 0.5}
    unseen = [Finding(C.CONSTANT_NOT_SEEN, Severity.WARNING, name, values) for name in ("C", "h", "s")]
    other = Finding(C.MODEL_LACKS_SOMETHING, Severity.WARNING)
    first, last = merge_not_seen([unseen[0], other, *unseen[1:]])
    assert first.values["names"] == ["C", "h", "s"] and last is other
    assert merge_not_seen([unseen[0], other]) == [unseen[0], other]
    wide = SimpleNamespace(before=2.0, after=2.1, interval=(-1e300, 1e304), unit="J/K", p=0.5, moved=False)
    assert constant_row("C", wide)[3:5] == ["not determined", ""]
    narrow = SimpleNamespace(before=2.0, after=2.1, interval=(-0.1, 0.3), unit="J/K", p=0.5, moved=False)
    assert is_determined(narrow) and not is_determined(wide)


def test_machines_are_told_to_as_many_digits_as_their_records_tell() -> None:
    constants = {
        "Kf": {"value": 1.39309, "std": 1.8e-4},
        "La": {"value": 5.005e-4, "std": 1.4e-6},
        "K": {"value": 1.0, "std": None},
    }
    machine = SimpleNamespace(name="no1", constants=constants, outlying=("Kf",))
    known = {
        "Kf": PopulationConstant(1.393121, (1.392891, 1.393349), "N/A", 1.2e-4, True),
        "La": PopulationConstant(5e-4, (4.99e-4, 5.01e-4), "H", 0.0, True),
        "K": PopulationConstant(1.0, (0.9, 1.1), "N/m", 0.0, True),
    }
    survey = SimpleNamespace(constants={}, population=known, machines=(machine,), change_points=())
    population, machines = change_tables(survey)
    assert population.rows[0] == ["Kf", "1.39312 N/A", "1.39289 to 1.39335", "0.012 %"]
    assert machines.head == ["machine", "Kf [N/A]", "La [H]", "K [N/m]", "falls out in"]
    assert machines.rows == [["no1", "1.39309 +- 0.00018", "5.005e-04 +- 1.4e-06", "open", "Kf"]]
