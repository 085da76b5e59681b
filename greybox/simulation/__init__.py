"""Running a model: free simulation, test signals, and records as files."""

from greybox.simulation.inputs import read_inputs
from greybox.simulation.simulate import Simulation, declared_initial_state, simulate
from greybox.simulation.write import write_csv

__all__ = ["Simulation", "declared_initial_state", "read_inputs", "simulate", "write_csv"]
