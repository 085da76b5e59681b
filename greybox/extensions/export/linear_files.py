"""Linear models as files: MATLAB's .mat, JSON, NumPy's .npz, and a Python file that makes a `control.StateSpace`.

A new format is a function that writes a `Linearisation`, and an `ExportTarget` with an entry point.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypedDict, Unpack

import numpy as np

from greybox.base.errors import ModelError, nearest
from greybox.base.extensions import ExtensionKind, load_extensions
from greybox.base.files import write_file
from greybox.base.json_shape import format_json, to_json_data
from greybox.base.texts import to_identifiers, to_line
from greybox.estimation.linear.linearisation import Linearisation, minimal_realisation
from greybox.estimation.linear.linearise import linearise
from greybox.estimation.linear.model_family import ModelFamily, sample_family
from greybox.estimation.linear.plant import Plant, to_plant
from greybox.estimation.linear.transfer_channel import describe_behaviour, extract_channel
from greybox.estimation.result import Fit
from greybox.extensions.export.target import ExportTarget
from greybox.model.model import Model
from greybox.model.python_text import docstring, literal
from greybox.simulation.kernel.c_compiler import GreyboxWarning

# Version of the keys in the files of linear models.
FORMAT_VERSION = 1


SIGNALS = ("state", "input", "output")


class LinearExportOptions(TypedDict, total=False):
    """How the linear model that is written is made: arguments of `linearise` and `sample_family`."""

    dt: float | None
    """Sampling time in seconds; None: continuous."""
    method: str
    """``zoh`` or ``tustin``."""
    delay: float
    """Seconds by which every input arrives late."""
    minimal: bool
    """Whether states that no input reaches or no output shows are removed."""
    samples: int
    """Number of models drawn from the covariance of the parameters that are added."""
    seed: int
    """Seed of these draws."""


def write_linear(
    plant: Fit | Model,
    path: str | Path,
    format: str,
    at: Mapping[str, float] | None = None,
    *,
    dt: float | None = None,
    method: str = "zoh",
    delay: float = 0.0,
    minimal: bool = False,
    samples: int = 0,
    seed: int = 0,
) -> Path:
    """Linearise a fit or model and write the linear model as a file.

    Parameters
    ----------
    plant
        A fit, or a model at its present values.
    path
        The file; its suffix becomes that of the format.
    format
        ``control``, ``mat``, ``json`` or ``numpy``.
    at
        The operating point: states and inputs by name, in the model's units; see `linearise`.
    dt, method, delay
        Sampling, as in `linearise`.
    minimal
        Whether states that no input reaches or no output shows are removed.
    samples
        How many models drawn from the covariance of the parameters are added.
    seed
        Seed of these draws.

    Returns
    -------
    Path
        The file. Findings are given as warnings.

    Raises
    ------
    ModelError
        For an unknown format, for samples of a model without a fit, and as `linearise`.

    Examples
    --------
    >>> gb.export.write_linear(fit, "plant.mat", "mat", {"u": 0.5}, samples=50)  # doctest: +SKIP
    """
    # Also those that other packages bring.
    formats = {name: target for name, target in load_extensions(ExtensionKind.EXPORTS).items() if target.linear}
    if format not in formats:
        raise ModelError(f"unknown format {format!r}; {nearest(format, formats)}")
    model = linearise(plant, at, dt=dt, method=method, delay=delay)
    family = None
    if samples:
        if not isinstance(plant, Fit):
            raise ModelError(
                "samples need a fit, whose parameters have a covariance; give what gb.fit returns, or samples=0"
            )
        family = sample_family(plant, at, number=samples, seed=seed, dt=dt, method=method, delay=delay, minimal=minimal)
    # A file has no place where somebody would look for them: they are said when it is written.
    for finding in (*model.findings, *(family.findings if family else ())):
        warnings.warn(str(finding), GreyboxWarning, stacklevel=2)
    # After the findings: what is cut away may be what they speak of.
    reduced = minimal_realisation(model) if minimal else model
    return formats[format].write(reduced, path, plant=to_plant(plant), family=family)


def to_mat(
    plant: Fit | Model,
    path: str | Path,
    at: Mapping[str, float] | None = None,
    **options: Unpack[LinearExportOptions],
) -> Path:
    """Write a linear model as MATLAB's ``.mat`` file (see `write_mat` for its contents).

    Parameters
    ----------
    plant
        A fit, or a model at its present values.
    path
        The file; its suffix becomes ``.mat``.
    at
        The operating point: states and inputs by name, in the model's units; see `linearise`.
    **options
        ``dt``, ``method``, ``delay``, ``minimal``, ``samples``, ``seed``: see `write_linear`.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ModelError
        As `write_linear`.

    Examples
    --------
    >>> gb.export.to_mat(fit, "plant.mat", {"u": 0.5}, dt=1e-3, samples=50)  # doctest: +SKIP
    """
    return write_linear(plant, path, "mat", at, **options)


def to_json(
    plant: Fit | Model,
    path: str | Path,
    at: Mapping[str, float] | None = None,
    **options: Unpack[LinearExportOptions],
) -> Path:
    """Write a linear model as JSON: matrices, names, units, poles, zeros, parameters, covariance.

    Parameters
    ----------
    plant
        A fit, or a model at its present values.
    path
        The file; its suffix becomes ``.json``.
    at
        The operating point: states and inputs by name, in the model's units; see `linearise`.
    **options
        ``dt``, ``method``, ``delay``, ``minimal``, ``samples``, ``seed``: see `write_linear`.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ModelError
        As `write_linear`.

    Examples
    --------
    >>> gb.export.to_json(fit, "plant.json", {"u": 0.5}, dt=1e-3, samples=50)  # doctest: +SKIP
    """
    return write_linear(plant, path, "json", at, **options)


def to_numpy(
    plant: Fit | Model,
    path: str | Path,
    at: Mapping[str, float] | None = None,
    **options: Unpack[LinearExportOptions],
) -> Path:
    """Write a linear model as arrays of NumPy.

    Parameters
    ----------
    plant
        A fit, or a model at its present values.
    path
        The file; its suffix becomes ``.npz``.
    at
        The operating point: states and inputs by name, in the model's units; see `linearise`.
    **options
        ``dt``, ``method``, ``delay``, ``minimal``, ``samples``, ``seed``: see `write_linear`.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ModelError
        As `write_linear`.

    Examples
    --------
    >>> gb.export.to_numpy(fit, "plant.npz", {"u": 0.5}, dt=1e-3, samples=50)  # doctest: +SKIP
    """
    return write_linear(plant, path, "numpy", at, **options)


def write_json(
    model: Linearisation, path: str | Path, *, plant: Plant | None = None, family: ModelFamily | None = None
) -> Path:
    """Write ``model`` as JSON, every number to the last digit; ``plant`` adds where it comes from, ``family`` its members."""
    return write_file(Path(path).with_suffix(".json"), format_json(linear_model_data(model, plant, family)) + "\n")


def linear_model_data(
    model: Linearisation, plant: Plant | None = None, family: ModelFamily | None = None
) -> dict[str, Any]:
    """What `write_json` writes."""
    channels = {}
    for output in model.output_names:
        for name in model.input_names:
            channel = extract_channel(model, output, name)
            numbers = ("factor", "gain", "integrators", "bandwidth", "unit")
            channels[f"{name} -> {output}"] = {
                "zeros": _complex(channel.zeros),
                "poles": _complex(channel.poles),
                **{key: getattr(channel, key) for key in numbers},
            }
    data = {
        "format": FORMAT_VERSION,
        **_contents(model),
        "findings": model.findings,
        "poles": _complex(model.poles),
        "channels": channels,
        **_origin(plant),
        **_members(family),
    }
    return dict(to_json_data(data))


def write_npz(
    model: Linearisation, path: str | Path, *, plant: Plant | None = None, family: ModelFamily | None = None
) -> Path:
    """Write ``model`` as arrays of NumPy (``A``, ``B``, ``C``, ``D``, ``dt``, names ...), the members of a family as ``family_A`` ..."""
    contents = _contents(model) | _origin(plant)
    # Tables have no arrays: they become names and values beside each other.
    arrays = {key: np.asarray(value) for key, value in contents.items() if not isinstance(value, Mapping)}
    arrays |= _tables(contents)
    arrays |= {f"family_{key}": np.asarray(value) for key, value in _members(family).get("family", {}).items()}
    return write_file(Path(path).with_suffix(".npz"), lambda file: np.savez(file, allow_pickle=False, **arrays))


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
        "A": model.A,
        "B": model.B,
        "C": model.C,
        "D": model.D,
        "Ts": model.dt,
        # Apart from the matrices, as `ss` takes it: exact in MATLAB, not approximated.
        "InputDelay": model.delay.reshape(-1, 1),
        **{f"{kind.capitalize()}Name": _cell(to_identifiers(getattr(model, f"{kind}_names"))) for kind in SIGNALS},
        **{f"{kind.capitalize()}Unit": _cell(getattr(model, f"{kind}_units")) for kind in SIGNALS},
        **{key: getattr(model, key).reshape(-1, 1) for key in ("x0", "u0", "y0", "rates")},
        "Name": to_line(model.name),
        "Method": model.method,
        "Notes": _cell([str(finding) for finding in model.findings]),
    }
    # As arrays with names: a name of a parameter need not be one that MATLAB allows.
    tables = _tables(_contents(model) | _origin(plant))
    for key in ("parameters", "covariance"):
        if f"{key}_names" in tables:
            values[f"{key}_names"] = _cell(tables[f"{key}_names"])
            values[f"{key}_values"] = tables[f"{key}_values"]
    if plant is not None:
        values["Origin"] = _cell(plant.origin())
    if family is not None:
        members = _members(family)["family"]
        # MATLAB counts pages last: family.A(:, :, k).
        pages = {key: np.moveaxis(np.asarray(members[key]), 0, -1) for key in ("A", "B", "C", "D")}
        values["family"] = pages | {
            "constants": members["constants"],
            "names": _cell(members["names"]),
            "seed": members["seed"],
        }
    return write_file(
        Path(path).with_suffix(".mat"), lambda file: savemat(file, values, do_compression=True, oned_as="column")
    )


def write_control(
    model: Linearisation, path: str | Path, *, plant: Plant | None = None, family: ModelFamily | None = None
) -> Path:
    """Write a Python file that makes the ``control.StateSpace`` called ``plant``, matrices and names in plain sight.

    A ``family`` has no place in it and is left out.
    """
    target = Path(path).with_suffix(".py")
    notes = [f"Note: {finding}" for finding in model.findings]
    behaviour = str(describe_behaviour(model)).splitlines()
    lines = docstring(
        f"Linear model of {model.name} for python-control: from {target.stem} import plant.",
        [behaviour, list(plant.origin()) if plant else [], notes],
    )
    lines += ["", "import control", "import numpy as np", ""]
    for name in ("A", "B", "C", "D"):
        # Every digit, so that the file holds the same numbers.
        rows = [f"        [{', '.join(repr(float(v)) for v in row)}]," for row in getattr(model, name)]
        # An empty matrix in brackets has lost one of its sizes.
        shape = f".reshape({getattr(model, name).shape})" if 0 in getattr(model, name).shape else ""
        lines += [f"{name} = np.array(", "    [", *rows, "    ]", f"){shape}"]
    units = {
        kind: dict(zip(to_identifiers(getattr(model, f"{kind}_names")), getattr(model, f"{kind}_units"), strict=True))
        for kind in SIGNALS
    }
    for kind, table in units.items():
        lines.append(f"{kind}_units = {{{', '.join(f'{literal(n)}: {literal(u)}' for n, u in table.items())}}}")
    if model.delay.any():
        delays = dict(zip(to_identifiers(model.input_names), map(float, model.delay), strict=True))
        lines += [f"delay = {delays!r}  # s, not in the matrices"]
    names = ", ".join(f"{kind}s=list({kind}_units)" for kind in units)
    lines += [f"plant = control.ss(A, B, C, D, {model.dt!r}, {names})", ""]
    return write_file(target, "\n".join(lines))


CONTROL = ExportTarget("a Python file for python-control", ".py", write_control, linear=True, ending="_ss.py")
MAT = ExportTarget("a MATLAB file", ".mat", write_mat, linear=True, options=frozenset(["samples"]))
JSON = ExportTarget("JSON", ".json", write_json, linear=True, options=frozenset(["samples"]))
NUMPY = ExportTarget("NumPy arrays", ".npz", write_npz, linear=True, options=frozenset(["samples"]))


# What every file holds of a linear model, under these keys.
CONTENTS = (
    *("name", "A", "B", "C", "D", "dt", "method"),
    *(f"{kind}_names" for kind in SIGNALS),
    *(f"{kind}_units" for kind in SIGNALS),
    *("x0", "u0", "y0", "rates", "delay"),
)


def _contents(model: Linearisation) -> dict[str, Any]:
    notes = [str(finding) for finding in model.findings]
    return {key: getattr(model, key) for key in CONTENTS} | {"parameters": dict(model.parameters), "notes": notes}


def _origin(plant: Plant | None) -> dict[str, Any]:
    if plant is None:
        return {}
    origin: dict[str, Any] = {
        "origin": plant.origin(),
        "provenance": {n: plant.provenance(n) for n in plant.model.values},
    }
    if plant.fit is not None:
        # By name on both sides: nobody need know the order.
        free, covariance = plant.fit.uncertainty.free, np.asarray(plant.fit.uncertainty.covariance, float)
        origin["covariance"] = {
            name: dict(zip(free, map(float, row), strict=True)) for name, row in zip(free, covariance, strict=True)
        }
    return origin


def _members(family: ModelFamily | None) -> dict[str, Any]:
    if family is None:
        return {}
    # Members first: family_A[k] is the matrix of one draw.
    stacked = {key: np.array([getattr(member, key) for member in family.members]) for key in ("A", "B", "C", "D")}
    return {"family": stacked | {"constants": family.parameters, "names": family.parameter_names, "seed": family.seed}}


def _tables(contents: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The parameters and their covariance as arrays, with names beside them."""
    parameters = contents["parameters"]
    tables = {"parameters_names": np.array(list(parameters)), "parameters_values": np.array(list(parameters.values()))}
    if covariance := contents.get("covariance"):
        values = np.array([list(row.values()) for row in covariance.values()])
        tables |= {"covariance_names": np.array(list(covariance)), "covariance_values": values}
    return tables


def _complex(values: np.ndarray) -> list[list[float]]:
    """Real and imaginary parts."""
    return [[float(v.real), float(v.imag)] for v in values]


def _cell(texts: Any) -> np.ndarray:
    """A column of texts, which MATLAB reads as a cell array."""
    # Of objects: an array of texts would become one matrix of characters.
    cell = np.empty((len(texts), 1), object)
    for k, text in enumerate(texts):
        cell[k, 0] = to_line(str(text))
    return cell
