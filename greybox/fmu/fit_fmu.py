"""Fit the parameters of an FMU to records: free runs, slopes by bounded differences, damped Gauss-Newton steps.

A run costs what the FMU costs, so a slope is one run, a rejected step one more, and nothing is run twice. A run that fails costs a
bounded amount: the search turns back from it and goes on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from greybox.errors import DataError
from greybox.estimation.sandwich import estimate_residual_colour, sum_scores
from greybox.experiment import Experiment
from greybox.fmu.description import FmuPlant, FmuVariable
from greybox.fmu.policy import DEFAULT_FMU_FIT, FmuFitPolicy
from greybox.fmu.simulator import FmuRunError, FmuSimulator
from greybox.linear_algebra import pseudo_inverse
from greybox.noise.differences import estimate_noise_of_records
from greybox.optim import MinimisationMethod, TerminationStatus, minimise
from greybox.optim.quadratic_model import QuadraticModel
from greybox.result import Estimate, Misfit
from greybox.values import Printable


@dataclass(frozen=True, eq=False)
class FmuFit(Printable):
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
        Runs of one record, and those of them that failed.
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

    @property
    def success(self) -> bool:
        """Whether the search converged."""
        return self.status.success

    def as_dict(self) -> dict[str, object]:
        """The results as numbers, texts and dictionaries, ready for JSON."""

        def misfit(m: Misfit) -> dict[str, object]:
            ratio = m.noise_ratio if np.isfinite(m.noise_ratio) else None
            return {"rmse": m.rmse, "unit": m.unit, "best_fit_percent": m.best_fit_percent, "noise_ratio": ratio}

        return {
            "fmu": self.plant.path.name,
            "status": str(self.status),
            "parameters": {
                name: {"value": e.value, "unit": e.unit, "std": e.std, "interval": e.interval, "at_bound": e.at_bound}
                for name, e in self.parameters.items()
            },
            "misfit": {name: misfit(m) for name, m in self.misfits.items()},
            "validation": {name: misfit(m) for name, m in self.validation.items()},
            "runs": self.runs,
            "failures": self.failures,
        }


def fit_fmu(
    plant: FmuPlant,
    experiments: Experiment | Sequence[Experiment],
    *,
    free: Sequence[str] = (),
    start: Mapping[str, float] | None = None,
    fixed: Mapping[str, float] | None = None,
    noise: Mapping[str, float] | None = None,
    validation: Experiment | Sequence[Experiment] = (),
    policy: FmuFitPolicy = DEFAULT_FMU_FIT,
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
    policy
        How it is run and sought.

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
    records = (experiments,) if isinstance(experiments, Experiment) else tuple(experiments)
    others = (validation,) if isinstance(validation, Experiment) else tuple(validation)
    if not records:
        raise DataError("no experiment; give at least one record")
    unknowns = plant.choose(free, policy)
    if not unknowns:
        raise DataError(f"{plant.title} has no parameter to fit")
    given = {plant.find(n).name: float(v) for n, v in (fixed or {}).items()}
    begin = {v.name: v.start for v in unknowns} | {plant.find(n).name: float(x) for n, x in (start or {}).items()}
    given |= {name: value for name, value in begin.items() if name not in {v.name for v in unknowns}}
    std = {o.label: _find_noise(o, records, noise, policy) for o in plant.outputs}
    with FmuSimulator(plant, policy) as simulator:
        search = _FmuSearch(simulator, unknowns, given, records, std, policy)
        z = search.to_unknowns(np.array([begin[v.name] for v in unknowns]))
        search.begin(z)
        low, high = search.bounds
        outcome = minimise(
            search.evaluate,
            z,
            low,
            high,
            method=MinimisationMethod.GAUSS_NEWTON,
            scale=float(max(search.count, 1)),
            iterations=policy.iterations,
            thorough=False,
            cost=search.cost,
            termination_test=search.test_termination,
        )
        rows, slopes = search.run(outcome.z), search.slopes(outcome.z)
        simulated = search.simulated
        values = search.values(outcome.z)
        settled = outcome.status.success or search.test_termination(outcome.z, outcome.value) is not None
        checked = {record.name: simulator.run(record, search.names(outcome.z)) for record in others}
        runs, failures = simulator.runs, simulator.failures
    status = TerminationStatus.CONVERGED if settled else outcome.status
    covariance = _estimate_covariance(rows, slopes, search.sizes, noise is not None)
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
        _compute_misfits(plant, records, simulated, std),
        _compute_misfits(plant, others, checked, std),
        simulated,
        status,
        runs,
        failures,
    )


class _FmuSearch:
    """Residuals of the records as a function of the unknowns, each point run once."""

    def __init__(
        self,
        simulator: FmuSimulator,
        unknowns: Sequence[FmuVariable],
        given: Mapping[str, float],
        records: Sequence[Experiment],
        std: Mapping[str, float],
        policy: FmuFitPolicy,
    ) -> None:
        self.simulator, self.unknowns, self.given = simulator, unknowns, given
        self.records, self.std, self.policy = records, std, policy
        self.sizes = np.ones(len(unknowns))
        self.penalty = self.exact = np.inf
        self.simulated: dict[str, dict[str, np.ndarray]] = {}
        self._known: dict[bytes, list[np.ndarray] | None] = {}
        self._slopes: dict[bytes, list[np.ndarray]] = {}

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

    def to_unknowns(self, values: np.ndarray) -> np.ndarray:
        """Parameters over their sizes, which are those of the start."""
        widths = np.array([hi - lo if np.isfinite(hi - lo) else 1.0 for lo, hi in (v.bounds for v in self.unknowns)])
        self.sizes = np.where(values != 0, np.abs(values), widths)
        return values / self.sizes

    def values(self, z: np.ndarray) -> np.ndarray:
        """Parameters (n,)."""
        limits = np.array([v.bounds for v in self.unknowns])
        return np.clip(z * self.sizes, limits[:, 0], limits[:, 1])

    def names(self, z: np.ndarray) -> dict[str, float]:
        """Every value that is set before a run."""
        settings = dict(self.given)
        settings |= {v.name: float(x) for v, x in zip(self.unknowns, self.values(z), strict=True)}
        return settings

    def begin(self, z: np.ndarray) -> None:
        """Run the start, which must not fail. Raises FmuRunError."""
        try:
            self.run(z)
        except FmuRunError as error:
            why = f"{error.__cause__ or error}".removeprefix(f"{self.simulator.plant.path.name}: ")
            raise FmuRunError(
                f"{self.simulator.plant.path.name}: it does not run from its start values ({why}); give others"
                " (start={...}, shell: --start)"
            ) from error
        cost = self.cost(z)
        self.penalty, self.exact = self.policy.failed_cost * cost, self.policy.exact * cost

    def run(self, z: np.ndarray) -> list[np.ndarray]:
        """Weighted residuals (N, ny) of each record. Raises FmuRunError."""
        key = z.tobytes()
        if key not in self._known:
            try:
                self._known[key] = [self._run_record(record, z) for record in self.records]
            except FmuRunError:
                self._known[key] = None
        rows = self._known[key]
        if rows is None:
            raise FmuRunError(f"{self.simulator.plant.path.name}: the run failed")
        return rows

    def _run_record(self, record: Experiment, z: np.ndarray) -> np.ndarray:
        outputs = self.simulator.run(record, self.names(z))
        self.simulated[record.name] = outputs
        missing = np.full(record.rows, np.nan)
        columns = [
            (record.outputs.get(o.label, missing) - outputs[o.label]) / self.std[o.label]
            for o in self.simulator.plant.outputs
        ]
        return np.column_stack(columns)

    def slopes(self, z: np.ndarray) -> list[np.ndarray]:
        """Slopes (N, ny, n) of the residuals, by a difference within the bounds; the other side where a run fails, zero where both do."""
        key = z.tobytes()
        if key in self._slopes:
            return self._slopes[key]
        rows_at, (low, high) = self.run(z), self.bounds
        last = dict(self.simulated)
        result = [np.zeros((*r.shape, len(z))) for r in rows_at]
        for k in range(len(z)):
            width = self.policy.difference * max(abs(float(z[k])), 1.0)
            for sign in (1.0, -1.0) if z[k] + width <= high[k] else (-1.0, 1.0):
                moved = z.copy()
                moved[k] += sign * width
                if not low[k] <= moved[k] <= high[k]:
                    continue
                try:
                    rows = [self._run_record(record, moved) for record in self.records]
                except FmuRunError:
                    continue
                for e, r in enumerate(rows):
                    result[e][:, :, k] = (r - rows_at[e]) / (sign * width)
                break
        self.simulated = last
        self._slopes[key] = result
        return result

    def cost(self, z: np.ndarray) -> float:
        """Sum of squares; the penalty for a run that fails."""
        try:
            return float(sum(np.nansum(r**2) for r in self.run(z)))
        except FmuRunError:
            return self.penalty

    def evaluate(self, z: np.ndarray) -> QuadraticModel:
        """The cost with its quadratic model; flat at the penalty where the run fails."""
        try:
            rows, slopes = self.run(z), self.slopes(z)
        except FmuRunError:
            return QuadraticModel(self.penalty, np.zeros(len(z)), np.eye(len(z)))
        residual = np.concatenate([r[np.isfinite(r)] for r in rows])
        matrix = np.concatenate([s[np.isfinite(r)] for r, s in zip(rows, slopes, strict=True)])
        return QuadraticModel.from_residuals(matrix, residual)

    def test_termination(self, z: np.ndarray, value: QuadraticModel) -> TerminationStatus | None:
        """Converged where the quadratic model promises less than what noise does."""
        low, high = self.bounds
        noise = value.cost / max(self.count - len(z), 1)
        if value.cost <= self.exact or value.predicted_decrease(low - z, high - z) <= self.policy.converged * noise:
            return TerminationStatus.CONVERGED
        return None


@dataclass(frozen=True)
class _AllColumns:
    """Every unknown concerns every record."""

    size: int

    def columns(self, experiment: int) -> np.ndarray:
        """All of them."""
        return np.arange(self.size)


def _estimate_covariance(
    rows: Sequence[np.ndarray], slopes: Sequence[np.ndarray], sizes: np.ndarray, noise_given: bool
) -> np.ndarray:
    """The covariance of the parameters, which allows for a coloured residual."""
    pairs = list(zip(rows, slopes, strict=True))
    colour = estimate_residual_colour(pairs, len(sizes), noise_given)
    sums = sum_scores(_AllColumns(len(sizes)), pairs, colour)
    bread = pseudo_inverse(sums.information)
    return sizes[:, None] * (bread @ np.asarray(sums.coloured) @ bread) * sizes


def _find_noise(
    output: FmuVariable, records: Sequence[Experiment], noise: Mapping[str, float] | None, policy: FmuFitPolicy
) -> float:
    columns = [r.outputs[output.label] for r in records if output.label in r.outputs]
    if not columns:
        return 1.0
    if noise and output.label in noise:
        return float(noise[output.label])
    movement = float(np.nanstd(np.concatenate(columns)))
    estimate = estimate_noise_of_records(columns)
    return max(estimate if np.isfinite(estimate) else 0.0, policy.least_std * movement) or 1.0


def _compute_misfits(
    plant: FmuPlant,
    records: Sequence[Experiment],
    simulated: Mapping[str, Mapping[str, np.ndarray]],
    std: Mapping[str, float],
) -> dict[str, Misfit]:
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
