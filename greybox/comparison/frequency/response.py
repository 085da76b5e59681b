"""A measured frequency response: complex points with their variance, from arrays or a file."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from greybox.base.errors import DataError, nearest
from greybox.base.values import Printable
from greybox.data.file_kinds import open_record_file
from greybox.data.headers import Column, parse_header
from greybox.data.notation import read_conversion
from greybox.data.policy import READING_POLICY, ReadingPolicy
from greybox.data.problems import raise_problems

FREQUENCY = {"frequency": "Hz", "freq": "Hz", "f": "Hz", "omega": "rad/s", "w": "rad/s"}
"""Names of the frequency column, with the unit that they have where the header gives none."""
PARTS = ("real", "imag", "magnitude", "mag", "gain", "phase", "coherence", "std", "variance")


@dataclass(frozen=True, eq=False)
class FrequencyResponse(Printable):
    """Points of a frequency response from inputs to outputs.

    Parameters
    ----------
    frequency : array (nf,)
        Frequencies in Hz, above zero and increasing.
    response : array (nf, ny, nu)
        Complex response, in the model's units; NaN where it was not measured.
    inputs, outputs
        Names of the signals.
    variance : array (nf, ny, nu), optional
        Expected square of the error's magnitude at each point; None where nobody knows it.
    sampling_time
        Of a response of a held input and a sampled output, in seconds; 0 for a continuous one.
    name
        What results call it.
    with_phase
        Whether the phase was measured. Without it ``response`` holds magnitudes, and ``variance`` is theirs.

    Raises
    ------
    DataError
        When shapes do not fit, or a frequency is not above the one before.

    Examples
    --------
    >>> points = FrequencyResponse.from_points([1, 2, 5], [1.0, 0.9, 0.5], [-0.1, -0.3, -0.8], "u", "y")
    >>> points.points
    3
    """

    frequency: np.ndarray
    response: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    variance: np.ndarray | None = None
    sampling_time: float = 0.0
    name: str = "frequency response"
    with_phase: bool = True

    def __post_init__(self) -> None:
        frequency = np.asarray(self.frequency, dtype=float)
        shape = (len(frequency), len(self.outputs), len(self.inputs))
        response = np.asarray(self.response, dtype=complex)
        if response.shape != shape:
            raise DataError(f"{self.name}: the response has shape {response.shape}; {shape} is needed")
        if (
            not len(frequency)
            or not np.isfinite(frequency).all()
            or frequency[0] <= 0
            or np.any(np.diff(frequency) <= 0)
        ):
            raise DataError(f"{self.name}: frequencies must be above 0 Hz and increase from point to point")
        if not np.isfinite(response).any():
            raise DataError(f"{self.name}: no point holds a value")
        object.__setattr__(self, "frequency", frequency)
        object.__setattr__(self, "response", response)
        if self.variance is not None:
            variance = np.asarray(self.variance, dtype=float)
            if variance.shape != shape:
                raise DataError(f"{self.name}: the variance has shape {variance.shape}; {shape} is needed")
            if np.any(variance[np.isfinite(response)] <= 0):
                raise DataError(f"{self.name}: a variance is not above 0; leave out points that are known exactly")
            object.__setattr__(self, "variance", variance)

    @property
    def points(self) -> int:
        """Number of complex points with a value."""
        return int(np.isfinite(self.response).sum())

    @classmethod
    def from_points(
        cls,
        frequency: Sequence[float] | np.ndarray,
        magnitude: Sequence[float] | np.ndarray,
        phase: Sequence[float] | np.ndarray | None,
        input: str,
        output: str,
        *,
        coherence: Sequence[float] | np.ndarray | None = None,
        averages: int = 1,
        std: Sequence[float] | np.ndarray | None = None,
        name: str = "frequency response",
    ) -> FrequencyResponse:
        """A response of one channel from its Bode points.

        Parameters
        ----------
        frequency, magnitude, phase
            Hz, gain (not in dB), and radians, each (nf,); None for a phase that was not measured.
        input, output
            Names of the signals.
        coherence, averages
            Coherence (nf,) and the number of averages behind it: the variance is ``|G|^2 (1 - c) / (c averages)`` with the squared
            coherence ``c`` (Bendat, Piersol: Random Data, section 9.2).
        std
            Standard deviation of the complex points (nf,), in the place of a coherence.
        name
            What results call it.
        """
        response = np.asarray(magnitude, float) * np.exp(1j * np.asarray(0.0 if phase is None else phase, float))
        variance = None if std is None else np.asarray(std, float) ** 2
        if coherence is not None:
            share = np.asarray(coherence, float)
            if np.any((share <= 0) | (share > 1)):
                raise DataError(f"{name}: a coherence is not between 0 and 1")
            floor = np.finfo(float).eps
            # |G|^2 (1 - c) / (c n); a coherence of one would make a point infinitely certain, hence the floor.
            variance = np.abs(response) ** 2 * np.maximum(1 - share, floor) / (share * averages)
        cube = None if variance is None else variance[:, None, None]
        points = np.asarray(frequency, float), response[:, None, None]
        return cls(*points, (input,), (output,), cube, name=name, with_phase=phase is not None)


def read_frequency_response(
    path: str | os.PathLike[str],
    input: str,
    output: str,
    *,
    columns: Mapping[str, str] | None = None,
    averages: int = 1,
    reading: ReadingPolicy = READING_POLICY,
) -> FrequencyResponse:
    """Read the response of one channel from a file of any kind that records are read from.

    Headers are ``frequency [Hz]`` or ``omega [rad/s]``; ``real`` and ``imag``, or ``magnitude`` (``[dB]`` too), alone or with ``phase``
    (degrees unless the unit is rad); and, if known, ``coherence``, ``std`` or ``variance`` of the points.

    Parameters
    ----------
    path
        The file.
    input, output
        Names of the signals of the model.
    columns
        Column -> header, where the file's headers are others.
    averages
        Averages behind a coherence.
    reading
        How large the file may be.

    Returns
    -------
    FrequencyResponse
        The points in the order of frequency.

    Raises
    ------
    DataError
        For a file that cannot be read, or lacks a column.
    """
    file = open_record_file(Path(path), policy=reading)
    headers = {c.name.lower(): c for k, h in enumerate(file.table.headers) for c in [parse_header(h, k)]}
    for name, header in (columns or {}).items():
        match = next((c for c in headers.values() if header in (c.header, c.name)), None)
        if match is None:
            raise DataError(
                f"{file.path.name}: no column {header!r}; {nearest(header, [c.header for c in headers.values()])}"
            )
        headers[name] = match
    clock = next((headers[name] for name in FREQUENCY if name in headers), None)
    parts = {name: headers[name] for name in PARTS if name in headers}
    if clock is None:
        raise DataError(f"{file.path.name}: no column for the frequency; call one 'frequency [Hz]' or 'omega [rad/s]'")
    wanted = [clock, *parts.values()]
    values = file.values([c.position for c in wanted])
    raise_problems(file.path.name, values.problems)

    def read(column: Column, unit: str) -> np.ndarray:
        raw = values.arrays[column.position]
        return read_conversion(column.unit or unit, unit)(raw)

    raw = values.arrays[clock.position]
    by_name = FREQUENCY.get(clock.name.lower(), "Hz")
    # 1/s is a frequency or an angular one: the name tells.
    unit = by_name if clock.unit.replace(" ", "") in ("", "1/s", "s^-1") else clock.unit
    frequency = read_conversion(unit, "Hz")(raw)
    magnitude = next((parts[n] for n in ("magnitude", "mag", "gain") if n in parts), None)
    if "real" in parts and "imag" in parts:
        response: np.ndarray = values.arrays[parts["real"].position] + 1j * values.arrays[parts["imag"].position]
    elif magnitude is not None:
        gain = values.arrays[magnitude.position]
        response = 10 ** (gain / 20) if magnitude.unit.lower() == "db" else gain
        if "phase" in parts:
            angle = values.arrays[parts["phase"].position]
            angle = read_conversion(parts["phase"].unit or "deg", "rad")(angle)
            response = np.asarray(response * np.exp(1j * angle))
    else:
        raise DataError(f"{file.path.name}: give the columns real and imag, or magnitude, with phase or alone")
    # Files of swept sines may run downwards.
    order = np.argsort(frequency)
    known: dict[str, np.ndarray] = {}
    if "coherence" in parts:
        known["coherence"] = read(parts["coherence"], "1")[order]
    elif "std" in parts or "variance" in parts:
        name = "std" if "std" in parts else "variance"
        size = values.arrays[parts[name].position][order]
        known["std"] = size if name == "std" else np.sqrt(size)
    whole = response[order]
    phase = np.angle(whole) if np.iscomplexobj(whole) else None
    return FrequencyResponse.from_points(
        frequency[order], np.abs(whole), phase, input, output, averages=averages, name=file.path.stem, **known
    )
