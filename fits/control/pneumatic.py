"""Does knowing the friction help to control the pneumatic cylinder?

A piston on two gas springs that a proportional valve fills and vents; hidden in it is seal friction of 25 N sliding and 35 N at
standstill. The position goes to 100 mm, 110 mm and back within 1.5 s each; within 2 mm counts as there. Where the integral of a
controller meets friction that falls once it slides, the piston hunts: it sticks, breaks loose, passes the target, sticks again.
Everything is generated, nothing measured. `python -m fits.control.pneumatic` prints the table; `python -m fits.control.page` writes
the page.
"""

from __future__ import annotations

import numpy as np

from fits.control.design import Weights
from fits.control.loop import Moves
from fits.control.study import BLACK, COMPENSATED, PLAIN, Setting, Study, study
from fits.control.tables import print_tables
from greybox.data.signals import multisine
from models.pneumatic_cylinder import pneumatic_cylinder

PERIOD, ROWS = 0.01, 1500  # s, rows of a record
SETTING = Setting(
    model=pneumatic_cylinder,
    start=pneumatic_cylinder.start(f_v=60.0, K2=5e-10),
    hidden={"stribeck_friction": {"Fc": 25.0, "Fs": 35.0, "vs": 0.02}},
    inputs=lambda seed: multisine(PERIOD * np.arange(ROWS), 0.1, 2.5, 4.0, np.random.default_rng(seed)),
    sampling_time=PERIOD,
    noise={"s": 2e-4, "p_a": 500.0, "p_b": 500.0},
    candidates=(
        "coulomb_friction",
        "stribeck_friction",
        "quadratic_damping",
        "valve_dead_zone",
        "chamber_leakage",
        "constant_load",
    ),
    moves=Moves((0.1, 0.11, 0.0), hold=1.5, rise=0.5, band=2e-3),
    weights=Weights(error=5e-3, integral=1.5e-3, effort=3.0, shock=0.5, noise=2e-4),
    limit=10.0,
    slow=0.02,
    rate=10.0,
    mass="M_piston",
    shown=("mm", 1e-3),
)
WORDS = """A piston between two gas springs that a valve fills and vents. The hidden friction of the seals is 25 N sliding and 35 N at
standstill, which takes 30 kPa to overcome.

Friction that falls once the piston slides makes every uncompensated design hunt. The black box and the plain model give hardly any
margin besides, or none: the friction in the record passes for damping. With the effect in the fit the margins are right."""


def verdict(results: Study) -> None:
    """What the page says of this rig."""
    assert results.discovery.verdict == "named" and [e["name"] for e in results.discovery.effects] == [
        "stribeck_friction"
    ]
    best, plain, black = (results.verdicts[n] for n in (COMPENSATED, PLAIN, BLACK))
    assert np.isfinite(best.slowest)
    assert not np.isfinite(plain.slowest) and not np.isfinite(black.slowest)
    assert best.steady < 0.5 * min(plain.steady, black.steady)
    assert not results.margins[BLACK].stable and results.margins[PLAIN].distance < 0.1
    assert results.margins[COMPENSATED].distance > 0.5 and results.spread[COMPENSATED].worst > 0.5
    assert all(np.isfinite(v.slowest) for v in results.spread[COMPENSATED].verdicts)
    for gentler in results.gentler.values():
        assert [name for name, v in gentler.items() if np.isfinite(v.slowest)] == [COMPENSATED]


if __name__ == "__main__":
    result = study(SETTING)
    print_tables(result)
    verdict(result)
