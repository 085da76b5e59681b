"""Hammerstein models: each input passes a static nonlinearity before a linear difference equation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Literal, NoReturn, get_args

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from greybox.base.errors import DataError, ModelError, nearest
from greybox.base.values import Finding, Printable
from greybox.comparison.blackbox import prediction_error
from greybox.comparison.blackbox.linear_regression import (
    FunctionSignal,
    Orders,
    RowSignal,
    SampledData,
    each_block,
    refuse_few_rows,
    to_sampled_data,
)
from greybox.comparison.blackbox.polynomial import InitialChoice, PolynomialModel, PolynomialStructure
from greybox.comparison.blackbox.prediction_error_models import make_structure
from greybox.data.experiment import Experiment

# Static nonlinearities of an input: polynomials and piecewise linear functions, as sums of basis functions.

NonlinearityShape = Literal["polynomial", "piecewise"]


@dataclass(frozen=True)
class StaticNonlinearity:
    """``v = sum_j weights[j] g_j(d)`` of the deviation ``d = u - origin``, with ``v = 0`` at the origin.

    ``polynomial``: ``g_j = T_j(d / size) - T_j(0)`` with Chebyshev's ``T_j``, j = 1 ... . ``piecewise``: ``g_1 = d / size``, and a
    kink at every knot, ``g_j = (max(d - knot, 0) - max(-knot, 0)) / size``. ``size`` is the largest deviation in the records, and
    it and the ``knots`` are in the input's unit.
    """

    shape: NonlinearityShape
    size: float
    weights: tuple[float, ...]
    knots: tuple[float, ...] = ()
    origin: float = 0.0

    def basis(self, u: np.ndarray) -> np.ndarray:
        """The functions (N, m) of the input ``u`` (N,)."""
        d = u - self.origin
        if self.shape == "polynomial":
            degree = len(self.weights)
            # Orthogonal on the range: powers of d are nearly collinear. T_j(0) is taken off so that nothing flows at the origin.
            return (chebvander(d / self.size, degree) - chebvander(np.zeros(1), degree))[:, 1:]
        kinks = [np.maximum(d - k, 0.0) - max(-k, 0.0) for k in self.knots]
        return np.column_stack([d, *kinks]) / self.size

    def in_units(self, origin: float, size: float) -> StaticNonlinearity:
        """The curve of numbers as that of the signal ``origin + size * number``: as large as before beside its input."""
        return StaticNonlinearity(
            self.shape,
            self.size * size,
            tuple(size * w for w in self.weights),
            tuple(size * k for k in self.knots),
            origin,
        )

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """The curve's value (N,) at ``u`` (N,)."""
        return self.basis(np.asarray(u, float)) @ np.array(self.weights)

    def with_weights(self, weights: np.ndarray) -> StaticNonlinearity:
        """The same functions with other weights (m,)."""
        return replace(self, weights=tuple(map(float, weights)))


def find_levels(signals: Sequence[RowSignal]) -> np.ndarray:
    """The distinct values of an input over its records, ascending."""
    parts = (np.unique(signal[rows]) for signal in signals for rows in each_block(len(signal)))
    return reduce(np.union1d, parts, np.empty(0))


def make_linear_nonlinearity(shape: NonlinearityShape, u: np.ndarray, basis_size: int) -> StaticNonlinearity:
    """A straight line through zero with ``basis_size`` functions to bend it: the degree, or one more than the number of kinks.

    Kinks lie at equal fractions of the input's distinct values, so that each piece has data.
    """
    size = float(np.abs(u).max(initial=0.0)) or 1.0
    weights = (1.0, *(0.0,) * (basis_size - 1))
    if shape == "polynomial":
        return StaticNonlinearity(shape, size, weights)
    # By distinct values: an input that rests most of the time would put all kinks where it rests.
    levels = np.quantile(np.unique(u), np.arange(1, basis_size) / basis_size)
    return StaticNonlinearity(shape, size, weights, tuple(map(float, levels)))


@dataclass(frozen=True, eq=False)
class HammersteinModel(Printable):
    """``curves`` (one for each input) followed by ``linear``, whose inputs are the curves' values.

    The curve and the gain behind it share one scale: each curve is as large (rms over the records) as its input, and goes up.
    """

    curves: tuple[StaticNonlinearity, ...]
    linear: PolynomialModel

    @property
    def kind(self) -> str:
        """``hammerstein``; ``linear.kind`` is ``output error`` or ``arx``."""
        return "hammerstein"

    @property
    def output(self) -> str:
        """Name of the output."""
        return self.linear.output

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return self.linear.inputs

    @property
    def sampling_time(self) -> float:
        """Seconds from sample to sample."""
        return self.linear.sampling_time

    @property
    def label(self) -> str:
        """Kind, the curves' degree or number of pieces, and the linear part's orders."""
        sizes = [f"{'degree' if c.shape == 'polynomial' else 'pieces'} {len(c.weights)}" for c in self.curves]
        return f"hammerstein({', '.join(sizes)}; {self.linear.label})"

    @property
    def model(self) -> NoReturn:
        """None: as a plant it would have constants of its own. Raises ModelError."""
        raise ModelError(
            f"{self.label}: each curve shares its scale with the gain behind it, so that neither is a constant that could be fitted;"
            " fit its linear part, linear, to the values of the curves"
        )

    @property
    def rest(self) -> float:
        """That of ``linear``."""
        return self.linear.rest

    @property
    def history(self) -> str:
        """That of ``linear``."""
        return self.linear.history

    @property
    def parameters(self) -> int:
        """Number of estimated numbers; each curve's scale is not one."""
        return self.linear.parameters + sum(len(c.weights) - 1 for c in self.curves)

    @property
    def stable(self) -> bool:
        """Whether every pole lies inside the unit circle."""
        return self.linear.stable

    @property
    def feedthrough(self) -> dict[str, float]:
        """Direct share of each curve in the output of the same row."""
        return self.linear.feedthrough

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What one should know before trusting it."""
        return self.linear.findings

    def simulate(
        self, experiment: Experiment, *, initial: InitialChoice = "estimated", rows: int | None = None
    ) -> dict[str, np.ndarray]:
        """Free run ``{output: (N,)}``, as `PolynomialModel.simulate`."""
        return self.linear.simulate(self._transform(experiment), initial=initial, rows=rows)

    def predict(
        self, experiment: Experiment, steps: int = 1, *, initial: InitialChoice = "estimated", rows: int | None = None
    ) -> dict[str, np.ndarray]:
        """Prediction ``{output: (N,)}``, as `PolynomialModel.predict`."""
        return self.linear.predict(self._transform(experiment), steps, initial=initial, rows=rows)

    def _transform(self, experiment: Experiment) -> Experiment:
        absent = [name for name in self.inputs if name not in experiment.inputs]
        if absent:
            raise DataError(
                f"experiment {experiment.name!r}: no input {absent[0]!r}; {nearest(absent[0], experiment.inputs)}"
            )
        transformed = {
            name: curve(experiment.inputs[name]) for name, curve in zip(self.inputs, self.curves, strict=True)
        }
        return replace(experiment, inputs={**experiment.inputs, **transformed})


def hammerstein(
    experiments: Experiment | Sequence[Experiment],
    *,
    nb: int | Sequence[int],
    nk: int | Sequence[int] = 1,
    nf: int | Sequence[int] = 0,
    na: int = 0,
    shape: NonlinearityShape = "polynomial",
    basis_size: int = 3,
    output: str | None = None,
    inputs: Sequence[str] | str | None = None,
    history: prediction_error.HistoryTreatment = "estimated",
    offset: bool = False,
) -> HammersteinModel:
    """Fit ``y = sum_i B_i(q) / F_i(q) v_i + e`` with static nonlinearities ``v_i = g_i(u_i)``.

    The mean square free-run error is minimised. With ``na`` in place of ``nf`` the linear part is an ARX model,
    ``A(q) y = sum_i B_i(q) v_i + e``, and the one-step error is minimised. The search adjusts nonlinearity and linear part
    together; it starts from linear estimates in which every basis function is an input of its own (Bai 1998).

    Parameters
    ----------
    experiments
        One or more records of the same sampling time.
    nb, nk, nf
        Numerator coefficients, delay in samples and poles: one number for all inputs, or one for each (see `output_error`).
    na
        Poles of an ARX model; leave ``nf`` at 0 then.
    shape
        ``"polynomial"``, or ``"piecewise"`` linear (a dead zone, a saturation).
    basis_size
        Degree of the polynomial, or number of linear pieces.
    output
        Name of the output; needed where the records have several.
    inputs
        Names of the inputs; None takes all.
    history
        ``"estimated"``: what lies before each record is estimated with it. ``"zero"``: everything was zero there.
    offset
        Whether the equation has a constant, for signals that do not rest at zero.

    Returns
    -------
    HammersteinModel
        The nonlinearities and the linear model behind them. Coefficients have no covariance.

    Raises
    ------
    DataError
        For irregular time, unknown names, impossible orders, too few rows, and coefficients that the record cannot tell apart.

    Examples
    --------
    >>> model = gb.blackbox.hammerstein(record, nb=2, nf=2, shape="piecewise", basis_size=3)  # doctest: +SKIP
    """
    prediction_error.check_history(history)
    if shape not in get_args(NonlinearityShape):
        raise DataError(f"unknown shape {shape!r}; {nearest(shape, get_args(NonlinearityShape))}")
    if int(basis_size) != basis_size or basis_size < 1:
        raise DataError(f"hammerstein: basis_size = {basis_size}; give a whole number from 1 (1: a straight line)")
    data = to_sampled_data(experiments, output, inputs)
    if na and np.any(nf):
        raise DataError(
            f"hammerstein: na = {na} and nf = {nf}; the linear part is an ARX model (na) or an output error (nf)"
        )
    kind = "arx" if na else "output error"
    structure = make_structure(kind, data, nb=nb, nk=nk, na=na, nf=nf, offset=offset, refused_as="hammerstein")
    # Zeros before the record are a statement about the signals as they are.
    data = data.scaled("mean" if offset and history != "zero" else "zero")
    model = fit_hammerstein(structure, data, shape, basis_size, history)
    return replace(model, linear=model.linear.from_zero())


def fit_hammerstein(
    structure: PolynomialStructure,
    data: SampledData,
    shape: NonlinearityShape,
    basis_size: int,
    history: prediction_error.HistoryTreatment,
    policy: prediction_error.PredictionErrorPolicy = prediction_error.DEFAULT_SEARCH,
) -> HammersteinModel:
    """The model of this structure with nonlinearities of ``basis_size`` functions in front, for scaled data."""
    curves = tuple(
        make_linear_nonlinearity(shape, find_levels([r.signals[i] for r in data.records]), basis_size)
        for i in range(len(data.inputs))
    )
    records = tuple(
        replace(r, basis=tuple(FunctionSignal(u[:], c.basis) for u, c in zip(r.signals, curves, strict=True)))
        for r in data.records
    )
    data = replace(data, records=records)
    problem = _HammersteinProblem(
        structure, data, prediction_error.split_records(data, structure), history == "zero", curves
    )
    label = HammersteinModel(curves, structure.model(np.zeros(structure.size), data)).label
    count = int(sum(np.isfinite(part.y).sum() for part in problem.parts))
    refuse_few_rows(data, label, count, problem.size, history)
    starts = sorted(problem.starts(), key=lambda start: start[0].evaluate(start[1], False).squares)
    # Short searches from the best starts, a long one from the best of these.
    minima = [
        (p, prediction_error.minimise_prediction_errors(p, theta, policy=policy, iterations=policy.first_iterations))
        for p, theta in starts[: policy.starts]
    ]
    problem, best = min(minima, key=lambda pair: pair[1].errors.squares)
    if not best.converged:
        best = prediction_error.minimise_prediction_errors(problem, best.theta, policy=policy)
    return _finish(problem, best, count, label, history)


@dataclass(frozen=True, eq=False)
class _HammersteinProblem(prediction_error.PredictionErrorProblem):
    """The unknowns: coefficients of the linear part, then the weights of each curve without its largest, which sets the scale."""

    curves: tuple[StaticNonlinearity, ...]

    @property
    def fixed_weights(self) -> list[int]:
        """Of each curve, the number of the weight that stays."""
        return [int(np.argmax(np.abs(c.weights))) for c in self.curves]

    @property
    def size(self) -> int:
        return self.structure.size + sum(len(c.weights) - 1 for c in self.curves)

    def join(self, linear: np.ndarray) -> np.ndarray:
        """The vector of all unknowns from the coefficients of the linear part."""
        free = [np.delete(c.weights, k) for c, k in zip(self.curves, self.fixed_weights, strict=True)]
        return np.concatenate([linear, *free])

    def weights(self, theta: np.ndarray) -> list[np.ndarray]:
        """All weights of each curve."""
        counts = [len(c.weights) - 1 for c in self.curves]
        free = np.split(theta[self.structure.size :], np.cumsum(counts)[:-1])
        return [
            np.insert(part, k, c.weights[k]) for part, k, c in zip(free, self.fixed_weights, self.curves, strict=True)
        ]

    def stabilise(self, theta: np.ndarray) -> np.ndarray:
        n = self.structure.size
        return np.append(prediction_error.stabilise(self.structure, theta[:n]), theta[n:])

    def evaluate(self, theta: np.ndarray, with_gradient: bool) -> prediction_error.PredictionErrors:
        n, weights = self.structure.size, self.weights(theta)
        curves = [c.with_weights(w) for c, w in zip(self.curves, weights, strict=True)]
        parts = tuple(
            replace(p, signals=tuple(FunctionSignal(b.values, c) for b, c in zip(p.basis, curves, strict=True)))
            for p in self.parts
        )
        linear = prediction_error.PredictionErrorProblem(self.structure, self.data, parts, self.rest)
        errors = linear.evaluate(theta[:n], with_gradient)
        if not with_gradient:
            return errors
        # The largest weight of each curve sets its scale and stays: curve and gain could trade a factor for ever.
        fixed = (n + np.cumsum([0, *(len(c.weights) for c in self.curves)])[:-1] + self.fixed_weights).astype(int)
        assert errors.triangle is not None
        # Without some of its columns a triangle is one no longer: reduced again.
        kept = np.delete(errors.triangle, fixed, axis=1)
        return replace(errors, triangle=np.asarray(np.linalg.qr(kept, mode="r")))

    def starts(self) -> Iterator[tuple[_HammersteinProblem, np.ndarray]]:
        """Linear estimates with every basis function as an input of its own, their numerators then made multiples of one
        (the nearest matrix of rank one, Bai 1998)."""
        orders, counts = self.structure.orders, [len(c.weights) for c in self.curves]
        wide_orders = Orders(orders.na, tuple(np.repeat(orders.nb, counts)), tuple(np.repeat(orders.nk, counts)))
        wide = replace(self.structure, orders=wide_orders, nf=tuple(np.repeat(self.structure.nf, counts)))
        single = [[c.with_weights(w) for w in np.eye(m)] for c, m in zip(self.curves, counts, strict=True)]
        records = tuple(
            replace(
                r,
                signals=tuple(
                    FunctionSignal(b.values, c) for b, each in zip(r.basis, single, strict=True) for c in each
                ),
                basis=(),
            )
            for r in self.data.records
        )
        names = tuple(f"{name} {j}" for name, m in zip(self.data.inputs, counts, strict=True) for j in range(m))
        data = replace(self.data, inputs=names, records=records)
        estimate_starts = (
            prediction_error.estimate_armax_starts if orders.na else prediction_error.estimate_output_error_starts
        )
        for start in estimate_starts(wide, data, self.rest):
            a, *parts = wide.parts(start)
            b, f, remainder = parts[: len(names)], parts[len(names) : 2 * len(names)], parts[2 * len(names) :]
            weights, numerators, poles = [], [], []
            for first, m in zip(np.cumsum([0, *counts[:-1]]), counts, strict=True):
                # b_j = w_j b for every basis function j: the nearest matrix of rank one gives weights and numerator
                # (Bai 1998).
                left, size, right = np.linalg.svd(np.stack(b[first : first + m]), full_matrices=False)
                weights.append(left[:, 0])
                numerators.append(size[0] * right[0])
                # Of the basis function with the largest weight: its estimate of the poles is the least noisy.
                poles.append(f[first + int(np.argmax(np.abs(left[:, 0])))])
            curves = tuple(c.with_weights(w) for c, w in zip(self.curves, weights, strict=True))
            problem = replace(self, curves=curves)
            yield problem, problem.stabilise(problem.join(np.concatenate([a, *numerators, *poles, *remainder])))


def _finish(
    problem: _HammersteinProblem,
    best: prediction_error.PredictionErrorMinimum,
    count: int,
    label: str,
    history: str,
) -> HammersteinModel:
    structure, data = problem.structure, problem.data
    model = structure.model(best.theta[: structure.size], data)
    names = list(model.coefficients)
    several = len(data.inputs) > 1
    for name, c in zip(data.inputs, problem.curves, strict=True):
        names += [f"curve{f'[{name}]' if several else ''} {j}" for j in range(1, len(c.weights))]
    prediction_error.refuse_collinear(best.errors, names, label)
    curves, b = [], []
    for i, (curve, weights) in enumerate(zip(problem.curves, problem.weights(best.theta), strict=True)):
        products = np.zeros((2, 2))
        for record in data.records:
            for rows in each_block(record.rows):
                u = record.signals[i][rows]
                both = np.stack([u, curve.with_weights(weights)(u)])
                products += both @ both.T
        # Curve as large as its input over the records and rising with it; the numerator takes the factor back.
        scale = np.sqrt(products[0, 0] / products[1, 1]) * (1.0 if products[0, 1] >= 0 else -1.0)
        curves.append(curve.with_weights(weights * scale))
        b.append(model.b[i] / scale)
    freedom = count - problem.size - best.errors.states
    linear = prediction_error.finish_model(replace(model, b=tuple(b)), best, count, max(freedom, 1), history)
    scaling = data.scaling
    _, *origins = scaling.origins
    # Each curve is zero at the origin of its input.
    linear = replace(linear.in_units(scaling), origins=(scaling.origins[0], *(0.0 for _ in origins)))
    in_units = zip(curves, origins, scaling.sizes[1:], strict=True)
    return HammersteinModel(tuple(curve.in_units(origin, size) for curve, origin, size in in_units), linear)
