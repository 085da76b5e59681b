"""What a discovery gives back, as a value and as JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, NotRequired, TypedDict

from greybox.base import Check, FileKind, Finding, Finite, Interval, Printable, StoredResult, read_json
from greybox.base.frames import make_frame
from greybox.data.input_course import Holds
from greybox.discovery.claims import Claim, name_claim, order_of_name
from greybox.discovery.decision import Grade, Verdict
from greybox.discovery.disturbance_sites import SiteKind
from greybox.discovery.effect_signal import EffectSignal, RemainingError
from greybox.discovery.execution import SearchFailure
from greybox.discovery.false_names import FalseNameRate
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.holdout import HoldoutError, compare_holdout_errors, worst_output
from greybox.discovery.laws.terms import Law, claimed_name
from greybox.discovery.localisation import ResidualLocalisation
from greybox.discovery.policy import DiscoveryPolicy
from greybox.discovery.residual_noise import is_shape_correction
from greybox.discovery.search import SelectionStep
from greybox.discovery.surrogate import Surrogate, find_missing_sites
from greybox.estimation import Estimate, Fit, FitOptions
from greybox.estimation.reading_errors import OF_INSTRUMENTS
from greybox.model.parts import Occurrence, read_parts
from greybox.model.system import BoundEffect


@dataclass(frozen=True)
class RankedCandidate:
    """One set of effects that was fitted.

    Parameters
    ----------
    effects
        Those of its model.
    misfit
        Misfit over noise on the estimation records (`FittedCandidate.noise_ratio`).
    behind
        How far its criterion lies behind that of the best one there.
    constants
        How many constants the effects add.
    occurrence
        How often rigs with such parts have the rarest of the effects (`greybox.model.parts.Occurrence`).
    errors
        Rms error on the validation records by output, with the constants of the estimation records; empty for a set that nobody ran there.
    """

    effects: tuple[str, ...]
    misfit: float
    behind: float
    constants: int
    occurrence: Occurrence
    errors: Mapping[str, float]

    KEYS: ClassVar[str] = "effects misfit behind constants? occurrence? errors?"


# Entries of ``discovery.json`` that no class of the search has.


class PlainMisfit(TypedDict):
    """The misfit of the plain model on the estimation records, in all outputs together.

    Attributes
    ----------
    noise_ratio
        Misfit over the noise.
    limit
        Below it there may be noise alone.
    """

    noise_ratio: float
    limit: float


class SiteEntry(TypedDict):
    """One site where the plain model may fall short.

    Attributes
    ----------
    name, kind
        A balance, an input or an output, and which of them.
    gain
        How much likelier the residual is with a signal there, in nats.
    set
        Number of the set of sites that the sensors cannot separate; 0 is the likeliest.
    size, unit
        Rms of the signal, in the unit.
    """

    name: str
    kind: SiteKind
    gain: float
    set: int
    size: float
    unit: str


class FoundConstant(TypedDict):
    """One constant of a found effect.

    Attributes
    ----------
    value, unit
        The estimate and its unit.
    std, interval
        Standard deviation and 95 % interval; null where it is not determined.
    """

    value: Finite
    std: NotRequired[float | None]
    unit: str
    interval: NotRequired[Interval | None]


class FoundEffect(TypedDict):
    """One effect, or one law, of the best model.

    Attributes
    ----------
    name
        Of the catalogue, or of the law.
    site
        Where it acts.
    equation
        Of a law: the term with its constants as numbers, in the names of the model, as SymPy reads it.
    formula
        Of a law: the same with its constants by name.
    parameters
        Its constants.
    grade
        How certain it is, in a word.
    range
        Of a law: variable -> least and largest value in the records.
    memory
        Of a law with memory: the unit of what passes through its lag.
    probability
        That it is there and has the right name.
    share
        Of the error that it takes away.
    """

    name: str
    site: str
    equation: NotRequired[str]
    formula: NotRequired[str]
    parameters: dict[str, FoundConstant]
    grade: NotRequired[Grade]
    range: NotRequired[dict[str, list[float]]]
    memory: NotRequired[str]
    probability: NotRequired[float | None]
    share: NotRequired[float | None]


@dataclass(frozen=True)
class Discovery(Printable, StoredResult):
    """The result of a discovery: the missing effect, and what is claimed of it.

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
    claims
        What is said of the plain model, as a tree: where something is missing, of which variables, of which family, which effect; each
        with its probability, its grade and its best rival.
    false_names
        For each effect of which more than the place is probable, how often signals without meaning would have been established there.
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
    test
        By output, the error of the plain model and of the one to go on with on the test records, which took no part in the search.
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
    policy: DiscoveryPolicy = field(default_factory=DiscoveryPolicy)
    seconds: float = 0.0
    options: FitOptions = field(default_factory=FitOptions)
    not_tried: Mapping[str, Finding] = field(default_factory=dict)
    failures: tuple[SearchFailure, ...] = ()
    claims: tuple[Claim, ...] = ()
    false_names: tuple[FalseNameRate, ...] = ()
    left: Mapping[str, RemainingError] = field(default_factory=dict)
    laws: tuple[Law, ...] = ()
    test: Mapping[str, HoldoutError] = field(default_factory=dict)

    FILE: ClassVar[FileKind] = FileKind("a discovery", "discovery.json that greybox discover has written")
    KEYS: ClassVar[str] = """
        verdict effects! form=shape_corrections alternatives plain_misfit sites=ranked_sites when=localisation.windows
        regions=localisation.dependences stand_in=surrogate parameters=best.parameters plain_parameters
        gap=holdout test claims false_names effect_signals left ranking story next_steps=str(next_steps) notes=str(findings)
        not_tried=str(not_tried) failures checks path findings=all_findings policy options=stored_options seconds
        model=best.model.name equations=best.provenance.equations plain_equations?=base.provenance.equations
        declared?=base.provenance.declared hold? conditions? noise=best.noise.std noise_source=best.noise.source
        integration_error=best.discretisation.error search=best.solver.strategy versions=best.provenance.versions
        """

    @property
    def hold(self) -> Holds:
        """How the inputs of the fitted records move between rows."""
        return self.best.traces[0].hold

    @property
    def conditions(self) -> tuple[str, ...]:
        """What stayed the same during each record, by name."""
        return tuple(self.best.traces[0].conditions)

    @property
    def sites(self) -> tuple[str, ...]:
        """Where the plain model falls short: the likeliest site with those that the sensors cannot tell from it."""
        return find_missing_sites(self.localisation, self.surrogate)

    @property
    def extended(self) -> Fit:
        """The fit to go on with: the best model; with a surrogate instead where no effect is certain and that does better."""
        surrogate = self.surrogate
        if surrogate is None:
            return self.best
        output = worst_output(self.holdout)
        is_better = surrogate.holdout[output].after < self.holdout[output].after
        return surrogate.fit if is_better else self.best

    @property
    def shape_corrections(self) -> tuple[str, ...]:
        """Second branches, or a curve, in the best model: the shape of an effect is not quite the catalogue's."""
        return tuple(e.name for e in self.best.model.effects if is_shape_correction(e.name))

    @property
    def story(self) -> str:
        """The answer in sentences."""
        return " ".join(map(str, self.conclusion))

    @property
    def all_findings(self) -> tuple[Finding, ...]:
        """The answer, what to know before believing it, and what to do next."""
        return (*self.conclusion, *self.findings, *self.instruments, *self.next_steps)

    @property
    def instruments(self) -> tuple[Finding, ...]:
        """What the fit of the best model says of sensors, clocks, loops and weighed constants: it may be what an effect is the name of."""
        return tuple(f for f in self.best.findings if f.code in OF_INSTRUMENTS)

    @property
    def plain_misfit(self) -> PlainMisfit:
        """The misfit of the plain model on the estimation records, and the limit below which there may be noise alone."""
        return {"noise_ratio": self.localisation.misfit, "limit": self.localisation.threshold}

    @property
    def plain_parameters(self) -> Mapping[str, Estimate]:
        """The constants of the plain model."""
        return self.base.parameters

    @property
    def ranked_sites(self) -> list[SiteEntry]:
        """Where the plain model may fall short, likeliest first."""
        sets = {label: k for k, group in enumerate(self.localisation.sets) for label in group}
        return [
            {"name": s.name, "kind": s.kind, "gain": s.gain, "set": sets[s.label], "size": s.size, "unit": s.unit}
            for s in self.localisation.sites
        ]

    @property
    def stored_options(self) -> Mapping[str, Any]:
        """Options of the estimation, by name."""
        return self.options.to_data()

    @property
    def effects(self) -> list[FoundEffect]:
        """Name, site, parameters, grade, probability and share of each effect in the best model; none if the plain model is complete.

        What is established comes first, then what takes most of the error, then what such rigs usually have.
        A law has its ``equation``, its ``formula`` and the ``range`` in which it was seen as well.
        """
        laws = {law.name: law for law in self.laws}
        given = {effect.name for effect in self.base.model.effects}  # the user's own are not found by the search
        parts = read_parts(self.base.model)
        effects: list[FoundEffect] = []
        added = [
            b
            for b in self.best.model.bound_effects
            if not is_shape_correction(b.effect.name) and b.effect.name not in given
        ]

        def order(bound: BoundEffect) -> tuple[int, float, float]:
            return order_of_name(self.claims, claimed_name(bound.effect), parts.occurrence(bound.effect))

        for bound in sorted(added, key=order):
            parameters: dict[str, FoundConstant] = {}
            for name, in_model in bound.model_names.items():
                estimate = self.best.parameters.get(in_model)
                if estimate is not None:
                    parameters[name] = {
                        "value": estimate.value,
                        "std": estimate.std,
                        "unit": estimate.unit,
                        "interval": estimate.interval,
                    }
            claim = name_claim(self.claims, claimed_name(bound.effect))
            entry: FoundEffect = {
                "name": bound.effect.name,
                "site": bound.site,
                "parameters": parameters,
                "grade": Grade.STAND_IN if claim is None else claim.grade,
                "probability": None if claim is None else claim.probability,
                "share": None if claim is None else claim.share,
            }
            law = laws.get(bound.effect.name)
            if law is not None:
                entry |= {
                    "equation": law.equation,
                    "formula": law.formula,
                    "range": {v: list(ends) for v, ends in law.seen.items()},
                }
                if law.memory:
                    entry["memory"] = law.memory
            effects.append(entry)
        return effects

    def to_frame(self) -> Any:
        """A pandas data frame with a row for each set of effects that was fitted, best first.

        Columns are the constants that it adds, its misfit over noise on the estimation records, how far its criterion lies behind, whether
        it is the answer, and ``error in OUTPUT`` on the validation records (NaN for a set that nobody ran there).
        Raises ModuleNotFoundError without pandas (``pip install 'greybox-sysid[frames]'``).
        """
        chosen = {effect["name"] for effect in self.effects}
        columns: dict[str, list[Any]] = {
            "constants": [r.constants for r in self.ranking],
            "misfit": [r.misfit for r in self.ranking],
            "behind": [r.behind for r in self.ranking],
            "answer": [set(r.effects) == chosen for r in self.ranking],
        }
        errors = {f"error in {name}": [r.errors.get(name, math.nan) for r in self.ranking] for name in self.holdout}
        return make_frame("effects", [" + ".join(r.effects) or "none" for r in self.ranking], columns | errors)


def quote_test_error(result: Discovery, plain: Fit, answer: Fit) -> Discovery:
    """A discovery with the error on records that took no part: of the plain model and the answer, each validated there."""
    errors = compare_holdout_errors(plain, answer)
    findings = tuple(
        Finding(
            DiscoveryCode.TEST_ERROR,
            subject=output,
            values={"before": e.before, "after": e.after, "unit": e.unit, "is_plain": answer is plain},
        )
        for output, e in errors.items()
    )
    return replace(result, test=errors, findings=(*findings, *result.findings))


def load_discovery(path: str | Path) -> dict[str, Any]:
    """What ``discovery.json`` holds, checked.

    Parameters
    ----------
    path
        The file that `Discovery.save` or ``greybox discover`` has written.

    Returns
    -------
    dict
        ``verdict``, ``effects`` with their parameters, ``claims``, ``parameters`` of the best model and more, as
        ``docs/result_files.md`` lists them.

    Raises
    ------
    DataError
        If it cannot be read, or is not a discovery as the schema says, with the first offence.

    Examples
    --------
    >>> gb.discovery.load_discovery("results/discovery.json")["verdict"]  # doctest: +SKIP
    """
    return read_json(path, Discovery)
