"""Six everyday plants with every effect written out by hand: plain Python, RK4 with a step far below the sampling time.

The plants are those of `greybox init --plant`: a drive, two inertias on a shaft, a stage, a servo cylinder, a heated block and two tanks.
Nothing here comes from greybox: neither its models nor its integrators. A body with dry friction is held where its velocity changes sign
and the other forces stay below what friction can hold; it leaves when they pass that. This is looked at in every one of the small steps,
so the moment is known to one of them. The input is held between samples, and zero before the first.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import copysign, exp, sqrt, tanh

Effects = Mapping[str, Mapping[str, float]]
Values = Mapping[str, float]
# States that an effect brings along; each is zero at rest.
STATES: Mapping[str, tuple[str, ...]] = {
    "viscoelastic_creep": ("crept",),
    "bouc_wen_hysteresis": ("loop",),
    "valve_lag": ("spool",),
    "input_lag": ("spool",),
    "sensor_lag": ("shown",),
    "winding_heating": ("heat",),
    "second_body": ("store",),
}


@dataclass(frozen=True)
class Body:
    """A moving part: the places of its velocity and position among the states, the name of its mass, and the site of its effects."""

    velocity: int
    position: int | None
    mass: str
    site: str = ""


@dataclass(frozen=True)
class Plant:
    """A plant: ``rates(x, u, p, effects, extra)`` of its own states, and what of them is read."""

    name: str
    states: tuple[float, ...]
    rates: Callable[[list[float], list[float], Values, Effects, dict[str, float]], list[float]]
    outputs: Callable[[list[float], Values], list[float]]
    bodies: tuple[Body, ...] = ()


def simulate(
    plant: Plant, base: Values, effects: Effects, inputs: Sequence[Sequence[float]], period: float, fine: int
) -> list[list[float]]:
    """Rows of outputs for rows of inputs, with ``fine`` steps a sample; a delay must be a whole number of them."""
    return _Run(plant, base, effects, period, fine).run(inputs)


class _Run:
    """One run of a plant with effects; ``held`` are the bodies that friction holds."""

    def __init__(self, plant: Plant, base: Values, effects: Effects, period: float, fine: int) -> None:
        self.plant, self.p, self.e, self.h, self.fine = plant, base, effects, period / fine, fine
        self.extra = [name for effect in effects for name in STATES.get(effect, ())]
        self.at = {name: len(plant.states) + k for k, name in enumerate(self.extra)}
        self.held = [self.dry(body) is not None for body in plant.bodies]
        self.direction = [1.0] * len(plant.bodies)
        self.play = self.sent = None

    def run(self, inputs):
        x = [*self.plant.states, *([0.0] * len(self.extra))]
        if "sensor_lag" in self.e:
            x[self.at["shown"]] = self.plant.outputs(x, self.p)[0]
        late = round(self.e.get("transport_delay", {"delay": 0.0})["delay"] / self.h)
        rows = []
        for n in range(len(inputs) * self.fine):
            now = n - late
            u = list(inputs[n // self.fine])
            u[0] = self.acting(float(inputs[now // self.fine][0]) if now >= 0 else 0.0)
            if n % self.fine == 0:
                rows.append(self.shown(n * self.h, x))
            x = self.step(x, u)
        return rows

    def acting(self, u):
        """What the signal path makes of the first input."""
        e = self.e
        if "input_offset" in e:
            u += e["input_offset"]["u0"]
        if "input_saturation" in e:
            limit = e["input_saturation"]["u_max"]
            u = min(max(u, -limit), limit)
        for name in ("input_dead_zone", "valve_dead_zone"):
            if name in e:
                u = 0.0 if abs(u) <= e[name]["d"] else u - copysign(e[name]["d"], u)
        if "soft_saturation" in e:
            u = e["soft_saturation"]["u_max"] * tanh(u / e["soft_saturation"]["u_max"])
        if "input_play" in e:  # half the width
            h = e["input_play"]["h"]
            self.play = min(max(u if self.play is None else self.play, u - h), u + h)
            u = self.play
        if "gain_by_sign" in e and u < 0:
            u *= 1 - e["gain_by_sign"]["g"]
        if "coarse_drive" in e:
            u = e["coarse_drive"]["q"] * round(u / e["coarse_drive"]["q"])
        return u

    def shown(self, t, x):
        """What the sensors make of the outputs; effects are those of the first one."""
        y = list(self.plant.outputs(x, self.p))
        if "sensor_drift" in self.e:
            y[0] += self.e["sensor_drift"]["rate"] * t
        if "sensor_lag" in self.e:
            y[0] = x[self.at["shown"]]
        if "sensor_on_change" in self.e:
            if self.sent is None or abs(y[0] - self.sent) > self.e["sensor_on_change"]["d"]:
                self.sent = y[0]
            y[0] = self.sent
        return y

    def dry(self, body):
        """The dry friction of a body, if it has some."""
        return next((self.e[name + body.site] for name in DRY if name + body.site in self.e), None)

    def force(self, body, x, d):
        """Force of the effects on a body, dry friction left out; rates of their states go into ``d``."""
        e, v, total = self.e, x[body.velocity], 0.0
        s = 0.0 if body.position is None else x[body.position]
        named = {name.removesuffix(body.site): values for name, values in e.items() if name.endswith(body.site)}
        if body.site == "":
            named = {name: values for name, values in e.items() if "_at_" not in name}
        for name, f in named.items():
            if name == "quadratic_damping":
                total -= f["B2"] * abs(v) * v
            elif name == "cubic_damping":
                total -= f["B3"] * v**3
            elif name == "power_damping":
                total -= copysign(f["c"] * abs(v) ** 0.6, v)
            elif name == "creeping_friction":
                total -= f["Fc"] * tanh(v / f["vr"])
            elif name == "cubic_stiffness":
                total -= f["K3"] * s**3
            elif name == "quadratic_stiffness":
                total -= f["K2"] * s**2
            elif name == "quintic_stiffness":
                total -= f["K5"] * s**5
            elif name == "end_stop":
                total -= f["kc"] * (s - min(max(s, -f["gap"]), f["gap"]))
            elif name == "magnet":
                total -= f["F"] * exp(-(((s - f["x0"]) / f["w"]) ** 2))
            elif name == "constant_load":
                total += f["F0"]
            elif name == "viscoelastic_creep":
                z = x[self.at["crept"]]
                total -= f["K1"] * (s - z)
                d[self.at["crept"]] = (s - z) / f["tau1"]
            elif name == "bouc_wen_hysteresis":
                z = x[self.at["loop"]]
                total -= f["alpha"] * z
                d[self.at["loop"]] = v - f["beta"] * abs(v) * z - f["gamma"] * v * abs(z)
        return total

    def rates(self, x, u):
        """Rates of all states, and the force on each body but for the dry friction of one at rest."""
        p, d = self.p, [0.0] * len(x)
        u = list(u)
        for name in ("valve_lag", "input_lag"):
            if name in self.e:
                z = self.at["spool"]
                d[z] = (u[0] - x[z]) / self.e[name]["tau_v"]
                u[0] = x[z]
        extra = {name: x[k] for name, k in self.at.items()}
        grown: dict[str, float] = {}
        d[: len(self.plant.states)] = self.plant.rates(x, u, p, self.e, extra | {"rates": grown})
        for name, rate in grown.items():
            d[self.at[name]] = rate
        forces = []
        for k, body in enumerate(self.plant.bodies):
            force = d[body.velocity] * p[body.mass] + self.force(body, x, d)
            friction = self.dry(body)
            if friction is not None:
                if self.held[k]:
                    forces.append(force)
                    d[body.velocity] = 0.0
                    continue
                v = x[body.velocity]
                force -= _sliding(friction, v) * self.direction[k]
            forces.append(force)
            d[body.velocity] = force / p[body.mass]
        if "sensor_lag" in self.e:
            z = self.at["shown"]
            d[z] = (self.plant.outputs(x, p)[0] - x[z]) / self.e["sensor_lag"]["tau_s"]
        return d, forces

    def step(self, x, u):
        h = self.h

        def moved(k, share):
            return [a + share * h * b for a, b in zip(x, k, strict=True)]

        if any(self.held):
            _, forces = self.rates(x, u)
            for k, body in enumerate(self.plant.bodies):
                friction = self.dry(body)
                if friction is not None and self.held[k] and abs(forces[k]) > friction.get("Fs", friction["Fc"]):
                    self.held[k] = False
                    x[body.velocity] = copysign(1e-300, forces[k])  # zero, with the sign of the motion to come
        self.direction = [copysign(1.0, x[body.velocity]) for body in self.plant.bodies]  # the same throughout a step
        k1, _ = self.rates(x, u)
        k2, _ = self.rates(moved(k1, 0.5), u)
        k3, _ = self.rates(moved(k2, 0.5), u)
        k4, _ = self.rates(moved(k3, 1.0), u)
        after = [a + h / 6 * (p + 2 * q + 2 * r + s) for a, p, q, r, s in zip(x, k1, k2, k3, k4, strict=True)]
        for k, body in enumerate(self.plant.bodies):
            if self.dry(body) is not None and not self.held[k] and x[body.velocity] * after[body.velocity] < 0:
                after[body.velocity], self.held[k] = 0.0, True
        return after


DRY = ("coulomb_friction", "stribeck_friction")


def _sliding(friction, v):
    """Size of dry friction at a velocity."""
    if "Fs" not in friction:
        return friction["Fc"]
    return friction["Fc"] + (friction["Fs"] - friction["Fc"]) * exp(-((v / friction["vs"]) ** 2))


def _drive(x, u, p, e, extra):
    warm = 1.0
    if "winding_heating" in e:
        f, heat = e["winding_heating"], extra["heat"]
        warm = 1 + heat
        extra["rates"]["heat"] = (f["Rth"] * p["Ra"] * warm * x[1] ** 2 - heat) / f["tau_th"]
    return [
        (p["Kt"] * x[1] - p["B"] * x[0]) / p["J"],
        (u[0] - p["Ra"] * warm * x[1] - p["Kt"] * x[0]) / p["La"],
    ]


def _two_mass(x, u, p, e, extra):
    a1, w1, a2, w2 = x[:4]
    twist = a1 - a2
    if "shaft_play" in e:
        gap = e["shaft_play"]["gap"]
        inside = min(max(twist, -gap), gap)
        torque = p["c"] * (twist - inside) + (p["d"] * (w1 - w2) if inside != twist else 0.0)
    else:
        torque = p["c"] * twist + p["d"] * (w1 - w2)
    if "cubic_shaft" in e:
        torque += e["cubic_shaft"]["c3"] * twist**3
    return [w1, (u[0] - p["d1"] * w1 - torque) / p["J1"], w2, (torque - p["d2"] * w2) / p["J2"]]


def _stage(x, u, p, e, extra):
    return [x[1], (p["Kf"] * u[0] - p["B"] * x[1] - p["K"] * x[0]) / p["M"]]


def _cylinder(x, u, p, e, extra):
    leak = p["Cl"] * x[2]
    if "root_leak" in e:
        leak += e["root_leak"]["c"] * copysign(sqrt(abs(x[2])), x[2])
    return [
        x[1],
        (p["A"] * x[2] - p["B"] * x[1]) / p["M"],
        4 * p["E"] / p["V"] * (p["Kq"] * u[0] - p["A"] * x[1] - leak),
    ]


def _thermal(x, u, p, e, extra):
    power, ambient = u
    above = x[0] - ambient
    loss = p["h"] * above
    if "radiation" in e:
        loss += e["radiation"]["s"] * ((x[0] + 273.15) ** 4 - (ambient + 273.15) ** 4)
    if "convection" in e:
        loss += e["convection"]["c"] * copysign(abs(above) ** 1.25, above)
    if "second_body" in e:  # beside the ambient temperature at the beginning
        f = e["second_body"]
        flow = f["g"] * (x[0] - 20.0 - extra["store"])
        loss += flow
        extra["rates"]["store"] = flow / f["C2"]
    return [(power - loss) / p["C"], (x[0] - x[1]) / p["s"]]


def _tanks(x, u, p, e, extra):
    g = 2 * p["g"]
    upper, lower = p["a1"] * sqrt(g * max(x[0], 0.0)), p["a2"] * sqrt(g * max(x[1], 0.0))
    pump = p["kp"] * u[0]
    if "pump_back_pressure" in e:
        pump *= 1 - e["pump_back_pressure"]["c"] * x[0]
    leak = e["linear_leak"]["k"] * x[0] if "linear_leak" in e else 0.0
    over = e["overflow"]["k"] * max(x[0] - e["overflow"]["h"], 0.0) if "overflow" in e else 0.0
    return [(pump - upper - leak - over) / p["A1"], (upper - lower) / p["A2"]]


PLANTS = {
    "rotary_drive": Plant("rotary_drive", (0.0, 0.0), _drive, lambda x, p: [x[0], x[1]], (Body(0, None, "J"),)),
    "two_mass": Plant(
        "two_mass",
        (0.0,) * 4,
        _two_mass,
        lambda x, p: [x[0], x[2]],
        (Body(1, 0, "J1"), Body(3, 2, "J2", "_at_load")),
    ),
    "stage": Plant("stage", (0.0, 0.0), _stage, lambda x, p: [x[0]], (Body(1, 0, "M"),)),
    "cylinder": Plant("cylinder", (0.0,) * 3, _cylinder, lambda x, p: [x[0], x[2]], (Body(1, 0, "M"),)),
    "thermal": Plant("thermal", (20.0, 20.0), _thermal, lambda x, p: [x[1]]),
    "tanks": Plant("tanks", (0.10, 0.10), _tanks, lambda x, p: [x[0], x[1]]),
}
