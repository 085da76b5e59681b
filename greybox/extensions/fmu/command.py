"""An FMU in the place of the model of a command."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from greybox.shell.plants import PlantKind
from greybox.shell.study import Study

if TYPE_CHECKING:
    from greybox.simulation.plant import PlantModel

# What integrates and linearises equations changes nothing; neither do initial states, with which an FMU begins by itself.
NEED_EQUATIONS = (
    Study.method,
    Study.substeps,
    Study.transcription,
    Study.arc_length,
    Study.schedules,
    Study.process_noise,
    Study.at_rest,
    Study.laws,
)


def read_fmu_model(path: str) -> PlantModel:
    """The FMU in a file. Raises GreyboxError."""
    from greybox.extensions.fmu.plant import read_fmu

    return read_fmu(path).model


def set_fmu_parameters(model: PlantModel, study: Study) -> PlantModel:
    """The FMU of a study with its start values, by the names of its records or its own, and those of effects. Raises GreyboxError."""
    plant = model.plant
    known = {name for v in plant.fmu.parameters for name in (v.name, v.label)}
    added = {q.name for q in model.stated_parameters} - {q.name for q in model.parameters}

    def divide(given: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        """Of the FMU, and of its effects; what neither knows is of the FMU, which says so."""
        of_effects = {name: value for name, value in given.items() if name in added - known}
        return {name: value for name, value in given.items() if name not in of_effects}, of_effects

    (start, start_beside), (fixed, fixed_beside) = divide(study.start), divide(study.fixed)
    set_to, as_declared = ({n: v for n, v in fixed.items() if (v is None) == is_free} for is_free in (False, True))
    alone = plant.with_values([n for n in study.free if n not in added], start, set_to).fix(
        *map(plant.find, as_declared)
    )
    for effect in model.effects:
        alone = alone + effect
    alone = alone.start(**start_beside).fix(*(n for n, v in fixed_beside.items() if v is None))
    return alone.fix(**{n: v for n, v in fixed_beside.items() if v is not None})


FMU = PlantKind(
    (".fmu",),
    "on an FMU, whose equations are closed",
    NEED_EQUATIONS,
    read_fmu_model,
    set_fmu_parameters,
    # The compiled model in it is loaded into this process.
    runs_code=True,
)
"""An FMU in the place of a model."""
