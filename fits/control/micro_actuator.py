"""Does knowing the friction help to control the micro-motion actuator?

A coil on a compliant mechanism that rings with 3 % of damping; hidden in it is dry friction of 0.05 N, which holds it anywhere
within 8 um. The position goes to 20 um, 25 um and back within 40 ms each; within 0.5 um counts as there. Everything is
generated, nothing measured. `python -m fits.control.micro_actuator` prints the table; `python -m fits.control.page` writes the page.
"""

from __future__ import annotations

import numpy as np

from fits.control.design import Weights
from fits.control.loop import Moves
from fits.control.study import BLACK, COMPENSATED, PLAIN, Setting, Study, study
from fits.control.tables import print_tables
from greybox.data.signals import multisine
from models.micro_actuator import micro_actuator

PERIOD, ROWS = 2.5e-4, 800  # s, rows of a record
SETTING = Setting(
    model=micro_actuator,
    start=micro_actuator.fix("M", "Ra").start(B=0.35, K=5000.0, Kf=1.2, Kv=1.2, La=7e-4),
    hidden={"coulomb_friction": {"Fc": 0.05}},
    inputs=lambda seed: multisine(PERIOD * np.arange(ROWS), 5, 300, 2.0, np.random.default_rng(seed)),
    sampling_time=PERIOD,
    noise={"x": 1e-7, "i": 5e-3},
    candidates=(
        "coulomb_friction",
        "quadratic_damping",
        "cubic_stiffness",
        "bouc_wen_hysteresis",
        "input_dead_zone",
        "constant_load",
    ),
    moves=Moves((20e-6, 25e-6, 0.0), hold=0.04, rise=0.006, band=0.5e-6),
    weights=Weights(error=2e-5, integral=1e-7, effort=1.0, shock=0.2, noise=1e-7),
    limit=5.0,
    slow=5e-4,
    rate=1500.0,
    mass="M",
    shown=("µm", 1e-6),
)
WORDS = """A coil on a compliant mechanism that rings with 3 % of damping. The hidden friction of 0.05 N holds it anywhere within 8 µm.

The integral of the designs that do not compensate the friction needs twice the time. The black box is as good as the uncompensated
grey-box ones."""


def verdict(results: Study) -> None:
    """What the page says of this rig."""
    assert results.discovery.verdict == "named" and [e["name"] for e in results.discovery.effects] == [
        "coulomb_friction"
    ]
    best, plain, black = (results.verdicts[n] for n in (COMPENSATED, PLAIN, BLACK))
    assert best.slowest < 0.015
    assert best.slowest < 0.5 * min(plain.slowest, black.slowest)
    assert best.steady < 0.5 * min(plain.steady, black.steady)
    for name in (PLAIN, COMPENSATED):
        assert results.margins[name].distance > 0.5 and results.spread[name].worst > 0.45
    assert max(v.slowest for v in results.spread[COMPENSATED].verdicts) < 0.02
    for gentler in results.gentler.values():
        assert min(v.slowest for n, v in gentler.items() if n != COMPENSATED) > 1.5 * gentler[COMPENSATED].slowest


if __name__ == "__main__":
    result = study(SETTING)
    print_tables(result)
    verdict(result)
