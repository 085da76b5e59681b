"""FMUs and their fits in plain text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from greybox.base.units import format_unit
from greybox.show.sentences.estimation import MISFIT_HEADS, to_misfit_cells
from greybox.show.sentences.registry import renders
from greybox.show.sentences.wording import format_table, format_with_std

if TYPE_CHECKING:
    from greybox.estimation.result_parts import Estimate, Misfit
    from greybox.extensions.fmu.effects import FmuDiscovery, FmuWithEffects
    from greybox.extensions.fmu.plant import FmuPlant


@renders("FmuPlant")
def write_plant(plant: FmuPlant) -> str:
    """Its kind, signals and parameters."""
    parameters = [
        [v.label, f"{v.start:.6g}", format_unit(v.unit) or "-", "initial state" if v.is_initial else v.description]
        for v in plant.fmu.parameters
    ]
    return "\n".join(
        [
            f"{plant.fmu.title}: FMI {plant.fmu.fmi_version}, {plant.fmu.kind}",
            f"  inputs: {', '.join(v.name for v in plant.inputs) or 'none'}",
            f"  outputs: {', '.join(v.name for v in plant.outputs)}",
            *format_table(["parameter", "value", "unit", ""], parameters),
        ]
    )


@renders("FmuWithEffects")
def write_effect_fit(result: FmuWithEffects) -> str:
    """The same of an FMU with effects."""
    failed = f", {result.prepared.failures} of them failed" if result.prepared.failures else ""
    agreement = (
        "agrees with its linearised response" if result.agrees else "does not agree with its linearised response yet"
    )
    title = f"{result.plant.title} + {' + '.join(result.effects)}: the FMU {agreement} after {result.runs} runs{failed}"
    return "\n".join([title, "", *_tables(result.parameters, result.misfits, result.validation)])


@renders("FmuDiscovery")
def write_discovery(result: FmuDiscovery) -> str:
    """The FMU alone, the answer, and the FMU with the effects of the answer."""
    parts = [str(result.prepared.fit)]
    response = result.prepared.local.response
    if response is None and result.prepared.fit.model.inputs:
        parts.append("No effect at an input was tried: no linear response to the inputs could be found.")
    elif response is not None:
        share = min(response.explained.values())
        parts.append(f"Effects at inputs are seen through a linear response that follows {share:.1%} of the FMU's.")
    parts.append(str(result.discovery))
    if result.with_effects is not None:
        parts.append(str(result.with_effects))
    return "\n\n".join([*parts, f"{result.runs} runs of the FMU in all"])


def _tables(
    parameters: Mapping[str, Estimate], misfits: Mapping[str, Misfit], validation: Mapping[str, Misfit]
) -> list[str]:
    rows = []
    for name, e in parameters.items():
        low, high = e.interval or (float("nan"), float("nan"))
        note = "at its bound" if e.at_bound else "" if e.determined else "not determined"
        rows.append(
            [name, format_with_std(e.value, e.std or 0.0), format_unit(e.unit) or "-", f"{low:.5g} .. {high:.5g}", note]
        )
    lines = format_table(["parameter", "value", "unit", "95 % interval", ""], rows)
    for title, group in (("estimation", misfits), ("validation", validation)):
        if group:
            cells = [[name, *to_misfit_cells(m)] for name, m in group.items()]
            lines = [*lines, "", *format_table([f"output, {title}", *MISFIT_HEADS], cells)]
    return list(lines)
