"""An FMU in plain text."""

from __future__ import annotations

from typing import TYPE_CHECKING

from greybox.base import format_unit
from greybox.base.document import REMARK, Block, Details, Facts, TableBlock
from greybox.show.sentences import renders

if TYPE_CHECKING:
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
