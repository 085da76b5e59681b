"""Measured data: one frozen `Experiment` per record, and the readers that make it from a file."""

from greybox.data.experiment import Experiment, collect_record_findings
from greybox.data.read import read_csv, read_experiments

__all__ = ["Experiment", "collect_record_findings", "read_csv", "read_experiments"]
