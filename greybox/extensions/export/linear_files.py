"""Linear models as files: MATLAB's .mat, JSON, NumPy's .npz, and a Python file that makes a `control.StateSpace`.

A new format is a function that writes a `Linearisation`, and an `ExportTarget` with an entry point.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypedDict

import numpy as np

from greybox.base import ExtensionKind, ModelError, load_extensions, nearest, to_identifiers, to_line, write_file
from greybox.base.json_file import write_json as write_json_file
from greybox.base.json_shape import Axes, FileKind, Matrix
from greybox.estimation.linear.exported_model import ExportedModel, to_plant
from greybox.estimation.linear.linearisation import Linearisation, minimal_realisation
from greybox.estimation.linear.linearise import linearise
from greybox.estimation.linear.model_family import ModelFamily, sample_family
from greybox.estimation.linear.transfer_channel import TransferChannel, describe_behaviour, extract_channel
from greybox.estimation.result import Fit
from greybox.extensions.export.target import ExportTarget
from greybox.model import Model, docstring, literal
from greybox.simulation.kernel.c_compiler import GreyboxWarning

SIGNALS = ("state", "input", "output")


# What every file holds of a linear model, under these keys.
CONTENTS = (
    *("name", "A", "B", "C", "D", "dt", "method"),
    *(f"{kind}_names" for kind in SIGNALS),
    *(f"{kind}_units" for kind in SIGNALS),
    *("x0", "u0", "y0", "rates", "delay"),
)


class FamilyData(TypedDict):
    """Models drawn from the covariance of the parameters.

    Attributes
    ----------
    A, B, C, D
        Matrices of all members, members first.
    constants, names
        Parameters of each member, and their names.
    seed
        Of the draws.
    """

    A: Annotated[np.ndarray, Axes(3)]
    B: Annotated[np.ndarray, Axes(3)]
    C: Annotated[np.ndarray, Axes(3)]
    D: Annotated[np.ndarray, Axes(3)]
    constants: Matrix
    names: tuple[str, ...]
    seed: int


class PrintedExport(TypedDict):
    """What ``greybox export --json`` prints.

    Attributes
    ----------
    target
        The format, as --to names it.
    files
        What was written.
    report
        The page; null where none was asked for.
    linear
        The linear model; null for code.
    """

    target: str
    files: list[str]
    report: str | None
    linear: LinearFile | None


@dataclass(frozen=True, eq=False)
class LinearFile:
    """A linear model with where it comes from, as JSON holds it.

    Attributes
    ----------
    model
        The linear model.
    plant
        What it was made of, where that is known.
    members
        Models that were drawn about it.
    """

    model: Linearisation
    plant: ExportedModel | None = None
    members: ModelFamily | None = None

    FILE: ClassVar[FileKind] = FileKind("a linear model", "file that greybox export --to json has written")
    KEYS: ClassVar[str] = " ".join(
        [
            *(f"{key}=model.{key}" for key in CONTENTS),
            "parameters=model.parameters notes=str(model.findings) findings=model.findings poles=model.poles channels",
            "origin? provenance? covariance? family?",
        ]
    )

    @property
    def channels(self) -> dict[str, TransferChannel]:
        """``input -> output`` -> its zeros, poles and gain."""
        pairs = [(name, output) for output in self.model.output_names for name in self.model.input_names]
        return {f"{name} -> {output}": extract_channel(self.model, output, name) for name, output in pairs}

    @property
    def origin(self) -> tuple[str, ...]:
        """What it was computed from."""
        return self.plant.origin() if self.plant else ()

    @property
    def provenance(self) -> dict[str, str]:
        """Parameter -> where its value is from."""
        return {n: self.plant.provenance(n) for n in self.plant.model.values} if self.plant else {}

    @property
    def covariance(self) -> dict[str, dict[str, float]]:
        """Of the fitted parameters, by name on both sides: nobody need know the order."""
        if self.plant is None or self.plant.fit is None:
            return {}
        free, covariance = self.plant.fit.uncertainty.free, np.asarray(self.plant.fit.uncertainty.covariance, float)
        return {name: dict(zip(free, map(float, row), strict=True)) for name, row in zip(free, covariance, strict=True)}

    @property
    def family(self) -> FamilyData | None:
        """The members that were drawn about it."""
        if self.members is None:
            return None
        # Members first: A[k] is the matrix of one draw.
        a, b, c, d = (np.array([getattr(each, key) for each in self.members.members]) for key in ("A", "B", "C", "D"))
        parameters = self.members.parameters
        return {
            "A": a,
            "B": b,
            "C": c,
            "D": d,
            "constants": parameters,
            "names": self.members.parameter_names,
            "seed": self.members.seed,
        }


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
    return formats[format].write(reduced, path, plant=to_plant(plant, with_equations=False), family=family)


def write_json(
    model: Linearisation, path: str | Path, *, plant: ExportedModel | None = None, family: ModelFamily | None = None
) -> Path:
    """Write ``model`` as JSON, every number to the last digit; ``plant`` adds where it comes from, ``family`` its members."""
    return write_json_file(Path(path).with_suffix(".json"), LinearFile(model, plant, family))


def write_npz(
    model: Linearisation, path: str | Path, *, plant: ExportedModel | None = None, family: ModelFamily | None = None
) -> Path:
    """Write ``model`` as arrays of NumPy (``A``, ``B``, ``C``, ``D``, ``dt``, names ...), the members of a family as ``family_A`` ..."""
    file = LinearFile(model, plant, family)
    texts = {"notes": [str(finding) for finding in model.findings], **({"origin": file.origin} if plant else {})}
    arrays = {key: np.asarray(value) for key, value in ({key: getattr(model, key) for key in CONTENTS} | texts).items()}
    # Tables have no arrays: they become names and values beside each other.
    arrays |= _tables(file)
    arrays |= {f"family_{key}": np.asarray(value) for key, value in (file.family or {}).items()}
    return write_file(Path(path).with_suffix(".npz"), lambda file: np.savez(file, allow_pickle=False, **arrays))


def write_mat(
    model: Linearisation, path: str | Path, *, plant: ExportedModel | None = None, family: ModelFamily | None = None
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
    file = LinearFile(model, plant, family)
    tables = _tables(file)
    for key in ("parameters", "covariance"):
        if f"{key}_names" in tables:
            values[f"{key}_names"] = _cell(tables[f"{key}_names"])
            values[f"{key}_values"] = tables[f"{key}_values"]
    if plant is not None:
        values["Origin"] = _cell(plant.origin())
    if (members := file.family) is not None:
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
    model: Linearisation, path: str | Path, *, plant: ExportedModel | None = None, family: ModelFamily | None = None
) -> Path:
    """Write a Python file that makes the ``control.StateSpace`` called ``plant``, matrices and names in plain sight.

    Those of a ``family`` are in its list ``family``.
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
    if family is not None:
        shapes = [getattr(model, key).shape for key in "ABCD"]
        rows = [f"    ({', '.join(repr(getattr(m, key).ravel().tolist()) for key in 'ABCD')})," for m in family.members]
        lines += [
            f"# {len(rows)} models drawn from the covariance of the parameters with seed {family.seed}: A, B, C and D, row by row.",
            *("members = [", *rows, "]"),
            f"shapes = {shapes!r}",
            "family = [",
            f"    control.ss(*(np.reshape(m, s) for m, s in zip(member, shapes)), {model.dt!r}, {names})",
            *("    for member in members", "]", ""),
        ]
    return write_file(target, "\n".join(lines))


CONTROL = ExportTarget(
    "a Python file for python-control",
    ".py",
    write_control,
    linear=True,
    options=frozenset(["samples"]),
    ending="_ss.py",
)
MAT = ExportTarget("a MATLAB file", ".mat", write_mat, linear=True, options=frozenset(["samples"]))
JSON = ExportTarget("JSON", ".json", write_json, linear=True, options=frozenset(["samples"]))
NUMPY = ExportTarget("NumPy arrays", ".npz", write_npz, linear=True, options=frozenset(["samples"]))


def _tables(file: LinearFile) -> dict[str, np.ndarray]:
    """The parameters and their covariance as arrays, with names beside them."""
    parameters = file.model.parameters
    tables = {"parameters_names": np.array(list(parameters)), "parameters_values": np.array(list(parameters.values()))}
    if covariance := file.covariance:
        values = np.array([list(row.values()) for row in covariance.values()])
        tables |= {"covariance_names": np.array(list(covariance)), "covariance_values": values}
    return tables


def _cell(texts: Any) -> np.ndarray:
    """A column of texts, which MATLAB reads as a cell array."""
    # Of objects: an array of texts would become one matrix of characters.
    cell = np.empty((len(texts), 1), object)
    for k, text in enumerate(texts):
        cell[k, 0] = to_line(str(text))
    return cell
