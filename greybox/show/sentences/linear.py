"""Linear models and families of them in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from greybox.base import Finding, format_unit
from greybox.base.document import Block, Details, Facts, Paragraphs, TableBlock
from greybox.base.numerics import VANISHED_POLE
from greybox.estimation.linear.exported_model import ExportFinding
from greybox.show.sentences import register, renders, writes
from greybox.show.sentences.estimation import status_text
from greybox.show.sentences.wording import choose_prefix, percent_text, value_with_unit

if TYPE_CHECKING:
    from greybox.estimation.linear.model_family import ModelFamily
    from greybox.estimation.linear.transfer_channel import LinearBehaviour, TransferChannel


@writes(ExportFinding.NO_EQUILIBRIUM)
def _no_equilibrium(finding: Finding) -> str:
    imbalance = ", ".join(
        f"{r['balance']} by {value_with_unit(r['value'], r['unit'], 4)}" for r in finding.values["imbalance"]
    )
    return (
        f"{finding.values['point']} is not an equilibrium (out of balance: {imbalance}): the linear model holds for deviations from the"
        " motion through this point"
    )


@writes(ExportFinding.STEADY_MOTION)
def _steady_motion(finding: Finding) -> str:
    others = (
        "all other states are at rest"
        if finding.values["others_rest"]
        else "the other states are constant only for a moment"
    )
    speed = value_with_unit(finding.values["speed"], finding.values["unit"], 4)
    return f"the operating point is a steady motion, not an equilibrium: {finding.subject} moves at {speed}, {others}"


@writes(ExportFinding.OUTSIDE_RECORDS)
def _outside_records(finding: Finding) -> str:
    signals = ", ".join(
        f"{_amount_of(s['name'], s['value'], s['unit'])} (records: {s['low']:.4g} to {value_with_unit(s['high'], s['unit'], 4)})"
        for s in finding.values["signals"]
    )
    return (
        f"the operating point is far outside the estimation records: {signals}; the parameters may not be valid there"
    )


def _amount_of(name: str, value: float, unit: str) -> str:
    return f"{name} = {value_with_unit(value, unit, 6)}"


@writes(ExportFinding.FRICTION_LEFT_OUT)
def _friction_left_out(finding: Finding) -> str:
    values = finding.values
    level = value_with_unit(values["level"], values["unit"], 4)
    used = f", of which {value_with_unit(values['held'], values['unit'], 4)} are used" if values["held"] else ""
    return (
        f"{finding.subject} cannot be linearised at {values['state']} = 0, where it holds up to {level}{used}; the matrices describe the"
        f" sliding body without friction; treat friction as a disturbance of up to {level}, or compensate it"
    )


@writes(ExportFinding.KINK)
def _kink(finding: Finding) -> str:
    values = finding.values
    who = " and ".join(values["effects"]) or f"the equations of {values['model']}"
    return (
        f"{who} cannot be linearised at {_amount_of(values['variable'], values['value'], values['unit'])}: the derivative is"
        f" discontinuous there; the derivative {values['side']} this point is used"
    )


@writes(ExportFinding.INPUT_WITHOUT_EFFECT)
def _input_without_effect(finding: Finding) -> str:
    values = finding.values
    cause = f" ({', '.join(values['effects'])})" if values["effects"] else ""
    point = _amount_of(finding.subject, values["value"], values["unit"])
    return (
        f"input {finding.subject!r} has no effect at {point}{cause}, so its gain is zero; choose an operating point with another"
        f" {finding.subject}"
    )


@writes(ExportFinding.STATES_REMOVED)
def _states_removed(finding: Finding) -> str:
    values = finding.values
    reasons = (("unreached", "not controllable"), ("unobserved", "not observable"))
    removed = "; ".join(f"{', '.join(values[key])} ({reason})" for key, reason in reasons if values[key])
    return f"the minimal realisation has {values['states']} of {values['of']} states; removed: {removed}"


@writes(ExportFinding.MODE_UNDERSAMPLED)
def _mode_undersampled(finding: Finding) -> str:
    values = finding.values
    if values["samples"] <= 2:
        effect = "the mode lies above half the sampling rate"
    else:
        effect = f"one period has only {values['samples']:.2g} samples"
    return (
        f"the sampling time {values['dt']:g} s is too long for the mode at {values['frequency']:.4g} rad/s: {effect}; use"
        f" {values['proposed']:.2g} s or less"
    )


def _chosen(finding: Finding, where: str) -> str:
    inputs = ", ".join(f"{name} = {value:.4g}" for name, value in finding.values["inputs"].items())
    return f"no operating point was chosen: it is linearised about {where}, {inputs}; at= (shell: --at NAME=VALUE) gives another"


register(
    {
        ExportFinding.FIT_FAILED: lambda finding: (
            f"the fit failed ({status_text(finding.values['status'])}): do not use its parameters"
        ),
        ExportFinding.PLAY_CLOSED: "{subject} cannot be linearised: {state} either stays or moves with the plant; the play is assumed to"
        " be closed, as in a large motion in one direction",
        ExportFinding.INPUT_BETWEEN_ROWS: "{subject} says what the input did between the rows of the record; a step from sample to sample"
        " holds its input, so its outputs differ from those of the fit. Step it at a shorter interval, with the input that acts there",
        ExportFinding.ABOUT_THE_MEANS: lambda finding: _chosen(finding, "the means of the inputs in the records"),
        ExportFinding.ABOUT_THE_BEGINNING: lambda finding: _chosen(finding, "the inputs at which a record begins"),
        ExportFinding.ABOUT_A_RUN: "the plant is run from outside: the linear model is its answer to small changes of the inputs along"
        " {subject}, of which it follows {share:.0%} at least",
        ExportFinding.DELAY_APPROXIMATED: "the delay of {delay:.4g} s of {subject} is a Pade approximation of order {order}, accurate up"
        " to about {limit:.3g} rad/s; use a sampled model (dt) for the exact delay",
        ExportFinding.DECAY_UNDERSAMPLED: "the sampling time {dt:g} s is too long: every mode decays within one sample (the slowest in"
        " {time_constant:.2g} s); use {proposed:.2g} s or less",
        ExportFinding.TUSTIN_RINGS: "Tustin's method at {dt:g} s maps the pole at {pole:.4g} 1/s to one that alternates from sample to"
        " sample; use zoh, or {proposed:.2g} s or less",
        ExportFinding.PARAMETERS_NOT_DRAWN: "{parameters:list}: no covariance (at a bound, or not determined by the records); kept at the"
        " fitted value",
    }
)


@renders("LinearBehaviour")
def behaviour_blocks(behaviour: LinearBehaviour) -> list[Block]:
    """Poles, then zeros, gain and bandwidth of each channel."""
    return [poles_table(behaviour.poles, behaviour.dt), *(Paragraphs(channel_lines(c)) for c in behaviour.channels)]


@renders("ModelFamily")
def model_family_blocks(family: ModelFamily) -> list[Block]:
    """How far poles, gains and frequency responses spread."""
    from greybox.estimation.linear.transfer_channel import extract_channel

    poles, (real, imag) = family.nominal.poles, family.pole_bounds()
    rows = [
        [
            f"{poles[k].real:.6g}{poles[k].imag:+.6g}j" if poles[k].imag else f"{poles[k].real:.6g}",
            f"[{real[k][0]:.6g}, {real[k][1]:.6g}]",
            f"[{imag[k][0]:.6g}, {imag[k][1]:.6g}]" if poles[k].imag else "",
        ]
        for k in np.flatnonzero(poles.imag >= 0)
    ]
    errors = []
    for row, output in enumerate(family.nominal.output_names):
        for column, name in enumerate(family.nominal.input_names):
            gains = [extract_channel(member, output, name).gain for member in family.members]
            low, high = np.quantile(gains, [0.025, 0.975])
            rows.append([f"gain {name} -> {output}", f"[{low:.6g}, {high:.6g}]", ""])
            bandwidth = extract_channel(family.nominal, output, name).bandwidth
            if np.isfinite(bandwidth):
                largest = family.relative_error(bandwidth * np.geomspace(1e-3, 1, 200))[:, row, column].max()
                errors.append(
                    f"response {name} -> {output} up to {bandwidth:.6g} rad/s: within {percent_text(largest, 3)} of the nominal one"
                )
    drawn = ", ".join(family.distribution.names)
    head = f"{len(family.members)} models drawn from the covariance of {drawn} (seed {family.seed})"
    table = TableBlock("Spread of the models", ["pole", "real part, 95 %", "imaginary part, 95 %"], rows)
    return [Details(head, [table, Paragraphs(errors)]), Facts([("note", finding) for finding in family.findings])]


def poles_table(poles: np.ndarray, dt: float) -> TableBlock:
    """Poles with natural frequency, damping ratio, time constant; of a conjugate pair one."""
    rows = []
    for pole in poles[poles.imag >= 0]:
        if dt and abs(pole) < VANISHED_POLE:
            rows.append([complex_text(pole), "decays within one sample", "", ""])
            continue
        s = np.log(pole) / dt if dt else pole
        speed = abs(s)
        rows.append(
            [
                complex_text(pole) + " and conjugate" * bool(pole.imag),
                f"{speed:.6g} rad/s" if speed else "integrates",
                f"{-s.real / speed:.4g}" if speed else "",
                f"{-1 / s.real:.4g} s" if s.real < 0 else "unstable" * bool(s.real > 0),
            ]
        )
    name = "poles (z)" if dt else "poles"
    return TableBlock(name.capitalize(), [name, "natural frequency", "damping", "time constant"], rows)


def channel_lines(channel: TransferChannel) -> list[str]:
    """Lines about one channel."""
    per_second = f"/s**{channel.integrators}" if channel.integrators else ""
    # A gain without a unit is a number alone, not "1.26 1".
    unit, own_unit = (
        f" {text}" if text != "1" else "" for text in map(format_unit, (f"({channel.unit}){per_second}", channel.unit))
    )
    kind = "integrator gain" if channel.integrators else "gain"
    # In the unit of the output that suits the gain: 29.5 µm/V.
    factor, prefix = choose_prefix(channel.unit.partition("/")[0].strip("()"), abs(channel.gain))
    unit, own_unit = (f" {prefix}{text.strip()}" if prefix else text for text in (unit, own_unit))
    lines = [f"  {channel.input} -> {channel.output}: {kind} {factor * channel.gain:.6g}{unit}"]
    lines.append("    zeros " + (", ".join(map(complex_text, channel.zeros)) or "none"))
    bandwidth, (frequency, gain) = channel.bandwidth, channel.peak
    if np.isfinite(bandwidth):
        lines.append(f"    bandwidth (-3 dB) {bandwidth:.6g} rad/s, {bandwidth / (2 * np.pi):.6g} Hz")
    elif np.isinf(bandwidth):
        lines.append("    bandwidth: the gain never falls 3 dB below its static value")
    if np.isfinite(gain) and gain > 1.01 * abs(channel.gain):
        lines.append(f"    largest gain {factor * gain:.6g}{own_unit} at {frequency:.6g} rad/s")
    return lines


def complex_text(value: complex) -> str:
    """``-25.6``, ``-25.5869+767.985j`` with six digits."""
    if abs(value.imag) <= 1e-12 * abs(value):
        return f"{value.real:.6g}"
    return f"{value.real:.6g}{value.imag:+.6g}j"
