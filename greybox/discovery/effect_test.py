"""`try_effect` and `drop_effect`: one effect added or removed by hand, with the evidence for and against it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from greybox.base import Check, DataError
from greybox.base.values import Printable, ReadOnly
from greybox.data.experiment import Experiment, as_records
from greybox.discovery.candidates import estimate_scales, generate_starting_points
from greybox.discovery.decision import criterion_gain, excess_cost, judge_effect
from greybox.discovery.holdout import HoldoutError, compare_holdout_errors, validate_candidate
from greybox.discovery.plant_search import fit_with_plant, view_plant
from greybox.discovery.policy import DiscoveryPolicy
from greybox.discovery.problem import DiscoveryProblem, FittedCandidate
from greybox.estimation import Fit, FitOptions
from greybox.estimation.fit import fit as fit_model
from greybox.estimation.validate import validate
from greybox.model import Effect, Model
from greybox.model.effects.catalogue import effect
from greybox.model.effects.scales import AMPLITUDE_GRID, tailor_to_record


@dataclass(frozen=True, eq=False)
class EffectTest(Printable, ReadOnly):
    """A model with and without one effect, both fitted to the same records.

    Parameters
    ----------
    name
        The effect.
    smaller, larger
        The two fits.
    gain
        Decrease of Schwarz's criterion by the effect, its parameters paid for.
    explained_fraction
        Share of the smaller model's excess cost that the effect explains.
    holdout
        Error on the validation records by output; empty without any.
    is_needed
        Whether the records demand the effect, by the rules of `discover`.
    checks
        What this rests on.
    """

    name: str
    smaller: Fit
    larger: Fit
    gain: float
    explained_fraction: float
    holdout: Mapping[str, HoldoutError]
    is_needed: bool
    checks: tuple[Check, ...] = ()

    @property
    def model(self) -> Model:
        """The model to go on with: the larger where the effect is needed, else the smaller."""
        return self.larger.model if self.is_needed else self.smaller.model


# Starting points from which an effect that is tried by hand is refitted.
EFFECT_TEST_STARTS = 3


def try_effect(
    fit: Fit,
    candidate: Effect | str,
    *,
    validation: Experiment | Sequence[Experiment] = (),
    nominal: Model | None = None,
    policy: DiscoveryPolicy | None = None,
) -> EffectTest:
    """Refit the model of ``fit`` with one more effect, on the same records, from many starting points.

    Parameters
    ----------
    fit
        A finished fit.
    candidate
        An `Effect`, or the name of one of the catalogue.
    validation
        Records that neither fit has seen.
    nominal
        The model as it was before the fit. Its parameters are further starting points, which matters where the plain fit has
        swallowed the effect (dry friction that became damping).
    policy
        The decision numbers.

    Returns
    -------
    EffectTest
        Both fits and the checks. Keep the effect by going on with ``larger``, drop it by not doing so.

    Raises
    ------
    ModelError
        For an effect that the model has no site for.
    DataError
        If the extended model cannot be simulated from any starting point.

    Examples
    --------
    >>> test = gb.discovery.try_effect(fit, "coulomb_friction", validation=record)  # doctest: +SKIP
    >>> test.is_needed  # doctest: +SKIP
    True
    """
    policy = policy or DiscoveryPolicy()
    if not fit.model.has_equations:
        return _try_at_plant(fit, candidate, as_records(validation), policy)
    problem = DiscoveryProblem.from_fit(fit)
    without = problem.to_candidate(fit)
    scales = estimate_scales(without)
    added = tailor_to_record(effect(candidate) if isinstance(candidate, str) else candidate, scales)
    model = fit.model + added
    amplitudes = AMPLITUDE_GRID
    starts = list(generate_starting_points(model, added, without, nominal or fit.model, scales, amplitudes))
    # From its absence as well: an effect that is not there must not make the fit worse.
    refits = (
        problem.refit_best(model, starts, EFFECT_TEST_STARTS, like=without),
        problem.refit_best(model, [model.values], 1, like=without),
    )
    best = min((refit for refit in refits if refit is not None), key=lambda refit: refit.cost, default=None)
    if best is None:
        raise DataError(
            f"effect {added.name!r}: the extended model overflows from every start; state the effect's bounds"
        )
    return _compare(added.name, problem, without, best, validation, policy)


def _try_at_plant(
    plant: Fit, candidate: Effect | str, validation: tuple[Experiment, ...], policy: DiscoveryPolicy
) -> EffectTest:
    """The same at a plant without equations: tried on the model about its run, then fitted with the plant itself."""
    options, noise = FitOptions.from_data(plant.provenance.options), plant.noise.std
    view = view_plant(plant)
    local = fit_model(view.model, view.estimation, noise=noise, options=replace(options, at_rest=True))
    test = try_effect(local, candidate, policy=policy)
    records = [t.experiment for t in plant.traces]
    larger = fit_with_plant(plant, test.larger.model, records, options, noise=noise, validation=validation)
    if larger is None:
        raise DataError(f"{plant.model.title} does not run with {test.name}")
    smaller = plant
    if validation:
        smaller = replace(plant, validation=validate(plant.model, validation, noise=noise, options=options))
    return replace(test, smaller=smaller, larger=larger, holdout=compare_holdout_errors(smaller, larger))


def drop_effect(
    fit: Fit,
    name: str,
    *,
    validation: Experiment | Sequence[Experiment] = (),
    policy: DiscoveryPolicy | None = None,
) -> EffectTest:
    """Refit the model of ``fit`` without one of its effects: is it still needed, now that the others are there?

    Parameters
    ----------
    fit
        A finished fit of a model with effects.
    name
        The effect to remove.
    validation
        Records that neither fit has seen.
    policy
        The decision numbers.

    Returns
    -------
    EffectTest
        Both fits and the checks.

    Raises
    ------
    ModelError
        For an effect that the model does not have.
    DataError
        If the smaller model cannot be simulated.
    """
    policy = policy or DiscoveryPolicy()
    problem = DiscoveryProblem.from_fit(fit)
    larger = problem.to_candidate(fit)
    refit = problem.refit_without(larger, name)
    if refit is None:
        raise DataError(f"model {fit.model.without(name).title!r} overflows with the parameters of {fit.model.title!r}")
    return _compare(name, problem, refit, larger, validation, policy)


def _compare(
    name: str,
    problem: DiscoveryProblem,
    smaller: FittedCandidate,
    larger: FittedCandidate,
    validation: Experiment | Sequence[Experiment],
    policy: DiscoveryPolicy,
) -> EffectTest:
    records = as_records(validation)
    before, after = (validate_candidate(problem, candidate, records) for candidate in (smaller, larger))
    excess = excess_cost(smaller)
    explained = (smaller.cost - larger.cost) / excess if excess else 0.0
    needed = judge_effect(smaller, smaller, larger, policy.selection)
    return EffectTest(
        name,
        before,
        after,
        criterion_gain(smaller, larger),
        min(explained, 1.0),
        compare_holdout_errors(before, after),
        needed.passed,
        needed.checks,
    )
