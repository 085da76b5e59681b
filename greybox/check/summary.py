"""A check in plain text."""

from __future__ import annotations

from greybox.check.check import WEAK, Check
from greybox.experiment import Experiment
from greybox.model.show import equations
from greybox.result.summary import number


def summary(check: Check) -> str:
    """Equations, integration, records, and what they determine."""
    linear = "linear in states and inputs" if check.linear else "nonlinear"
    lines = [check.model.title, equations(check.model), ""]
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
        noise = ", ".join(f"{name} {number(std, 3)} {units[name]}".rstrip() for name, std in check.noise.items())
        lines += [f"noise           {noise}; {check.noise_source}"]
    return "\n".join([*lines, "", *_constants(check)])


def _records(experiments: tuple[Experiment, ...]) -> list[str]:
    return [line for e in experiments for line in str(e).splitlines()]


def _constants(check: Check) -> list[str]:
    if check.failure:
        return [f"constants       {check.failure}"]
    head = ["constant", "start value", "expected std", "unit", ""]
    rows = [head]
    for name, c in check.constants.items():
        if c.std is None:
            rows.append([name, number(c.value), "", c.unit, "not determined"])
            continue
        share = c.std / abs(c.value) if c.value else float("inf")
        remark = "weakly determined" if share > WEAK else ""
        told = f"{number(c.std, 2)} ({100 * share:.2g} %)" if c.value else number(c.std, 2)
        rows.append([name, number(c.value), told, c.unit, remark])
    widths = [max(len(row[k]) for row in rows) for k in range(len(head))]
    lines = ["what the records can tell, near the start values:"]
    lines += ["  " + "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]
    lines += [f"not determined: {direction}" for direction in check.open_directions]
    if not check.open_directions:
        lines.append("every free constant is determined")
    return lines
