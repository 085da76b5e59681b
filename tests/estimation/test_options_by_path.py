"""Every option of a fit changes its result in every way of fitting, or is refused there in one sentence that names it."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Experiment, FitOptions, Input, Model, Output, Parameter, State
from greybox.base import DataError, ModelError
from greybox.estimation.score import score_fit

pytestmark = pytest.mark.rest

TIME = 0.05 * np.arange(60)
TRUE = {"M": 0.7, "D": 1.5, "K": 30.0, "K3": 40.0}

mass = Model(
    "mass",
    states=[State("x", "m"), State("v", "m/s")],
    inputs=[Input("F", "N")],
    outputs=[Output("x", "m"), Output("again", "m", lambda x, u, p: x.x)],
    parameters=[
        Parameter("M", "kg", 0.7, (1e-2, 1e2), fixed=True),
        Parameter("D", "N*s/m", 1.3, (1e-3, 1e2)),
        Parameter("K", "N/m", 28.0, (1e-1, 1e3)),
        Parameter("K3", "N/m^3", 40.0, (1e-3, 1e4), fixed=True),
    ],
    balances=lambda x, u, p: [
        Balance("position", "m/s", 1.0, "x", v=x.v),
        Balance("force", "N", p.M, "v", drive=u.F, damping=-p.D * x.v, spring=-p.K * x.x, cubic=-p.K3 * x.x**3),
    ],
)


class Rig:
    """The same equations as something that is run from outside."""

    name = "rig"
    inputs, states = mass.inputs, mass.states
    outputs = tuple(Output(o.name, o.unit) for o in mass.outputs)
    parameters = tuple(q for q in mass.parameters if not q.fixed)
    cheap = True

    def simulate(self, record: Experiment, values: dict[str, float]) -> dict[str, np.ndarray]:
        own = {name: values[name] for name in ("D", "K")}
        begin = {name: values.get(name, 0.0) for name in ("x", "v")}
        return dict(gb.simulate(mass.start(**own), record, initial=begin, substeps=4).outputs)


PATHS: dict[str, tuple[Any, dict[str, Any]]] = {
    "free run": (mass, {}),
    "segments": (mass, {"transcription": "multiple"}),
    "collocation": (mass, {"transcription": "collocation-radau"}),
    "arcs": (mass, {"arc_length": 2.0}),
    "filter": (mass.with_process_noise(v=0.3), {}),
    "plant": (Rig(), {}),
}
OPTIONS: dict[str, dict[str, Any]] = {
    "method": {"method": "midpoint"},
    "substeps": {"substeps": 2},
    "loss": {"loss": "huber:1"},
    "at_rest": {"at_rest": True},
    "common_noise": {"common_noise": True},
    "per_experiment": {"per_experiment": ("K",)},
    "transcription": {"transcription": "multiple"},
    "arc_length": {"arc_length": 1.0},
    "hold": {},
    "mean": {},
}
HOLDS = {"hold": "first", "mean": "mean"}
REFUSED = {
    ("collocation", "method"),
    ("collocation", "arc_length"),
    ("segments", "arc_length"),
    ("arcs", "at_rest"),
    ("arcs", "transcription"),
    ("filter", "loss"),
    ("filter", "transcription"),
    ("filter", "arc_length"),
    ("filter", "common_noise"),
    *(("plant", name) for name in ("method", "substeps", "transcription", "arc_length", "mean")),
}


@cache
def records(hold: str) -> tuple[Experiment, ...]:
    rng = np.random.default_rng(3)
    made = []
    for k in range(2):
        force = 8 * np.sin(2.1 * TIME + k) + 5 * np.sin(5.3 * TIME)
        run = gb.simulate(mass.start(D=TRUE["D"], K=TRUE["K"]), {"time": TIME, "F": force}, initial={"x": 0.05})
        noise = {"x": 0.004, "again": 0.02}
        outputs = {n: run.outputs[n] + s * rng.standard_t(3, len(TIME)) for n, s in noise.items()}
        made.append(Experiment(f"run {k}", TIME, {"F": force}, outputs, hold))  # type: ignore[arg-type]
    return tuple(made)


@cache
def constants(path: str, option: str = "") -> tuple[float | str, ...]:
    model, base = PATHS[path]
    fit = gb.fit(
        model,
        records(HOLDS.get(option, "zero")),
        options=FitOptions(**{**base, **OPTIONS.get(option, {})}),
    )
    assert fit.success
    # Another transcription ends at the same optimum: there it shows by its name.
    ways = [str(fit.solver.statistics["transcription"])] if option in ("", "transcription") else []
    return (*(fit.parameters[n].value for n in ("D", "K")), *ways)


@pytest.mark.crossed(3)
@pytest.mark.parametrize("path", PATHS)
def test_the_rows_of_a_validation_record_and_the_samples_ahead_count_everywhere(path: str) -> None:
    model, base = PATHS[path]
    (fitted, judge), options = records("zero"), FitOptions(**base)
    # The same constants each time: what is left out of a validation record changes nothing else.
    plain, skipped, begun = (
        gb.fit(model, fitted, validation=judge, options=options, **left_out)
        for left_out in ({}, {"skip": 40}, {"beginning": 40})
    )
    assert skipped.parameters["K"].value == begun.parameters["K"].value == plain.parameters["K"].value
    for name, misfit in skipped.validation.misfit.items():
        assert misfit.samples == plain.validation.misfit[name].samples - 40
        assert begun.validation.misfit[name].rmse == pytest.approx(misfit.rmse, rel=1e-6)
        assert plain.validation.misfit[name].rmse != pytest.approx(misfit.rmse, rel=1e-3)
    _, whole = score_fit(plain, (judge,), steps=[1, 5])
    _, scores = score_fit(plain, (judge,), steps=[1, 5], skip=40)
    for name, score in scores.outputs.items():
        assert score.samples == whole.outputs[name].samples - 40
        assert set(score.ahead) == {1, 5} and np.isfinite(list(score.ahead.values())).all()
        # Of free runs whose error is white nothing is corrected; a filter forgets what it was told five samples ago.
        assert (score.ahead[1] == score.ahead[5]) == (path != "filter")


@pytest.mark.crossed(3)
@pytest.mark.parametrize("option", OPTIONS)
@pytest.mark.parametrize("path", PATHS)
def test_an_option_works_or_is_refused(path: str, option: str) -> None:
    if PATHS[path][1].items() & OPTIONS[option].items():
        return
    if (path, option) in REFUSED:
        with pytest.raises((DataError, ModelError), match=option):
            constants(path, option)
        return
    found, plain = constants(path, option), constants(path)
    if option == "transcription":
        assert found[-1] == "multiple" != plain[-1]
    else:
        # Four digits beyond what a search leaves open.
        assert found[:2] != pytest.approx(plain[:2], rel=1e-7)
