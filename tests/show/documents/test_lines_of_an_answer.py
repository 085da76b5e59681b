"""A result without --details stands on a screen: the answer first, the rows and notes that say most, in 80 columns."""

from types import SimpleNamespace

import numpy as np
import pytest

import greybox as gb
from greybox.base.document import Document, TableBlock
from greybox.base.values import Finding
from greybox.discovery.decision import Grade, Verdict
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.holdout import HoldoutError
from greybox.discovery.result import RankedCandidate
from greybox.model.parts import Occurrence
from greybox.show import text
from greybox.show.documents.discovery import describe_discovery
from greybox.show.printers.text import MOST_LINES, MOST_NOTES, print_text
from tests.support.first_order import first_order

USUAL = next(iter(Occurrence))
# Below the answer of a command: an empty line, what is typed next with all its options, the files.
BELOW = 7


def effect(name: str, grade: Grade) -> dict:
    constants = {c: {"value": 1.234567e-8, "std": 1e-10, "unit": "N*m/rad"} for c in ("K1", "tau1", "alpha")}
    return {"name": name, "site": "torque", "grade": grade, "parameters": constants}


def error_left(output: str) -> Finding:
    values = {
        "size": 0.00179,
        "after": 0.00179,
        "before": 0.07,
        "unit": "rad",
        "noise_ratio": 42.0,
        "noise": 4e-5,
        "signal": None,
    }
    return Finding(DiscoveryCode.ERROR_LEFT, subject=output, values=values)


NAMES = ("viscoelastic_creep", "coulomb_friction", "sensor_offset", "linear_leak")
CONCLUSIONS = {
    Verdict.COMPLETE: [Finding(DiscoveryCode.NOTHING_MISSING)],
    Verdict.NAMED: [Finding(DiscoveryCode.EFFECT_NAMED, subject=" + ".join(NAMES))],
    Verdict.AMBIGUOUS: [
        Finding(
            DiscoveryCode.EFFECTS_TIED,
            subject=" + ".join(NAMES[:2]),
            values={"share": 0.97, "output": "th", "rivals": [" + ".join(NAMES[1:]), NAMES[3]], "is_simplest": False},
        )
    ],
    Verdict.PARTLY: [
        Finding(
            DiscoveryCode.EFFECTS_ESTABLISHED,
            subject=" + ".join(NAMES),
            values={
                "established": list(NAMES[:2]),
                "others": dict.fromkeys(NAMES[2:], Grade.STAND_IN),
                "left": ["fitted", "judging", "test", "correlated"],
            },
        )
    ],
    Verdict.UNKNOWN: [
        Finding(DiscoveryCode.UNKNOWN_EFFECT),
        Finding(DiscoveryCode.NEAREST_LOOK_ALIKE, subject=" + ".join(NAMES)),
    ],
}


def discovery(verdict: Verdict) -> SimpleNamespace:
    """A discovery with much to say: four effects of three constants, a dozen other sets, long notes."""
    effects = [] if verdict is Verdict.COMPLETE else [effect(name, Grade.STAND_IN) for name in NAMES]
    sets = [
        RankedCandidate((*NAMES[:k], f"effect_number_{k}"), 1.0 + k, float(k), k, USUAL, {"th": 0.01 + k})
        for k in range(12)
    ]
    long = [f"{name}: {'what there is to say of it, ' * 8}" for name in NAMES]
    return SimpleNamespace(
        base=SimpleNamespace(model=SimpleNamespace(title="rig")),
        best=SimpleNamespace(success=True, explains_records=True),
        verdict=verdict,
        conclusion=CONCLUSIONS[verdict],
        effects=effects,
        holdout={"th": HoldoutError(0.07, 0.002, 1e-5, "rad")},
        ranking=[RankedCandidate(NAMES, 1.0, 0.0, 9, USUAL, {"th": 0.002}), *sets] if effects else sets,
        claims=(),
        laws=(),
        findings=(),
        instruments=(),
        next_steps=(),
        not_tried={},
        notes=long,
    )


@pytest.mark.parametrize("verdict", CONCLUSIONS)
def test_a_discovery_of_each_verdict_stands_on_a_screen(verdict: Verdict) -> None:
    answer = discovery(verdict)
    document = describe_discovery(answer)
    document = Document(document.title, document.answer, table=document.table, notes=[*document.notes, *answer.notes])
    lines = print_text(document, details=False, lines=MOST_LINES - BELOW).splitlines()
    assert len(lines) <= MOST_LINES - BELOW and max(map(len, lines)) <= 80
    first = " ".join(" ".join(lines).split())
    assert first.startswith(str(document.answer)), "the answer is whole, and comes first"
    assert any(line.startswith("note: ") for line in lines) and "--details" in first
    # The first table is there; of another at least three rows, or nothing.
    shown = [n for n, table in enumerate(document.table) if any(line.split()[:1] == [table.head[0]] for line in lines)]
    assert shown[0] == 0 and all(
        sum(table.rows[2][0] in line for line in lines) for table in [document.table[n] for n in shown]
    )


@pytest.mark.parametrize(
    ("rows", "notes", "width"), [(0, 9, 1), (3, 3, 3), (40, 0, 1), (40, 9, 2), (5, 9, 4), (1, 1, 30)]
)
def test_what_says_least_gives_way(rows: int, notes: int, width: int) -> None:
    table = TableBlock("t", ["name", "value"], [[f"row {k:2}", str(k)] for k in range(rows)])
    texts = [f"{k} {'word ' * 14 * width}" for k in range(notes)]
    document = Document("rig", "The answer. " * 10, table=[table] if rows else [], notes=texts)
    whole, short = (print_text(document, details=details).splitlines() for details in (True, False))
    assert len(short) <= MOST_LINES or notes == 1  # a single note is whole
    shown = sum(line.startswith("note: ") for line in short)
    assert shown == min(notes, MOST_NOTES) or len(short) > MOST_LINES - 2 * width - 2
    assert sum(line.startswith("note: ") for line in whole) == notes
    # What is shown is the beginning of all, and that something is left out is said.
    for kind in ("note: ", "  row"):
        first, everything = ([line for line in lines if line.startswith(kind)] for lines in (short, whole))
        assert first == everything[: len(first)]
        assert len(first) == len(everything) or any("more" in line and "--details" in line for line in short)


def test_a_result_in_python_stands_on_a_screen_too() -> None:
    rng, time = np.random.default_rng(1), 0.05 * np.arange(200)
    records = [
        gb.Experiment(f"record of a long name {k}", time, {"u": np.sign(np.sin(time))}, {"y": rng.normal(size=200)})
        for k in range(20)
    ]
    options = gb.FitOptions(other_starts=0)
    fit = gb.fit(first_order(), records, noise={"y": 0.01}, per_experiment=["gain"], options=options)
    lines, whole = (text(fit, details=details).splitlines() for details in (None, True))
    assert len(lines) <= MOST_LINES < len(whole) and max(map(len, lines)) <= 80
    assert len(str(fit).splitlines()) <= MOST_LINES
