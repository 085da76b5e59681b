"""The app without its page: the present session, what can be done to it, and what runs beside it.

Every step is kept and can be taken back; nothing that fails changes the session.
"""

from __future__ import annotations

import itertools
import math
import os
import shutil
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from greybox.base import DataError, GreyboxError, ModelError, format_unit, nearest, write_file
from greybox.base.document import FigureBlock
from greybox.base.figure import Figure
from greybox.base.files import OUTPUTS_FOLDER, find_free_path, is_output_of, list_foreign
from greybox.data.columns import ColumnChoice, merge_mappings
from greybox.data.experiment import GapError
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.localisation import ResidualLocalisation
from greybox.extensions.app.jobs import LAST_NEWS, Job, JobEvent, JobKind, JobNews
from greybox.extensions.app.session import LoadedRecord, Session
from greybox.extensions.export.python_model import to_python
from greybox.model import Effect, Model, equations_text
from greybox.model.effects.catalogue import all_effects, find_placements
from greybox.model.parts import PARTS
from greybox.model.system import Statement
from greybox.shell.project import remember_program
from greybox.show import describe, report
from greybox.show.documents.tables import MISFIT_HEADS, estimate_cells, misfit_cells
from greybox.show.figures.discovery import plot_misfit_windows
from greybox.show.figures.figure import typeset_unit
from greybox.show.figures.plotly_backend import height_on_page
from greybox.show.figures.records import plot_inputs, plot_residual, plot_run
from greybox.show.printers.html import figure_content, say
from greybox.show.printers.text import print_text
from greybox.simulation.kernel.c_compiler import find_cache_folder

if TYPE_CHECKING:
    from greybox.extensions.app.command import StudyOnFile

# What the page shows of a session, as plain values for JSON. Figures and sentences are those of the reports.

EffectPlace = tuple[Effect, str]
"""An effect and the site where it would act."""


def show_session(session: Session, places: Sequence[EffectPlace] = ()) -> dict[str, Any]:
    """Model, constants, effects, records and answers; ``places`` are the effects that can be put in."""
    model, constants = session.model, []
    for q in model.all_parameters:
        reach = session.ranges[q.name]
        # Interval and remark are those of the fit, as long as the constants are still its own.
        estimate = session.fit.parameters.get(q.name) if session.fit is not None and session.is_fitted else None
        cells = None if estimate is None or estimate.fixed else estimate_cells(q.name, estimate)
        constants.append(
            {
                "name": q.name,
                "unit": typeset_unit(q.unit),
                "description": q.description,
                "value": q.value,
                "fixed": q.fixed,
                "interval": "" if cells is None else cells[2],
                "remark": "" if cells is None else cells[4],
                "low": reach.low,
                "high": reach.high,
                "logarithmic": reach.logarithmic,
            }
        )
    known = dict.fromkeys(model.lacks, "lacks") | dict.fromkeys(model.has, "has")
    return {
        "model": model.name,
        "title": model.title,
        "description": model.description,
        "equations": equations_text(model),
        "constants": constants,
        "effects": [
            {"name": b.effect.name, "site": b.site, "equation": b.effect.equation} for b in model.bound_effects
        ],
        "catalogue": [{"name": e.name, "site": site, "equation": e.equation} for e, site in places],
        "parts": [{"name": p.name, "meaning": p.meaning, "known": known.get(p.name, "")} for p in PARTS],
        "records": [
            {
                "name": r.experiment.name,
                "rows": r.experiment.rows,
                "seconds": float(r.experiment.time[-1] - r.experiment.time[0]),
                "validates": r.validates,
                "notes": [str(finding) for finding in r.experiment.findings],
            }
            for r in session.records
        ],
        "fit": None if session.fit is None else {"text": print_answer(session.fit), "current": session.is_fitted},
        "discovery": None
        if session.discovery is None
        else {
            "verdict": str(session.discovery.verdict),
            "text": print_answer(session.discovery),
            "asked": next((f.subject for f in session.discovery.next_steps if f.code == DiscoveryCode.ASK_PART), ""),
        },
    }


# Letters of a line that is not wrapped.
UNWRAPPED = 100_000


def print_answer(result: Any) -> str:
    """The answer, the table and all notes, each a line that the browser wraps: it has room for them, and nothing to type for the rest."""
    return print_text(replace(describe(result), details=()), UNWRAPPED, details=True)


def show_choice(columns: Sequence[str], choices: Sequence[ColumnChoice]) -> dict[str, Any]:
    """The columns of a file, and the signals that a person says the columns of."""
    return {
        "columns": list(columns),
        "signals": [
            {
                "name": c.signal.name,
                "unit": format_unit(c.signal.unit),
                "kind": str(c.signal.kind),
                "column": c.column,
                "matched": c.matched,
                "stated": c.unit,
            }
            for c in choices
        ],
    }


def list_effects(model: Model, beside: tuple[Effect, ...] = ()) -> tuple[EffectPlace, ...]:
    """Every effect that has a place in ``model``, and the place."""
    places = find_placements(model, (*beside, *all_effects()))
    return tuple((place.effect, place.site) for place in places if place.effect is not None)


def show_run(session: Session, index: int, *, inputs: bool = False) -> dict[str, Any]:
    """One record beside the simulation: the run, the residual, the misfit; with what drove it."""
    result = session.simulate(index)
    trace, model = result.traces[0], session.model
    units = {o.name: o.unit for o in model.outputs} | {i.name: i.unit for i in model.inputs}
    # The noise that was given, else that of the last fit: a band around the residual.
    noise: Mapping[str, float] = session.noise or (session.fit.noise.std if session.fit is not None else {})
    figures = {
        "run": plot_run(trace, units, "run"),
        "residual": plot_residual(trace, units, noise, "residual"),
        "inputs": plot_inputs(trace, units, "inputs") if inputs else None,
    }
    # A row an output; empty cells where the run overflows.
    rows = [
        [output, *(misfit_cells(m) if math.isfinite(m.rmse) else [""] * len(MISFIT_HEADS))]
        for output, m in result.misfit.items()
    ]
    return {
        "record": index,
        "figures": {name: show_figure(figure) for name, figure in figures.items() if figure is not None},
        "misfit": {"heads": ["", *MISFIT_HEADS], "rows": rows},
        "overflows": not all(math.isfinite(m.rmse) for m in result.misfit.values()),
    }


def show_location(location: ResidualLocalisation, index: int) -> dict[str, Any]:
    """Where, when and as a function of what the model falls short."""
    windows = plot_misfit_windows(location)
    return {
        "record": index,
        "missing": location.is_missing,
        "text": str(location),
        "ratio": location.misfit if math.isfinite(location.misfit) else None,
        "figures": {} if windows is None else {"windows": show_figure(windows)},
    }


# Stretches by which a long curve is drawn, each by its smallest and largest value: a redraw while a slider moves must be quick.
APP_STRETCHES = 700


def show_figure(figure: Figure) -> dict[str, Any]:
    """A figure as the page's script draws it, and in words."""
    # The page draws the same figure as a report.
    content = figure_content(FigureBlock(figure, stretches=APP_STRETCHES))
    words = say(figure.description) or say(figure.caption)
    return {**content, "height": height_on_page(figure), "words": words, "caption": say(figure.caption)}


STUDY_FILE, SCRIPT_FILE, MODEL_FILE, RECORDS_FOLDER = "study.toml", "repeat.py", "model.py", "records"
LAST_FILE = "last.toml"
EXPORTED = (
    STUDY_FILE,
    SCRIPT_FILE,
    MODEL_FILE,
    LAST_FILE,
    "fit.json",
    "report.html",
    "discovery.json",
    "discovery.html",
)
# What the app's exports are remembered as.
EXPORTER = "app"
"""What an export is called, in its folder."""
JOURNAL = "journal.jsonl"


class UnmatchedRecordError(DataError):
    """A record whose headers do not say which column is which signal; ``choice`` is what a person can choose from."""

    def __init__(self, text: str, choice: Mapping[str, Any]) -> None:
        super().__init__(text)
        self.choice = choice


# Steps that can be taken back; each is a few values, but a fit among them holds its runs.
MOST_UNDONE = 100


class Workbench:
    """A session that changes.

    Parameters
    ----------
    session
        What it begins with.
    study
        Reads records and writes studies.
    folder
        Where exports go, and the journal of a discovery.
    beside
        Effects of the project, offered beside the catalogue.
    uploads
        Where the page puts files that a person loads there; they are gone when the app ends, so an export copies them.
    workers
        Processes that a discovery may use; 0 for one a core.
    listener
        Called with what the page is to hear, as plain values, in any thread.
    """

    def __init__(
        self,
        session: Session,
        study: StudyOnFile,
        folder: Path,
        *,
        beside: Sequence[Effect] = (),
        uploads: Path | None = None,
        workers: int = 0,
        listener: Callable[[Mapping[str, Any]], None] | None = None,
    ) -> None:
        self.study, self.folder = study, folder
        self.session = self._with_common_courses(session)
        self.beside, self.uploads, self.workers = tuple(beside), uploads, workers
        self.listener = listener or (lambda _: None)
        self.undone: list[Session] = []
        self.job: Job | None = None
        # Requests come one by one, but a job tells its news in a thread of its own.
        self._lock = threading.RLock()
        self._exported_session = session
        # Where uploaded records are copied to.
        self._copies = dict[Path, Path]()
        self._shown = 0
        self._places: tuple[Statement, tuple[EffectPlace, ...]] | None = None

    def show(self) -> dict[str, Any]:
        """The state of everything, as the page shows it; of two, the one with the higher ``number`` is the later."""
        with self._lock:
            # Answers may overtake one another: the page shows the latest.
            self._shown += 1
            # Without a record there is no study to repeat.
            texts = {"study": "", "script": ""}
            if self.session.records:
                session = self._with_exported_records(self.session)
                texts["study"] = self.study.write_study(session, self.folder / STUDY_FILE)
                texts["script"] = self.study.write_script(session, self.folder / SCRIPT_FILE)
            return {
                **show_session(self.session, self._list_effects()),
                **texts,
                "number": self._shown,
                "folder": str(self.folder),
                "undo": len(self.undone),
                "job": None if self.job is None else str(self.job.kind),
            }

    @np.errstate(over="ignore", invalid="ignore")  # a constant may be moved to where the run overflows: that is shown
    def show_run(self, index: int, values: Mapping[str, float] | None = None, *, inputs: bool = False) -> dict:
        """One record beside the simulation, at other ``values`` for a look that changes nothing."""
        session = self.session.with_values(values) if values else self.session
        return show_run(session, index, inputs=inputs)

    @np.errstate(over="ignore", invalid="ignore")
    def show_location(self, index: int) -> dict[str, Any]:
        """Where the model falls short on one record."""
        return show_location(self.session.localise(index), index)

    def set_values(self, values: Mapping[str, float]) -> None:
        """Set constants. Raises ModelError."""
        self._take(self.session.with_values(values))

    def set_fixed(self, name: str, fixed: bool) -> None:
        """Fix a constant, or free it. Raises ModelError."""
        self._take(self.session.with_fixed(name, fixed))

    @np.errstate(over="ignore", invalid="ignore")
    def add_effect(self, name: str) -> None:
        """Put an effect in. Raises ModelError for a name that has no place in the model."""
        # Looked up by name, so that a page can only ask for what has a place.
        places = {effect.name: effect for effect, _ in self._list_effects()}
        if name in {e.name for e in self.session.model.effects}:
            raise ModelError(f"effect {name}: the model contains it already; take it out first")
        if name not in places:
            raise ModelError(f"effect {name!r} has no place in this model; {nearest(name, list(places))}")
        self._take(self.session.with_effect(places[name]))

    def remove_effect(self, name: str) -> None:
        """Take an effect out. Raises ModelError."""
        self._take(self.session.without_effect(name))

    def set_part(self, name: str, known: str) -> None:
        """Say that the rig ``has`` or ``lacks`` a part, or nothing of it. Raises ModelError."""
        self._take(self.session.with_part(name, known))

    def load(self, file: Path, *, validates: bool = False, columns: Mapping[str, str] | None = None) -> None:
        """Read a record. Raises GreyboxError, and then nothing has changed.

        ``columns`` says which column is which signal and in which unit, as ``--column`` does: for all records, so those that are there
        are read anew.
        """
        session = self.session
        if columns:
            # One choice of columns holds for all records: those that are there are read anew.
            merged = merge_mappings(session.columns, columns)
            session = replace(session, columns=merged)
            session = replace(session, records=self._read_again(session))
        try:
            records = self.study.read([file], session.columns, split=session.split)
        except GapError:
            raise
        except DataError as error:
            # A record that lacks columns asks the person; anything else that is wrong with it is said.
            proposal = self.study.propose_columns(file, session.columns)
            if proposal is None:
                raise
            raise UnmatchedRecordError(str(error), show_choice(*proposal)) from error
        self._take(session.with_records([LoadedRecord(record, file, validates) for record in records]))

    def split(self) -> None:
        """Read the records anew, each split where its time has gaps; and those that follow. Raises GreyboxError."""
        # Behind a gap a plant is in motion, however the record began.
        session = replace(self.session, split=True, options=replace(self.session.options, at_rest=False))
        self._take(replace(session, records=self._read_again(session)))

    def _read_again(self, session: Session) -> tuple[LoadedRecord, ...]:
        """The records of ``session``, its files read with its columns and split as it says. Raises GreyboxError."""
        fresh: list[LoadedRecord] = []
        before = self.session.split
        for file, group in itertools.groupby(self.session.records, key=lambda record: record.file):
            present = list(group)
            try:
                records = {r.name: r for r in self.study.read([file], session.columns, split=session.split)}
            except GapError:
                raise
            except DataError as error:
                raise DataError(
                    f"{error}. One choice of columns holds for all records: remove {file.name} first, or give both files the same headers"
                ) from error
            if session.split is before:
                fresh += [replace(r, experiment=records[r.experiment.name]) for r in present]
            else:
                fresh += [LoadedRecord(record, file, present[0].validates) for record in records.values()]
        return tuple(fresh)

    def forget(self, index: int) -> None:
        """Put a record away. Raises DataError."""
        self._take(self.session.without_record(index))

    def set_role(self, index: int, validates: bool) -> None:
        """Let a record judge, or be fitted. Raises DataError."""
        self._take(self.session.with_role(index, validates))

    def undo(self) -> None:
        """Take the last step back. Raises GreyboxError where there is none."""
        with self._lock:
            if not self.undone:
                raise GreyboxError("nothing to take back: this is where the session began")
            self.session = self.undone.pop()

    def start(self, kind: JobKind) -> None:
        """Begin a fit or a discovery. Raises GreyboxError while another runs, and DataError without the records it needs."""
        with self._lock:
            if self.job is not None:
                raise GreyboxError(f"a {self.job.kind} is running; stop it first, or wait for its answer")
            if not self.session.estimation:
                raise DataError(f"{kind}: no record to fit; load one, or let one of them be fitted")
            if kind is JobKind.DISCOVER and not self.session.validation:
                raise DataError(
                    "discover: no validation record; load another record for validation, which is not fitted"
                )
            self.job = Job(kind, self.session, journal=self.folder / JOURNAL, workers=self.workers, listener=self._hear)

    def stop(self) -> None:
        """Ask what runs to end: a fit keeps its best point, a discovery its finished refits; asked again, it ends at once."""
        job = self.job
        if job is not None:
            job.stop()

    def export(self) -> list[Path]:
        """Write the study, the program, the model, uploaded records, and the fit and the discovery as far as there are any."""
        session = self.session
        if not session.records:
            raise DataError("export: no record yet, so there is no study to write; load one first")
        # Taken before anything is written: what changes meanwhile is not in the files.
        self._exported_session = self.session
        self._settle_folder()
        # The study names files that are there on another day.
        copies = self._copy_records()
        session = self._with_exported_records(session)
        study, script = self.folder / STUDY_FILE, self.folder / SCRIPT_FILE
        files = [
            to_python(session.model, self.folder / MODEL_FILE),
            write_file(study, self.study.write_study(session, study)),
            write_file(script, self.study.write_script(session, script)),
            *copies,
        ]
        # A fit whose constants were moved since is no result of this session.
        if session.fit is not None and session.is_fitted:
            files.append(session.fit.save(self.folder / "fit.json"))
            files.append(report(session.fit, self.folder / "report.html"))
        if session.discovery is not None:
            files.append(session.discovery.save(self.folder / "discovery.json"))
            files.append(report(session.discovery, self.folder / "discovery.html"))
        self._remember(files)
        return files

    def save_last(self) -> Path | None:
        """Write the study of a session that has changed since its last export; None where there is nothing to lose."""
        if not self.session.records or self.session is self._exported_session:
            return None
        self._settle_folder()
        self._copy_records()
        session, target = self._with_exported_records(self.session), self.folder / LAST_FILE
        model = to_python(session.model, self.folder / MODEL_FILE)
        self._remember([model, write_file(target, self.study.write_study(session, target))])
        return target

    def _settle_folder(self) -> None:
        """Export to ``name-2``, ``name-3`` beside the folder where a file in it is none that the app wrote: nobody's work is replaced."""
        first, memory = self.folder, find_cache_folder() / OUTPUTS_FOLDER
        for count in itertools.count(2):
            present = [path for path in map(self.folder.joinpath, EXPORTED) if os.path.lexists(path)]
            if all(path.is_file() and is_output_of(path, EXPORTER, memory) for path in present):
                return
            self.folder, self._copies = first.with_name(f"{first.name}-{count}"), {}

    def _remember(self, files: Iterable[Path]) -> None:
        """Know these files for what the app wrote, when it exports again, in this session or in another."""
        list_foreign(dict.fromkeys(files, ""), EXPORTER, find_cache_folder() / OUTPUTS_FOLDER)
        remember_program(str(self.folder / MODEL_FILE))

    def close(self) -> None:
        """End what runs."""
        job = self.job
        if job is not None:
            job.end()

    def _with_exported_records(self, session: Session) -> Session:
        """The session with uploaded records where an export copies them, so that the study finds them on another day."""
        moved = tuple(replace(r, file=self._exported(r.file)) for r in session.records)
        return replace(session, records=moved)

    def _exported(self, file: Path) -> Path:
        # Files of the person stay where they are.
        if self.uploads is None or self.uploads not in file.parents:
            return file
        if file not in self._copies:
            # A record of another session may have this name: a study that names it must find it on another day.
            wanted = self.folder / RECORDS_FOLDER / file.name
            self._copies[file] = find_free_path(wanted, file, self._copies.values())
        return self._copies[file]

    def _copy_records(self) -> list[Path]:
        """Copy uploaded records into the folder of the export."""
        copies = []
        for source in dict.fromkeys(r.file for r in self.session.records):
            target = self._exported(source)
            if target != source and not target.exists():
                with source.open("rb") as uploaded:
                    copies.append(write_file(target, partial(shutil.copyfileobj, uploaded)))
        return copies

    def _list_effects(self) -> tuple[EffectPlace, ...]:
        """The effects that can be put in; looked for anew where the equations have changed."""
        statement = self.session.model.statement
        # Sliders change values, not equations: the search for places is made once for these.
        if self._places is None or self._places[0] != statement:
            self._places = statement, list_effects(self.session.model, self.beside)
        return self._places[1]

    def _with_common_courses(self, session: Session) -> Session:
        """The session with inputs that move alike in all its records, as those that a study reads together."""
        courses, records = self.study.find_courses(session.records), list(session.records)
        for k, record in enumerate(records):
            if any(record.experiment.courses.get(name, course) != course for name, course in courses.items()):
                again = self.study.read([record.file], session.columns, split=session.split, courses=courses)
                records[k] = replace(record, experiment=next(e for e in again if e.name == record.experiment.name))
        return replace(session, records=tuple(records))

    def _take(self, session: Session) -> None:
        if session.records is not self.session.records:
            session = self._with_common_courses(session)
        with self._lock:
            # Sessions are frozen: a step back is the value that was there.
            self.undone = [*self.undone, self.session][-MOST_UNDONE:]
            self.session = session

    def _hear(self, event: JobEvent) -> None:
        """What the job tells: its answer becomes the session's."""
        if event.news is JobNews.DONE:
            with self._lock:
                # The answer may come after the app has given the job up.
                job, self.job = self.job, None
                if job is None:
                    return
                # A discovery began with the model of its own session, which the person may have left meanwhile.
                if job.kind is JobKind.DISCOVER:
                    self._take(self.session.with_discovery(event.content, job.session.model))
                else:
                    self._take(self.session.with_fit(event.content))
            self.listener({"news": str(event.news), "kind": str(job.kind)})
            return
        if event.news in LAST_NEWS:
            with self._lock:
                self.job = None
        self.listener({"news": str(event.news), "content": event.content})
