"""The app in the browser: records beside the simulation, sliders, effects, fit and discover, on this machine alone."""

from greybox.extensions.app.session import LoadedRecord, Session, StudyBook
from greybox.extensions.app.workbench import Workbench

__all__ = ["LoadedRecord", "Session", "StudyBook", "Workbench"]
