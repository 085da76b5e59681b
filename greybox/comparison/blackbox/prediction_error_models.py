"""Prediction-error models: ARMAX, output error, Box-Jenkins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from greybox.base.errors import DataError
from greybox.comparison.blackbox.arx import find_weak_excitation
from greybox.comparison.blackbox.linear_regression import SampledData, to_orders, to_sampled_data
from greybox.comparison.blackbox.polynomial import PolynomialModel, PolynomialStructure, to_order
from greybox.comparison.blackbox.prediction_error import (
    DEFAULT_SEARCH,
    HistoryTreatment,
    PredictionErrorPolicy,
    check_history,
    estimate_armax_starts,
    estimate_box_jenkins_starts,
    estimate_output_error_starts,
    fit_prediction_error,
)
from greybox.data.experiment import Experiment


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
    policy: PredictionErrorPolicy = DEFAULT_SEARCH,
) -> PolynomialModel:
    """Fit ``A(q) y(k) = sum_i B_i(q) u_i(k) + C(q) e(k)`` by minimising the mean square of the one-step error ``e``.

    A damped Gauss-Newton search starts from several linear estimates and keeps the best minimum.

    Parameters
    ----------
    experiments
        One or more records of the same sampling time.
    na
        Number of poles.
    nb
        Number of coefficients of each ``B``: one number for all inputs, or one for each.
    nc
        Number of coefficients of the noise polynomial ``C``. It is kept stable: roots outside the unit circle are mirrored into it.
    nk
        Delay in samples of the first numerator coefficient: one number for all inputs, or one for each.
    output
        Name of the output; needed where the records have several.
    inputs
        Names of the inputs; None takes all.
    history
        ``"estimated"``: what lies before each record, and after each gap where past outputs count, is estimated with it.
        ``"zero"``: everything was zero there.
    offset
        Whether the equation has a constant, for signals that do not rest at zero.
    units
        Name of a signal -> unit.
    policy
        How hard to search.

    Returns
    -------
    PolynomialModel
        The model with the covariance of its coefficients and its findings.

    Raises
    ------
    DataError
        For irregular time, unknown names, impossible orders, too few rows, and coefficients that the record cannot tell apart.

    Examples
    --------
    >>> model = gb.blackbox.armax(record, na=2, nb=2, nc=1)  # doctest: +SKIP
    """
    check_history(history)
    data = to_sampled_data(experiments, output, inputs)
    structure = make_armax_structure(data, na, nb, nc, nk, offset=offset)
    model = fit_prediction_error(structure, data, estimate_armax_starts, history, units, policy)
    weak = find_weak_excitation(data, structure.orders.na + sum(structure.orders.nb), structure.orders.nb)
    return replace(model, findings=(*weak, *model.findings))


def output_error(
    experiments: Experiment | Sequence[Experiment],
    *,
    nb: int | Sequence[int],
    nf: int | Sequence[int],
    nk: int | Sequence[int] = 1,
    output: str | None = None,
    inputs: Sequence[str] | str | None = None,
    history: HistoryTreatment = "estimated",
    offset: bool = False,
    units: Mapping[str, str] | None = None,
    policy: PredictionErrorPolicy = DEFAULT_SEARCH,
) -> PolynomialModel:
    """Fit ``y(k) = sum_i B_i(q) / F_i(q) u_i(k) + e(k)`` by minimising the mean square of the free-run error ``e``.

    The standard deviations hold for a white error only. A gap in the output costs nothing but its rows.

    Parameters
    ----------
    experiments
        One or more records of the same sampling time.
    nb
        Number of coefficients of each ``B``: one number for all inputs, or one for each.
    nf
        Number of poles of each ``F``: one number for all inputs, or one for each. They are held inside the unit circle.
    nk
        Delay in samples of the first numerator coefficient: one number for all inputs, or one for each.
    output
        Name of the output; needed where the records have several.
    inputs
        Names of the inputs; None takes all.
    history
        ``"estimated"``: what lies before each record, and after each gap where past outputs count, is estimated with it.
        ``"zero"``: everything was zero there.
    offset
        Whether the equation has a constant, for signals that do not rest at zero.
    units
        Name of a signal -> unit.
    policy
        How hard to search.

    Returns
    -------
    PolynomialModel
        The model with the covariance of its coefficients and its findings.

    Raises
    ------
    DataError
        For irregular time, unknown names, impossible orders, too few rows, and coefficients that the record cannot tell apart.

    Examples
    --------
    >>> model = gb.blackbox.output_error(record, nb=2, nf=2)  # doctest: +SKIP
    """
    check_history(history)
    data = to_sampled_data(experiments, output, inputs)
    structure = make_output_structure("output error", data, nb, nf, nk, offset=offset)
    model = fit_prediction_error(structure, data, estimate_output_error_starts, history, units, policy)
    return _with_excitation(structure, data, model)


def box_jenkins(
    experiments: Experiment | Sequence[Experiment],
    *,
    nb: int | Sequence[int],
    nf: int | Sequence[int],
    nc: int,
    nd: int,
    nk: int | Sequence[int] = 1,
    output: str | None = None,
    inputs: Sequence[str] | str | None = None,
    history: HistoryTreatment = "estimated",
    offset: bool = False,
    units: Mapping[str, str] | None = None,
    policy: PredictionErrorPolicy = DEFAULT_SEARCH,
) -> PolynomialModel:
    """Fit ``y(k) = sum_i B_i(q) / F_i(q) u_i(k) + C(q) / D(q) e(k)`` by minimising the mean square of the one-step error ``e``.

    The output error model with coloured noise of its own poles and zeros (Box, Jenkins 1970; Ljung, System identification, 2nd ed.,
    equation 4.31).

    Parameters
    ----------
    experiments
        One or more records of the same sampling time.
    nb
        Number of coefficients of each ``B``: one number for all inputs, or one for each.
    nf
        Number of poles of each ``F``: one number for all inputs, or one for each. They are held inside the unit circle.
    nc, nd
        Number of zeros and poles of the noise model; both are held inside the unit circle.
    nk
        Delay in samples of the first numerator coefficient: one number for all inputs, or one for each.
    output
        Name of the output; needed where the records have several.
    inputs
        Names of the inputs; None takes all.
    history
        ``"estimated"``: what lies before each record, and after each gap where past outputs count, is estimated with it.
        ``"zero"``: everything was zero there.
    offset
        Whether the equation has a constant, for signals that do not rest at zero.
    units
        Name of a signal -> unit.
    policy
        How hard to search.

    Returns
    -------
    PolynomialModel
        The model with the covariance of its coefficients and its findings.

    Raises
    ------
    DataError
        For irregular time, unknown names, impossible orders, too few rows, and coefficients that the record cannot tell apart.

    Examples
    --------
    >>> model = gb.blackbox.box_jenkins(record, nb=2, nf=2, nc=1, nd=1)  # doctest: +SKIP
    """
    check_history(history)
    data = to_sampled_data(experiments, output, inputs)
    kind = "box-jenkins"
    noise = {"nc": to_order("nc", nc, kind), "nd": to_order("nd", nd, kind)}
    structure = make_output_structure(kind, data, nb, nf, nk, offset=offset, **noise)
    model = fit_prediction_error(structure, data, estimate_box_jenkins_starts, history, units, policy)
    return _with_excitation(structure, data, model)


def make_armax_structure(
    data: SampledData,
    na: int,
    nb: int | Sequence[int],
    nc: int,
    nk: int | Sequence[int],
    *,
    offset: bool = False,
) -> PolynomialStructure:
    """Structure of an ARMAX model, its orders spread over the inputs. Raises DataError for impossible orders."""
    orders = to_orders(data, nb, nk, na, "armax")
    return PolynomialStructure("armax", orders, (0,) * len(orders.nb), nc=to_order("nc", nc, "armax"), offset=offset)


def make_output_structure(
    kind: str,
    data: SampledData,
    nb: int | Sequence[int],
    nf: int | Sequence[int],
    nk: int | Sequence[int],
    *,
    nc: int = 0,
    nd: int = 0,
    offset: bool = False,
) -> PolynomialStructure:
    """Structure with ``A = 1``, its orders spread over the inputs. Raises DataError for impossible orders."""
    orders = to_orders(data, nb, nk, 0, kind)
    poles = (nf,) * len(orders.nb) if isinstance(nf, (int, np.integer)) else tuple(nf)
    if len(poles) != len(orders.nb):
        raise DataError(
            f"{kind}: nf has {len(poles)} numbers for {len(orders.nb)} inputs; give one number, or one for each"
        )
    return PolynomialStructure(kind, orders, tuple(to_order("nf", n, kind) for n in poles), nc=nc, nd=nd, offset=offset)


def _with_excitation(structure: PolynomialStructure, data: SampledData, model: PolynomialModel) -> PolynomialModel:
    needed = [nb + nf for nb, nf in zip(structure.orders.nb, structure.nf, strict=True)]
    return replace(model, findings=(*find_weak_excitation(data, sum(needed), needed), *model.findings))
