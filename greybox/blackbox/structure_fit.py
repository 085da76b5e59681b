"""The kinds of black-box models, and one function that fits any of them from a choice of orders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

from greybox.blackbox.arx import fit_arx
from greybox.blackbox.hammerstein import HammersteinModel, fit_hammerstein
from greybox.blackbox.initial_estimates import (
    estimate_armax_starts,
    estimate_box_jenkins_starts,
    estimate_output_error_starts,
)
from greybox.blackbox.linear_regression import to_orders
from greybox.blackbox.output_error import make_output_structure
from greybox.blackbox.polynomial import PolynomialModel
from greybox.blackbox.prediction_error_fit import HistoryTreatment, SearchEffort, fit_prediction_error
from greybox.blackbox.sampled_data import SampledData
from greybox.blackbox.structure import PolynomialStructure, to_order

BlackBox = PolynomialModel | HammersteinModel
BlackBoxKind = Literal["arx", "armax", "output error", "box-jenkins", "hammerstein"]
OrderChoice = Mapping[str, Any]

# The choices that a kind has, in the order in which they are written
ORDERS_BY_KIND: Mapping[str, tuple[str, ...]] = {
    "arx": ("na", "nb", "nk", "offset", "focus"),
    "armax": ("na", "nb", "nc", "nk", "offset"),
    "output error": ("nb", "nf", "nk", "offset"),
    "box-jenkins": ("nb", "nf", "nc", "nd", "nk", "offset"),
    "hammerstein": ("nb", "nf", "nk", "offset", "shape", "freedom"),
}


def fit_structure(
    data: SampledData,
    kind: BlackBoxKind,
    choice: OrderChoice,
    *,
    at_rest: bool = False,
    effort: SearchEffort | None = None,
) -> BlackBox:
    """The model of one ``choice`` of orders; ``at_rest``: all was zero before each record. Raises DataError where it cannot be."""
    offset, beginning = bool(choice.get("offset", False)), _beginning(at_rest)
    if kind in ("arx", "armax"):
        o = to_orders(data, choice["nb"], choice["nk"], choice["na"], kind)
        if kind == "arx":
            passes = 1 if choice.get("focus") == "simulation" else 0
            return fit_arx(data, o, history="zero" if at_rest else "measured", offset=offset, passes=passes)
        structure = PolynomialStructure(kind, o, (0,) * len(o.nb), nc=to_order("nc", choice["nc"], kind), offset=offset)
        return fit_prediction_error(structure, data, estimate_armax_starts, beginning, effort=effort)
    nc, nd = (to_order(letter, choice.get(letter, 0), kind) for letter in ("nc", "nd"))
    inner = "output error" if kind == "hammerstein" else kind
    structure = make_output_structure(
        inner, data, choice["nb"], choice["nf"], choice["nk"], nc=nc, nd=nd, offset=offset
    )
    if kind == "hammerstein":
        return fit_hammerstein(structure, data, choice["shape"], choice["freedom"], beginning, effort=effort)
    starts = estimate_output_error_starts if kind == "output error" else estimate_box_jenkins_starts
    return fit_prediction_error(structure, data, starts, beginning, effort=effort)


def get_linear_part(model: BlackBox) -> PolynomialModel:
    """The difference equation of ``model``."""
    return model.linear if isinstance(model, HammersteinModel) else model


def with_units(model: BlackBox, units: Mapping[str, str]) -> BlackBox:
    """``model`` with the units of its signals."""
    named = replace(get_linear_part(model), units=dict(units))
    return replace(model, linear=named) if isinstance(model, HammersteinModel) else named


def _beginning(at_rest: bool) -> HistoryTreatment:
    return "zero" if at_rest else "estimated"
