"""`analyse_practical_identifiability`: what given records determine of the free constants, near their present values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.estimation.problem import EstimationProblem, prepare_problem
from greybox.experiment import Experiment
from greybox.identifiability.determined_combinations import (
    ParameterCombination,
    find_product_combinations,
    find_transfer_function_combinations,
    free_parameter_indices,
    is_determined,
    simplicity_key,
)
from greybox.identifiability.excitation import Excitation, analyse_excitation
from greybox.identifiability.sensitivity import SensitivityRank
from greybox.identifiability.sensitivity import compute_rank as rank_at
from greybox.identifiability.structural import StructuralIdentifiability, analyse_structural_identifiability
from greybox.identifiability.transfer_function_sensitivity import compute_transfer_function_sensitivity
from greybox.model import Model

# An interval that reaches further than this share of the value determines nothing.
HALF = 0.5
REACH = 1.96  # standard deviations in a 95 % interval
OPEN = 1e-12  # share of the largest curvature, of constants scaled alike, that is rounding
TAKES_PART = 0.3  # of a direction of length one
PRIOR = np.log(10.0)  # what is known without data: the order of magnitude


@dataclass(frozen=True)
class ExpectedPrecision:
    """What the records can say about one constant.

    ``std`` to expect, in ``unit``, at ``value``; None: infinite. ``determined``: the 95 % interval stays within 50 % of
    the value. ``averaged``: only because many samples are averaged: if the constant changed by 50 % and the others made
    up for it as well as they can, the outputs would change by less than their noise. It then rests on noise that is
    white and a model that is right to a small part of the noise.
    """

    value: float
    unit: str
    std: float | None
    determined: bool
    averaged: bool = False


@dataclass(frozen=True)
class PracticalIdentifiability:
    """What records determine. ``constants``: free constants by name.

    ``rank``: combinations that show above the noise; ``averaged``: further ones that come from averaging alone.
    ``combinations``: these as formulas, with their expected relative standard deviation, those by averaging in
    ``by_averaging``. ``weakest``: relative weights of the worst direction among those that the structure determines,
    ``weakest_std`` its standard deviation (relative). ``remarks``: sentences, with what to do.
    """

    constants: Mapping[str, ExpectedPrecision]
    rank: int
    averaged: int
    combinations: Mapping[str, float]
    by_averaging: Mapping[str, float]
    weakest: Mapping[str, float]
    weakest_std: float
    excitation: tuple[Excitation, ...]
    remarks: tuple[str, ...]
    failure: str = ""

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Constants whose interval is too wide."""
        return tuple(name for name, c in self.constants.items() if not c.determined)


def analyse_practical_identifiability(
    model: Model,
    experiments: Experiment | Sequence[Experiment],
    *,
    noise: Mapping[str, float] | None = None,
    at_rest: bool = False,
    method: str = "automatic",
    substeps: int = 0,
    structure: StructuralIdentifiability | None = None,
) -> PracticalIdentifiability:
    """Which constants, and which combinations of them, the records determine near the present values of ``model``.

    From the slopes of a free run over each record; initial states are estimated along, unless ``at_rest``. ``noise``:
    standard deviation by output, estimated from the records if left out. The numbers hold for white noise and a model
    that is right. ``structure``: the model's `analyse_structural_identifiability` from the measured outputs, if it is at hand.

    Raises DataError and ModelError for records that do not go with the model.
    """
    problem = prepare_problem(model, experiments, noise, at_rest=at_rest, method=method, substeps=substeps)
    return analyse_problem(
        problem, structure or analyse_structural_identifiability(model, list_measured_outputs(problem), at_rest=at_rest)
    )


def list_measured_outputs(problem: EstimationProblem) -> list[str]:
    """Names of the outputs that at least one record has, but for sensors that were left out as dead."""
    names = [o.name for o in problem.model.outputs if any(o.name in e.outputs for e in problem.experiments)]
    return [name for name in names if name not in problem.constant_outputs]


def analyse_problem(
    problem: EstimationProblem, structure: StructuralIdentifiability | None
) -> PracticalIdentifiability:
    """`analyse_practical_identifiability` for a problem that is laid out already; ``structure`` is None where it could not be found out."""
    variables, n = problem.variables, len(problem.variables.names)
    drives = tuple(analyse_excitation(e, problem.model, structure=structure) for e in problem.experiments)
    if not n:
        return _nothing(drives, "no constant is free: nothing to determine")
    evaluation = problem.shooting(variables).evaluate(np.zeros(variables.size))
    if not np.isfinite(evaluation.cost):
        record, sample = evaluation.failed or (0, 0)
        time, name = float(problem.records[record].h[:sample].sum()), problem.experiments[record].name
        return _nothing(
            drives, f"the model overflows on {name} after {time:.3g} s at the start values; give others with --start"
        )
    information = _projected(evaluation.hessian / 2, n)
    samples = evaluation.count / max(len(list_measured_outputs(problem)), 1)
    values, vectors = np.linalg.eigh(information)
    spans = 1 / np.sqrt(np.maximum(values, 1e-300))
    shown, reached = spans * np.sqrt(samples) < HALF, REACH * spans < HALF
    rank, averaged = int(shown.sum()), int((reached & ~shown).sum())
    total = rank + averaged
    sure, thin = _combinations(problem, structure, information, samples, total)
    # Formulas that account for everything say it better than directions of length one, which mix them.
    rank = len(sure) if len(sure) + len(thin) == total else max(rank, len(sure))
    averaged = total - rank
    missing = structure.count - structure.rank if structure else 0
    weakest = {
        name: float(w)
        for name, w in zip(variables.names, vectors[:, min(missing, n - 1)], strict=True)
        if abs(w) > TAKES_PART
    }
    constants = _constants(problem, information, samples)
    remarks = _remarks(structure, rank, averaged, drives)
    span = float(spans[min(missing, n - 1)])
    return PracticalIdentifiability(constants, rank, averaged, sure, thin, weakest, span, drives, remarks)


def _nothing(drives: tuple[Excitation, ...], failure: str) -> PracticalIdentifiability:
    return PracticalIdentifiability({}, 0, 0, {}, {}, {}, 0.0, drives, (), failure)


def _constants(problem: EstimationProblem, information: np.ndarray, samples: float) -> dict[str, ExpectedPrecision]:
    variables = problem.variables
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    weak = values <= OPEN * max(values.max(initial=0.0), 1.0)
    variance = ((vectors[:, ~weak] / values[~weak]) * vectors[:, ~weak]).sum(axis=1) / scale**2
    variance = np.where((np.abs(vectors[:, weak]) > 1e-3).any(axis=1), np.inf, variance)
    found = {}
    for k, name in enumerate(variables.names):
        value, unit = float(variables.base[k]), variables.quantities[k].unit
        if not np.isfinite(variance[k]):
            found[name] = ExpectedPrecision(value, unit, None, False)
            continue
        std = float(np.sqrt(variance[k]) * abs(variables.spans[k]))
        share = std / abs(value) if value else 0.0
        found[name] = ExpectedPrecision(value, unit, std, REACH * share <= HALF, bool(share * np.sqrt(samples) > HALF))
    return found


def _combinations(
    problem: EstimationProblem,
    structure: StructuralIdentifiability | None,
    information: np.ndarray,
    samples: float,
    most: int,
) -> tuple[dict[str, float], dict[str, float]]:
    """Formulas that the records determine, above the noise and by averaging, each with its relative deviation."""
    if structure is None:
        return {}, {}
    p, which = problem.variables.fixed, free_parameter_indices(problem.model)
    covariance = np.linalg.inv(information + np.eye(len(which)) / PRIOR**2)
    found = []
    for candidate in _candidates(problem.model, structure, p):
        slope = candidate.slope(p, which)
        std = float(np.sqrt(slope @ covariance @ slope))
        if np.isfinite(std):
            found.append((candidate.text, slope, std))
    chosen: list[np.ndarray] = []
    groups: tuple[dict[str, float], dict[str, float]] = ({}, {})
    for group, limit in zip(groups, (HALF / np.sqrt(samples), HALF / REACH), strict=True):
        for text, slope, std in found:
            if len(chosen) < most and std < limit and _new(chosen, slope):
                chosen.append(slope)
                group[text] = std
    return groups


def _candidates(model: Model, structure: StructuralIdentifiability, p: np.ndarray) -> list[ParameterCombination]:
    """The formulas that the structure determines at the parameters ``p``, plain ones first."""
    names, which = list(structure.constants), free_parameter_indices(model)
    scalings = [[d.weights.get(name, 0.0) for name in names] for d in structure.directions]
    null = np.array(scalings).reshape(-1, len(names)).T
    basis = np.linalg.qr(null)[0] if null.shape[1] else np.zeros((len(names), 0))
    found = list(
        find_product_combinations(model, [SensitivityRank(structure.rank, basis, basis[:, :0], np.zeros(0), 1.0, True)])
    )
    if model.system.linear:
        generator = np.random.default_rng(0)
        slopes = np.where(p[which] != 0, p[which], 1.0)
        here = rank_at(
            compute_transfer_function_sensitivity(model.system, p, which, slopes, structure.at_rest, generator),
            structure.outputs,
        )
        found = [
            c for c in [*found, *find_transfer_function_combinations(model)] if is_determined(c.slope(p, which), here)
        ]
    return sorted(found, key=simplicity_key)


def _new(chosen: list[np.ndarray], slope: np.ndarray) -> bool:
    matrix = np.array([s / np.linalg.norm(s) for s in [*chosen, slope]])
    return bool(np.linalg.svd(matrix, compute_uv=False)[-1] > 1e-3)


def _projected(information: np.ndarray, n: int) -> np.ndarray:
    """Information on the first ``n`` entries when the others (initial states) are estimated as well."""
    a, b, c = information[:n, :n], information[:n, n:], information[n:, n:]
    if not c.size:
        return a
    scale = 1 / np.sqrt(np.maximum(np.diag(c), 1e-300))
    b, c = b * scale, c * np.outer(scale, scale)
    return a - b @ np.linalg.pinv(c, rcond=1e-12, hermitian=True) @ b.T


def _remarks(
    structure: StructuralIdentifiability | None, rank: int, averaged: int, drives: Sequence[Excitation]
) -> tuple[str, ...]:
    found = []
    if structure and rank + averaged < structure.rank:
        found.append(
            f"the structure allows {structure.rank} combinations, these data show {rank + averaged}: another input or less"
            " noise is needed, not another sensor"
        )
    if averaged:
        found.append(
            f"{averaged} of {rank + averaged} combinations come from averaging noise that must be white, with a model that is"
            " right to a part of the noise: do not rely on them"
        )
    return (*found, *dict.fromkeys(w for drive in drives for w in drive.warnings))
