"""`greybox app`."""

from __future__ import annotations

import asyncio
import json as json_format
import os
import tempfile
import webbrowser
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

import click

from greybox.base import GreyboxError, ModelError
from greybox.shell import inputs, options
from greybox.shell.fit import FIT
from greybox.shell.study import Command, Idle, Option, Study
from greybox.shell.study_file import study_text
from greybox.shell.study_script import study_script
from greybox.shell.study_values import Count, Switch
from greybox.shell.terminal import print_answer

if TYPE_CHECKING:
    from greybox.data.columns import ColumnChoice
    from greybox.data.experiment import Experiment
    from greybox.data.input_course import Hold
    from greybox.extensions.app.session import LoadedRecord, Session
    from greybox.model import Model


class PrintedAddress(TypedDict):
    """What ``greybox app --json`` prints once the page is served.

    Attributes
    ----------
    address
        What a browser opens; whoever has it can use the app.
    folder
        Where it exports to.
    """

    address: str
    folder: str


APP = "app"
MODEL_FILE = "model.py"
"""The model itself, in the folder of an export."""


class AppStudy(Study):
    """The options of `greybox app`."""

    port = Option(Count(most=65535), "--port N", "", "Port to listen on. [default: any free one]")
    no_browser = Option(Switch(), "--no-browser", "", "Print the address, and do not open a browser.")


def app(study: AppStudy) -> None:
    """Open MODEL in the browser: records beside the simulation, with a slider for each constant.

    Effects are put in and taken out with a click; the residual and where it lives are shown; fit and discover run with their
    progress, and can be stopped. More records are loaded in the page. Export writes to DIR what repeats it: a study file, a Python
    program, the model, the fit and the discovery.

    The page is served on this machine alone, at an address with a token that nobody else knows. Ctrl-C ends it.

    greybox app study.toml opens a study.

    Exit code 0: ended. 2: bad input, nothing was opened.
    """
    from greybox.data.identity import refuse_repeated
    from greybox.data.noise.noise_sources import check_given_noise
    from greybox.extensions.app.session import LoadedRecord, Session
    from greybox.extensions.app.workbench import Workbench
    from greybox.shell.own_effects import find_own_effects

    if per_record := [name for name, values in study.conditions.items() if values is not None]:
        raise GreyboxError(
            f"{study.label('conditions')} {', '.join(per_record)}: records are loaded one by one in the app, so each must bring its"
            f" own value; write it into the files, and give {study.label('conditions')} {per_record[0]} without a value"
        )
    try:
        from greybox.extensions.app.server import serve
    except ModuleNotFoundError as error:
        raise GreyboxError(
            f"greybox app needs the package {error.name}; install it with: pip install 'greybox-sysid[app]'"
        ) from None
    model = inputs.constrain(inputs.build_model(study), study)
    inputs.check_substeps(study, model)
    check_given_noise(model, dict(study.noise))
    folder = inputs.result_folder(study, model.name)
    book = StudyOnFile(study, model)
    records = [
        LoadedRecord(record, file, validates)
        for files, validates in ((study.estimation, False), (study.validation, True))
        for file in files
        for record in book.read([file], study.columns, validates=validates, split=study.split_holes)
    ]
    refuse_repeated(r.experiment for r in records if not r.validates)
    judges = [r.experiment for r in records if r.validates]
    inputs.check_skip(study, judges)
    inputs.print_record_notes([r.experiment for r in records], loss=study.loss)
    session = Session(
        model,
        tuple(records),
        dict(study.noise),
        inputs.read_quiet_records(study, model),
        inputs.fit_options(study),
        study.skip,
        study.beginning,
        study.columns,
        study.split_holes,
    )

    def announce(address: str) -> None:
        if study.json:
            click.echo(json_format.dumps({"address": address, "folder": str(folder)}, indent=2))
            return
        print_answer(f"{address}\n")
        if not study.no_browser:
            webbrowser.open(address)

    with tempfile.TemporaryDirectory(prefix="greybox-") as uploads:
        bench = Workbench(
            session, book, folder, beside=find_own_effects(), uploads=Path(uploads).resolve(), workers=study.workers
        )
        with suppress(KeyboardInterrupt):  # that is how it ends
            asyncio.run(serve(bench, study.port, announce))
        last = bench.save_last()
    if last is not None and not study.json:
        from greybox.show.sentences.shell import study_line

        print_answer(study_line(last, APP))


class StudyOnFile:
    """A study that was opened: how further records are read, and how a session is written as a study.

    Parameters
    ----------
    study
        As it was opened.
    model
        The model that it gave.
    """

    def __init__(self, study: Study, model: Model) -> None:
        self.study, self.model = study, model

    def read(
        self,
        files: Sequence[Path],
        columns: Mapping[str, str],
        *,
        validates: bool = False,
        split: bool = False,
        courses: Mapping[str, Hold] | None = None,
    ) -> tuple[Experiment, ...]:
        """The records in ``files``, as the study reads its own but for the ``columns``, ``split`` at gaps. Raises GreyboxError.

        ``courses``: input -> how it moves in the other records, where the study does not say it.
        """
        estimation, validation = ((), tuple(files)) if validates else (tuple(files), ())
        study = self.study.but(estimation=estimation, validation=validation, columns=columns)
        study = study.but(interpolation={**(courses or {}), **study.interpolation})
        if split and not study.split_holes:  # behind a gap the plant is in motion
            study = study.but(split_holes=True, at_rest=False)
        return tuple(record for group in inputs.read_records(study, self.model) for record in group)

    def find_courses(self, records: Sequence[LoadedRecord]) -> Mapping[str, Hold]:
        """How each input moves in every one of the ``records``, as they would be read together: those that are fitted tell it."""
        from greybox.data.read import find_shared_courses

        fitted = [r.experiment for r in records if not r.validates]
        if self.study.hold != "auto" or not fitted:
            return {}
        return {**fitted[0].courses, **find_shared_courses(fitted, "auto", self.study.interpolation)}

    def propose_columns(
        self, file: Path, columns: Mapping[str, str]
    ) -> tuple[tuple[str, ...], tuple[ColumnChoice, ...]] | None:
        """The columns of a file that lacks some of the model's, and which each signal may be; None where no choice would help."""
        from greybox.data.columns import propose_columns
        from greybox.data.file_kinds import open_record_file
        from greybox.data.policy import READING_POLICY

        if self.study.headers:
            return None
        table = open_record_file(file, policy=inputs.layout_of(self.study).get("reading", READING_POLICY)).table
        return propose_columns(table, self.model, columns, has_clock=self.study.sampling_time > 0)

    def write_study(self, session: Session, path: Path) -> str:
        """The text of the study file ``path``, from which ``greybox fit`` computes the same."""
        from greybox.shell.commands import COMMANDS

        return study_text(self._defined(session, path.parent), path, "fit", COMMANDS)

    def write_script(self, session: Session, path: Path) -> str:
        """The text of the Python program ``path`` that computes the same."""
        study = self._defined(session, path.parent)
        if session.discovery is None or session.searched is None or not study.validation:
            return study_script(study, path)
        return study_script(study, path, searched=self._defined(replace(session, model=session.searched), path.parent))

    def _defined(self, session: Session, folder: Path) -> Study:
        """The study with what its model states, unless that is a file which the app writes beside it."""
        from greybox.shell.project import find_model, remember_program

        study = self.to_study(session, folder)
        if study.model != self.study.model:
            return study
        remember_program(study.model)
        return study.but(definition=inputs.state_in_study(find_model(study.model), study))

    def to_study(self, session: Session, folder: Path) -> Study:
        """The study that a session is by now; its model a file in ``folder`` where it has no name."""
        effects = self._named_effects(session)
        estimation, validation = (
            tuple(dict.fromkeys(_beside(r.file, folder) for r in session.records if r.validates is validates))
            for validates in (False, True)
        )
        study = self.study.but(
            estimation=estimation,
            validation=validation,
            columns=session.columns,
            split_holes=session.split,
            at_rest=session.options.at_rest,
            file=None,
            from_file=frozenset(),
            unused=(),
        )
        bare = study.but(start={}, fixed={}, free=(), has=tuple(session.model.has), lacks=tuple(session.model.lacks))
        if effects is None:
            return bare.but(
                model=str(_beside(folder / MODEL_FILE, folder)), effects=(), schedules={}, process_noise={}, ties={}
            )
        bare = bare.but(effects=effects)
        declared = {q.name: q for q in inputs.build_model(bare).all_parameters}
        present = [q for q in session.model.all_parameters if q.name in declared]
        return bare.but(
            start={q.name: q.value for q in present if not q.fixed and q.value != declared[q.name].value},
            fixed={
                q.name: q.value if q.value != declared[q.name].value else None
                for q in present
                if q.fixed and (not declared[q.name].fixed or q.value != declared[q.name].value)
            },
            free=tuple(q.name for q in present if not q.fixed and declared[q.name].fixed),
        )

    def _named_effects(self, session: Session) -> tuple[str, ...] | None:
        """Names of the effects that were put in, if names are enough to put them in again."""
        from greybox.shell.own_effects import find_effect
        from greybox.shell.project import find_model

        brought = [e.name for e in find_model(self.study.model).effects]
        names = [e.name for e in session.model.effects]
        if names[: len(brought)] != brought:
            return None
        try:
            for name in names[len(brought) :]:
                find_effect(name)
        except ModelError:
            return None
        return tuple(names[len(brought) :])


def _beside(file: Path, folder: Path) -> Path:
    """A file in ``folder`` as seen from the working folder, so that the study names it relative to itself; any other as it is."""
    inside = folder.absolute() in file.absolute().parents
    return Path(os.path.relpath(file)) if inside else file


NOT_HERE = (Study.profiles, Study.bootstrap, Study.predict, Study.time_limit, Study.seed, Study.starts)

COMMAND = Command(
    app,
    "Open a model and its records in the browser.",
    (
        *(*FIT.in_study().values(), Study.estimation, Study.workers, AppStudy.port, AppStudy.no_browser),
        *(Study.has, Study.lacks),
        Study.output.but(help="Folder for what is exported. [default: results/MODEL-app]"),
        Study.json.but(help="Print the address as JSON instead of text, and open no browser."),
    ),
    (
        "greybox app micro_actuator train.csv --validate test.csv --fix M=0.01 --at-rest",
        "greybox app my/rig.py",
        "greybox app study.toml",
    ),
    (
        *(options.LAYOUT, options.SUBSTEPS),
        Idle(NOT_HERE, "in the app", remedy=", and give {it} to greybox fit with the study that the app exports"),
    ),
    study=AppStudy,
    like="fit",
)

PRINTS = {"app": ("greybox.extensions.app.command:PrintedAddress",)}
"""Command -> types of what it prints with ``--json``."""
