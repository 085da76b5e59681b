"""A linear model with names and units: matrices about an operating point, continuous or sampled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from greybox.errors import ModelError
from greybox.export.state_scaling import compute_poles
from greybox.findings import Finding
from greybox.values import Printable


@dataclass(frozen=True, eq=False)
class Linearisation(Printable):
    """``dx/dt = A x + B u, y = C x + D u`` for deviations from an operating point; with ``dt`` above zero ``x[k+1] = A x[k] + B u[k]``.

    Attributes
    ----------
    name
        Name of the model.
    A, B, C, D
        Matrices (nx, nx), (nx, nu), (ny, nx), (ny, nu).
    state_names, input_names, output_names
        Names in the order of the matrices.
    state_units, input_units, output_units
        Their units.
    x0, u0, y0
        The operating point: states (nx,), inputs (nu,), outputs (ny,).
    rates
        ``dx/dt`` (nx,) at the operating point, zero at an equilibrium.
    delay
        Seconds (nu,) by which each input arrives late, not in the matrices. A sampled model holds delays as states: then it is zero.
    parameters
        The parameters of the model, by name.
    dt
        Sampling time in seconds, 0 for continuous.
    method
        How it was sampled.
    findings
        What to know before using it.

    See Also
    --------
    sample, minimal_realisation, extract_channel, to_state_space, to_transfer_function : what is made of it.
    """

    name: str
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    state_names: tuple[str, ...]
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    state_units: tuple[str, ...]
    input_units: tuple[str, ...]
    output_units: tuple[str, ...]
    x0: np.ndarray
    u0: np.ndarray
    y0: np.ndarray
    rates: np.ndarray
    delay: np.ndarray
    parameters: Mapping[str, float]
    dt: float = 0.0
    method: str = ""
    findings: tuple[Finding, ...] = ()

    def __post_init__(self) -> None:
        infinite = [name for name in ("A", "B", "C", "D") if not np.isfinite(getattr(self, name)).all()]
        if infinite:
            raise ModelError(
                f"linear model of {self.name}: {' and '.join(infinite)} not finite; an equation has no finite slope at the operating"
                " point (a root at zero, a division by zero); give a point near it"
            )

    @property
    def poles(self) -> np.ndarray:
        """Eigenvalues of ``A`` (nx,), in 1/s, or in the z-plane for a sampled model; slowest first."""
        return compute_poles(self.A, self.dt)

    def frequency_response(self, omega: np.ndarray) -> np.ndarray:
        """Complex response (nw, ny, nu) at the angular frequencies ``omega`` (nw,) in rad/s, delays included."""
        w = np.atleast_1d(np.asarray(omega, float))
        point = np.exp(1j * w * self.dt) if self.dt else 1j * w
        resolvent = point[:, None, None] * np.eye(len(self.A)) - self.A
        response = self.C @ np.linalg.solve(resolvent, np.broadcast_to(self.B, (len(w), *self.B.shape))) + self.D
        return response * np.exp(-1j * w[:, None, None] * self.delay)

    def with_delay(self, seconds: float) -> Linearisation:
        """The same plant with every input arriving ``seconds`` later (a converter, a bus, the time of a computation)."""
        if not (np.isfinite(seconds) and seconds >= 0):
            raise ModelError(f"delay {seconds} s: give a time of 0 s or more")
        if seconds and self.dt:
            raise ModelError("a delay is added before sampling; use linearise(..., dt=..., delay=...)")
        return replace(self, delay=self.delay + seconds)
