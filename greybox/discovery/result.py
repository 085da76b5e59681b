"""What a discovery gives back, as a value and as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from greybox.base.files import write_file
from greybox.base.findings import Check, Finding
from greybox.base.json_file import ResultKind, read_json
from greybox.base.json_shape import format_json, to_json_data
from greybox.base.values import Printable
from greybox.discovery.certainty import Grade
from greybox.discovery.claims import Claim, claim_values
from greybox.discovery.decision import Verdict
from greybox.discovery.effect_signal import EffectSignal, RemainingError
from greybox.discovery.evidence import EffectEvidence
from greybox.discovery.execution import SearchFailure
from greybox.discovery.holdout import HoldoutError, worst_output
from greybox.discovery.laws.search import Law
from greybox.discovery.localisation import ResidualLocalisation
from greybox.discovery.policy import DiscoveryPolicy
from greybox.discovery.refinement import Refinement
from greybox.discovery.residual_noise import is_shape_correction
from greybox.discovery.selection import SelectionStep
from greybox.discovery.surrogate import Surrogate, find_missing_sites
from greybox.estimation.options import FitOptions
from greybox.estimation.result import Fit

FORMAT = 1
"""Version of ``discovery.json``."""


@dataclass(frozen=True)
class RankedCandidate:
    """One candidate on the estimation records: misfit over noise (`CandidateFit.noise_ratio`), and how far its criterion lies behind."""

    effects: tuple[str, ...]
    misfit: float
    behind: float


@dataclass(frozen=True)
class Discovery(Printable):
    """The result of a discovery: the missing effect and its evidence.

    Parameters
    ----------
    verdict
        ``complete`` (nothing is missing beyond the noise), ``named``, ``ambiguous`` (``alternatives`` explain the records
        as well), or ``unknown`` (something is missing that no effect of the catalogue explains).
    base, best
        Fits of the plain and of the extended model; where the verdict is ``unknown``, ``best`` has the nearest look-alike.
    alternatives
        Other sets of effects that explain the records as well.
    holdout
        Error of both on the validation records, by output.
    ranking
        The candidates, best first.
    localisation
        Where, when and as a function of what the plain model falls short.
    conclusion
        The answer as findings.
    checks
        Every check in order: of the selection, of the validation records, and those that the verdict rests on.
    path
        The steps of the selection, each with its checks.
    findings
        What to know before believing the answer.
    next_steps
        What to do about something unknown, or before believing that nothing is missing.
    effect_signals
        For each effect its signal as the data and as the extended model have it.
    surrogate
        A curve or a tone in the place of an unknown effect.
    refinement
        The further effects that were looked for where more than noise was left; the best model has them.
    evidence
        For each effect of the best model what speaks for it, its probability and grade.
    claims
        What is said of the plain model, as a tree: where something is missing, of which variables, of which family, which effect; each
        with its probability, its grade and its best rival.
    left
        By output, what the best model leaves on the validation records.
    not_tried
        For each effect that was not tried, or could not be fitted, the reason.
    failures
        Everything that failed in the search, with the stage and the reason.
    policy
        The decision numbers.
    options
        How every model was estimated; the fits beside the search go straight to the whole record.
    seconds
        Time that it took.
    laws
        The terms of an equation that the best model has in the place of effects of the catalogue; ``alternatives`` are then equations.
    """

    verdict: Verdict
    base: Fit
    best: Fit
    alternatives: Sequence[tuple[str, ...]]
    holdout: Mapping[str, HoldoutError]
    ranking: Sequence[RankedCandidate]
    localisation: ResidualLocalisation
    conclusion: tuple[Finding, ...] = ()
    checks: tuple[Check, ...] = ()
    path: tuple[SelectionStep, ...] = ()
    findings: tuple[Finding, ...] = ()
    next_steps: tuple[Finding, ...] = ()
    effect_signals: tuple[EffectSignal, ...] = ()
    surrogate: Surrogate | None = None
    refinement: Refinement | None = None
    policy: DiscoveryPolicy = field(default_factory=DiscoveryPolicy)
    seconds: float = 0.0
    options: FitOptions = field(default_factory=FitOptions)
    not_tried: Mapping[str, Finding] = field(default_factory=dict)
    failures: tuple[SearchFailure, ...] = ()
    evidence: tuple[EffectEvidence, ...] = ()
    claims: tuple[Claim, ...] = ()
    left: Mapping[str, RemainingError] = field(default_factory=dict)
    laws: tuple[Law, ...] = ()

    @property
    def sites(self) -> tuple[str, ...]:
        """Where the plain model falls short: the likeliest site with those that the sensors cannot tell from it."""
        return find_missing_sites(self.localisation, self.surrogate)

    @property
    def extended(self) -> Fit:
        """The fit to go on with: the best model; with a surrogate instead where no effect is certain and that does better."""
        surrogate = self.surrogate
        if surrogate is None or self.laws:  # a surrogate is fitted only where no effect has a name
            return self.best
        output = worst_output(self.holdout)
        is_better = surrogate.holdout[output].after < self.holdout[output].after
        return surrogate.fit if is_better else self.best

    @property
    def shape_corrections(self) -> tuple[str, ...]:
        """Second branches, or a curve, in the best model: the shape of an effect is not quite the catalogue's."""
        return tuple(e.name for e in self.best.model.effects if is_shape_correction(e.name))

    @property
    def effects(self) -> list[dict[str, Any]]:
        """Name, site, parameters, grade, probability and share of each effect in the best model; none if the plain model is complete.

        A law has its ``equation``, its ``formula`` and the ``range`` in which it was seen instead of probability and share.
        """
        laws = {law.name: law for law in self.laws}
        evidence = {e.effect: e for e in self.evidence}
        given = {effect.name for effect in self.base.model.effects}  # the user's own are not found by the search
        effects: list[dict[str, Any]] = []
        for bound in self.best.model.bound_effects:
            if is_shape_correction(bound.effect.name) or bound.effect.name in given:
                continue
            parameters = {}
            for name, in_model in bound.model_names.items():
                estimate = self.best.parameters.get(in_model)
                if estimate is not None:
                    parameters[name] = {
                        "value": estimate.value,
                        "std": estimate.std,
                        "unit": estimate.unit,
                        "interval": estimate.interval,
                    }
            law = laws.get(bound.effect.name)
            if law is not None:
                effects.append(
                    {
                        "name": law.name,
                        "site": law.site,
                        "equation": law.equation,
                        "formula": law.formula,
                        "parameters": parameters,
                        "grade": law.grade,
                        "range": {v: list(ends) for v, ends in law.seen.items()},
                        **({"memory": law.memory} if law.memory else {}),
                    }
                )
                continue
            each = evidence.get(bound.effect.name)
            effects.append(
                {
                    "name": bound.effect.name,
                    "site": bound.site,
                    "parameters": parameters,
                    "grade": Grade.STAND_IN if each is None else each.grade,
                    "probability": None if each is None else each.probability,
                    "share": None if each is None else each.share,
                }
            )
        return effects

    def save(self, path: str | Path) -> Path:
        """Write ``discovery.json``."""
        return save_discovery(self, path)


def save_discovery(discovery: Discovery, path: str | Path) -> Path:
    """Write a discovery as JSON. The keys are a contract: they stay, whatever the fields are called."""
    return write_file(path, format_json(to_json_data(_to_mapping(discovery))) + "\n")


def load_discovery(path: str | Path) -> dict[str, Any]:
    """What ``discovery.json`` holds, checked.

    Parameters
    ----------
    path
        The file that `Discovery.save` or ``greybox discover`` has written.

    Returns
    -------
    dict
        ``verdict``, ``effects`` with their parameters, ``evidence``, ``parameters`` of the best model and more, as
        ``docs/result_files.md`` lists them.

    Raises
    ------
    DataError
        If it cannot be read, or is not a discovery as the schema says, with the first offence.

    Examples
    --------
    >>> gb.discovery.load_discovery("results/discovery.json")["verdict"]  # doctest: +SKIP
    """
    return read_json(path, ResultKind.DISCOVERY)


def _to_mapping(d: Discovery) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "verdict": d.verdict,
        "effects": d.effects,
        "form": d.shape_corrections,
        "alternatives": d.alternatives,
        "plain_misfit": {"noise_ratio": d.localisation.misfit, "limit": d.localisation.threshold},
        "sites": _sites(d.localisation),
        "when": d.localisation.windows,
        "regions": _dependences(d.localisation),
        "stand_in": _surrogate(d.surrogate),
        "further": _refinement(d.refinement),
        "parameters": d.best.parameters,
        "plain_parameters": d.base.parameters,
        "gap": {output: _gap(error) for output, error in d.holdout.items()},
        "evidence": d.evidence,
        "claims": [claim_values(claim) for claim in d.claims],
        "effect_signals": [s.to_values() for s in d.effect_signals],
        "left": {output: _left(error) for output, error in d.left.items()},
        "ranking": d.ranking,
        "story": " ".join(map(str, d.conclusion)),
        "next_steps": list(map(str, d.next_steps)),
        "notes": list(map(str, d.findings)),
        "not_tried": {name: str(reason) for name, reason in d.not_tried.items()},
        "failures": d.failures,
        "checks": d.checks,
        "path": d.path,
        "findings": (*d.conclusion, *d.findings, *d.next_steps),
        "policy": d.policy,
        "options": d.options.to_data(),
        "seconds": d.seconds,
        "model": d.best.model.name,
        "equations": d.best.provenance.equations,
        "noise": d.best.noise.std,
        "noise_source": d.best.noise.source,
        "integration_error": d.best.discretisation.error,
        "search": d.best.solver.strategy,
        "versions": d.best.provenance.versions,
    }


def _gap(error: HoldoutError) -> dict[str, Any]:
    floor = error.floor if error.is_floor_known else None
    return {"before": error.before, "after": error.after, "floor": floor, "unit": error.unit, "share": error.share}


def _left(error: RemainingError) -> dict[str, Any]:
    dependence = None if error.dependence is None else str(error.dependence)
    return {
        "rmse": error.rmse,
        "unit": error.unit,
        "where": " or ".join(error.sites) or None,
        "as": "amplitude" if dependence is None and error.grows_with_amplitude else dependence,
        "noise_ratio": error.noise_ratio,
        "grows_with_amplitude": error.grows_with_amplitude,
    }


def _sites(location: ResidualLocalisation) -> list[dict[str, Any]]:
    """Ranked sites, each with the number of the set that the sensors cannot separate it from (0: the likeliest)."""
    sets = {label: k for k, group in enumerate(location.sets) for label in group}
    return [
        {"name": s.name, "kind": s.kind, "gain": s.gain, "set": sets[s.label], "size": s.size, "unit": s.unit}
        for s in location.sites
    ]


def _dependences(location: ResidualLocalisation) -> list[dict[str, Any]]:
    return [{**d.to_values(), "centres": d.centres, "mean": d.mean, "std": d.std} for d in location.dependences]


def _surrogate(surrogate: Surrogate | None) -> dict[str, Any] | None:
    if surrogate is None:
        return None
    arrays = {
        "gap": {output: _gap(error) for output, error in surrogate.holdout.items()},
        "values": surrogate.values,
        "curve": surrogate.curve,
    }
    return {**surrogate.to_values(), **arrays}


def _refinement(refinement: Refinement | None) -> dict[str, Any] | None:
    if refinement is None:
        return None
    fit = refinement.fit
    return {
        "steps": [
            {
                "name": s.name,
                "fitted": s.estimation_share,
                "held_out": s.validation_share,
                "alike": s.alike,
                "replaced": s.replaced,
                "dropped": s.dropped,
            }
            for s in refinement.steps
        ],
        "checks": refinement.checks,
        "effects": [e.name for e in fit.model.effects],
        "parameters": fit.parameters,
        "misfit": fit.misfit,
        "validation": fit.validation.misfit,
    }
