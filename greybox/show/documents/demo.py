"""The demonstration: the whole way from the first fit to the controller's matrices."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from greybox.base import format_unit
from greybox.base.document import Block, Document, EquationList, FigureBlock, Later, Section, TableBlock
from greybox.estimation.result_parts import Estimate
from greybox.show.documents import comparison, discovery, linearisation, tables
from greybox.show.figures.discovery import plot_holdout_error
from greybox.show.sentences.wording import format_with_std

if TYPE_CHECKING:
    from greybox.shell.demonstration import Demo


def describe_demo(demo: Demo, *, command: str = "") -> Document:
    """What is said of the demonstration; ``command`` is what was typed."""
    answer = discovery.discovery_answer(demo.discovery)
    return Document(
        "Demonstration: from the first fit to the controller",
        answer,
        discovery.discovery_tone(demo.discovery),
        Later(lambda: [_parameters(demo)]),
        list(demo.comparison.verdict[:1]),
        Later(_details, demo),
        "A simulated micro-motion actuator has an effect that its model lacks. Does the program detect and identify the effect, and"
        " does the extended model have smaller errors?",
        Later(lambda: [FigureBlock(plot_holdout_error(demo.discovery))]),
        Later(_sections, demo, command),
        "demonstration",
    )


def _details(demo: Demo) -> Iterator[Block]:
    """The equations, the discovery, the errors, the state space."""
    yield EquationList([], demo.fit.provenance.equations)
    for part in (demo.discovery, demo.comparison, demo.plant):
        document = part.describe()
        yield from (*document.table, *document.details)


def _sections(demo: Demo, command: str) -> Iterator[Section]:
    best, plain = demo.discovery.best, demo.plain
    misfit = tables.misfit_table("Free run on the estimation records", plain.misfit)
    yield Section("plain", "The plain model", [plain.describe().verdict, misfit])
    yield from discovery.discovery_sections(demo.discovery, beside_verdict=True)
    yield Section("truth", "Parameters and true values", [_parameters(demo)])
    yield Section("extended", "The extended model", [tables.typeset_equations(best.model)])
    of_models = demo.comparison
    models = comparison.models_table(of_models)
    yield Section("errors", "Errors", [of_models.describe().verdict, *comparison.error_blocks(of_models), models])
    yield from linearisation.linear_sections(demo.plant, None)
    yield tables.records_section(best)
    yield tables.fit_provenance_section(best, command)


def _parameters(demo: Demo) -> TableBlock:
    """Each parameter with its true value: of the plain model, and of the extended model."""
    rows = []
    for name, truth in demo.truth.items():
        estimate, before = demo.fit.parameters.get(name), demo.plain.parameters.get(name)
        rows.append(
            [
                name,
                f"{truth:.5g}",
                _value(before),
                _value(estimate),
                f"{abs(demo.deviations[name]):.1f} std" if estimate else "",
                format_unit(estimate.unit) if estimate else "",
            ]
        )
    head = ["parameter", "true", "plain model", "extended model", "off by", "unit"]
    return TableBlock("Estimates and true values; the start values were 40 % off", head, rows)


def _value(estimate: Estimate | None) -> str:
    return "" if estimate is None else format_with_std(estimate.value, estimate.std or 0.0)
