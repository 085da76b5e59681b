"""Loads: forces from outside that do not depend on the motion."""

from __future__ import annotations

from greybox.effects.parameters import amplitude_parameter
from greybox.model import Effect
from greybox.model.signals import Expression, NamedValues


def _constant_force(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    return p.F0


constant_load = Effect(
    "constant_load",
    site="force",
    parameters=[amplitude_parameter("F0", "{force}", "constant external force (a weight), either sign")],
    terms=_constant_force,
    equation="+F0",
    parity="even",
    tells_apart=(
        "For a linear spring a constant load, an input offset and a sensor offset give the same displacement record."
        " Measure the current or the pressures, or turn the rig over: a weight changes sign, an offset does not."
    ),
    source="Linear ARX modelling of pneumatic actuator system (chapter 10), section 10.2.3: F_External of eq. 10.6",
    amplitudes=("F0",),
    probe=lambda s: {"F0": s.visible_force},
)

LOAD: tuple[Effect, ...] = (constant_load,)
