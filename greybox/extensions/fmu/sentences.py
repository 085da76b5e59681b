"""FMUs and their fits in plain text."""

from __future__ import annotations

from typing import TYPE_CHECKING

from greybox.base.document import REMARK, Block, Details, Facts, Paragraphs, TableBlock
from greybox.base.units import format_unit
from greybox.show.documents.tables import estimates_table, misfit_table
from greybox.show.sentences.registry import renders

if TYPE_CHECKING:
    from greybox.extensions.fmu.effects import FmuDiscovery, FmuWithEffects
    from greybox.extensions.fmu.plant import FmuPlant


@renders("FmuPlant")
def write_plant(plant: FmuPlant) -> list[Block]:
    """Its kind, signals and parameters."""
    signals = [
        ("inputs", ", ".join(v.name for v in plant.inputs) or "none"),
        ("outputs", ", ".join(v.name for v in plant.outputs)),
    ]
    rows = [
        [v.label, f"{v.start:.6g}", format_unit(v.unit) or "-", "initial state" if v.is_initial else v.description]
        for v in plant.fmu.parameters
    ]
    table = TableBlock("Parameters", ["parameter", "value", "unit", REMARK], rows)
    title = f"{plant.fmu.title}: FMI {plant.fmu.fmi_version}, {plant.fmu.kind}"
    return [Details(title, [Facts(signals), table])]


@renders("FmuWithEffects")
def write_effect_fit(result: FmuWithEffects) -> list[Block]:
    """Parameters with intervals, misfits, and the runs that it took."""
    agreement = (
        "agrees with its linearised response" if result.agrees else "does not agree with its linearised response yet"
    )
    failed = f", {result.prepared.failures} of them failed" if result.prepared.failures else ""
    title = f"{result.plant.title} + {' + '.join(result.effects)}: the FMU {agreement} after {result.runs} runs{failed}"
    return [Paragraphs([title]), *_tables(result)]


@renders("FmuDiscovery")
def write_discovery(result: FmuDiscovery) -> list[Block]:
    """The FMU alone, the answer, and the FMU with the effects of the answer."""
    blocks = [*result.prepared.fit.describe().brief]
    response = result.prepared.local.response
    if response is None and result.prepared.fit.model.inputs:
        blocks.append(Paragraphs(["No effect at an input was tried: no linear response to the inputs could be found."]))
    elif response is not None:
        share = min(response.explained.values())
        seen = f"Effects at inputs are seen through a linear response that follows {share:.1%} of the FMU's."
        blocks.append(Paragraphs([seen]))
    blocks += result.discovery.describe().brief
    if result.with_effects is not None:
        blocks += result.with_effects.describe().brief
    return [*blocks, Paragraphs([f"{result.runs} runs of the FMU in all"])]


def _tables(result: FmuWithEffects) -> list[TableBlock]:
    groups = (("estimation", result.misfits), ("validation", result.validation))
    return [
        estimates_table(result.parameters),
        *(
            misfit_table(f"Misfit on the {title} records", misfits, corner=f"output, {title}")
            for title, misfits in groups
            if misfits
        ),
    ]
