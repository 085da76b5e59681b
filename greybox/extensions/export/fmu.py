"""The model as an FMU 2.0 for co-simulation: description, sources, and a binary for this platform."""

from __future__ import annotations

import errno
import hashlib
import sys
import tempfile
import uuid
import zipfile
from pathlib import Path
from typing import BinaryIO
from xml.etree import ElementTree as ET

from greybox.base import format_unit, parse_unit, to_identifier, to_identifiers, to_line, write_file
from greybox.base.errors import ModelError, OutputError
from greybox.estimation.linear.exported_model import ExportedModel, to_plant
from greybox.estimation.result import Fit
from greybox.extensions.export.c_code import write_constants, write_step
from greybox.extensions.export.discrete_step import (
    DiscreteStep,
    SteppedSignals,
    find_delay_parameters,
    make_discrete_step,
)
from greybox.extensions.export.observer import Observer, refuse_sampling
from greybox.extensions.export.target import ExportTarget, read_template
from greybox.model import Input, Model, Output, Parameter, State
from greybox.model.expressions.printer import c_literal
from greybox.simulation.kernel import c_compiler

PLATFORMS = {"linux": ("linux64", ".so"), "darwin": ("darwin64", ".dylib"), "win32": ("win64", ".dll")}
# Every entry has this date, so that the same model gives the same file.
ENTRY_DATE = (1980, 1, 1, 0, 0, 0)
# Compiler flags: nothing that only this processor has; no contraction of products and sums, so that every compiler gives the same digits.
FLAGS = ("-O2", "-std=c99", "-ffp-contract=off", "-shared", "-fvisibility=hidden")
BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd")


def to_fmu(
    plant: Fit | Model | Observer, path: str | Path, *, dt: float | None = None, substeps: int = 0, binary: bool = True
) -> Path:
    """Write the model as an FMU 2.0 for co-simulation.

    Inputs are held over a communication step. The step is the library's Runge-Kutta step, with friction that sticks, bristles, play
    and delays in it. Communication steps that are no multiple of ``dt`` are divided evenly; with a delayed input they are refused.
    Parameters can be changed at any time, except those of a delay; states can be set before a run begins.

    Parameters
    ----------
    plant
        A fit, a model at its present values, or an `Observer`: its outputs are the states predicted for the present from the measurements
        up to the sample before, and their standard deviations; a measurement that is NaN is missing. Its steps are its own ``dt``.
    path
        The file; its suffix becomes ``.fmu``.
    dt
        Step in seconds; None: the sampling time of the estimation records.
    substeps
        Integration steps in ``dt``; 0 chooses.
    binary
        Whether a library for this platform is added to the sources.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ModelError
        Where no sampling time is known.
    CompilerError
        Where a binary is wanted and there is no C compiler.
    OutputError
        Where the binary cannot be compiled, or the file cannot be written.

    Examples
    --------
    >>> gb.export.to_fmu(fit, "plant.fmu", dt=1e-3)  # doctest: +SKIP
    """
    step: DiscreteStep
    if isinstance(plant, Observer):
        refuse_sampling(dt, substeps)
        source, step = plant.plant, plant.predicted
    else:
        source = to_plant(plant)
        step = make_discrete_step(source, dt, substeps=substeps, method="rk4")
    # Parameters of an FMU may change on the way, matrices that were computed from them would not.
    if step.step.per_interval:
        raise ModelError(f"{source.model.title}: an FMU needs a step that takes the parameters as they are; use rk4")
    name = to_identifier(step.signals.name)
    fixed = find_delay_parameters(source.model)
    flags = ", ".join(str(int(q.name in fixed)) for q in step.signals.all_parameters)
    body = [
        write_step(step),
        f"#define DT {c_literal(step.dt)}",
        f'#define DT_TEXT "{step.dt:g}"',
        "",
        *write_constants(source, step),
        f"static const int FIXED[] = {{{flags or '0'}}};",
        "",
        read_template("fmu.c"),
    ]
    # The identifier follows from the text: the same model gives the same FMU, a changed one another.
    digest = hashlib.sha256("\n".join(body).encode()).digest()
    guid = f"{{{uuid.UUID(bytes=digest[:16])}}}"
    head = f"/* {to_identifier(step.signals.title)}: one model as an FMU. */"
    text = "\n".join([head, f'#define GUID "{guid}"', *body])
    # A platform without a place in the standard gets the sources alone.
    platform = next((value for key, value in PLATFORMS.items() if sys.platform.startswith(key)), None)
    target = Path(path).with_suffix(".fmu")
    contents: dict[str, bytes] = {
        "modelDescription.xml": write_description(source, step, name, guid).encode(),
        f"sources/{name}.c": text.encode(),
    }
    if binary and platform is not None:
        folder, suffix = platform
        # For this platform alone; others compile the sources, which are in the archive.
        contents[f"binaries/{folder}/{name}{suffix}"] = _compile_binary(text, f"{name}{suffix}", target)

    def write_archive(file: BinaryIO) -> None:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            for entry, data in contents.items():
                archive.writestr(zipfile.ZipInfo(entry, ENTRY_DATE), data, zipfile.ZIP_DEFLATED)

    return write_file(target, write_archive)


# ---- modelDescription.xml ----


def write_description(plant: ExportedModel, step: DiscreteStep, name: str, guid: str) -> str:
    """The description of ``plant`` stepped over ``step``; value references as in ``fmu.c``."""
    model = step.signals
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=to_line(model.title),
        guid=guid,
        description=to_line(model.description or model.title),
        generationTool=plant.origin()[0].partition(",")[0],
        variableNamingConvention="structured",
    )
    simulation = ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=name,
        # Past inputs, and the measurements of an observer, belong to samples: such a step cannot be divided.
        canHandleVariableCommunicationStepSize="false" if step.past or step.measurements else "true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
        canNotUseMemoryManagementFunctions="true",
    )
    ET.SubElement(ET.SubElement(simulation, "SourceFiles"), "File", name=f"{name}.c")
    signals: list[Input | Output | State | Parameter] = [
        *model.inputs,
        *model.outputs,
        *model.all_states,
        *model.all_parameters,
    ]
    # Each unit by its powers of the base units.
    units = dict.fromkeys(format_unit(s.unit) for s in signals if format_unit(s.unit) not in ("", "-", "1"))
    definitions = ET.SubElement(root, "UnitDefinitions") if units else root
    for unit_text in units:
        value = parse_unit(unit_text)
        powers = {
            symbol: str(int(e)) for symbol, e in value.dimensions if symbol in BASE_UNITS and float(e).is_integer()
        }
        unit = ET.SubElement(definitions, "Unit", name=unit_text)
        if len(powers) == len(value.dimensions):  # the standard has no fractional powers
            ET.SubElement(unit, "BaseUnit", {**powers, "factor": repr(value.factor)})
    # A thousand steps, so that whoever opens it sees something.
    ET.SubElement(root, "DefaultExperiment", startTime="0", stopTime=repr(1000 * step.dt), stepSize=repr(step.dt))
    _variables(root, plant, step, signals)
    structure = ET.SubElement(root, "ModelStructure")
    # Indices count from one, in the order of the variables: inputs, then outputs.
    first = len(model.inputs) + 1
    for kind in ("Outputs", "InitialUnknowns"):
        group = ET.SubElement(structure, kind)
        for k in range(len(model.outputs)):
            ET.SubElement(group, "Unknown", index=str(first + k))
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def list_fmu_names(model: Model | SteppedSignals) -> list[str]:
    """The FMU's names of inputs, outputs, states (``state.x``) and constants, each once."""
    # One name each: an output may be called as a state is, and a constant as an input.
    plain = to_identifiers([*(i.name for i in model.inputs), *(o.name for o in model.outputs)])
    states = [f"state.{name}" for name in to_identifiers(s.name for s in model.all_states)]
    return [*plain, *states, *to_identifiers((q.name for q in model.all_parameters), plain)]


def _variables(
    root: ET.Element, plant: ExportedModel, step: DiscreteStep, signals: list[Input | Output | State | Parameter]
) -> None:
    group, fixed = ET.SubElement(root, "ModelVariables"), find_delay_parameters(plant.model)
    starts = iter(step.x0)
    for reference, (name, signal) in enumerate(zip(list_fmu_names(step.signals), signals, strict=True)):
        description = signal.description
        real: dict[str, str] = {}
        if isinstance(signal, Input):
            # A measurement is there at its sample; between two of them there is nothing to interpolate.
            kind = {
                "causality": "input",
                "variability": "discrete" if signal.name in step.measurements else "continuous",
            }
            # Missing until the simulator sets it: the observer then predicts.
            real["start"] = "NaN" if signal.name in step.measurements else "0"
        elif isinstance(signal, Output):
            kind = {"causality": "output", "variability": "continuous", "initial": "calculated"}
        elif isinstance(signal, State):
            kind = {"causality": "local", "variability": "continuous", "initial": "exact"}
            real["start"] = repr(float(next(starts)))
        else:
            settable = {"causality": "parameter", "variability": "tunable", "initial": "exact"}
            # A delay decides how many states there are: it cannot move.
            kind = {"causality": "local", "variability": "constant"} if signal.name in fixed else settable
            real["start"] = repr(float(signal.value))
            # Bounds that are none are left out: a reader would take them for numbers.
            real |= {
                key: repr(float(v)) for key, v in zip(("min", "max"), signal.bounds, strict=True) if abs(v) < 1e300
            }
            description = f"{description} ({plant.provenance(signal.name)})".strip()
        unit = format_unit(signal.unit)
        variable = ET.SubElement(
            group,
            "ScalarVariable",
            {"name": name, "valueReference": str(reference), "description": to_line(description), **kind},
        )
        ET.SubElement(variable, "Real", {**real, **({"unit": unit} if unit not in ("", "-", "1") else {})})


# ---- The binary ----


def _compile_binary(text: str, name: str, target: Path) -> bytes:
    """The library of that ``name``, for any machine of this kind.

    Raises NoCompilerError, and OutputError with the FMU's name where it cannot be made.
    """
    try:
        compiler = c_compiler.find_compiler()
        with tempfile.TemporaryDirectory() as folder:
            library = Path(folder) / name
            source = write_file(library.with_suffix(".c"), text)
            # Windows has no position-independent code to ask for.
            flags = (*FLAGS, *(() if sys.platform == "win32" else ("-fPIC",)))
            run = c_compiler.run_compiler(
                [*compiler.command, *flags, "-o", str(library), str(source), "-lm"], compiler.timeout
            )
            if run.returncode != 0:
                raise c_compiler.CompilerError(
                    f"C compiler {' '.join(compiler.command)} ended with code {run.returncode} {c_compiler.summarise_errors(run)}"
                )
            return library.read_bytes()
    except c_compiler.NoCompilerError:
        raise
    except c_compiler.CompilerError as error:
        raise OutputError(errno.EIO, f"its library cannot be compiled: {error}", str(target)) from error
    except OSError as error:
        reason = f"its library cannot be made in {tempfile.gettempdir()}: {error.strerror or error}"
        raise OutputError(error.errno or errno.EIO, reason, str(target)) from error


TARGET = ExportTarget(
    "an FMU 2.0 for co-simulation", ".fmu", to_fmu, options=frozenset(["dt", "substeps", "observer"]), stepped="step"
)
