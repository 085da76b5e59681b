"""Filters of our own give what scipy's give; a discovery needs no part of scipy that is slow to import."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy import signal
from scipy.ndimage import uniform_filter1d

from greybox.data.noise.noise_model import AutoRegression
from greybox.discovery.localisation import estimate_power_density
from greybox.estimation.parameter_constancy import compute_running_mean

SLOW = {"scipy.signal", "scipy.stats", "scipy.optimize", "scipy.ndimage", "pandas", "control", "matplotlib.pyplot"}
NEEDED = (
    "greybox.shell.commands, greybox.discovery.pipeline, greybox.extensions.export, greybox.show.figures.discovery,"
    " greybox.show.documents.discovery"
)


@pytest.mark.parametrize(("rows", "length"), [(1000, 512), (1000, 255), (3000, 512), (9, 8), (13, 13)])
def test_a_power_density_is_that_of_scipy(rows: int, length: int) -> None:
    values = 0.3 + np.random.default_rng(rows).normal(size=rows)
    frequency, power = signal.welch(values, 50.0, nperseg=length, detrend=False)
    assert estimate_power_density(values, 0.02, length) == pytest.approx(power, rel=1e-12)
    assert np.fft.rfftfreq(length, 0.02) == pytest.approx(frequency)


@pytest.mark.parametrize("width", [1, 2, 7, 40, 299, 300])
def test_a_running_mean_is_that_of_scipy(width: int) -> None:
    values = np.random.default_rng(width).normal(size=300)
    assert compute_running_mean(values, width) == pytest.approx(
        uniform_filter1d(values, width, mode="nearest"), abs=1e-12
    )


@pytest.mark.parametrize("reflection", [(0.9,), (0.99, -0.5, 0.3), (0.999, -0.9, 0.8, 0.2, -0.3, 0.1, 0.05)])
def test_correlations_of_coloured_noise_go_on_as_a_filter_does(reflection: tuple[float, ...]) -> None:
    colour = AutoRegression(reflection)
    denominator = np.append(1.0, -colour.coefficients)
    first = colour.autocorrelation(colour.order + 1)
    memory = signal.lfiltic([1.0], denominator, first[::-1][: colour.order])
    rest, _ = signal.lfilter([1.0], denominator, np.zeros(5000), zi=memory)
    assert colour.autocorrelation(5000 + len(first)) == pytest.approx(np.append(first, rest), abs=1e-12)


@pytest.mark.rest
def test_a_discovery_loads_nothing_that_is_slow_to_import() -> None:
    code = f"import sys, {NEEDED}; print(sorted({SLOW} & set(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
