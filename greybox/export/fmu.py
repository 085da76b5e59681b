"""The model as an FMU 2.0 for co-simulation: description, sources, and a binary for this platform."""

from __future__ import annotations

import hashlib
import sys
import tempfile
import uuid
import zipfile
from pathlib import Path

from greybox.errors import ModelError
from greybox.export.c_core import read_template, write_initialisers, write_step
from greybox.export.discrete_step import DiscreteStep, find_delay_parameters, make_discrete_step
from greybox.export.fmu_description import write_description
from greybox.export.identifiers import to_identifier
from greybox.export.plant import Plant, to_plant
from greybox.export.shared_library import compile_shared_library
from greybox.expressions.c import c_literal
from greybox.model import Model
from greybox.result import Fit
from greybox.units import format_unit

PLATFORMS = {"linux": ("linux64", ".so"), "darwin": ("darwin64", ".dylib"), "win32": ("win64", ".dll")}
SAME_DATE = (1980, 1, 1, 0, 0, 0)  # the same model gives the same file


def to_fmu(
    plant: Fit | Model, path: str | Path, *, dt: float | None = None, substeps: int = 0, binary: bool = True
) -> Path:
    """Write an FMU 2.0 for co-simulation (``plant.fmu``): sources, and with ``binary`` a library for this platform.

    Inputs are held over a communication step. The step is the library's Runge-Kutta step over ``dt`` seconds (None: the sampling time of
    the fitted records), with friction that sticks, bristles, play and delays in it; ``substeps`` 0 chooses their number. Communication
    steps that are no multiple of ``dt`` are cut evenly; with a delayed input they are refused. Constants can be changed at any time,
    except those of a delay; states can be set before a run begins.

    Raises ModelError where no sampling time is known, CompilerError where a binary is wanted and the C compiler is missing or fails.
    """
    source = to_plant(plant)
    interval = make_discrete_step(source, dt, substeps=substeps, method="rk4")
    if interval.step.per_interval:
        raise ModelError(f"{source.model.title}: an FMU needs a step that takes the constants as they are; use rk4")
    name = to_identifier(source.model.name)
    text, guid = _source(source, interval)
    platform = next((value for key, value in PLATFORMS.items() if sys.platform.startswith(key)), None)
    target = Path(path).with_suffix(".fmu")
    contents: dict[str, bytes] = {
        "modelDescription.xml": write_description(source, interval, name, guid).encode(),
        f"sources/{name}.c": text.encode(),
    }
    if binary and platform is not None:
        folder, suffix = platform
        with tempfile.TemporaryDirectory() as place:
            library = compile_shared_library(text, Path(place) / f"{name}{suffix}")
            contents[f"binaries/{folder}/{name}{suffix}"] = library.read_bytes()
    target.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for entry, data in contents.items():
            archive.writestr(zipfile.ZipInfo(entry, SAME_DATE), data, zipfile.ZIP_DEFLATED)
    return target


def _source(plant: Plant, interval: DiscreteStep) -> tuple[str, str]:
    """The C text of the FMU and its identifier, which follows from the text."""
    model, fixed = plant.model, find_delay_parameters(plant.model)
    remarks = [f"{q.name} [{format_unit(q.unit) or '-'}] {plant.provenance(q.name)}" for q in model.all_parameters]
    body = [
        write_step(interval), f"#define DT {c_literal(interval.dt)}", f'#define DT_TEXT "{interval.dt:g}"', "",
        "static const double constants[] = {", write_initialisers(list(interval.p), remarks) or "    0", "};",
        f"static const int FIXED[] = {{{', '.join(str(int(q.name in fixed)) for q in model.all_parameters) or '0'}}};",
        "", read_template("fmu.c"),
    ]  # fmt: skip
    guid = str(uuid.UUID(bytes=hashlib.sha256("\n".join(body).encode()).digest()[:16]))
    return "\n".join(
        [f"/* {to_identifier(model.title)}: one model as an FMU. */", f'#define GUID "{{{guid}}}"', *body]
    ), f"{{{guid}}}"
