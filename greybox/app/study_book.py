"""What the app asks of whoever knows how studies are written: the command line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

from greybox.app.session import Session
from greybox.experiment import Experiment
from greybox.experiment.columns import ColumnChoice


class StudyBook(Protocol):
    """Reads records as a study says, and writes a session as the study and the program that repeat it."""

    def read(self, files: Sequence[Path], columns: Mapping[str, str]) -> tuple[Experiment, ...]:
        """The records in ``files``, where ``columns`` are as in `Session`. Raises GreyboxError."""
        ...

    def propose_columns(
        self, file: Path, columns: Mapping[str, str]
    ) -> tuple[tuple[str, ...], tuple[ColumnChoice, ...]] | None:
        """The columns of a file that lacks some of the model's, and which each signal may be; None where no choice would help."""
        ...

    def write_study(self, session: Session, path: Path) -> str:
        """The text of the study file ``path``, from which ``greybox fit`` computes the same."""
        ...

    def write_script(self, session: Session, path: Path) -> str:
        """The text of the Python program ``path`` that computes the same."""
        ...
