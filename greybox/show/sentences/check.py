"""A check in plain text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from greybox.model.equations import equations_text
from greybox.show.sentences.identifiability import describe_inputs, describe_verdict
from greybox.show.sentences.model import write_places
from greybox.show.sentences.registry import renders
from greybox.show.sentences.wording import format_number

if TYPE_CHECKING:
    from greybox.data.experiment import Experiment
    from greybox.estimation.check import ModelCheck
    from greybox.estimation.identifiability.practical import ExpectedPrecision


def describe_noise_source(check: ModelCheck) -> str:
    """Where the noise is known from, and which outputs are left out."""
    return "; ".join(map(str, (check.noise_model, *check.excluded)))


@renders("ModelCheck")
def write_check(check: ModelCheck) -> str:
    """Equations, integration, records, what the outputs can tell at best and what these records tell, roles and effects."""
    linear = "linear in states and inputs" if check.linear else "nonlinear"
    lines = [check.model.title, equations_text(check.model), ""]
    lines += ["units           every term has the unit of its balance"]
    lines += [f"equations       {linear}; integrated by {check.discretisation}"]
    lines += [f"runs as         {check.kernel} ({check.kernel_reason})"]
    if not check.compiled:
        lines.append(
            "                for the fast kernel, install a C compiler (gcc, clang) or set the environment variable CC"
        )
    if check.assumed:
        lines += ["records         none given; simulated at the start values:", f"                {check.assumed}"]
    else:
        lines += [f"{'records' if k == 0 else '':<16}{line}" for k, line in enumerate(_records(check.experiments))]
        units = {o.name: o.unit for o in check.model.outputs}
        noise = ", ".join(f"{name} {format_number(std, 3)} {units[name]}".rstrip() for name, std in check.noise.items())
        lines += [f"noise           {noise}; {describe_noise_source(check)}", *_excitation(check)]
    lines += ["", *_roles(check)]
    if check.failure and not check.model.free_parameters:
        return "\n".join([*lines, "", f"parameters      {check.failure}"])
    return "\n".join([*lines, "", *_structure(check), "", *_constants(check)])


def _roles(check: ModelCheck) -> list[str]:
    """The role of each signal, the effects that find a place, and what would open the others."""
    named = check.roles
    lines = [f"roles           {', '.join(f'{n} {role}' for n, role in named['states'].items()) or 'no state has one'}"]
    lines += [
        f"{'':<16}{', '.join(f'{n} {role}' for n, role in named[group].items())}"
        for group in ("inputs", "parameters")
        if named[group]
    ]
    without = [s.name for s in check.model.states if s.name not in named["states"]]
    lines += [f"{'':<16}without one: {', '.join(without)}"] if without else []
    count = sum(p.effect is not None for p in check.placements)
    return [*lines, f"effects         {count} find a place", *write_places(check.placements)]


def _records(experiments: tuple[Experiment, ...]) -> list[str]:
    return [line for e in experiments for line in str(e).splitlines()]


def _excitation(check: ModelCheck) -> list[str]:
    """One line for each input and record; records that are driven alike share one."""
    inputs = dict.fromkeys(line for e in check.practical.excitation for line in describe_inputs(e))
    return [f"{'input' if k == 0 else '':<16}{line}" for k, line in enumerate(inputs)]


def _structure(check: ModelCheck) -> list[str]:
    structure = check.structure
    if structure is None:
        return [f"identifiability from any record: {check.doubt}"]
    lines = [f"identifiability from any record: {describe_verdict(structure)}"]
    if structure.complete:
        return lines
    more = structure.rank - len(structure.determined)
    formulas = [*structure.determined, *([f"{more} more"] if more else [])]
    lines += [f"  determined: {', '.join(formulas)}"] if formulas else []
    lines += [f"  not determined: {direction}" for direction in structure.directions]
    return lines + [f"  {'remedy' if k == 0 else 'or'}: {remedy}" for k, remedy in enumerate(structure.recommendations)]


def _constants(check: ModelCheck) -> list[str]:
    if check.failure:
        return [f"parameters      {check.failure}"]
    rows = [["parameter", "start value", "expected std", "unit", ""]]
    rows += [_constant_row(name, c) for name, c in check.constants.items()]
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = [
        "expected precision from these records, near the start values:"
        if not check.assumed
        else "expected precision from such a record:"
    ]
    lines += ["  " + "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]
    practical = check.practical
    if not check.complete and practical.combinations:
        lines.append(f"  combinations above the noise: {_list_formulas(practical.combinations)}")
    if not check.complete and practical.by_averaging:
        lines.append(f"  only by averaging the noise: {_list_formulas(practical.by_averaging)}")
    if practical.weakest and not check.complete:
        lines.append(
            f"  least precise combination: {', '.join(practical.weakest)} ({100 * practical.weakest_std:.2g} %)"
        )
    lines += [f"note: {finding}" for finding in practical.findings]
    if check.complete:
        lines.append("every free parameter is determined")
    return lines


def _constant_row(name: str, c: ExpectedPrecision) -> list[str]:
    if c.std is None:
        return [name, format_number(c.value), "", c.unit, "not determined"]
    precision = (
        f"{format_number(c.std, 2)} ({100 * c.std / abs(c.value):.2g} %)" if c.value else format_number(c.std, 2)
    )
    remark = "not determined" if not c.determined else "only by averaging" if c.averaged else ""
    return [name, format_number(c.value), precision, c.unit, remark]


def _list_formulas(combinations: Mapping[str, float]) -> str:
    return ", ".join(f"{text} ({100 * std:.2g} %)" for text, std in combinations.items())
