"""The kinds of black-box models, and one function that fits any of them from a choice of orders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

from greybox.blackbox.arx import solved
from greybox.blackbox.hammerstein import HammersteinModel, bent
from greybox.blackbox.output_error import without_equation_error
from greybox.blackbox.polynomial import PolynomialModel
from greybox.blackbox.regression import orders
from greybox.blackbox.search import Beginning, Effort, searched
from greybox.blackbox.series import Channels
from greybox.blackbox.starts import armax_starts, box_jenkins_starts, output_error_starts
from greybox.blackbox.structure import Structure, whole

BlackBox = PolynomialModel | HammersteinModel
Kind = Literal["arx", "armax", "output error", "box-jenkins", "hammerstein"]
Choice = Mapping[str, Any]

# The choices that a kind has, in the order in which they are written
ORDERS: Mapping[str, tuple[str, ...]] = {
    "arx": ("na", "nb", "nk", "offset", "focus"),
    "armax": ("na", "nb", "nc", "nk", "offset"),
    "output error": ("nb", "nf", "nk", "offset"),
    "box-jenkins": ("nb", "nf", "nc", "nd", "nk", "offset"),
    "hammerstein": ("nb", "nf", "nk", "offset", "shape", "freedom"),
}


def fitted(
    data: Channels, kind: Kind, choice: Choice, *, at_rest: bool = False, effort: Effort | None = None
) -> BlackBox:
    """The model of one ``choice`` of orders; ``at_rest``: all was zero before each record. Raises DataError where it cannot be."""
    offset, beginning = bool(choice.get("offset", False)), _beginning(at_rest)
    if kind in ("arx", "armax"):
        o = orders(data, choice["nb"], choice["nk"], choice["na"], kind)
        if kind == "arx":
            passes = 1 if choice.get("focus") == "simulation" else 0
            return solved(data, o, history="zero" if at_rest else "measured", offset=offset, passes=passes)
        structure = Structure(kind, o, (0,) * len(o.nb), nc=whole("nc", choice["nc"], kind), offset=offset)
        return searched(structure, data, armax_starts, beginning, effort=effort)
    nc, nd = (whole(letter, choice.get(letter, 0), kind) for letter in ("nc", "nd"))
    inner = "output error" if kind == "hammerstein" else kind
    structure = without_equation_error(
        inner, data, choice["nb"], choice["nf"], choice["nk"], nc=nc, nd=nd, offset=offset
    )
    if kind == "hammerstein":
        return bent(structure, data, choice["shape"], choice["freedom"], beginning, effort=effort)
    starts = output_error_starts if kind == "output error" else box_jenkins_starts
    return searched(structure, data, starts, beginning, effort=effort)


def linear_part(model: BlackBox) -> PolynomialModel:
    """The difference equation of ``model``."""
    return model.linear if isinstance(model, HammersteinModel) else model


def with_units(model: BlackBox, units: Mapping[str, str]) -> BlackBox:
    """``model`` with the units of its signals."""
    named = replace(linear_part(model), units=dict(units))
    return replace(model, linear=named) if isinstance(model, HammersteinModel) else named


def _beginning(at_rest: bool) -> Beginning:
    return "zero" if at_rest else "estimated"
