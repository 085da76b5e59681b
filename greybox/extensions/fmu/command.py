"""`greybox fit`, `check`, `compare` and `discover` with an FMU in the place of the model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from greybox.base.errors import DataError, ExitCode
from greybox.shell.inputs import layout_of, print_record_notes, result_folder
from greybox.shell.plants import PlantDiscovery, PlantKind
from greybox.shell.study import FITTING, READING, Answer, Study

if TYPE_CHECKING:
    from greybox.comparison.result import Comparison
    from greybox.data.experiment import Experiment
    from greybox.estimation.result import Fit
    from greybox.simulation.plant import PlantModel

    Records = tuple[Experiment, ...]

ALWAYS = (
    *(Study.model, Study.estimation, Study.validation, Study.fixed, Study.start, Study.free, Study.noise),
    *READING,
)
JUDGING = (Study.candidates, Study.skip, Study.beginning)
# What integrates and linearises equations changes nothing; neither do initial states, with which an FMU begins by itself.
NEED_EQUATIONS = (
    Study.method,
    Study.substeps,
    Study.transcription,
    Study.arc_length,
    Study.schedules,
    Study.process_noise,
    Study.at_rest,
)
USED = {
    "fit": (
        *(option for option in FITTING if option not in (*NEED_EQUATIONS, Study.effects)),
        Study.time_limit,
        Study.profiles,
        Study.bootstrap,
    ),
    "fit with effects": (*ALWAYS, Study.effects),
    "check": ALWAYS,
    "compare": (*ALWAYS, *JUDGING, Study.predict),
    "discover": (*ALWAYS, *JUDGING, Study.without, Study.without_family, Study.further, Study.time_limit),
}
"""Command -> options of a study that it uses with an FMU."""


def read_fmu_model(study: Study) -> PlantModel:
    """The FMU of a study with its start values. Raises GreyboxError."""
    from greybox.extensions.fmu.plant import read_fmu

    plant = read_fmu(study.model)
    names = {v.name for v in plant.fmu.parameters} | {v.label for v in plant.fmu.parameters}
    # Of effects there are start values, too.
    start = {name: value for name, value in study.start.items() if name in names or not study.effects}
    fixed = {name: value for name, value in study.fixed.items() if value is not None}
    return plant.with_values(study.free, start, fixed)


def run_fmu_effects(study: Study) -> Answer:
    """Fit the FMU of a study with effects to its records, and write fmu_fit.json. Raises GreyboxError."""
    from greybox.base.json_shape import format_json
    from greybox.discovery.effect_test import try_effect
    from greybox.estimation.fit import fit
    from greybox.extensions.fmu.effects import AT_REST, fit_fmu_effects, prepare_fmu

    result, records, validation, folder = _fit(study)
    prepared, noise = prepare_fmu(result, records, validation), dict(study.noise) or None
    # Each from where the records show it, then together with the FMU itself.
    extended = fit(prepared.local.model, prepared.estimation, noise=noise, options=AT_REST)
    for name in study.effects:
        extended = try_effect(extended, name, nominal=prepared.local.model).larger
    plain = {q.name for q in prepared.local.model.parameters}
    start = {n: v for n, v in extended.model.values.items() if n not in plain}
    start |= {n: v for n, v in study.start.items() if n in start}
    answer = fit_fmu_effects(prepared, extended.model.effects, start=start, noise=noise)
    return Answer(
        answer,
        lambda _: format_json(answer.as_dict()),
        [answer.save(folder / "fmu_fit.json")],
        code=ExitCode.SUCCESS if answer.agrees else ExitCode.UNSUCCESSFUL,
    )


def run_fmu_check(study: Study) -> tuple[Any, Path]:
    """The check of an FMU at its start values, and the folder for it. Raises GreyboxError."""
    from greybox.estimation.check import check
    from greybox.extensions.fmu.effects import AT_REST, prepare_plant

    if not study.estimation:
        raise DataError(f"{study.model}: an FMU is checked over records; give one")
    model, records, _, folder = _read(study)
    local, (extended, _), _ = prepare_plant(model, records)
    return check(local.model, extended, noise=dict(study.noise), options=AT_REST), folder


def run_fmu_discovery(study: Study, without: Sequence[str], **options: Any) -> PlantDiscovery:
    """The discovery around the FMU of a study. Raises GreyboxError."""
    from greybox.extensions.fmu.effects import discover_fmu, prepare_fmu
    from greybox.model.effects.catalogue import effect

    if not study.validation:
        raise DataError("no validation record: a discovery needs a record that was not fitted; give --validate FILE")
    result, records, validation, folder = _fit(study)
    prepared = prepare_fmu(result, records, validation)
    candidates = [effect(name) for name in study.candidates] or None
    answer = discover_fmu(
        prepared,
        noise=dict(study.noise) or None,
        effects=candidates,
        skip=study.skip,
        beginning=study.beginning,
        without=without,
        further=study.further,
        **options,
    )
    fitted = answer.with_effects or prepared.fit
    name = "fmu_fit.json" if answer.with_effects else "fit.json"
    return PlantDiscovery(answer.discovery, str(answer), folder, lambda: fitted.save(folder / name))


def run_fmu_comparison(study: Study) -> tuple[Comparison, Records, Records, Path]:
    """The FMU of a study beside black boxes, its records and the others, and the folder for that. Raises GreyboxError."""
    from greybox.extensions.fmu.effects import compare_fmu, prepare_fmu

    result, records, validation, folder = _fit(study)
    prepared = prepare_fmu(result, records, validation)
    comparison = compare_fmu(
        prepared,
        study.candidates,
        noise=dict(study.noise) or None,
        skip=study.skip,
        beginning=study.beginning,
        steps=study.predict,
    )
    return comparison, prepared.records, prepared.others, folder


def _read(study: Study) -> tuple[PlantModel, Records, Records, Path]:
    """The FMU with its start values, the records and the folder."""
    from greybox.data.read import read_experiments

    model = read_fmu_model(study)
    folder = result_folder(study, model.name)
    layout = layout_of(study)
    records, validation = (
        read_experiments(
            files,
            model,
            hold=study.hold,  # type: ignore[arg-type]
            split=study.split_holes,
            allow_constant_input=study.free_decay or not model.inputs,
            **layout,
        )
        if files
        else ()
        for files in (study.estimation, study.validation)
    )
    print_record_notes(records, validation)
    return model, records, validation, folder


def _fit(study: Study) -> tuple[Fit, Records, Records, Path]:
    """The fit of the FMU alone, the records and the folder."""
    from greybox.estimation.fit import fit

    model, records, validation, folder = _read(study)
    result = fit(model, records, noise=dict(study.noise) or None, validation=validation)
    return result, records, validation, folder


CLOSED = "on an FMU, whose equations are closed"
FMU = PlantKind(
    (".fmu",),
    CLOSED,
    USED,
    read_fmu_model,
    run_fmu_effects,
    run_fmu_check,
    run_fmu_comparison,
    run_fmu_discovery,
)
"""An FMU in the place of a model."""

PRINTS = {"fit": ("greybox.extensions.fmu.effects:FmuWithEffects",)}
"""Command -> types of what it prints with ``--json``."""
