"""What changed: a machine was fitted once, here are its records of today, those of its kind, or those of months."""

from greybox.extensions.changes.chart import chart_changes
from greybox.extensions.changes.detect import detect_changes
from greybox.extensions.changes.policy import (
    ChangePolicy,
    ChangeTestPolicy,
    ChartPolicy,
    PopulationPolicy,
    SensitivityPolicy,
)
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

__all__ = [
    "ChangeDetection",
    "ChangePoint",
    "ChangePolicy",
    "ChangeTestPolicy",
    "ChangeVerdict",
    "ChartPolicy",
    "ChartedRecord",
    "ConstantChange",
    "MachineReport",
    "PopulationConstant",
    "PopulationPolicy",
    "SensitivityPolicy",
    "chart_changes",
    "detect_changes",
    "load_changes",
    "survey_population",
]
