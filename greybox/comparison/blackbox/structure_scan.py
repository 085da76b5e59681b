"""Many structures fitted in one call, tabulated, and the best of them chosen."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import product
from typing import Any, Literal, get_args

import numpy as np

from greybox.base.errors import DataError, nearest
from greybox.base.values import Printable
from greybox.comparison.blackbox.arx import fit_arx
from greybox.comparison.blackbox.hammerstein import HammersteinModel, fit_hammerstein
from greybox.comparison.blackbox.linear_regression import SampledData, to_orders, to_sampled_data
from greybox.comparison.blackbox.polynomial import PolynomialModel
from greybox.comparison.blackbox.prediction_error import (
    DEFAULT_SEARCH,
    HistoryTreatment,
    PredictionErrorPolicy,
    fit_prediction_error,
)
from greybox.comparison.blackbox.prediction_error_models import STARTS, make_structure
from greybox.comparison.blackbox.resample import Fold
from greybox.data.experiment import Experiment, as_records
from greybox.estimation.optim.minimisation import TerminationPolicy


@dataclass(frozen=True)
class StructureScanPolicy:
    """Which structures are tried, on which rows, and which of the good ones is chosen.

    Parameters
    ----------
    search
        Search while scanning: enough to rank structures.
    final_search
        Search for the chosen structure.
    largest_poles
        Most poles of an ARX model, which is a linear problem.
    largest_searched_poles
        Most poles of a structure that needs an iterative search.
    first_delays
        Delays in samples that are always tried.
    nonlinearities
        Basis sizes that are tried for each shape of a static nonlinearity.
    """

    search: PredictionErrorPolicy = field(
        default_factory=lambda: PredictionErrorPolicy(
            starts=2,
            first_iterations=4,
            iterations=15,
            termination=TerminationPolicy(
                negligible_decrease=1e-2, perfect_noise_ratio=0.0, patience=1, little_gain=1e-6
            ),
        )
    )
    final_search: PredictionErrorPolicy = field(default_factory=PredictionErrorPolicy)
    largest_poles: int = 6
    largest_searched_poles: int = 4
    first_delays: tuple[int, ...] = (0, 1, 2)
    nonlinearities: Mapping[str, tuple[int, ...]] = field(
        default_factory=lambda: {"polynomial": (2, 3, 5), "piecewise": (3, 5)}
    )


DEFAULT_SCAN = StructureScanPolicy()


class BlackBoxKind(StrEnum):
    """The kinds of black-box models that are scanned."""

    ARX = "arx"
    ARMAX = "armax"
    OUTPUT_ERROR = "output error"
    BOX_JENKINS = "box-jenkins"
    HAMMERSTEIN = "hammerstein"


BlackBox = PolynomialModel | HammersteinModel
OrderChoice = Mapping[str, Any]
SelectionCriterion = Literal["aic", "bic", "free run"]

# The choices that a kind has, in the order in which they are written.
ORDERS_BY_KIND: Mapping[str, tuple[str, ...]] = {
    BlackBoxKind.ARX: ("na", "nb", "nk", "offset", "focus"),
    BlackBoxKind.ARMAX: ("na", "nb", "nc", "nk", "offset"),
    BlackBoxKind.OUTPUT_ERROR: ("nb", "nf", "nk", "offset"),
    BlackBoxKind.BOX_JENKINS: ("nb", "nf", "nc", "nd", "nk", "offset"),
    BlackBoxKind.HAMMERSTEIN: ("nb", "nf", "nk", "offset", "shape", "basis_size"),
}


@dataclass(frozen=True, eq=False)
class ScannedStructure:
    """One structure of a scan.

    Attributes
    ----------
    label
        Kind and orders.
    orders
        The orders that were tried, by their letters.
    model
        The fitted model; None where it could not be fitted.
    aic, bic
        ``N ln(loss) + 2 p`` and ``N ln(loss) + p ln N`` with the same N for all structures, where ``loss`` is the mean square that
        the structure minimises; infinite for ``simulation`` focus, whose loss is another one.
    free_run
        Root mean square error of the free run over the validation records, in the output's unit; infinite where it diverges.
    failure
        Why there is no model.
    folds
        How many parts of the records measured that error: only the best of the first part are measured on the others.
    """

    label: str
    orders: OrderChoice
    model: BlackBox | None = None
    aic: float = np.inf
    bic: float = np.inf
    free_run: float = np.inf
    failure: str = ""
    folds: int = 1


@dataclass(frozen=True, eq=False)
class StructureScan(Printable):
    """All structures of a scan and the chosen one.

    Attributes
    ----------
    structures
        Every structure that was tried, in order.
    chosen
        The one that was chosen.
    best
        Its model, fitted in full.
    criterion
        What was chosen by.
    validation
        Names of the records over which the free run was measured; empty: the estimation records themselves.
    unit
        Unit of the output.
    seconds
        Time that the scan took.
    policy
        What it was steered by.
    """

    structures: tuple[ScannedStructure, ...]
    chosen: ScannedStructure
    best: BlackBox
    criterion: SelectionCriterion
    validation: tuple[str, ...] = ()
    unit: str = ""
    seconds: float = 0.0
    policy: StructureScanPolicy = DEFAULT_SCAN


def scan_structures(
    experiments: Experiment | Sequence[Experiment],
    kind: str = BlackBoxKind.ARX,
    *,
    na: Any = range(1, 5),
    nb: Any = range(1, 5),
    nc: Any = (1, 2),
    nd: Any = (1, 2),
    nf: Any = range(1, 4),
    nk: Any = (1, 2, 3),
    offset: Any = False,
    focus: Any = "prediction",
    shape: Any = "polynomial",
    basis_size: Any = 3,
    at_rest: bool = False,
    output: str | None = None,
    inputs: Sequence[str] | str | None = None,
    validation: Experiment | Sequence[Experiment] = (),
    skip: int = 0,
    criterion: SelectionCriterion = "free run",
    units: Mapping[str, str] | None = None,
    report: Callable[[int, int, ScannedStructure], None] | None = None,
    policy: StructureScanPolicy = DEFAULT_SCAN,
) -> StructureScan:
    """Fit every combination of the given orders and choose one.

    Parameters
    ----------
    experiments
        One or more estimation records of the same sampling time.
    kind
        ``arx``, ``armax``, ``output error``, ``box-jenkins`` or ``hammerstein``. Of the orders below those count that it has.
    na, nb, nc, nd, nf, nk, offset, focus, shape, basis_size
        One value, or several to try: ``na=range(1, 6)``, ``offset=(False, True)``. For several inputs ``nb``, ``nf`` and ``nk``
        may hold tuples with one number for each input. See `arx`, `armax`, `output_error`, `box_jenkins`, `hammerstein`.
    at_rest
        Everything was zero before each record.
    output
        Name of the output; needed where the records have several.
    inputs
        Names of the inputs; None takes all.
    validation
        Records over which the free run is measured; none: the estimation records.
    skip
        Rows at the start of each validation record that do not count and determine its initial state (0: the first 50 determine it).
    criterion
        ``"free run"`` takes, of all stable structures within 0.5 % of the smallest error, the one of smallest BIC (for output
        errors, whose BIC trusts a white free-run error, the one of fewest coefficients); ``"aic"`` and ``"bic"`` take the smallest.
    units
        Name of a signal -> unit.
    report
        Called as ``report(done, total, structure)`` after each.
    policy
        How hard to search, and what counts as equally good.

    Returns
    -------
    StructureScan
        All structures, the chosen one, and its model.

    Raises
    ------
    DataError
        Where no structure could be fitted, with the reason of the first, and for unknown names.

    Examples
    --------
    >>> scan = gb.blackbox.scan_structures(record, na=range(1, 4), nb=(1, 2))  # doctest: +SKIP
    >>> scan.best.label  # doctest: +SKIP
    'arx(2, 2, 1)'
    """
    if kind not in ORDERS_BY_KIND:
        raise DataError(f"unknown kind {kind!r}; {nearest(kind, ORDERS_BY_KIND)}")
    if criterion not in get_args(SelectionCriterion):
        raise DataError(f"unknown criterion {criterion!r}; {nearest(criterion, get_args(SelectionCriterion))}")
    given = {
        "na": na,
        "nb": nb,
        "nc": nc,
        "nd": nd,
        "nf": nf,
        "nk": nk,
        "offset": offset,
        "focus": focus,
        "shape": shape,
        "basis_size": basis_size,
    }
    single = (bool, int, np.integer, str)
    axes = {n: [given[n]] if isinstance(given[n], single) else list(given[n]) for n in ORDERS_BY_KIND[kind]}
    choices = [dict(zip(axes, values, strict=True)) | {"at_rest": at_rest} for values in product(*axes.values())]
    data = to_sampled_data(experiments, output, inputs)
    return scan_choices(
        [Fold.of(data.experiments, as_records(validation), skip)],
        data,
        BlackBoxKind(kind),
        choices,
        criterion=criterion,
        units=units,
        report=report,
        policy=policy,
    )


# Structures, the best of the first fold, that the other folds judge as well: a single part of a record may praise one by chance.
SECOND_LOOK, SECOND_LOOK_OF_ARX = 8, 64


def scan_choices(
    folds: Sequence[Fold],
    whole: SampledData,
    kind: BlackBoxKind,
    choices: Iterable[OrderChoice],
    *,
    criterion: SelectionCriterion = "free run",
    units: Mapping[str, str] | None = None,
    report: Callable[[int, int, ScannedStructure], None] | None = None,
    policy: StructureScanPolicy = DEFAULT_SCAN,
) -> StructureScan:
    """`scan_structures` over a list of ``choices``; the chosen one is fitted to the ``whole`` data."""
    first, *others = folds
    data = to_sampled_data(first.estimation, whole.output, whole.inputs)
    listed, structures, began = list(choices), [], time.perf_counter()
    for done, orders in enumerate(listed, 1):
        try:
            model = fit_structure(data, kind, orders, policy=policy.search)
        except DataError as error:
            written = ", ".join(f"{letter} {orders[letter]}" for letter in ORDERS_BY_KIND[kind] if letter in orders)
            structure = ScannedStructure(f"{kind}({written})", orders, failure=str(error))
        else:
            structure = ScannedStructure(model.label, orders, model, free_run=_measure(first, model))
        structures.append(structure)
        if report is not None:
            report(done, len(listed), structure)
    if all(s.model is None for s in structures):
        raise DataError(
            structures[0].failure
            if structures
            else f"{kind}: no structure to fit; give at least one order of each kind"
        )
    structures = _add_criteria(structures)
    ranked, look = _rank([s for s in structures if s.model is not None], criterion), 1
    if others and criterion == "free run":
        # ARX models are cheap, and do not minimise the error of their free run: that on their own rows tells more.
        looks, look = (SECOND_LOOK_OF_ARX, FULL_FITS_OF_ARX) if kind == BlackBoxKind.ARX else (SECOND_LOOK, 1)
        looked_at = {id(s): _judge_again(s, whole, kind, others, policy.search) for s in ranked[:looks]}
        structures = [looked_at.get(id(s), s) for s in structures]
        ranked = _rank(list(looked_at.values()), criterion)
    chosen, best = _fit_in_full(ranked, whole, kind, policy.final_search, look)
    known_units = units or {}
    return StructureScan(
        tuple(structures),
        chosen,
        with_units(best, known_units),
        criterion,
        tuple(dict.fromkeys(e.name for fold in folds if fold.judged != fold.estimation for e in fold.judged)),
        known_units.get(whole.output, ""),
        time.perf_counter() - began,
        policy,
    )


def _measure(fold: Fold, model: BlackBox) -> float:
    """The free-run error; infinite where it diverges."""
    error = fold.score(model, model.output).rmse
    return error if np.isfinite(error) else np.inf


def _judge_again(
    structure: ScannedStructure,
    whole: SampledData,
    kind: BlackBoxKind,
    folds: Sequence[Fold],
    policy: PredictionErrorPolicy,
) -> ScannedStructure:
    """The structure with its error over all folds, each with a model of its own."""
    errors = [structure.free_run]
    for fold in folds:
        data = to_sampled_data(fold.estimation, whole.output, whole.inputs)
        try:
            errors.append(_measure(fold, fit_structure(data, kind, structure.orders, policy=policy)))
        except DataError:
            errors.append(np.inf)
    return replace(structure, free_run=float(np.sqrt(np.mean(np.square(errors)))), folds=len(errors))


# Structures that are fitted in full at most, best first.
FULL_FITS, FULL_FITS_OF_ARX = 3, 16


def _fit_in_full(
    ranked: Sequence[ScannedStructure], data: SampledData, kind: BlackBoxKind, policy: PredictionErrorPolicy, look: int
) -> tuple[ScannedStructure, BlackBox]:
    """The first structure whose model of all rows is stable and better than a constant on them; the first of all where none is.

    Of the first ``look`` the one that is best over held-out and own rows together, where there are several.
    """
    fitted: list[tuple[float, ScannedStructure, BlackBox]] = []
    reason = ""
    for structure in ranked[: max(look, FULL_FITS)]:
        try:
            # Once more on all rows: what was held out for the choice is worth its information.
            model = fit_structure(data, kind, structure.orders, policy=policy)
        except DataError as error:
            reason = str(error)
            continue
        score = Fold.of(data.experiments).score(model, data.output)
        # A model that was stable on fewer rows need not be so on all.
        sound = model.stable and score.rmse < score.movement
        fitted.append((float(np.hypot(structure.free_run, score.rmse)) if sound else np.inf, structure, model))
        if sound and look == 1:
            return structure, model
    if not fitted:
        raise DataError(reason)
    _, chosen, best = min(fitted, key=lambda each: each[0])
    return chosen, best


def fit_structure(
    data: SampledData, kind: BlackBoxKind, orders: OrderChoice, *, policy: PredictionErrorPolicy = DEFAULT_SEARCH
) -> BlackBox:
    """The model of these ``orders``, with ``at_rest`` for records that begin so. Raises DataError where it cannot be fitted."""
    offset, at_rest = bool(orders.get("offset", False)), bool(orders.get("at_rest", False))
    history: HistoryTreatment = "zero" if at_rest else "estimated"
    data = data.scaled("rest" if at_rest else "mean" if offset else "zero")
    if kind == BlackBoxKind.ARX:
        arx_orders = to_orders(data, orders["nb"], orders["nk"], orders["na"], kind)
        passes = 1 if orders.get("focus") == "simulation" else 0
        arx_history: Literal["zero", "measured"] = "zero" if at_rest else "measured"
        return fit_arx(data, arx_orders, history=arx_history, offset=offset, passes=passes)
    letters = {letter: orders[letter] for letter in ("nb", "nk", "na", "nf", "nc", "nd") if letter in orders}
    linear_kind = str(BlackBoxKind.OUTPUT_ERROR if kind == BlackBoxKind.HAMMERSTEIN else kind)
    structure = make_structure(linear_kind, data, **letters, offset=offset)
    if kind == BlackBoxKind.HAMMERSTEIN:
        return fit_hammerstein(structure, data, orders["shape"], orders["basis_size"], history, policy=policy)
    return fit_prediction_error(structure, data, STARTS[kind], history, policy=policy)


def get_linear_part(model: BlackBox) -> PolynomialModel:
    """The difference equation of ``model``."""
    return model.linear if isinstance(model, HammersteinModel) else model


def with_units(model: BlackBox, units: Mapping[str, str]) -> BlackBox:
    """``model`` with the units of its signals."""
    linear = replace(get_linear_part(model), units=dict(units))
    return replace(model, linear=linear) if isinstance(model, HammersteinModel) else linear


def _add_criteria(structures: Sequence[ScannedStructure]) -> list[ScannedStructure]:
    """The same with AIC and BIC on a common number of equations, so that losing a few rows to history is no gain."""
    n = min(get_linear_part(s.model).samples for s in structures if s.model is not None)
    result = []
    for structure in structures:
        if structure.model is None or structure.orders.get("focus") == "simulation":
            result.append(structure)  # the prefiltered loss is not comparable
            continue
        loss, p = get_linear_part(structure.model).loss, structure.model.parameters
        fit = n * np.log(loss) if loss > 0 else -np.inf
        # AIC = N ln V + 2 p, BIC = N ln V + p ln N (Ljung 1999, section 16.4)
        result.append(replace(structure, aic=fit + 2 * p, bic=fit + p * np.log(n)))
    return result


# Relative difference of free-run errors within which the simpler structure is chosen.
AS_GOOD = 0.005


def _rank(fitted: Sequence[ScannedStructure], criterion: SelectionCriterion) -> list[ScannedStructure]:
    """The structures, best first."""
    if criterion != "free run":
        return sorted(fitted, key=lambda s: s.aic if criterion == "aic" else s.bic)
    # An unstable model may run well over a short record and never over a longer one.
    pool = [s for s in fitted if s.model is not None and s.model.stable and np.isfinite(s.free_run)] or list(fitted)
    limit = (1 + AS_GOOD) * min(s.free_run for s in pool)

    def simplicity(structure: ScannedStructure) -> tuple[float, ...]:
        """Of structures that run equally well: the smallest BIC where it is about a one-step error, which can be white; else, because a
        free-run error is not and its BIC would go on praising coefficients, the fewest of these."""
        model = structure.model
        count = float(model.parameters) if model is not None else np.inf
        one_step = model is not None and get_linear_part(model).kind != BlackBoxKind.OUTPUT_ERROR
        if structure.free_run > limit:
            return (1.0, structure.free_run, count)
        # Of as many coefficients those without a direct share of the input, which no plant with inertia has.
        at_once = float(model is not None and any(model.feedthrough.values()))
        return (0.0, structure.bic if one_step else count, count, at_once, structure.free_run)

    return sorted(pool, key=simplicity)
