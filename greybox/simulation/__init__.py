"""From a model to runs: integrators, compiled kernels, filters, free simulation and simulated rigs."""

from greybox.simulation.simulate import (
    Simulation,
    SimulationPolicy,
    declared_initial_state,
    read_inputs,
    simulate,
    write_csv,
)

__all__ = ["Simulation", "SimulationPolicy", "declared_initial_state", "read_inputs", "simulate", "write_csv"]
