"""From a fit.json to the fit: its model found by the name that the file holds."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from greybox.errors import DataError, ModelError

if TYPE_CHECKING:
    from greybox.model import Model
    from greybox.result import Fit


def load_fit_with_model(path: Path, model: str | None = None) -> Fit:
    """The fit in ``path``. ``model`` names its model or model file (None: the name that the file holds).

    Effects of the catalogue that the fit has and the model lacks are added. Raises DataError for a file that is no fit, ModelError
    where its model cannot be found.
    """
    from greybox.effects import effect
    from greybox.project import find_model
    from greybox.result import load_fit

    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "not JSON"
        raise DataError(f"{path}: not a readable fit ({why}); give the fit.json that greybox fit has written") from None
    if not (isinstance(data, dict) and isinstance(data.get("model"), str) and isinstance(data.get("effects"), list)):
        raise DataError(f"{path}: not a fit of this program; give the fit.json that greybox fit has written")
    try:
        plant: Model = find_model(model or data["model"])
        present = [e.name for e in plant.effects]
        for name in data["effects"]:
            plant = plant if name in present else plant + effect(name)
    except ModelError as error:
        raise ModelError(f"{path}: its model cannot be found: {error}; name its file with --model my/rig.py") from None
    return load_fit(path, plant)
