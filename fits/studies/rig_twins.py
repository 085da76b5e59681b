"""The two rigs with every effect written out by hand: plain Python, RK4 with a step far below the sampling time.

Nothing here comes from greybox: neither its models nor its integrators, so that what greybox finds in these records is not its
own reflection. Dry friction keeps its direction within a step; where the velocity changes sign, and where the force on a
body at rest passes the static friction, the step is cut (bisection). The input is held between samples, and zero before the first.

Beside the effects of the catalogue there are some that it does not have, and relatives of its own whose form differs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import copysign, exp, pi, sin, sqrt, tanh

import numpy as np

BISECTIONS = 60
# States that an effect brings along, and what they are at rest.
STATES = {
    "lugre_friction": ["bristle"],
    "viscoelastic_creep": ["crept"],
    "bouc_wen_hysteresis": ["loop"],
    "second_mode": ["z1", "z2"],
    "winding_heating": ["heat"],
    "supply_droop": ["droop"],
    "valve_lag": ["spool"],
    "sensor_lag": ["shown"],
    "creep_spectrum": ["crept1", "crept2", "crept3"],
    "resting_friction": ["rest"],
    "random_disturbance": ["w1", "w2"],
    "thermal_drive": ["warmth"],
}
DRY = {"coulomb_friction", "stribeck_friction", "asymmetric_friction", "resting_friction"}
# Relaxation times of a creep with a spectrum, in units of the middle one; each branch has a third of the stiffness.
SPECTRUM = (0.2, 1.0, 5.0)
PLAYS = 4  # elements of a rate-independent hysteresis, each with another width


def clip(value, low, high):
    return min(max(value, low), high)


Effects = Mapping[str, Mapping[str, float]]


class Rig:
    """A rig with ``base`` constants and ``effects`` {name: {parameter: value}}; ``run`` gives its outputs."""

    native_states = ()

    def __init__(self, base, effects):
        self.base, self.e = base, effects
        self.names = [*self.native_states, *(s for name in effects for s in STATES.get(name, []))]
        self.at = {name: k for k, name in enumerate(self.names)}
        self.held = None  # play: where the sensor stands
        self.spool = 0.0  # play of the spool: what reaches the valve
        self.plays = [0.0] * PLAYS  # one position for each element of a Prandtl-Ishlinskii operator
        self.rested = 0.0  # how far friction has grown when the body last came to rest, 0 to 1
        self.sent = 0.0  # what a sensor that sends on change last sent
        self.disturbance = np.random.default_rng(0)
        self.sticks = bool(set(effects) & DRY)
        self.now = 0.0

    def run(self, u, period, fine):
        """Rows of outputs for the inputs ``u`` (N,), ``fine`` steps a sample; a delay must be a whole number of them."""
        h = period / fine
        late = round(self.e.get("transport_delay", {"delay": 0.0})["delay"] / h)
        x = [*self.start_values(), *([0.0] * (len(self.names) - len(self.native_states)))]
        self.held = x[0]
        if "random_disturbance" in self.e:  # another one for each record
            self.disturbance = np.random.default_rng(
                [int(self.e["random_disturbance"]["seed"]), round(1e9 * sum(map(abs, u)))]
            )
        rows = []
        for n in range(len(u) * fine):
            now = n - late
            self.now = n * h
            acting = self.acting(float(u[now // fine]) if now >= 0 else 0.0)
            if n % fine == 0:
                rows.append(self.outputs(n * h, x, acting))
            x = self.step(x, acting, h)
            if "backlash" in self.e:
                gap = self.e["backlash"]["gap"]
                self.held = clip(self.held, x[0] - gap, x[0] + gap)
            self.remember(x, h)
        return rows

    def remember(self, x, h):
        """After a step: what has a memory that is no state of a differential equation."""
        if "ishlinskii_spring" in self.e:
            width = self.e["ishlinskii_spring"]["width"]
            for k in range(PLAYS):
                half = width * (k + 1) / PLAYS
                self.plays[k] = clip(self.plays[k], x[0] - half, x[0] + half)
        if "random_disturbance" in self.e:  # white noise held for a step drives a filter of second order
            x[self.at["w2"]] += self.e["random_disturbance"]["F"] * sqrt(h) * float(self.disturbance.normal())

    def acting(self, u):
        """What the signal path makes of the input."""
        if "input_offset" in self.e:
            u += self.e["input_offset"]["u0"]
        if "input_saturation" in self.e:
            u = clip(u, -self.e["input_saturation"]["u_max"], self.e["input_saturation"]["u_max"])
        for name in ("input_dead_zone", "valve_dead_zone"):
            if name in self.e:
                d = self.e[name]["d"]
                u = 0.0 if abs(u) <= d else u - copysign(d, u)
        if "soft_saturation" in self.e:
            u = self.e["soft_saturation"]["u_max"] * tanh(u / self.e["soft_saturation"]["u_max"])
        if "soft_dead_zone" in self.e:
            u -= self.e["soft_dead_zone"]["d"] * tanh(u / self.e["soft_dead_zone"]["d"])
        if "spool_play" in self.e:
            h = self.e["spool_play"]["h"]
            u = self.spool = clip(self.spool, u - h, u + h)
        if "gain_by_sign" in self.e and u < 0:
            u *= 1 - self.e["gain_by_sign"]["g"]
        if "coarse_drive" in self.e:
            q = self.e["coarse_drive"]["q"]
            u = q * round(u / q)
        if "gain_ripple" in self.e:
            f = self.e["gain_ripple"]
            u *= 1 + f["m"] * sin(2 * pi * f["f"] * self.now)
        return u

    def shown(self, t, x):
        """What the sensor makes of the position."""
        if "sensor_drift" in self.e:
            return x[0] + self.e["sensor_drift"]["rate"] * t
        if "sensor_lag" in self.e:
            return x[self.at["shown"]]
        if "backlash" in self.e:
            return self.held
        if "sensor_on_change" in self.e:
            if abs(x[0] - self.sent) > self.e["sensor_on_change"]["d"]:
                self.sent = x[0]
            return self.sent
        if "second_clock" in self.e:  # to first order the position a growing time ago
            return x[0] - self.e["second_clock"]["rate"] * t * x[1]
        return x[0]

    def levels(self, v, direction):
        """Dry friction while sliding with ``v``, and the most it holds at standstill against a push in ``direction``."""
        if "coulomb_friction" in self.e:
            return self.e["coulomb_friction"]["Fc"], self.e["coulomb_friction"]["Fc"]
        if "stribeck_friction" in self.e:
            f = self.e["stribeck_friction"]
            return f["Fc"] + (f["Fs"] - f["Fc"]) * exp(-((v / f["vs"]) ** 2)), f["Fs"]
        if "resting_friction" in self.e:  # what it holds grows with the time of rest
            f = self.e["resting_friction"]
            return f["Fc"], f["Fc"] + f["dF"] * self.rested
        level = self.e["asymmetric_friction"]["Fp" if direction > 0 else "Fm"]
        return level, level

    def forces(self, x, d):
        """Force of the effects on the moving mass, dry friction left out; rates of their states go into ``d``."""
        e, at, s, v, total = self.e, self.at, x[0], x[1], 0.0
        if "lugre_friction" in e:
            f, z = e["lugre_friction"], x[at["bristle"]]
            g = f["Fc"] + (f["Fs"] - f["Fc"]) * exp(-((v / f["vs"]) ** 2))
            d[at["bristle"]] = v - f["s0"] * abs(v) * z / g
            total -= f["s0"] * z + f["s1"] * d[at["bristle"]]
        if "quadratic_damping" in e:
            total -= e["quadratic_damping"]["B2"] * abs(v) * v
        if "cubic_stiffness" in e:
            total -= e["cubic_stiffness"]["K3"] * s**3
        if "quadratic_stiffness" in e:
            total -= e["quadratic_stiffness"]["K2"] * s**2
        if "return_spring" in e:
            total -= e["return_spring"]["Ks"] * s
        if "constant_load" in e:
            total += e["constant_load"]["F0"]
        if "viscoelastic_creep" in e:
            f, z = e["viscoelastic_creep"], x[at["crept"]]
            total -= f["K1"] * (s - z)
            d[at["crept"]] = (s - z) / f["tau1"]
        if "bouc_wen_hysteresis" in e:
            f, z = e["bouc_wen_hysteresis"], x[at["loop"]]
            total -= f["alpha"] * z
            d[at["loop"]] = v - f["beta"] * abs(v) * z - f["gamma"] * v * abs(z)
        if "second_mode" in e:
            f, z1, z2 = e["second_mode"], x[at["z1"]], x[at["z2"]]
            reaction = f["k2"] * (z1 - s) + f["c2"] * (z2 - v)
            total += reaction
            d[at["z1"]], d[at["z2"]] = z2, -reaction / f["m2"]
        if "sensor_lag" in e:
            d[at["shown"]] = (s - x[at["shown"]]) / e["sensor_lag"]["tau_s"]
        return total + self.foreign(x, d)

    def foreign(self, x, d):
        """Force of the effects that the catalogue does not have, or has in another form."""
        e, s, v, total = self.e, x[0], x[1], 0.0
        if "cogging" in e:
            total += e["cogging"]["F"] * sin(2 * pi * s / e["cogging"]["pitch"])
        if "end_stop" in e:
            gap = e["end_stop"]["gap"]
            total -= e["end_stop"]["kc"] * (s - clip(s, -gap, gap))
        if "mains_hum" in e:
            total += e["mains_hum"]["F"] * sin(2 * pi * e["mains_hum"]["f"] * self.now)
        if "quintic_stiffness" in e:
            total -= e["quintic_stiffness"]["K5"] * s**5
        if "cubic_damping" in e:
            total -= e["cubic_damping"]["B3"] * v**3
        if "creeping_friction" in e:
            total -= e["creeping_friction"]["Fc"] * tanh(v / e["creeping_friction"]["vr"])
        if "power_damping" in e:
            total -= copysign(e["power_damping"]["c"] * abs(v) ** 0.6, v)
        if "magnet" in e:
            f = e["magnet"]
            total -= f["F"] * exp(-(((s - f["x0"]) / f["w"]) ** 2))
        if "ishlinskii_spring" in e:
            total -= e["ishlinskii_spring"]["k"] * sum(s - play for play in self.plays) / PLAYS
        if "resting_friction" in e:
            f = e["resting_friction"]
            d[self.at["rest"]] = (
                (1 - x[self.at["rest"]]) / f["tau"] if v == 0 else -x[self.at["rest"]] * abs(v) / f["slip"]
            )
        if "random_disturbance" in e:
            w = 2 * pi * e["random_disturbance"]["f"]
            z1, z2 = self.at["w1"], self.at["w2"]
            d[z1], d[z2] = w * x[z2], -w * x[z1] - w * x[z2]
            total += x[z1] * sqrt(w)
        if "thermal_drive" in e:  # work done warms the drive, and the warm drive pushes one way
            f = e["thermal_drive"]
            d[self.at["warmth"]] = (abs(v) * f["per_speed"] - x[self.at["warmth"]]) / f["tau"]
            total += f["F"] * x[self.at["warmth"]]
        if "creep_spectrum" in e:
            f = e["creep_spectrum"]
            for share, name in zip(SPECTRUM, STATES["creep_spectrum"], strict=True):
                stretch = s - x[self.at[name]]
                total -= f["K1"] / len(SPECTRUM) * stretch
                d[self.at[name]] = stretch / (share * f["tau1"])
        return total

    def rates(self, x, u, direction):
        """Rates of all states; ``direction`` is the sign of motion, 0 for a body that is held by friction."""
        d, force = self.smooth(x, u)
        if self.sticks:
            if direction == 0:
                d[0] = d[1] = 0.0
                return d
            force -= self.levels(x[1], direction)[0] * direction
        d[1] = force / self.mass
        return d

    def step(self, x, u, h):
        if not self.sticks:
            return self.rk4(x, u, h, 1.0)
        while h > 0:
            direction = copysign(1.0, x[1]) if x[1] != 0 else self.leaving(x, u)
            after = self.rk4(x, u, h, direction)
            if self.goes_on(after, u, direction):
                return after
            low, high = 0.0, h
            for _ in range(BISECTIONS):
                middle = (low + high) / 2
                if self.goes_on(self.rk4(x, u, middle, direction), u, direction):
                    low = middle
                else:
                    high = middle
            if x[1] == 0 and direction and high < 1e-9 * h:  # it was about to leave and comes back at once: it stays
                return self.rk4(x, u, h, 0.0)
            x = self.rk4(x, u, high, direction)
            x[1] = 0.0
            h -= high
        return x

    def goes_on(self, x, u, direction):
        """Whether a body that slid in this direction still does, and one that was held (0) is still held."""
        return x[1] * direction > 0 if direction else self.leaving(x, u) == 0

    def leaving(self, x, u):
        self.rested = x[self.at["rest"]] if "resting_friction" in self.e else 0.0
        force = self.smooth(x, u)[1]
        way = copysign(1.0, force)
        return 0.0 if abs(force) <= self.levels(0.0, way)[1] else way

    def rk4(self, x, u, h, direction):
        def moved(k, share):
            return [a + share * h * b for a, b in zip(x, k, strict=True)]

        k1 = self.rates(x, u, direction)
        k2 = self.rates(moved(k1, 0.5), u, direction)
        k3 = self.rates(moved(k2, 0.5), u, direction)
        k4 = self.rates(moved(k3, 1.0), u, direction)
        return [a + h / 6 * (p + 2 * q + 2 * r + s) for a, p, q, r, s in zip(x, k1, k2, k3, k4, strict=True)]


class Actuator(Rig):
    """M v' = Kf i - B v - K x, La i' = u - Ra i - Kv v; outputs x, i."""

    native_states = ("x", "v", "i")

    @property
    def mass(self):
        return self.base["M"]

    def start_values(self):
        return [0.0, 0.0, 0.0]

    def constants(self, x):
        """Kf, Kv and Ra as they are at this moment."""
        b = self.base
        left = 1 - self.e["force_constant_droop"]["a"] * x[0] ** 2 if "force_constant_droop" in self.e else 1.0
        warm = 1 + x[self.at["heat"]] if "winding_heating" in self.e else 1.0
        return b["Kf"] * left, b["Kv"] * left, b["Ra"] * warm

    def current(self, x, u):
        if "eddy_current" not in self.e:
            return x[2]
        _, kv, ra = self.constants(x)
        re = self.e["eddy_current"]["Re"]
        return (u - kv * x[1] + re * x[2]) / (ra + re)

    def smooth(self, x, u):
        b, d = self.base, [0.0] * len(x)
        kf, kv, ra = self.constants(x)
        i = self.current(x, u)
        d[0] = x[1]
        if "eddy_current" in self.e:
            d[2] = self.e["eddy_current"]["Re"] * (i - x[2]) / b["La"]
        else:
            d[2] = (u - ra * i - kv * x[1]) / b["La"]
        if "winding_heating" in self.e:
            f = self.e["winding_heating"]
            d[self.at["heat"]] = (f["Rth"] * ra * i**2 - x[self.at["heat"]]) / f["tau_th"]
        return d, kf * x[2] - b["B"] * x[1] - b["K"] * x[0] + self.forces(x, d)

    def outputs(self, t, x, u):
        return self.shown(t, x), self.current(x, u)


class Cylinder(Rig):
    """p_a' = G u - (P_S A/V) v, p_b' = -(that), M v' = A (p_a - p_b) - M f_v v; outputs s, p_a, p_b."""

    native_states = ("s", "v", "p_a", "p_b")

    @property
    def mass(self):
        return self.base["M_piston"]

    def start_values(self):
        return [0.0, 0.0, self.base["P_S"] / 2, self.base["P_S"] / 2]

    def smooth(self, x, u):
        b, e, d = self.base, self.e, [0.0] * len(x)
        s, v, pa, pb = x[:4]
        if "valve_lag" in e:
            d[self.at["spool"]] = (u - x[self.at["spool"]]) / e["valve_lag"]["tau_v"]
            u = x[self.at["spool"]]
        gain = b["P_a"] * b["K2"] * b["P_S"] / (b["rho_a"] * b["V_total"])
        if "supply_droop" in e:
            f, z = e["supply_droop"], x[self.at["droop"]]
            d[self.at["droop"]] = (f["r"] * abs(u) - z) / f["tau_d"]
            gain *= 1 - z
        into_a, into_b = gain * u, -gain * u
        if "choked_flow" in e:
            into_a = self.choked(gain, u, pa)
            into_b = self.choked(gain, -u, pb)
        by_motion = b["P_S"] * b["A_piston"] / b["V_total"] * v
        d[0], d[2], d[3] = v, into_a - by_motion, into_b + by_motion
        if "chamber_leakage" in e:
            leak = e["chamber_leakage"]["kl"] * (pa - pb)
            d[2], d[3] = d[2] - leak, d[3] + leak
        if "position_dependent_volume" in e:
            share = e["position_dependent_volume"]["scale"] * b["A_piston"] * s / (b["V_total"] / 2)
            d[2], d[3] = d[2] / (1 + share), d[3] / (1 - share)
        force = b["A_piston"] * (pa - pb) - b["M_piston"] * b["f_v"] * v
        return d, force + self.forces(x, d)

    def choked(self, gain, opening, p):
        """Rate of the pressure in a chamber that a positive ``opening`` fills and a negative one vents."""
        f = self.e["choked_flow"]

        def orifice(upstream, downstream):
            if upstream < downstream:
                return -orifice(downstream, upstream)
            r = downstream / upstream
            return upstream * (1.0 if r <= f["b"] else sqrt(max(0.0, 1 - ((r - f["b"]) / (1 - f["b"])) ** 2)))

        if opening > 0:
            return gain * opening * orifice(self.base["P_S"], p) / self.base["P_S"]
        return f["ce"] * gain * opening * orifice(p, self.base["P_a"]) / self.base["P_S"]

    def outputs(self, t, x, u):
        return self.shown(t, x), x[2], x[3]


def simulate(
    rig: str, base: Mapping[str, float], effects: Effects, u: Sequence[float], period: float, fine: int
) -> list[tuple[float, ...]]:
    """Outputs (N rows) of ``micro_actuator`` (x, i) or ``pneumatic_cylinder`` (s, p_a, p_b) from rest.

    ``u`` (N,) is held for ``period`` seconds each, ``fine`` steps a sample; a delay must be a whole number of them.
    """
    return {"micro_actuator": Actuator, "pneumatic_cylinder": Cylinder}[rig](base, effects).run(u, period, fine)
