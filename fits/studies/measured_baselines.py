"""How far do linear black boxes come on two measured records, and what does physics add?

Data: the silverbox (Wigren, Schoukens 2013) and the cascaded tanks (Schoukens, Mattsson, Wigren, Noel 2016), not part of this project;
give the folder that holds both:

    python -m fits.studies.measured_baselines FOLDER [--output docs/studies]

with ``silverbox/`` (``train_multisine.csv``, ``test_multisine.csv``, ``test_arrow.csv``) and ``cascaded_tanks/`` (``train.csv``,
``test.csv``). ARX, ARMAX and output error, each chosen by its own scan within the training record, and physical models, all fitted to
the training records alone; free-run errors on the test records without their first 50 rows. Writes its part of `docs/studies/real_data.md`.

What to expect: on the silverbox output error is at the published error of linear models on all three records, and so is a linear
physical model, with fewer numbers; a hardening spring takes away 95 % of the error. On the tanks linear black boxes are near the
published linear model and better than Torricelli's law alone; with overflow at both tanks physics passes them, and with a curved
reading of the level too it leaves a third of their error.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import greybox as gb
from fits import data_and_docs
from fits.papers.paper_page import Say, markdown
from fits.studies.real_page import write as write_part
from models.cascaded_tanks import cascaded_tanks
from models.silverbox import silverbox

SKIP = 50  # rows of a test record that tell the initial state and are not judged
SILVERBOX = ("silverbox/train_multisine.csv", "silverbox/test_multisine.csv", "silverbox/test_arrow.csv")
TANKS = ("cascaded_tanks/train.csv", "cascaded_tanks/test.csv")
KNOWN_ARROW = 32000  # rows of the arrow record whose amplitude the training record covers
PUBLISHED_SILVERBOX = {"multisine": 6.96e-3, "arrow": 14.4e-3, "arrow, first part": 6.58e-3}  # V, linear models
PUBLISHED_TANKS = {"test": 0.588}  # V
# 1/s: at most what runs over within a sampling time; beyond, an edge is an edge and the record shows no difference.
SPILLING = {"ko": (0.0, 1.0), "lower_overflow.ko": (0.0, 1.0)}
BEGIN = {"ko": 0.1, "edge": 12.0, "lower_overflow.ko": 0.1, "lower_overflow.edge": 9.9}  # 1/s, V
SCANNED = 8000  # rows of the silverbox that a scan fits, and as many that judge
SCANS: Mapping[str, Mapping[str, object]] = {
    "arx": {"na": range(1, 5), "nb": range(1, 5), "focus": ("prediction", "simulation")},
    "armax": {"na": (2, 3), "nb": (2, 3), "nc": (1, 2, 3)},
    "output error": {"nb": range(1, 4), "nf": range(1, 4)},
}


@dataclass(frozen=True)
class Row:
    """One model: its structure, how many numbers it has, its free-run errors in volt by record, and whether it is physical."""

    structure: str
    numbers: int
    errors: Mapping[str, float]
    physical: bool = False


def silverbox_records(folder: Path) -> tuple[gb.Experiment, dict[str, gb.Experiment]]:
    """The training record, and the test records by name. The generator is band-limited."""
    train, multisine, arrow = (gb.read_csv(folder / name, silverbox, hold="band-limited") for name in SILVERBOX)
    return train, {"multisine": multisine, "arrow": arrow, "arrow, first part": arrow.window(0, KNOWN_ARROW)}


def tank_records(folder: Path) -> tuple[gb.Experiment, dict[str, gb.Experiment]]:
    """The training record, and the test record by name."""
    train, test = (gb.read_csv(folder / name, cascaded_tanks) for name in TANKS)
    return train, {"test": test}


def silverbox_rows(train: gb.Experiment, tests: Mapping[str, gb.Experiment]) -> list[Row]:
    """Black boxes by a scan within the training record, then the linear and the hardening physical model."""
    scanned, judge = train.window(0, SCANNED), train.window(SCANNED, 2 * SCANNED)
    rows = []
    for kind, orders in SCANS.items():
        scan = gb.blackbox.scan_structures(scanned, kind, validation=judge, skip=SKIP, nk=(0, 1), offset=True, **orders)
        rows.append(black(gb.blackbox.scan_structures(train, kind, **scan.chosen.orders).best, tests))
    linear = silverbox + gb.effect("input_offset")
    hardening = linear + gb.effect("cubic_stiffness") + gb.effect("quadratic_stiffness")
    return rows + [grey(gb.fit(model, train), tests) for model in (linear, hardening)]


def tank_rows(train: gb.Experiment, tests: Mapping[str, gb.Experiment]) -> list[Row]:
    """Black boxes by their best scan, then Torricelli's law with more and more of what the rig does."""
    scans = gb.blackbox.best_black_boxes(train, kinds=tuple(SCANS))
    overflowing = (cascaded_tanks + gb.effect("upper_overflow") + gb.effect("lower_overflow")).bound(**SPILLING)
    overflowing = overflowing.start(**BEGIN)
    models = (cascaded_tanks, overflowing, overflowing + gb.effect("reading_curve"))
    rows = [black(scan.best, tests) for scan in scans.values()]
    return rows + [grey(gb.fit(model, train), tests) for model in models]


def black(model: gb.blackbox.PolynomialModel, tests: Mapping[str, gb.Experiment]) -> Row:
    """A black box judged; its initial state comes from the rows that do not count."""
    errors = {}
    for name, record in tests.items():
        error = (record.outputs["y"] - model.simulate(record, rows=SKIP)["y"])[SKIP:]
        errors[name] = float(np.sqrt(np.mean(error**2)))
    return Row(model.label, model.parameters, errors)


def grey(fit: gb.Fit, tests: Mapping[str, gb.Experiment]) -> Row:
    """A physical model judged in the same way."""
    errors = {name: gb.validate(fit.model, record, skip=SKIP).misfit["y"].rmse for name, record in tests.items()}
    return Row(fit.model.title, len(fit.uncertainty.free), errors, physical=True)


def verdict(silver: Sequence[Row], tanks: Sequence[Row]) -> None:
    """Black boxes are where the literature's linear models are, and physics with the right effects is far below."""
    *boxes, linear, hardening = silver
    for name, published in PUBLISHED_SILVERBOX.items():
        for row in boxes:
            assert 0.97 < row.errors[name] / published < 1.05, (row.structure, name)
        best = min(row.errors[name] for row in boxes)
        assert linear.errors[name] < 1.02 * best and linear.numbers < boxes[-1].numbers
        assert hardening.errors[name] < 0.06 * best, name
    *boxes, torricelli, overflowing, curved = tanks
    errors = [row.errors["test"] for row in boxes]
    assert all(0.9 < e / PUBLISHED_TANKS["test"] < 1.15 for e in errors)
    assert torricelli.errors["test"] > max(errors)  # honest: physics without overflow is worse than any black box
    assert overflowing.errors["test"] < min(errors) and curved.errors["test"] < 0.4 * min(errors)


def write(silver: Sequence[Row], tanks: Sequence[Row], folder: Path) -> Path:
    """The part of the page."""
    text = [
        "## Linear black boxes and physics on measured records",
        "Written by `python -m fits.studies.measured_baselines`: fitted to the training records, free runs over the test records without"
        " their first 50 rows. Black boxes are chosen by a scan within the training record.",
        "### Silverbox, mV",
        _table(silver, PUBLISHED_SILVERBOX, 1e3),
        "Output error and the linear physical model reach the linear model of the literature. The"
        " hardening spring is what no linear model has.",
        "### Cascaded tanks, V",
        _table(tanks, PUBLISHED_TANKS, 1.0),
        "Torricelli's law alone is worse than any black box, because the tanks overflow.",
    ]
    return write_part(folder, "4 linear black boxes", text)


def _table(rows: Sequence[Row], published: Mapping[str, float], factor: float) -> str:
    def cells(errors: Mapping[str, float]) -> list[str]:
        return [f"{factor * errors[name]:.3g}" for name in published]

    lines = [[row.structure, "grey" if row.physical else "black", str(row.numbers), *cells(row.errors)] for row in rows]
    lines.append(["published, linear", "", "", *cells(published)])
    return markdown(["model", "box", "numbers", *published], lines)


def main(data: Path, docs: Path, say: Say = sys.stdout.write) -> None:
    """The whole study; half a minute."""
    silver = silverbox_rows(*silverbox_records(data))
    tanks = tank_rows(*tank_records(data))
    path = write(silver, tanks, docs)
    say(path.read_text(encoding="utf-8"))
    verdict(silver, tanks)


if __name__ == "__main__":
    main(*data_and_docs("studies.measured_baselines", *SILVERBOX, *TANKS))
