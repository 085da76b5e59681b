"""The app in the browser: records beside the simulation, sliders, effects, fit and discover, on this machine alone."""

from greybox.app.session import LoadedRecord, Session
from greybox.app.study_book import StudyBook
from greybox.app.workbench import Workbench

__all__ = ["LoadedRecord", "Session", "StudyBook", "Workbench"]
