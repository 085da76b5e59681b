"""What several documents have: tables of parameters and misfits, names with values, equations, records, and how a result came about."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from greybox.base import Finding, Severity, format_unit, read_versions
from greybox.base import document as doc
from greybox.estimation import Fit, FitOptions, Trace
from greybox.model import Balance, Model, equations_text
from greybox.model.balance import stores_nothing
from greybox.model.expressions.operations import Binding
from greybox.model.expressions.printer import Printed
from greybox.model.expressions.text import LATEX, expression_latex, symbol_latex
from greybox.show.figures.figure import scale_to_prefix, value_range
from greybox.show.sentences import wording
from greybox.simulation.simulate import Simulation

if TYPE_CHECKING:
    from greybox.estimation.result_parts import Estimate, Misfit

SEVERITIES = (Severity.ERROR, Severity.WARNING, Severity.NOTE)
MISFIT_HEADS = ("rmse", "best fit", "noise", "rmse / noise")


def parameters_table(fit: Fit, note: doc.Text = "", *, fitted: bool = False) -> doc.TableBlock:
    """The parameters of a fit: each one, its values in experiments that have their own, then those that are tied.

    ``fitted``: without those that were known before.
    """
    rows = []
    for name, e in fit.parameters.items():
        if fitted and e.fixed and fit.uncertainty.free:
            continue
        rows.append(estimate_cells(name, e))
        if name in fit.constraints.per_experiment:
            rows[-1][-1] = "mean"
            each = fit.constraints.per_experiment[name].items()
            rows += [estimate_cells(f"{name} ({title})", estimate) for title, estimate in each]
    for name, e in fit.constraints.tied.items():
        rows.append(estimate_cells(name, e))
        rows[-1][-1] = f"= {fit.constraints.ties[name]}"
    caption, heads = (
        "Parameters with standard deviations and 95 % intervals",
        ["value", "95 % interval", "unit", doc.REMARK],
    )
    # Of several starts each has its own: they stand in a table of theirs.
    if fitted or fit.starts or not fit.provenance.start:
        return doc.TableBlock(caption, ["parameter", *heads], rows, note)
    begun = fit.provenance.start
    starts = [wording.format_number(begun[row[0]], 4) if row[0] in begun else "" for row in rows]
    rows = [[row[0], start, *row[1:]] for row, start in zip(rows, starts, strict=True)]
    return doc.TableBlock(caption, ["parameter", "start", *heads], rows, note)


def estimate_cells(name: str, e: Estimate) -> list[str]:
    """Name, value, interval, unit and remark of one parameter."""
    if e.fixed:
        return [name, wording.format_number(e.value, 7), "", format_unit(e.unit), "fixed"]
    remark = "at its bound" if e.at_bound else ""
    if e.std is None or e.interval is None:
        limits = (
            ""
            if e.interval is None
            else f"[{wording.format_number(e.interval[0], 3)}, {wording.format_number(e.interval[1], 3)}]"
        )
        return [name, wording.format_number(e.value), limits, format_unit(e.unit), remark or "not determined"]
    if not remark and not e.determined:
        remark = "not determined"
    low, high = map(wording.make_formatter(e.value, e.std), e.interval)
    return [name, wording.format_with_std(e.value, e.std), f"[{low}, {high}]", format_unit(e.unit), remark]


# Powers of ten between which a number of a LaTeX table stands without one.
PLAIN_POWERS = range(-2, 5)
# Significant digits of a standard deviation, and of a value that has none.
STD_DIGITS, VALUE_DIGITS = 2, 4


def parameters_latex(fit: Fit) -> str:
    r"""The constants of a fit as a table for a paper, in LaTeX with the rules of the package ``booktabs``.

    Parameters
    ----------
    fit
        The result of `greybox.fit`.

    Returns
    -------
    str
        Symbol, value with its standard deviation, 95 % interval and unit of each constant, one a row; known ones say so.
    """
    rows = [*fit.parameters.items(), *fit.constraints.tied.items()]
    lines = [rf"  ${symbol_latex(name)}$ & {' & '.join(_latex_cells(e))} \\" for name, e in rows]
    head = r"  constant & value & 95\,\% interval & unit \\"
    begin, end = r"\begin{tabular}{llll}", r"\end{tabular}"
    return "\n".join([begin, r"  \toprule", head, r"  \midrule", *lines, r"  \bottomrule", end, ""])


def _latex_cells(e: Estimate) -> list[str]:
    power = math.floor(math.log10(abs(e.value))) if e.value else 0
    power = 0 if power in PLAIN_POWERS else power
    times = rf" \times 10^{{{power}}}" if power else ""
    # A number shows the digits of its standard deviation, and no fewer than two of its own.
    shown = e.std if e.std and not e.fixed else abs(e.value) * 10.0 ** (STD_DIGITS - VALUE_DIGITS) or 1.0
    digits = max(0, STD_DIGITS - 1 - math.floor(math.log10(shown / 10.0**power)))

    def scaled(number: float) -> str:
        return f"{number / 10.0**power:.{digits}f}" if math.isfinite(number) else rf"{'-' * (number < 0)}\infty"

    if e.fixed:
        interval, value = "known", f"{e.value / 10.0**power:.{VALUE_DIGITS}g}"
    else:
        value = scaled(e.value) if e.std is None else rf"{scaled(e.value)} \pm {scaled(e.std)}"
        value = f"({value})" if power and e.std is not None else value
        interval = "" if e.interval is None else rf"$[{', '.join(map(scaled, e.interval))}]{times}$"
    # kg*m^2/s reads kg m^2/s, upright.
    unit = re.sub(r"\^(-?[\d.]+)", r"^{\1}", format_unit(e.unit)).replace("*", r"\,").replace("%", r"\%")
    return [f"${value}{times}$", interval, rf"$\mathrm{{{unit}}}$" if unit else ""]


def misfit_table(caption: doc.Text, misfit: Mapping[str, Misfit], corner: str = "") -> doc.TableBlock:
    """Misfits by output."""
    rows = [[name, *misfit_cells(m)] for name, m in misfit.items()]
    return doc.TableBlock(caption, ["output", *MISFIT_HEADS], rows, corner=corner)


def misfit_cells(m: Misfit) -> list[str]:
    """rmse, best fit, the noise, and error over noise."""
    error = wording.quantity_text(m.rmse, format_unit(m.unit), 4)
    if m.without_outliers and m.error is not None:
        error = f"{error} ({wording.quantity_text(m.error, format_unit(m.unit), 4)} without outliers)"
    return [error, f"{m.best_fit_percent:.2f} %", wording.noise_text(m), f"{wording.ratio_text(m)} x noise"]


def worst_first(findings: Iterable[Finding]) -> list[Finding]:
    """Errors, then warnings, then notes, each in their order."""
    return sorted(findings, key=lambda finding: SEVERITIES.index(finding.severity))


def named_values(title: str, values: Mapping[str, Any]) -> doc.Facts:
    """Names and values; a name within a group is ``group.name``."""
    return doc.Facts(list(flatten(values).items()), title)


def flatten(values: Mapping[str, Any], group: str = "") -> dict[str, str]:
    """The values of nested mappings as text, by their names."""
    flat: dict[str, str] = {}
    for name, value in values.items():
        nested = isinstance(value, Mapping)
        flat |= flatten(value, f"{group}{name}.") if nested else {f"{group}{name}": "" if value is None else str(value)}
    return flat


# The equations of a model, typeset: one line a balance, then what holds, delays, sets and measures.


def typeset_equations(model: Model) -> doc.EquationList:
    """The equations of ``model`` with every effect written out, and the same as text."""
    return doc.EquationList(
        [*_balances(model), *_standstill(model), *_updates(model), *_outputs(model)], equations_text(model)
    )


# Letters of an equation on one line of a page, and of a part of it that gets a name of its own where it stands there several times.
EQUATION_LETTERS, NAMED_LETTERS = 90, 12
# Where a part of an equation in LaTeX begins that may get a name: a function of something in brackets, or a fraction.
PART = re.compile(r"\\(?:min|max|sqrt|frac|operatorname\{\w+\})(?=\\left|\{)")


def _balances(model: Model) -> Iterator[doc.Equation]:
    named = 0
    for balance in model.system.stated_balances:
        parts, terms = name_parts(_terms(balance), named)
        named += len(parts)
        for symbol, part in reversed(parts.items()):
            yield doc.Equation(f"{balance.name}, with", "", f"{symbol} = {part}")
        left, unit = f"{_storage(balance)} = ", format_unit(balance.unit)
        if count_letters(left + "".join(terms)) <= EQUATION_LETTERS:
            yield doc.Equation(balance.name, unit, left + " ".join(terms))
        else:
            rows = r" \\ \quad ".join([left + terms[0], *terms[1:]])
            yield doc.Equation(balance.name, unit, rf"\begin{{array}}{{l}} {rows} \end{{array}}")


def count_letters(latex: str) -> int:
    """About how many letters wide an equation is."""
    return len(
        re.sub(r"\\underset\{[^{}]*\{[^{}]*\}\}|\\(?:left|right|mathrm|frac|text)\b|\\[a-z]+|[{}_^\s,]", "", latex)
    )


def name_parts(terms: Sequence[str], named: int = 0) -> tuple[dict[str, str], list[str]]:
    """Terms in LaTeX in which parts that stand there several times have names: what each name is, and the terms.

    The part that saves most comes first; ``named`` so many names are taken already. An equation that fits on a line stays as it is.
    """
    parts: dict[str, str] = {}
    texts = list(terms)
    while count_letters("".join(texts)) > EQUATION_LETTERS:
        spans = Counter(span for text in (*texts, *parts.values()) for span in _list_parts(text))
        gains = {span: (n - 1) * count_letters(span) for span, n in spans.items() if n > 1}
        gains = {span: gain for span, gain in gains.items() if count_letters(span) >= NAMED_LETTERS}
        if not gains:
            break
        largest = max(gains, key=lambda span: (gains[span], len(span)))
        symbol = rf"\zeta_{{{named + len(parts) + 1}}}"
        texts = [text.replace(largest, symbol) for text in texts]
        parts = {symbol: largest, **{name: part.replace(largest, symbol) for name, part in parts.items()}}
    return parts, texts


def _list_parts(latex: str) -> Iterator[str]:
    """The parts of an equation that may get a name, each as a balanced text."""
    for match in PART.finditer(latex):
        end = match.end()
        for _ in range(2 if match[0].endswith("frac") else 1):
            end = _end_of_group(latex, end)
        yield latex[match.start() : end]


def _end_of_group(latex: str, start: int) -> int:
    """Where the group in braces, or between ``\\left`` and ``\\right``, ends that begins at ``start``."""
    opening, closing = (r"\left", r"\right") if latex.startswith(r"\left", start) else ("{", "}")
    depth, at = 0, start
    while at < len(latex):
        if latex.startswith(opening, at):
            depth, at = depth + 1, at + len(opening)
        elif latex.startswith(closing, at):
            depth, at = depth - 1, at + len(closing)
            if not depth:
                return at + (closing != "}")  # the bracket itself
        else:
            at += 1
    return at


def _storage(balance: Balance) -> str:
    if stores_nothing(balance):
        return "0"
    rate = rf"\frac{{\mathrm{{d}}{symbol_latex(balance.state)}}}{{\mathrm{{d}}t}}"
    factor = LATEX.write(balance.storage)
    return rate if factor.text == "1" else rf"{factor.within(Binding.NEGATION, LATEX.brackets)}\,{rate}"


def _terms(balance: Balance) -> list[str]:
    """The terms with their signs, and their names below."""
    texts: list[str] = []
    for name, value in balance.terms.items():
        block = balance.blocks.get(name)
        if block:
            stands = rf"\text{{{_words(block.name)}}}"
            term = (
                Printed(f"-{stands}", Binding.NEGATION, stands) if block.is_negative else Printed(stands, Binding.ATOM)
            )
        else:
            term = LATEX.write(value)
        sign = "- " if term.opposite else ("+ " if texts else "")
        texts.append(rf"{sign}\underset{{\text{{{_words(name)}}}}}{{{term.opposite or term.text}}}")
    return texts


def _standstill(model: Model) -> Iterator[doc.Equation]:
    for dry in model.system.dry:
        if dry.static.element_hash() != dry.sliding.element_hash():
            unit = next(b.unit for b in model.system.balances if b.name == dry.balance)
            yield doc.Equation(
                f"{_words(dry.effect)} holds at standstill up to", format_unit(unit), expression_latex(dry.static)
            )


def _updates(model: Model) -> Iterator[doc.Equation]:
    for update in model.system.updates:
        state = model.all_states[update.state]
        yield doc.Equation(
            f"{state.name} after each step",
            format_unit(state.unit),
            rf"{symbol_latex(state.name)} = {expression_latex(update.value)}",
        )


def _outputs(model: Model) -> Iterator[doc.Equation]:
    system = model.system
    outputs = system.outputs if system.stated_outputs is None else system.stated_outputs
    for k, output in enumerate(model.outputs):
        value: ca.SX = outputs[k]
        yield doc.Equation(
            f"measured {output.name}",
            format_unit(output.unit),
            rf"{symbol_latex(output.name)}^\ast = {expression_latex(value)}",
        )


def _words(name: str) -> str:
    """A name as text within a formula: what LaTeX or a page would read as a command becomes a space."""
    return re.sub(r"[^\w .,:;()'+*/=<>|!?°-]|_", " ", name)


# What stands at the end of a page: its records, and how to repeat it with the same command, options and versions.


def provenance_section(command: str, versions: Mapping[str, Any] | None = None) -> doc.Section:
    """The command and the versions: those of now, or those that were noted."""
    table = named_values("Versions", read_versions() if versions is None else versions)
    return doc.Section("repeat", "How to repeat it", [*_command(command), table])


def fit_provenance_section(fit: Fit, command: str) -> doc.Section:
    """What is needed to get the numbers of a fit again."""
    iterations = wording.count_noun(int(fit.solver.statistics.get("iterations", 0)), "iteration")
    ended = f"{fit.status.replace('_', ' ')} after {iterations}"
    computed = doc.Facts([*computation_facts(fit), ("ended", ended)], "How it was computed")
    # The options; of the policy only what differs from the default, which the note says.
    usual = flatten(FitOptions().to_data())
    rows = [
        [name, value]
        for name, value in flatten(fit.provenance.options).items()
        if not (name.startswith("policy.") and usual.get(name) == value)
    ]
    note = "Numbers of the policy that are not listed have their default values."
    options = doc.TableBlock("Options", ["name", "value"], rows, note)
    tables: list[doc.Block] = [options, named_values("Versions", fit.provenance.versions)]
    return doc.Section(
        "repeat", "How to repeat it", [*_command(command), computed, doc.Details("Options and versions", tables)]
    )


def _command(command: str) -> list[doc.Block]:
    return [doc.CodeBlock(command, "In the shell")] if command else []


def computation_facts(fit: Fit) -> list[tuple[str, str]]:
    """How a fit was integrated and searched for; nothing of the integrator's error where the discretisation is exact."""
    error = max((e for e in fit.discretisation.error.values() if math.isfinite(e)), default=0.0)
    shift = max((s for s in fit.discretisation.shift.values() if math.isfinite(s)), default=0.0)
    left = f"; error {error:.2g} x noise, half the step changes no parameter by more than {shift:.2g} std"
    search = [] if fit.solver.strategy is None else [("search", str(fit.solver.strategy))]
    return [("discretisation", fit.discretisation.label + (left if error or shift else "")), *search]


# The data of a page: which records, what they hold, and their fingerprints.


def records_section(fit: Fit) -> doc.Section:
    """Names, lengths, gaps and fingerprints of the records, and what their columns hold."""
    fitted, validation = [*fit.traces], [*fit.validation.traces]
    rows = [*(_record(t, "fitted") for t in fitted), *(_record(t, "validation") for t in validation)]
    note = f"Noise: {fit.noise}"
    head = ["record", "use", "rows", "duration", "sampling time", "missing values", "fingerprint"]
    records = doc.TableBlock("Records", head, rows, note)
    return doc.Section("data", "Data", [records, _signals(fitted + validation, fit)])


def hidden_states(run: Simulation) -> dict[str, np.ndarray]:
    """The states of a run that no output of the same name shows already."""
    return {
        name: values
        for name, values in run.states.items()
        if name not in run.outputs or not np.array_equal(run.outputs[name], values)
    }


def _record(trace: Trace, use: str) -> list[str]:
    missing = {name: int(np.isnan(v).sum()) for name, v in trace.measured.items()}
    gaps = wording.join_names([f"{count} of {name}" for name, count in missing.items() if count])
    return [
        trace.name,
        use,
        str(len(trace.time)),
        f"{trace.time[-1] - trace.time[0]:.6g} s",
        format_sampling_time(trace.time),
        gaps or "none",
        trace.fingerprint[:12],
    ]


def format_sampling_time(time: np.ndarray) -> str:
    """The sampling time, or its range where it varies."""
    steps = np.diff(time)
    if not len(steps):
        return ""
    even = float(np.ptp(steps)) < 1e-6 * float(steps.mean())
    return f"{float(steps.mean()):.6g} s" if even else f"{float(steps.min()):.4g} to {float(steps.max()):.4g} s"


def signal_units(model: Model) -> dict[str, str]:
    """Unit of each output, input and state."""
    units = {s.name: s.unit for s in model.all_states} | {i.name: i.unit for i in model.inputs}
    return units | {o.name: o.unit for o in model.outputs}


def format_range(*signals: np.ndarray, factor: float = 1.0) -> str:
    """``-3.1 to 2.7``, of the finite values of all ``signals`` (N,) times ``factor``."""
    ends = [end for values in signals for end in value_range(values) if math.isfinite(end)]
    return f"{factor * min(ends):.4g} to {factor * max(ends):.4g}" if ends else "nothing"


def _signals(traces: list[Trace], fit: Fit) -> doc.TableBlock:
    rows = []
    for use, signals in (("input", fit.model.inputs), ("measured", fit.model.outputs)):
        for signal in signals:
            groups = [t.inputs if use == "input" else t.measured for t in traces]
            values = [np.asarray(g[signal.name]) for g in groups if signal.name in g]
            factor, unit = scale_to_prefix(signal.unit, *values)
            std = fit.noise.std.get(signal.name) if use == "measured" else None
            noise = f"{factor * std:.3g} {unit}" if std is not None and np.isfinite(std) else ""
            limits = f"{format_range(*values, factor=factor)} {unit}" if values else "not recorded"
            rows.append([signal.name, use, limits, noise])
    return doc.TableBlock("Signals over all records", ["signal", "use", "from … to", "noise (std)"], rows)
