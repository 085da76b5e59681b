"""A linear model with names and units: matrices about an operating point, continuous or sampled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from greybox.errors import ModelError, nearest

if TYPE_CHECKING:
    from greybox.export.transfer_channel import TransferChannel


@dataclass(frozen=True, eq=False)
class Linearisation:
    """``dx/dt = A x + B u, y = C x + D u`` for deviations from an operating point; with ``dt`` above zero ``x[k+1] = A x[k] + B u[k]``.

    ``A`` (nx, nx), ``B`` (nx, nu), ``C`` (ny, nx), ``D`` (ny, nu); names and units in their order. ``x0``, ``u0``, ``y0``: the operating
    point; ``rates`` (nx,) its ``dx/dt``, zero at an equilibrium. ``delay`` (nu,): seconds by which each input arrives late, not in the
    matrices (a sampled model holds it as states: then it is zero). ``dt``: sampling time in seconds, 0 for continuous; ``method`` how it
    was sampled. ``parameters``: the constants behind it, by name. ``notes``: what to know before using it.
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
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        unfit = [name for name in ("A", "B", "C", "D") if not np.isfinite(getattr(self, name)).all()]
        if unfit:
            raise ModelError(
                f"linear model of {self.name}: {' and '.join(unfit)} not finite; an equation has no finite slope at the operating"
                " point (a root at zero, a division by zero); give a point beside it"
            )

    @property
    def poles(self) -> np.ndarray:
        """Eigenvalues of ``A`` (nx,), in 1/s, or in the z-plane for a sampled model; slowest first."""
        from greybox.export.transfer_channel import compute_poles

        return compute_poles(self.A, self.dt)

    def channel(self, output: str | None = None, input: str | None = None) -> TransferChannel:
        """Zeros, poles, gain and bandwidth from one input to one output (None: the first). Raises ModelError for unknown names."""
        from greybox.export.transfer_channel import extract_channel

        row = self._number("output", output, self.output_names)
        return extract_channel(self, row, self._number("input", input, self.input_names))

    def frequency_response(self, omega: np.ndarray) -> np.ndarray:
        """Complex response (nw, ny, nu) at the angular frequencies ``omega`` (nw,) in rad/s, delays included."""
        w = np.atleast_1d(np.asarray(omega, float))
        point = np.exp(1j * w * self.dt) if self.dt else 1j * w
        resolvent = point[:, None, None] * np.eye(len(self.A)) - self.A
        response = self.C @ np.linalg.solve(resolvent, np.broadcast_to(self.B, (len(w), *self.B.shape))) + self.D
        return response * np.exp(-1j * w[:, None, None] * self.delay)

    def sampled(self, dt: float, method: str = "zoh", *, delay: float = 0.0) -> Linearisation:
        """The same plant seen by a controller every ``dt`` seconds: see `greybox.export.sampling.sample`."""
        from greybox.export.sampling import sample

        return sample(self, dt, method, delay=delay)

    def late(self, seconds: float) -> Linearisation:
        """The same plant with every input arriving ``seconds`` later (a converter, a bus, the time of a computation)."""
        if not (np.isfinite(seconds) and seconds >= 0):
            raise ModelError(f"delay {seconds} s: give a time from 0 s up")
        if seconds and self.dt:
            raise ModelError("a delay is added before sampling; use linearise(..., dt=..., delay=...)")
        return replace(self, delay=self.delay + seconds)

    def minimal(self) -> Linearisation:
        """Without states that no input reaches or no output shows: see `greybox.export.minimal_realisation.minimal_realisation`."""
        from greybox.export.minimal_realisation import minimal_realisation

        return minimal_realisation(self)

    def state_space(self, pade: int = 4) -> Any:
        """``control.StateSpace`` with signal names; a delay of a continuous model becomes a Pade approximation of order ``pade``."""
        from greybox.export.python_control import to_state_space

        return to_state_space(self, pade)

    def transfer_function(self, pade: int = 4) -> Any:
        """``control.TransferFunction`` with signal names, one numerator and denominator for each channel."""
        from greybox.export.python_control import to_transfer_function

        return to_transfer_function(self, pade)

    def __str__(self) -> str:
        from greybox.export.summary import summarise_linearisation

        return summarise_linearisation(self)

    def _number(self, kind: str, name: str | None, names: tuple[str, ...]) -> int:
        if name is None and names:
            return 0
        if name not in names:
            raise ModelError(f"linear model of {self.name} has no {kind} {name!r}; {nearest(str(name), names)}")
        return names.index(name)
