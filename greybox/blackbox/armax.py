"""ARMAX: the equation error is a moving average of white noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from greybox.blackbox.excitation import find_weak_excitation
from greybox.blackbox.initial_estimates import estimate_armax_starts
from greybox.blackbox.linear_regression import to_orders
from greybox.blackbox.polynomial import PolynomialModel
from greybox.blackbox.prediction_error_fit import HistoryTreatment, check_history, fit_prediction_error
from greybox.blackbox.sampled_data import to_sampled_data
from greybox.blackbox.structure import PolynomialStructure, to_order
from greybox.experiment import Experiment


def armax(
    experiments: Experiment | Sequence[Experiment],
    *,
    na: int,
    nb: int | Sequence[int],
    nc: int,
    nk: int | Sequence[int] = 1,
    output: str | None = None,
    inputs: Sequence[str] | str | None = None,
    history: HistoryTreatment = "estimated",
    offset: bool = False,
    units: Mapping[str, str] | None = None,
) -> PolynomialModel:
    """Fit ``A(q) y(k) = sum_i B_i(q) u_i(k) + C(q) e(k)`` by minimising the mean square of the one-step error ``e``.

    ``nc`` coefficients of the noise polynomial ``C``, which is stable: its roots are mirrored into the unit circle. The rest as in
    `arx`. ``history``: ``"estimated"``, what lies before each record and after each gap is estimated with it; ``"zero"``, all was
    zero there. The search (Gauss and Newton's step, damped) starts from several linear estimates and keeps the best.

    Raises DataError as `arx` does.
    """
    check_history(history)
    data = to_sampled_data(experiments, output, inputs)
    o = to_orders(data, nb, nk, na, "armax")
    structure = PolynomialStructure("armax", o, (0,) * len(o.nb), nc=to_order("nc", nc, "armax"), offset=offset)
    model = fit_prediction_error(structure, data, estimate_armax_starts, history, units)
    return replace(model, notes=(*find_weak_excitation(data, o.na + sum(o.nb), o.nb), *model.notes))
