"""FMUs and their fits in plain text."""

from __future__ import annotations

from typing import TYPE_CHECKING

from greybox.rendering.registry import renders
from greybox.rendering.result import MISFIT_HEADS, to_misfit_cells
from greybox.rendering.tables import format_table, format_with_std
from greybox.units import format_unit

if TYPE_CHECKING:
    from greybox.fmu import FmuFit, FmuPlant


@renders("FmuPlant")
def write_plant(plant: FmuPlant) -> str:
    """Its kind, signals and parameters."""
    parameters = [
        [v.label, f"{v.start:.6g}", format_unit(v.unit) or "-", "initial state" if v.is_initial else v.description]
        for v in plant.parameters
    ]
    return "\n".join(
        [
            f"{plant.title}: FMI {plant.fmi_version}, {plant.kind}",
            f"  inputs: {', '.join(v.label for v in plant.inputs) or 'none'}",
            f"  outputs: {', '.join(v.label for v in plant.outputs)}",
            *format_table(["parameter", "value", "unit", ""], parameters),
        ]
    )


@renders("FmuFit")
def write_fit(result: FmuFit) -> str:
    """Parameters with intervals, misfits, and the runs that it took."""
    rows = []
    for name, e in result.parameters.items():
        low, high = e.interval or (float("nan"), float("nan"))
        note = "at its bound" if e.at_bound else "" if e.determined else "not determined"
        rows.append(
            [name, format_with_std(e.value, e.std or 0.0), format_unit(e.unit) or "-", f"{low:.5g} .. {high:.5g}", note]
        )
    failed = f", {result.failures} of them failed" if result.failures else ""
    cost = f"{result.runs} runs{failed}, in all as long as {result.equivalents:.3g} of all records"
    lines = [f"{result.plant.title}: {result.status} after {cost}", ""]
    lines += format_table(["parameter", "value", "unit", "95 % interval", ""], rows)
    for title, misfits in (("estimation", result.misfits), ("validation", result.validation)):
        if misfits:
            cells = [[name, *to_misfit_cells(m)] for name, m in misfits.items()]
            lines += ["", *format_table([f"output, {title}", *MISFIT_HEADS], cells)]
    return "\n".join(lines)
