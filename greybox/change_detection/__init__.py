"""What changed: a machine was fitted once, here are its records of today, those of its kind, or those of months."""

from greybox.change_detection.chart import chart_changes
from greybox.change_detection.detect import detect_changes
from greybox.change_detection.policy import (
    ChangePolicy,
    ChangeTestPolicy,
    ChartPolicy,
    PopulationPolicy,
    SensitivityPolicy,
)
from greybox.change_detection.population import survey_population
from greybox.change_detection.result import (
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
