"""Linear models as files: MATLAB's .mat, JSON, NumPy's .npz, and a Python file that makes a `control.StateSpace`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from greybox.export.identifiers import to_identifiers
from greybox.export.linearisation import Linearisation
from greybox.export.model_family import ModelFamily
from greybox.export.plant import Plant
from greybox.export.python_text import docstring, literal
from greybox.export.summary import format_behaviour
from greybox.result import format_json, to_json_data

FORMAT = 1


def write_json(
    model: Linearisation, path: str | Path, *, plant: Plant | None = None, family: ModelFamily | None = None
) -> Path:
    """Write ``model`` as JSON, every number to the last digit; ``plant`` adds where it comes from, ``family`` its members."""
    return _written(Path(path).with_suffix(".json"), (format_json(to_data(model, plant, family)) + "\n").encode())


def to_data(model: Linearisation, plant: Plant | None = None, family: ModelFamily | None = None) -> dict[str, Any]:
    """What `write_json` writes."""
    data = {"format": FORMAT, **_contents(model), **_channels(model), **_origin(plant), **_members(family)}
    return dict(to_json_data(data))


def write_npz(
    model: Linearisation, path: str | Path, *, plant: Plant | None = None, family: ModelFamily | None = None
) -> Path:
    """Write ``model`` as arrays of NumPy (``A``, ``B``, ``C``, ``D``, ``dt``, names ...), the members of a family as ``family_A`` ..."""
    target = Path(path).with_suffix(".npz")
    target.parent.mkdir(parents=True, exist_ok=True)
    contents = _contents(model) | _origin(plant)
    arrays = {key: np.asarray(value) for key, value in contents.items() if not isinstance(value, Mapping)}
    arrays |= _tables(contents)
    arrays |= {f"family_{key}": np.asarray(value) for key, value in _members(family).get("family", {}).items()}
    np.savez(target, allow_pickle=False, **arrays)
    return target


def write_mat(
    model: Linearisation, path: str | Path, *, plant: Plant | None = None, family: ModelFamily | None = None
) -> Path:
    """Write ``model`` for MATLAB: ``A, B, C, D, Ts`` and the names and units that ``ss`` takes, as cell arrays.

    In MATLAB: ``m = load('plant.mat'); sys = ss(m.A, m.B, m.C, m.D, m.Ts, 'InputName', m.InputName, 'OutputName', m.OutputName,
    'StateName', m.StateName, 'InputDelay', m.InputDelay);``. ``Ts`` is 0 for a continuous model; ``family`` adds members as pages
    ``family.A(:, :, k)``.
    """
    from scipy.io import savemat

    values: dict[str, Any] = {
        "A": model.A, "B": model.B, "C": model.C, "D": model.D, "Ts": model.dt, "InputDelay": model.delay.reshape(-1, 1),
        "StateName": _cell(to_identifiers(model.state_names)), "InputName": _cell(to_identifiers(model.input_names)),
        "OutputName": _cell(to_identifiers(model.output_names)),
        "StateUnit": _cell(model.state_units), "InputUnit": _cell(model.input_units), "OutputUnit": _cell(model.output_units),
        "x0": model.x0.reshape(-1, 1), "u0": model.u0.reshape(-1, 1), "y0": model.y0.reshape(-1, 1), "rates": model.rates.reshape(-1, 1),
        "Name": model.name, "Method": model.method, "Notes": _cell(model.notes),
    }  # fmt: skip
    tables = _tables(_contents(model) | _origin(plant))
    for key in ("parameters", "covariance"):
        if f"{key}_names" in tables:
            values[f"{key}_names"] = _cell(tables[f"{key}_names"])
            values[f"{key}_values"] = tables[f"{key}_values"]
    if "origin" in (told := _origin(plant)):
        values["Origin"] = _cell(told["origin"])
    if family is not None:
        members = _members(family)["family"]
        pages = {key: np.moveaxis(np.asarray(members[key]), 0, -1) for key in ("A", "B", "C", "D")}
        values["family"] = pages | {
            "constants": members["constants"],
            "names": _cell(members["names"]),
            "seed": members["seed"],
        }
    target = Path(path).with_suffix(".mat")
    target.parent.mkdir(parents=True, exist_ok=True)
    savemat(target, values, do_compression=True, oned_as="column")
    return target


def write_control(model: Linearisation, path: str | Path, *, plant: Plant | None = None) -> Path:
    """Write a Python file that makes the ``control.StateSpace`` called ``plant``, matrices and names in plain sight."""
    target = Path(path).with_suffix(".py")
    lines = docstring(
        f"Linear model of {model.name} for python-control: from {target.stem} import plant.",
        [format_behaviour(model), list(plant.origin()) if plant else [], [f"Note: {note}" for note in model.notes]],
    )
    lines += ["", "import control", "import numpy as np", ""]
    for name in ("A", "B", "C", "D"):
        rows = [f"        [{', '.join(repr(float(v)) for v in row)}]," for row in getattr(model, name)]
        shape = f".reshape({getattr(model, name).shape})" if 0 in getattr(model, name).shape else ""
        lines += [f"{name} = np.array(", "    [", *rows, "    ]", f"){shape}"]
    units = {
        "state": dict(zip(to_identifiers(model.state_names), model.state_units, strict=True)),
        "input": dict(zip(to_identifiers(model.input_names), model.input_units, strict=True)),
        "output": dict(zip(to_identifiers(model.output_names), model.output_units, strict=True)),
    }
    for kind, table in units.items():
        lines.append(f"{kind}_units = {{{', '.join(f'{literal(n)}: {literal(u)}' for n, u in table.items())}}}")
    if model.delay.any():
        delays = dict(zip(to_identifiers(model.input_names), map(float, model.delay), strict=True))
        lines += [f"delay = {delays!r}  # s, not in the matrices"]
    names = ", ".join(f"{kind}s=list({kind}_units)" for kind in units)
    lines += [f"plant = control.ss(A, B, C, D, {model.dt!r}, {names})", ""]
    return _written(target, "\n".join(lines).encode())


def _contents(model: Linearisation) -> dict[str, Any]:
    return {
        "name": model.name, "A": model.A, "B": model.B, "C": model.C, "D": model.D, "dt": model.dt, "method": model.method,
        "state_names": model.state_names, "input_names": model.input_names, "output_names": model.output_names,
        "state_units": model.state_units, "input_units": model.input_units, "output_units": model.output_units,
        "x0": model.x0, "u0": model.u0, "y0": model.y0, "rates": model.rates, "delay": model.delay,
        "parameters": dict(model.parameters), "notes": model.notes,
    }  # fmt: skip


def _channels(model: Linearisation) -> dict[str, Any]:
    found = {}
    for output in model.output_names:
        for name in model.input_names:
            channel = model.channel(output, name)
            found[f"{name} -> {output}"] = {
                "zeros": _complex(channel.zeros), "poles": _complex(channel.poles), "factor": channel.factor, "gain": channel.gain,
                "integrators": channel.integrators, "bandwidth": channel.bandwidth, "unit": channel.unit,
            }  # fmt: skip
    return {"poles": _complex(model.poles), "channels": found}


def _origin(plant: Plant | None) -> dict[str, Any]:
    if plant is None:
        return {}
    found: dict[str, Any] = {
        "origin": plant.origin(),
        "provenance": {n: plant.provenance(n) for n in plant.model.values},
    }
    if plant.fit is not None:
        found["covariance"] = {
            name: dict(zip(plant.fit.uncertainty.free, map(float, row), strict=True))
            for name, row in zip(
                plant.fit.uncertainty.free, np.asarray(plant.fit.uncertainty.covariance, float), strict=True
            )
        }
    return found


def _members(family: ModelFamily | None) -> dict[str, Any]:
    if family is None:
        return {}
    stacked = {key: np.array([getattr(member, key) for member in family.members]) for key in ("A", "B", "C", "D")}
    return {"family": stacked | {"constants": family.constants, "names": family.names, "seed": family.seed}}


def _tables(contents: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The constants and their covariance as arrays, with names beside them."""
    constants = contents["parameters"]
    found = {"parameters_names": np.array(list(constants)), "parameters_values": np.array(list(constants.values()))}
    if covariance := contents.get("covariance"):
        values = np.array([list(row.values()) for row in covariance.values()])
        found |= {"covariance_names": np.array(list(covariance)), "covariance_values": values}
    return found


def _complex(values: np.ndarray) -> list[list[float]]:
    """Real and imaginary parts."""
    return [[float(v.real), float(v.imag)] for v in values]


def _cell(texts: Any) -> np.ndarray:
    """A column of texts, which MATLAB reads as a cell array."""
    cell = np.empty((len(texts), 1), object)
    for k, text in enumerate(texts):
        cell[k, 0] = str(text)
    return cell


def _written(target: Path, data: bytes) -> Path:
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(data)
    return target
