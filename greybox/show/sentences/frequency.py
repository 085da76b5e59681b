"""Frequency responses, their fits, and best linear approximations in plain text."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from greybox.show.sentences.registry import register, renders

if TYPE_CHECKING:
    from greybox.base.findings import Check
    from greybox.comparison.frequency.best_linear_approximation import BestLinearApproximation
    from greybox.comparison.frequency.response import FrequencyResponse

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
    return (
        f"{response.name}: {response.points} points from {low:.4g} to {high:.4g} Hz, {', '.join(response.inputs)} to"
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
