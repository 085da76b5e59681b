"""Two ways to name a hidden effect without refitting anything: correlate the residual, or regress the unexplained acceleration.

Both see what `discover` sees. The first takes the candidate whose linear response (one small amplitude, at the middle of its shape
grid) correlates best with the residual of the plain fit. The second differentiates the measured main output twice, takes away what
the plain model's force balance explains, and regresses the rest sparsely (pysindy, sequentially thresholded least squares) on a
library of functions, each of which is read as an effect.
"""

from __future__ import annotations

import numpy as np

import greybox as gb
from fits.studies.hidden_cases import Case
from greybox.model.effects.catalogue import applicable_effects
from greybox.model.effects.scales import measure_scales

# Functions of displacement, velocity, input and time, and the effects that they are read as.
LIBRARY = {
    "sign(v)": "coulomb_friction",
    "v|v|": "quadratic_damping",
    "x^3": "cubic_stiffness",
    "x^2": "quadratic_stiffness",
    "1": "constant_load",
    "u^3": "input_saturation",
    "sign(u)": "input_dead_zone",
}
PNEUMATIC = {"sign(u)": "valve_dead_zone"}
SMOOTH = 9  # samples of the local polynomials that differentiate
THRESHOLD = 0.1  # of the largest standardised coefficient


def by_correlation(base: gb.Fit, plain: gb.Model, case: Case) -> str:
    """Name of the candidate whose response correlates best with the residual of the plain fit."""
    trace = base.traces[0]
    outputs = list(trace.measured)
    residual = np.concatenate([trace.residual(o) / case.sigma[o] for o in outputs])
    run = gb.simulate(base.model, trace.experiment)
    inputs = np.column_stack(list(run.inputs.values()))
    scales = measure_scales(
        base.model, np.column_stack(list(run.states.values())), inputs, float(np.median(np.diff(run.time)))
    )
    best, name = 0.0, ""
    for effect in applicable_effects(base.model, scales):
        model = base.model + effect
        model_names = next(b.model_names for b in model.bound_effects)
        grid = effect.grid(scales) if effect.grid else {}
        start = {q: sorted(values)[len(values) // 2] for q, values in grid.items()}
        start |= dict(effect.probe(scales)) if effect.probe else {}
        low_high = {q: model.parameter(model_names[q]).bounds for q in start}
        values = {model_names[q]: float(np.clip(v, *low_high[q])) for q, v in start.items()}
        moved = gb.simulate(model.start(**values), trace.experiment)
        response = np.concatenate([(moved.outputs[o] - run.outputs[o]) / case.sigma[o] for o in outputs])
        size = float(np.linalg.norm(response))
        if np.isfinite(size) and size > 0 and (likeness := abs(float(response @ residual)) / size) > best:
            best, name = likeness, effect.name
    return name


def by_sparse_regression(plain: gb.Model, case: Case) -> str:
    """Name of the library's strongest function in the acceleration that a linear model does not explain."""
    import pysindy
    from scipy.signal import savgol_filter

    record = case.estimation
    period = float(np.median(record.intervals))
    y, u = record.outputs[plain.outputs[0].name], record.inputs["u"]
    x, v, a = (savgol_filter(y, SMOOTH, 4, deriv=k, delta=period) for k in range(3))
    # The linear part of the balance, with the drive and its slow follower: what the plain model could explain.
    drive = savgol_filter(np.cumsum(u) * period, SMOOTH, 2)
    linear = np.column_stack([x, v, u, drive, *(record.outputs[n] for n in list(record.outputs)[1:])])
    functions = {
        "sign(v)": np.sign(v),
        "v|v|": v * np.abs(v),
        "x^3": x**3,
        "x^2": x**2,
        "1": np.ones_like(x),
        "u^3": u**3,
        "sign(u)": np.sign(u),
    }
    added = np.column_stack(list(functions.values()))
    left = np.linalg.lstsq(linear, np.column_stack([a, added]), rcond=None)[0]
    rest = np.column_stack([a, added]) - linear @ left
    scale = np.linalg.norm(rest, axis=0)
    scale[scale == 0] = 1.0
    target, columns = rest[:, :1] / scale[0], rest[:, 1:] / scale[1:]
    optimiser = pysindy.STLSQ(threshold=0.0, alpha=1e-6)
    optimiser.fit(columns, target)
    largest = float(np.abs(optimiser.coef_).max())
    sparse = pysindy.STLSQ(threshold=THRESHOLD * largest, alpha=1e-6)
    sparse.fit(columns, target)
    strongest = list(functions)[int(np.argmax(np.abs(sparse.coef_[0])))]
    names = LIBRARY | (PNEUMATIC if case.model == "pneumatic_cylinder" else {})
    return names[strongest]
