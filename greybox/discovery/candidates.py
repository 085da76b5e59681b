"""Which effects are tried, and why the others are not."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from greybox.base import DataError, Finding, ModelError, nearest
from greybox.discovery.execution import FailureLog, SearchStage, reason_of
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.problem import FittedCandidate, StartValues
from greybox.estimation.identifiability.structural import find_certainly_open_directions
from greybox.estimation.reading_errors import GAINS
from greybox.model import Effect, Model
from greybox.model.effects import Scales, all_effects, applicable_effects, measure_scales, tailor_to_record
from greybox.model.effects.catalogue import AT
from greybox.model.effects.scales import list_effect_values, within_bounds
from greybox.model.parts import RigParts, read_parts


@dataclass(frozen=True)
class CandidateList:
    """The effects to try, in catalogue order, and for each effect that is not tried the reason."""

    effects: tuple[Effect, ...]
    not_tried: dict[str, Finding] = field(default_factory=dict)


def list_candidates(
    model: Model,
    scales: Scales,
    failures: FailureLog,
    effects: Sequence[Effect] | None = None,
    without: Collection[str] = (),
    beside: Sequence[Effect] = (),
    *,
    is_uniform: bool = True,
) -> CandidateList:
    """The effects that ``model`` may lack, made ready for a record.

    Parameters
    ----------
    model, scales
        The plain model, and the peaks and times of the records.
    failures
        Takes effects that cannot be made ready.
    effects
        The only candidates, instead of the catalogue.
    without
        Names of effects to leave out, at all their sites.
    beside
        Effects of one's own that are tried as well; one of the same name comes in the place of the catalogue's.
    is_uniform
        Whether every record is sampled uniformly: what says how an input moves within its band needs that.

    Raises
    ------
    ModelError
        For a name in ``without`` that neither ``effects`` nor the catalogue has, and where none of ``effects`` has a place.
    """
    renewed = {e.name for e in beside}
    entries = (*(e for e in effects or applicable_effects(model) if e.name not in renewed), *beside)
    _check_names(without, [e.name for e in (*entries, *all_effects())])
    left_out = [e.name for e in entries if {e.name, e.name.partition(AT)[0]} & set(without)]
    not_tried = {name: Finding(DiscoveryCode.EFFECT_LEFT_OUT, subject=name) for name in left_out}
    # Who names effects expects them: beside a list only what somebody said of the rig rules them out.
    parts = RigParts() if effects else read_parts(model).told if model.candidates else read_parts(model)
    for entry in entries:
        if lacking := parts.missing(entry):
            values = {"part": lacking, "reason": parts.lacks[lacking]}
            not_tried.setdefault(entry.name, Finding(DiscoveryCode.PART_MISSING, subject=entry.name, values=values))
        if entry.hold == "band-limited" and not is_uniform:
            not_tried.setdefault(entry.name, Finding(DiscoveryCode.NEEDS_UNIFORM_SAMPLING, subject=entry.name))
    candidates: list[Effect] = []
    for entry in entries:
        if entry.name in not_tried:
            continue
        obstacle = _find_obstacle(model, entry) or _find_imitation(model, entry, candidates)
        if obstacle is not None:
            not_tried[entry.name] = obstacle
            continue
        tailor = partial(tailor_to_record, entry, scales)
        tailored = failures.attempt(SearchStage.PREPARATION, (entry.name,), tailor, None)
        if tailored is not None:
            candidates.append(tailored)
    if effects and not candidates:
        reasons = "; ".join(dict.fromkeys(str(f.values.get("reason", f)) for f in not_tried.values()))
        raise ModelError(f"none of the effects to try finds a place in model {model.title!r}: {reasons}")
    if not effects:
        for entry in all_effects():
            if not {entry.name} & {e.name.partition(AT)[0] for e in entries}:
                not_tried[entry.name] = _find_obstacle(model, entry) or _explain_absence(model, entry)
    return CandidateList(tuple(candidates), not_tried)


def family_of(name: str, entries: Sequence[Effect] | None = None) -> tuple[str, ...]:
    """An effect with all that contain it as a special case or are contained in it, directly or by others.

    Parameters
    ----------
    name
        Name of an effect.
    entries
        The effects among which its family is looked for; those of the catalogue where none are given.

    Returns
    -------
    tuple of str
        The names, in the order of ``entries``.

    Examples
    --------
    >>> "lugre_friction" in family_of("coulomb_friction")
    True
    """
    entries = all_effects() if entries is None else entries
    family = {name}
    while True:
        children = {e.name for e in entries if family & {*e.parents, *e.approaches}}
        parents = {simpler for e in entries if e.name in family for simpler in (*e.parents, *e.approaches)}
        larger = family | children | parents
        if larger == family:
            return tuple(e.name for e in entries if e.name in family)
        family = larger


def failed_candidates(
    candidates: Sequence[Effect], failures: FailureLog, fitted: Collection[str]
) -> dict[str, Finding]:
    """The candidates that could not be fitted alone, each with the reason; ``fitted`` are those that could."""
    reasons = failures.of_single_effects()
    return {e.name: _failure(e.name, reasons[e.name]) for e in candidates if e.name in reasons and e.name not in fitted}


def _failure(name: str, reason: str) -> Finding:
    if not reason:
        return Finding(DiscoveryCode.CANDIDATE_NOT_SIMULATED, subject=name)
    return Finding(DiscoveryCode.CANDIDATE_FAILED, subject=name, values={"reason": reason})


def _check_names(names: Collection[str], known: Sequence[str]) -> None:
    for name in names:
        if name not in known:
            raise ModelError(f"without {name!r}: no such effect among the candidates; {nearest(name, known)}")


def _find_obstacle(model: Model, entry: Effect) -> Finding | None:
    """Why the model does not take an effect; None where it does."""
    if entry.name in {e.name for e in model.effects}:
        return Finding(DiscoveryCode.EFFECT_PRESENT, subject=entry.name)
    try:
        model + entry  # states what the model lacks
    except ModelError as error:
        return Finding(DiscoveryCode.NO_PLACE, subject=entry.name, values={"reason": reason_of(error)})
    return None


# The effect that scales time, on a linear plant as free constants and a gain do; the one that moves a reading, as other constants of the
# catalogue do where nothing in the plant bends; and linear terms that a plain model may have under another name.
SKEW, OFFSET = "clock_skew", "sensor_offset"
# By effect, those that are tried and together with free constants may do the same.
ALIKE = {
    SKEW: tuple(GAINS),
    OFFSET: ("constant_load", "input_offset", "gravity_torque"),
    "heat_gain": ("input_offset",),
    **dict.fromkeys(("viscous_damping", "heat_loss"), ()),
}
# Value at which what a scaling effect does is compared with what constants do: far from absent, where its slope by logarithm would vanish.
SCALED_BY = 0.3


def _find_imitation(model: Model, entry: Effect, tried: Sequence[Effect]) -> Finding | None:
    """What does the same as an effect that scales or moves a signal or time, on any record: then it is no candidate. None if nothing does.

    A constant that was weighed or measured by itself counts as known, as a fixed one does.
    """
    base = entry.name.partition(AT)[0]
    if base not in (*GAINS, *ALIKE) or not model.has_equations:
        return None
    known = model.fix(*(q.name for q in model.free_parameters if q.prior))
    # It is told from free constants and the effects that are tried together, or it is one more name for these.
    alike = [e for e in tried if e.name.partition(AT)[0] in ALIKE.get(base, ())]
    scaled, effect_of = known, {}
    for effect in (*alike, entry):
        scaled = scaled + effect
        for scale in (scaled.names_of(effect.name)[name] for name in effect.amplitudes):
            scaled, effect_of[scale] = scaled.start(**{scale: SCALED_BY}), effect.name
    try:
        directions = find_certainly_open_directions(scaled)
    except (ModelError, DataError):
        # A model that cannot be run at random constants: nothing is known against the effect.
        return None
    # The amplitude of ``entry`` was the last. What moves a reading may be nothing but another start.
    taking = [d.names for d in directions if scale in d.names and (len(d.names) > 1 or base == OFFSET)]
    if not taking:
        return None
    others = [name for name in min(taking, key=len) if name != scale]
    if effects := list(dict.fromkeys(effect_of[name] for name in others if name in effect_of)):
        return Finding(DiscoveryCode.TRIED_AS_OTHERS, subject=entry.name, values={"others": effects})
    return Finding(
        DiscoveryCode.TAKEN_BY_CONSTANTS, subject=entry.name, values={"constants": others or ["the initial state"]}
    )


def _explain_absence(model: Model, entry: Effect) -> Finding:
    """Why an effect that has a place is no candidate: the model's own list leaves it out, or others together are the same."""
    if model.candidates:
        return Finding(DiscoveryCode.NOT_A_CANDIDATE, subject=entry.name)
    return Finding(DiscoveryCode.TRIED_AS_OTHERS, subject=entry.name, values={"others": list(entry.stands_for)})


# Where the refit of a candidate starts.
#
# The plain model has swallowed the missing effect into its own parameters (dry friction has become damping), so a candidate
# starts from the fitted values and from the ones that the user gave; at a small amplitude and at a large one; at every shape
# of its grid; and a child effect from its fitted parent as well.


def estimate_scales(candidate: FittedCandidate) -> Scales:
    """Peaks and times of a fitted model on its first record."""
    _, states = candidate.problem.shooting(candidate.variables).simulate(candidate.variables.here)[0]
    record = candidate.problem.records[0]
    return measure_scales(candidate.model, states, record.u, float(np.median(record.h)))


def generate_starting_points(
    model: Model, effect: Effect, parent: FittedCandidate, plain: Model, scales: Scales, amplitudes: Sequence[float]
) -> Iterator[StartValues]:
    """Start values for ``model``, which is ``parent.model + effect``.

    Parameters
    ----------
    model, effect, parent
        The model with the effect, and the fit of the model without it.
    plain
        The model whose start values are a second origin.
    scales
        Peaks and times of the records.
    amplitudes
        Amplitudes of the effect, in multiples of its probe.
    """
    nominal = {**parent.model.values, **plain.values}
    origins = [parent.model.values] + ([nominal] if nominal != parent.model.values else [])
    for effect_values in list_effect_values(model, effect, scales, amplitudes):
        for origin in origins:
            yield {**origin, **effect_values}


def generate_child_starting_points(
    model: Model, child: Effect, parent: FittedCandidate, parent_effect: Effect, scales: Scales
) -> Iterator[StartValues]:
    """Start values for ``model``, in which ``child`` replaces its fitted parent effect."""
    if child.from_parent is None:
        return
    parent_names = parent.model.names_of(parent_effect.name)
    child_names = model.names_of(child.name)
    fitted = {
        name: parent.model.values[in_model]
        for name, in_model in parent_names.items()
        if in_model in parent.model.values
    }
    kept = {
        name: value
        for name, value in parent.model.values.items()
        if name in model.values and name not in parent_names.values()
    }
    for start in child.from_parent(fitted, scales):
        values = {child_names[name]: within_bounds(model, child_names[name], value) for name, value in start.items()}
        yield {**kept, **values}
