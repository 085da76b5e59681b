"""Fit a model to frequency responses, alone or together with records over time.

The model is linearised where the response was measured. Each complex point counts by its error over its standard deviation, its real and
its imaginary part as one residual each. The search begins on the logarithm of the response, where a resonance in the wrong place
still attracts, and ends on the response itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.base.errors import DataError, GreyboxError, nearest
from greybox.base.findings import Finding
from greybox.base.linear_algebra import pseudo_inverse
from greybox.base.values import Printable
from greybox.comparison.frequency.response import FrequencyResponse
from greybox.data.experiment import Experiment, as_records
from greybox.estimation.fit import fit
from greybox.estimation.linear.linearise import linearise
from greybox.estimation.objective import ResidualRows, SimulationErrorObjective, search_minimum
from greybox.estimation.optim.methods import MinimisationMethod, minimise
from greybox.estimation.optim.minimisation import TerminationStatus
from greybox.estimation.optim.quadratic_model import QuadraticModel
from greybox.estimation.options import FitOptions, resolve_options
from greybox.estimation.result import Fit
from greybox.estimation.result_parts import Estimate
from greybox.estimation.transcription.decision_vector import DecisionVector
from greybox.estimation.transcription.problem import prepare_problem
from greybox.estimation.transcription.simulation_error import Evaluation
from greybox.model.model import Model

# 97.5 % quantile of the normal distribution: half the width of a 95 % interval in standard deviations.
NORMAL_95 = 1.959963984540054
OperatingPoints = Mapping[str, float] | Sequence[Mapping[str, float]] | None


@dataclass(frozen=True, eq=False)
class FrequencyFit(Printable):
    """A model fitted to frequency responses.

    Attributes
    ----------
    model
        The model at the fitted values.
    parameters
        Name -> value with standard deviation and 95 % interval.
    names, covariance
        Free parameters, and their covariance (n, n).
    responses, fitted
        What was fitted, and the model's response (nf, ny, nu) at the same points.
    noise_ratio
        Root mean square of the weighted residuals of the responses: 1 means that only the stated noise is left.
    weighted
        Whether the responses state their noise; otherwise the covariance is scaled by the residual.
    status
        How the search ended.
    time_fit
        The fit to the records over time alone that the search began from; None without records.
    findings
        What the linearisation left out.
    """

    model: Model
    parameters: Mapping[str, Estimate]
    names: tuple[str, ...]
    covariance: np.ndarray
    responses: tuple[FrequencyResponse, ...]
    fitted: tuple[np.ndarray, ...]
    noise_ratio: float
    weighted: bool
    status: TerminationStatus
    time_fit: Fit | None = None
    findings: tuple[Finding, ...] = ()

    @property
    def success(self) -> bool:
        """Whether the search converged."""
        return self.status.success


# Step of a parameter for the slope of the response, over its size.
RESPONSE_FIT_DIFFERENCE = 1e-06
# Most steps on the logarithm of the response, whose minimum is wide: resonances far from the data attract.
LOG_ITERATIONS = 100
# Most steps on the response itself.
RESPONSE_FIT_ITERATIONS = 200
# Predicted decrease of the cost, in squared standard deviations, below which a search that cannot go on has ended well.
RESPONSE_FIT_CONVERGED = 0.001
# Error of points without a stated variance, over ``unknown_std``, below which it is rounding: beside records they weigh no more.
RESPONSE_FIT_EXACT = 1e-06


def fit_frequency_response(
    model: Model,
    responses: FrequencyResponse | Sequence[FrequencyResponse],
    experiments: Experiment | Sequence[Experiment] = (),
    *,
    at: OperatingPoints = None,
    noise: Mapping[str, float] | None = None,
    options: FitOptions | None = None,
) -> FrequencyFit:
    """Fit a model to frequency responses, and to records over time if there are any.

    Parameters
    ----------
    model
        The model with its start values; its free parameters are fitted.
    responses
        One or several responses; inputs and outputs are found by name.
    experiments
        Records over time that count as well, by their simulation error over its noise.
    at
        Operating point of the responses by name, see `linearise`; one for all, or one for each.
    noise
        Standard deviation of the outputs of the records; None estimates it.
    options
        How the records are simulated.

    Returns
    -------
    FrequencyFit
        Parameters with intervals.

    Raises
    ------
    DataError
        For signals that the model does not have, and where it has no free parameter.

    Examples
    --------
    >>> result = gb.frequency.fit_frequency_response(model, points)  # doctest: +SKIP
    >>> result.parameters["k"].interval  # doctest: +SKIP
    """
    group = (responses,) if isinstance(responses, FrequencyResponse) else tuple(responses)
    if not group:
        raise DataError("no frequency response; give at least one")
    points = [at] * len(group) if at is None or isinstance(at, Mapping) else list(at)
    if len(points) != len(group):
        raise DataError(
            f"at: {len(points)} operating points for {len(group)} responses; give one for each, or one for all"
        )
    names = tuple(q.name for q in model.free_parameters)
    if not names:
        raise DataError(f"{model.title} has no free parameter; free one")
    rows = _ResponseRows(model, names, group, tuple(points))
    records = as_records(experiments)
    time_fit = fit(model, records, noise=noise, options=options) if records else None
    start = np.array(
        [model.parameter(n).value if time_fit is None else time_fit.model.parameter(n).value for n in names]
    )
    search = _ScaledSearch.of(model, names, start)
    low, high = search.bounds
    # The logarithm first, whose valley is wide; the response itself last, whose errors are normal.
    for residual, iterations in ((rows.log_residual, LOG_ITERATIONS), (rows.residual, RESPONSE_FIT_ITERATIONS)):
        outcome = minimise(
            search.quadratic_model(residual, RESPONSE_FIT_DIFFERENCE),
            search.here,
            low,
            high,
            method=MinimisationMethod.GAUSS_NEWTON,
            scale=float(max(rows.count, 1)),
            iterations=iterations,
            thorough=False,
        )
        search = replace(search, values=search.values_at(outcome.z))
    values, status = search.values, outcome.status
    if (
        not status.success
        and outcome.value.predicted_decrease(low - outcome.z, high - outcome.z) <= RESPONSE_FIT_CONVERGED
    ):
        status = TerminationStatus.CONVERGED  # nothing is left to gain: exact data end at rounding
    weighted = all(r.variance is not None for r in group)
    freedom = max(rows.count - len(names), 1)
    scale = 1.0 if weighted else float(np.sum(rows.residual(values) ** 2)) / freedom
    slopes = search.slopes(rows.residual, values, RESPONSE_FIT_DIFFERENCE)
    # Without a stated variance the residual says how large it is: s^2 = V / (N - p).
    information = slopes.T @ slopes / max(scale, np.finfo(float).tiny)
    if time_fit is not None:
        resolved = resolve_options(options)
        problem = prepare_problem(_with_values(model, names, values), records, time_fit.noise.std, resolved)
        # Squares of the responses in units of their noise, as those of the records are in theirs.
        weight = 1 / max(scale, RESPONSE_FIT_EXACT**2)
        joint = _JointObjective(SimulationErrorObjective(problem), rows, names, weight, RESPONSE_FIT_DIFFERENCE)
        minimum = search_minimum(joint, resolved)
        variables, status = minimum.objective.variables, minimum.status
        if not status.success and minimum.evaluation.predicted_decrease(*variables.bounds()) <= RESPONSE_FIT_CONVERGED:
            status = TerminationStatus.CONVERGED
        optimum = minimum.objective.variables.here
        all_names = list(problem.model.system.parameter_names)
        chosen = [all_names.index(n) for n in names]
        values = variables.parameters(optimum)[chosen]
        moves = _differentiate(lambda z: variables.parameters(z)[chosen], optimum, RESPONSE_FIT_DIFFERENCE)
        # J C J': from the scaled unknowns of the joint fit to the constants.
        covariance = moves @ pseudo_inverse(minimum.evaluation.hessian / 2) @ moves.T
    else:
        covariance = pseudo_inverse(information)
    fitted_model = _with_values(model, names, values)
    errors = rows.residual(values)
    return FrequencyFit(
        fitted_model,
        _make_estimates(fitted_model, names, covariance),
        names,
        covariance,
        group,
        tuple(rows.respond(values)),
        float(np.sqrt(np.mean(errors**2))) if weighted else float("nan"),
        weighted,
        status,
        time_fit,
        linearise(fitted_model, points[0]).findings,
    )


# Standard deviation of a point, over its magnitude, where the response states none; the intervals are then scaled by the residual.
UNKNOWN_STD = 0.01


@dataclass(frozen=True, eq=False)
class _ResponseRows:
    """The residuals of responses as a function of the values (n,) of the free parameters."""

    model: Model
    names: tuple[str, ...]
    responses: tuple[FrequencyResponse, ...]
    points: tuple[Mapping[str, float] | None, ...]

    def __post_init__(self) -> None:
        for kind, known in (("inputs", self.model.inputs), ("outputs", self.model.outputs)):
            for response in self.responses:
                for name in getattr(response, kind):
                    if name not in [s.name for s in known]:
                        raise DataError(
                            f"{response.name}: model {self.model.title!r} has no {kind[:-1]} {name!r};"
                            f" {nearest(name, [s.name for s in known])}"
                        )

    @property
    def count(self) -> int:
        """Number of real residuals."""
        return 2 * sum(r.points for r in self.responses)

    def respond(self, values: np.ndarray) -> list[np.ndarray]:
        """The model's response (nf, ny, nu) at the points of each response."""
        model = _with_values(self.model, self.names, values)
        inputs, outputs = [i.name for i in model.inputs], [o.name for o in model.outputs]
        result = []
        for r, point in zip(self.responses, self.points, strict=True):
            linear = linearise(model, point, dt=r.sampling_time or None)
            whole = linear.frequency_response(2 * np.pi * r.frequency)
            rows, columns = [outputs.index(n) for n in r.outputs], [inputs.index(n) for n in r.inputs]
            result.append(whole[:, rows][:, :, columns])
        return result

    def residual(self, values: np.ndarray) -> np.ndarray:
        """Errors over their standard deviation, real and imaginary part of each point."""
        parts = []
        for r, fitted in zip(self.responses, self.respond(values), strict=True):
            std = UNKNOWN_STD * np.abs(r.response) if r.variance is None else np.sqrt(r.variance)
            # E|error|^2 = std^2 is shared by both parts: each has std / sqrt(2).
            error = ((r.response - fitted) / std * np.sqrt(2))[np.isfinite(r.response)]
            parts += [error.real, error.imag]
        return np.concatenate(parts)

    def log_residual(self, values: np.ndarray) -> np.ndarray:
        """Errors of magnitude and phase in logarithms and radians."""
        parts = []
        for r, fitted in zip(self.responses, self.respond(values), strict=True):
            known = np.isfinite(r.response) & (np.abs(r.response) > 0)
            # ln(G_m / G) = ln |G_m / G| + i (phase difference)
            error = np.log((r.response[known] / fitted[known]).astype(complex))
            parts += [error.real, error.imag]
        return np.concatenate(parts)


@dataclass(frozen=True, eq=False)
class _ScaledSearch:
    """Unknowns without unit: the logarithm of a parameter that is positive by its bounds, else the parameter over its size."""

    model: Model
    names: tuple[str, ...]
    values: np.ndarray
    positive: np.ndarray
    sizes: np.ndarray

    @classmethod
    def of(cls, model: Model, names: tuple[str, ...], start: np.ndarray) -> _ScaledSearch:
        """The unknowns from a start."""
        lows = np.array([model.parameter(n).bounds[0] for n in names])
        sizes = np.where(start != 0, np.abs(start), 1.0)
        # By its bounds: a constant that may be zero has no logarithm there.
        return cls(model, names, start, (lows > 0) & (start > 0), sizes)

    @property
    def here(self) -> np.ndarray:
        """The unknowns (n,) of the present values."""
        return self._to_unknowns(self.values)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Their bounds."""
        limits = np.array([self.model.parameter(n).bounds for n in self.names])
        return self._to_unknowns(limits[:, 0]), self._to_unknowns(limits[:, 1])

    def _to_unknowns(self, values: np.ndarray) -> np.ndarray:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(
                self.positive, np.log(np.where(self.positive, values / self.sizes, 1.0)), values / self.sizes
            )

    def values_at(self, z: np.ndarray) -> np.ndarray:
        """Values of the parameters."""
        return np.asarray(np.where(self.positive, np.exp(np.where(self.positive, z, 0.0)), z) * self.sizes)

    def quadratic_model(
        self, residual: Callable[[np.ndarray], np.ndarray], step: float
    ) -> Callable[[np.ndarray], QuadraticModel]:
        """The cost and its quadratic model as a function of the unknowns; infinite where there is no response."""

        def evaluate(z: np.ndarray) -> QuadraticModel:
            try:
                r = residual(self.values_at(z))
                slopes = _differentiate(lambda at: residual(self.values_at(at)), z, step)
            except (GreyboxError, np.linalg.LinAlgError):
                r, slopes = np.full(1, np.inf), np.zeros((1, len(z)))
            if not (np.isfinite(r).all() and np.isfinite(slopes).all()):
                return QuadraticModel(np.inf, np.zeros(len(z)), np.eye(len(z)))
            return QuadraticModel.from_residuals(slopes, r)

        return evaluate

    def slopes(self, residual: Callable[[np.ndarray], np.ndarray], values: np.ndarray, step: float) -> np.ndarray:
        """Slopes of the residual along the parameters themselves (N, n)."""
        return _differentiate(lambda s: residual(values + s * self.sizes), np.zeros(len(values)), step) / self.sizes


@dataclass(frozen=True, eq=False)
class _JointObjective:
    """The cost of records over time and of frequency responses together."""

    time: SimulationErrorObjective
    rows: _ResponseRows
    names: tuple[str, ...]
    weight: float
    step: float

    @property
    def variables(self) -> DecisionVector:
        """Those of the records."""
        return self.time.variables

    @property
    def squares(self) -> int:
        """Squares of both."""
        return self.time.squares + self.rows.count

    def at(self, variables: DecisionVector) -> _JointObjective:
        """The same cost over other variables."""
        return replace(self, time=self.time.at(variables))

    def evaluate(self, z: np.ndarray) -> Evaluation:
        """Both costs, and the sum of their quadratic models."""
        evaluation = self.time.evaluate(z)
        chosen = [self.time.problem.model.system.parameter_names.index(n) for n in self.names]
        try:
            residual = self.rows.residual(self.variables.parameters(z)[chosen])
            slopes = _differentiate(lambda at: self.rows.residual(self.variables.parameters(at)[chosen]), z, self.step)
        except (GreyboxError, np.linalg.LinAlgError):
            return replace(evaluation, cost=np.inf)
        return replace(
            evaluation,
            cost=evaluation.cost + self.weight * float(residual @ residual),
            gradient=evaluation.gradient + 2 * self.weight * slopes.T @ residual,
            hessian=evaluation.hessian + 2 * self.weight * slopes.T @ slopes,
            factor=None,
        )

    def linearise(self) -> ResidualRows:
        """The residuals of the records."""
        return self.time.linearise()

    def halve_step(self) -> _JointObjective:
        """The same with half the integration step."""
        return replace(self, time=self.time.halve_step())


def _differentiate(function: Callable[[np.ndarray], np.ndarray], z: np.ndarray, step: float) -> np.ndarray:
    """Slopes (N, n) by central differences."""
    columns = []
    for k in range(len(z)):
        width = step * max(abs(float(z[k])), 1.0)
        ends = [function(z + sign * width * np.eye(len(z))[k]) for sign in (1, -1)]
        columns.append((ends[0] - ends[1]) / (2 * width))
    return np.column_stack(columns)


def _with_values(model: Model, names: Sequence[str], values: np.ndarray) -> Model:
    limits = [model.parameter(n).bounds for n in names]
    inside = {n: float(np.clip(v, *b)) for n, v, b in zip(names, values, limits, strict=True)}
    return model.start(**inside)


def _make_estimates(model: Model, names: Sequence[str], covariance: np.ndarray) -> dict[str, Estimate]:
    std = dict(zip(names, np.sqrt(np.maximum(np.diag(covariance), 0.0)), strict=True))
    estimates = {}
    for q in model.all_parameters:
        spread = float(std[q.name]) if q.name in std else None
        interval = None if spread is None else (q.value - NORMAL_95 * spread, q.value + NORMAL_95 * spread)
        at_bound = spread is not None and q.value in q.bounds
        estimates[q.name] = Estimate(float(q.value), q.unit, spread, interval, spread is None, at_bound)
    return estimates
