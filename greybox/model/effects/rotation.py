"""Rotation: torques that depend on where a shaft stands, with the angle among the states or from the speed alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import casadi as ca

from greybox.model.balance import Balance
from greybox.model.effect import Effect, amplitude_parameter, shape_parameter
from greybox.model.effects.scales import Scales
from greybox.model.parts import Occurrence
from greybox.model.signals import State


def _both_amplitudes(sine: str, cosine: str) -> Callable[[Scales], Mapping[str, float]]:
    """A probe that shows an amplitude of either phase."""

    def probe(s: Scales) -> Mapping[str, float]:
        return {sine: s.visible_force, cosine: s.visible_force}

    return probe


gravity_torque = Effect(
    "gravity_torque",
    site="angle",
    parameters=[
        amplitude_parameter("Gs", "{force}", "weight times lever arm, against the sine of the angle; either sign"),
        amplitude_parameter(
            "Gc", "{force}", "the same against its cosine, where zero is not at the bottom; either sign"
        ),
    ],
    terms=lambda x, u, p: -p.Gs * ca.sin(x.displacement) - p.Gc * ca.cos(x.displacement),
    equation="-Gs sin(a) - Gc cos(a)",
    parity="odd",
    tells_apart=(
        "Turn the shaft slowly through a whole revolution: a weight pushes once forwards and once backwards, whatever the direction of"
        " motion; cogging does so many times a revolution, a spring grows on and on."
    ),
    source="pendulum, or unbalance of a rotor with a horizontal axis: K. Ogata, System Dynamics",
    probe=_both_amplitudes("Gs", "Gc"),
    needs=("weight",),
    occurs=Occurrence.COMMON,
)

# Periods of a torque a revolution that a search starts from: an unbalance, pairs of poles, slots.
STARTING_RIPPLES: tuple[float, ...] = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0)


torque_ripple = Effect(
    "torque_ripple",
    site="shaft",
    parameters=[
        amplitude_parameter("Fs", "{force}", "torque against the sine of n angles; either sign"),
        amplitude_parameter(
            "Fc", "{force}", "the same against the cosine, as the angle at the start is not known; either sign"
        ),
        shape_parameter(
            "n", "1", 1.0, (0.5, 200.0), "periods a revolution: 1 for an unbalance, more for poles and teeth"
        ),
    ],
    states=[State("a", "rad", description="angle from where the record begins")],
    terms=lambda x, u, p: -p.Fs * ca.sin(p.n * x.a) - p.Fc * ca.cos(p.n * x.a),
    balances=lambda x, u, p: [Balance("angle", "rad/s", 1, "a", speed=x.velocity)],
    equation="-Fs sin(n a) - Fc cos(n a), a' = w",
    parity="even",
    tells_apart=(
        "Run at several constant speeds: the frequency of the ripple goes with the speed; hum of the mains stays where it is, a second mode"
        " shows at its own frequency."
    ),
    source="cogging of a permanent-magnet machine, unbalance: D. Hanselman, Brushless Permanent Magnet Motor Design",
    probe=_both_amplitudes("Fs", "Fc"),
    grid=lambda s: {"n": list(STARTING_RIPPLES)},
    needs=("motor", "gear"),
    occurs=Occurrence.EXOTIC,
)

ROTATION: tuple[Effect, ...] = (gravity_torque, torque_ripple)


# Loads: forces from outside that do not depend on the motion.


constant_load = Effect(
    "constant_load",
    site="force",
    parameters=[amplitude_parameter("F0", "{force}", "constant external force (a weight), either sign")],
    terms=lambda x, u, p: p.F0,
    equation="+F0",
    parity="even",
    tells_apart=(
        "For a linear spring a constant load, an input offset and a sensor offset give the same displacement record."
        " Measure the current or the pressures, or turn the rig over: a weight changes sign, an offset does not."
    ),
    source="Linear ARX modelling of pneumatic actuator system (chapter 10), section 10.2.3: F_External of eq. 10.6",
    probe=lambda s: {"F0": s.visible_force},
    occurs=Occurrence.COMMON,
    occurs_with={"weight": Occurrence.USUAL, "free": Occurrence.EXOTIC},
)

LOAD: tuple[Effect, ...] = (constant_load,)
