"""Where an estimation ended: runs, residuals with their slopes, covariance and tests, each computed once; or restored from a fit.

`SimulationOptimum` is the end of an estimation by simulation error, `PredictionOptimum` of one by prediction error. `assemble_fit` makes
a `greybox.estimation.result.Fit` of either.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from greybox.base import TINY, FitError
from greybox.base.values import with_code
from greybox.data.findings import RecordCode
from greybox.data.input_course import Hold, Holds
from greybox.data.noise.noise_model import AutoRegression, NoiseModel, NoiseSource
from greybox.estimation.covariance import ParameterCovariance, estimate_covariance, estimate_likelihood_covariance
from greybox.estimation.errors import compute_misfits
from greybox.estimation.noise_loop import without_bursts
from greybox.estimation.objective import (
    LikelihoodMaximum,
    Objective,
    PredictionErrorObjective,
    ProcessNoiseTest,
    ResidualRows,
    SimulationErrorObjective,
)
from greybox.estimation.optim.minimisation import TerminationStatus
from greybox.estimation.options import FitOptions, RobustLoss
from greybox.estimation.parameter_constancy import ParameterShift, expect_noise, find_parameter_shifts
from greybox.estimation.result import Fit
from greybox.estimation.result_parts import Misfit, PredictionReport, Trace
from greybox.estimation.sandwich import ResidualColour, estimate_residual_colour
from greybox.estimation.transcription.decision_vector import DecisionVector
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.estimation.transcription.problem import EstimationProblem, Runs, Solution
from greybox.estimation.transcription.shooting_cost import Evaluation
from greybox.model import Model
from greybox.simulation.kernel.record import Record
from greybox.simulation.plant import PlantModel
from greybox.simulation.plant_kernel import PlantKernel
from greybox.simulation.records import to_record


def make_traces(problem: EstimationProblem, runs: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[Trace, ...]:
    """Each record with the model's run over it: outputs (N, ny) and states (N, nx) for each."""
    states = problem.model.system.state_names
    result = []
    for experiment, record, (y, x) in zip(problem.experiments, problem.records, runs, strict=True):
        y, x, seen, given = (record.samples(rows) for rows in (y, x, record.y, record.u))
        unknown = record.count_unknown_rows(problem.step) // record.rows_per_sample
        if unknown:
            seen = seen.copy()
            seen[:unknown] = np.nan
        # The signals of the record themselves, which no one has to copy; what it lacks is a column of its own.
        measured = {
            o.name: seen[:, j] if unknown else experiment.outputs.get(o.name, seen[:, j])
            for j, o in enumerate(problem.model.outputs)
            if np.isfinite(seen[:, j]).any()
        }
        simulated = {o.name: y[:, j] for j, o in enumerate(problem.model.outputs) if o.name in measured}
        start = dict(zip(states, map(float, x[0]), strict=True))
        inputs = {i.name: experiment.inputs.get(i.name, given[:, j]) for j, i in enumerate(problem.model.inputs)}
        result.append(
            Trace(
                experiment.name,
                experiment.fingerprint,
                experiment.time,
                measured,
                simulated,
                start,
                inputs,
                experiment.hold,
                dict(experiment.conditions),
                {name: std for name, std in experiment.noise.items() if name in measured},
                experiment.before,
                experiment.before_ages,
            )
        )
    return tuple(result)


@dataclass(frozen=True, eq=False)
class OtherCourse:
    """What other ``courses`` (input -> course) between the rows, or one for all signals, make of an optimum: the ``change`` of each free
    constant (nf,), and by how much the cost is less; None where no step compares them: of a run that is joined
    from segments, or that leads elsewhere."""

    courses: Mapping[str, str] | str
    change: np.ndarray | None = None
    gain: float = 0.0


# Loss that a step leaves, over what it gains, from which no second one is taken: what the curvature of a plant changes of the first, a few
# per cent of its gain, brings no such loss back.
NO_SECOND_STEP = 0.25
# Gain by inputs that act earlier, linearised, from which means are tried: chance alone gives it to one fit of 24. That means fit better is
# said from twice this gain.
EARLIER_GAINS = 3.0
# Rows by which they act earlier at least: means do by a half or a whole one, and a strong record shows chance parts of a thousandth.
LEAST_EARLIER = 0.1
# Draws of the noise of inputs, each with both signs: standard deviations by them are right within 25 % (one over the root of 2 n).
INPUT_NOISE_DRAWS = 8
# Twice the logarithm of the odds by which the records have to miss the fastest part of an input for its noise to be one that acted.
NOISE_ACTED = 6.0
# Differences of the fourth order over their largest gain: 1 at half the sampling rate, 1 % at a tenth of it.
FASTEST_PART = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 16


@dataclass(frozen=True, eq=False)
class InputNoise:
    """What the noise of measured inputs does to an optimum.

    ``levels``: input -> its standard deviation; ``bias`` of each free constant (nf,), and ``spread`` (nf, nf), the covariance that it adds.
    """

    levels: Mapping[str, float]
    bias: np.ndarray
    spread: np.ndarray


def _find_fastest(u: np.ndarray) -> np.ndarray:
    """The fastest part of inputs (N, nu)."""
    padded = np.pad(u, ((2, 2), (0, 0)), mode="edge")
    return sum(c * padded[k : k + len(u)] for k, c in enumerate(FASTEST_PART))


@dataclass(frozen=True, eq=False)
class Optimum(ABC):
    """The end of an estimation of ``model``.

    ``solution``: that by simulation error, which is the estimate itself or where its search began.
    """

    model: Model
    solution: Solution

    tests: Sequence[ProcessNoiseTest] = ()
    """Of the intensities of process noise."""

    @property
    @abstractmethod
    def search(self) -> Solution | LikelihoodMaximum:
        """How the search ended, and the work it took."""

    @property
    @abstractmethod
    def problem(self) -> EstimationProblem:
        """The problem with the noise as it is known at the optimum."""

    @property
    @abstractmethod
    def objective(self) -> Objective:
        """What was minimised, the present point being the optimum."""

    @property
    @abstractmethod
    def runs(self) -> Runs:
        """For each record the outputs (N, ny) of the free run, and its states, of which there is the first row at least."""

    @property
    @abstractmethod
    def residuals(self) -> ResidualRows | None:
        """The weighted residuals or innovations, and their slopes; None where there are none."""

    @property
    @abstractmethod
    def colour(self) -> ResidualColour:
        """Colour and variance of these."""

    @property
    @abstractmethod
    def covariance(self) -> ParameterCovariance:
        """Of the free constants."""

    @property
    def variables(self) -> DecisionVector:
        """The constants and initial states, ``z = 0`` at the optimum."""
        return self.objective.variables

    @cached_property
    def fitted_model(self) -> Model:
        """The model with the fitted values."""
        return self.model.start(**dict(zip(self.model.values, self.variables.fixed.tolist(), strict=True)))

    @property
    def evaluation(self) -> Evaluation:
        """The cost at the optimum with its quadratic model."""
        return self.search.evaluation

    @property
    def status(self) -> TerminationStatus:
        """How the search ended."""
        return self.search.status

    @property
    def discretisation(self) -> str:
        """How the model was integrated."""
        return self.solution.discretisation or self.problem.step.label

    @cached_property
    def traces(self) -> tuple[Trace, ...]:
        """Each record with the free run over it."""
        return make_traces(self.problem, self.runs)

    @cached_property
    def misfit(self) -> Mapping[str, Misfit]:
        """Free-run error of each output."""
        return compute_misfits(self.problem, self.traces)

    @cached_property
    def step_shift(self) -> np.ndarray:
        """Change of each free constant (nf,) when the step is halved, over its standard deviation.

        Zero for a discretisation that is exact. NaN where the finer run overflows or the deviation is unknown. The steps to the optimum
        at the present step and at half of it are compared, so that what the search has left over does not count.
        """
        variables = self.variables
        change = self._compute_step_change()[: len(variables.which)]
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(
                change == 0, 0.0, np.abs(change * variables.spans) / np.sqrt(np.diag(self.covariance.covariance))
            )

    def _compute_step_change(self) -> np.ndarray:
        """Change of the unknowns, or of the first of them, in ``z`` with half the step."""
        variables = self.objective.variables
        if self.solution.problem.step.per_interval or not len(variables.which):
            return variables.here
        finer = self.objective.halve_step().evaluate(variables.here)
        if not (np.isfinite(finer.cost) and np.isfinite(self.evaluation.cost)):
            return np.full(variables.size, np.nan)
        bounds = variables.bounds()
        # The steps to the optimum at half the step and at the whole one: their difference is that of the optima.
        return finer.bounded_step(*bounds) - self.evaluation.bounded_step(*bounds)

    @cached_property
    def _step_here(self) -> tuple[np.ndarray, float]:
        """What one step from the end itself gives, as `_step_with`: what the search has left over."""
        bounds = self._step_bounds
        evaluation = self.evaluation
        return evaluation.bounded_step(*bounds), evaluation.cost - evaluation.predicted_decrease(*bounds)

    @cached_property
    def _step_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of a step in ``z`` that leaves the noise as it is: of a likelihood far off its optimum one step says nothing of it."""
        variables, bounds = self.variables, self.variables.bounds()
        noise = [k for k, name in enumerate(variables.names) if name in self.problem.model.noise_parameters]
        for limits in bounds:
            limits[[*noise, *range(variables.slices.noise_levels.start, variables.size)]] = 0.0
        return bounds

    def _step_with(self, records: tuple[Record, ...], steps: int = 1) -> tuple[np.ndarray, float] | None:
        """Change of each free constant (nf,) by some steps with other ``records`` of the same rows, and by how much the cost is less then.

        The steps to the optimum with these and with the present records are compared, so that what the search has left over does not count.
        None where the runs over them are not finite, and where of two steps the second still promises more than the loss that is seen.
        """
        variables, (low, high), objective = self.variables, self._step_bounds, self.objective.with_records(records)
        gone, result, (step, cost) = np.zeros(variables.size), None, self._step_here
        for _ in range(steps):
            evaluation = objective.evaluate(variables.here + gone)
            if not (np.isfinite(evaluation.cost) and evaluation.is_finite):
                break
            limits = low - gone, high - gone
            promised = evaluation.predicted_decrease(*limits)
            gone, gain = gone + evaluation.bounded_step(*limits), cost - evaluation.cost + promised
            if result is None or gain > result[1]:
                result = (gone - step)[: len(variables.which)] * variables.spans, float(gain)
            if gain < -NO_SECOND_STEP * promised:
                break
        else:
            # Of a plant that falls over the steps have led elsewhere: what fits there is not known.
            if steps > 1 and promised > -gain > 0:
                return None
        return result

    @property
    def _can_compare(self) -> bool:
        """Whether there is an end that other records can be held against."""
        return bool(len(self.variables.which) and np.isfinite(self.evaluation.cost))

    @cached_property
    def other_courses(self) -> tuple[OtherCourse, ...]:
        """For each input that may move otherwise between its rows, by its values, and for all of these: what one step with it gives."""
        problem, courses = self.problem, dict[str, str]()
        present, swapped, result = problem.records, dict[str, tuple[Record, ...]](), []
        for column, i in enumerate(problem.model.inputs if self._can_compare else ()):
            records = tuple(
                record.with_other_course(column, i.name) if i.name in e.open_inputs else record
                for record, e in zip(present, problem.experiments, strict=True)
            )
            changed = [k for k, (a, b) in enumerate(zip(records, present, strict=True)) if a is not b]
            if changed:
                courses[i.name] = "first" if records[changed[0]].is_linear[column] else "zero"
                swapped[i.name] = records
        # One of two inputs that both move otherwise may fit worse alone: the error of the one made up for that of the other.
        for names in [*([n] for n in courses), *([list(courses)] if len(courses) > 1 else [])]:
            records = present
            for n in names:
                column = [i.name for i in problem.model.inputs].index(n)
                pairs = zip(records, swapped[n], present, strict=True)
                records = tuple(r if s is o else r.with_other_course(column, n) for r, s, o in pairs)
            # Far from this optimum a second step corrects what the first foretold of a curved plant; where runs have a price one is enough.
            steps = 1 if isinstance(problem.kernel, PlantKernel) else 2
            seen = None if self.solution.joined else self._step_with(records, steps)
            result.append(OtherCourse({n: courses[n] for n in names}, *(seen or ())))
        result += self._bow_straight_courses()
        # A meter writes means over the interval that ends at its row, which held from there on act late; a sensor beside it may not.
        inputs: dict[str, Hold] = dict.fromkeys([i.name for i in problem.model.inputs], "mean")
        can_be_means = (
            inputs and self._can_compare and not self.solution.joined and self._gain_by_acting_earlier > EARLIER_GAINS
        )
        for hold in ("mean", inputs) if can_be_means else ():
            if (means := self._read_means(hold)) and (seen := self._step_with(means)):
                result.append(OtherCourse(hold, *seen))
        return tuple(result)

    def _bow_straight_courses(self) -> Iterator[OtherCourse]:
        """For each smooth input that was taken straight because nobody told its course, what steps with a curve through its rows give."""
        problem = self.problem
        if self.solution.joined or isinstance(problem.kernel, PlantKernel) or not self._can_compare:
            return
        for column, i in enumerate(problem.model.inputs):
            records = tuple(
                record.with_bowed_course(column)
                if any(f.subject == i.name for f in with_code(e.findings, RecordCode.INPUT_TAKEN_STRAIGHT))
                else record
                for record, e in zip(problem.records, problem.experiments, strict=True)
            )
            is_bowed = any(a is not b for a, b in zip(records, problem.records, strict=True))
            if is_bowed and (seen := self._step_with(records, 2)):
                yield OtherCourse({i.name: "band-limited"}, *seen)

    @cached_property
    def _gain_by_acting_earlier(self) -> float:
        """By how much the cost is less, linearised, if all inputs act earlier by a tenth of a row or more; infinite if not known.

        Inputs that are means act a row earlier than held ones, and readings that are means too were made half a row before their stamps:
        from one row to the next a plant that does not know the time moves on along its run. That is Rao's score test (1948): of the
        residual ``r`` that the slopes have left, the part along this way ``d``, less what the unknowns make of it.
        """
        residuals, problem = self.residuals, self.problem
        is_even = all(len(r.lengths) == 1 and r.rows_per_sample == 1 for r in problem.records)
        if not (residuals and is_even and problem.is_plain_squares):
            return np.inf
        variables, along = self.variables, np.zeros(self.variables.size)
        # What was not measured counts nothing.
        rows = [(r, J) if np.isfinite(r).all() else (np.nan_to_num(r), np.nan_to_num(J)) for r, J in residuals.rows]
        advances = []
        for e, ((y, _), (r, _), (_, slopes)) in enumerate(zip(self.runs, residuals.rows, rows, strict=True)):
            # The last row has no next one: it moves on as the one before.
            advance = np.diff(y, axis=0, append=2 * y[-1:] - y[-2:-1]) / problem.noise.std
            advances.append(np.where(np.isfinite(r), advance, 0.0))
            along[variables.columns(e)] += np.tensordot(advances[-1], slopes)
        # The unknowns that are inside their bounds make up for what lies along their slopes: min |d + J z|^2.
        low, high = self._step_bounds
        free, step = (low < 0) & (high > 0), np.zeros(variables.size)
        step[free] = np.linalg.lstsq(self.evaluation.hessian[np.ix_(free, free)] / 2, -along[free], rcond=None)[0]
        matched, size = 0.0, 0.0
        for e, (advance, (r, slopes)) in enumerate(zip(advances, rows, strict=True)):
            left = advance + slopes @ step[variables.columns(e)]
            matched, size = matched + np.sum(r * left), size + np.sum(left**2)
        # |r|^2 - |r - a d|^2 = a (2 r'd - a d'd), greatest for a = r'd / d'd rows; the other way is later.
        rows_earlier = max(matched / max(size, TINY), LEAST_EARLIER)
        return float(rows_earlier * (2 * matched - rows_earlier * size))

    def _read_means(self, hold: Holds) -> tuple[Record, ...] | None:
        """The records if signals are means as ``hold`` says; None where that was told, or an effect says when an input acts."""
        problem, model = self.problem, self.problem.model
        is_told = any(b.effect.hold or b.effect.late for b in model.bound_effects) or isinstance(model, PlantModel)
        if is_told or any(
            not {*e.courses.values()} <= {"zero", "first"} or e.outputs_are_means for e in problem.experiments
        ):
            return None
        pairs = zip(problem.experiments, problem.records, strict=True)
        return tuple(replace(to_record(model, e.with_hold(hold)), spread=r.spread, log_std=r.log_std) for e, r in pairs)

    @cached_property
    def input_noise(self) -> InputNoise | None:
        """What the noise of sensors in the inputs does to the constants; None where no input shows noise, or the runs show that it acted.

        Noise ``e`` of an input that acted as ``u`` enters the run as ``G e``, which the residual holds as ``-G e``. More noise of the same
        size does once more to the constants what is there does (simulation extrapolation: Cook and Stefanski, Journal of the American
        Statistical Association 89, 1994): draws of both signs tell the covariance that it adds, half their difference, and the bias, their
        mean.
        """
        problem = self.problem
        names = [i.name for i in problem.model.inputs]
        levels = [np.array([e.input_noise[n] for n in names]) for e in problem.experiments]
        if (
            self.solution.joined
            or not (self._can_compare and np.any(levels))
            or any(r.rows_per_sample > 1 for r in problem.records)
        ):
            return None
        rng, odd, even = np.random.default_rng(0), list[np.ndarray](), list[np.ndarray]()

        def move(shifts: Sequence[np.ndarray]) -> tuple[np.ndarray, float] | None:
            pairs = zip(problem.records, shifts, strict=True)
            return self._step_with(tuple(record.with_inputs(record.u + shift, names) for record, shift in pairs))

        # Without its fastest part an input that was measured so fits no worse; noise that acted, as a command in a loop, is missed.
        fastest = [
            np.where(level > 0, _find_fastest(r.u), 0.0) for level, r in zip(levels, problem.records, strict=True)
        ]
        smoothed = move([-shift for shift in fastest])
        if smoothed is None or smoothed[1] < -NOISE_ACTED:
            return None
        for _ in range(INPUT_NOISE_DRAWS):
            draw = [level * rng.normal(size=r.u.shape) for level, r in zip(levels, problem.records, strict=True)]
            one, other = move(draw), move([-shift for shift in draw])
            if one is None or other is None:
                return None
            odd.append((one[0] - other[0]) / 2)
            even.append((one[0] + other[0]) / 2)
        sizes = {n: float(max(level[j] for level in levels)) for j, n in enumerate(names)}
        spread = np.asarray(odd).T @ np.asarray(odd) / len(odd)
        return InputNoise({n: size for n, size in sizes.items() if size}, np.mean(even, axis=0), spread)

    @cached_property
    def parameter_shifts(self) -> list[ParameterShift]:
        """Parameters that are not constant."""
        if not self.residuals:
            return []
        problem = self.problem
        outputs = [
            record.samples(y) if len(y) == len(record.u) else y
            for record, (y, _) in zip(problem.records, self.runs, strict=True)
        ]
        names = [e.name for e in problem.experiments]
        excluded, rows = problem.model.noise_parameters, self.residuals.rows
        return find_parameter_shifts(self.variables, rows, self._expected_noise, outputs, names, excluded)

    @property
    def _expected_noise(self) -> ResidualColour:
        """Colour and variance of what noise alone leaves in the rows."""
        return self.colour


@dataclass(frozen=True, eq=False)
class SimulationOptimum(Optimum):
    """The end of an estimation by simulation error."""

    beside: ParameterCovariance | None = None
    """The covariance beside the optimum, where the slopes at it do not tell one (`greybox.estimation.exchange`)."""

    @property
    def search(self) -> Solution:
        """How the search ended, and the work it took."""
        return self.solution

    @property
    def problem(self) -> EstimationProblem:
        """The problem with the noise as it is known at the optimum."""
        return self.solution.problem

    @cached_property
    def objective(self) -> SimulationErrorObjective:
        """The squares of the simulation error."""
        return SimulationErrorObjective(self.solution.at_optimum)

    @property
    def runs(self) -> Runs:
        """For each record the outputs of the free run (or of joined segments), and its states."""
        return self._linearised[0]

    @property
    def residuals(self) -> ResidualRows | None:
        """The weighted residuals and their slopes; None where the simulation overflows."""
        return ResidualRows(self._linearised[1]) if np.isfinite(self.evaluation.cost) else None

    @cached_property
    def _linearised(self) -> tuple[Runs, Runs]:
        return self.solution.linearise()

    @cached_property
    def colour(self) -> ResidualColour:
        """Colour and variance of the residuals."""
        problem = self.problem
        return estimate_residual_colour(
            self._linearised[1], self.solution.unknowns, problem.noise.known, problem.variance_floor
        )

    @cached_property
    def covariance(self) -> ParameterCovariance:
        """Of the free constants."""
        if self.beside is not None or not self.residuals:
            return self.beside or ParameterCovariance.unknown(self.variables)
        covariance = estimate_covariance(self.variables, self.evaluation, self.residuals, self.colour, self.problem)
        return covariance.with_spread(self.input_noise.spread) if self.input_noise else covariance

    def _compute_step_change(self) -> np.ndarray:
        joined = self.solution.joined
        return joined.shift if joined else super()._compute_step_change()

    @property
    def _expected_noise(self) -> ResidualColour:
        """As the noise is known where the residual clearly exceeds it."""
        return expect_noise(self.colour, self._linearised[1], self.problem.noise)


@dataclass(frozen=True, eq=False, kw_only=True)
class PredictionOptimum(Optimum):
    """The end of an estimation by prediction error: the ``maximum`` of the likelihood."""

    maximum: LikelihoodMaximum

    @property
    def search(self) -> LikelihoodMaximum:
        """How the search ended, and the work it took."""
        return self.maximum

    @cached_property
    def problem(self) -> EstimationProblem:
        """The problem with the noise as it was estimated, white."""
        problem, variables = self.solution.problem, self.variables
        std = self.maximum.objective.noise
        estimated = [problem.model.outputs[j].name for j in variables.estimated_noise]
        noise = replace(
            problem.noise,
            std=std,
            sources={**problem.noise.sources, **dict.fromkeys(estimated, NoiseSource.INNOVATIONS)},
            colour=tuple(AutoRegression() for _ in std),
        )
        return replace(problem, noise=noise)

    @property
    def objective(self) -> Objective:
        """Minus twice the logarithm of the likelihood."""
        return self.maximum.objective

    @cached_property
    def runs(self) -> Runs:
        """For each record outputs and states of the free run."""
        return self.maximum.objective.simulate()

    @cached_property
    def residuals(self) -> ResidualRows | None:
        """The innovations with their slopes; None without success."""
        return self.maximum.objective.linearise() if self.status.success else None

    @cached_property
    def colour(self) -> ResidualColour:
        """Colour and variance of the innovations."""
        rows = self.residuals.rows if self.residuals else ()
        return estimate_residual_colour(rows, 0, True, noise_policy=self.solution.problem.policy.noise)

    @cached_property
    def covariance(self) -> ParameterCovariance:
        """Of the free constants."""
        if not self.residuals or not self.variables.size:
            return ParameterCovariance.unknown(self.variables)
        return estimate_likelihood_covariance(self.maximum, self.residuals, self.colour)

    @cached_property
    def one_step(self) -> Mapping[str, Misfit]:
        """Error of each output one step ahead, over what process noise and the noise of the sensor make of it together."""
        traces = make_traces(self.problem, self.maximum.objective.predict_one_step())
        misfits = compute_misfits(self.problem, traces)
        if not self.residuals:
            return misfits
        # An innovation over its standard deviation has the rms rmse / s: the s of all rows.
        weighed = np.concatenate([rows for rows, _ in self.residuals.rows])
        counted = np.isfinite(weighed).sum(axis=0)
        scale = np.sqrt(np.nansum(weighed**2, axis=0) / np.maximum(counted, 1))
        rms = dict(zip((o.name for o in self.problem.model.outputs), scale.tolist(), strict=True))
        std = {n: float(m.rmse / rms[n]) for n, m in misfits.items() if rms[n] > 0}
        noise = self.problem.noise
        levels = np.array(
            [std.get(o.name, level) for o, level in zip(self.problem.model.outputs, noise.std, strict=True)]
        )
        sources = {**noise.sources, **dict.fromkeys(std, NoiseSource.INNOVATIONS)}
        return compute_misfits(
            replace(self.problem, noise=replace(noise, std=levels, sources=sources, bounds={})), traces
        )

    @property
    def discretisation(self) -> str:
        """How the filter was integrated."""
        return self.maximum.objective.kalman.filter_step.label

    @property
    def is_exact(self) -> bool:
        """Whether the Kalman filter is exact: for a linear model and an exact discretisation."""
        return bool(self.problem.model.system.linear and self.problem.step.per_interval)

    def report(self) -> PredictionReport:
        """What a fit by prediction error adds."""
        fitted, likelihood = self.fitted_model, -0.5 * self.evaluation.cost
        return PredictionReport(
            {state: value for state, value in fitted.noise_intensities.items() if state in self.model.noisy_states},
            self.one_step,
            likelihood if np.isfinite(likelihood) else None,
        )


def restore_options(fit: Fit) -> FitOptions:
    """The options of ``fit`` for a search that begins next to its optimum, with the step it ended with."""
    options = FitOptions.from_data(fit.provenance.options)
    return replace(
        options,
        progressive=False,
        method=str(fit.solver.statistics.get("method", options.method)),
        substeps=int(fit.solver.statistics.get("substeps", options.substeps)),
        transcription="single",
        arc_length=0.0,
        hessian="gauss-newton",
    )


def has_free_run(fit: Fit) -> bool:
    """Whether the run of ``fit`` is a free one from each record's initial state, and not arcs or the segments of an unstable plant."""
    return fit.solver.statistics.get("transcription", "single") != "arcs" and bool(
        fit.solver.statistics.get("free_run", True)
    )


def restore_problem(fit: Fit) -> EstimationProblem:
    """The problem of ``fit`` with its records, its noise, its loss and its initial states, at its optimum.

    An intensity of process noise that became zero stays there.

    Raises FitError for a fit that did not succeed, that was saved without its inputs, or whose run is neither a free one (but arcs, or
    the segments of an unstable plant) nor a prediction.
    """
    if not fit.success:
        raise FitError(
            f"fit of {fit.model.title}: {fit.solver.status_message}; intervals need a fit that has succeeded"
        )
    if any(i.name not in t.inputs for t in fit.traces for i in fit.model.inputs):
        raise FitError(f"fit of {fit.model.title}: saved without the inputs of its records; fit again")
    if not (has_free_run(fit) or fit.prediction.process_noise):
        raise FitError(
            f"fit of {fit.model.title}: its simulation is not a free run ({fit.solver.statistics['transcription']}), which"
            " this result needs; use the intervals of the fit itself, or fit by single shooting if the plant is stable"
        )
    without = [name for name in fit.model.noise_parameters if fit.model.values[name] == 0]
    problem = prepare_problem(
        fit.model.fix(*without), [t.experiment for t in fit.traces], restore_noise(fit), restore_options(fit)
    )
    # Parameters that each experiment has for itself go by their labels, ``B (day 1)``.
    per_experiment = {
        f"{name} ({title})": estimate.value
        for name, estimates in fit.constraints.per_experiment.items()
        for title, estimate in estimates.items()
    }
    variables = problem.variables.with_values(per_experiment)
    start = np.array([[t.initial_state[name] for name in problem.model.system.state_names] for t in fit.traces])
    variables = replace(variables, initial=replace(variables.initial, guess=start))
    if problem.noise.growth:  # each row weighed as at the optimum
        runs = [
            np.column_stack([t.simulated.get(o.name, np.ones(len(t.time))) for o in problem.model.outputs])
            for t in fit.traces
        ]
        problem = problem.with_growing_noise(problem.noise.growth, runs)
    problem = replace(problem, loss=restore_loss(fit), variables=variables)
    if problem.loss is not None:
        problem = without_bursts(problem, problem.shooting().simulate(variables.here))
    return problem


def restore_objective(fit: Fit) -> Objective:
    """What ``fit`` minimised, at its optimum; raises as `restore_problem`."""
    problem = restore_problem(fit)
    if fit.prediction.process_noise:
        return PredictionErrorObjective.of(problem)
    return SimulationErrorObjective(problem)


def restore_residuals(fit: Fit) -> tuple[Objective, ResidualRows]:
    """What ``fit`` minimised, and its residuals or innovations with their slopes. Raises FitError where they are not finite."""
    objective = restore_objective(fit)
    residuals = objective.linearise()
    if residuals is None:
        raise FitError(f"fit of {fit.model.title}: its filter is not finite at the fitted parameters; fit again")
    return objective, residuals


def restore_loss(fit: Fit) -> RobustLoss | None:
    """The robust loss of ``fit`` with its scales; None for least squares."""
    loss = FitOptions.from_data(fit.provenance.options).to_loss()
    scale = np.array([fit.robust.scale.get(o.name, 1.0) for o in fit.model.outputs])
    return None if loss is None else replace(loss, scale=scale)


def restore_noise(fit: Fit) -> NoiseModel:
    """The noise that ``fit`` was weighted with."""
    outputs = fit.model.outputs
    std = np.array([fit.noise.std.get(o.name, 1.0) for o in outputs])
    colour = tuple(AutoRegression(tuple(fit.noise.colour.get(o.name, ()))) for o in outputs)
    known = bool(fit.noise.sources) and all(source.is_independent for source in fit.noise.sources.values())
    return NoiseModel(
        tuple(o.name for o in outputs),
        std,
        fit.noise.sources,
        colour,
        known,
        fit.noise.bounds,
        fit.noise.named,
        fit.noise.growth,
    )
