"""A rig with friction that its model lacks, recorded twice, and a session on it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import greybox as gb
from greybox.simulation.simulate import write_csv

PLANT = '''"""A carriage on a slide, pushed by a force."""

from greybox import Balance, Input, Model, Output, Parameter, State

carriage = Model(
    "carriage",
    [State("v", "m/s", role="velocity")],
    [Input("f", "N", role="force")],
    [Output("v", "m/s")],
    [
        Parameter("M", "kg", 1.0, (0.01, 100.0), fixed=True, description="moved mass"),
        Parameter("B", "N*s/m", 2.0, (1e-3, 100.0), description="viscous damping"),
    ],
    lambda x, u, p: [Balance("force", "N", p.M, "v", drive=u.f, damping=-p.B * x.v)],
)
'''
NOISE = {"v": 2e-3}


@pytest.fixture(scope="session")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the model file, ``train.csv`` and ``test.csv``: the rig has Coulomb friction of 0.5 N and B = 1.5."""
    folder = tmp_path_factory.mktemp("rig")
    (folder / "carriage.py").write_text(PLANT, encoding="utf-8")
    from greybox.shell.project import find_model

    plain = find_model(str(folder / "carriage.py"))
    real = (plain + gb.effect("coulomb_friction")).start(B=1.5, Fc=0.5)
    time = 0.02 * np.arange(300)
    for k, name in enumerate(("train", "test")):
        force = 3 * np.sin((2 + k) * time) + np.sign(np.sin((5 - k) * time))
        run = gb.simulate(real, gb.Experiment(name, time, {"f": force}, {}))
        write_csv(run.record(NOISE, np.random.default_rng(k)), plain, folder / f"{name}.csv")
    return folder
