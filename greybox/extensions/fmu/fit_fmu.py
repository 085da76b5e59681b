"""Fit the parameters of an FMU to records: constants with intervals, misfits, and what that took."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from scipy.special import ndtri

from greybox.base.errors import DataError
from greybox.base.json_file import StoredResult
from greybox.base.json_shape import FileKind
from greybox.base.linear_algebra import pseudo_inverse
from greybox.base.values import Printable
from greybox.data.experiment import Experiment, as_records
from greybox.data.noise.spectrum import estimate_noise_of_records
from greybox.estimation.optim.methods import MinimisationMethod, minimise
from greybox.estimation.optim.minimisation import DEFAULT_POLICY, GaussNewtonPolicy, TerminationStatus
from greybox.estimation.optim.quadratic_model import QuadraticModel
from greybox.estimation.result_parts import Estimate, Misfit
from greybox.estimation.sandwich import estimate_residual_colour, sum_scores
from greybox.extensions.fmu.description import FmuPlant, FmuVariable
from greybox.extensions.fmu.simulator import FmuRunError, FmuSimulator

# The search for parameters of an FMU: what a run of it costs decides how it goes.
#
# It begins with the first part of the records and goes on to longer ones, so that most runs are short ones. Slopes by differences cost a
# run a parameter: they are taken where a search begins, and follow from step to step by Broyden's secant update (Math. Comp. 19, 1965) as
# long as steps gain what they promise. A run that fails costs a bounded amount.


# Step of a parameter for a slope, over its size: above what solvers with a tolerance of 1e-8 scatter, below what bends.
FMU_FIT_DIFFERENCE = 0.0001
# Predicted decrease of the cost, over its noise (cost over degrees of freedom), from which nothing visible is left to gain.
FMU_FIT_CONVERGED = 0.0001
# Share of the cost at the start that is a solver's scatter: exact data end here.
FMU_FIT_EXACT = 1e-12
# Cost of a run that fails, over that of the start: bounded, so that the search turns back and goes on.
FAILED_COST = 100.0
# Share of the promised decrease that a step must gain for slopes to follow by the secant update (Fletcher's lower ratio).
SECANT_SHARE = 0.25


@dataclass
class FmuObjective:
    """Residuals of records as a function of the unknowns, each point run once.

    Parameters
    ----------
    simulator
        Runs the FMU.
    unknowns
        What is fitted.
    given
        Further values that are set.
    records
        What is fitted to.
    std
        Output -> noise.
    sizes
        What the unknowns are divided by (n,).
    penalty
        Cost of a run that fails.
    exact
        Cost below which only the solver's scatter is left.
    central
        Whether a slope is a difference to both sides, for twice the runs.
    """

    simulator: FmuSimulator
    unknowns: Sequence[FmuVariable]
    given: Mapping[str, float]
    records: Sequence[Experiment]
    std: Mapping[str, float]
    sizes: np.ndarray
    penalty: float = np.inf
    exact: float = 0.0
    central: bool = False
    simulated: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)
    _known: dict[bytes, list[np.ndarray] | None] = field(default_factory=dict)
    _slopes: dict[bytes, list[np.ndarray]] = field(default_factory=dict)
    _secant: tuple[np.ndarray, list[np.ndarray], list[np.ndarray]] | None = None

    @property
    def count(self) -> int:
        """Number of measurements."""
        names = [o.label for o in self.simulator.plant.outputs]
        return sum(int(np.isfinite(r.outputs[n]).sum()) for r in self.records for n in names if n in r.outputs)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the unknowns."""
        limits = np.array([v.bounds for v in self.unknowns])
        return limits[:, 0] / self.sizes, limits[:, 1] / self.sizes

    def over(self, records: Sequence[Experiment]) -> FmuObjective:
        """The same over other records."""
        return FmuObjective(self.simulator, self.unknowns, self.given, records, self.std, self.sizes)

    def values(self, z: np.ndarray) -> np.ndarray:
        """Parameters (n,)."""
        limits = np.array([v.bounds for v in self.unknowns])
        return np.clip(z * self.sizes, limits[:, 0], limits[:, 1])

    def settings(self, z: np.ndarray) -> dict[str, float]:
        """Every value that is set before a run."""
        chosen = {v.name: float(x) for v, x in zip(self.unknowns, self.values(z), strict=True)}
        return {**self.given, **chosen}

    def begin(self, z: np.ndarray) -> None:
        """Run the start, which must not fail. Raises FmuRunError."""
        try:
            self.run(z)
        except FmuRunError as error:
            name = self.simulator.plant.path.name
            why = f"{error.__cause__ or error}".removeprefix(f"{name}: ")
            raise FmuRunError(
                f"{name}: it does not run from its start values ({why}); give others (start={{...}}, shell: --start)"
            ) from error
        cost = self.cost(z)
        self.penalty, self.exact = FAILED_COST * cost, FMU_FIT_EXACT * cost

    def run(self, z: np.ndarray) -> list[np.ndarray]:
        """Weighted residuals (N, ny) of each record. Raises FmuRunError."""
        key = z.tobytes()
        if key not in self._known:
            try:
                self._known[key] = [self._run_record(record, z) for record in self.records]
            except FmuRunError:
                # A failure is remembered, too: an optimiser asks the same point for its cost and for its slopes.
                self._known[key] = None
                raise
        rows = self._known[key]
        if rows is None:
            raise FmuRunError(f"{self.simulator.plant.path.name}: the run failed")
        return rows

    def _run_record(self, record: Experiment, z: np.ndarray) -> np.ndarray:
        outputs = self.simulator.run(record, self.settings(z))
        self.simulated[record.name] = outputs
        missing = np.full(record.rows, np.nan)
        columns = [
            (record.outputs.get(o.label, missing) - outputs[o.label]) / self.std[o.label]
            for o in self.simulator.plant.outputs
        ]
        return np.column_stack(columns)

    def slopes(self, z: np.ndarray) -> list[np.ndarray]:
        """Slopes (N, ny, n) of the residuals: by directional derivatives of the FMU; else by differences within the bounds, to one side,
        the other where a run fails, both where ``central``; zero where neither side runs.
        """
        key = z.tobytes()
        if key in self._slopes:
            return self._slopes[key]
        rows_at, (low, high) = self.run(z), self.bounds
        exact = None if self.central else self._differentiate(z)
        if exact is not None:
            self._slopes[key] = exact
            return exact
        last = dict(self.simulated)
        result = [np.zeros((*r.shape, len(z))) for r in rows_at]
        for k in range(len(z)):
            width = FMU_FIT_DIFFERENCE * max(abs(float(z[k])), 1.0)
            each = []
            # Inwards first, where the upper bound is near.
            for sign in (1.0, -1.0) if z[k] + width <= high[k] else (-1.0, 1.0):
                moved = z.copy()
                moved[k] += sign * width
                if not low[k] <= moved[k] <= high[k]:
                    continue
                try:
                    rows = [self._run_record(record, moved) for record in self.records]
                except FmuRunError:
                    continue
                each.append([(r - at) / (sign * width) for r, at in zip(rows, rows_at, strict=True)])
                if not self.central:
                    break
            for e, sides in enumerate(zip(*each, strict=True)):
                # Both sides cancel the second order: half the sum of the two one-sided slopes.
                result[e][:, :, k] = np.mean(sides, axis=0)
        # Runs beside the point are not its runs.
        self.simulated = last
        self._slopes[key] = result
        return result

    def _differentiate(self, z: np.ndarray) -> list[np.ndarray] | None:
        std = np.array([self.std[o.label] for o in self.simulator.plant.outputs])
        widths = FMU_FIT_DIFFERENCE * np.maximum(np.abs(z), 1.0) * self.sizes
        widths = np.where(z * self.sizes + widths > self.bounds[1] * self.sizes, -widths, widths)
        result = []
        for record in self.records:
            run = self.simulated[record.name]
            slopes = self.simulator.differentiate(record, self.settings(z), self.unknowns, widths, run)
            if slopes is None:
                return None
            result.append(-slopes * self.sizes / std[None, :, None])
        return result

    def follow_slopes(self, z: np.ndarray) -> list[np.ndarray]:
        """Slopes by the secant update from the point before; by differences where there is none, or its step fell short of its promise."""
        rows_at, last, key = self.run(z), self._secant, z.tobytes()
        slopes = self._slopes.get(key)
        if slopes is None and last is not None:
            before, rows_before, slopes_before = last
            step = z - before
            # r(z0) + J d: what the slopes before promised.
            expected = [r + s @ step for r, s in zip(rows_before, slopes_before, strict=True)]
            cost_before, cost_now, cost_expected = (
                sum(float(np.nansum(r**2)) for r in group) for group in (rows_before, rows_at, expected)
            )
            # A step that fell short shows that the slopes are wrong beyond what one secant can mend.
            if not cost_before - cost_now < SECANT_SHARE * (cost_before - cost_expected):
                # Broyden: J+ = J + (r - e) d' / d'd, the least change that explains the step.
                slopes = [
                    s + np.where(np.isfinite(r - e), r - e, 0.0)[:, :, None] * step / (step @ step)
                    for s, r, e in zip(slopes_before, rows_at, expected, strict=True)
                ]
        if slopes is None:
            slopes = self.slopes(z)
        self._secant = z.copy(), rows_at, slopes
        return slopes

    def forget(self, known: bool = False) -> None:
        """Take the next slopes by differences; where ``known``, too, those of points at which they were taken."""
        self._secant = None
        if known:
            self._slopes.clear()

    def cost(self, z: np.ndarray) -> float:
        """Sum of squares; the penalty for a run that fails."""
        try:
            return float(sum(np.nansum(r**2) for r in self.run(z)))
        except FmuRunError:
            return self.penalty

    def evaluate(self, z: np.ndarray) -> QuadraticModel:
        """The cost with its quadratic model by the slopes that follow; flat at the penalty where the run fails."""
        try:
            rows, each = self.run(z), self.follow_slopes(z)
        except FmuRunError:
            return QuadraticModel(self.penalty, np.zeros(len(z)), np.eye(len(z)))
        residual = np.concatenate([r[np.isfinite(r)] for r in rows])
        matrix = np.concatenate([s[np.isfinite(r)] for r, s in zip(rows, each, strict=True)])
        return QuadraticModel.from_residuals(matrix, residual)

    def test_termination(self, z: np.ndarray, value: QuadraticModel) -> TerminationStatus | None:
        """Converged where the quadratic model promises less than what noise does."""
        low, high = self.bounds
        noise = value.cost / max(self.count - len(z), 1)
        if value.cost <= self.exact or value.predicted_decrease(low - z, high - z) <= FMU_FIT_CONVERGED * noise:
            return TerminationStatus.CONVERGED
        return None


# Shares of the records that are fitted before the whole: over a short part a start that is far off is not out of step yet, and a run
# costs little.
SHARES = (0.15, 0.4)
# Rows of a record that the first part has at least.
FMU_FIT_LEAST_ROWS = 50
# Share of the rows from which a part is not worth a search of its own.
FMU_FIT_ALMOST_WHOLE = 0.8


def search_parameters(objective: FmuObjective, z: np.ndarray) -> tuple[np.ndarray, TerminationStatus]:
    """The unknowns (n,) that fit the records best, and how the search ended. Raises FmuRunError where the FMU does not run at ``z``."""
    for share in SHARES:
        lengths = [min(max(round(share * r.rows), FMU_FIT_LEAST_ROWS), r.rows) for r in objective.records]
        # Nearly the whole costs as much as the whole.
        if sum(lengths) >= FMU_FIT_ALMOST_WHOLE * sum(r.rows for r in objective.records):
            continue
        part = objective.over([r.window(0, n) for r, n in zip(objective.records, lengths, strict=True)])
        part.begin(z)
        z = _descend(part, z)[0]
    objective.begin(z)
    return _descend(objective, z)


# Most times that the search goes on from slopes by differences.
ROUNDS = 12
# Most steps that gain, from one set of slopes by differences.
FMU_FIT_ITERATIONS = 30
# Damping of the first step, as a share of the curvature: an undamped one may leave a start that is far off for another oscillation.
INITIAL_DAMPING = 0.001
# Steps in a row that gain nothing before slopes are taken by differences again.
FMU_FIT_REJECTIONS = 5


def _descend(objective: FmuObjective, z: np.ndarray) -> tuple[np.ndarray, TerminationStatus]:
    """Rounds of steps, each from slopes by differences, until these promise nothing."""
    status, (low, high) = TerminationStatus.ITERATION_LIMIT, objective.bounds
    damped = GaussNewtonPolicy(initial_damping=INITIAL_DAMPING, max_rejections=FMU_FIT_REJECTIONS)
    for _ in range(ROUNDS):
        objective.forget()
        begun = objective.evaluate(z)
        if objective.test_termination(z, begun) is not None:
            return z, TerminationStatus.CONVERGED
        outcome = minimise(
            objective.evaluate,
            z,
            low,
            high,
            method=MinimisationMethod.GAUSS_NEWTON,
            scale=float(max(objective.count, 1)),
            value_at_start=begun,
            iterations=FMU_FIT_ITERATIONS,
            thorough=False,
            cost=objective.cost,
            termination_test=objective.test_termination,
            policy=replace(DEFAULT_POLICY, damped=damped),
        )
        status = outcome.status
        # Slopes by differences, and no step gains: their own error may be what is left.
        if np.array_equal(outcome.z, z):
            if objective.central:
                return z, status
            # Twice the runs, but without the error of first order in the width; slopes that are known were taken otherwise.
            objective.central = True
            objective.forget(known=True)
        z = outcome.z
        if status is TerminationStatus.INTERRUPTED:
            break
    return z, status


FMU_FIT_FILE = FileKind("a fit of an FMU", "fmu_fit.json that greybox fit has written")


@dataclass(frozen=True, eq=False)
class FmuFit(Printable, StoredResult):
    """Parameters of an FMU fitted to records.

    Attributes
    ----------
    plant
        The FMU.
    parameters
        Label -> value with standard deviation and 95 % interval, of the fitted ones.
    covariance
        Of these (n, n), allowing for a coloured residual.
    misfits
        Output -> free-run error; its ratio to the noise where that is given or the record shows it.
    validation
        The same on validation records.
    simulated
        Record -> output -> run (N,).
    status
        How the search ended.
    runs, failures
        Runs of one record or its beginning that the search took, and those of them that failed.
    equivalents
        What these runs cost: their rows over those of all records.
    given
        Variable -> value that was set and not fitted.
    std
        Output -> noise by which errors were weighted.
    """

    plant: FmuPlant
    parameters: Mapping[str, Estimate]
    covariance: np.ndarray
    misfits: Mapping[str, Misfit]
    validation: Mapping[str, Misfit]
    simulated: Mapping[str, Mapping[str, np.ndarray]]
    status: TerminationStatus
    runs: int
    failures: int
    equivalents: float
    given: Mapping[str, float] = field(default_factory=dict)
    std: Mapping[str, float] = field(default_factory=dict)

    FILE: ClassVar[FileKind] = FMU_FIT_FILE
    KEYS: ClassVar[str] = """
        fmu!=plant.file_name status parameters misfit=misfits validation runs failures simulation_equivalents=equivalents
        """

    @property
    def success(self) -> bool:
        """Whether the search converged."""
        return self.status.success


def fit_fmu(
    plant: FmuPlant,
    experiments: Experiment | Sequence[Experiment],
    *,
    free: Sequence[str] = (),
    start: Mapping[str, float] | None = None,
    fixed: Mapping[str, float] | None = None,
    noise: Mapping[str, float] | None = None,
    validation: Experiment | Sequence[Experiment] = (),
    search: bool = True,
) -> FmuFit:
    """Fit parameters of an FMU to records.

    Each record starts as the FMU starts: an initial state that it lets set is a parameter like others.

    Parameters
    ----------
    plant
        The FMU, see `read_fmu`.
    experiments
        Records, read by `FmuPlant.record_model`.
    free
        Parameters to fit, by name; none: all, if they are few.
    start
        Start values by name; the others are those of the FMU.
    fixed
        Further values that are set and not fitted.
    noise
        Output -> standard deviation of its sensor; None estimates it from the records.
    validation
        Records that are not fitted.
    search
        Whether parameters are sought; else the FMU is run at its start values.

    Returns
    -------
    FmuFit
        Parameters with intervals, misfits and runs.

    Raises
    ------
    DataError
        Where a record has no output of the FMU.
    FmuRunError
        Where the FMU does not run from its start values.
    ModelError
        For unknown names.
    """
    records = as_records(experiments)
    others = as_records(validation)
    if not records:
        raise DataError("no experiment; give at least one record")
    unknowns = plant.choose(free)
    if not unknowns:
        raise DataError(f"{plant.title} has no parameter to fit")
    given = {plant.find(n).name: float(v) for n, v in (fixed or {}).items()}
    # Start values of what is not fitted are settings like others.
    begin = {v.name: v.start for v in unknowns} | {plant.find(n).name: float(x) for n, x in (start or {}).items()}
    given |= {name: value for name, value in begin.items() if name not in {v.name for v in unknowns}}
    std = {o.label: _find_noise(o, records, noise) for o in plant.outputs}
    with FmuSimulator(plant) as simulator:
        values = np.array([begin[v.name] for v in unknowns])
        sizes = choose_sizes(unknowns, values)
        objective = FmuObjective(simulator, unknowns, given, records, std, sizes)
        z, status = values / sizes, TerminationStatus.ITERATION_LIMIT
        if search:
            z, status = search_parameters(objective, z)
        else:
            objective.begin(z)
        values = objective.values(z)
        # Weighted residuals and their slopes by differences, or the FMU's own.
        residuals = list(zip(objective.run(z), objective.slopes(z), strict=True))
        simulated = dict(objective.simulated)
        rows, failures, runs = simulator.rows, simulator.failures, simulator.runs
        # After the search is counted: validation is no cost of the fit.
        checked = {record.name: simulator.run(record, objective.settings(z)) for record in others}
    colour = estimate_residual_colour(residuals, len(sizes), noise is not None)
    sums = sum_scores(_AllColumns(len(sizes)), residuals, colour)
    # (J'J)^-1 J'RJ (J'J)^-1, which allows for a coloured residual, in the units of the unknowns; there are no initial states beside them.
    bread = pseudo_inverse(sums.information)
    covariance = sizes[:, None] * (bread @ np.asarray(sums.coloured) @ bread) * sizes
    deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    reach = float(ndtri(0.975))
    parameters = {
        v.label: Estimate(
            float(x), v.unit, float(s), (float(x - reach * s), float(x + reach * s)), False, bool(x in v.bounds)
        )
        for v, x, s in zip(unknowns, values, deviations, strict=True)
    }
    return FmuFit(
        plant,
        parameters,
        covariance,
        compute_misfits(plant, records, simulated, std),
        compute_misfits(plant, others, checked, std),
        simulated,
        status,
        runs,
        failures,
        rows / sum(record.rows for record in records),
        given,
        std,
    )


@dataclass(frozen=True)
class _AllColumns:
    """Every unknown concerns every record."""

    size: int

    def columns(self, experiment: int) -> np.ndarray:
        """All of them."""
        return np.arange(self.size)


def choose_sizes(unknowns: Sequence[FmuVariable], values: np.ndarray) -> np.ndarray:
    """What the unknowns are divided by: their start values; the width of their bounds where that is zero."""
    widths = np.array([high - low if np.isfinite(high - low) else 1.0 for low, high in (v.bounds for v in unknowns)])
    return np.where(values != 0, np.abs(values), widths)


# Smallest noise of an output, over its movement, by which errors are weighted: simulated records have none.
LEAST_STD = 1e-09


def _find_noise(output: FmuVariable, records: Sequence[Experiment], noise: Mapping[str, float] | None) -> float:
    columns = [r.outputs[output.label] for r in records if output.label in r.outputs]
    if not columns:
        return 1.0
    if noise and output.label in noise:
        return float(noise[output.label])
    movement = float(np.nanstd(np.concatenate(columns)))
    estimate = estimate_noise_of_records(columns)
    # The level scales the outputs against each other; a simulated record has none, and a division by it none either.
    return max(estimate if np.isfinite(estimate) else 0.0, LEAST_STD * movement) or 1.0


def compute_misfits(
    plant: FmuPlant,
    records: Sequence[Experiment],
    simulated: Mapping[str, Mapping[str, np.ndarray]],
    std: Mapping[str, float],
) -> dict[str, Misfit]:
    """Output -> error of these runs."""
    misfits = {}
    for o in plant.outputs:
        measured = [r for r in records if o.label in r.outputs]
        if not measured:
            continue
        y = np.concatenate([r.outputs[o.label] for r in measured])
        error = y - np.concatenate([simulated[r.name][o.label] for r in measured])
        known = np.isfinite(y)
        rmse = float(np.sqrt(np.mean(error[known] ** 2)))
        spread = float(np.linalg.norm(y[known] - y[known].mean()))
        fit = 100 * (1 - float(np.linalg.norm(error[known])) / spread) if spread else float("nan")
        misfits[o.label] = Misfit(rmse, o.unit, fit, rmse / std[o.label], int(known.sum()))
    return misfits
