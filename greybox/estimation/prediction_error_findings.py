"""What a prediction-error fit says: how it ended, what its process noise means, what to know before trusting a number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from greybox.estimation.findings import CAUSES, describe_direction, describe_shifts
from greybox.estimation.likelihood_covariance import SANDWICH, LikelihoodCovariance
from greybox.estimation.likelihood_search import LikelihoodOptimum
from greybox.estimation.parameter_constancy import ParameterShift
from greybox.estimation.problem import EstimationProblem
from greybox.estimation.process_noise_tests import ProcessNoiseTest
from greybox.model import Model
from greybox.result import Estimate, Misfit
from greybox.units import format_unit

# Share of a standard deviation that half the step may move a constant.
SHIFTED = 0.1


def describe_likelihood_status(
    found: LikelihoodOptimum, one_step: Mapping[str, Misfit], free_run: Mapping[str, Misfit]
) -> str:
    """The status in plain words, with the error one step ahead and of the free run beside it."""
    text = found.status.value
    if found.status in CAUSES:
        text += f". Likely causes, in order: {'; '.join(f'({k + 1}) {c}' for k, c in enumerate(CAUSES[found.status]))}"
    if found.evaluation.failed:
        return f"{text}. The filter of experiment {found.evaluation.failed[0] + 1} is no longer finite"
    if one_step:
        worst = max(one_step, key=lambda name: one_step[name].noise_ratio)
        text += (
            f"; error {one_step[worst].noise_ratio:.3g} times the noise in {worst} one step ahead,"
            f" {free_run[worst].noise_ratio:.3g} times in a free run"
        )
    return text


def find_likelihood_issues(
    model: Model,
    problem: EstimationProblem,
    found: LikelihoodOptimum,
    spread: LikelihoodCovariance,
    estimates: Mapping[str, Estimate],
    intensities: Sequence[ProcessNoiseTest],
    shift: Mapping[str, float],
    moves: Sequence[ParameterShift] = (),
) -> tuple[str, ...]:
    """Sentences in order of importance; ``model`` has the fitted values."""
    result = [f"not determined by these data: {describe_direction(d)}" for d in spread.constants.open_directions]
    zero = [i.name for i in intensities if i.value == 0]
    at_bound = [name for name, e in estimates.items() if e.at_bound and name not in zero]
    if at_bound:
        result.append(
            f"stopped by a bound: {', '.join(at_bound)}; widen the bound, or the model needs something else there"
        )
    told_apart = [i.name for i in intensities]
    wide = [
        n for n, e in estimates.items() if e.std is not None and not (e.at_bound or e.determined or n in told_apart)
    ]
    if wide:
        result.append(f"not determined (the 95 % interval reaches further than half the value): {', '.join(wide)}")
    result += describe_shifts(moves)
    result += [describe_process_noise(model, problem, i, estimates[i.name]) for i in intensities]
    kind, inflation = spread.constants.kind, spread.constants.inflation
    if kind == SANDWICH and inflation is not None and np.isfinite(inflation).any():
        result.append(
            "the innovations are correlated from sample to sample: the model and its noise lack something still; the intervals"
            f" allow for it, and are up to {np.nanmax(inflation):.2g} times as wide as white innovations would make them"
        )
    if problem.noise.coloured:
        result.append("the noise is known to be coloured; beside process noise it is taken to be white")
    rough = [f"{n} by {s:.2g}" for n, s in shift.items() if s > SHIFTED]
    if rough:
        result.append(
            f"with half the step the constants change by more than a tenth of their standard deviation ({', '.join(rough)} of it):"
            " raise the number of substeps"
        )
    return tuple(result)


def describe_process_noise(
    model: Model, problem: EstimationProblem, intensity: ProcessNoiseTest, estimate: Estimate
) -> str:
    """One sentence on one intensity: where it acts, how sure it is, and what it means."""
    unit = format_unit(estimate.unit)
    places = find_driven_balances(model, intensity.name)
    states = ", ".join(places)
    balances = " and ".join(f"the balance {b!r}" for b in dict.fromkeys(b for b, _, _ in places.values()))
    upper = "" if intensity.limits is None else f"; below {intensity.limits[1]:.3g} {unit} at 95 %"
    if intensity.value == 0:
        return f"process noise on {states} ({intensity.name}): none; {balances} lacks nothing that these records show{upper}"
    if not intensity.significant:
        return (
            f"process noise on {states} ({intensity.name}): not significant (p = {intensity.p_value:.2g}); {balances} lacks nothing"
            f" that these records show for certain{upper}"
        )
    period = float(np.median(np.concatenate([r.h for r in problem.records])) * problem.records[0].every)
    sizes = [
        f"{size / np.sqrt(period):.3g} {format_unit(b_unit)} averaged over a sample of {period:.3g} s"
        for _, b_unit, size in places.values()
    ]
    return (
        f"process noise on {states} ({intensity.name} = {estimate.value:.3g} {unit}) is clearly above zero (likelihood ratio"
        f" {intensity.ratio:.3g}): {balances} lacks something, or something random acts there, as large as {' and '.join(sizes)}"
    )


def find_driven_balances(model: Model, name: str) -> dict[str, tuple[str, str, float]]:
    """States that the intensity ``name`` pushes -> their balance, its unit, and storage times intensity, in that unit times sqrt(s)."""
    system = model.system
    p = list(model.values.values())
    at = ca.Function("at", [system.x, system.u, system.p], [system.storages, system.diffusion])
    x0 = system.start_function(p)[0]
    storages, sizes = (np.asarray(v).ravel() for v in at(x0, np.zeros(system.u.numel()), p))
    balances = {b.state: b for b in system.balances}
    found = {}
    for k, state in enumerate(system.state_names):
        if name in {s.name() for s in ca.symvar(system.diffusion[k])}:
            balance = balances[state]
            found[state] = balance.name, balance.unit, float(abs(storages[k]) * sizes[k])
    return found
