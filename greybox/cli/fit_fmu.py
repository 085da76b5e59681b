"""`greybox fit plant.fmu`."""

from __future__ import annotations

from pathlib import Path

import typer

from greybox.cli.exit_codes import ExitCode
from greybox.cli.inputs import layout_of, print_record_notes
from greybox.cli.options import check_writable
from greybox.cli.study import FIT, Study, fields_of
from greybox.errors import GreyboxError

SIGNALS = "hold columns headers sampling_time read_limit interpolation split_holes free_decay"
USED = frozenset(["model", "estimation", "validation", "fixed", "start", "free", "noise", *SIGNALS.split()])
"""Fields of a study that a fit of an FMU uses."""


def is_fmu(study: Study) -> bool:
    """Whether the model of a study is an FMU."""
    return Path(study.model).suffix.lower() == ".fmu"


def run_fmu_fit(study: Study, output: Path | None, *, json: bool) -> None:
    """Fit the FMU of a study to its records, print the result and write fmu_fit.json. Raises GreyboxError."""
    from greybox.experiment import read_experiments
    from greybox.fmu import fit_fmu, read_fmu
    from greybox.rendering.cli import written
    from greybox.result import format_json

    specs = fields_of(FIT)
    idle = [
        study.label(name)
        for name, spec in specs.items()
        if name not in USED and getattr(study, name) != getattr(Study(), name) and spec.flag
    ]
    if idle:
        raise GreyboxError(f"{', '.join(idle)}: no effect on an FMU, whose equations are closed; leave out")
    plant = read_fmu(study.model)
    model = plant.record_model
    folder = check_writable(output or Path("results") / f"{model.name}-fit")
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
    fixed = {name: value for name, value in study.fixed.items() if value is not None}
    result = fit_fmu(
        plant,
        records,
        free=study.free,
        start=study.start,
        fixed=fixed,
        noise=dict(study.noise) or None,
        validation=validation,
    )
    saved = result.save(folder / "fmu_fit.json")
    typer.echo(format_json(result.as_dict()) if json else f"{result}\n\n{written([saved])}")
    if not result.success:
        raise typer.Exit(ExitCode.UNSUCCESSFUL)
