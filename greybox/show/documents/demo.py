"""The page of the demonstration: the whole way from the first fit to the controller's matrices."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from greybox.estimation.result_parts import Estimate
from greybox.show.figures.discovery import plot_holdout_error
from greybox.show.figures.figure import typeset_unit
from greybox.show.pages.comparison_page import comparison_verdict, error_blocks, models_table
from greybox.show.pages.discovery_page import discovery_sections, discovery_verdict, extended_name
from greybox.show.pages.equations import typeset_equations
from greybox.show.pages.fit_page import fit_verdict, misfit_table
from greybox.show.pages.linearisation_page import linear_sections
from greybox.show.pages.page import Block, FigureBlock, Page, PageTable, Paragraphs, Section, typeset_number
from greybox.show.pages.provenance import fit_provenance_section, records_section
from greybox.show.sentences.wording import format_number, join_names

if TYPE_CHECKING:
    from greybox.shell.demonstration import Demo


def build_demo_page(demo: Demo, *, command: str = "") -> Page:
    """The page of the demonstration; ``command`` is what was typed."""
    best = demo.discovery.best
    sections = [
        Section(
            "plain",
            "The plain model",
            [
                fit_verdict(demo.plain),
                misfit_table("Free run on the estimation records", demo.plain.misfit, demo.plain.noise),
            ],
        ),
        *discovery_sections(demo.discovery, beside_verdict=True),
        Section("truth", "Parameters and true values", [_parameters(demo)]),
        Section("extended", "The extended model", [typeset_equations(best.model)]),
        Section("errors", "Errors", list(_comparison(demo))),
        *linear_sections(demo.plant, None),
        records_section([*best.traces], [*best.validation.traces], best),
        fit_provenance_section(best, command),
    ]
    evidence = FigureBlock(plot_holdout_error(demo.discovery))
    return Page(
        "Demonstration: from the first fit to the controller",
        "A simulated micro-motion actuator has an effect that its model lacks. Does the program detect and identify the effect, and"
        " does the extended model have smaller errors?",
        _verdict(demo),
        sections,
        "demonstration",
        evidence,
    )


def _verdict(demo: Demo) -> Paragraphs:
    answer = discovery_verdict(demo.discovery)
    output, worst = max(demo.plain.misfit.items(), key=lambda item: item[1].noise_ratio)
    names = [name for name in demo.truth if name in demo.deviations]
    deviation = max((abs(demo.deviations[name]) for name in names), default=0.0)
    items = [
        f"In {output}, the residual of the plain model is {worst.noise_ratio:.3g} times the noise.",
        *answer.items,
        f"Every fitted parameter is within {deviation:.1f} standard deviations of its true value: {join_names(names)}.",
        *demo.comparison.verdict[:1],
    ]
    return Paragraphs(items, answer.tone)


def _comparison(demo: Demo) -> Iterator[Block]:
    yield comparison_verdict(demo.comparison)
    yield from error_blocks(demo.comparison)
    yield models_table(demo.comparison)


def _parameters(demo: Demo) -> PageTable:
    rows = []
    for name, truth in demo.truth.items():
        e, plain = demo.fit.parameters.get(name), demo.plain.parameters.get(name)
        start = format_number(demo.start[name], 4) if name in demo.start else "–"
        deviation = f"{abs(demo.deviations[name]):.1f} std" if name in demo.deviations else ""
        cells = [format_number(truth), start, _value(plain), _value(e), deviation]
        rows.append([name, *map(typeset_number, cells), typeset_unit(e.unit) if e is not None else ""])
    head = ["parameter", "true", "start", "plain model", extended_name(demo.discovery), "deviation", "unit"]
    return PageTable("Start values, estimates and true values", head, rows)


def _value(e: Estimate | None) -> str:
    return "–" if e is None else format_number(e.value) + (f" +- {e.std:.1g}" if e.std is not None else "")
