"""Electrical: what a coil does besides resistance, inductance and a constant force per ampere."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from greybox.model.balance import Balance
from greybox.model.effect import Effect, amplitude_parameter, fixed_parameter, geometric_grid, shape_parameter
from greybox.model.parts import Occurrence
from greybox.model.signals import Expression, NamedValues, State


def _drooping_constants(x: NamedValues, u: NamedValues, p: NamedValues) -> Mapping[str, Expression]:
    # First even term of the bell: Kf (1 - a x^2).
    left = 1 - p.a * x.displacement**2
    # One constant may stand for both: in SI units they are the same number.
    roles = ("force_constant", "back_emf_constant") if "back_emf_constant" in p else ("force_constant",)
    return {role: p[role] * left for role in roles}


def _amplifier_current(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    """Current from the amplifier when the inductance carries ``x.current`` and ``Re`` the rest."""
    emf = (p.back_emf_constant if "back_emf_constant" in p else p.force_constant) * x.velocity
    # u = emf + R i + Re (i - iL), solved for the current i of the amplifier; iL is that of the inductance.
    return (u.drive - emf + p.Re * x.current) / (p.resistance + p.Re)


force_constant_droop = Effect(
    "force_constant_droop",
    site="force",
    parameters=[
        amplitude_parameter("a", "1/{displacement}**2", "share of force and back EMF lost per squared displacement")
    ],
    on_parameter=_drooping_constants,
    equation="Kf (1 - a x^2), Kv (1 - a x^2)",
    parity="odd",
    tells_apart=(
        "Measure the current, or compare slow motion with motion above the resonance: the loss goes with the current, the"
        " force of a cubic spring with the displacement."
    ),
    source="bell-shaped force of a voice coil over its stroke; Klippel 2006, Loudspeaker nonlinearities, Bl(x)",
    probe=lambda s: {"a": 0.03 / s.displacement**2},
    needs=("voice_coil",),
    occurs=Occurrence.EXOTIC,
    occurs_with={"voice_coil": Occurrence.USUAL},
)

winding_heating = Effect(
    "winding_heating",
    site="voltage",
    parameters=[
        amplitude_parameter("Rth", "1/({voltage}*{current})", "rise of the resistance, as a share, per power", low=0.0),
        shape_parameter("tau_th", "s", 1.0, (1e-3, 1e7), "time in which the winding warms"),
    ],
    states=[State("z", "", description="rise of the resistance, as a share")],
    on_parameter=lambda x, u, p: {"resistance": p.resistance * (1 + x.z)},
    # The resistance as it is used already carries the factor 1 + z.
    balances=lambda x, u, p: [
        Balance("heat", "1", p.tau_th, "z", power=p.Rth * p.resistance * x.current**2, cooling=-x.z)
    ],
    equation="Ra (1 + z), tau_th z' = Rth Ra (1 + z) i^2 - z",
    parity="slow",
    tells_apart=(
        "Rest, then load: the current falls as the winding warms and recovers at rest; creep leaves the current as it"
        " is."
    ),
    source="temperature coefficient of copper, 0.39 % per kelvin, with one thermal time constant",
    probe=lambda s: {"Rth": 0.1 / (s.input * s.current)},
    grid=lambda s: {"tau_th": geometric_grid(0.02 * s.duration, 2 * s.duration, 4)},
    needs=("motor", "voice_coil"),
    occurs=Occurrence.RARE,
    occurs_with={"voice_coil": Occurrence.COMMON},
)

eddy_current = Effect(
    "eddy_current",
    site="voltage",
    parameters=[
        shape_parameter(
            "Re",
            "{voltage}/{current}",
            1e6,
            (1e-6, 1e9),
            "loop resistance in parallel with the inductance",
            "large: absent until fitted",
        )
    ],
    on_state=lambda x, u, p: {"current": _amplifier_current(x, u, p)},
    # Only the current in the inductance makes force; the other terms take the current from the amplifier.
    on_term=lambda x, u, p: {"force": {"coil": p.force_constant * x.current}},
    equation="La iL' = Re (i - iL), u = Ra i + Re (i - iL) + Kv v, force Kf iL",
    parity="linear",
    tells_apart=(
        "Excite up to Re/La with the current measured: eddy currents let the current lead at high frequency, a delay or"
        " a slow amplifier lets it lag."
    ),
    source="semi-inductance of a coil in iron with one loop: Klippel 2006, Loudspeaker nonlinearities",
    neutral={"Re": 1e6},
    grid=lambda s: {"Re": [factor * s.input / s.current for factor in (30.0, 5.0, 1.0, 0.3)]},
    needs=("motor", "voice_coil"),
    occurs=Occurrence.RARE,
    occurs_with={"voice_coil": Occurrence.COMMON},
)

saturating_inductance = Effect(
    "saturating_inductance",
    site="voltage",
    parameters=[amplitude_parameter("a", "1/{current}**2", "loss of inductance per squared current", low=0.0)],
    on_parameter=lambda x, u, p: {"inductance": p.inductance / (1 + p.a * x.current**2)},
    equation="La / (1 + a i^2)",
    parity="odd",
    tells_apart=(
        "Step the voltage at standstill with and without a bias current: with the bias the current rises faster at first; a warm winding"
        " changes where it ends, not how it begins."
    ),
    source="differential inductance of a coil on iron: R. Erickson, D. Maksimovic, Fundamentals of Power Electronics",
    probe=lambda s: {"a": 0.1 / s.current**2},
    needs=("motor", "voice_coil"),
    occurs=Occurrence.RARE,
)

# Share of the largest current within which the drop of a contact builds up.
BRUSH_CURRENT = 0.02


brush_drop = Effect(
    "brush_drop",
    site="voltage",
    parameters=[
        amplitude_parameter(
            "Ub", "{voltage}", "drop of brushes, a diode or another contact, nearly the same at every current", low=0.0
        ),
        fixed_parameter("ib", "{current}", 1e-3, (1e-12, 1e6), "current within which the drop builds up"),
    ],
    terms=lambda x, u, p: -p.Ub * ca.tanh(x.current / p.ib),
    equation="-Ub sign(i), smooth within ib",
    parity="odd",
    tells_apart=(
        "Hold the shaft and raise the voltage slowly with the current measured: nothing flows below the drop; a dead zone of the amplifier"
        " shows the same, but only in its own voltage. Dry friction lets current flow before anything moves."
    ),
    source="voltage drop of carbon brushes, 0.5 to 2 V a pair: A. Hughes, B. Drury, Electric Motors and Drives",
    probe=lambda s: {"Ub": s.visible_force},
    grid=lambda s: {"ib": [BRUSH_CURRENT * s.current]},
    needs=("motor",),
    occurs=Occurrence.RARE,
)

ELECTRICAL: tuple[Effect, ...] = (
    force_constant_droop,
    winding_heating,
    eddy_current,
    saturating_inductance,
    brush_drop,
)
