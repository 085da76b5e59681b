"""What does the plain silverbox model lack? Nothing is told but the plain model.

Data: the silverbox records (Wigren, Schoukens 2013), not part of this project; give their folder:
``python -m fits.silverbox_discovery FOLDER`` with ``train_multisine.csv``, ``test_multisine.csv`` and ``test_arrow.csv``.

Learnt from 3000 rows of the training record, chosen by 20 000 others, refitted to all rows up to the end of those, and then run once
over the test records. Expected: what the input does between samples comes first, as it outweighs every nonlinearity after the cubic
spring; then the cubic spring, an offset of the input (or a load: the same data). Damping that grows with the amplitude belongs to the set
that the records alone prefer, and not to what such rigs usually have; of it only the family can be named. The quadratic spring and the
dampings of the table are added by hand.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import greybox as gb
from fits.papers.paper_page import markdown
from fits.studies.real_page import arguments, verdict_text, write
from greybox.discovery.findings import DiscoveryCode
from models.silverbox import silverbox

FILES = ("train_multisine.csv", "test_multisine.csv", "test_arrow.csv")
LEARN, REFIT, JUDGE = (0, 3000), (0, 40_000), (20_000, 40_000)
WITHOUT_EXTRAPOLATION, SKIP = 32_000, 50  # rows of the arrow; rows left out of the errors
HOLDS = {"zero": "held", "first": "straight", "band-limited": "band-limited"}
SPRINGS = ("cubic_stiffness", "quadratic_stiffness", "input_offset")
DAMPING = ("quadratic_damping", "cubic_damping", "displacement_damping")
# Free-run errors in V: multisine, whole arrow, arrow without extrapolation.
GOAL, PUBLISHED = (0.31e-3, 0.40e-3, 0.32e-3), (0.30e-3, 0.26e-3, 0.26e-3)
# Members of the family differ by less than this share of the error on the multisine.
ALIKE = 0.1
Errors = tuple[float, ...]
Say = Callable[[str], object]


@dataclass(frozen=True)
class Study:
    """The discovery, and errors on the three test records: by hold, and by form of the damping."""

    discovery: gb.discovery.Discovery
    linear: Errors
    holds: Mapping[str, Errors]
    springs: Errors
    forms: Mapping[str, Errors]

    @property
    def named(self) -> set[str]:
        """Every effect in the final model."""
        return {e.name for e in self.discovery.best.model.effects}


def study(folder: Path, say: Say = lambda _: None) -> Study:
    """Discover, go on, then judge the members of the family."""
    train, *tests = (gb.read_csv(folder / name, silverbox) for name in FILES)
    tests.append(tests[1].window(0, WITHOUT_EXTRAPOLATION))

    def errors(model: gb.Model, hold: str = "zero") -> Errors:
        return tuple(gb.validate(model, t.with_hold(hold), skip=SKIP).misfit["y"].rmse for t in tests)  # type: ignore[arg-type]

    discovery = gb.discover(silverbox, train.window(*LEARN), validation=train.window(*JUDGE), on_message=say)
    springs = _with(silverbox, SPRINGS)
    holds = {}
    for hold in HOLDS:
        part = train.window(*LEARN).with_hold(hold)  # type: ignore[arg-type]
        holds[hold] = errors(gb.fit(springs, part).model, hold)
    whole, moving = train.window(*REFIT), springs + gb.effect("band_limited_input")
    forms = {}
    for form in DAMPING:
        forms[form] = errors(gb.fit(moving + gb.effect(form), whole).model)
        say(f"{form}: {_millivolt(forms[form])} mV")
    linear = gb.fit(silverbox + gb.effect("band_limited_input"), train.window(*LEARN))
    return Study(discovery, errors(linear.model), holds, errors(gb.fit(moving, whole).model), forms)


def _with(model: gb.Model, names: tuple[str, ...]) -> gb.Model:
    for name in names:
        model = model + gb.effect(name)
    return model


def _millivolt(values: Errors) -> list[str]:
    return [f"{1e3 * v:.3f}" for v in values]


def section(s: Study) -> list[str]:
    """The page's part."""
    head = ["model", "multisine, mV", "arrow, mV", "arrow without extrapolation, mV"]
    rows = [["linear, input band-limited", *_millivolt(s.linear)]]
    rows += [[f"cubic and quadratic spring, offset; input {HOLDS[h]}", *_millivolt(e)] for h, e in s.holds.items()]
    rows += [["the same, more rows, input band-limited", *_millivolt(s.springs)]]
    rows += [[f"and `{form}`", *_millivolt(e)] for form, e in s.forms.items()]
    rows += [["*published, best*", *_millivolt(PUBLISHED)]]
    return [
        "## Silverbox: an electronic circuit",
        verdict_text(s.discovery),
        "Errors on the test records, which took no part in choosing effects or constants:",
        markdown(head, rows),
        "The members of the damping family differ by less than the"
        " spread between the records: these do not tell the member. Dampings and the quadratic spring of this table were added by hand.",
    ]


def verdict(s: Study) -> None:
    """The input first, then spring and offset, by the records alone a damping too; errors within the goal on all three test records."""
    first = [e.name for e in s.discovery.best.model.effects][:2]
    assert first == ["band_limited_input", "cubic_stiffness"], first
    assert s.named & {"input_offset", "constant_load"}, s.named
    usual = next((f for f in s.discovery.conclusion if f.code is DiscoveryCode.USUAL_FIRST), None)
    by_records = s.named if usual is None else set(usual.values["by_records"][0].split(" + "))
    assert by_records & set(DAMPING), by_records
    assert s.holds["band-limited"][0] < s.holds["first"][0] / 2 < s.holds["zero"][0] / 4
    for values in s.forms.values():
        assert all(v <= most for v, most in zip(values, GOAL, strict=True)), values
        assert all(v < plain for v, plain in zip(values, s.springs, strict=True)), values
    multisine = [values[0] for values in s.forms.values()]
    assert max(multisine) <= (1 + ALIKE) * min(multisine)


if __name__ == "__main__":
    records, docs = arguments("silverbox_discovery", *FILES)
    done = study(records, lambda line: sys.stdout.write(f"{line}\n"))
    write(docs, "1 silverbox", section(done))
    verdict(done)
