"""The text of the demonstration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from greybox.rendering.discovery import conclusion_text
from greybox.rendering.registry import renders
from greybox.rendering.tables import format_table, format_with_std
from greybox.units import format_unit

if TYPE_CHECKING:
    from greybox.demo import Demo
    from greybox.result import Estimate

HEAD = ("parameter", "true", "start", "plain model", "extended model", "deviation", "unit")


@renders("Demo")
def demo_text(demo: Demo) -> str:
    """Parameters and true values, the missing effect, the errors before and after, the best model, the state space."""
    gaps = [
        f"  {output}: rms error on the validation record {gap.before:.3g} -> {gap.after:.3g} {format_unit(gap.unit)}"
        + (f" (noise {gap.floor:.3g})" if gap.is_floor_known else "")
        for output, gap in demo.discovery.holdout.items()
    ]
    best = map(str, demo.comparison.verdict[:1])
    return "\n".join(
        [constants_table(demo), "", conclusion_text(demo.discovery), *gaps, "", *best, "", str(demo.plant)]
    )


def constants_table(demo: Demo) -> str:
    """Each parameter with its true value: of the plain model, and of the extended model."""
    rows = []
    for name, truth in demo.truth.items():
        estimate, before = demo.fit.parameters.get(name), demo.plain.parameters.get(name)
        rows.append(
            [
                name,
                f"{truth:.5g}",
                f"{demo.start[name]:.4g}" if name in demo.start else "",
                format_estimate(before),
                format_estimate(estimate),
                f"{abs(demo.deviations[name]):.1f} std" if estimate else "",
                format_unit(estimate.unit) if estimate else "",
            ]
        )
    return "\n".join(format_table(HEAD, rows))


def format_estimate(estimate: Estimate | None) -> str:
    """``value +- std``; empty where a model lacks the parameter."""
    return "" if estimate is None else format_with_std(estimate.value, estimate.std or 0.0)


def demo_answer(demo: Demo, folder: Path) -> str:
    """What `greybox demo` prints: the results, the files, and the commands that repeat it."""
    setup, (first, second) = demo.setup, demo.records
    known = " ".join(f"--fix {name}={demo.fit.parameters[name].value:g}" for name in setup.known)
    noise = " ".join(f"--noise {name}={std:g}" for name, std in setup.noise.items())
    arguments = f"{setup.model} {first} --validate {second} {known} {noise} --at-rest"
    return "\n".join(
        [
            "",
            demo.fit.provenance.equations,
            "",
            str(demo),
            "",
            f"files in {folder} (computed in {demo.seconds:.1f} s):",
            *(f"  {path.name:20s} {what}" for path, what in demo.files.items()),
            "",
            "to repeat the demonstration step by step:",
            f"  greybox fit {arguments}",
            f"  greybox discover {arguments}",
            f"  greybox export {folder / 'fit.json'} --to control",
        ]
    )
