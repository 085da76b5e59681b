"""What changed: a machine was fitted once, here are its records of today, those of its kind, or those of months."""

from typing import TYPE_CHECKING

from greybox.base.faces import lazy_face

if TYPE_CHECKING:
    from greybox.extensions.changes.chart import chart_changes
    from greybox.extensions.changes.detect import detect_changes
    from greybox.extensions.changes.population import survey_population
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

__getattr__, __all__ = lazy_face(
    __name__,
    {
        "greybox.extensions.changes.chart": ("chart_changes",),
        "greybox.extensions.changes.detect": ("detect_changes",),
        "greybox.extensions.changes.population": ("survey_population",),
        "greybox.extensions.changes.result": (
            "ChangeDetection",
            "ChangePoint",
            "ChangeVerdict",
            "ChartedRecord",
            "ConstantChange",
            "MachineReport",
            "PopulationConstant",
            "load_changes",
        ),
    },
)
