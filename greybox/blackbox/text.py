"""A black-box model in plain text."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from greybox.blackbox.polynomial import PolynomialModel
from greybox.blackbox.rounding import count_digits_needed
from greybox.blackbox.static_nonlinearity import StaticNonlinearity
from greybox.result.summary import format_table

CURVE_POINTS = 7
FEWEST_SHOWN = 8  # digits of coefficients in a text; more where stability or behaviour needs them


def describe_model(model: PolynomialModel) -> str:
    """Equation, coefficients with standard deviations, poles, zeros, gain, and what to know before trusting them."""
    digits = max(FEWEST_SHOWN, count_digits_needed(model))
    unit = model.units.get(model.output, "")
    spread = model.std
    rows = [
        [name, f"{value:.{digits}g}", "" if np.isnan(spread[name]) else f"{spread[name]:.2g}"]
        for name, value in model.coefficients.items()
    ]
    lines = [
        f"{model.label} of {model.output} from {', '.join(model.inputs)}, every {model.sampling_time:.6g} s",
        format_equation(model),
        "",
        *format_table(["coefficient", "value", "std"], rows),
        "",
        f"poles: {_numbers(model.poles)}",
        *(f"zeros from {n}: {_numbers(model.zeros(n))}; steady-state gain {model.gain(n):.6g}" for n in model.inputs),
        f"noise: {model.noise_std:.4g} {unit}".rstrip() + f" one step ahead, over {model.samples} equations",
        f"digits: at least {count_digits_needed(model)} keep its stability and its response within 1 %",
    ]
    if model.history:
        lines.append(f"rows: {model.history} history; focus: {model.focus}")
    return "\n".join([*lines, *(f"note: {note}" for note in model.notes)])


def format_equation(model: PolynomialModel) -> str:
    """The difference equation with its polynomials' letters: ``A(q) y = B(q) / F(q) u + C(q) e``."""
    left = f"{'A(q) ' if len(model.a) > 1 else ''}{model.output}(k)"
    several = len(model.inputs) > 1
    terms = []
    for i, (name, f) in enumerate(zip(model.inputs, model.f, strict=True), 1):
        mark = str(i) if several else ""
        terms.append(f"B{mark}(q)" + (f" / F{mark}(q)" if len(f) > 1 else "") + f" {name}(k)")
    if model.constant is not None:
        terms.append("constant")
    shape = ("C(q)" if len(model.c) > 1 else "") + (
        f"{'' if len(model.c) > 1 else '1'} / D(q)" if len(model.d) > 1 else ""
    )
    return f"{left} = {' + '.join([*terms, f'{shape} e(k)'.strip()])}"


def _numbers(values: np.ndarray) -> str:
    if not len(values):
        return "none"
    said = [f"{v.real:.6g}" if abs(v.imag) < 1e-12 else f"{v.real:.6g}{v.imag:+.6g}j" for v in values]
    return ", ".join(said)


def describe_nonlinearity(name: str, curve: StaticNonlinearity, units: Mapping[str, str]) -> str:
    """A static curve as a few of its points."""
    points = np.linspace(-curve.size, curve.size, CURVE_POINTS)
    unit = units.get(name, "")
    said = ", ".join(f"{u:.3g} -> {v:.4g}" for u, v in zip(points, curve(points), strict=True))
    return f"curve of {name}{f' [{unit}]' if unit else ''}: {said}"
