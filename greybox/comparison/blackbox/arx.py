"""ARX by linear least squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from greybox.base.errors import DataError, nearest
from greybox.base.values import Finding, Severity
from greybox.comparison.blackbox.linear_regression import (
    Orders,
    RegressionHistory,
    SampledData,
    collect_equations,
    name_regressors,
    refuse_few_rows,
    solve_least_squares,
    to_orders,
    to_sampled_data,
)
from greybox.comparison.blackbox.polynomial import BlackBoxFinding, PolynomialModel, PolynomialStructure, reflect_roots
from greybox.data.experiment import Experiment

# Checks of a fitted black-box model: weak excitation, instability, an unfinished search.


def find_weak_excitation(data: SampledData, needed: int, nb: Sequence[int]) -> tuple[Finding, ...]:
    """A finding for each input whose order of persistent excitation is below the ``needed`` number of coefficients.

    The order is 1 for a constant or a step and 2 for each sine; each carries one coefficient. Several inputs share the
    ``needed`` coefficients, so that each is compared with its own ``nb`` there.
    """
    from greybox.estimation.identifiability.excitation import analyse_excitation

    analyses = [analyse_excitation(experiment) for experiment in data.experiments]
    findings = []
    for i, name in enumerate(data.inputs):
        required = min(needed if len(data.inputs) == 1 else nb[i], max(a.limit for a in analyses))
        order = max(a.orders[name] for a in analyses)
        if order < required:
            values = {"order": order, "required": required}
            findings.append(Finding(BlackBoxFinding.WEAK_EXCITATION, Severity.WARNING, name, values))
    return tuple(findings)


def find_instability(model: PolynomialModel) -> tuple[Finding, ...]:
    """A finding with the outermost pole of an unstable model and the samples in which a free run grows by a factor of e."""
    if model.stable:
        return ()
    outermost = float(np.abs(model.poles[0]))
    # |p|^k = e after k = 1 / ln |p| samples
    growth = np.inf if outermost == 1 else 1 / np.log(outermost)
    values = {"pole": outermost, "growth_samples": float(growth), "equation_error": len(model.a) > 1}
    return (Finding(BlackBoxFinding.UNSTABLE, Severity.WARNING, model.output, values),)


def find_unfinished_search(converged: bool, iterations: int) -> tuple[Finding, ...]:
    """A finding where the search ended at its limit of iterations."""
    if converged:
        return ()
    return (Finding(BlackBoxFinding.SEARCH_UNFINISHED, Severity.WARNING, values={"iterations": iterations}),)


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
) -> PolynomialModel:
    """Fit ``A(q) y(k) = sum_i B_i(q) u_i(k) + e(k)`` by linear least squares.

    Parameters
    ----------
    experiments
        One or more records of the same sampling time. A gap in the output leaves out every equation that it is part of.
    na
        Number of poles.
    nb
        Number of coefficients of each ``B``: one number for all inputs, or one for each.
    nk
        Delay in samples of the first of these coefficients (0: direct feed-through).
    output
        Name of the output; needed where the records have several.
    inputs
        Names of the inputs; None takes all.
    history
        ``"measured"`` uses the equations whose whole history was measured (the covariance method: row ``max(na, nb + nk - 1)``
        on). ``"zero"`` uses the first rows as well, with zeros before the record (pre-windowing): right where the record begins at
        rest, and the only way to tell the lags of a step apart.
    focus
        ``"prediction"`` minimises the mean square of the one-step error ``e``. ``"simulation"`` then filters the equations
        ``passes`` times by ``1 / A`` of the previous estimate (Steiglitz and McBride 1965), which approximately minimises the error
        of a free run.
    passes
        Number of these passes.
    offset
        Whether the equation has a constant, for signals that do not rest at zero.

    Returns
    -------
    PolynomialModel
        The model with the covariance of its coefficients and its findings.

    Raises
    ------
    DataError
        For irregular time, unknown names, too few rows, and columns that the record cannot tell apart.

    See Also
    --------
    armax, output_error : models with another place for the noise.

    Examples
    --------
    >>> import greybox as gb
    >>> import numpy as np
    >>> u = np.random.default_rng(0).standard_normal(200)
    >>> y = np.zeros(200)
    >>> for k in range(1, 200):
    ...     y[k] = 0.9 * y[k - 1] + 0.5 * u[k - 1]
    >>> record = gb.Experiment("record", 0.1 * np.arange(200), {"u": u}, {"y": y})
    >>> model = gb.blackbox.arx(record, na=1, nb=1)
    >>> {name: round(value, 6) for name, value in model.coefficients.items()}
    {'a1': -0.9, 'b1': 0.5}
    """
    if history not in get_args(RegressionHistory):
        raise DataError(f"unknown history {history!r}; {nearest(history, get_args(RegressionHistory))}")
    if focus not in get_args(FitFocus):
        raise DataError(f"unknown focus {focus!r}; {nearest(focus, get_args(FitFocus))}")
    data = to_sampled_data(experiments, output, inputs)
    orders = to_orders(data, nb, nk, na)
    # Zeros before the record are a statement about the signals as they are.
    data = data.scaled("mean" if offset and history != "zero" else "zero")
    model = fit_arx(
        data, orders, history=history, offset=offset, passes=passes if focus == "simulation" else 0
    ).from_zero()
    findings = (*find_weak_excitation(data, sum(orders.nb) + orders.na, orders.nb), *model.findings)
    return replace(model, findings=findings)


def fit_arx(
    data: SampledData, orders: Orders, *, history: RegressionHistory, offset: bool, passes: int = 0
) -> PolynomialModel:
    """`arx` of these orders for scaled data, with ``passes`` of the filter ``1 / A``."""
    model = _estimate(data, orders, history, offset, None)
    for _ in range(passes):
        # 1 / A of an unstable estimate would grow without bound; its mirror image has the same magnitude.
        model = _estimate(data, orders, history, offset, reflect_roots(model.a))
    focus = "simulation" if passes else "prediction"
    return replace(model.in_units(data.scaling), focus=focus, findings=find_instability(model))


def _estimate(
    data: SampledData, orders: Orders, history: RegressionHistory, offset: bool, prefilter: np.ndarray | None
) -> PolynomialModel:
    """The least-squares estimate, its equations filtered by ``1 / prefilter`` from the first one of each record or segment on."""
    equations = collect_equations(data, orders, offset, history, prefilter)
    names = name_regressors(data, orders, offset)
    na, nb, nk = orders.na, orders.nb, orders.nk
    label = f"arx({na}, {list(nb)}, {list(nk)})" if len(nb) > 1 else f"arx({na}, {nb[0]}, {nk[0]})"
    refuse_few_rows(data, label, equations.rows, len(names), history)
    theta, inverse, squares = solve_least_squares(equations, names, label)
    # s^2 = V / (N - p), cov theta = s^2 (Phi'Phi)^-1
    variance = squares / (equations.rows - len(theta))
    structure = PolynomialStructure("arx", orders, (0,) * len(nb), offset=offset)
    return replace(
        structure.model(theta, data),
        noise_std=float(np.sqrt(variance)),
        covariance=variance * inverse,
        samples=equations.rows,
        loss=squares / equations.rows,
        history=history,
    )
