"""Models in plain text: title, equations, parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from greybox.expressions.text import number_text
from greybox.model.equations import equations_text
from greybox.rendering.registry import renders
from greybox.units import format_unit

if TYPE_CHECKING:
    from greybox.model import Model
    from greybox.model.signals import Parameter


@renders("Model")
def write_model(model: Model) -> str:
    """Title, equations and parameters of a model."""
    title = f"{model.title}: {model.description}" if model.description else model.title
    parameters = ["  parameters", *_table([_row(q) for q in model.all_parameters])] if model.all_parameters else []
    return "\n".join([title, equations_text(model), *parameters])


def _row(parameter: Parameter) -> tuple[str, ...]:
    low, high = parameter.bounds
    bounded = math.isfinite(low) or math.isfinite(high)
    return (
        parameter.name,
        number_text(parameter.value),
        format_unit(parameter.unit) or "-",
        "fixed" if parameter.fixed else "free",
        f"[{number_text(low)}, {number_text(high)}]" if bounded else "",
        "" if parameter.prior is None else "prior " + " +- ".join(map(number_text, parameter.prior)),
        parameter.source,
    )


def _table(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        ("    " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True) if width)).rstrip()
        for row in rows
    ]
