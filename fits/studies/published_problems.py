"""Published problems with known optima: does a fit from the published starts, and from random ones, end where the literature says?

    python -m fits.studies.published_problems [--random N] [--page FOLDER]

- Nonlinear regressions of the Statistical Reference Datasets (NIST/ITL StRD, certified optima and two starts each): a function of an input.
- Kinetics: isomerisation of alpha-pinene, five reactions (Box, Hunter, MacGregor and Erjavec, Technometrics 15, 1973), pyrolysis of oil
  shale and others with the optima of the COPS collection (Dolan, More and Munson, 2004).

For each problem: the optimum from each published start, the share of N random starts (each constant between a tenth and ten times its
certified value, of the same sign) that end there, and the standard errors beside those of an independent least-squares solver at the
certified optimum.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

import greybox as gb
from fits.papers.paper_page import write_section

Formula = Callable[[Any, Sequence[Any]], Any]


@dataclass(frozen=True)
class Regression:
    """A function of ``x`` with constants ``b``, its data, starts, certified constants and sum of squares."""

    formula: Formula
    x: np.ndarray
    y: np.ndarray
    starts: tuple[tuple[float, ...], ...]
    optimum: tuple[float, ...]
    squares: float

    def model(self) -> gb.Model:
        """The function as a model: what it is a function of is an input, and nothing moves by itself."""
        names = self.names
        parameters = [gb.Parameter(name, "1", value) for name, value in zip(names, self.starts[0], strict=True)]
        return gb.Model(
            "regression",
            states=[gb.State("s", "1")],  # a model has a state: this one rests, and nothing depends on it
            inputs=[gb.Input("x", "1")],
            outputs=[gb.Output("y", "1", lambda x, u, p: self.formula(u.x, [getattr(p, n) for n in names]))],
            parameters=parameters,
            balances=lambda x, u, p: [gb.Balance("rest", "1", 1, "s", decay=-x.s)],
        )

    def record(self) -> gb.Experiment:
        """The data, a row a second."""
        t = np.arange(len(self.x), dtype=float)
        return gb.Experiment("data", t, {"x": self.x}, {"y": self.y})

    @property
    def names(self) -> list[str]:
        """Of the constants."""
        return [f"b{k + 1}" for k in range(len(self.optimum))]

    def residual(self, constants: Sequence[float]) -> np.ndarray:
        """The function less the data."""
        return np.asarray(self.formula(self.x, list(constants)), float) - self.y


def _rational(x: Any, b: Sequence[Any]) -> Any:
    return (b[0] + b[1] * x + b[2] * x**2 + b[3] * x**3) / (1 + b[4] * x + b[5] * x**2 + b[6] * x**3)


def exp(value: Any) -> Any:
    """Of symbols and of numbers."""
    return np.exp(value) if isinstance(value, (np.ndarray, float)) else ca.exp(value)


def atan(value: Any) -> Any:
    """Of symbols and of numbers."""
    return np.arctan(value) if isinstance(value, (np.ndarray, float)) else ca.atan(value)


def _numbers(text: str) -> np.ndarray:
    return np.array(text.split(), float)


MISRA_X = _numbers("77.6 114.9 141.1 190.8 239.9 289.0 332.8 378.4 434.8 477.3 536.8 593.1 689.1 760.0")
MISRA_Y = _numbers("10.07 14.73 17.94 23.93 29.61 35.18 40.02 44.82 50.76 55.05 61.01 66.40 75.47 81.78")

REGRESSIONS: dict[str, Regression] = {
    "Misra1a": Regression(
        lambda x, b: b[0] * (1 - exp(-b[1] * x)),
        MISRA_X,
        MISRA_Y,
        ((500.0, 1e-4), (250.0, 5e-4)),
        (2.3894212918e02, 5.5015643181e-04),
        1.2455138894e-01,
    ),
    "Misra1d": Regression(
        lambda x, b: b[0] * b[1] * x / (1 + b[1] * x),
        MISRA_X,
        MISRA_Y,
        ((500.0, 1e-4), (450.0, 3e-4)),
        (4.3736970754e02, 3.0227324449e-04),
        5.6419295283e-02,
    ),
    "Lanczos1": Regression(
        lambda x, b: b[0] * exp(-b[1] * x) + b[2] * exp(-b[3] * x) + b[4] * exp(-b[5] * x),
        0.05 * np.arange(24),
        _numbers(
            "2.5134 2.044333373291 1.668404436564 1.366418021208 1.123232487372 0.9268897180037 0.7679338563728 0.6388775523106"
            " 0.5337835317402 0.4479363617347 0.377584788435 0.3197393199326 0.2720130773746 0.2324965529032 0.1996589546065"
            " 0.1722704126914 0.1493405660168 0.1300700206922 0.1138119324644 0.1000415587559 0.0883320908454 0.0783354401935"
            " 0.06976693743449 0.06239312536719"
        ),
        ((1.2, 0.3, 5.6, 5.5, 6.5, 7.6), (0.5, 0.7, 3.6, 4.2, 4.0, 6.3)),
        (9.5100000027e-02, 1.0000000001, 8.6070000013e-01, 3.0000000002, 1.5575999998, 5.0000000001),
        1.4307867721e-25,
    ),
    "Rat42": Regression(
        lambda x, b: b[0] / (1 + exp(b[1] - b[2] * x)),
        _numbers("9 14 21 28 42 57 63 70 79"),
        _numbers("8.93 10.8 18.59 22.33 39.35 56.11 61.73 64.62 67.08"),
        ((100.0, 1.0, 0.1), (75.0, 2.5, 0.07)),
        (7.2462237576e01, 2.6180768402, 6.7359200066e-02),
        8.0565229338,
    ),
    "Rat43": Regression(
        lambda x, b: b[0] / (1 + exp(b[1] - b[2] * x)) ** (1 / b[3]),
        np.arange(1.0, 16.0),
        _numbers(
            "16.08 33.83 65.80 97.20 191.55 326.20 386.87 520.53 590.03 651.92 724.93 699.56 689.96 637.56 717.41"
        ),
        ((100.0, 10.0, 1.0, 1.0), (700.0, 5.0, 0.75, 1.3)),
        (6.9964151270e02, 5.2771253025, 7.5962938329e-01, 1.2792483859),
        8.7864049080e03,
    ),
    "MGH10": Regression(
        lambda x, b: b[0] * exp(b[1] / (x + b[2])),
        np.arange(50.0, 126.0, 5.0),
        _numbers("34780 28610 23650 19630 16370 13720 11540 9744 8261 7030 6005 5147 4427 3820 3307 2872"),
        ((2.0, 400000.0, 25000.0), (0.02, 4000.0, 250.0)),
        (5.6096364710e-03, 6.1813463463e03, 3.4522363462e02),
        8.7945855171e01,
    ),
    "BoxBOD": Regression(
        lambda x, b: b[0] * (1 - exp(-b[1] * x)),
        _numbers("1 2 3 5 7 10"),
        _numbers("109 149 149 191 213 224"),
        ((1.0, 1.0), (100.0, 0.75)),
        (2.1380940889e02, 5.4723748542e-01),
        1.1680088766e03,
    ),
    "MGH17": Regression(
        lambda x, b: b[0] + b[1] * exp(-x * b[3]) + b[2] * exp(-x * b[4]),
        10.0 * np.arange(33),
        _numbers(
            "0.844 0.908 0.932 0.936 0.925 0.908 0.881 0.850 0.818 0.784 0.751 0.718 0.685 0.658 0.628 0.603 0.580 0.558 0.538"
            " 0.522 0.506 0.490 0.478 0.467 0.457 0.448 0.438 0.431 0.424 0.420 0.414 0.411 0.406"
        ),
        ((50.0, 150.0, -100.0, 1.0, 2.0), (0.5, 1.5, -1.0, 0.01, 0.02)),
        (3.7541005211e-01, 1.9358469127, -1.4646871366, 1.2867534640e-02, 2.2122699662e-02),
        5.4648946975e-05,
    ),
    "MGH09": Regression(
        lambda x, b: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
        _numbers("4 2 1 0.5 0.25 0.167 0.125 0.1 0.0833 0.0714 0.0625"),
        _numbers("0.1957 0.1947 0.1735 0.16 0.0844 0.0627 0.0456 0.0342 0.0323 0.0235 0.0246"),
        ((25.0, 39.0, 41.5, 39.0), (0.25, 0.39, 0.415, 0.39)),
        (1.9280693458e-01, 1.9128232873e-01, 1.2305650693e-01, 1.3606233068e-01),
        3.0750560385e-04,
    ),
    "Thurber": Regression(
        _rational,
        _numbers(
            "-3.067 -2.981 -2.921 -2.912 -2.840 -2.797 -2.702 -2.699 -2.633 -2.481 -2.363 -2.322 -1.501 -1.460 -1.274 -1.212"
            " -1.100 -1.046 -0.915 -0.714 -0.566 -0.545 -0.400 -0.309 -0.109 -0.103 0.010 0.119 0.377 0.790 0.963 1.006 1.115"
            " 1.572 1.841 2.047 2.200"
        ),
        _numbers(
            "80.574 84.248 87.264 87.195 89.076 89.608 89.868 90.101 92.405 95.854 100.696 101.060 401.672 390.724 567.534"
            " 635.316 733.054 759.087 894.206 990.785 1090.109 1080.914 1122.643 1178.351 1260.531 1273.514 1288.339 1327.543"
            " 1353.863 1414.509 1425.208 1421.384 1442.962 1464.350 1468.705 1447.894 1457.628"
        ),
        ((1000.0, 1000.0, 400.0, 40.0, 0.7, 0.3, 0.03), (1300.0, 1500.0, 500.0, 75.0, 1.0, 0.4, 0.05)),
        (
            1.2881396800e03,
            1.4910792535e03,
            5.8323836877e02,
            7.5416644291e01,
            9.6629502864e-01,
            3.9797285797e-01,
            4.9727297349e-02,
        ),
        5.6427082397e03,
    ),
    "Eckerle4": Regression(
        lambda x, b: b[0] / b[1] * exp(-0.5 * ((x - b[2]) / b[1]) ** 2),
        _numbers(
            "400 405 410 415 420 425 430 435 436.5 438 439.5 441 442.5 444 445.5 447 448.5 450 451.5 453 454.5 456 457.5 459"
            " 460.5 462 463.5 465 470 475 480 485 490 495 500"
        ),
        _numbers(
            "0.0001575 0.0001699 0.0002350 0.0003102 0.0004917 0.0008710 0.0017418 0.0046400 0.0065895 0.0097302 0.0149002"
            " 0.0237310 0.0401683 0.0712559 0.1264458 0.2073413 0.2902366 0.3445623 0.3698049 0.3668534 0.3106727 0.2078154"
            " 0.1164354 0.0616764 0.0337200 0.0194023 0.0117831 0.0074357 0.0022732 0.0008800 0.0004579 0.0002345 0.0001586"
            " 0.0001143 0.0000710"
        ),
        ((1.0, 10.0, 500.0), (1.5, 5.0, 450.0)),
        (1.5543827178, 4.0888321754, 4.5154121844e02),
        1.4635887487e-03,
    ),
    "Roszman1": Regression(
        lambda x, b: b[0] - b[1] * x - atan(b[2] / (x - b[3])) / math.pi,
        _numbers(
            "-4868.68 -4868.09 -4867.41 -3375.19 -3373.14 -3372.03 -2473.74 -2472.35 -2469.45 -1894.65 -1893.40 -1497.24"
            " -1495.85 -1493.41 -1208.68 -1206.18 -1206.04 -997.92 -996.61 -996.31 -834.94 -834.66 -710.03 -530.16 -464.17"
        ),
        _numbers(
            "0.252429 0.252141 0.251809 0.297989 0.296257 0.295319 0.339603 0.337731 0.333820 0.389510 0.386998 0.438864"
            " 0.434887 0.427893 0.471568 0.461699 0.461144 0.513532 0.506641 0.505062 0.535648 0.533726 0.568064 0.612886"
            " 0.624169"
        ),
        ((0.1, -1e-5, 1000.0, -100.0), (0.2, -5e-6, 1200.0, -150.0)),
        (2.0196866396e-01, -6.1953516256e-06, 1.2044556708e03, -1.8134269537e02),
        4.9484847331e-04,
    ),
}


Rates = Callable[[Any, Any], Mapping[str, Any]]


@dataclass(frozen=True)
class Kinetics:
    """Rates of states with constants, their known beginning, measured states, starts, published constants and sum of squares."""

    rates: Rates
    beginning: Mapping[str, float]
    time: np.ndarray
    measured: Mapping[str, np.ndarray]
    starts: tuple[tuple[float, ...], ...]
    optimum: tuple[float, ...]
    squares: float
    positive: bool = False

    @property
    def names(self) -> list[str]:
        """Of the constants."""
        return [f"k{k + 1}" for k in range(len(self.optimum))]

    def model(self) -> gb.Model:
        """The rates as balances of plain numbers."""
        bounds = (0.0, np.inf) if self.positive else (-np.inf, np.inf)
        return gb.Model(
            "kinetics",
            states=[gb.State(name, "1", start) for name, start in self.beginning.items()],
            inputs=[],
            outputs=[gb.Output(name, "1") for name in self.measured],
            parameters=[gb.Parameter(n, "1", v, bounds) for n, v in zip(self.names, self.starts[0], strict=True)],
            balances=lambda x, u, p: [
                gb.Balance(name, "1", 1, name, reactions=rate) for name, rate in self.rates(x, p).items()
            ],
        )

    def record(self) -> gb.Experiment:
        """The data behind a row at time zero in which nothing was measured."""
        outputs = {name: np.array([np.nan, *values]) for name, values in self.measured.items()}
        return gb.Experiment("data", np.array([0.0, *self.time]), {}, outputs)

    def residual(self, constants: Sequence[float]) -> np.ndarray:
        """Simulated less measured, by an independent solver."""
        names = list(self.beginning)

        def slope(_: float, y: np.ndarray) -> list[float]:
            rates = self.rates(
                SimpleNamespace(**dict(zip(names, y, strict=True))),
                SimpleNamespace(**dict(zip(self.names, constants, strict=True))),
            )
            return [float(rates[name]) for name in names]

        span, start = (0.0, float(self.time[-1])), list(self.beginning.values())
        run = solve_ivp(slope, span, start, "LSODA", self.time, rtol=1e-10, atol=1e-12)
        return np.concatenate([run.y[names.index(n)] - values for n, values in self.measured.items()])


def _pinene(x: Any, p: Any) -> Mapping[str, Any]:
    back = p.k5 * x.y5
    return {
        "y1": -(p.k1 + p.k2) * x.y1,
        "y2": p.k1 * x.y1,
        "y3": p.k2 * x.y1 - (p.k3 + p.k4) * x.y3 + back,
        "y4": p.k3 * x.y3,
        "y5": p.k4 * x.y3 - back,
    }


def _methanol(x: Any, p: Any) -> Mapping[str, Any]:
    rate = p.k1 * x.y1 / ((p.k2 + p.k5) * x.y1 + x.y2)
    return {
        "y1": -2 * p.k1 * x.y1 + rate * x.y2 - (p.k3 + p.k4) * x.y1,
        "y2": rate * (p.k2 * x.y1 - x.y2) + p.k3 * x.y1,
        "y3": rate * (x.y2 + p.k5 * x.y1) + p.k4 * x.y1,
    }


KINETICS: dict[str, Kinetics] = {
    # Box, Hunter, MacGregor and Erjavec, Technometrics 15, 1973; minutes and per cent.
    "alpha-pinene": Kinetics(
        _pinene,
        {"y1": 100.0, "y2": 0.0, "y3": 0.0, "y4": 0.0, "y5": 0.0},
        _numbers("1230 3060 4920 7800 10680 15030 22620 36420"),
        {
            "y1": _numbers("88.35 76.4 65.1 50.4 37.5 25.9 14.0 4.5"),
            "y2": _numbers("7.3 15.6 23.1 32.9 42.7 49.1 57.4 63.1"),
            "y3": _numbers("2.3 4.5 5.3 6.0 6.0 5.9 5.1 3.8"),
            "y4": _numbers("0.4 0.7 1.1 1.5 1.9 2.2 2.6 2.9"),
            "y5": _numbers("1.75 2.8 5.8 9.3 12.0 17.0 21.0 25.7"),
        },
        ((5.84e-5, 2.65e-5, 1.63e-5, 27.77e-5, 4.61e-5), (1e-5, 1e-5, 1e-5, 1e-4, 1e-5)),
        (5.9258e-05, 2.9634e-05, 2.0473e-05, 2.7447e-04, 3.9980e-05),
        19.872,
    ),
    # Bellman, Jacquez, Kalaba and Schwimmer, Mathematical Biosciences 1, 1967: NO and oxygen.
    "nitric oxide": Kinetics(
        lambda x, p: {"y": p.k1 * (126.2 - x.y) * (91.9 - x.y) ** 2 - p.k2 * x.y**2},
        {"y": 0.0},
        _numbers("1 2 3 4 5 6 7 9 11 14 19 24 29 39"),
        {"y": _numbers("1.4 6.3 10.5 14.2 17.6 21.4 23.0 27.0 30.5 34.4 38.8 41.6 43.5 45.3")},
        ((1e-6, 1e-6), (1e-5, 1e-4)),
        (4.577e-6, 2.797e-4),
        21.867,
    ),
    # Tjoa and Biegler, Industrial and Engineering Chemistry Research 30, 1991; optimum of COPS 3.
    "gas oil": Kinetics(
        lambda x, p: {"y1": -(p.k1 + p.k3) * x.y1**2, "y2": p.k1 * x.y1**2 - p.k2 * x.y2},
        {"y1": 1.0, "y2": 0.0},
        _numbers("0.025 0.05 0.075 0.1 0.125 0.15 0.175 0.2 0.225 0.25 0.3 0.35 0.4 0.45 0.5 0.55 0.65 0.75 0.85 0.95"),
        {
            "y1": _numbers(
                "0.8105 0.6208 0.5258 0.4345 0.3903 0.3342 0.3034 0.2735 0.2405 0.2283 0.2071 0.1669 0.1530 0.1339 0.1265"
                " 0.1200 0.0990 0.0870 0.0770 0.0690"
            ),
            "y2": _numbers(
                "0.2 0.2886 0.3010 0.3215 0.3123 0.2716 0.2551 0.2258 0.1959 0.1789 0.1457 0.1198 0.0909 0.0719 0.0561"
                " 0.0460 0.0280 0.0190 0.0140 0.0100"
            ),
        },
        ((1.0, 1.0, 1.0), (0.0, 0.0, 0.0)),
        (11.8468, 8.34458, 1.00135),
        5.23659e-03,
    ),
    # Maria, Chemical Engineering Science 44, 1989: methanol to hydrocarbons; three rates are nothing.
    "methanol": Kinetics(
        _methanol,
        {"y1": 1.0, "y2": 0.0, "y3": 0.0},
        _numbers("0.050 0.065 0.080 0.123 0.233 0.273 0.354 0.397 0.418 0.502 0.553 0.681 0.750 0.916 0.937 1.122"),
        {
            "y1": _numbers(
                "0.461 0.426 0.383 0.305 0.195 0.170 0.139 0.112 0.112 0.090 0.082 0.066 0.053 0.043 0.041 0.029"
            ),
            "y2": _numbers(
                "0.114 0.135 0.157 0.194 0.231 0.234 0.228 0.228 0.226 0.220 0.214 0.178 0.188 0.183 0.184 0.166"
            ),
            "y3": _numbers(
                "0.018 0.035 0.045 0.047 0.084 0.095 0.111 0.134 0.168 0.148 0.157 0.206 0.206 0.214 0.213 0.230"
            ),
        },
        ((1.0, 1.0, 1.0, 1.0, 1.0), (2.69, 0.5, 3.02, 0.5, 0.5)),
        (5.2407, 1.2176, 0.0, 0.0, 0.0),
        0.10693056,
        positive=True,
    ),
    # Tjoa and Biegler, 1991: two reactions in a row, rounded to three digits.
    "chain": Kinetics(
        lambda x, p: {"y1": -p.k1 * x.y1, "y2": p.k1 * x.y1 - p.k2 * x.y2},
        {"y1": 1.0, "y2": 0.0},
        0.1 * np.arange(1.0, 11.0),
        {
            "y1": _numbers("0.606 0.368 0.223 0.135 0.082 0.050 0.030 0.018 0.011 0.007"),
            "y2": _numbers("0.373 0.564 0.647 0.669 0.656 0.624 0.583 0.539 0.494 0.451"),
        },
        ((1.0, 1.0), (10.0, 10.0)),
        (5.00349, 1.0),
        1.18584e-06,
    ),
}

Problem = Regression | Kinetics
PROBLEMS: dict[str, Problem] = {**REGRESSIONS, **KINETICS}

# Sum of squares over the published one up to which a fit ended there: three digits.
SAME_SQUARES = 1.001
# Of a problem without noise the published sum is rounding: there the sum itself must be.
EXACT_SQUARES = 1e-15


@dataclass(frozen=True)
class Ended:
    """Where one fit ended: at the published optimum or not, its sum of squares over that, greatest error of a standard error."""

    reached: bool
    ratio: float
    standard_error: float
    status: str
    warned: bool


# Steps that a search may take where the usual limit ends it: the curved valley of MGH10 takes Levenberg and Marquardt hundreds.
ITERATIONS = {"MGH10": 3000}


def fit_from(name: str, start: Sequence[float]) -> Ended:
    """Fit a problem from ``start``; every record begins as declared."""
    problem = PROBLEMS[name]
    model = problem.model().start(**dict(zip(problem.names, start, strict=True)))
    options = gb.FitOptions(at_rest=True, common_noise=True)
    if name in ITERATIONS:
        options = replace(options, iterations=ITERATIONS[name])
    found = gb.fit(model, problem.record(), options=options)
    constants = [found.parameters[n].value for n in problem.names]
    ratio = float(np.sum(problem.residual(constants) ** 2)) / problem.squares
    has_noise = problem.squares > EXACT_SQUARES
    reached = ratio < SAME_SQUARES if has_noise else ratio * problem.squares < EXACT_SQUARES
    errors = compute_standard_errors(problem)
    fitted = np.array([found.parameters[n].std or np.nan for n in problem.names])
    error = float(np.nanmax(np.abs(fitted / errors - 1), initial=0.0)) if reached and has_noise else np.nan
    warned = not found.success or any(f.severity != "note" for f in found.findings)
    return Ended(reached, ratio, error, str(found.status), warned)


def compute_standard_errors(problem: Problem) -> np.ndarray:
    """Those of least squares at the published optimum, by central differences of an independent run; NaN of a constant that is nothing."""
    best = np.array(problem.optimum)
    moving = np.flatnonzero(best)
    slopes = []
    for k in moving:
        step = 1e-5 * abs(best[k])
        ends = [problem.residual(best + sign * step * np.eye(len(best))[k]) for sign in (1, -1)]
        slopes.append((ends[0] - ends[1]) / (2 * step))
    slope = np.array(slopes).T
    variance = np.sum(problem.residual(best) ** 2) / (len(slope) - len(best))
    errors = np.full(len(best), np.nan)
    errors[moving] = np.sqrt(variance * np.diag(np.linalg.inv(slope.T @ slope)))
    return errors


def draw_start(problem: Problem, generator: np.random.Generator) -> list[float]:
    """Each constant between a tenth and ten times its published value (of one that is nothing, between 0.1 and 10)."""
    factors = 10 ** generator.uniform(-1, 1, len(problem.optimum))
    return [factor * (value or 1.0) for factor, value in zip(factors, problem.optimum, strict=True)]


def study(name: str, random: int) -> dict[str, Any]:
    """One line of the table."""
    problem, generator = PROBLEMS[name], np.random.default_rng(1)
    published = [fit_from(name, start) for start in problem.starts]
    drawn = [fit_from(name, draw_start(problem, generator)) for _ in range(random)]
    missed = [e for e in (*published, *drawn) if not e.reached]
    return {
        "problem": name,
        "published": f"{sum(e.reached for e in published)} of {len(published)}",
        "random": f"{sum(e.reached for e in drawn)} of {len(drawn)}",
        "standard_error": max((e.standard_error for e in published if e.reached), default=math.nan),
        "missed_without_a_word": sum(not e.warned for e in missed),
        "missed": [
            f"{e.status}, {e.ratio:.3g} times"
            if problem.squares > EXACT_SQUARES
            else f"{e.status}, a sum of {e.ratio * problem.squares:.2g}"
            for e in missed
        ],
    }


# The page of published problems, whose other part `fits.studies.published_networks` writes.
PAGE, HEAD = (
    "published_problems.md",
    "# Published problems\n\nHow often a fit reaches the published answer: regressions, reaction mechanisms, networks and stiff models.\n",
)
PART = """## Regressions and reaction mechanisms

Written by `python -m fits.studies.published_problems --page docs/studies`. {regressions} nonlinear regressions of the
Statistical Reference Datasets (NIST/ITL StRD) and {kinetics} reaction mechanisms (alpha-pinene: Box and others, Technometrics 15,
1973; nitric oxide: Bellman and others, Mathematical Biosciences 1, 1967; gas oil and chain: Tjoa and Biegler, Industrial and
Engineering Chemistry Research 30, 1991, the first with the optimum of COPS 3; methanol: Maria, Chemical Engineering Science 44,
1989). Every fit is `gb.fit(model, data, options=gb.FitOptions(at_rest=True, common_noise=True))`, a plain sum of squares of all
outputs; of MGH10 with `iterations={iterations}`.

- A fit has *reached* the optimum where its sum of squares is within 0.1 % of the published one.
- *Published starts*: the one or two that the source gives. *Random starts*: each constant between a tenth and ten times its
  published value.
- *Standard errors*: the largest difference from those of linear regression at the published optimum.
- *Missed*: how the fits ended that did not reach it, and their sum of squares over the published one.

From the published starts {published} fits reach the optimum, from random ones {random}.

| problem | published starts | random starts | standard errors differ by | missed |
|---|---|---|---|---|
{rows}

A fit that explains nothing of an output, ends at its iteration limit, or where a constant ran away is begun from other starts by itself,
and says so. Missed: Thurber and Roszman1, quotients with poles, have optima of their own; the first published start of MGH17 is ninety
times off in two rates, and its fit follows 85 % of the curve, so that no other start is tried.
"""


def add_up(shares: Sequence[str]) -> str:
    """``2 of 2`` and ``1 of 2`` together."""
    reached, tried = (sum(int(share.split()[k]) for share in shares) for k in (0, 2))
    return f"{reached} of {tried}"


def write_row(line: Mapping[str, Any]) -> str:
    """A line of the table."""
    error = f"{100 * line['standard_error']:.2g} %" if math.isfinite(line["standard_error"]) else ""
    counts: dict[str, int] = {}
    for text in line["missed"]:
        counts[text] = counts.get(text, 0) + 1
    missed = "; ".join(text if n == 1 else f"{text} ({n})" for text, n in counts.items())
    return f"| {line['problem']} | {line['published']} | {line['random']} | {error} | {missed} |"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Published problems with known optima.")
    parser.add_argument("--random", type=int, default=10, help="number of random starts")
    parser.add_argument("--page", type=Path, help="folder of the page for the table")
    given = parser.parse_args(arguments)
    lines = []
    for name in PROBLEMS:
        lines.append(study(name, given.random))
        sys.stdout.write(write_row(lines[-1]) + "\n")
        sys.stdout.flush()
    published, drawn = (add_up([line[key] for line in lines]) for key in ("published", "random"))
    rows = "\n".join(map(write_row, lines))
    counts = {"regressions": len(REGRESSIONS), "kinetics": len(KINETICS), "iterations": ITERATIONS["MGH10"]}
    if given.page:
        text = PART.format(published=published, random=drawn, rows=rows, **counts)
        write_section(given.page, "1 regressions", text, PAGE, HEAD)


if __name__ == "__main__":
    main()
