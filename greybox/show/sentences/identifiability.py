"""What is said of identifiability: open directions, what would determine more, how rich an input is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from greybox.base import Finding
from greybox.estimation.identifiability.sensitivity import IdentifiabilityCode
from greybox.show.sentences import register, renders, sentence, writes
from greybox.show.sentences.wording import format_with_std, join_names, value_with_unit, with_unit

if TYPE_CHECKING:
    from greybox.estimation.identifiability import Excitation, OpenDirection, StructuralIdentifiability


def describe_closing(closing: Mapping[str, Any]) -> str:
    """Which constants to fix, and which relations would do as well; "" where nothing is missing."""
    if not closing:
        return ""
    missing, constants = closing["missing"], closing["constants"]
    if missing == 1:
        text = f"fix one of {', '.join(constants)}" if len(constants) > 1 else f"fix {constants[0]}"
    else:
        text = f"fix {missing} parameters" + (f", such as {join_names(constants)}" if constants else "")
    if not closing["relations"]:
        return text
    known = ((*relation["constants"], relation["equal"]) for relation in closing["relations"])
    relations = " or ".join(f"{one} = {other}" if equal else f"the ratio {one}/{other}" for one, other, equal in known)
    does = "also suffices" if missing == 1 else "replaces one of them"
    return f"{text}; knowing {relations} {does}"


@writes(IdentifiabilityCode.MEASURE_OUTPUT, IdentifiabilityCode.ADD_SENSOR)
def _recommend_signals(finding: Finding) -> str:
    signals = " or ".join(finding.values["signals"])
    measure = finding.code == IdentifiabilityCode.MEASURE_OUTPUT
    what = f"measure {signals} as well" if measure else f"add a sensor for {signals}"
    then = describe_closing(finding.values["then"])
    result = f"{finding.values['rank']} of {finding.values['count']} determined"
    return f"{what}: {result}" + (f"; then {then}" if then else "")


def _doubt(certain: bool) -> str:
    return "" if certain else "; the singular values show no clear gap, so this is uncertain"


def _where(inputs: Sequence[str], outputs: Sequence[str]) -> str:
    measured = ", ".join(outputs)
    return f"from {', '.join(inputs)} to {measured}" if inputs else f"from {measured}"


@writes(IdentifiabilityCode.RICHER_RECORD)
def _recommend_richer_record(finding: Finding) -> str:
    v = finding.values
    inputs = f": excite {', '.join(v['inputs'])} more strongly and over a wider band" if v["inputs"] else ""
    where = _where(v["inputs"], v["outputs"])
    return (
        f"a sufficiently rich record {where} determines all {v['count']} free parameters{inputs}{_doubt(v['certain'])}"
    )


def _name_exchanged(v: Mapping[str, Any]) -> str:
    """``ka and ke may change places (V with them)``."""
    if not v["exchanged"]:
        return f"there is another answer for {join_names(list(v['values']))}"
    others = f" ({join_names(v['others'])} with them)" if v["others"] else ""
    return f"{join_names(v['exchanged'])} may change places{others}"


@writes(IdentifiabilityCode.OTHER_ANSWER)
def _write_other_answer(finding: Finding) -> str:
    """Another set of values that makes the same run, and what decides."""
    v = finding.values
    values = ", ".join(f"{name} = {value_with_unit(value, v['units'][name], 4)}" for name, value in v["values"].items())
    if v.get("equal") and v["exchanged"]:
        return f"{_name_exchanged(v)} and start equal, where no record tells them apart: what is expected is asked where they differ"
    sensor = f"a sensor for {' or '.join(v['told_by'])}" if v["told_by"] else "another sensor"
    more = f" ({v['count']} such answers)" if v["count"] > 1 else ""
    return f"{_name_exchanged(v)}: {values} makes the same run{more}; a bound, a prior or {sensor} decides"


@writes(IdentifiabilityCode.EXCHANGEABLE)
def _write_exchangeable(finding: Finding) -> str:
    v = finding.values
    sums = [
        f"{' + '.join(s['constants'])} = {with_unit(format_with_std(s['value'], s['std']), s['unit'])}"
        for s in v["sums"]
    ]
    where = "are equal within their intervals" if v["equal"] else "are near one another, so that their intervals are"
    better = f"; better determined: {', '.join(sums)}" if sums else ""
    return f"{_name_exchanged(v)} and {where}{', which are' * v['equal']} by profile likelihood{better}"


@writes(IdentifiabilityCode.SIMULATED_RECORD)
def _simulated_record(finding: Finding) -> str:
    v = finding.values
    drive = ", ".join(
        f"{name} random between {each['low']:g} and {each['high']:g} {each['unit']}".rstrip()
        for name, each in v["inputs"].items()
    )
    noise = f"noise {100 * v['noise_share']:g} % of each output's movement"
    return f"{v['rows']} rows every {v['step']:.3g} s, {drive or 'no input'}, {noise}"


register(
    {
        IdentifiabilityCode.FIX_CONSTANTS: lambda f: describe_closing(f.values),
        IdentifiabilityCode.NO_INPUT_MOVES: "no input moves: only the response to the initial state carries information",
        IdentifiabilityCode.EXCITATION_ORDER_LOW: "{inputs:list}: persistently exciting of order {order}, but the model has {needed}"
        " coefficients for each output: only transients determine the rest; use more tones, a sweep or random levels",
        IdentifiabilityCode.EXCITATION_BAND_NARROW: "the input excites up to {band:.3g} rad/s, but the fastest mode of the model is at"
        " {fastest:.3g} rad/s; excite up to that frequency",
        IdentifiabilityCode.RECORDS_SHOW_FEWER: lambda f: (
            f"any record can determine {f.values['structure']} combinations, these records only {f.values['records']}: use another"
            f" {'input' if f.values.get('driven', True) else 'initial state'}, reduce the noise"
            + (f", or measure {' or '.join(f.values['sensors'])}" if f.values.get("sensors") else "")
        ),
        IdentifiabilityCode.AVERAGING_ONLY: "{averaged} of {total} combinations are determined only by averaging the noise, which requires"
        " white noise and a model error far below the noise: do not rely on them",
        IdentifiabilityCode.PRIORS_COUNT: "the expected standard deviations count what is known of {constants:list} beforehand; what the"
        " records determine without it, the check without the prior says",
        IdentifiabilityCode.NO_FREE_CONSTANT: "no parameter is free: nothing to determine",
        IdentifiabilityCode.MODEL_OVERFLOWS: "at the start values, the model overflows on {subject} after {time:.3g} s; set other values"
        " with --start",
    }
)


@renders("OpenDirection")
def write_open_direction(direction: OpenDirection) -> str:
    """Which constants can change together without any change of the outputs."""
    names = list(direction.weights)
    if len(names) == 1:
        return f"{names[0]} has no influence on the measured outputs"
    listed = ", ".join(names)
    if not direction.scaling:
        return f"{listed} compensate for one another"
    if set(direction.weights.values()) == {1.0}:
        return f"{listed} scale together"

    def factors(sign: int) -> list[str]:
        return [n + " by c" + f"^{w * sign:g}" * (w * sign != 1) for n, w in direction.weights.items() if w * sign > 0]

    down = factors(-1)
    divided = f" and dividing {join_names(down)}" if down else ""
    return f"multiplying {join_names(factors(1))}{divided} leaves the outputs unchanged, for any c"


def describe_verdict(structure: StructuralIdentifiability) -> str:
    """What the measured outputs can show, in one sentence."""
    if not structure.count:
        return "no parameter is free: nothing to determine"
    where, doubt = _where(structure.inputs, structure.outputs), _doubt(structure.certain)
    if structure.complete:
        return f"{where}, all {structure.count} free parameters can be determined{doubt}"
    rank, missing = structure.rank, structure.count - structure.rank
    combinations = f"{rank} combination{'s' * (rank != 1)} of the {structure.count} free parameters can be determined"
    left = f"{missing} direction{'s' * (missing != 1)} stay{'s' * (missing == 1)} open"
    return f"{where}, {combinations}, {left}{doubt}"


@renders("StructuralIdentifiability")
def write_structural_identifiability(structure: StructuralIdentifiability) -> str:
    """The verdict, what is determined, what stays open, and what would close it."""
    lines = [describe_verdict(structure)]
    if structure.complete:
        return lines[0]
    more = structure.rank - len(structure.determined)
    others = [f"{more} more without a simple formula"] if more else []
    if structure.rank:
        lines.append(f"  determined  {', '.join([*structure.determined, *others])}")
    lines += [f"  open        {direction}{_suggest(direction)}" for direction in structure.directions]
    lines += [f"  remedy      {sentence(finding)}" for finding in structure.recommendations]
    return "\n".join(lines)


def _suggest(direction: OpenDirection) -> str:
    """What would close one direction."""
    fix = "fix it" if len(direction.names) == 1 else "fix one of them"
    measure = f", or measure {' or '.join(direction.seen_by)}" if direction.seen_by else ""
    return f": {fix}{measure}"


def describe_inputs(excitation: Excitation) -> list[str]:
    """A line for each input: its order of excitation and its band."""
    return [
        f"{name}: persistently exciting of order {f'{order} or more' if order == excitation.limit else order}, band up to"
        f" {excitation.bands[name]:.3g} rad/s"
        for name, order in excitation.orders.items()
    ]


@renders("Excitation")
def write_excitation(excitation: Excitation) -> str:
    """The inputs, and the excitation that the model still needs."""
    return "\n".join([*describe_inputs(excitation), *map(sentence, excitation.findings)])
