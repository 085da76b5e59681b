"""How far does Torricelli's law alone carry the cascaded tanks?

Data: the cascaded tanks records (Schoukens, Mattsson, Wigren, Noel 2016), not part of this project; give their folder:
``python -m fits.cascaded_tanks_base FOLDER`` with ``train.csv`` and ``test.csv``.

To about 0.69 V on the test record, thirty times the sensor's noise: the tanks overflow, and that is not in the model.
"""

from __future__ import annotations

import sys
from pathlib import Path

import greybox as gb
from fits import data_folder
from models.cascaded_tanks import cascaded_tanks


def study(folder: Path) -> gb.Fit:
    """The fit of the model without overflow."""
    train, test = (gb.read_csv(folder / name, cascaded_tanks) for name in ("train.csv", "test.csv"))
    return gb.fit(cascaded_tanks, train, validation=test, skip=50)


def verdict(fitted: gb.Fit) -> None:
    """Where the literature's first model is, and visibly incomplete."""
    assert 0.6 < fitted.validation.misfit["y"].rmse < 0.75
    # Over the level that it is weighed with; no more than a ceiling of the noise is known.
    assert fitted.misfit["y"].rmse > 10 * fitted.noise.std["y"]


if __name__ == "__main__":
    fit = study(data_folder("cascaded_tanks_base", "train.csv", "test.csv"))
    sys.stdout.write(f"{fit}\n")
    verdict(fit)
