"""Fit the parameters of an FMU to records: constants with intervals, misfits, and what that took."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtri

from greybox.base.errors import DataError
from greybox.base.files import write_file
from greybox.base.linear_algebra import pseudo_inverse
from greybox.base.values import Printable
from greybox.data.experiment import Experiment, as_records
from greybox.data.noise.spectrum import estimate_noise_of_records
from greybox.estimation.optim.minimisation import TerminationStatus
from greybox.estimation.result_parts import Estimate, Misfit, format_json, to_json_data
from greybox.estimation.sandwich import estimate_residual_colour, sum_scores
from greybox.extensions.fmu.description import FmuPlant, FmuVariable
from greybox.extensions.fmu.policy import DEFAULT_FMU_FIT, FmuFitPolicy
from greybox.extensions.fmu.search import FmuObjective, search_parameters
from greybox.extensions.fmu.simulator import FmuSimulator

# Version of the keys in fmu_fit.json.
FORMAT = 1


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

    @property
    def success(self) -> bool:
        """Whether the search converged."""
        return self.status.success

    def as_dict(self) -> dict[str, Any]:
        """The results as numbers, texts and dictionaries, ready for JSON; what is not finite is None."""
        data: dict[str, Any] = to_json_data(fmu_fit_data(self))
        return data

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the results as JSON.

        Parameters
        ----------
        path
            The file, ``fmu_fit.json`` by custom.

        Returns
        -------
        Path
            The file.
        """
        return write_file(path, format_json(self.as_dict()) + "\n")


def fmu_fit_data(result: FmuFit) -> dict[str, Any]:
    """A fit of an FMU under the keys of ``fmu_fit.json``."""
    return {
        "format": FORMAT,
        "fmu": result.plant.path.name,
        "status": str(result.status),
        "parameters": result.parameters,
        "misfit": result.misfits,
        "validation": result.validation,
        "runs": result.runs,
        "failures": result.failures,
        "simulation_equivalents": result.equivalents,
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
    with FmuSimulator(plant, policy) as simulator:
        values = np.array([begin[v.name] for v in unknowns])
        sizes = choose_sizes(unknowns, values)
        objective = FmuObjective(simulator, unknowns, given, records, std, policy, sizes)
        outcome = search_parameters(objective, values / sizes)
        values = objective.values(outcome.z)
        rows, failures = simulator.rows, simulator.failures
        runs = simulator.runs
        # After the search is counted: validation is no cost of the fit.
        checked = {record.name: simulator.run(record, objective.settings(outcome.z)) for record in others}
    covariance = _estimate_covariance(outcome.rows, outcome.slopes, sizes, noise is not None)
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
        compute_misfits(plant, records, outcome.simulated, std),
        compute_misfits(plant, others, checked, std),
        outcome.simulated,
        outcome.status,
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


def _estimate_covariance(
    rows: Sequence[np.ndarray], slopes: Sequence[np.ndarray], sizes: np.ndarray, noise_given: bool
) -> np.ndarray:
    """The covariance of the parameters, which allows for a coloured residual."""
    pairs = list(zip(rows, slopes, strict=True))
    colour = estimate_residual_colour(pairs, len(sizes), noise_given)
    sums = sum_scores(_AllColumns(len(sizes)), pairs, colour)
    # (J'J)^-1 J'RJ (J'J)^-1, in the units of the unknowns; there are no initial states beside them.
    bread = pseudo_inverse(sums.information)
    return sizes[:, None] * (bread @ np.asarray(sums.coloured) @ bread) * sizes


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
