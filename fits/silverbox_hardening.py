"""Which stiffness does the silverbox circuit have, and what does the input do between samples?

Data: the silverbox records (Wigren, Schoukens 2013), not part of this project; give their folder:
``python -m fits.silverbox_hardening FOLDER`` with ``train_multisine.csv``, ``test_multisine.csv`` and ``test_arrow.csv``.

A mass on a hardening spring: cubic stiffness, a small quadratic one and an input offset take the error from about 8 mV to
below 1 mV. What is left is mostly the input: it is a band-limited signal, here taken as linear between samples.
"""

from __future__ import annotations

import sys
from pathlib import Path

import greybox as gb
from fits import data_folder
from models.silverbox import silverbox

RECORDS = ("train_multisine", "test_multisine", "test_arrow")
EFFECTS = ("cubic_stiffness", "quadratic_stiffness", "input_offset")


def study(folder: Path) -> tuple[gb.Fit, dict[str, float], dict[str, float]]:
    """The fit of the hardening model, and free-run errors (V) on the test records: of the linear model and of this one."""
    read = {name: gb.read_csv(folder / f"{name}.csv", silverbox, hold="first") for name in RECORDS}
    arrow = read["test_arrow"]
    tests = {"multisine": read["test_multisine"], "arrow": arrow, "arrow without extrapolation": arrow.window(0, 32000)}
    hardening = silverbox
    for name in EFFECTS:
        hardening = hardening + gb.effect(name)
    linear, fitted = (gb.fit(model, read["train_multisine"]) for model in (silverbox, hardening))
    errors = [
        {name: gb.validate(f.model, record, skip=50).misfit["y"].rmse for name, record in tests.items()}
        for f in (linear, fitted)
    ]
    return fitted, errors[0], errors[1]


def verdict(fitted: gb.Fit, linear: dict[str, float], hardening: dict[str, float]) -> None:
    """Below a millivolt on all three test records."""
    for name, most in {"multisine": 0.95e-3, "arrow": 1.0e-3, "arrow without extrapolation": 0.8e-3}.items():
        assert hardening[name] <= most < linear[name], name
    assert fitted.parameters["K3"].interval is not None and fitted.parameters["K3"].interval[0] > 0


if __name__ == "__main__":
    result = study(data_folder("silverbox_hardening", *(f"{name}.csv" for name in RECORDS)))
    sys.stdout.write(f"{result[0]}\n")
    for name in result[1]:
        sys.stdout.write(f"{name}: linear {1e3 * result[1][name]:.2f} mV, hardening {1e3 * result[2][name]:.3f} mV\n")
    verdict(*result)
