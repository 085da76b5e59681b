"""Which transcription suits a model and its record, and why."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgWarning, expm

from greybox.base import Finding, Severity
from greybox.estimation.optim.gauss_newton import run_gauss_newton
from greybox.estimation.optim.minimisation import Minimisation
from greybox.estimation.options import DEFAULT_POLICY, FitOptions, Transcription, TranscriptionPolicy
from greybox.estimation.transcription.problem import EstimationProblem, TranscriptionReason, make_strategy
from greybox.model import System
from greybox.simulation.free_run import linearise_along
from greybox.simulation.integrators.discretisation import choose_implicit_method
from greybox.simulation.integrators.runge_kutta import compute_fastest_rate
from greybox.simulation.kernel.record import Record


@dataclass(frozen=True)
class TranscriptionChoice:
    """A transcription (`Transcription` without ``automatic``), why it was chosen (None where it was asked for), and the problem with the
    steps that go with it.
    """

    transcription: Transcription
    reason: Finding | None
    problem: EstimationProblem

    def to_strategy(self, **values: object) -> Finding:
        """The strategy with what the search was made of."""
        code = "" if self.reason is None else str(self.reason.code)
        reason_values = {} if self.reason is None else dict(self.reason.values)
        return make_strategy(self.transcription, reason=code, reason_values=reason_values, **values)

    def follow_freely(self) -> TranscriptionChoice:
        """Single shooting in place of the segments that were chosen."""
        assert self.reason is not None
        return replace(
            self,
            transcription=Transcription.SINGLE,
            reason=replace(self.reason, code=TranscriptionReason.FREE_RUN_FOLLOWS),
        )


def select_transcription(problem: EstimationProblem, options: FitOptions) -> TranscriptionChoice:
    """The transcription that was asked for, else the one that suits the model and the longest record at the start values.

    A stiff model also gets implicit steps, unless the method or the substeps were given.
    """
    longest = max(problem.records, key=lambda r: r.duration)
    policy, p = options.policy, problem.start_parameters
    proposal = propose_transcription(
        problem.model.system,
        p,
        longest,
        policy=policy.transcription,
        free_run=options.transcription == Transcription.SINGLE or options.arc_length > 0,
    )
    # One that goes on from a solution keeps the steps that were found there.
    if proposal.implicit and problem.method == options.method == "automatic" and not options.substeps:
        problem = replace(problem, method=proposal.implicit).with_step(0, p)
    if options.arc_length:
        return TranscriptionChoice(Transcription.ARCS, None, problem)
    if options.transcription != Transcription.AUTOMATIC:
        return TranscriptionChoice(Transcription(options.transcription), None, problem)
    return TranscriptionChoice(proposal.transcription, proposal.reason, problem)


def shorten_steps(problem: EstimationProblem, options: FitOptions) -> EstimationProblem | None:
    """``problem``, which cannot be run from where it begins, with steps that follow the error and are so short that it can; None where none
    are.

    Next to constants with which a model grows without end, an error of the steps decides whether it does.
    """
    if options.method != "automatic" or options.substeps:
        return None
    stable = problem.with_stable_steps()
    for _ in range(options.policy.step_refinement.halvings if stable.step.adaptive else 0):
        if np.isfinite(stable.shooting().evaluate(stable.variables.here).cost):
            return stable
        stable = stable.halve_step()
    return None


# Damped steps of a free run by which it is tried: enough to leave a start, and few beside those of a search.
TRIAL_STEPS = 4


def try_free_run(choice: TranscriptionChoice, options: FitOptions) -> TranscriptionChoice:
    """``choice``, or single shooting where segments were chosen for a stiff model whose free run gains what its slopes promise.

    Rates far apart, and amounts that grow, look like instability in each point. Whether errors run away from the data, as in chaos, is
    seen from a few steps: there no step gains what it should.
    """
    problem, reason = choice.problem, choice.reason
    if reason is None or reason.code != TranscriptionReason.UNSTABLE or not problem.step.implicit:
        return choice
    shooting, (low, high) = problem.shooting(), problem.variables.bounds()
    policy = options.policy.minimisation
    search = Minimisation(shooting.evaluate, 1.0, None, None, policy)
    if not np.isfinite(search(problem.variables.here).cost) or not run_gauss_newton(
        search, low, high, policy.damped, steps=TRIAL_STEPS, while_predicted=True
    ):
        return choice
    return choice.follow_freely()


class TranscriptionProposal(NamedTuple):
    """A transcription, why it was proposed (a finding with a code of `TranscriptionReason`), and the implicit method it needs, if any."""

    transcription: Transcription
    reason: Finding
    implicit: str = ""


# Points along the record in which the equations are linearised.
LINEARISATION_POINTS = 9
# A mode that forgets less than this share of its state over the record counts as an integrator.
FORGOTTEN_SHARE = 0.03
# Time constants of the slowest other mode after which an integrator's drift leaves the data.
LONG_RUN = 50.0


def propose_transcription(
    system: System,
    p: np.ndarray,
    record: Record,
    *,
    policy: TranscriptionPolicy = DEFAULT_POLICY.transcription,
    free_run: bool = False,
) -> TranscriptionProposal:
    """The transcription that suits a model and its record, and why.

    Multiple shooting where errors grow along the record (an unstable or chaotic plant). Where the fastest mode asks for more explicit
    steps than are sensible (stiff, nonlinear) single shooting with implicit steps (multiple shooting then has them, too), or collocation
    if there are too many states for those (smooth, and not too long). Else single shooting on a growing part of the record, which also
    keeps the drift of an integrator near the data.

    Parameters
    ----------
    system, p
        The equations, judged at the parameters ``p`` (np,) in several points of the record: measured states as measured, hidden ones as
        declared.
    record
        The longest record.
    policy
        The limits.
    free_run
        Whether a free run, or arcs, were asked for, however errors grow; only their steps are to be chosen.
    """
    jacobians = _linearise_along(system, p, record, LINEARISATION_POINTS)
    duration = record.duration
    growth = 0.0 if free_run else estimate_error_growth(system, p, record, policy, jacobians)
    # exp(rate duration) is the factor by which an error grows over the record.
    stiff = _propose_for_stiff(system, jacobians, record)
    if growth * duration > math.log(policy.max_error_growth):
        values = {"rate": growth, "exponent": growth * duration, "duration": duration}
        implicit = stiff.implicit if stiff else ""
        return _propose(Transcription.MULTIPLE, TranscriptionReason.UNSTABLE, values, implicit)
    if stiff:
        return stiff
    eigenvalues = np.linalg.eigvals(jacobians).ravel()
    # Modes that forget something over the record: the others integrate.
    decays = -eigenvalues.real[-eigenvalues.real * duration > FORGOTTEN_SHARE]
    slowest = 1 / decays.min() if len(decays) else 0.0
    if not (np.abs(eigenvalues) * duration <= FORGOTTEN_SHARE).any():
        return _propose(Transcription.SINGLE, TranscriptionReason.STABLE)
    constants: dict[str, float | None] = {
        "duration": duration,
        "time_constants": float(duration / slowest) if slowest else None,
    }
    if duration <= LONG_RUN * slowest:
        return _propose(Transcription.SINGLE, TranscriptionReason.INTEGRATING_SHORT, constants)
    return _propose(Transcription.SINGLE, TranscriptionReason.INTEGRATING_GROWING, constants)


def estimate_error_growth(
    system: System,
    p: np.ndarray,
    record: Record,
    policy: TranscriptionPolicy = DEFAULT_POLICY.transcription,
    jacobians: np.ndarray | None = None,
) -> float:
    """Mean rate (1/s) at which small errors grow along ``record``; negative where they decay.

    The largest real part of an eigenvalue; where that changes along the record, the growth that is left of it over the record.
    ``jacobians`` (k, nx, nx): those in some points of the record, if known already.
    """
    if jacobians is None:
        jacobians = _linearise_along(system, p, record, LINEARISATION_POINTS)
    if not jacobians.size:  # no point, or relations alone: nothing grows
        return 0.0
    # The largest Re(lambda) in each point.
    rates = np.linalg.eigvals(jacobians).real.max(axis=1)
    duration = record.duration
    if system.linear or rates.max() * duration <= math.log(policy.max_error_growth):
        return float(rates.mean())
    # A mode that is unstable in some points only may decay over the record as a whole.
    return _compute_lyapunov_exponent(_linearise_along(system, p, record, GROWTH_POINTS), duration)


def _propose(
    transcription: Transcription,
    reason: TranscriptionReason,
    values: Mapping[str, float | None] = MappingProxyType({}),
    implicit: str = "",
) -> TranscriptionProposal:
    return TranscriptionProposal(transcription, Finding(reason, Severity.NOTE, "", dict(values)), implicit)


# Points along the record from which the growth of errors is computed, where one of the first points is unstable.
GROWTH_POINTS = 1000


@np.errstate(over="ignore", invalid="ignore")  # a transition that overflows grows without end
def _compute_lyapunov_exponent(jacobians: np.ndarray, duration: float) -> float:
    """Largest Lyapunov exponent (1/s) over the second half of the record, from the product of the transitions.

    The first half turns the errors into the direction that grows most. What grows like a power of time (a chain of integrators)
    gains a factor of two or four in the second half, which is not instability.
    """
    errors, logarithm = np.eye(jacobians.shape[1]), 0.0
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LinAlgWarning)
            transitions = expm(jacobians * (duration / len(jacobians)))
    except np.linalg.LinAlgError:  # Pade's quotient has no value, of a candidate that has gone astray
        return math.inf
    for k, transition in enumerate(transitions):
        # e(t + h) = exp(J h) e(t), scaled back before it overflows; its logarithm is added up.
        errors = transition @ errors
        size = float(np.linalg.norm(errors))
        if not 0 < size < math.inf:
            return math.inf if size else -math.inf
        errors /= size
        logarithm += math.log(size) if k >= len(jacobians) // 2 else 0.0
    return logarithm / (duration * (len(jacobians) - len(jacobians) // 2) / len(jacobians))


# Explicit substeps a sample beyond which a model counts as stiff.
MAX_EXPLICIT_SUBSTEPS: float = 32
# ``|h lambda|`` of an explicit substep in that count, as in `DiscretisationPolicy.eigenvalue_step`.
EXPLICIT_STEP = 0.5
# Samples up to which collocation is chosen: its program grows with the record, by some tens of kilobytes a sample.
MAX_COLLOCATION_SAMPLES = 10000


def _propose_for_stiff(system: System, jacobians: np.ndarray, record: Record) -> TranscriptionProposal | None:
    """Implicit steps or collocation, where a fast mode rules explicit steps out."""
    fastest = max((compute_fastest_rate(jacobian, system.relaxing) for jacobian in jacobians), default=0.0)
    # So many explicit steps keep |h lambda| where they are stable and accurate.
    substeps = fastest * record.period / EXPLICIT_STEP
    if system.linear or substeps <= MAX_EXPLICIT_SUBSTEPS:
        return None
    values = {"fastest": 1 / fastest, "substeps": substeps}
    if method := choose_implicit_method(system):
        return _propose(Transcription.SINGLE, TranscriptionReason.STIFF_IMPLICIT, values, method)
    if system.dry or system.updates or system.delays:
        return _propose(Transcription.SINGLE, TranscriptionReason.STIFF_NOT_SMOOTH, values)
    samples = len(record.samples(record.u))
    if samples > MAX_COLLOCATION_SAMPLES:
        return _propose(Transcription.SINGLE, TranscriptionReason.STIFF_LONG, values | {"samples": samples})
    return _propose(Transcription.COLLOCATION_RADAU, TranscriptionReason.STIFF_COLLOCATION, values)


def _linearise_along(system: System, p: np.ndarray, record: Record, points: int) -> np.ndarray:
    """Jacobians (k, nx, nx) of the equations in several points of the record, those that can be computed; a linear model has one."""
    start = np.asarray(system.start_function(p)[0]).ravel()
    columns = {system.outputs[j].name(): j for j in range(system.outputs.numel()) if system.outputs[j].is_symbolic()}
    rows = np.unique(np.linspace(0, len(record.u) - 1, points).astype(int))
    x = np.tile(start, (len(rows), 1))
    for k, name in enumerate(system.state_names):
        if name in columns:
            values = record.y[:, columns[name]]
            known = np.flatnonzero(np.isfinite(values))
            if len(known):
                x[:, k] = values[known[np.minimum(np.searchsorted(known, rows), len(known) - 1)]]
    u = record.u[rows, : system.u.numel()]
    jacobians = linearise_along(system, x, u, p)[0]
    return jacobians[np.isfinite(jacobians).all(axis=(1, 2))]
