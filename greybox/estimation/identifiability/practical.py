"""`analyse_practical_identifiability`: what given records determine of the free constants, near their present values."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from greybox.base import DataError, Finding, Severity
from greybox.base.linear_algebra import are_independent, decompose_symmetric, eliminate, orthonormalise
from greybox.base.numerics import INDEPENDENT_FORMULA, TINY
from greybox.data.experiment import Experiment
from greybox.estimation.identifiability import structural
from greybox.estimation.identifiability.combinations import (
    find_product_combinations,
    find_transfer_function_combinations,
    free_parameter_indices,
    is_determined,
    simplicity_key,
)
from greybox.estimation.identifiability.excitation import Excitation, analyse_excitation
from greybox.estimation.identifiability.sensitivity import RANDOM_EXPERIMENT_NOISE_SHARE, IdentifiabilityCode
from greybox.estimation.identifiability.transfer_functions import compute_transfer_function_sensitivity
from greybox.estimation.options import FitOptions
from greybox.estimation.result import Fit
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.estimation.transcription.problem import EstimationProblem
from greybox.model import Model
from greybox.simulation.simulate import simulate


@dataclass(frozen=True)
class ExpectedPrecision:
    """What the records can say about one constant.

    Parameters
    ----------
    value, unit
        The present value and its unit.
    std
        Standard deviation to expect, in ``unit``; None: infinite.
    determined
        Whether the 95 % interval stays within 50 % of the value.
    averaged
        Only because many samples are averaged: if the constant changed by 50 % and the others made up for it as well as they can,
        the outputs would change by less than their noise. It then rests on noise that is white and a model that is right to a small
        part of the noise.
    """

    value: float
    unit: str
    std: float | None
    determined: bool
    averaged: bool = False


@dataclass(frozen=True)
class PracticalIdentifiability:
    """What records determine.

    Parameters
    ----------
    constants
        Free constants by name; as in a fit, what priors say of them counts.
    rank
        Combinations that show above the noise.
    averaged
        Further ones that come from averaging alone.
    combinations, by_averaging
        These as formulas, with their expected relative standard deviation.
    weakest, weakest_std
        Relative weights of the worst direction among those that the structure determines, and its relative standard deviation.
    excitation
        How rich the inputs of each record are.
    findings
        What limits the records.
    failure
        Why nothing can be said, None where something can.
    """

    constants: Mapping[str, ExpectedPrecision]
    rank: int
    averaged: int
    combinations: Mapping[str, float]
    by_averaging: Mapping[str, float]
    weakest: Mapping[str, float]
    weakest_std: float
    excitation: tuple[Excitation, ...]
    findings: tuple[Finding, ...]
    failure: Finding | None = None

    KEYS: ClassVar[str] = """
        constants rank averaged combinations by_averaging weakest weakest_std excitation findings failure=str(failure)
        remarks=str(findings)
        """

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
    structure: structural.StructuralIdentifiability | None = None,
) -> PracticalIdentifiability:
    """Which constants, and which combinations of them, given records determine near the present values of a model.

    From the slopes of a free run over each record; initial states are estimated along, unless ``at_rest``. The numbers hold for
    white noise and a model that is right.

    Parameters
    ----------
    model
        The model with its present values.
    experiments
        The records.
    noise
        Standard deviation by output, estimated from the records if left out.
    at_rest
        The records begin in the declared state.
    method, substeps
        How the model is integrated, as in `greybox.FitOptions`.
    structure
        The model's `analyse_structural_identifiability` from the measured outputs, if it is at hand.

    Returns
    -------
    PracticalIdentifiability
        Expected standard deviations, combinations, and what limits the records.

    Raises
    ------
    DataError, ModelError
        For records that do not go with the model.

    Examples
    --------
    >>> analyse_practical_identifiability(model, record, noise={"x": 2e-7}).undetermined  # doctest: +SKIP
    ('La',)
    """
    options = FitOptions(at_rest=at_rest, method=method, substeps=substeps)
    problem = prepare_problem(model, experiments, noise, options)
    if structure is None and model.has_equations:
        measured = list_measured_outputs(problem)
        structure = structural.analyse_structural_identifiability(model, measured, at_rest=at_rest)
    return analyse_problem(problem, structure, options)


def list_measured_outputs(problem: EstimationProblem) -> list[str]:
    """Names of the outputs that at least one record has, but for sensors that were left out as dead."""
    names = [o.name for o in problem.model.outputs if any(o.name in e.outputs for e in problem.experiments)]
    return [name for name in names if name not in problem.constant_outputs]


# Half width of a 95 % interval, over the value, beyond which a constant is not determined.
MAX_RELATIVE_INTERVAL = 0.5
# Standard deviations in half a 95 % interval.
INTERVAL_STDS = 1.96
# Weight of a constant in a direction of length one, from which it takes part.
DIRECTION_WEIGHT = 0.3


def analyse_problem(
    problem: EstimationProblem, structure: structural.StructuralIdentifiability | None, options: FitOptions
) -> PracticalIdentifiability:
    """`analyse_practical_identifiability` for a problem that ``options`` laid out; ``structure`` is None where it is not known."""
    variables, n = problem.variables, len(problem.variables.names)
    drives = tuple(analyse_excitation(e, problem.model, structure=structure) for e in problem.experiments)
    if not n:
        failure = Finding(IdentifiabilityCode.NO_FREE_CONSTANT)
        return PracticalIdentifiability({}, 0, 0, {}, {}, {}, 0.0, drives, (), failure)
    evaluation = problem.shooting(variables).evaluate(variables.here)
    if not np.isfinite(evaluation.cost):
        record, sample = evaluation.failed or (0, 0)
        time, name = float(problem.records[record].h[:sample].sum()), problem.experiments[record].name
        failure = Finding(IdentifiabilityCode.MODEL_OVERFLOWS, Severity.ERROR, name, {"time": time})
        return PracticalIdentifiability({}, 0, 0, {}, {}, {}, 0.0, drives, (), failure)
    constants_and_states = evaluation.hessian / 2
    first_states = np.arange(n, len(constants_and_states))
    # Schur complement: initial states are estimated with the constants.
    information = (eliminate(constants_and_states, np.arange(n), first_states) @ constants_and_states)[:, :n]
    samples = evaluation.count / max(len(list_measured_outputs(problem)), 1)
    # What each output says in one row; a prior is not averaged, it holds its 1 / std^2 in one row as in all.
    known = np.diag(variables.penalty(variables.here)[2] / 2)
    of_one_row = (information - known) / samples + known
    values, vectors = np.linalg.eigh(information)
    # Standard deviation along each eigenvector of the information, in relative changes of the constants.
    stds = 1 / np.sqrt(np.maximum(values, TINY))
    widest = MAX_RELATIVE_INTERVAL
    # Over the noise of single samples, and after averaging over all of them.
    shown = 1 / np.sqrt(np.maximum(np.linalg.eigvalsh(of_one_row), TINY)) < widest
    reached = INTERVAL_STDS * stds < widest
    rank, averaged = int(shown.sum()), int((reached & ~shown).sum())
    total = rank + averaged
    above, by_averaging = _choose_combinations(problem, structure, information, samples, total)
    # Formulas that account for everything say it better than directions of length one, which mix them.
    is_told_by_formulas = len(above) + len(by_averaging) == total and not variables.has_prior.any()
    rank = len(above) if is_told_by_formulas else max(rank, len(above))
    averaged = total - rank
    missing = structure.count - structure.rank if structure else 0
    weakest = {
        name: float(w)
        for name, w in zip(variables.names, vectors[:, min(missing, n - 1)], strict=True)
        if abs(w) > DIRECTION_WEIGHT
    }
    constants = _estimate_precision(problem, information, of_one_row)
    findings: list[Finding] = []
    if variables.has_prior.any():
        given = [name for name, has_prior in zip(variables.names, variables.has_prior, strict=True) if has_prior]
        findings.append(Finding(IdentifiabilityCode.PRIORS_COUNT, values={"constants": given}))
    if structure and total < structure.rank:
        sensors = _find_telling_sensors(problem, options, total)
        shortfall = {
            "structure": structure.rank,
            "records": total,
            "driven": bool(problem.model.inputs),
            "sensors": sensors,
        }
        findings.append(Finding(IdentifiabilityCode.RECORDS_SHOW_FEWER, Severity.WARNING, values=shortfall))
    if averaged:
        figures = {"averaged": averaged, "total": total}
        findings.append(Finding(IdentifiabilityCode.AVERAGING_ONLY, Severity.WARNING, values=figures))
    for drive in drives:
        findings += [finding for finding in drive.findings if finding not in findings]
    std = float(stds[min(missing, n - 1)])
    return PracticalIdentifiability(
        constants, rank, averaged, above, by_averaging, weakest, std, drives, tuple(findings)
    )


def _find_telling_sensors(problem: EstimationProblem, options: FitOptions, least: int) -> list[str]:
    """States that nobody measures, of which a sensor would let the same records show more than ``least`` combinations.

    Each is tried: its run at the present values is the reading, with the noise of a sensor that suits its movement.
    """
    telling, runs = [], [simulate(problem.model, e) for e in problem.experiments]
    measured = {name: float(problem.noise.std[j]) for j, name in enumerate(problem.noise.outputs)}
    measured = {name: std for name, std in measured.items() if name in list_measured_outputs(problem)}
    for state in structural.find_unmeasured_states(problem.model):
        movement = max(float(np.std(run.states[state])) for run in runs)
        if not (np.isfinite(movement) and movement > 0):
            continue
        records = [
            e.with_outputs({**e.outputs, state: run.states[state]})
            for e, run in zip(problem.experiments, runs, strict=True)
        ]
        noise = {**measured, state: RANDOM_EXPERIMENT_NOISE_SHARE * movement}
        sensed = prepare_problem(structural.add_sensors(problem.model, [state]), records, noise, options)
        precision = analyse_problem(sensed, None, options)
        if precision.rank + precision.averaged > least:
            telling.append(state)
    return telling


def _estimate_precision(
    problem: EstimationProblem, information: np.ndarray, of_one_row: np.ndarray
) -> dict[str, ExpectedPrecision]:
    variables = problem.variables
    single = np.diag(decompose_symmetric(of_one_row).pseudo_inverse)
    decomposition = decompose_symmetric(information)
    variance = np.where(decomposition.is_open, np.inf, np.diag(decomposition.pseudo_inverse))
    constants = {}
    for k, name in enumerate(variables.names):
        value, unit = float(variables.base[k]), variables.quantities[k].unit
        if not np.isfinite(variance[k]):
            constants[name] = ExpectedPrecision(value, unit, None, False)
            continue
        # From z to the unit of the constant.
        std = float(np.sqrt(variance[k]) * abs(variables.spans[k]))
        share = std / abs(value) if value else 0.0
        determined = INTERVAL_STDS * share <= MAX_RELATIVE_INTERVAL
        of_one = float(np.sqrt(single[k]) * abs(variables.spans[k]))
        averaged = bool(value) and of_one > MAX_RELATIVE_INTERVAL * abs(value)
        constants[name] = ExpectedPrecision(value, unit, std, determined, averaged)
    return constants


# What is known without data, as a standard deviation of the logarithm: the order of magnitude.
IDENTIFIABILITY_PRIOR_SPREAD: float = math.log(10.0)


def _choose_combinations(
    problem: EstimationProblem,
    structure: structural.StructuralIdentifiability | None,
    information: np.ndarray,
    samples: float,
    most: int,
) -> tuple[dict[str, float], dict[str, float]]:
    """Formulas that the records determine, above the noise and by averaging, each with its relative deviation."""
    if structure is None:
        return {}, {}
    p, which = problem.variables.fixed, free_parameter_indices(problem.model)
    # With the order of magnitude known: an open direction then has a large variance instead of none.
    covariance = np.linalg.inv(information + np.eye(len(which)) / IDENTIFIABILITY_PRIOR_SPREAD**2)
    # The formulas that the structure determines at these parameters, plain ones first.
    model, names = problem.model, list(structure.constants)
    scalings = [[d.weights.get(name, 0.0) for name in names] for d in structure.directions]
    basis = orthonormalise(np.array(scalings).reshape(-1, len(names)).T)
    formulas = list(find_product_combinations(model, [basis]))
    if model.system.linear:
        generator = np.random.default_rng(0)
        slopes = np.where(p[which] != 0, p[which], 1.0)
        sensitivity = compute_transfer_function_sensitivity(
            model.system, p, which, slopes, structure.at_rest, generator
        )
        present = sensitivity.decompose(structure.outputs).without_doubtful().null_basis
        formulas += find_transfer_function_combinations(model)
        formulas = [c for c in formulas if is_determined(c.slope(p, which), present)]
    candidates = []
    for candidate in sorted(formulas, key=simplicity_key):
        slope = candidate.slope(p, which)
        # Delta method: d log f = slope' d log p.
        variance = float(slope @ covariance @ slope)
        if 0 <= variance < np.inf:  # rounding can make it negative where the information is next to singular
            candidates.append((candidate.text, slope, float(np.sqrt(variance))))
    chosen: list[np.ndarray] = []
    groups: tuple[dict[str, float], dict[str, float]] = ({}, {})
    widest = MAX_RELATIVE_INTERVAL
    for group, limit in zip(groups, (widest / np.sqrt(samples), widest / INTERVAL_STDS), strict=True):
        for text, slope, std in candidates:
            if len(chosen) < most and std < limit and are_independent([*chosen, slope], INDEPENDENT_FORMULA):
                chosen.append(slope)
                group[text] = std
    return groups


# After a fit that left constants open: what would determine them.


def recommend_after_fit(fit: Fit) -> tuple[Finding, ...]:
    """What would determine the constants that the records of a fit left open.

    Another output of the model that was not measured, a sensor, a constant that is known, or a relation between two (tried one
    after the other, see `analyse_structural_identifiability`); or, where the measured outputs could show them all, a richer record.

    Parameters
    ----------
    fit
        A fit, of which some free constants may have no standard deviation.

    Returns
    -------
    tuple of Finding
        The most effective first; empty where no constant is open, or nothing can be said.

    Examples
    --------
    >>> [finding.code for finding in recommend_after_fit(fit)]  # doctest: +SKIP
    ['measure_output', 'fix_constants']
    """
    undetermined = [n for n, e in fit.parameters.items() if not e.fixed and e.std is None and not e.at_bound]
    if not (fit.success and undetermined and fit.model.has_equations):
        return ()
    try:
        at_rest = bool(fit.provenance.options.get("at_rest", False))
        structure = structural.analyse_structural_identifiability(fit.model, list(fit.misfit), at_rest=at_rest)
    except DataError:  # a nonlinear model that overflows wherever it is looked at
        return ()
    if structure.complete:
        figures = {
            "inputs": list(structure.inputs),
            "outputs": list(structure.outputs),
            "count": structure.count,
            "certain": structure.certain,
        }
        return (Finding(IdentifiabilityCode.RICHER_RECORD, values=figures),)
    return structure.recommendations
