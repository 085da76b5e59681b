"""A linear model in plain text: matrices to the last digit, poles, and for each channel zeros, gain and bandwidth."""

from __future__ import annotations

import numpy as np

from greybox.export.linearisation import Linearisation
from greybox.export.plant import format_signals
from greybox.export.transfer_channel import TransferChannel
from greybox.result.summary import format_table
from greybox.units import format_unit

GONE = 1e-12  # a pole of a sampled model at zero, as a delay has it


def summarise_linearisation(model: Linearisation) -> str:
    """Operating point, matrices, poles with natural frequency and damping, channels, notes."""
    return "\n".join([*_head(model), "", *_matrices(model), "", *format_behaviour(model), *format_notes(model)])


def format_behaviour(model: Linearisation) -> list[str]:
    """Lines about poles and channels."""
    lines = format_poles(model.poles, model.dt)
    for output in model.output_names:
        for name in model.input_names:
            lines += ["", *format_channel(model.channel(output, name))]
    return lines


def format_notes(model: Linearisation) -> list[str]:
    """The notes, a line each, after an empty one."""
    return ["", *(f"note: {note}" for note in model.notes)] if model.notes else []


def _head(model: Linearisation) -> list[str]:
    timing = f"sampled every {model.dt:g} s ({model.method})" if model.dt else "continuous"
    lines = [f"{model.name}: linear model, {timing}", ""]
    lines += [f"  at   {format_signals(model.state_names, model.x0, model.state_units)}"]
    lines += [f"       {format_signals(model.input_names, model.u0, model.input_units)}"] * bool(model.input_names)
    lines += [f"       outputs {format_signals(model.output_names, model.y0, model.output_units)}"]
    lines += [
        f"  delay of {name} {seconds:.6g} s, not in the matrices"
        for name, seconds in zip(model.input_names, model.delay, strict=True)
        if seconds
    ]
    return lines


def format_poles(poles: np.ndarray, dt: float) -> list[str]:
    """Lines with pole, natural frequency, damping ratio, time constant."""
    rows = []
    for pole in poles[poles.imag >= 0]:
        if dt and abs(pole) < GONE:
            rows.append([format_complex(pole), "gone after one sample", "", ""])
            continue
        s = np.log(pole) / dt if dt else pole
        speed = abs(s)
        rows.append(
            [
                format_complex(pole) + " and conjugate" * bool(pole.imag),
                f"{speed:.6g} rad/s" if speed else "integrates",
                f"{-s.real / speed:.4g}" if speed else "",
                f"{-1 / s.real:.4g} s" if s.real < 0 else "unstable" * bool(s.real > 0),
            ]
        )
    return format_table(["poles" if not dt else "poles (z)", "natural frequency", "damping", "decays in"], rows)


def format_channel(channel: TransferChannel) -> list[str]:
    """Lines about one channel."""
    per = "/s" + (f"^{channel.integrators}" if channel.integrators > 1 else "") if channel.integrators else ""
    unit = format_unit(f"({channel.unit}){'/s**' + str(channel.integrators) if per else ''}")
    kind = f"integrator gain {channel.gain:.10g} {unit}" if per else f"gain {channel.gain:.10g} {unit}"
    lines = [f"  {channel.input} -> {channel.output}: {kind}"]
    lines.append("    zeros " + (", ".join(map(format_complex, channel.zeros)) or "none"))
    width, (at, size) = channel.bandwidth, channel.peak
    if np.isfinite(width):
        lines.append(f"    bandwidth (-3 dB) {width:.6g} rad/s, {width / (2 * np.pi):.6g} Hz")
    elif np.isinf(width):
        lines.append("    bandwidth: the gain never stays 3 dB below that at rest")
    if np.isfinite(size) and size > 1.01 * abs(channel.gain):
        lines.append(f"    largest gain {size:.6g} {format_unit(channel.unit)} at {at:.6g} rad/s")
    return lines


def format_complex(value: complex) -> str:
    """``-25.6``, ``-25.6+767.98j`` with ten digits."""
    if abs(value.imag) <= 1e-12 * abs(value):
        return f"{value.real:.10g}"
    return f"{value.real:.10g}{value.imag:+.10g}j"


def _matrices(model: Linearisation) -> list[str]:
    lines = []
    for name, matrix in (("A", model.A), ("B", model.B), ("C", model.C), ("D", model.D)):
        rows = [[repr(float(v)) for v in row] for row in matrix]
        widths = [max((len(row[k]) for row in rows), default=0) for k in range(matrix.shape[1])]
        for k, row in enumerate(rows):
            head = f"  {name} = " if k == 0 else "      "
            lines.append(head + "  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True)))
    return lines
