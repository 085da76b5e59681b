"""The sentences of a discovery."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from greybox.base import Check, Finding, format_unit
from greybox.base.json_shape import to_values
from greybox.discovery.claims import Depth, split_names
from greybox.discovery.curve_shape import TIME, Parity, ShapeKind
from greybox.discovery.decision import Grade
from greybox.discovery.disturbance_sites import SiteKind
from greybox.discovery.execution import SearchStage
from greybox.discovery.findings import DiscoveryCode, DiscoveryRule
from greybox.discovery.laws.terms import LikenessKind
from greybox.discovery.plausibility import MOST_ODDS
from greybox.model.parts import TOLD, part
from greybox.show.sentences import register, renders, sentence, wording, writes
from greybox.show.sentences.estimation import status_text

if TYPE_CHECKING:
    from greybox.discovery import Dependence, EffectTest, HoldoutError, Surrogate
    from greybox.discovery.false_names import FalseNameRate
    from greybox.discovery.localisation import MisfitTiming, ResidualLocalisation


# Shapes and dependences


def shape_text(values: Mapping[str, Any]) -> str:
    """A shape in words, from the values of a dependence or of a surrogate."""
    kind, parity, position = values["shape"], values["parity"], values["position"]
    unit = values.get("variable_unit", values["unit"])
    if kind == ShapeKind.PERIODIC:
        text = f"periodic, every {wording.value_with_unit(values['period'], unit)}"
        amplitude = values.get("amplitude")
        return (
            text
            if amplitude is None
            else f"{text}, with an amplitude of {wording.value_with_unit(amplitude, values['unit'])}"
        )
    if kind == ShapeKind.BEND:
        return f"a bend at {wording.value_with_unit(position, unit)}"
    if kind == ShapeKind.CURVED:
        return "curving downwards" if values["downwards"] else "curving upwards"
    if kind == ShapeKind.UNNAMED:
        return f"{parity} in shape" if parity != Parity.NEITHER else "of no simple shape"
    text = {
        ShapeKind.TOO_FEW_VALUES: "too few values to tell its shape",
        ShapeKind.STRAIGHT: "no shape beyond a straight line",
        ShapeKind.STEP: "odd, a step at zero",
        ShapeKind.FLAT_MIDDLE: "odd, with a flat middle",
        ShapeKind.CUBIC: "odd, growing faster than proportionally",
        ShapeKind.ODD_SQUARE: "odd, growing with the square",
        ShapeKind.SQUARE: "even, growing with the square",
        ShapeKind.KINK: "even, with a kink at zero",
        ShapeKind.TONE: "a tone",
    }[kind]
    if kind == ShapeKind.FLAT_MIDDLE:
        text += f" up to about {wording.value_with_unit(position, unit)}"
    return f"{text}, downwards" if values["downwards"] else text


def dependence_text(values: Mapping[str, Any]) -> str:
    """The dependence of a signal on a variable, from the values of a dependence."""
    share = f"explains {100 * values['share']:.0f} %"
    if values["tone"] is not None:
        return f"a tone of {values['tone']:.4g} Hz that does not depend on the motion ({share})"
    added = f"{100 * values['loop']:.0f} %"
    if values["has_loop"] and round(100 * values["share"]) == 0:
        return f"a loop over {values['variable']}: another value on its way up than on its way down (explains {added})"
    loop = f", with a loop (direction adds {added})" if values["has_loop"] else ""
    return f"a function of {values['variable']} ({share}): {shape_text(values)}{loop}"


@renders("Dependence")
def _dependence(dependence: Dependence) -> str:
    return dependence_text(to_values(dependence))


# Stretches of time that a sentence lists.
LISTED_STRETCHES = 4


def timing_text(timing: MisfitTiming | None) -> str:
    """When most of the misfit happens."""
    if timing is None:
        return "nowhere above the noise"
    if not timing.stretches:
        return "throughout the records"
    shown = ", ".join(
        f"{start:.4g} to {end:.4g} s of {name}" for name, start, end in timing.stretches[:LISTED_STRETCHES]
    )
    rest = len(timing.stretches) - LISTED_STRETCHES
    more = f" and {rest} more stretches" if rest > 0 else ""
    return f"{100 * timing.share:.0f} % of it in {100 * timing.time_share:.0f} % of the time: {shown}{more}"


def site_text(label: str) -> str:
    """``the force balance``, ``the input u`` or ``the sensor of x``, from the label of a site."""
    kind, _, name = label.partition(" ")
    return f"the {name} balance" if kind == SiteKind.BALANCE else f"the {label}"


def sites_text(labels: Sequence[str], *, explained: bool = False) -> str:
    """The likeliest sites; ``explained`` where they are told first, with why there are several."""
    why = " (these sensors cannot distinguish them)" if explained and len(labels) > 1 else ""
    return " or ".join(map(site_text, labels)) + why if labels else "no particular site"


def ratio_text(ratio: float, bounded: bool, digits: int = 3) -> str:
    """``2.91 times the noise``, or at least so many times, where the noise is only known to be no larger."""
    return f"{'at least ' * bounded}{ratio:.{digits}g} times the noise"


@renders("ResidualLocalisation")
def _localisation(location: ResidualLocalisation) -> str:
    limit = "" if location.is_noise_bounded else f"; noise alone stays below {location.threshold:.4g}"
    lines = [f"misfit {ratio_text(location.misfit, location.is_noise_bounded, 4)}{limit}"]
    if not location.is_missing:
        return "\n".join([*lines, "no effect is missing"])
    lines.append(f"when:  {timing_text(location.timing)}")
    if location.likeliest:
        site = location.sites[0]
        size = f", {wording.value_with_unit(site.size, site.unit)} rms" if site.unit else ""
        lines.append(f"where: {sites_text(location.likeliest, explained=True)}{size}")
    relevant = [str(d) for d in location.dependences if d.is_relevant][:3]
    lines.append(f"as:    {'; '.join(relevant) if relevant else 'no function of any one variable'}")
    return "\n".join(lines)


# Surrogates


def tone_title(frequency: float) -> str:
    """``a tone of 50.00 Hz``."""
    return f"a tone of {f'{frequency:#.4g}'.rstrip('.')} Hz"


def surrogate_title(surrogate: Surrogate) -> str:
    """``a curve over x``, ``a sinusoid over x`` or ``a tone of 50.00 Hz``."""
    return _surrogate_title(to_values(surrogate))


def _surrogate_title(values: Mapping[str, Any]) -> str:
    if values["tone"] is not None:
        return tone_title(values["tone"]["frequency"])
    return f"a {'curve' if values['period'] is None else 'sinusoid'} over {values['variable']}"


def explained_share_text(share: float) -> str:
    """``takes away 98.8 % of the error``; a model with a larger error than the plain one takes nothing."""
    return f"takes away {wording.percent_text(share)} of the error" if share > 0 else "takes away none of the error"


@renders("Surrogate")
def _surrogate(surrogate: Surrogate) -> str:
    return surrogate_text(to_values(surrogate))


def surrogate_text(values: Mapping[str, Any]) -> str:
    """What a surrogate is, where it acts and what it explains, from its values."""
    title, tone = _surrogate_title(values), values["tone"]
    explained = f"{explained_share_text(values['closed'])} on the validation records"
    if tone is None:
        smooth = "a smooth curve" if values["levels"] is None else f"a curve of {values['levels']} levels"
        title = title.replace("a curve", smooth)
        beside = f", together with {' + '.join(values['beside'])}," if values["beside"] else ""
        return f"{title} ({shape_text(values)}) at {site_text(values['site'])}{beside} {explained}"
    sizes = sorted(tone["amplitude"].values())
    size = f"{sizes[0]:.3g}" if sizes[-1] <= 1.05 * sizes[0] else f"{sizes[0]:.3g} to {sizes[-1]:.3g}"
    others = " or ".join(map(site_text, tone["alike"]))
    alike = f" (or {others}: these records cannot distinguish them)" if others else ""
    amplitude = f"{size} {values['unit']}".rstrip()
    return (
        f"{title} at {site_text(values['site'])}{alike}, with an amplitude of {amplitude}, {explained} (amplitude and phase there are"
        f" estimated from the first {tone['beginning']:.2g} s)"
    )


# Holdout errors and effects by hand


@renders("HoldoutError")
def _holdout_error(error: HoldoutError) -> str:
    noise = f" (noise {error.floor:.4g})" if error.is_floor_known else ""
    return wording.with_unit(f"{error.before:.4g} -> {error.after:.4g}", error.unit) + noise


@renders("EffectTest")
def _effect_test(test: EffectTest) -> str:
    decision = "keep it: the records require it" if test.is_needed else "omit it: the records do not require it"
    lines = [f"{test.name}: {decision}"]
    lines += [f"  {sentence(check)}" for check in test.checks]
    lines.append(f"  explains {wording.percent_text(test.explained_fraction)} of the misfit above the noise")
    names = test.larger.model.names_of(test.name)
    for name, in_model in names.items():
        estimate = test.larger.parameters.get(in_model)
        if estimate is not None:
            values = {"value": estimate.value, "std": estimate.std, "unit": estimate.unit}
            lines.append(f"  {constant_text(name, values)}")
    lines += [f"  {output}: rms error on the validation records {error}" for output, error in test.holdout.items()]
    return "\n".join(lines)


# Evidence for each effect, and what is left

EFFECT_TITLES = {
    "band_limited_input": "band-limited input",
    "bouc_wen_hysteresis": "Bouc-Wen hysteresis",
    "fitted_curve": "a fitted curve",
    "plain_model": "the plain model",
}


def effect_title(name: str) -> str:
    """The name of an effect as words: ``cubic stiffness``."""
    return EFFECT_TITLES.get(name, name.replace("_", " "))


def part_text(name: str) -> str:
    """The name of a part as words: ``voice coil``."""
    return name.replace("_", " ")


def _how_known(reason: str) -> str:
    return "" if reason == TOLD else f" ({reason})"


def impossible_text(not_tried: Mapping[str, Finding]) -> str:
    """Which effects were not tried because the rig has no part that they need, and how that is known; "" where there are none."""
    lacking = [f for f in not_tried.values() if f.code is DiscoveryCode.PART_MISSING]
    reasons: dict[str, list[Finding]] = {}
    for f in lacking:
        reasons.setdefault(f.values["reason"], []).append(f)
    groups = [
        f"{wording.join_names([effect_title(f.subject) for f in group])} for lack of"
        f" {wording.join_names(list(dict.fromkeys(part_text(f.values['part']) for f in group)))}{_how_known(reason)}"
        for reason, group in reasons.items()
    ]
    is_guessed = any(reason != TOLD for reason in reasons)
    return f"not tried: {'; '.join(groups)}{': --has PART tries them' if is_guessed else ''}" if groups else ""


GRADES = {Grade.ESTABLISHED: "established", Grade.PROBABLE: "probable", Grade.STAND_IN: "a stand-in"}


def false_names_text(rate: FalseNameRate) -> str:
    """How often signals without meaning would have been established in the place of an effect, and what follows."""
    won = f"{rate.established or 'none'} of {wording.count_noun(rate.tried, 'draw')}"
    text = (
        f"In the place of {effect_title(rate.effect)} the best of {wording.count_noun(rate.among, 'signal')} without meaning, made from"
        f" these records, would have been established in {won} (at most {100 * rate.upper:.0f} %, with 95 % confidence)."
    )
    if rate.is_common:
        text += " That is more often than an established claim may be wrong: beyond the place nothing here is more than probable."
    return text


def probability_text(probability: float) -> str:
    """``98 %``; nothing is quite certain, and nothing impossible."""
    most = wording.MOST_PERCENT
    return f"{min(max(100 * probability, 100 - most), most):.0f} %"


def claim_text(values: Mapping[str, Any]) -> str:
    """What a claim says, in half a sentence, from its values."""
    if values["depth"] == Depth.MISSING:
        return f"something is missing in {values['output']}"
    place = sites_text(values["site"].split(" or ") if values["site"] else [])
    if values["depth"] == Depth.PLACE:
        return f"something acts at {place}"
    kind = {"static": "a static function", "with memory": "a function with memory", "timing": "a lag or a delay"}.get(
        values["form"], "a function"
    )
    # A static function of nothing that moves is a constant.
    what = "a constant" if values["form"] == "static" and not values["variables"] else kind
    if values["variables"]:
        what += f" of {wording.join_names(['time' if v == TIME else v for v in values['variables']])}"
    if values["depth"] == Depth.VARIABLES:
        return f"{what} acts at {place}"
    if values["depth"] == Depth.FAMILY and values["form"] == "timing":
        return f"{what} acts at {place}"
    if values["depth"] == Depth.FAMILY:
        family = [effect_title(name) for name in values["family"]]
        named = f"{family[0]} or a relative ({', '.join(family[1:])})" if len(family) > 1 else family[0]
        return f"{named}, {what}, acts at {place}"
    return f"{effect_title(values['name'])} acts at {place}"


def rival_text(rival: str) -> str:
    """The sets of effects that win where a claim does not hold."""
    if not rival:
        return ""
    return wording.join_names([effect_title(name) for name in split_names(rival)])


@writes(DiscoveryCode.USUAL_FIRST)
def _usual_first(finding: Finding) -> str:
    v = finding.values
    by_records = " or ".join(map(rival_text, v["by_records"]))
    text = f"By the records alone {by_records}; by what such rigs usually have, {rival_text(finding.subject)}"
    if v["odds"] > 1.5:
        text += f" ({v['odds']:.0f} to 1{' or more' if v['odds'] >= MOST_ODDS else ''})"
    shares = [f"{100 * v[key]:.0f} %" for key in ("share", "best_share")]
    # Those of the resamples, in which every record judges now and then: the table of sets has the errors on the validation records.
    return f"{text}: over all records it takes {shares[0]} of the error, the best of all ({rival_text(v['best'])}) {shares[1]}."


@writes(DiscoveryCode.ASK_PART)
def _ask_part(finding: Finding) -> str:
    yes, no = (rival_text(finding.values[key]) for key in ("yes", "no"))
    question, flag = wording.capitalise(part(finding.subject).question), finding.subject
    return f"{question} If so, it is {yes} (--has {flag}); if not, {no} (--lacks {flag})"


@writes(DiscoveryCode.CLAIM_ESTABLISHED)
def _claim_established(finding: Finding) -> str:
    v = finding.values
    text = claim_text(v)
    share = f": {100 * v['share']:.0f} % of the error in {v['output']}" if v["share"] > 0 else ""
    return f"{text[0].upper()}{text[1:]}{share} ({probability_text(v['probability'])} certain). The name is open."


def _remaining_text(output: str, values: Mapping[str, Any]) -> str:
    text = (
        f"{wording.quantity_text(values['rmse'], values['unit'], beside=values.get('before', 0.0))} is left in {output}"
    )
    if values["noise_ratio"] is not None:
        text += f", {values['noise_ratio']:.2g} times the sensor noise"
    parts = ["it grows with the amplitude"] if values["grows_with_amplitude"] else []
    if values["dependence"] is not None:
        place = f" at {sites_text(values['sites'])}" if values["sites"] else ""
        parts.append(
            f"on the estimation records it looks like a missing signal{place} that is {dependence_text(values['dependence'])}"
        )
    elif values["sites"]:
        parts.append(f"on the estimation records it looks like a missing signal at {sites_text(values['sites'])}")
    return f"{text}: {'; '.join(parts)}" if parts else text


@writes(DiscoveryCode.ERROR_REDUCED)
def _error_reduced(finding: Finding) -> str:
    v = finding.values
    effects = wording.join_names([effect_title(name) for name in v["effects"]])
    if not v["share"] > 0:
        return f"The error in {finding.subject} on the validation records does not fall with {effects}."
    # Result files write what is infinite as null.
    if v["before"] is None or math.isinf(v["before"]):
        left = wording.quantity_text(v["after"], v["unit"])
        return f"On the validation records the run of the plain model goes astray; with {effects} the error in {finding.subject} is {left}."
    return (
        f"The error in {finding.subject} on the validation records falls from {wording.change_text(v['before'], v['after'], v['unit'])}"
        f" ({wording.percent_text(v['share'], 2)} less) with {effects}."
    )


# Records that show more than noise.
_REST = {"fitted": "the fitted", "judging": "the validation", "test": "the test"}


@writes(DiscoveryCode.EFFECTS_ESTABLISHED)
def _effects_established(finding: Finding) -> str:
    v = finding.values
    names = [effect_title(name) for name in v["established"]]
    text = f"{wording.join_names(names)} {'are' if len(names) > 1 else 'is'} established"
    text = text[0].upper() + text[1:]
    for grade, words in ((Grade.PROBABLE, "probable"), (Grade.STAND_IN, "only a stand-in for something else")):
        others = [effect_title(name) for name, given in v["others"].items() if given == grade]
        if others:
            text += f"; {wording.join_names(others)} {'are' if len(others) > 1 else 'is'} {words}"
    left = v.get("left", ())
    records = [_REST[place] for place in left if place in _REST]
    reasons = [f"{wording.join_names(records)} records show more than noise"] if records else []
    if "correlated" in left:
        reasons.append("what is left goes on from reading to reading, which the noise does not")
    more = f"More is missing: {'; '.join(reasons)}" if reasons else "Whether more is missing is not certain"
    return f"{text}. {more}."


@writes(DiscoveryCode.EFFECTS_PROBABLE)
def _effects_probable(finding: Finding) -> str:
    v = finding.values
    names = [
        f"{effect_title(name)} ({min(100 * p, wording.MOST_PERCENT):.0f} %)" for name, p in v["probabilities"].items()
    ]
    text = f"No effect is established. {'Probable are' if len(names) > 1 else 'The most probable is'} {wording.join_names(names)}"
    others = [effect_title(name) for name in v["others"]]
    if others:
        text += (
            f"; {wording.join_names(others)} {'are' if len(others) > 1 else 'is'} only a stand-in for something else"
        )
    return f"{text}."


def constant_text(name: str, values: Mapping[str, Any]) -> str:
    """``Fc = 0.05 +- 0.001 N``; a pure number has no unit."""
    std = "" if values["std"] is None else f" +- {values['std']:.2g}"
    return wording.with_unit(f"{name} = {values['value']:.5g}{std}", values["unit"])


# Findings


@writes(DiscoveryCode.EFFECTS_TIED)
def _effects_tied(finding: Finding) -> str:
    equals = "; ".join((finding.subject, *finding.values["rivals"]))
    simplest = f"; {finding.subject} is the simplest" if finding.values["is_simplest"] else ""
    return f"The plain model lacks one of these effects: {equals}. The records cannot distinguish them{simplest}."


def _laws_text(laws: Sequence[Mapping[str, str]]) -> str:
    """``-0.6*a*b (1/s) in the prey balance``; several with ``and``."""
    return wording.join_names(
        [
            f"{law['equation']}{f' ({unit})' if (unit := law['unit']) not in ('', '-', '1') else ''} in the {law['site']} balance"
            for law in laws
        ]
    )


@writes(DiscoveryCode.LAW_ESTABLISHED)
def _law_established(finding: Finding) -> str:
    several = len(finding.values["laws"]) > 1
    return (
        f"The plain model lacks {'the terms' if several else 'the term'} {_laws_text(finding.values['laws'])}. No law that is simpler or"
        " as simple does as well."
    )


LIKENESSES = {
    LikenessKind.BIAS: "a constant bias of {size}",
    LikenessKind.LINEAR: "a term proportional to {variable} with {size}",
    LikenessKind.HARDENING: "a nonlinear spring or resistance with {size}",
    LikenessKind.QUADRATIC_DRAG: "quadratic drag with {size}",
    LikenessKind.DRY_FRICTION: "dry friction of {size}",
    LikenessKind.STOP: "a stop or a threshold at {variable} = {place} with {size}",
    LikenessKind.SATURATION: "a saturation over {variable}, at half of {size} where {variable} = {place}",
    LikenessKind.SWITCH: "a switch over {variable}, at half of {size} where {variable} = {place}",
    LikenessKind.MASS_ACTION: "mass action with {size}",
    LikenessKind.CROWDING: "crowding with {size}",
    LikenessKind.PERIODIC: "a periodic term of {size}",
    LikenessKind.MEMORY: "a term with memory of {size}",
}


@writes(DiscoveryCode.LAW_LIKENESS)
def _law_likeness(finding: Finding) -> str:
    v = finding.values
    place = "" if v["place"] is None else wording.value_with_unit(v["place"], _shown_unit(v["place_unit"]))
    words = LIKENESSES[LikenessKind(v["kind"])].format(
        size=wording.value_with_unit(abs(v["size"]), _shown_unit(v["size_unit"])), place=place, variable=v["variable"]
    )
    return f"{finding.subject if v['several'] else 'It'} behaves as {words}."


def _shown_unit(unit: str) -> str:
    return "" if unit in ("", "-", "1") else format_unit(unit)


@writes(DiscoveryCode.LAW_RANGE)
def _law_range(finding: Finding) -> str:
    v = finding.values
    ranges = [
        f"{name} from {low:.3g} to {wording.value_with_unit(high, _shown_unit(v['units'].get(name, '')))}"
        for name, (low, high) in v["range"].items()
    ]
    return f"{finding.subject} was seen with {wording.join_names(ranges)}: beyond that it is a guess"


@writes(DiscoveryCode.MISSING_SIGNAL)
def _missing_signal(finding: Finding) -> str:
    values = finding.values
    if values["dependence"] is not None:
        dependence = dependence_text(values["dependence"])
    elif values["variable"]:
        dependence = f"a function of {values['variable']}"
    else:
        dependence = "no function of any one variable"
    size = wording.value_with_unit(values["size"], values["unit"])
    return f"The plain model lacks a signal of {size} rms at {sites_text(values['sites'], explained=True)}. The signal is {dependence}."


@writes(DiscoveryCode.CHECK_NOISE)
def _check_noise(finding: Finding) -> str:
    values = finding.values
    each = zip(values["std"], values["units"], values["outputs"], strict=True)
    sizes = ", ".join(f"{wording.value_with_unit(std, unit)} in {output}" for std, unit, output in each)
    return (
        f"check that the sensor noise is {sizes}: it was estimated from these records, and a smaller noise would mean that an effect is"
        " missing; give the noise as a number or as a quiet record"
    )


def _noise_from_residual(finding: Finding) -> str:
    shown = ", ".join("white" if not colour else f"correlation {colour[0]:.3g}" for colour in finding.values["colours"])
    return f"candidates are weighed by the colour of the residual of {finding.subject}: {shown}"


@writes(DiscoveryCode.TEST_ERROR)
def _test_error(finding: Finding) -> str:
    v = finding.values
    where = f"on the test records, which took no part in the search, the error of {finding.subject}"
    if v["is_plain"]:
        return f"{where} is {wording.quantity_text(v['before'], v['unit'])}"
    return f"{where} goes from {wording.change_text(v['before'], v['after'], v['unit'])}"


# Moved constants that a sentence names.
MOST_MOVES = 3


@writes(DiscoveryCode.REFIT_ELSEWHERE)
def _refit_elsewhere(finding: Finding) -> str:
    status, errors, constants = (finding.values[key] for key in ("status", "errors", "constants"))
    ended = f" ({status_text(status)})" if status else ""
    # Result files of before have no such key: nothing was told there where the time was over.
    if finding.values.get("is_late") and not (errors or constants):
        return (
            f"{finding.subject}: a fit that begins where the search ended was not done by the time limit, or within as long as the search"
            " took, so nobody knows whether the constants have settled. Fit the written model."
        )
    if not (errors or constants):
        return (
            f"{finding.subject}: a fit of this model that begins at these constants does not end with success{ended}. The constants are"
            " those of the search; another fit may end elsewhere."
        )
    parts = [
        f"the error of {e['output']} on the {e['records']} records from {wording.change_text(e['before'], e['after'], e['unit'], 4)}"
        for e in errors
    ]
    # A curve has twenty heights: the largest moves tell, the others are in the result file.
    moved = sorted(constants.items(), key=lambda item: -item[1])
    parts += [f"{name} by {move:.2g} standard deviations" for name, move in moved[:MOST_MOVES]]
    if len(moved) > MOST_MOVES:
        parts.append(f"{wording.count_noun(len(moved) - MOST_MOVES, 'further constant')} by less")
    moves = wording.join_names(parts)
    return f"{finding.subject}: the last fit had not settled. Another that begins at these constants{ended} changes {moves}."


# What a stage of a search would have said.
FAILED_STAGES = {
    SearchStage.WEIGHING: "the answer could not be weighed against its rivals, so no name of an effect is certain",
    SearchStage.LAWS: "no equation could be looked for",
}

register(
    {
        # The answer.
        DiscoveryCode.NOTHING_MISSING: "No effect is missing: the plain model explains the records down to the noise.",
        DiscoveryCode.PLAIN_UNSETTLED: "The plain model explains the records down to the noise, but its fit has not settled: whether an"
        " effect is missing is open.",
        DiscoveryCode.PLAIN_WAS_STUCK: lambda f: (
            f"{f.subject}: from its start values the plain model ends at {ratio_text(f.values['before'], f.values['bounded'])}, from"
            f" others at {f.values['after']:.3g} times. What a fit from there leaves is another optimum and no missing effect: begin at"
            " the constants found here (shell: fit the model.py that is written), or take several starts (--starts 8)."
        ),
        DiscoveryCode.EFFECT_NAMED: "The plain model lacks {subject}: with it, only noise is left.",
        DiscoveryCode.ERROR_LEFT: lambda f: f"{_remaining_text(f.subject, f.values)}.",
        DiscoveryCode.UNKNOWN_EFFECT: "The model lacks an effect, and no effect of the catalogue is established.",
        DiscoveryCode.NO_LOOK_ALIKE: "What follows the estimation records best, {subject}, does no better than the plain model on the"
        " validation records: the plain model is the answer.",
        DiscoveryCode.WORSE_ON_TEST: "What follows the estimation and the validation records best, {subject}, does worse than the plain"
        " model on the test records: the plain model is the answer.",
        DiscoveryCode.NEAREST_LOOK_ALIKE: "The nearest look-alike is {subject}.",
        DiscoveryCode.HARDLY_VISIBLE: lambda f: (
            "The estimation records hardly show it: the misfit of the plain model there is"
            f" {ratio_text(f.values['misfit'], f.values['bounded'])}."
        ),
        DiscoveryCode.WITHIN_SENSOR_CLASS: "It may be a sensor that is off: what is missing is {size:percent 2} of the range of {subject},"
        " and a sensor is commonly off by up to {limit:percent 6}.",
        DiscoveryCode.SURROGATE_FITTED: lambda f: f"As a surrogate, {surrogate_text(f.values)}.",
        DiscoveryCode.LAW_PROBABLE: lambda f: (
            f"The most probable law is {_laws_text(f.values['laws'])}; it is not established."
        ),
        DiscoveryCode.LAWS_TIED: lambda f: (
            f"The plain model lacks one of these laws: {'; '.join((_laws_text(f.values['laws']), *f.values['rivals']))}. The records cannot"
            " distinguish them."
        ),
        DiscoveryCode.NO_LAW: "No equation among {terms} terms explains it.",
        # What a reader should know.
        DiscoveryCode.DETECTION_LIMIT: "{subject} is not detectable below {parameter} = {limit@unit:2}",
        DiscoveryCode.LEARNT_FROM_VALIDATION: "the constants of the estimation records alone do not hold on the validation records: the"
        " first half of these was fitted as well, and their second half judges",
        DiscoveryCode.ERRORS_GROW: lambda f: (
            "the plain model is unstable: an error grows by e^{exponent:.3g} over a record of {duration:.4g} s."
            + (
                " The records are searched in stretches of {stretch:.2g} s, each with first states of its own"
                if f.values["stretch"]
                else " Where something acts and what is claimed rests on free runs, which lose such a plant: take it for a guess, or cut"
                " the records (up to {longest:.2g} s they are run freely)"
            )
        ).format(**f.values),
        DiscoveryCode.TIME_OVER: "from {seconds:.3g} s on, as asked, the search began no further fit: this is the best answer so far, and"
        " no effect of it is established; repeat the command to continue with its finished refits, or give it more time",
        DiscoveryCode.STAGE_FAILED: lambda f: f"{FAILED_STAGES[f.subject]}: {f.values['reason']}",
        DiscoveryCode.SEEN_THROUGH_RESPONSE: "{subject} is run from outside: effects at its inputs were seen through a linear response"
        " that follows {share:percent 3} of its own, and those that were found are fitted with the plant itself",
        DiscoveryCode.NO_INPUT_RESPONSE: "no effect at an input of {subject} was tried: no linear response to its inputs could be found",
        DiscoveryCode.PLANT_DISAGREES: lambda f: (
            f"{f.subject} itself errs otherwise than the model about its run, on which the effects were found: "
            + wording.join_names(
                [f"{wording.times_text(ratio)} in {name}" for name, ratio in f.values["ratios"].items()]
            )
        ),
        DiscoveryCode.PLANT_FAILS: "{subject} itself does not run with {effects}: their constants and errors are those of the model about"
        " its run",
        DiscoveryCode.PLANT_RUNS: "{subject} was run {runs} times over a record",
        DiscoveryCode.MISSING_ON_TEST: "the test records, which took no part in the search, contradict that only noise is left: the error"
        " of {subject} there is {ratio:.3g} times the noise",
        # Why an effect was not tried.
        DiscoveryCode.NO_PLACE: "the model has no place for it: {reason}",
        DiscoveryCode.EFFECT_PRESENT: "the model contains it already",
        DiscoveryCode.NOT_A_CANDIDATE: "the model lists the effects to try, and this is none of them",
        DiscoveryCode.TRIED_AS_OTHERS: lambda f: (
            f"{wording.join_names([effect_title(name) for name in f.values['others']])}"
            f" {'together are' if len(f.values['others']) > 1 else 'is'} exactly the same"
        ),
        DiscoveryCode.TAKEN_BY_CONSTANTS: "no record tells it from other values of {constants:and}: fix or weigh one of them",
        DiscoveryCode.EFFECT_LEFT_OUT: "left out as asked",
        DiscoveryCode.PART_MISSING: lambda f: (
            f"it needs {part_text(f.values['part'])}, which the rig lacks{_how_known(f.values['reason'])}"
        ),
        DiscoveryCode.NEEDS_UNIFORM_SAMPLING: "it needs uniform sampling, and these records are sampled unevenly: resample them to try it",
        DiscoveryCode.NOT_REACHED: "the time was over before it was tried",
        DiscoveryCode.CANDIDATE_FAILED: "it could not be fitted: {reason}",
        DiscoveryCode.CANDIDATE_NOT_SIMULATED: "the model with it cannot be simulated from any starting point",
        # What to do next.
        DiscoveryCode.SEPARATE_FROM_RIVAL: lambda f: (
            f"no record tells {effect_title(f.subject)} from {effect_title(f.values['rival'])}: {f.values['advice']}"
            if f.values["advice"]
            else f"record an experiment in which {effect_title(f.subject)} and {effect_title(f.values['rival'])} differ (another amplitude,"
            " speed or direction; `greybox design` with `--goal discrimination` plans it): these records do not separate them"
        ),
        DiscoveryCode.CONFIRM_ON_ANOTHER_RECORD: "continue with the extended model, and confirm it on a record with another amplitude or"
        " waveform",
        DiscoveryCode.CONTINUE_WITH_LOOK_ALIKE: "continue with {subject}, which follows the records better, but do not read its parameters"
        " as physics",
        DiscoveryCode.STATE_NOISE: "give the noise of {subject} (a number or a quiet record): these records show only what it is at most,"
        " and below that an effect may hide",
        DiscoveryCode.EXTEND_ESTIMATION_RECORDS: "use longer estimation records, or records with the range of the validation records:"
        " these hardly show the missing effect",
        DiscoveryCode.SUSPECT_MAINS: "check grounding, shields and the supply of drive and sensor: the tone is at the mains frequency of"
        " {mains:.0f} Hz or a multiple of it",
        DiscoveryCode.SUSPECT_MACHINE: "look for a rotating or switching machine at {frequency:.4g} Hz near the rig; a record with zero"
        " input shows the tone alone",
        DiscoveryCode.USE_TONE_MODEL: "if the tone remains, reject it with a notch filter, or with an observer that contains the model and"
        " its tone generator",
        DiscoveryCode.SUSPECT_MEMORY: "record the same motion slowly and fast, and at two amplitudes: no function of one variable explains"
        " the missing signal, so the effect may have memory (play, hysteresis, creep, a part with its own motion)",
        DiscoveryCode.LOOK_AT_STRETCH: "look at what happens from {start:.4g} to {end:.4g} s of {subject}: {share:percent 2} of the misfit"
        " lies in {time_share:percent 2} of the time, so something acts then that the model does not have",
        DiscoveryCode.TRACE_LOOP: "record {subject} up and down over its range, once slowly and once fast: the missing signal differs"
        " between the way up and the way down; a loop that stays when slow is play or hysteresis, one that shrinks is a lag or a loss that"
        " grows with speed",
        DiscoveryCode.TRACE_CURVE: "record {subject} slowly over its whole range: the missing signal is a function of it (explains"
        " {share:percent 2}), and there its curve shows by itself",
        DiscoveryCode.SUSPECT_PERIODIC_PART: "look for magnets, teeth, a thread or a bearing with a period of {period:.3g} {unit}: the"
        " missing signal is periodic in {subject}",
        DiscoveryCode.SUSPECT_CONTACT: "inspect the rig where {subject} is about {position:.3g} {unit}: the curve bends there, as with a"
        " stop, a contact or the end of a guide",
        DiscoveryCode.USE_CURVE_MODEL: "continue with the model that contains the curve, or take its law from the figure and write your"
        " own effect",
        DiscoveryCode.VARY_SPEED_AND_AMPLITUDE: "record the same motion slowly and fast, and at two amplitudes: the curve explains a part,"
        " and the rest depends on more than {subject}",
        DiscoveryCode.VARY_OTHER_VARIABLE: "record the same range of {subject} at several levels of {other}: the curve over {subject}"
        " explains a part, and the missing signal depends on {other} too (explains {share:percent 2})",
        DiscoveryCode.MEASURE_MORE: "measure {outputs:and} as well, to narrow down the site",
        # Steps of the search.
        DiscoveryCode.LAW_TERMS_RANKED: "{terms} terms of equations ranked",
        DiscoveryCode.BASELINE_FITTED: lambda f: (
            f"plain model: misfit {ratio_text(f.values['misfit'], f.values['bounded'])}"
        ),
        DiscoveryCode.FIRST_EFFECT: lambda f: (
            f"{f.subject}: misfit {f.values['before']:.3g} -> {f.values['after']:.3g} times the noise{' at least' * f.values['bounded']}"
        ),
        DiscoveryCode.FURTHER_EFFECT: lambda f: (
            f"{f.subject}: misfit {ratio_text(f.values['after'], f.values['bounded'])}"
        ),
        DiscoveryCode.LEARNING_FROM_VALIDATION: "more than noise is left on the validation records: constants that are fitted to their"
        " first half as well are tried",
    }
)


# Checks


def _check(what: str, relation: str) -> Callable[[Check], str]:
    def write(check: Check) -> str:
        subject = f"{check.subject}: " if check.subject else ""
        outcome = "yes" if check.passed else "no"
        return f"{subject}{what} {check.value:.4g} {relation} {check.limit:.4g}: {outcome}"

    return write


register(
    {
        DiscoveryRule.BASELINE_ABOVE_NOISE: _check("cost per sample of the plain model", ">"),
        DiscoveryRule.VALIDATION_ABOVE_NOISE: _check("validation error over noise", ">"),
        DiscoveryRule.VALIDATION_ONLY: _check("excess of the validation error over noise", ">="),
        DiscoveryRule.CRITERION_GAIN: _check("decrease of Schwarz's criterion", ">"),
        DiscoveryRule.EXPLAINED_EXCESS: _check("decrease of the cost", ">="),
        DiscoveryRule.ONLY_NOISE_LEFT: _check("cost per sample, reduced to the noise", "<="),
        DiscoveryRule.CLEAN_RESIDUAL: _check("cost per sample", "<="),
        DiscoveryRule.SMALL_REMAINDER: _check("remaining excess cost", "<="),
        DiscoveryRule.WHITE_RESIDUAL: _check("excess autocorrelation of the residual", "<="),
        DiscoveryRule.HOLDOUT_GAP: _check("validation error of the plain model over noise", ">"),
        DiscoveryRule.HOLDOUT_EXPLAINED: _check("share of the excess validation error explained", ">="),
        DiscoveryRule.HOLDOUT_PARTLY_EXPLAINED: _check(
            "share of the excess validation error explained, down to the noise", ">="
        ),
        DiscoveryRule.HOLDOUT_NOISE: _check("validation error of the extended model over noise", "<="),
        DiscoveryRule.VALIDATION_DECREASE: _check("validation misfit", "<="),
        DiscoveryRule.CONSISTENT_DECREASE: _check(
            "decrease over blocks of the validation records, in standard errors", ">="
        ),
        DiscoveryRule.TEST_INCREASE: _check("increase over blocks of the test records, in standard errors", "<"),
        DiscoveryRule.SETTLED: _check("fit repeated from its end, and ended there", ">="),
        DiscoveryRule.TEST_NOISE: _check("error on the test records over noise", "<="),
        DiscoveryRule.WINS: _check("misfit over that of the set before", "<"),
        DiscoveryRule.ESTABLISHED: _check("established, with probability", ">="),
    }
)
