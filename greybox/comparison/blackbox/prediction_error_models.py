"""Prediction-error models: ARMAX, output error, Box-Jenkins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from greybox.base.errors import DataError
from greybox.comparison.blackbox import prediction_error
from greybox.comparison.blackbox.arx import find_weak_excitation
from greybox.comparison.blackbox.linear_regression import SampledData, to_orders, to_sampled_data
from greybox.comparison.blackbox.polynomial import PolynomialModel, PolynomialStructure, to_order
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
    history: prediction_error.HistoryTreatment = "estimated",
    offset: bool = False,
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
    return _fit("armax", experiments, output, inputs, history, na=na, nb=nb, nc=nc, nk=nk, offset=offset)


def output_error(
    experiments: Experiment | Sequence[Experiment],
    *,
    nb: int | Sequence[int],
    nf: int | Sequence[int],
    nk: int | Sequence[int] = 1,
    output: str | None = None,
    inputs: Sequence[str] | str | None = None,
    history: prediction_error.HistoryTreatment = "estimated",
    offset: bool = False,
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
    return _fit("output error", experiments, output, inputs, history, nb=nb, nf=nf, nk=nk, offset=offset)


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
    history: prediction_error.HistoryTreatment = "estimated",
    offset: bool = False,
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
    return _fit("box-jenkins", experiments, output, inputs, history, nb=nb, nf=nf, nc=nc, nd=nd, nk=nk, offset=offset)


# Where the search of each kind starts.
STARTS: Mapping[str, prediction_error.Starts] = {
    "armax": prediction_error.estimate_armax_starts,
    "output error": prediction_error.estimate_output_error_starts,
    "box-jenkins": prediction_error.estimate_box_jenkins_starts,
}


def _fit(
    kind: str,
    experiments: Experiment | Sequence[Experiment],
    output: str | None,
    inputs: Sequence[str] | str | None,
    history: prediction_error.HistoryTreatment,
    **orders: Any,
) -> PolynomialModel:
    prediction_error.check_history(history)
    data = to_sampled_data(experiments, output, inputs)
    structure = make_structure(kind, data, **orders)
    # Zeros before the record are a statement about the signals as they are.
    data = data.scaled("mean" if structure.offset and history != "zero" else "zero")
    model = prediction_error.fit_prediction_error(structure, data, STARTS[kind], history).from_zero()
    # An input has to be exciting for its own coefficients, numerator and poles.
    needed = [nb + nf for nb, nf in zip(structure.orders.nb, structure.nf, strict=True)]
    weak = find_weak_excitation(data, structure.orders.na + sum(needed), needed)
    return replace(model, findings=(*weak, *model.findings))


def make_structure(
    kind: str,
    data: SampledData,
    *,
    nb: int | Sequence[int],
    nk: int | Sequence[int],
    na: int = 0,
    nf: int | Sequence[int] = 0,
    nc: int = 0,
    nd: int = 0,
    offset: bool = False,
    refused_as: str = "",
) -> PolynomialStructure:
    """Structure with its orders spread over the inputs; DataError, under the name ``refused_as``, for impossible orders."""
    name = refused_as or kind
    nc, nd = to_order("nc", nc, name), to_order("nd", nd, name)
    orders = to_orders(data, nb, nk, na, name)
    poles = (nf,) * len(orders.nb) if isinstance(nf, (int, np.integer)) else tuple(nf)
    if len(poles) != len(orders.nb):
        raise DataError(
            f"{name}: nf has {len(poles)} numbers for {len(orders.nb)} inputs; give one number, or one for each"
        )
    return PolynomialStructure(kind, orders, tuple(to_order("nf", n, name) for n in poles), nc, nd, offset)
