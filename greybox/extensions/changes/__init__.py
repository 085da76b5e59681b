"""What changed: a machine was fitted once, here are its records of today, those of its kind, or those of months."""

from typing import TYPE_CHECKING

from greybox.base.faces import lazy_face

if TYPE_CHECKING:
    from greybox.extensions.changes.detect import detect_changes
    from greybox.extensions.changes.result import (
        ChangeDetection,
        ChangePoint,
        ChangeVerdict,
        ChartedRecord,
        ConstantChange,
        MachineReport,
        PopulationConstant,
        load_changes,
    )
    from greybox.extensions.changes.survey import chart_changes, survey_population

__getattr__, __all__, __dir__ = lazy_face(__name__)
