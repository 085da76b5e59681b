"""The page of the demonstration: the story in the order in which it was told, then the fit in all detail."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from greybox.demo.story import EXTENDED, HIDDEN, MODEL, PLAIN, Demo, written
from greybox.figures.scale import scaled
from greybox.reports import Page, page_of
from greybox.reports.axes import axes, band, line, rms
from greybox.reports.page import Block, Code, Figure, Section, Table, Text, Tone
from greybox.result import Trace
from greybox.units import tidy

OUTPUT = "x"


def page_of_demo(told: Demo, *, command: str = "") -> Page:
    """The report of a demonstration; ``command`` is what was typed, for repeating it."""
    discovery = told.discovery
    off = told.plain.validation[OUTPUT].noise_ratio
    said = [
        f"The model alone misses the record that was not used by {off:.0f} times the noise. {discovery.story}",
        f"Its constants come back to within {max(abs(d) for d in told.deviations.values()):.1f} standard deviations of the rig's.",
        *(f"{text}." for text in told.comparison.verdict[:1]),
    ]
    sections = [
        Section("gap", "The gap, before and after", list(_gap(told))),
        Section("found", "What was found", list(_found(told))),
        Section("black", "Beside black boxes", [_black(told)]),
        Section("plant", "The state space", [Code(str(told.plant), "About rest, for a controller design")]),
        *page_of(discovery.best, command=command).sections,
    ]
    question = f"A simulated {MODEL} hides {HIDDEN} from its model. Does the program find out, and what does it gain?"
    tone: Tone = "good" if discovery.verdict == "named" else "caution"
    return Page("A hidden effect, found and named", question, Text(said, tone), sections, "demo")


def _gap(told: Demo) -> Iterator[Block]:
    before, after = told.plain.validation_traces[0], told.fit.validation_traces[0]
    yield _residual(before, after, told.fit.model.title, told.fit.noise[OUTPUT])
    rows = [
        [f"{o} [{tidy(g.unit)}]", f"{g.before:.3g}", f"{g.after:.3g}", f"{g.floor:.3g}", f"{100 * g.closed:.1f} %"]
        for o, g in told.discovery.gap.items()
    ]
    head = ["output", "model alone", "with the effect", "noise", "closed"]
    yield Table("Root mean square misfit of the free run on the record that was not used", head, rows)


def _residual(before: Trace, after: Trace, title: str, noise: float) -> Figure:
    left, right = before.residual(OUTPUT), after.residual(OUTPUT)
    factor, unit = scaled("m", left)
    words = (
        f"Residual of {OUTPUT} over {float(np.ptp(before.time)):.3g} s: the model alone leaves {factor * rms(left):.3g} {unit} rms,"
        f" with the effect {factor * rms(right):.3g} {unit}, which is noise."
    )
    return Figure(
        "gap", "What the models leave of the record that was not used; the band is two standard deviations of the noise.", words,
        [line(before.time, factor * left, PLAIN, "--residual"), line(after.time, factor * right, title, "--model")],
        {**axes("time [s]", f"residual of {OUTPUT} [{unit}]"), "shapes": [band(2 * factor * noise)]},
    )  # fmt: skip


def _found(told: Demo) -> Iterator[Block]:
    rows = []
    for name, truth in told.truth.items():
        plain, best = told.plain.parameters.get(name), told.fit.parameters.get(name)
        cells = [written(e).replace("+-", "±") for e in (plain, best)]
        rows.append([name, f"{truth:.5g}", *cells, tidy(best.unit) if best else ""])
    yield Table("Constants beside those of the rig", ["constant", "rig", PLAIN, EXTENDED, "unit"], rows)
    ranking = [
        [" + ".join(r.effects) or PLAIN, f"{r.misfit:.4g}", f"{r.behind:.4g}"] for r in told.discovery.ranking[:8]
    ]
    note = "A candidate more than ten behind explains the record clearly worse."
    yield Table(
        "Candidates on the fitted record, best first",
        ["candidate", "misfit over noise", "behind the best"],
        ranking,
        note,
    )


def _black(told: Demo) -> Table:
    entries = sorted(told.comparison.entries, key=lambda e: e.validation[OUTPUT].rmse)
    rows = [
        [e.name, e.kind, ", ".join(e.structure.values()), str(e.parameters), f"{e.validation[OUTPUT].rmse:.3g}",
         f"{e.validation[OUTPUT].best_fit_percent:.2f} %"]
        for e in entries
    ]  # fmt: skip
    head = ["model", "box", "structure", "numbers", "free run [m]", "best fit"]
    return Table(f"Errors of {OUTPUT} on the record that no model saw", head, rows)
