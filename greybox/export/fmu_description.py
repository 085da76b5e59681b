"""modelDescription.xml of an FMU 2.0: variables with units, start values and what they depend on."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree import ElementTree as ET

from greybox.export.discrete_step import DiscreteStep, find_delay_parameters
from greybox.export.identifiers import to_identifiers
from greybox.export.plant import Plant
from greybox.model.signals import Input, Output, Parameter, State
from greybox.units import format_unit, parse_unit

BASE = ("kg", "m", "s", "A", "K", "mol", "cd")
STEPS = 1000  # of the default experiment


def write_description(plant: Plant, interval: DiscreteStep, name: str, guid: str) -> str:
    """The description of ``plant`` stepped over ``interval``; value references as in ``fmu.c``."""
    model = plant.model
    root = ET.Element(
        "fmiModelDescription", fmiVersion="2.0", modelName=model.title, guid=guid, description=model.description or model.title,
        generationTool=plant.origin()[0].partition(",")[0], variableNamingConvention="structured",
    )  # fmt: skip
    simulation = ET.SubElement(
        root, "CoSimulation", modelIdentifier=name, canHandleVariableCommunicationStepSize=_yes(not interval.past),
        canGetAndSetFMUstate="true", canSerializeFMUstate="true", canNotUseMemoryManagementFunctions="true",
    )  # fmt: skip
    ET.SubElement(ET.SubElement(simulation, "SourceFiles"), "File", name=f"{name}.c")
    signals: list[Input | Output | State | Parameter] = [
        *model.inputs, *model.outputs, *model.all_states, *model.all_parameters
    ]  # fmt: skip
    _units(root, signals)
    ET.SubElement(
        root, "DefaultExperiment", startTime="0", stopTime=repr(STEPS * interval.dt), stepSize=repr(interval.dt)
    )
    _variables(root, plant, interval, signals)
    structure = ET.SubElement(root, "ModelStructure")
    first = len(model.inputs) + 1
    for kind in ("Outputs", "InitialUnknowns"):
        group = ET.SubElement(structure, kind)
        for k in range(len(model.outputs)):
            ET.SubElement(group, "Unknown", index=str(first + k))
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def list_fmu_names(plant: Plant) -> list[str]:
    """The FMU's names of inputs, outputs, states (``state.x``) and constants, each once."""
    model = plant.model
    plain = to_identifiers([*(i.name for i in model.inputs), *(o.name for o in model.outputs)])
    states = [f"state.{name}" for name in to_identifiers(s.name for s in model.all_states)]
    return [*plain, *states, *to_identifiers((q.name for q in model.all_parameters), plain)]


def _units(root: ET.Element, signals: Iterable[Input | Output | State | Parameter]) -> None:
    units = dict.fromkeys(format_unit(s.unit) for s in signals if format_unit(s.unit) not in ("", "-", "1"))
    if not units:
        return
    group = ET.SubElement(root, "UnitDefinitions")
    for text in units:
        value = parse_unit(text)
        powers = {symbol: str(int(e)) for symbol, e in value.dimensions if symbol in BASE and float(e).is_integer()}
        whole = len(powers) == len(value.dimensions)
        unit = ET.SubElement(group, "Unit", name=text)
        if whole:  # broken powers have no place in the standard
            ET.SubElement(unit, "BaseUnit", {**powers, "factor": repr(value.factor)})


def _variables(
    root: ET.Element, plant: Plant, interval: DiscreteStep, signals: list[Input | Output | State | Parameter]
) -> None:
    group, fixed = ET.SubElement(root, "ModelVariables"), find_delay_parameters(plant.model)
    starts = iter(interval.x0)
    for reference, (name, signal) in enumerate(zip(list_fmu_names(plant), signals, strict=True)):
        remark = signal.description
        real: dict[str, str] = {}
        if isinstance(signal, Input):
            kind = {"causality": "input", "variability": "continuous"}
            real["start"] = "0"
        elif isinstance(signal, Output):
            kind = {"causality": "output", "variability": "continuous", "initial": "calculated"}
        elif isinstance(signal, State):
            kind = {"causality": "local", "variability": "continuous", "initial": "exact"}
            real["start"] = repr(float(next(starts)))
        else:
            settable = {"causality": "parameter", "variability": "tunable", "initial": "exact"}
            kind = {"causality": "local", "variability": "constant"} if signal.name in fixed else settable
            real["start"] = repr(float(signal.value))
            real |= {
                key: repr(float(v)) for key, v in zip(("min", "max"), signal.bounds, strict=True) if abs(v) < 1e300
            }
            remark = f"{remark} ({plant.provenance(signal.name)})".strip()
        unit = format_unit(signal.unit)
        variable = ET.SubElement(
            group, "ScalarVariable", {"name": name, "valueReference": str(reference), "description": remark, **kind}
        )
        ET.SubElement(variable, "Real", {**real, **({"unit": unit} if unit not in ("", "-", "1") else {})})


def _yes(value: bool) -> str:
    return "true" if value else "false"
