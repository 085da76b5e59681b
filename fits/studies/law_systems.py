"""Systems of ordinary differential equations that others published, as terms and constants.

Each line is an equation: the state, then its terms. A number in braces is a constant that the study does not know to better than 40 %; the
others (exponents, factors of two) belong to the form of the law. Two first states and a duration follow. The systems are those of textbooks
and papers on dynamics (S. Strogatz, Nonlinear Dynamics and Chaos; J. Murray, Mathematical Biology; lists of test problems for equation
discovery such as ODEBench state most of them); of systems that are chaotic the duration is a few turns, so that one run is like the next.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class PublishedSystem:
    """One system: state -> its terms, the first states of the record to learn from and of the one to judge by, seconds."""

    name: str
    equations: dict[str, tuple[str, ...]]
    starts: tuple[tuple[float, ...], tuple[float, ...]]
    duration: float


def _system(name: str, duration: float, starts: tuple, **equations: str) -> PublishedSystem:
    terms = {state: tuple(t.strip() for t in text.split(";")) for state, text in equations.items()}
    pairs = tuple(tuple(np.atleast_1d(s).astype(float).tolist()) for s in starts)
    return PublishedSystem(name, terms, pairs, duration)


SYSTEMS = (
    # One state.
    _system("charging_with_leak", 8, (0.2, 5.0), x="{2.0}; -{0.8}*x"),
    _system("logistic_growth", 8, (0.3, 14.0), x="{0.9}*x; -{0.09}*x**2"),
    _system("weak_allee_effect", 8, (1.6, 9.0), x="-{0.5}*x; {0.4}*x**2; -{0.04}*x**3"),
    _system("gompertz_tumour", 10, (0.3, 6.0), x="{1.2}*x; -{0.7}*x*log(1 + x)"),
    _system("harvest_with_saturation", 10, (2.0, 0.9), x="{0.8}*x; -{0.2}*x**2; -{0.6}*x/({0.5} + x)"),
    _system("spruce_budworm", 10, (0.5, 6.0), x="{0.8}*x; -{0.08}*x**2; -{1.3}*x**2/({1.1}**2 + x**2)"),
    _system("fall_with_drag", 4, (0.0, 12.0), x="{9.8}; -{0.12}*abs(x)*x"),
    _system("torricelli_tank", 12, (0.2, 5.0), x="{0.6}; -{0.5}*sqrt(x)"),
    _system("landau_amplitude", 6, (0.2, 2.5), x="{0.9}*x; -{0.5}*x**3"),
    _system("subcritical_pitchfork", 6, (0.7, 1.9), x="-{0.5}*x; {1.6}*x**3; -{0.6}*x**5"),
    _system("overdamped_pendulum", 6, (0.3, -2.0), x="{0.4}; -{1.1}*sin(x)"),
    _system("gene_with_feedback", 10, (0.2, 3.0), x="{0.1}; -{0.6}*x; {1.8}*x**2/({1.0}**2 + x**2)"),
    _system("laser_threshold", 6, (0.2, 3.0), x="{1.5}*x; -{0.7}*x**2"),
    _system("autocatalysis", 6, (0.3, 4.0), x="{1.8}*x; -{0.6}*x**2"),
    # Two states.
    _system("lotka_volterra", 12, ((3.0, 1.0), (1.5, 2.5)), x="{1.0}*x; -{0.6}*x*y", y="-{1.0}*y; {0.4}*x*y"),
    _system(
        "competing_species",
        12,
        ((0.5, 1.2), (2.5, 0.4)),
        x="{1.0}*x; -{0.4}*x**2; -{0.3}*x*y",
        y="{0.8}*y; -{0.3}*y**2; -{0.35}*x*y",
    ),
    _system(
        "rosenzweig_macarthur",
        16,
        ((2.0, 0.6), (4.0, 1.4)),
        x="{1.0}*x; -{0.15}*x**2; -{1.4}*x*y/({1.5} + x)",
        y="-{0.5}*y; {0.9}*x*y/({1.5} + x)",
    ),
    _system("van_der_pol", 14, ((1.0, 0.0), (-2.0, 1.5)), x="y", y="-{1.0}*x; {0.9}*y; -{0.9}*x**2*y"),
    _system("duffing", 14, ((1.6, 0.0), (-0.6, 1.4)), x="y", y="-{0.12}*y; -{0.8}*x; -{0.5}*x**3"),
    _system("double_well", 14, ((1.7, 0.2), (-0.4, 1.1)), x="y", y="-{0.2}*y; {1.0}*x; -{0.8}*x**3"),
    _system("damped_pendulum", 12, ((2.4, 0.0), (-1.0, 1.8)), x="y", y="-{0.15}*y; -{1.4}*sin(x)"),
    _system("pendulum_in_air", 12, ((2.2, 0.0), (-1.0, 2.0)), x="y", y="-{1.4}*sin(x); -{0.25}*abs(y)*y"),
    _system("bead_on_a_hoop", 14, ((1.2, 0.0), (-0.4, 0.9)), x="y", y="-{0.15}*y; -{1.0}*sin(x); {1.6}*sin(x)*cos(x)"),
    _system("reactor_sir", 18, ((4.0, 0.1), (2.5, 0.4)), x="-{0.4}*x*y", y="-{0.35}*y; {0.4}*x*y"),
    _system("sirs", 24, ((3.0, 0.1), (1.6, 0.9)), x="{0.5}; -{0.12}*x; -{0.4}*x*y", y="-{0.5}*y; {0.4}*x*y"),
    _system("brusselator", 16, ((1.0, 1.6), (2.2, 0.9)), x="{1.0}; -{3.4}*x; {1.0}*x**2*y", y="{2.4}*x; -{1.0}*x**2*y"),
    _system("schnakenberg", 16, ((0.8, 0.9), (1.6, 0.4)), x="{0.2}; -{1.0}*x; {1.0}*x**2*y", y="{0.8}; -{1.0}*x**2*y"),
    _system(
        "glycolysis",
        20,
        ((0.7, 1.6), (1.5, 0.8)),
        x="-{1.0}*x; {0.1}*y; {1.0}*x**2*y",
        y="{0.6}; -{0.1}*y; -{1.0}*x**2*y",
    ),
    _system(
        "fitzhugh_nagumo",
        30,
        ((-1.0, 0.4), (1.5, -0.4)),
        x="{0.5}; {1.0}*x; -{1.0}*y; -{0.33}*x**3",
        y="{0.06}; {0.08}*x; -{0.06}*y",
    ),
    _system(
        "toggle_switch",
        10,
        ((0.3, 2.0), (2.4, 0.6)),
        x="-{0.8}*x; {2.2}*(1/(1 + (y/{1.0})**2))",
        y="-{0.8}*y; {2.0}*(1/(1 + (x/{1.1})**2))",
    ),
    _system(
        "chemostat",
        14,
        ((1.6, 0.3), (0.5, 1.6)),
        x="{0.6}; -{0.3}*x; -{0.9}*x*y/({0.7} + x)",
        y="-{0.3}*y; {0.6}*x*y/({0.7} + x)",
    ),
    _system("rayleigh", 14, ((0.6, 0.0), (1.8, -1.0)), x="y", y="-{1.0}*x; {0.8}*y; -{0.4}*y**3"),
    _system(
        "two_species_mutualism",
        8,
        ((0.4, 0.6), (2.2, 0.5)),
        x="{0.8}*x; -{0.5}*x**2; {0.2}*x*y",
        y="{0.7}*y; -{0.5}*y**2; {0.15}*x*y",
    ),
    _system("two_tanks", 20, ((2.0, 0.3), (0.6, 2.4)), x="{0.3}; -{0.4}*sqrt(x)", y="{0.4}*sqrt(x); -{0.45}*sqrt(y)"),
    _system(
        "enzyme_kinetics",
        16,
        ((4.0, 0.1), (2.0, 1.0)),
        x="{0.5}; -{1.6}*x/({1.2} + x)",
        y="-{0.5}*y; {1.6}*x/({1.2} + x)",
    ),
    # Three states.
    _system(
        "lorenz",
        3,
        ((2.0, 3.0, 18.0), (-5.0, -3.0, 22.0)),
        x="-{10.0}*x; {10.0}*y",
        y="{28.0}*x; -{1.0}*y; -{1.0}*x*z",
        z="-{2.67}*z; {1.0}*x*y",
    ),
    _system(
        "roessler",
        14,
        ((3.0, -3.0, 0.3), (-4.0, 2.0, 0.2)),
        x="-{1.0}*y; -{1.0}*z",
        y="{1.0}*x; {0.2}*y",
        z="{0.2}; -{5.0}*z; {1.0}*x*z",
    ),
    _system(
        "rigid_body",
        14,
        ((1.0, 0.4, 1.4), (0.3, 1.3, -0.8)),
        x="-{0.05}*x; -{0.6}*y*z",
        y="-{0.06}*y; {0.9}*x*z",
        z="-{0.04}*z; -{0.4}*x*y",
    ),
    _system(
        "food_chain",
        18,
        ((1.6, 0.7, 0.5), (0.8, 1.2, 0.9)),
        x="{1.0}*x; -{0.3}*x**2; -{0.7}*x*y",
        y="-{0.4}*y; {0.6}*x*y; -{0.4}*y*z",
        z="-{0.3}*z; {0.35}*y*z",
    ),
    _system(
        "seir_short",
        24,
        ((3.0, 0.2, 0.1), (2.0, 0.5, 0.4)),
        x="-{0.4}*x*z",
        y="-{0.5}*y; {0.4}*x*z",
        z="{0.5}*y; -{0.4}*z",
    ),
    _system(
        "goodwin",
        24,
        ((0.2, 0.4, 1.4), (1.2, 0.6, 0.5)),
        x="-{0.5}*x; {1.6}*(1/(1 + (z/{0.8})**4))",
        y="{0.6}*x; -{0.5}*y",
        z="{0.6}*y; -{0.5}*z",
    ),
    _system(
        "thomas_cyclic",
        14,
        ((1.0, 0.2, -0.6), (-1.4, 1.2, 0.4)),
        x="-{0.2}*x; {1.0}*sin(y)",
        y="-{0.2}*y; {1.0}*sin(z)",
        z="-{0.2}*z; {1.0}*sin(x)",
    ),
    _system(
        "robertson_mild",
        12,
        ((1.6, 0.4, 0.3), (0.6, 1.2, 1.0)),
        x="-{0.7}*x; {0.5}*y*z",
        y="{0.7}*x; -{0.5}*y*z; -{0.6}*y**2",
        z="-{0.1}*z; {0.6}*y**2",
    ),
    _system(
        "maxwell_bloch",
        10,
        ((0.5, 0.3, 1.2), (1.2, -0.4, 0.6)),
        x="-{1.0}*x; {1.0}*y",
        y="-{0.8}*y; {1.6}*x*z",
        z="{1.2}; -{0.6}*z; -{0.9}*x*y",
    ),
    # Four states.
    _system(
        "seir",
        28,
        ((3.0, 0.2, 0.1, 0.0), (2.0, 0.5, 0.4, 0.3)),
        x="-{0.4}*x*z; {0.1}*w",
        y="-{0.5}*y; {0.4}*x*z",
        z="{0.5}*y; -{0.4}*z",
        w="{0.4}*z; -{0.1}*w",
    ),
    _system(
        "henon_heiles",
        14,
        ((0.4, -0.2, 0.1, 0.25), (-0.3, 0.3, 0.3, -0.1)),
        x="z",
        y="w",
        z="-{1.0}*x; -{2.0}*x*y",
        w="-{1.0}*y; {1.0}*y**2; -{1.0}*x**2",
    ),
    _system(
        "coupled_duffing",
        14,
        ((1.2, -0.4, 0.0, 0.4), (-0.5, 1.4, 0.6, 0.0)),
        x="z",
        y="w",
        z="-{1.0}*x; -{0.1}*z; {0.3}*y; -{0.5}*x**3",
        w="-{1.3}*y; -{0.1}*w; {0.3}*x",
    ),
    _system(
        "two_patches",
        18,
        ((2.6, 0.8, 1.0, 1.4), (1.2, 2.0, 2.4, 0.7)),
        x="{0.9}*x; -{0.6}*x*y; {0.15}*z",
        y="-{0.8}*y; {0.4}*x*y",
        z="{0.7}*z; -{0.5}*z*w",
        w="-{0.9}*w; {0.5}*z*w",
    ),
)
"""48 systems: 14 of one state, 21 of two, 9 of three, 4 of four."""
