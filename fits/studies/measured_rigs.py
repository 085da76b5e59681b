"""Measured records of public rigs: their plain models, how a search learns, chooses and is judged on them, and what is known of each.

The records are not part of this project. A folder for each rig: everyday work and three benchmarks, and in ``known`` five whose missing
effects are known by construction, by weighing or by publication: falling balls (de Silva and others, Frontiers in Artificial Intelligence
3, 2020), a weighed pendulum (Wiebe and others, DFKI), a magneto-rheological damper (UTFPR Labcontrol), two heaters (APMonitor's temperature
control laboratory), a rotor with an electric brake (Yeung and others, IROS 2022). A model is what an engineer would write first from
the rig's documentation, in SI units but for the damper (mm).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.discovery.candidates import family_of
from greybox.discovery.curve_shape import TIME
from greybox.shell.project import load_model_file
from models.cascaded_tanks import cascaded_tanks
from models.emps import emps
from models.silverbox import silverbox


def falling_ball() -> Model:
    """A ball in free fall from a bridge; the height is measured."""
    return Model(
        "ball",
        states=[State("h", "m", 45.0, role="displacement"), State("v", "m/s", role="velocity")],
        inputs=[],
        outputs=[Output("h", "m")],
        parameters=[Parameter("g", "m/s^2", 9.79, (5.0, 15.0), fixed=True)],
        balances=lambda x, u, p: [
            Balance("height", "m/s", 1, "h", v=x.v),
            Balance("force", "m/s^2", 1, "v", weight=-p.g),
        ],
    )


def rotor() -> Model:
    """A rotor with a drive of unknown strength and a constant load, per moment of inertia."""
    return Model(
        "rotor",
        states=[State("w", "rad/s", role="velocity")],
        inputs=[Input("u", "V", role="drive")],
        outputs=[Output("w", "rad/s")],
        parameters=[
            Parameter("kt", "rad/(s^2*V)", 3.0, (1e-3, 1e4)),
            Parameter("b", "1/s", 1.0, (1e-4, 1e3), role="damping"),
            Parameter("c", "rad/s^2", 0.0, (-1e3, 1e3)),
        ],
        balances=lambda x, u, p: [
            Balance("torque", "rad/s^2", 1, "w", drive=p.kt * u.u, damping=-p.b * x.w, load=-p.c)
        ],
    )


def pendulum() -> Model:
    """A weighed pendulum on a drive whose torque is measured."""
    return Model(
        "pendulum",
        states=[State("q", "rad", role="displacement"), State("w", "rad/s", role="velocity")],
        inputs=[Input("tau", "N*m", role="drive")],
        outputs=[Output("q", "rad")],
        parameters=[
            Parameter("J", "kg*m^2", 0.147, (1e-3, 10.0)),
            Parameter("mgl", "N*m", 2.98, (1e-2, 100.0)),
            Parameter("b", "N*m*s/rad", 0.03, (1e-4, 10.0), role="damping"),
        ],
        balances=lambda x, u, p: [
            Balance("angle", "rad/s", 1, "q", w=x.w),
            Balance("torque", "N*m", p.J, "w", drive=u.tau, weight=-p.mgl * ca.sin(x.q), damping=-p.b * x.w),
        ],
    )


def heaters() -> Model:
    """Two heaters with a sensor each: heat from the board, heat to the room."""
    return Model(
        "heaters",
        states=[State("T1", "K", 294.0), State("T2", "K", 294.0)],
        inputs=[Input("Q1", "W", role="drive"), Input("Q2", "W")],
        outputs=[Output("T1", "K"), Output("T2", "K")],
        parameters=[
            Parameter("C", "J/K", 2.0, fixed=True),
            Parameter("a1", "1", 1.0, (1e-2, 100.0)),
            Parameter("a2", "1", 0.75, (1e-2, 100.0)),
            Parameter("UA", "W/K", 0.01, (1e-4, 1.0)),
            Parameter("Ta", "K", 294.0, (270.0, 320.0)),
        ],
        balances=lambda x, u, p: [
            Balance("heat_1", "W", p.C, "T1", heater=p.a1 * u.Q1, loss=-p.UA * (x.T1 - p.Ta)),
            Balance("heat_2", "W", p.C, "T2", heater=p.a2 * u.Q2, loss=-p.UA * (x.T2 - p.Ta)),
        ],
    )


def damper() -> Model:
    """A damper that is moved; its force is measured."""
    return Model(
        "damper",
        states=[State("x", "mm", role="displacement")],
        inputs=[Input("v", "mm/s", role="drive")],
        outputs=[Output("F", "N", lambda x, u, p: p.c * u.v + p.K * x.x + p.F0)],
        parameters=[
            Parameter("c", "N*s/mm", 1.0, (1e-4, 100.0)),
            Parameter("K", "N/mm", 0.1, (-10.0, 100.0)),
            Parameter("F0", "N", 0.0, (-1e3, 1e3)),
        ],
        balances=lambda x, u, p: [Balance("motion", "mm/s", 1, "x", v=u.v)],
    )


def pushed_damper() -> Model:
    """The same damper the other way about: its force moves it, and its displacement is measured; friction has a balance to act in."""
    return Model(
        "pushed_damper",
        states=[State("x", "mm", role="displacement"), State("v", "mm/s", role="velocity")],
        inputs=[Input("F", "N", role="drive")],
        outputs=[Output("x", "mm")],
        parameters=[
            # 5 kg of piston and clamp: less is too fast for 100 Hz, and its inertia is a hundredth of the force.
            Parameter("M", "N*s^2/mm", 0.005, fixed=True, role="mass"),
            Parameter("c", "N*s/mm", 1.0, (1e-4, 100.0), role="damping"),
            Parameter("K", "N/mm", 0.1, (-10.0, 100.0)),
            Parameter("F0", "N", 0.0, (-1e3, 1e3)),
        ],
        balances=lambda x, u, p: [
            Balance("motion", "mm/s", 1, "x", v=x.v),
            Balance("force", "N", p.M, "v", drive=u.F, damping=-p.c * x.v, spring=-p.K * x.x, offset=-p.F0),
        ],
    )


def table(path: Path) -> np.ndarray:
    """The columns of a CSV file with one line of names."""
    return np.genfromtxt(path, delimiter=",", skip_header=1).T


def ball(path: Path) -> gb.Experiment:
    """One fall."""
    t, h, *_ = table(path)
    return gb.Experiment(path.stem, t, {}, {"h": h})


def rosa(path: Path) -> gb.Experiment:
    """One run of the rotor, effort in per cent read as volts."""
    t, _, speed, effort, *_ = table(path)
    return gb.Experiment(path.stem, t, {"u": effort}, {"w": speed * np.pi / 30})


def swing(path: Path) -> gb.Experiment:
    """One swing-up."""
    t, q, _, tau = table(path)
    return gb.Experiment(path.stem, t, {"tau": tau}, {"q": q})


def heating(path: Path) -> gb.Experiment:
    """One heating experiment, 10 mW a per cent."""
    t, q1, q2, t1, t2 = table(path)
    return gb.Experiment(path.stem, t, {"Q1": 0.01 * q1, "Q2": 0.01 * q2}, {"T1": t1 + 273.15, "T2": t2 + 273.15})


def shaken(path: Path) -> gb.Experiment:
    """One run of the damper, its velocity from differences of the displacement."""
    t, x, force = table(path)
    return gb.Experiment(path.stem, t, {"v": np.gradient(x, t)}, {"F": force}).window(0, 1500)


def pushed(path: Path) -> gb.Experiment:
    """The same run, the force as its input."""
    t, x, force = table(path)
    return gb.Experiment(path.stem, t, {"F": force}, {"x": x}).window(0, 1500)


def by_header(path: Path) -> gb.Experiment:
    """A record with the names of the model in its first line."""
    return gb.read_csv(path, plain(path))


def plain(path: Path) -> Model:
    """The plain model that lies beside a record."""
    return next(v for v in vars(load_model_file(path.parent / "plain.py")).values() if isinstance(v, Model))


FRICTION = family_of("coulomb_friction")
TIMING = ("transport_delay", "drive_lag", "valve_lag", "sensor_lag")


@dataclass(frozen=True)
class Fact:
    """Something that a plain model is known to lack: where (labels of sites), as a function of what, and the names it may be given."""

    sites: tuple[str, ...]
    variables: tuple[str, ...]
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Rig:
    """A rig and what is known of it.

    ``has`` and ``lacks`` are parts that anybody knows who stands before the rig.
    ``facts`` are true. Of a rig that is known whole (``is_whole``) whatever is claimed beside them is false, but for the effects in
    ``open``; of any other nobody knows, but that those in ``false`` are not there. A whole rig without facts lacks nothing.
    """

    folder: str
    read: Callable[[Path], gb.Experiment]
    model: Callable[[Path], Model]
    facts: tuple[Fact, ...] = ()
    open: tuple[str, ...] = ()
    false: tuple[str, ...] = ()
    is_whole: bool = False
    has: tuple[str, ...] = ()
    lacks: tuple[str, ...] = ()

    @property
    def is_in_catalogue(self) -> bool:
        """Whether an effect of the catalogue is a right name."""
        return any(fact.names for fact in self.facts)

    def record(self, root: Path, stretch: str) -> gb.Experiment:
        """``FILE`` or ``FILE FIRST END``: a record, or these rows of it."""
        file, *bounds = stretch.split()
        record = self.read(root / self.folder / f"{file}.csv")
        return record.window(int(bounds[0]), min(int(bounds[1]), record.rows)) if bounds else record


def always(model: Callable[[], Model]) -> Callable[[Path], Model]:
    """The same model wherever the records lie."""
    return lambda path: model()


LEVEL = ("balance lower_level", "sensor of y")

RIGS = {
    # Drag of the size that mass and circumference give. The scale of the video bends too, by a tenth of that.
    "light ball": Rig(
        "known/ball_drops",
        ball,
        always(falling_ball),
        facts=(Fact(("balance force",), ("v",), ("quadratic_damping",)),),
        open=("reading_curve",),
        is_whole=True,
        has=("free", "fluid", "video"),
        lacks=("analogue",),
    ),
    # The drag is within the errors of the video: any certain word names the camera.
    "heavy ball": Rig(
        "known/ball_drops",
        ball,
        always(falling_ball),
        is_whole=True,
        has=("free", "fluid", "video"),
        lacks=("analogue",),
    ),
    # The brake is switched while the record runs: no effect of the catalogue, but more damping at certain times.
    "braked rotor": Rig(
        "known/rosa_rotor",
        rosa,
        always(rotor),
        facts=(Fact(("balance torque", "input u"), ("w", TIME)),),
        open=("input_dead_zone", "drive_lag", "sensor_lag", "linear_input", "transport_delay"),
        is_whole=True,
        has=("motor", "contact"),
        lacks=("elastic", "spring", "rubber", "hysteretic", "magnets", "stop", "weight", "analogue"),
    ),
    "healthy rotor": Rig(
        "known/rosa_rotor",
        rosa,
        always(rotor),
        is_whole=True,
        has=("motor", "contact"),
        lacks=("elastic", "spring", "rubber", "hysteretic", "magnets", "stop", "weight", "analogue"),
    ),
    # Published friction of the same rig; the torque reads 1.13 to 1.2 times too large for the weighed constants.
    "pendulum": Rig(
        "known/ak80_pendulum",
        swing,
        always(pendulum),
        facts=(Fact(("balance torque", "input tau"), ("w",), ("coulomb_friction", "load_dependent_friction")),),
        open=(
            "stribeck_friction",
            "lugre_friction",
            "asymmetric_friction",
            "constant_load",
            "input_offset",
            "backlash",
        ),
        is_whole=True,
        has=("motor", "gear", "encoder"),
        lacks=("fluid", "spring", "rubber", "hysteretic", "magnets", "stop", "voice_coil"),
    ),
    # The sensor sits on a pad; heat goes over from heater to heater. Radiation is there, and convection does the same: never certain.
    "heaters": Rig(
        "known/tclab",
        heating,
        always(heaters),
        facts=(
            Fact(("sensor of T1",), ("T1",), ("sensor_lag",)),
            Fact(("sensor of T2",), ("T2",), ("sensor_lag_at_T2",)),
            Fact(("balance heat_1", "balance heat_2"), ("T1", "T2")),
        ),
        open=("natural_convection", "heat_storage"),
        is_whole=True,
        has=("actuator", "second_body", "slow_sensor"),
    ),
    # The fluid yields before it flows: a hysteresis with presliding, more of it with the field; a step at zero speed alone is wrong. Where
    # the force is the output there is no balance for a friction of the catalogue to act in.
    "damper": Rig(
        "known/mr_damper_utfpr",
        shaken,
        always(damper),
        facts=(Fact(("sensor of F", "input v"), ("v",)),),
        is_whole=True,
    ),
    "pushed damper": Rig(
        "known/mr_damper_utfpr",
        pushed,
        always(pushed_damper),
        facts=(Fact(("balance force", "input F"), ("v",), ("bouc_wen_hysteresis", "lugre_friction")),),
        is_whole=True,
        has=("hysteretic", "contact"),
        lacks=("gear", "motor", "magnets", "voice_coil"),
    ),
    "hydraulic motor": Rig(
        "hydraulic_motor",
        by_header,
        plain,
        facts=(
            Fact(("balance force", "input u"), ("u", "y"), ("input_hysteresis", "input_saturation", "soft_saturation")),
        ),
        false=("second_mode", "sensor_drift"),
        has=("valve", "seal"),
        lacks=("motor", "magnets", "spring", "rubber"),
    ),
    "hanging load": Rig(
        "hanging_load",
        by_header,
        plain,
        facts=(Fact(("balance force", "input u"), ("u", "v"), ("gain_by_sign", "directional_damping")),),
        false=("second_mode", "sensor_drift"),
        has=("valve", "seal", "single_rod", "weight"),
        lacks=("motor", "magnets"),
    ),
    "two cylinders": Rig(
        "two_cylinders",
        by_header,
        plain,
        facts=(
            Fact(("balance loop_1", "input r1"), ("r1",), ("input_offset", *TIMING)),
            Fact(("balance loop_2", "input r2"), ("r2",), ("input_offset_at_r2", *(f"{n}_at_r2" for n in TIMING))),
        ),
        false=("second_mode", "sensor_drift"),
        has=("valve", "seal", "link"),
    ),
    "tacho": Rig(
        "dc_motor_tacho",
        by_header,
        plain,
        facts=(
            Fact(("balance force", "input u"), ("u",), ("input_dead_zone",)),
            Fact(("sensor of y",), ("y",), ("sensor_saturation",)),
        ),
        false=("second_mode", "sensor_drift"),
        has=("motor", "analogue", "contact"),
        lacks=("fluid", "magnets", "spring"),
    ),
    "EMPS": Rig(
        "emps",
        lambda path: gb.read_csv(path, emps),
        always(lambda: emps),
        facts=(
            Fact(
                ("balance force", "input u"), ("v",), ("coulomb_friction", "asymmetric_friction", "directional_damping")
            ),
        ),
        open=("constant_load", "input_offset"),
        false=("second_mode", "sensor_lag"),
        has=("motor", "gear", "encoder"),
        lacks=("fluid",),
    ),
    "silverbox": Rig(
        "silverbox",
        lambda path: gb.read_csv(path, silverbox),
        always(lambda: silverbox),
        facts=(
            Fact(("balance force", "input u"), ("y",), ("cubic_stiffness", "quadratic_stiffness")),
            Fact(
                ("balance force", "input u"), ("y", "v"), ("displacement_damping", "cubic_damping", "quadratic_damping")
            ),
            Fact(("balance force", "input u"), ("u",), ("band_limited_input", "linear_input", "input_offset")),
        ),
        false=("viscoelastic_creep", "sensor_drift"),
        has=("spring",),
        lacks=("contact",),
    ),
    "tanks": Rig(
        "cascaded_tanks",
        lambda path: gb.read_csv(path, cascaded_tanks),
        always(lambda: cascaded_tanks),
        facts=(
            Fact(("balance upper_level", "input u"), ("x1",), ("upper_overflow",)),
            Fact(LEVEL, ("x2",), ("lower_overflow", "reading_curve", "sensor_saturation")),
        ),
        false=("sensor_drift",),
        has=("analogue",),
    ),
}


@dataclass(frozen=True)
class Case:
    """A search: the rig, and the stretches of records from which it learns, by which it chooses and on which its answer is judged."""

    rig: str
    learn: str
    choose: str
    judge: str


def falls(rig: str, name: str, other: str) -> list[Case]:
    """Learn from one fall of a ball, choose by the other, and the other way about; judge on a ball of the same kind."""
    first, second = f"{name}_drop1", f"{name}_drop2"
    return [Case(rig, first, second, f"{other}_drop1"), Case(rig, second, first, f"{other}_drop2")]


def thirds(rig: str, file: str, rows: int) -> list[Case]:
    """Each third of a record once to learn from, once to choose by, once to judge on."""
    parts = [f"{file} {rows * k // 3} {rows * (k + 1) // 3}" for k in range(3)]
    return [Case(rig, *(parts[(k + shift) % 3] for k in range(3))) for shift in range(3)]


def rotations(rig: str, *names: str) -> list[Case]:
    """Three records, each once to learn from, once to choose by, once to judge on."""
    return [Case(rig, *(names[(k + shift) % 3] for k in range(3))) for shift in range(3)]


def halves(rig: str, train: str, test: str, rows: int) -> Case:
    """Learn from the first half of a record, choose by the second, judge on the test record."""
    return Case(rig, f"{train} 0 {rows}", f"{train} {rows} {2 * rows}", f"{test} 0 {2 * rows}")


PAIRS = {
    "light ball": {
        "tennis_ball": "yellow_whiffle_ball",
        "whiffle_ball_1": "whiffle_ball_2",
        "whiffle_ball_2": "whiffle_ball_1",
        "yellow_whiffle_ball": "orange_whiffle_ball",
        "orange_whiffle_ball": "yellow_whiffle_ball",
        "blue_basketball": "green_basketball",
        "green_basketball": "blue_basketball",
        "volleyball": "tennis_ball",
    },
    "heavy ball": {"bowling_ball": "baseball", "baseball": "golf_ball", "golf_ball": "bowling_ball"},
}
FALLS = [falls(rig, name, other) for rig, pairs in PAIRS.items() for name, other in pairs.items()]
# Rows of the runs of the rotor, the shortest has 943.
RUN = 900
SEARCHES: tuple[Case, ...] = (
    *(case for case, _ in FALLS),
    *thirds("healthy rotor", "healthy_101", 1980),
    *rotations("braked rotor", *(f"damping_{k} 0 {RUN}" for k in (400, 401, 405))),
    Case("pendulum", "direct_collocation", "ddp", "ilqr_torque_limited"),
    Case("pendulum", "ddp", "direct_collocation", "ilqr_torque_limited"),
    Case("pendulum", "ddp 0 1500", "ddp 1500 3000", "direct_collocation"),
    # Three boards, each with constants of its own: within a record, and judged on another board where there is no third stretch.
    *thirds("heaters", "c", 597),
    Case("heaters", "a 0 100", "a 100 201", "b"),
    Case("heaters", "b 0 100", "b 100 201", "a"),
    Case("damper", "0V_ensaio1.1", "0V_ensaio4.1", "0V_ensaio8.1"),
    Case("damper", "0.871V_ensaio1.2.2 0 750", "0.871V_ensaio1.2.2 750 1500", "0.871V_ensaio4.2.2"),
    Case("damper", "1.98V_ensaio.B.1 0 750", "1.98V_ensaio.B.1 750 1500", "1.98V_ensaio.B.6"),
    Case("damper", "3.21V_ensaio.A.1", "3.21V_ensaio.A.4", "3.21V_ensaio.A.8"),
    Case("pushed damper", "0V_ensaio1.1", "0V_ensaio4.1", "0V_ensaio8.1"),
    Case("pushed damper", "3.21V_ensaio.A.1", "3.21V_ensaio.A.4", "3.21V_ensaio.A.8"),
    Case("pushed damper", "1.98V_ensaio.B.1 0 750", "1.98V_ensaio.B.1 750 1500", "1.98V_ensaio.B.6"),
    halves("two cylinders", "train", "test", 700),
    halves("tacho", "prbs500_train", "prbs500_test", 600),
    halves("hydraulic motor", "train", "test", 1500),
    halves("hanging load", "train", "test", 1500),
    halves("tanks", "train", "test", 512),
    Case("silverbox", "train_multisine 0 2000", "train_multisine 2000 4000", "test_multisine 0 4000"),
    # One of the four repetitions each: 0.1 N of offset is a centimetre after 24 s.
    Case("EMPS", "train 0 6210", "train 12420 18630", "test 0 6210"),
    *rotations("braked rotor", *(f"damping_{k} 0 {RUN}" for k in (408, 410, 411))),
    *(case for _, case in FALLS),
)
