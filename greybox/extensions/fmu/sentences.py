"""FMUs and their fits in plain text."""

from __future__ import annotations

from typing import TYPE_CHECKING

from greybox.base.document import REMARK, Block, Details, Facts, Paragraphs, TableBlock
from greybox.base.units import format_unit
from greybox.show.documents.tables import estimates_table, misfit_table
from greybox.show.sentences.registry import renders

if TYPE_CHECKING:
    from greybox.extensions.fmu.description import FmuPlant
    from greybox.extensions.fmu.effects import FmuDiscovery, FmuEffectFit
    from greybox.extensions.fmu.fit_fmu import FmuFit


@renders("FmuPlant")
def write_plant(plant: FmuPlant) -> list[Block]:
    """Its kind, signals and parameters."""
    signals = [
        ("inputs", ", ".join(v.label for v in plant.inputs) or "none"),
        ("outputs", ", ".join(v.label for v in plant.outputs)),
    ]
    rows = [
        [v.label, f"{v.start:.6g}", format_unit(v.unit) or "-", "initial state" if v.is_initial else v.description]
        for v in plant.parameters
    ]
    table = TableBlock("Parameters", ["parameter", "value", "unit", REMARK], rows)
    return [Details(f"{plant.title}: FMI {plant.fmi_version}, {plant.kind}", [Facts(signals), table])]


@renders("FmuFit")
def write_fit(result: FmuFit) -> list[Block]:
    """Parameters with intervals, misfits, and the runs that it took."""
    cost = f"{result.runs} runs{_failed(result.failures)}, in all as long as {result.equivalents:.3g} of all records"
    return [Paragraphs([f"{result.plant.title}: {result.status} after {cost}"]), *_tables(result)]


@renders("FmuEffectFit")
def write_effect_fit(result: FmuEffectFit) -> list[Block]:
    """The same of an FMU with effects."""
    agreement = (
        "agrees with its linearised response" if result.agrees else "does not agree with its linearised response yet"
    )
    runs = f"{result.runs} runs{_failed(result.prepared.failures)}"
    title = f"{result.plant.title} + {' + '.join(result.effects)}: the FMU {agreement} after {runs}"
    return [Paragraphs([title]), *_tables(result)]


@renders("FmuDiscovery")
def write_discovery(result: FmuDiscovery) -> list[Block]:
    """The FMU alone, the answer, and the FMU with the effects of the answer."""
    blocks = [*result.prepared.fit.describe().brief]
    response = result.prepared.local.response
    if response is None and result.prepared.fit.plant.inputs:
        blocks.append(Paragraphs(["No effect at an input was tried: no linear response to the inputs could be found."]))
    elif response is not None:
        share = min(response.explained.values())
        seen = f"Effects at inputs are seen through a linear response that follows {share:.1%} of the FMU's."
        blocks.append(Paragraphs([seen]))
    blocks += result.discovery.describe().brief
    if result.with_effects is not None:
        blocks += result.with_effects.describe().brief
    return [*blocks, Paragraphs([f"{result.runs} runs of the FMU in all"])]


def _failed(failures: int) -> str:
    return f", {failures} of them failed" if failures else ""


def _tables(result: FmuFit | FmuEffectFit) -> list[TableBlock]:
    groups = (("estimation", result.misfits), ("validation", result.validation))
    return [
        estimates_table(result.parameters),
        *(
            misfit_table(f"Misfit on the {title} records", misfits, corner=f"output, {title}")
            for title, misfits in groups
            if misfits
        ),
    ]
