"""A check in plain text."""

from __future__ import annotations

from collections.abc import Mapping

from greybox.check.check import ModelCheck
from greybox.experiment import Experiment
from greybox.identifiability import ExpectedPrecision
from greybox.model.equations import equations_text
from greybox.result.summary import format_number


def summary(check: ModelCheck) -> str:
    """Equations, integration, records, what the outputs can tell at best, and what these records tell."""
    linear = "linear in states and inputs" if check.linear else "nonlinear"
    lines = [check.model.title, equations_text(check.model), ""]
    lines += ["units           every term has the unit of its balance"]
    lines += [f"equations       {linear}; integrated by {check.discretisation}"]
    lines += [f"runs as         {check.kernel} ({check.kernel_reason})"]
    if not check.kernel.startswith("compiled"):
        lines.append(
            "                for the fast kernel install a C compiler (gcc, clang), or name one in the variable CC"
        )
    if check.assumed:
        lines += ["records         none given; simulated at the start values:", f"                {check.assumed}"]
    else:
        lines += [f"{'records' if k == 0 else '':<16}{line}" for k, line in enumerate(_records(check.experiments))]
        units = {o.name: o.unit for o in check.model.outputs}
        noise = ", ".join(f"{name} {format_number(std, 3)} {units[name]}".rstrip() for name, std in check.noise.items())
        lines += [f"noise           {noise}; {check.noise_source}", *_excitation(check)]
    if check.practical.failure and not check.model.free_parameters:
        return "\n".join([*lines, "", f"constants       {check.failure}"])
    return "\n".join([*lines, "", *_structure(check), "", *_constants(check)])


def _records(experiments: tuple[Experiment, ...]) -> list[str]:
    return [line for e in experiments for line in str(e).splitlines()]


def _excitation(check: ModelCheck) -> list[str]:
    """One line for each input and record; records that are driven alike share one."""
    found = dict.fromkeys(line for e in check.practical.excitation for line in str(e).splitlines()[: len(e.orders)])
    return [f"{'input' if k == 0 else '':<16}{line}" for k, line in enumerate(found)]


def _structure(check: ModelCheck) -> list[str]:
    structure = check.structure
    if structure is None:
        return [f"what any record can tell: {check.doubt}"]
    lines = [f"what any record can tell: {structure.verdict}"]
    if structure.complete:
        return lines
    more = structure.rank - len(structure.determined)
    formulas = [*structure.determined, *([f"{more} more"] if more else [])]
    lines += [f"  determined: {', '.join(formulas)}"] if formulas else []
    lines += [f"  not determined: {direction}" for direction in structure.directions]
    return lines + [f"  {'remedy' if k == 0 else 'or'}: {remedy}" for k, remedy in enumerate(structure.remedies)]


def _constants(check: ModelCheck) -> list[str]:
    if check.failure:
        return [f"constants       {check.failure}"]
    rows = [["constant", "start value", "expected std", "unit", ""]]
    rows += [_row(name, c) for name, c in check.constants.items()]
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = [
        "what these records can tell, near the start values:" if not check.assumed else "what such a record can tell:"
    ]
    lines += ["  " + "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]
    found = check.practical
    if not check.complete and found.combinations:
        lines.append(f"  combinations above the noise: {_formulas(found.combinations)}")
    if not check.complete and found.by_averaging:
        lines.append(f"  by averaging the noise alone: {_formulas(found.by_averaging)}")
    if found.weakest and not check.complete:
        lines.append(f"  weakest of what could be told: {', '.join(found.weakest)} ({100 * found.weakest_std:.2g} %)")
    lines += [f"note: {remark}" for remark in found.remarks]
    if check.complete:
        lines.append("every free constant is determined")
    return lines


def _row(name: str, c: ExpectedPrecision) -> list[str]:
    if c.std is None:
        return [name, format_number(c.value), "", c.unit, "not determined"]
    told = f"{format_number(c.std, 2)} ({100 * c.std / abs(c.value):.2g} %)" if c.value else format_number(c.std, 2)
    remark = "not determined" if not c.determined else "by averaging alone" if c.averaged else ""
    return [name, format_number(c.value), told, c.unit, remark]


def _formulas(found: Mapping[str, float]) -> str:
    return ", ".join(f"{text} ({100 * std:.2g} %)" for text, std in found.items())
