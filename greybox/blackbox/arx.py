"""ARX by linear least squares."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal, get_args

import numpy as np
from scipy.signal import lfilter

from greybox.blackbox.excitation import find_weak_excitation
from greybox.blackbox.linear_regression import (  # fmt: skip
    Orders,
    RegressionHistory,
    build_regressors,
    find_usable_rows,
    name_regressors,
    refuse_few_rows,
    solve_least_squares,
    to_orders,
)
from greybox.blackbox.polynomial import PolynomialModel
from greybox.blackbox.rounding import find_instability, reflect_roots
from greybox.blackbox.sampled_data import SampledData, to_sampled_data
from greybox.errors import DataError, nearest
from greybox.experiment import Experiment

FitFocus = Literal["prediction", "simulation"]


def arx(
    experiments: Experiment | Sequence[Experiment],
    *,
    na: int,
    nb: int | Sequence[int],
    nk: int | Sequence[int] = 1,
    output: str | None = None,
    inputs: Sequence[str] | str | None = None,
    history: RegressionHistory = "measured",
    focus: FitFocus = "prediction",
    passes: int = 1,
    offset: bool = False,
    units: Mapping[str, str] | None = None,
) -> PolynomialModel:
    """Fit ``A(q) y(k) = sum_i B_i(q) u_i(k) + e(k)`` to one or more records of the same sampling time, by least squares.

    ``na`` poles; ``nb`` coefficients of each ``B`` (one number for all inputs, or one for each), the first at a delay of ``nk``
    samples (0: direct feed-through). ``output``: needed where the records have several; ``inputs``: None for all.

    ``history`` names the rows: ``"measured"`` takes the equations whose whole history was measured (the covariance method: row
    ``max(na, nb + nk - 1)`` on); ``"zero"`` also the first ones, with zeros before the record (pre-windowing), which is right where
    it begins at rest and tells the lags of a step apart. A gap in the output leaves out every equation that it is part of.

    ``focus``: ``"prediction"`` minimises the mean square of ``e``, one step ahead; ``"simulation"`` then weighs it ``passes`` times
    by ``1 / A`` of the fit before (Steiglitz and McBride 1965), so that the error of a free run is minimised, approximately.
    ``offset`` adds a constant to the equation, for signals that do not rest at zero. ``units``: name -> unit.

    Raises DataError for irregular time, unknown names, too few rows, and columns that the record cannot tell apart.
    """
    if history not in get_args(RegressionHistory):
        raise DataError(f"unknown history {history!r}; {nearest(history, get_args(RegressionHistory))}")
    if focus not in get_args(FitFocus):
        raise DataError(f"unknown focus {focus!r}; {nearest(focus, get_args(FitFocus))}")
    data = to_sampled_data(experiments, output, inputs)
    o = to_orders(data, nb, nk, na)
    model = fit_arx(data, o, history=history, offset=offset, passes=passes if focus == "simulation" else 0)
    notes = (*find_weak_excitation(data, sum(o.nb) + o.na, o.nb), *model.notes)
    return replace(model, units=dict(units or {}), notes=notes)


def fit_arx(
    data: SampledData, o: Orders, *, history: RegressionHistory, offset: bool, passes: int = 0
) -> PolynomialModel:
    """`arx` of these orders, with ``passes`` of the filter ``1 / A``."""
    model = _estimate(data, o, history, offset, None)
    for _ in range(passes):
        model = _estimate(data, o, history, offset, reflect_roots(model.a))
    return replace(model, focus="simulation" if passes else "prediction", notes=find_instability(model))


def _estimate(
    data: SampledData, o: Orders, history: RegressionHistory, offset: bool, prefilter: np.ndarray | None
) -> PolynomialModel:
    """The least-squares estimate, its equations filtered by ``1 / prefilter`` from each record's or segment's first one on."""
    blocks, targets, ends = [], [], []
    for series in data.series:
        rows = find_usable_rows(series, o, history)
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
            if len(run):
                block, target = build_regressors(series, o, offset)[run], series.y[run]
                if prefilter is not None:
                    block, target = (lfilter([1.0], prefilter, part, axis=0) for part in (block, target))
                blocks.append(block)
                targets.append(target)
                ends.append(len(run))
    names = name_regressors(data, o, offset)
    label = f"arx({o.na}, {list(o.nb)}, {list(o.nk)})" if len(o.nb) > 1 else f"arx({o.na}, {o.nb[0]}, {o.nk[0]})"
    refuse_few_rows(data, label, sum(ends), len(names), history)
    phi, y = np.concatenate(blocks), np.concatenate(targets)
    theta, inverse, squares = solve_least_squares(phi, y, names, label)
    variance = squares / (len(y) - len(theta))
    a, rest = theta[: o.na], theta[o.na :]
    cut = np.cumsum(o.nb)
    return PolynomialModel(
        kind="arx", output=data.output, inputs=data.inputs, sampling_time=data.sampling_time, nk=o.nk,
        a=np.append(1.0, a),
        b=tuple(np.append(np.zeros(k), part) for k, part in zip(o.nk, np.split(rest[: cut[-1]], cut[:-1]), strict=True)),
        constant=float(rest[-1]) if offset else None, noise_std=float(np.sqrt(variance)), covariance=variance * inverse,
        samples=len(y), loss=squares / len(y), history=history,
    )  # fmt: skip
