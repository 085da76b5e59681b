"""`greybox fit`, `check`, `compare` and `discover` with an FMU in the place of the model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from greybox.base.errors import DataError, ExitCode, GreyboxError
from greybox.shell.inputs import layout_of, print_record_notes
from greybox.shell.options import check_writable
from greybox.shell.plants import PlantDiscovery, PlantKind
from greybox.shell.study import CHECK, COMPARE, DISCOVER, FIT, Study, fields_of

if TYPE_CHECKING:
    from greybox.comparison.result import Comparison
    from greybox.data.experiment import Experiment
    from greybox.extensions.fmu.effects import PreparedFmu
    from greybox.extensions.fmu.fit_fmu import FmuFit

    Records = tuple[Experiment, ...]

SIGNALS = ["hold", "columns", "headers", "sampling_time", "read_limit", "interpolation", "split_holes", "free_decay"]
ALWAYS = frozenset(["model", "estimation", "validation", "fixed", "start", "free", "noise", *SIGNALS])
USED = {
    FIT: ALWAYS | {"effects"},
    CHECK: ALWAYS,
    COMPARE: ALWAYS | {"candidates", "skip", "beginning", "predict"},
    DISCOVER: ALWAYS | {"candidates", "skip", "beginning", "without", "without_family", "further", "time_limit"},
}
"""Command -> fields of a study that it uses with an FMU."""


def run_fmu_fit(study: Study, output: Path | None, *, json: bool) -> None:
    """Fit the FMU of a study to its records, print the result and write fmu_fit.json. Raises GreyboxError."""
    from greybox.base.json_shape import format_json
    from greybox.extensions.fmu.effects import prepare_fmu
    from greybox.show.sentences.shell import written

    result, records, validation, folder = _fit(study, FIT, output)
    answer: Any = result
    if study.effects:
        answer = _fit_effects(prepare_fmu(result, records, validation), study.effects, study)
    saved = answer.save(folder / "fmu_fit.json")
    typer.echo(format_json(answer.as_dict()) if json else f"{answer}\n\n{written([saved])}")
    if not (answer.agrees if study.effects else result.success):
        raise typer.Exit(ExitCode.UNSUCCESSFUL)


def run_fmu_check(study: Study, output: Path | None) -> tuple[Any, Path]:
    """The check of an FMU at its start values, and the folder for it. Raises GreyboxError."""
    from greybox.estimation.check import check
    from greybox.extensions.fmu.effects import AT_REST, prepare_fmu

    if not study.estimation:
        raise DataError(f"{study.model}: an FMU is checked over records; give one")
    result, records, _, folder = _fit(study, CHECK, output, search=False)
    prepared = prepare_fmu(result, records)
    return check(prepared.local.model, prepared.estimation, noise=dict(study.noise), options=AT_REST), folder


def run_fmu_discovery(study: Study, output: Path | None, without: Sequence[str], **options: Any) -> PlantDiscovery:
    """The discovery around the FMU of a study. Raises GreyboxError."""
    from greybox.extensions.fmu.effects import discover_fmu, prepare_fmu
    from greybox.model.effects.catalogue import effect

    if not study.validation:
        raise DataError("no validation record: a discovery needs a record that was not fitted; give --validate FILE")
    result, records, validation, folder = _fit(study, DISCOVER, output)
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
    return PlantDiscovery(answer.discovery, str(answer), folder, lambda: fitted.save(folder / "fmu_fit.json"))


def run_fmu_comparison(study: Study, output: Path | None) -> tuple[Comparison, Records, Records, Path]:
    """The FMU of a study beside black boxes, its records and the others, and the folder for that. Raises GreyboxError."""
    from greybox.extensions.fmu.effects import compare_fmu, prepare_fmu

    result, records, validation, folder = _fit(study, COMPARE, output)
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


def _fit(
    study: Study, command: str, output: Path | None, *, search: bool = True
) -> tuple[FmuFit, tuple[Experiment, ...], tuple[Experiment, ...], Path]:
    """The fit of the FMU alone (its start values without a ``search``), the records and the folder."""
    from greybox.data.read import read_experiments
    from greybox.extensions.fmu.description import read_fmu
    from greybox.extensions.fmu.fit_fmu import fit_fmu

    idle = [
        study.label(name)
        for name, spec in fields_of(command).items()
        if name not in USED[command] and getattr(study, name) != getattr(Study(), name) and spec.flag
    ]
    if idle:
        raise GreyboxError(f"{', '.join(idle)}: no effect on an FMU, whose equations are closed; leave out")
    plant = read_fmu(study.model)
    model = plant.record_model
    folder = check_writable(output or Path("results") / f"{model.name}-{command}")
    layout = layout_of(study)
    records, validation = (
        read_experiments(
            files,
            model,
            hold=study.hold,  # type: ignore[arg-type]
            split=study.split_holes,
            allow_constant_input=study.free_decay or not plant.inputs,
            **layout,
        )
        if files
        else ()
        for files in (study.estimation, study.validation)
    )
    print_record_notes(records, validation)
    names = {v.name for v in plant.parameters} | {v.label for v in plant.parameters}
    start = {name: value for name, value in study.start.items() if name in names or not study.effects}
    result = fit_fmu(
        plant,
        records,
        free=study.free,
        start=start,
        fixed={name: value for name, value in study.fixed.items() if value is not None},
        noise=dict(study.noise) or None,
        validation=validation,
        search=search,
    )
    return result, records, validation, folder


def _fit_effects(prepared: PreparedFmu, names: Sequence[str], study: Study) -> Any:
    """Effects by name, each from where the records show it, then together with the FMU itself."""
    from greybox.discovery.effect_test import try_effect
    from greybox.estimation.fit import fit
    from greybox.extensions.fmu.effects import AT_REST, fit_fmu_effects

    noise = dict(study.noise) or None
    extended = fit(prepared.local.model, prepared.estimation, noise=noise, options=AT_REST)
    for name in names:
        extended = try_effect(extended, name, nominal=prepared.local.model).larger
    plain = {q.name for q in prepared.local.model.parameters}
    start = {n: v for n, v in extended.model.values.items() if n not in plain}
    start |= {n: v for n, v in study.start.items() if n in start}
    return fit_fmu_effects(prepared, extended.model.effects, start=start, noise=noise)


FMU = PlantKind((".fmu",), run_fmu_fit, run_fmu_check, run_fmu_comparison, run_fmu_discovery)
"""An FMU in the place of a model."""

PRINTS = {"fit": ("greybox.extensions.fmu.fit_fmu:FmuFit", "greybox.extensions.fmu.effects:FmuEffectFit")}
"""Command -> types of what it prints with ``--json``."""
