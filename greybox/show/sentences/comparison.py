"""Comparisons, black boxes and frequency responses in words."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from greybox.base import Finding, format_unit
from greybox.base.document import Block, Details, Facts, Paragraphs, TableBlock, Text
from greybox.comparison.blackbox.polynomial import BlackBoxFinding
from greybox.comparison.result import ComparisonFinding
from greybox.show.sentences import register, renders, writes
from greybox.show.sentences.estimation import status_text
from greybox.show.sentences.wording import quantity_text, times_text, value_with_unit

if TYPE_CHECKING:
    from greybox.base import Check
    from greybox.comparison.blackbox import PolynomialModel, StateSpaceModel, StructureScan
    from greybox.comparison.blackbox.hammerstein import HammersteinModel, StaticNonlinearity
    from greybox.comparison.blackbox.rounding import ContinuousTransferFunction
    from greybox.comparison.frequency import BestLinearApproximation, FrequencyResponse


MEASURE = {"free_run": "free run", "one_step": "one sample ahead"}
RECORDS = {
    "validation": "on the validation records",
    "training": "on the estimation records, where every error is optimistic",
}


@writes(ComparisonFinding.BEST_MODEL)
def _best_model(finding: Finding) -> str:
    values = finding.values
    unit, least, other = format_unit(values["unit"]), values["error"], values.get("rival_error", 0.0)
    error = quantity_text(least, unit, 4)
    text = (
        f"{finding.subject}, {MEASURE[values['measure']]} {RECORDS[values['records']]}: {_model_name(values['model'])} is best,"
        f" {error}"
    )
    if "rival" not in values:
        return f"{text}. There is no {values['other_kind']} box to compare with."
    rival = _model_name(values["rival"])
    if values["equally_good"]:
        return f"{text}. {rival} is equally good within {100 * values['tolerance']:.0f} %."
    if least > 0:
        return f"{text}. The best {values['other_kind']} box, {rival}, has {times_text(other / least, 'the error')}."
    return f"{text}. The best {values['other_kind']} box, {rival}, has {quantity_text(other, unit, 4)}."


def _model_name(model: Mapping[str, Any]) -> str:
    count = model["parameters"]
    return f"{model['name']} ({model['kind']} box, {count} parameter{'' if count == 1 else 's'})"


@writes(ComparisonFinding.BIC_OF_DIFFERENT_OUTPUTS)
def _bic_of_different_outputs(finding: Finding) -> str:
    listing = "; ".join(f"{name}: {', '.join(outputs)}" for name, outputs in finding.values["outputs"].items())
    return (
        f"BIC is summed over the outputs of each model ({listing}). Compare it only between models of the same outputs."
    )


def _failure(records: str) -> Callable[[Finding], str]:
    def write(finding: Finding) -> str:
        values, unit = finding.values, format_unit(finding.values["unit"])
        error, movement = (quantity_text(values[key], unit) for key in ("error", "movement"))
        runs = f"errs by {error}" if np.isfinite(values["error"]) else "leaves all bounds"
        return f"failed: its free run of {finding.subject} over {records} {runs}, where a constant errs by {movement}"

    return write


register(
    {
        ComparisonFinding.UNSTABLE_MODELS: "Unstable: {models:list}.",
        ComparisonFinding.FEEDTHROUGH_MODELS: "Direct feed-through within one sample: {models:list}. A plant with inertia has none; it"
        " represents a delay or the input between the samples.",
        ComparisonFinding.FAILED_FITS: "The fit failed: {models:list}. Do not judge the model by these errors.",
        ComparisonFinding.FAILED_MODELS: "Failed, and no part of this comparison: {models:list}. Each follows an output worse than a"
        " constant does.",
        ComparisonFinding.WORSE_THAN_CONSTANT: _failure("the records that it was fitted to"),
        ComparisonFinding.DIVERGED: _failure("the validation records"),
        ComparisonFinding.FIT_FAILED: lambda finding: f"the fit failed: {status_text(finding.values['status'])}",
        ComparisonFinding.PREDICTION_FILTER: "predictions are corrected by {filter}",
        ComparisonFinding.NO_BLACK_BOX: "{reason}",
        ComparisonFinding.NO_STATE_SPACE: "no state-space model of all inputs and outputs ({reason})",
        ComparisonFinding.RECORD_RESAMPLED: "{subject}: resampled to {sampling_time:.6g} s for the black boxes, which need a uniform"
        " sampling time",
        ComparisonFinding.MEASURED_ROWS_ONLY: "{subject}: the black boxes use only the measured rows, every {sampling_time:.6g} s",
    }
)


# Frequency responses, their fits, and best linear approximations in plain text.


_VERDICTS = {True: "noise alone", False: "the system is nonlinear"}


def _linearity(what: str) -> Callable[[Check], str]:
    def write(check: Check) -> str:
        return f"{what} {check.value:.3g} times the noise (limit {check.limit:.3g}): {_VERDICTS[check.passed]}"

    return write


# The codes are those of greybox.comparison.frequency.best_linear_approximation, a later package.
register(
    {
        "realisations_agree": _linearity("the spread of the response over realisations is"),
        "even_lines_are_noise": _linearity("even lines that are not excited hold"),
        "odd_lines_are_noise": _linearity("odd lines that are not excited hold"),
    }
)


@renders("FrequencyResponse")
def write_response(response: FrequencyResponse) -> str:
    """Points, band, channels, and whether their noise is known."""
    low, high = response.frequency[[0, -1]]
    noise = "without variance" if response.variance is None else "with variance"
    what = "points" if response.with_phase else "magnitudes"
    return (
        f"{response.name}: {response.points} {what} from {low:.4g} to {high:.4g} Hz, {', '.join(response.inputs)} to"
        f" {', '.join(response.outputs)}, {noise}"
    )


@renders("BestLinearApproximation")
def write_approximation(result: BestLinearApproximation) -> str:
    """Lines, noise and distortion in decibels of the response, and what the tests say."""
    size = np.mean(np.abs(result.response) ** 2)

    def decibels(variance: np.ndarray | None) -> str:
        power = 0.0 if variance is None else float(np.mean(variance))
        return f"{10 * np.log10(power / size):.1f} dB" if power > 0 else "none seen"

    lines = [
        f"best linear approximation, {result.input} to {result.output}: {len(result.frequency)} lines from"
        f" {result.frequency[0]:.4g} to {result.frequency[-1]:.4g} Hz, {result.realisations} realisations of {result.periods} periods",
        f"  noise of the response: {decibels(result.noise_variance)} of its power",
    ]
    if result.total_variance is not None:
        lines.append(f"  nonlinear distortion of one realisation: {decibels(result.distortion_variance)}")
    lines += [f"  {check}" for check in result.checks]
    if not result.checks:
        lines.append(
            "  nothing tells distortion from noise: give a second realisation, or leave lines of the input out"
        )
    return "\n".join(lines)


# Black-box models in words.


EXCITATION = {0: "it is constant zero", 1: "a constant or a step", 2: "one sine"}


@writes(BlackBoxFinding.WEAK_EXCITATION)
def _weak_excitation(finding: Finding) -> str:
    order, required = finding.values["order"], finding.values["required"]
    signal = EXCITATION.get(order) or (f"as {order // 2} sines are" if order % 2 == 0 else "")
    return (
        f"input {finding.subject!r} is persistently exciting of order {order}{f' ({signal})' if signal else ''}, but the structure"
        f" needs order {required}: only transients and noise determine the remaining coefficients; use a smaller structure or a"
        " richer input"
    )


@writes(BlackBoxFinding.UNSTABLE)
def _unstable(finding: Finding) -> str:
    if finding.values["equation_error"]:
        cause = (
            "more noise on the output than the structure allows for (use an output-error or ARMAX model, or focus='simulation'),"
            " or an integrating plant, whose pole lies at 1"
        )
    else:
        cause = "a structure that is too large (use a smaller one), or an integrating plant, whose pole lies at 1"
    return (
        f"the model is unstable: its outermost pole lies at |z| = {finding.values['pole']:.6g}, and a free run grows by a factor of e"
        f" every {finding.values['growth_samples']:.3g} samples; likely causes: {cause}"
    )


register({BlackBoxFinding.SEARCH_UNFINISHED: "the search stopped after {iterations} iterations without convergence"})


@renders("PolynomialModel")
def polynomial_blocks(model: PolynomialModel) -> list[Block]:
    """Equation, coefficients with standard deviations, poles, zeros, gain, and what to know before trusting them."""
    from greybox.comparison.blackbox.rounding import count_digits_needed

    needed = count_digits_needed(model)
    digits = max(8, needed)
    unit = model.units.get(model.output, "")
    std = model.std
    rows = [
        [name, f"{value:.{digits}g}", "" if np.isnan(std[name]) else f"{std[name]:.2g}"]
        for name, value in model.coefficients.items()
    ]
    facts: list[tuple[str, Text]] = [
        ("poles", _numbers(model.poles)),
        *(
            (f"zeros from {n}", f"{_numbers(model.zeros(n))}; steady-state gain {model.gain(n):.6g}")
            for n in model.inputs
        ),
        ("noise", f"{value_with_unit(model.noise_std, unit, 4)} one step ahead, over {model.samples} equations"),
        ("digits", f"at least {needed} keep stability, and the frequency response within 1 %"),
        *([("history", f"{model.history}; focus: {model.focus}")] if model.history else []),
        *(("note", finding) for finding in model.findings),
    ]
    if any(model.origins):
        named = zip((model.output, *model.inputs), model.origins, strict=True)
        text = ", ".join(f"{n} {value_with_unit(v, model.units.get(n, ''), 6)}" for n, v in named)
        facts.append(("signals", f"measured from {text}"))
    title = f"{model.label} of {model.output} from {', '.join(model.inputs)}, every {model.sampling_time:.6g} s"
    return [
        Paragraphs([title, polynomial_equation(model)]),
        TableBlock("Coefficients", ["coefficient", "value", "std"], rows),
        Facts(facts),
    ]


def polynomial_equation(model: PolynomialModel) -> str:
    """The difference equation with its polynomials' letters: ``A(q) y = B(q) / F(q) u + C(q) e``."""
    left = f"{'A(q) ' if len(model.a) > 1 else ''}{model.output}(k)"
    several = len(model.inputs) > 1
    terms = []
    for i, (name, f) in enumerate(zip(model.inputs, model.f, strict=True), 1):
        mark = str(i) if several else ""
        terms.append(f"B{mark}(q)" + (f" / F{mark}(q)" if len(f) > 1 else "") + f" {name}(k)")
    if model.constant is not None:
        first = "1" if several else ""
        terms.append(f"constant / F{first}(q)" if len(model.f[0]) > 1 else "constant")
    noise = "C(q)" if len(model.c) > 1 else ""
    if len(model.d) > 1:
        noise = f"{noise or '1'} / D(q)"
    return f"{left} = {' + '.join([*terms, f'{noise} e(k)'.strip()])}"


@renders("HammersteinModel")
def hammerstein_blocks(model: HammersteinModel) -> list[Block]:
    """A few points of each nonlinearity, then the linear part."""
    curves = [
        nonlinearity_text(name, curve, model.linear.units)
        for name, curve in zip(model.inputs, model.curves, strict=True)
    ]
    return [Paragraphs([model.label, *curves]), *polynomial_blocks(model.linear)]


def nonlinearity_text(name: str, curve: StaticNonlinearity, units: Mapping[str, str]) -> str:
    """A static nonlinearity as a few of its points."""
    points = curve.origin + np.linspace(-curve.size, curve.size, 7)
    unit = units.get(name, "")
    values = ", ".join(f"{u:.3g} -> {v:.4g}" for u, v in zip(points, curve(points), strict=True))
    return f"nonlinearity of {name}{f' [{unit}]' if unit else ''}: {values}"


@renders("StructureScan")
def structure_scan_blocks(scan: StructureScan) -> list[Block]:
    """The best structures in a table, the chosen one marked."""
    key = {"aic": lambda s: s.aic, "bic": lambda s: s.bic, "free run": lambda s: (-s.folds, s.free_run)}[scan.criterion]
    shown_rows = 12
    fitted = sorted((s for s in scan.structures if s.model is not None), key=key)
    shown = fitted[:shown_rows]
    if scan.chosen not in shown:
        shown = [*fitted[: shown_rows - 1], scan.chosen]
    rows = [
        [
            s.label,
            f"{s.model.parameters}",
            *("-" if np.isposinf(v) else f"{v:.1f}" for v in (s.aic, s.bic)),
            value_with_unit(s.free_run, scan.unit, 4),
            "" if s.model.stable else "unstable",
            "<- chosen" if s is scan.chosen else "",
        ]
        for s in shown
        if s.model is not None
    ]
    failed = [s for s in scan.structures if s.model is None]
    records = ", ".join(scan.validation) or "the estimation records"
    more = [f"and {len(fitted) - len(shown)} more"] if len(fitted) > len(shown) else []
    more += [f"{len(failed)} could not be fitted, the first: {failed[0].failure}"] if failed else []
    title = f"{len(scan.structures)} structures, chosen by {scan.criterion}; free run over {records}"
    table = TableBlock("Structures", ["structure", "coefficients", "AIC", "BIC", "free run", "", ""], rows)
    return [Details(title, [table, Paragraphs(more)])]


@renders("ContinuousTransferFunction")
def continuous_transfer_function_text(function: ContinuousTransferFunction) -> str:
    """Numerator over denominator in powers of s, and the delay."""
    fraction = f"({_polynomial(function.numerator)}) / ({_polynomial(function.denominator)})"
    return f"{fraction} e^(-{function.delay:.4g} s)" if function.delay else fraction


def _polynomial(coefficients: np.ndarray) -> str:
    powers = range(len(coefficients) - 1, -1, -1)
    terms = [
        f"{value:.8g}{' s' if p else ''}{f'^{p}' if p > 1 else ''}"
        for value, p in zip(coefficients, powers, strict=True)
        if value != 0
    ]
    return " + ".join(terms).replace("+ -", "- ") or "0"


def _numbers(values: np.ndarray) -> str:
    if not len(values):
        return "none"
    return ", ".join(f"{v.real:.6g}" if abs(v.imag) < 1e-12 else f"{v.real:.6g}{v.imag:+.6g}j" for v in values)


@renders("StateSpaceModel")
def write_state_space(model: StateSpaceModel) -> str:
    """Order, signals, poles, and where the singular values fall."""
    values = ", ".join(f"{v:.3g}" for v in model.singular_values[: model.order + 3])
    poles = ", ".join(f"{p.real:.5g}" if abs(p.imag) < 1e-12 else f"{p.real:.5g}{p.imag:+.5g}i" for p in model.poles)
    return "\n".join(
        [
            f"{model.weight} of order {model.order}: {', '.join(model.inputs)} to {', '.join(model.outputs)}, every"
            f" {model.sampling_time:.6g} s, {model.samples} columns",
            f"  poles (z): {poles}",
            f"  singular values: {values}",
        ]
    )
