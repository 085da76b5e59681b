"""Running a model: free simulation, test signals, and records as files."""

from greybox.simulation.inputs import read_inputs
from greybox.simulation.signals import chirp, multisine
from greybox.simulation.simulate import Simulation, initial_state, simulate
from greybox.simulation.write import write_csv

__all__ = ["Simulation", "chirp", "initial_state", "multisine", "read_inputs", "simulate", "write_csv"]
