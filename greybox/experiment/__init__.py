"""Measured data: one frozen `Experiment` per record, and the readers that make it from a file."""

from greybox.experiment.experiment import Experiment
from greybox.experiment.read import read_csv, read_experiments

__all__ = ["Experiment", "read_csv", "read_experiments"]
