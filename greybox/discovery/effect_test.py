"""`try_effect` and `drop_effect`: one effect put in or taken out by hand, with the evidence for and against it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.discovery import decision
from greybox.discovery.holdout_error import HoldoutError, compare_holdout_errors
from greybox.discovery.problem import CandidateFit, DiscoveryProblem
from greybox.discovery.starting_points import generate_starting_points
from greybox.effects import Scales, effect, measure_scales, tailor_to_record
from greybox.errors import DataError
from greybox.estimation import fit as fitted
from greybox.estimation import validate
from greybox.experiment import Experiment
from greybox.model import Effect, Model
from greybox.result import Fit
from greybox.values import ReadOnly

# Starts that are refitted, of all that are looked at.
KEPT = 3


@dataclass(frozen=True, eq=False)
class EffectTest(ReadOnly):
    """A model with and without one effect, both fitted to the same records.

    ``smaller`` and ``larger`` are the two fits. ``gain``: how much Schwarz's criterion falls by the effect (its constants paid for);
    ``closed``: the share of the smaller model's misfit beyond noise that the effect takes away; ``gap``: rms misfit on the validation
    records by output, empty without any. ``needed``: whether the records demand the effect, by the rules that `discover` goes by.
    """

    name: str
    smaller: Fit
    larger: Fit
    gain: float
    explained_fraction: float
    gap: Mapping[str, HoldoutError]
    is_needed: bool

    @property
    def model(self) -> Model:
        """The model to go on with: the larger where the effect is needed, else the smaller."""
        return self.larger.model if self.is_needed else self.smaller.model

    def __str__(self) -> str:
        said = "the records demand it: keep it" if self.is_needed else "the records do not demand it: leave it out"
        lines = [
            f"{self.name}: {said}",
            f"  criterion (Schwarz) better by {self.gain:.4g}, needed {decision.STRONG:g}",
            f"  closes {100 * self.explained_fraction:.3g} % of the misfit beyond noise, needed {100 * decision.FIRST_SHARE:g} %",
        ]
        own = next(b.model_names for b in self.larger.model.bound_effects if b.effect.name == self.name)
        for inner, name in own.items():
            constant = self.larger.parameters.get(name)
            if constant is not None:
                spread = "" if constant.std is None else f" +- {constant.std:.2g}"
                lines.append(f"  {inner} = {constant.value:.5g}{spread} {constant.unit}".rstrip())
        lines += [f"  {o}: rms misfit on the validation records {g}" for o, g in self.gap.items()]
        return "\n".join(lines)


def try_effect(
    fit: Fit,
    candidate: Effect | str,
    *,
    validation: Experiment | Sequence[Experiment] = (),
    nominal: Model | None = None,
) -> EffectTest:
    """Refit the model of ``fit`` with one more effect, on the same records, from many starts.

    ``candidate``: an `Effect`, or the name of one of the catalogue. ``nominal``: the model as it was before the fit; its constants are
    further starting points, which matters where the plain fit has swallowed the effect (dry friction that became damping).
    ``validation``: records that neither fit has seen. Keep the effect by going on with ``attempt.larger``, drop it by not doing so.

    Raises ModelError for an effect that the model has no place for, DataError where no start can be simulated.
    """
    bench = DiscoveryProblem.of(fit)
    trial = bench.at(fit)
    scales = estimate_scales(trial)
    added = tailor_to_record(effect(candidate) if isinstance(candidate, str) else candidate, scales)
    model = fit.model + added
    starts = list(generate_starting_points(model, added, trial, nominal or fit.model, scales))
    # Begun absent as well: an effect that is not there must not make the fit worse.
    tried = (bench.best(model, starts, KEPT, like=trial), bench.best(model, [model.values], 1, like=trial))
    found = min((t for t in tried if t is not None), key=lambda t: t.cost, default=None)
    if found is None:
        raise DataError(
            f"effect {added.name!r}: the extended model overflows from every start; state the effect's bounds"
        )
    return _attempt(added.name, bench, trial, found, validation)


def drop_effect(fit: Fit, name: str, *, validation: Experiment | Sequence[Experiment] = ()) -> EffectTest:
    """Refit the model of ``fit`` without one of its effects: is it still needed, now that the others are there?

    Raises ModelError for an effect that the model has not, DataError where the smaller model cannot be simulated.
    """
    bench = DiscoveryProblem.of(fit)
    smaller = fit.model.without(name)
    values = {n: value for n, value in fit.model.values.items() if n in smaller.values}
    found = bench.best(smaller, [values], like=bench.at(fit))
    if found is None:
        raise DataError(f"model {smaller.title!r} overflows from the constants of {fit.model.title!r}")
    return _attempt(name, bench, found, bench.at(fit), validation)


def estimate_scales(trial: CandidateFit) -> Scales:
    """Peaks and times of a fitted model on its first record."""
    _, states = trial.problem.shooting(trial.variables).simulate(np.zeros(trial.variables.size))[0]
    record = trial.problem.records[0]
    return measure_scales(trial.model, states, record.u, float(np.median(record.h)))


def estimated_initial_states(trial: CandidateFit) -> list[dict[str, float]]:
    """The estimated initial states of each record where a trial ended."""
    initial, names = trial.variables.initial, np.array(trial.model.system.state_names)
    return [dict(zip(names[initial.free].tolist(), row[initial.free].tolist(), strict=True)) for row in initial.guess]


def finish_and_validate(
    trial: CandidateFit, bench: DiscoveryProblem, judges: Sequence[Experiment], skip: int = 0
) -> Fit:
    """The trial as a fit with intervals, from its own constants and initial states, judged on other records without their first
    ``skip`` rows."""
    quick = replace(bench.options, progressive=False, thorough=False)
    result = fitted(
        trial.model,
        bench.experiments,
        noise=trial.problem.noise,
        initial=estimated_initial_states(trial),
        options=quick,
    )
    if not judges:
        return result
    seen = validate(result.model, judges, noise=result.noise.std, skip=skip, options=quick)
    return replace(result, validation=seen)


def _attempt(
    name: str,
    bench: DiscoveryProblem,
    smaller: CandidateFit,
    larger: CandidateFit,
    validation: Experiment | Sequence[Experiment],
) -> EffectTest:
    judges = (validation,) if isinstance(validation, Experiment) else tuple(validation)
    before, after = (finish_and_validate(t, bench, judges) for t in (smaller, larger))
    over = decision.excess_cost(smaller)
    explained_fraction = (smaller.cost - larger.cost) / over if over else 0.0
    return EffectTest(
        name, before, after, decision.criterion_gain(smaller, larger), min(explained_fraction, 1.0), compare_holdout_errors(before, after),
        decision.is_effect_accepted(smaller, smaller, larger),
    )  # fmt: skip
