"""The page of the demonstration: the whole story from the first fit to the controller's matrices."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from greybox.rendering import sentences
from greybox.rendering.result import MISFIT_HEADS, to_misfit_cells
from greybox.reports.equations import typeset_equations
from greybox.reports.fit_parts import verdict as fit_verdict
from greybox.reports.of_comparison import errors, models
from greybox.reports.of_comparison import verdict as comparison_verdict
from greybox.reports.of_discovery import discovery_sections, extended_name
from greybox.reports.of_discovery import verdict as discovery_verdict
from greybox.reports.of_linearisation import linear_sections
from greybox.reports.page import Block, Page, Section, Table, Text
from greybox.reports.provenance import provenance_section
from greybox.reports.records import records_section
from greybox.reports.typography import as_sentence, format_number, join_names, typeset_number, typeset_unit
from greybox.result import Estimate

if TYPE_CHECKING:
    from greybox.demo import Demo


def report_of_demo(demo: Demo, *, command: str = "") -> Page:
    """The page of the demonstration."""
    found = demo.discovery
    best = found.best
    sections = [
        Section("fit", "The model as it was", list(_plain(demo))),
        *discovery_sections(found),
        Section("constants", "The constants beside the truth", [_constants(demo)]),
        Section("model", "The extended model", [typeset_equations(best.model)]),
        Section("errors", "Beside black boxes", list(_beside(demo))),
        *linear_sections(demo.plant, None),
        records_section([*best.traces], [*best.validation.traces], best),
        provenance_section(best, command),
    ]
    question = (
        "A simulated micro-motion actuator has something that its model knows nothing of. Does the program notice, does it name what"
        " is missing, and does that pay?"
    )
    return Page("The whole story on a rig that hides an effect", question, _verdict(demo), sections, "demonstration")


def _verdict(demo: Demo) -> Text:
    found = discovery_verdict(demo.discovery)
    worst = max(demo.plain.misfit.items(), key=lambda item: item[1].noise_ratio)
    first = f"The model as it was misses {worst[0]} by {worst[1].noise_ratio:.3g} times the noise."
    names = [n for n in demo.truth if n in demo.deviations]
    off = max((abs(demo.deviations[n]) for n in names), default=0.0)
    true = f"Every constant of the rig is met within {off:.1f} standard deviations: {join_names(names)}."
    beside = [as_sentence(typeset_number(s)) for s in sentences(demo.comparison.verdict[:1])]
    return Text([first, *found.paragraphs, true, *beside], found.tone)


def _plain(demo: Demo) -> Iterator[Block]:
    yield fit_verdict(demo.plain)
    rows = [[name, *map(typeset_number, to_misfit_cells(m))] for name, m in demo.plain.misfit.items()]
    yield Table("Free run of the plain model on the fitted record", ["output", *MISFIT_HEADS], rows)


def _beside(demo: Demo) -> Iterator[Block]:
    yield comparison_verdict(demo.comparison)
    yield from errors(demo.comparison)
    yield models(demo.comparison)


def _constants(demo: Demo) -> Table:
    rows = []
    for name, truth in demo.truth.items():
        e, before = demo.fit.parameters.get(name), demo.plain.parameters.get(name)
        start = format_number(demo.start[name], 4) if name in demo.start else "–"
        off = f"{abs(demo.deviations[name]):.1f} std" if name in demo.deviations else ""
        cells = [format_number(truth), start, _value(before), _value(e), off]
        rows.append([name, *map(typeset_number, cells), typeset_unit(e.unit) if e is not None else ""])
    head = ["constant", "true", "start of the search", "plain model", extended_name(demo.discovery), "off by", "unit"]
    return Table("What the search began with, what it found, and what is true", head, rows)


def _value(e: Estimate | None) -> str:
    return "–" if e is None else format_number(e.value) + (f" +- {e.std:.1g}" if e.std is not None else "")
