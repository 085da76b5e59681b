"""Running a model: free simulation, and records as files. Test signals are in `greybox.signals`."""

from greybox.simulation.inputs import read_inputs
from greybox.simulation.simulate import Simulation, SimulationPolicy, declared_initial_state, simulate
from greybox.simulation.write import write_csv

__all__ = ["Simulation", "SimulationPolicy", "declared_initial_state", "read_inputs", "simulate", "write_csv"]
