"""Does the model that `discover` writes give, refitted, the errors that the search named?

Every search is written as a user's would be (``model.py``), read back, fitted to the same records and judged on a record that took no
part, beside the answer of the search itself and the plain model. Measured records of public rigs, none of them part of this project:

    python -m fits.round_trip FOLDER [--output RESULTS] [--case NAME]

with the rigs' folders below FOLDER. Finished cases are kept in RESULTS (a JSON file each), so that the study continues where it was
stopped. What to expect: the refit leaves the same error within 1 % in every case, on its own records and on the one that judges.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import process_time

import casadi as ca
import numpy as np

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.discovery.findings import DiscoveryCode
from greybox.estimation.result_parts import Misfit
from greybox.estimation.validate import validate
from greybox.shell.project import load_model_file

SAME = 0.01
"""Share by which two errors may differ and still be the same."""


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
    """A rotor with a drive of unknown strength, per moment of inertia."""
    return Model(
        "rotor",
        states=[State("w", "rad/s", role="velocity")],
        inputs=[Input("u", "V", role="drive")],
        outputs=[Output("w", "rad/s")],
        parameters=[
            Parameter("kt", "rad/(s^2*V)", 3.0, (1e-3, 1e4)),
            Parameter("b", "1/s", 1.0, (1e-4, 1e3), role="damping"),
        ],
        balances=lambda x, u, p: [Balance("torque", "rad/s^2", 1, "w", drive=p.kt * u.u, damping=-p.b * x.w)],
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


@dataclass(frozen=True)
class Case:
    """Records to learn from, to choose by and to judge on, and the plain model."""

    model: Callable[[Path], Model]
    train: Callable[[Path], gb.Experiment]
    choose: Callable[[Path], gb.Experiment]
    judge: Callable[[Path], gb.Experiment]


def table(path: Path) -> np.ndarray:
    """The columns of a CSV file with one line of names."""
    return np.genfromtxt(path, delimiter=",", skip_header=1).T


def rows(record: gb.Experiment, first: int, end: int) -> gb.Experiment:
    """Rows ``first`` to ``end`` as a record of their own."""
    return record.window(first, min(end, record.rows))


def ball(name: str, root: Path) -> gb.Experiment:
    """One fall."""
    t, h, *_ = table(root / "known" / "ball_drops" / f"{name}.csv")
    return gb.Experiment(name, t, {}, {"h": h})


def rosa(name: str, root: Path) -> gb.Experiment:
    """One run of the rotor, effort in per cent read as volts."""
    t, _, speed, effort, *_ = table(root / "known" / "rosa_rotor" / f"{name}.csv")
    return rows(gb.Experiment(name, t, {"u": effort}, {"w": speed * np.pi / 30}), 0, 900)


def swing(name: str, root: Path) -> gb.Experiment:
    """One swing-up."""
    t, q, _, tau = table(root / "known" / "ak80_pendulum" / f"{name}.csv")
    return gb.Experiment(name, t, {"tau": tau}, {"q": q})


def heating(name: str, root: Path) -> gb.Experiment:
    """One heating experiment, 10 mW a per cent."""
    t, q1, q2, t1, t2 = table(root / "known" / "tclab" / f"{name}.csv")
    return gb.Experiment(name, t, {"Q1": 0.01 * q1, "Q2": 0.01 * q2}, {"T1": t1 + 273.15, "T2": t2 + 273.15})


def shaken(name: str, root: Path) -> gb.Experiment:
    """One run of the damper, its velocity from differences of the displacement."""
    t, x, force = table(root / "known" / "mr_damper_utfpr" / f"{name}.csv")
    return rows(gb.Experiment(name, t, {"v": np.gradient(x, t)}, {"F": force}), 0, 1500)


def everyday(folder: str, file: str, first: int, end: int, root: Path) -> gb.Experiment:
    """A stretch of a record of an everyday rig: time, inputs, outputs by their header."""
    record = gb.read_csv(root / folder / file, plain(folder, root))
    record = record[0] if isinstance(record, (list, tuple)) else record
    return rows(record, first, end)


def plain(folder: str, root: Path) -> Model:
    """The plain model that lies beside the records."""
    return next(
        value for value in vars(load_model_file(root / folder / "plain.py")).values() if isinstance(value, Model)
    )


def balls(name: str, other: str) -> Case:
    """Learn from one fall, choose by the second, judge on another ball's."""
    return Case(
        lambda _: falling_ball(), partial(ball, f"{name}_drop1"), partial(ball, f"{name}_drop2"), partial(ball, other)
    )


def of(model: Callable[[], Model], read: Callable[[str, Path], gb.Experiment], *names: str) -> Case:
    """Three records of one rig."""
    return Case(lambda _: model(), *(partial(read, name) for name in names))


def halves(folder: str, train: str, test: str, count: int) -> Case:
    """Learn from the first half of a record, choose by the second, judge on the test record."""
    read = partial(everyday, folder)
    return Case(
        partial(plain, folder),
        partial(read, train, 0, count),
        partial(read, train, count, 2 * count),
        partial(read, test, 0, 2 * count),
    )


CASES = {
    "tennis": balls("tennis_ball", "yellow_whiffle_ball_drop1"),
    "whiffle": balls("whiffle_ball_1", "whiffle_ball_2_drop1"),
    "golf": balls("golf_ball", "baseball_drop1"),
    "basketball": balls("blue_basketball", "green_basketball_drop1"),
    "rotor": of(rotor, rosa, "damping_400", "damping_401", "damping_405"),
    "healthy": of(rotor, rosa, "healthy_101", "damping_408", "damping_411"),
    "pendulum": of(pendulum, swing, "direct_collocation", "ddp", "ilqr_torque_limited"),
    "heaters": of(heaters, heating, "a", "b", "c"),
    "damper": of(damper, shaken, "0V_ensaio1.1", "0V_ensaio4.1", "0V_ensaio8.1"),
    "damper on": of(damper, shaken, "3.21V_ensaio.A.1", "3.21V_ensaio.A.4", "3.21V_ensaio.A.8"),
    "two cylinders": halves("two_cylinders", "train.csv", "test.csv", 700),
    "tacho": halves("dc_motor_tacho", "prbs500_train.csv", "prbs500_test.csv", 600),
    "hydraulic motor": halves("hydraulic_motor", "train.csv", "test.csv", 1500),
    "hanging load": halves("hanging_load", "train.csv", "test.csv", 1500),
}


def study(name: str, root: Path, folder: Path) -> dict[str, object]:
    """One case: search, write, read back, refit, judge."""
    case = CASES[name]
    began = process_time()
    model, train, choose, judge = case.model(root), case.train(root), case.choose(root), case.judge(root)
    found = gb.discover(model, train, validation=choose)
    searched = process_time() - began
    file = gb.export.to_python(found.extended, folder / f"{name.replace(' ', '_')}_model.py")
    written = next(value for value in vars(load_model_file(file)).values() if isinstance(value, Model))
    refit = gb.fit(written, train)
    fits = {"plain": found.base, "answer": found.extended, "refit": refit}
    errors = {
        who: {
            "train": rms(fit.misfit),
            "choose": rms(validate(fit.model, choose, noise=fit.noise.std).misfit),
            "judge": rms(validate(fit.model, judge, noise=fit.noise.std).misfit),
        }
        for who, fit in fits.items()
    }
    return {
        "verdict": str(found.verdict),
        "effects": [f"{e['name']} ({e['grade']})" for e in found.effects],
        "written": [e.name for e in written.effects],
        "status": refit.solver.status,
        "said": [str(f) for f in found.findings if f.code == DiscoveryCode.REFIT_ELSEWHERE],
        "errors": errors,
        "seconds": searched,
        "story": " ".join(map(str, found.conclusion)),
    }


def rms(misfit: Mapping[str, Misfit]) -> dict[str, float]:
    """Root-mean-square error by output."""
    return {output: m.rmse for output, m in misfit.items()}


def worst_ratio(result: dict[str, dict[str, dict[str, dict[str, float]]]], where: str) -> float:
    """The refit's error over the answer's, of the output where it differs most."""
    answer, refit = (result["errors"][who][where] for who in ("answer", "refit"))
    return max((refit.get(o, np.inf) / answer[o] for o in answer), key=lambda r: abs(np.log(r)))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the cases that are not done yet, then print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--case", action="append", choices=list(CASES), dest="cases")
    parser.add_argument("--output", type=Path, default=Path("results/round_trip"))
    given = parser.parse_args(arguments)
    given.output.mkdir(parents=True, exist_ok=True)
    for name in given.cases or CASES:
        file = given.output / f"{name.replace(' ', '_')}.json"
        if not file.exists():
            sys.stderr.write(f"{name}\n")
            file.write_text(json.dumps(study(name, given.folder, given.output), indent=1))
    done = {n: json.loads(f.read_text()) for n in CASES if (f := given.output / f"{n.replace(' ', '_')}.json").exists()}
    sys.stdout.write(
        "| rig | verdict | effects | refit over answer: fitted, chosen by, judged | answer over plain: chosen by |\n"
    )
    sys.stdout.write("|---|---|---|---|---|\n")
    for name, result in done.items():
        ratios = ", ".join(f"{worst_ratio(result, where):.3f}" for where in ("train", "choose", "judge"))
        gain = {o: e / result["errors"]["plain"]["choose"][o] for o, e in result["errors"]["answer"]["choose"].items()}
        gains = ", ".join(f"{o} {g:.3f}" for o, g in gain.items())
        sys.stdout.write(f"| {name} | {result['verdict']} | {', '.join(result['written'])} | {ratios} | {gains} |\n")


if __name__ == "__main__":
    main()
