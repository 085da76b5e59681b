"""What does Torricelli's law lack on the cascaded tanks? Nothing is told but the plain model.

Data: the cascaded tanks records (Schoukens, Mattsson, Wigren, Noel 2016), not part of this project; give their folder:
``python -m fits.cascaded_tanks_discovery FOLDER`` with ``train.csv`` and ``test.csv``.

Learnt from the first 700 rows of the training record, chosen by the rest of it, refitted to all of it, and then run once over the
test record. Expected: the upper tank runs over and a part of that water reaches the lower one, the lower one runs over too, and the
reading is not proportional to the level. Which law bends the reading is an ambiguity set: a threshold of the pump, a sensor that
ends or has play, and the laws of outflow imitate one another.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import greybox as gb
from fits.papers.paper_page import markdown
from fits.studies.real_page import arguments, verdict_text, write
from models.cascaded_tanks import cascaded_tanks

FILES = ("train.csv", "test.csv")
LEARN, SKIP = 700, 50  # rows; rows left out of the errors
NEEDED = {"upper_overflow", "lower_overflow", "reading_curve"}
# Further effects that imitate one another, tried beside the final model.
SET = ("input_offset", "input_dead_zone", "backlash", "sensor_saturation", "sensor_lag", "transport_delay")
GOAL, PUBLISHED = 0.23, 0.18  # V
# Models whose error on the training record is within this share of the best one's cannot be told apart.
ALIKE = 0.1
# A model that holds another one follows the training record at least as well: this many times its error would be no optimum.
NESTED = 1.01
Say = Callable[[str], object]


@dataclass(frozen=True)
class Study:
    """The discovery, the refit to the whole training record, and each member of the ambiguity set added:
    errors (V) on the training and the test record, by name."""

    discovery: gb.discovery.Discovery
    refitted: gb.Fit
    base: gb.Fit
    beside: Mapping[str, tuple[float, float]]
    without: Mapping[str, tuple[float, float]]

    @property
    def named(self) -> set[str]:
        """Every effect in the final model."""
        return {e.name for e in self.refitted.model.effects}


def study(folder: Path, say: Say = lambda _: None) -> Study:
    """Discover, go on, refit, then put in and take out what may imitate each other."""
    train, test = (gb.read_csv(folder / name, cascaded_tanks) for name in FILES)
    learn, judge = train.window(0, LEARN), train.window(LEARN, train.rows)
    discovery = gb.discover(cascaded_tanks, learn, validation=judge, on_message=say)
    refitted, base = (_refit(model, train, test) for model in (discovery.best.model, cascaded_tanks))
    beside, without = {}, {}
    for name in SET:
        if name not in [e.name for e in refitted.model.effects]:
            beside[name] = _errors(gb.discovery.try_effect(refitted, name, validation=test).larger)
            say(f"with {name}: {beside[name]}")
    for name in [e.name for e in refitted.model.effects]:
        without[name] = _errors(gb.discovery.drop_effect(refitted, name, validation=test).smaller)
        say(f"without {name}: {without[name]}")
    return Study(discovery, refitted, base, beside, without)


def _refit(model: gb.Model, train: gb.Experiment, test: gb.Experiment) -> gb.Fit:
    return gb.fit(model, train, validation=test, skip=SKIP)


def _errors(fit: gb.Fit) -> tuple[float, float]:
    return fit.misfit["y"].rmse, fit.validation.misfit["y"].rmse


def section(s: Study) -> list[str]:
    """The page's part."""
    rows = [["Torricelli alone", *_shown(_errors(s.base))]]
    rows += [[f"**{', '.join(f'`{e.name}`' for e in s.refitted.model.effects)}**", *_shown(_errors(s.refitted))]]
    rows += [[f"without `{name}`", *_shown(e)] for name, e in s.without.items()]
    reference = _errors(s.refitted)[0]
    rows += [[f"with `{name}` besides", *_shown(e)] for name, e in s.beside.items()]
    rows += [["*published, best*", "", f"{PUBLISHED:.2f}"]]
    like = [f"`{n}`" for n, e in s.beside.items() if (1 - ALIKE) * reference <= e[0] <= (1 + ALIKE) * reference]
    constants = [
        [f"`{name}`", f"{q.value:.4g}", "" if q.interval is None else "{:.3g} to {:.3g}".format(*q.interval), q.unit]
        for name, q in s.refitted.parameters.items()
    ]
    return [
        "## Cascaded tanks",
        verdict_text(s.discovery),
        "Errors of the free run, refitted to the whole training record; the test record took no part in any choice:",
        markdown(["model", "training, V", "test, V"], rows),
        f"Beside what was found, {', '.join(like) or 'none of them'} change the training record by less than"
        f" {100 * ALIKE:.0f} %: with the reading curve they form an ambiguity set at this one output."
        " Known levels read at standstill would tell the reading from the rest.",
        markdown(["constant", "value", "95 % interval", "unit"], constants),
        "`k2` only sets the unit of the upper level, and `full` where the reading curve is"
        " anchored. A rate of overflow at its bound means an edge as sharp as the samples can show.",
    ]


def _shown(values: tuple[float, float]) -> list[str]:
    return [f"{v:.3f}" for v in values]


def verdict(s: Study) -> None:
    """Both tanks run over, the reading is curved; the error on the test record is within the goal."""
    assert s.named >= NEEDED, s.named
    assert s.refitted.validation.misfit["y"].rmse <= GOAL < 0.6 < s.base.validation.misfit["y"].rmse
    assert 0 < s.refitted.parameters["share"].value < 1
    for name in NEEDED:  # none of them can be spared
        assert s.without[name][0] > 1.2 * s.refitted.misfit["y"].rmse, name
    for name, (training, _) in s.beside.items():
        assert training < NESTED * s.refitted.misfit["y"].rmse, name


if __name__ == "__main__":
    records, docs = arguments("cascaded_tanks_discovery", *FILES)
    done = study(records, lambda line: sys.stdout.write(f"{line}\n"))
    write(docs, "3 cascaded tanks", section(done))
    verdict(done)
