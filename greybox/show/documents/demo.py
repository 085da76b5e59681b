"""The demonstration: the whole way from the first fit to the controller's matrices."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from greybox.base import format_unit
from greybox.base.document import Block, BulletList, Document, FigureBlock, Later, Paragraphs, Section, TableBlock
from greybox.estimation.result_parts import Estimate
from greybox.show.documents import comparison, discovery, fit, linearisation, tables
from greybox.show.figures.discovery import plot_holdout_error
from greybox.show.sentences.wording import format_with_std, join_names

if TYPE_CHECKING:
    from greybox.shell.demonstration import Demo


def describe_demo(demo: Demo, *, command: str = "") -> Document:
    """What is said of the demonstration; ``command`` is what was typed."""
    return Document(
        "Demonstration: from the first fit to the controller",
        Later(_brief, demo),
        "A simulated micro-motion actuator has an effect that its model lacks. Does the program detect and identify the effect, and"
        " does the extended model have smaller errors?",
        _verdict(demo),
        Later(_sections, demo, command),
        "demonstration",
        Later(lambda: [FigureBlock(plot_holdout_error(demo.discovery))]),
    )


def _brief(demo: Demo) -> Iterator[Block]:
    """Parameters and true values, the missing effect, the errors before and after, the best model, the state space."""
    yield _parameters(demo)
    yield Paragraphs([demo.discovery.story])
    yield BulletList(discovery.holdout_lines(demo.discovery))
    yield Paragraphs(demo.comparison.verdict[:1])
    yield from demo.plant.describe().brief


def _sections(demo: Demo, command: str) -> Iterator[Section]:
    best, plain = demo.discovery.best, demo.plain
    misfit = tables.misfit_table("Free run on the estimation records", plain.misfit, plain.noise)
    yield Section("plain", "The plain model", [fit.fit_verdict(plain), misfit])
    yield from discovery.discovery_sections(demo.discovery, beside_verdict=True)
    yield Section("truth", "Parameters and true values", [_parameters(demo)])
    yield Section("extended", "The extended model", [tables.typeset_equations(best.model)])
    of_models = demo.comparison
    verdict, models = comparison.comparison_verdict(of_models), comparison.models_table(of_models)
    yield Section("errors", "Errors", [verdict, *comparison.error_blocks(of_models), models])
    yield from linearisation.linear_sections(demo.plant, None)
    yield tables.records_section(best)
    yield tables.fit_provenance_section(best, command)


def _verdict(demo: Demo) -> Paragraphs:
    answer = discovery.discovery_verdict(demo.discovery)
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


def _parameters(demo: Demo) -> TableBlock:
    """Each parameter with its true value: of the plain model, and of the extended model."""
    rows = []
    for name, truth in demo.truth.items():
        estimate, before = demo.fit.parameters.get(name), demo.plain.parameters.get(name)
        rows.append(
            [
                name,
                f"{truth:.5g}",
                f"{demo.start[name]:.4g}" if name in demo.start else "",
                _value(before),
                _value(estimate),
                f"{abs(demo.deviations[name]):.1f} std" if estimate else "",
                format_unit(estimate.unit) if estimate else "",
            ]
        )
    head = ["parameter", "true", "start", "plain model", "extended model", "deviation", "unit"]
    return TableBlock("Start values, estimates and true values", head, rows)


def _value(estimate: Estimate | None) -> str:
    return "" if estimate is None else format_with_std(estimate.value, estimate.std or 0.0)
