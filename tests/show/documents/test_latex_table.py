"""The table of constants for a paper: what its numbers say is what the fit holds."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

import greybox as gb
from greybox.show.documents.tables import parameters_latex
from tests.support.pushed_mass import MASS, record


def numbers(cell: str) -> list[float]:
    """Every number of a cell, with the power of ten behind it."""
    power = re.search(r"\\times 10\^{(-?\d+)}", cell)
    scale = 10.0 ** int(power[1]) if power else 1.0
    return [scale * float(each) for each in re.findall(r"-?\d+\.?\d*", cell.partition(r"\times")[0])]


@pytest.fixture(scope="module")
def fit() -> gb.Fit:
    return gb.fit(MASS, record(1))


@pytest.mark.parametrize("size", [1e-9, 1e-3, 1.0, -1e3, 1e9])
def test_values_deviations_and_intervals_are_those_of_the_fit(fit: gb.Fit, size: float) -> None:
    scaled = {
        name: replace(e, value=e.value * size, std=e.std and abs(e.std * size), interval=e.interval and ends(e, size))
        for name, e in fit.parameters.items()
    }
    text = parameters_latex(replace(fit, parameters=type(fit.parameters)(scaled)))
    rows = [line for line in text.splitlines() if "&" in line][1:]
    assert len(rows) == len(scaled) == 3
    for row, e in zip(rows, scaled.values(), strict=True):
        _, value, interval, _ = row.removesuffix(r" \\").split(" & ")
        if e.fixed:
            assert interval == "known" and numbers(value) == pytest.approx([e.value], rel=1e-3)
        else:
            assert numbers(value) == pytest.approx([e.value, e.std], abs=0.06 * e.std)
            assert numbers(interval) == pytest.approx(e.interval, abs=0.06 * e.std)
    assert r"$\mathrm{N\,s/m}$" in text
    assert text.count("{") == text.count("}") and text.count("$") % 2 == 0


def ends(e, size: float) -> tuple[float, float]:
    low, high = sorted(end * size for end in e.interval)
    return low, high
