"""Noise from one record alone: never too little where it is called a ceiling, and right where it is called known."""

import numpy as np
import pytest
from scipy.signal import butter, lfilter, sosfiltfilt

from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.data.experiment import Experiment
from greybox.data.noise.noise_model import BoundDirection, NoiseSource
from greybox.data.noise.noise_sources import estimate_noise
from greybox.data.noise.repeats import estimate_resolution, estimate_written_step
from greybox.data.noise.spectrum import LeftoverSpectrum, _join_bands, leftover_spectrum, spectral_level

ROWS = 2500


def test_bands_that_are_joined_count_by_their_degrees_of_freedom():
    two = LeftoverSpectrum(*(np.array(pair) for pair in ([1.0, 2.0], [4.0, 8.0], [1.0, 3.0], [0.0, 4.0])))
    one = _join_bands(two, 1)
    assert (one.frequency, one.power, one.freedom, one.measured) == (1.75, 7.0, 4.0, 3.0)


def multisine(rng, top):
    """Random phases, equal amplitudes up to the share ``top`` of half the sampling rate; not periodic in the record."""
    spectrum = np.zeros(ROWS + 1, complex)
    lines = np.arange(1, int(top * ROWS))
    spectrum[lines] = np.exp(2j * np.pi * rng.random(len(lines)))
    u = np.fft.irfft(spectrum, 2 * ROWS)[:ROWS]
    return u / u.std()


def chirp(rng, top):
    n = np.arange(ROWS)
    return np.sin(np.pi * top * n**2 / (2 * ROWS))


def steps(rng, top):
    return np.repeat(rng.normal(size=ROWS), max(2, int(1 / top)))[:ROWS]


SIGNALS = {
    "slow multisine": (multisine, 0.05),
    "fast multisine": (multisine, 0.5),
    "chirp": (chirp, 0.4),
    "steps": (steps, 0.02),
}


def resonance(u, frequency=0.5, damping=0.05):
    """A second-order plant, sampled."""
    a = [1.0, -2 * np.exp(-damping * frequency) * np.cos(frequency), np.exp(-2 * damping * frequency)]
    return lfilter([0.0, sum(a)], a, u)


def hardening(u):
    """A mass on a hardening spring with dry friction, integrated by small steps."""
    x = v = 0.0
    rows = []
    for force in u:
        for _ in range(10):
            v += 0.1 * (0.25 * (force - x - 0.3 * x**3) - 0.05 * v - 0.05 * np.tanh(2000 * v))
            x += 0.1 * v
        rows.append(x)
    return np.array(rows)


def coloured(rng, rho, rows=ROWS):
    return lfilter([1.0], [1.0, -rho], rng.normal(size=rows + 500) * np.sqrt(1 - rho**2))[500:]


@pytest.mark.crossed(3)
@pytest.mark.parametrize("rho", [0.0, 0.7, 0.95])
@pytest.mark.parametrize("share", [1e-2, 1e-4])
@pytest.mark.parametrize("kind", SIGNALS)
@pytest.mark.parametrize("plant", [resonance, hardening])
def test_a_ceiling_is_never_below_the_noise_and_a_known_level_is_right(plant, kind, share, rho):
    rng = np.random.default_rng(1)
    make, top = SIGNALS[kind]
    u = make(rng, top)
    y = plant(u)
    std = share * y.std()
    level = spectral_level([leftover_spectrum(u[:, None], y + std * coloured(rng, rho))])
    if level.is_noise:
        assert level.std == pytest.approx(std, rel=0.25)
    else:
        assert level.most > 0.85 * std
    if plant is resonance:  # all of it is linear, however fast: little but noise is left
        assert level.most < 1.7 * std


def model(names=("y",)):
    def balances(x, u, p):
        return [Balance(f"{n}_rate", "V/s", 1, n, decay=-p.k * x[n]) for n in names]

    outputs = [Output(n, "V") for n in names]
    return Model(
        "m", [State(n, "V") for n in names], [Input("u", "V")], outputs, [Parameter("k", "1/s", 1.0)], balances
    )


def bound_of(u, y):
    record = Experiment("r", 0.01 * np.arange(len(y)), {"u": u}, {"y": y})
    return estimate_noise(model(), [record], {}).bound("y")


@pytest.mark.parametrize("rho", [0.0, 0.7])
def test_flat_pieces_show_level_and_colour(rho):
    rng = np.random.default_rng(2)
    u = np.repeat(rng.normal(size=10), 250)
    y = resonance(u, damping=0.2)
    bound = bound_of(u, y + 1e-3 * coloured(rng, rho))
    assert bound.source is NoiseSource.FLAT_PIECES and bound.direction is BoundDirection.ABOUT
    assert bound.level == pytest.approx(1e-3, rel=0.1)
    assert bound.correlation_time == pytest.approx(0.01 * rho / (1 - rho), abs=0.01)


@pytest.mark.parametrize("rho", [0.0, 0.7])
def test_a_piece_in_which_the_plant_still_swings_is_no_noise(rho):
    """One of ten pieces, without a trend, made the noise half as loud again and gave it a colour."""
    rng = np.random.default_rng(2)
    u = np.repeat(rng.normal(size=10), 250)
    noise = 1e-3 * coloured(rng, rho, len(u))
    swing = np.zeros(len(u))
    swing[-125:] = 4e-3 * np.sin(2 * np.pi * np.arange(125) / 50)
    bound = bound_of(u, u + noise + swing)
    assert bound.source is NoiseSource.FLAT_PIECES and bound.direction is BoundDirection.ABOUT
    assert bound.level == pytest.approx(1e-3, rel=0.1)
    assert bound.correlation_time == pytest.approx(0.01 * rho / (1 - rho), abs=0.01)


def test_pieces_of_different_loudness_give_a_ceiling():
    rng = np.random.default_rng(3)
    u = np.repeat([0.0, 1.0, 0.0, 2.0, 1.0, 2.0], 250)
    bound = bound_of(u, u + (1e-4 + 1e-2 * u) * rng.normal(size=len(u)))
    assert bound.direction is BoundDirection.AT_MOST and bound.floor is None
    overall = np.sqrt(np.mean((1e-4 + 1e-2 * u) ** 2))
    assert 0.95 * overall < bound.level < 1.15 * 2e-2


def test_a_fit_weighs_with_differences_below_the_ceiling():
    rng = np.random.default_rng(8)
    u = steps(rng, 0.02)
    y = hardening(u)
    slow, fast = 1e-3 * y.std(), 1e-4 * resonance(multisine(rng, 0.5)).std()
    record = Experiment("r", 0.01 * np.arange(ROWS), {"u": u}, {"y": y + slow * rng.normal(size=ROWS)})
    noise = estimate_noise(model(), [record], {})
    assert noise.std[0] <= noise.bound("y").level and noise.ceiling_ratio("y") >= 1.0
    u = multisine(rng, 0.5)
    y = resonance(u)
    quick = Experiment("r", 0.01 * np.arange(ROWS), {"u": u}, {"y": y + fast * rng.normal(size=ROWS)})
    assert estimate_noise(model(), [quick], {}).std[0] == pytest.approx(fast, rel=0.3)


# Filters between a sensor and its record, corner over half the sampling rate.
FILTERS = {
    "first order": butter(1, 0.2),
    "second order": butter(2, 0.1),
    "fourth order": butter(4, 0.1),
    "fourth order, high": butter(4, 0.4),
}


def filtered_noise(name, rng, rows=ROWS):
    """White noise behind a filter, with a standard deviation of one."""
    noise = lfilter(*FILTERS[name], rng.normal(size=rows + 500))[500:]
    return noise / noise.std()


@pytest.mark.crossed(3)
@pytest.mark.parametrize("digits", [None, 4])
@pytest.mark.parametrize("filter_name", FILTERS)
@pytest.mark.parametrize("kind", ["slow multisine", "steps"])
@pytest.mark.parametrize("plant", [resonance, hardening])
def test_what_a_filter_took_away_says_nothing_of_what_it_let_through(plant, kind, filter_name, digits):
    rng = np.random.default_rng(9)
    make, top = SIGNALS[kind]
    u = make(rng, top)
    y = plant(u)
    y = y / y.std() + 0.01 * filtered_noise(filter_name, rng)
    record = Experiment("r", 0.01 * np.arange(ROWS), {"u": u}, {"y": y if digits is None else np.round(y, digits)})
    assert estimate_noise(model(), [record], {}).bound("y").ceiling > 0.008


@pytest.mark.parametrize(("kind", "written"), [("steps", None), ("steps", "%.8g"), ("slow multisine", "%.8g")])
@pytest.mark.parametrize("corner", [0.01, 0.02, 0.05])
def test_a_filter_far_below_half_the_sampling_rate_hides_no_noise_of_its_pass_band(corner, kind, written):
    rng = np.random.default_rng(17)
    sections = butter(4, corner, output="sos")
    make, _ = SIGNALS[kind]
    u = make(rng, 0.002 if kind == "steps" else 0.01)
    noise = sosfiltfilt(sections, rng.normal(size=ROWS + 2000))[1000:-1000]
    y = sosfiltfilt(sections, resonance(u, 0.05, 0.3))
    y = y / y.std() + 0.01 * noise / noise.std()
    bound = bound_of(u, y if written is None else np.array([float(written % value) for value in y]))
    assert bound.direction is BoundDirection.AT_MOST and bound.level > 0.008


def test_a_pass_band_that_is_resolved_bounds_the_noise_closely():
    rng = np.random.default_rng(18)
    sections = butter(4, 0.02, output="sos")
    u = rng.normal(size=40000)
    noise = sosfiltfilt(sections, rng.normal(size=len(u) + 2000))[1000:-1000]
    y = sosfiltfilt(sections, resonance(u, 0.05, 0.3))
    bound = bound_of(u, y / y.std() + 0.01 * noise / noise.std())
    assert 0.008 < bound.level < 0.02


def test_a_filtered_output_does_not_outweigh_an_unfiltered_one():
    rng = np.random.default_rng(10)
    u = multisine(rng, 0.05)
    y = resonance(u) / resonance(u).std()
    outputs = {"y": y + 0.01 * filtered_noise("fourth order", rng), "z": y + 0.01 * rng.normal(size=ROWS)}
    record = Experiment("r", 0.01 * np.arange(ROWS), {"u": u}, outputs)
    noise = estimate_noise(model(("y", "z")), [record], {})
    assert 0.3 < noise.std[0] / noise.std[1] < 3


def test_differences_of_a_short_record_bound_noise_that_was_filtered_too():
    rng = np.random.default_rng(11)
    slow = np.sin(0.03 * np.arange(100))
    bounds = {}
    for name, noise in ("filtered", filtered_noise("fourth order", rng, 100)), ("white", rng.normal(size=100)):
        bounds[name] = bound_of(np.zeros(100), slow + 0.01 * noise)
    assert {bound.source for bound in bounds.values()} == {NoiseSource.DIFFERENCES}
    assert bounds["white"].level == pytest.approx(0.01, rel=0.2)
    assert bounds["filtered"].level > 0.008


def test_written_digits_are_a_grid():
    rng = np.random.default_rng(12)
    assert estimate_written_step([np.round(rng.normal(size=500), 4)]) == pytest.approx(1e-4)
    assert estimate_written_step([rng.normal(size=500)]) == 0.0
    # Six significant digits: of 0.1 to 1 the sixth is 1e-6.
    written = [np.array([float(f"{value:.6g}") for value in rng.uniform(low, 10 * low, 500)]) for low in (0.1, 0.01)]
    assert estimate_written_step(written[:1]) == pytest.approx(1e-6)
    assert estimate_written_step(written) == pytest.approx(np.sqrt((1e-12 + 1e-14) / 2))
    assert estimate_written_step([np.array([0.0, 1.0])]) == 0.0


def test_drift_is_no_noise():
    rng = np.random.default_rng(4)
    u = np.repeat([0.0, 1.0, 0.0, 2.0], 500)
    wandering = np.cumsum(0.01 * rng.normal(size=len(u)))
    bound = bound_of(u, u + wandering + 1e-4 * rng.normal(size=len(u)))
    assert bound.direction is BoundDirection.AT_MOST


def test_a_sensor_in_codes_has_at_least_their_rounding():
    rng = np.random.default_rng(5)
    u = multisine(rng, 0.05)
    y = np.round(resonance(u) / 0.05) * 0.05
    assert estimate_resolution([y]) == pytest.approx(0.05)
    bound = bound_of(u, y)
    assert 0.9 * 0.05 / np.sqrt(12) < bound.level < 2 * 0.05 / np.sqrt(12)
    assert estimate_resolution([rng.normal(size=500)]) == 0.0


@pytest.mark.parametrize("rests", [1, 2, 3])
@pytest.mark.parametrize("speed", [40, 110, 300])
def test_codes_that_a_motion_runs_past_are_no_step_of_the_sensor(rests, speed):
    # An encoder that stands for as long as it moves, and then passes tens of counts from row to row.
    count, rng = 0.0031416, np.random.default_rng(speed)
    motion = np.cumsum(speed * (1 + 0.05 * rng.normal(size=400)))
    codes = np.concatenate(
        [part for m in np.split(motion, [100, 250][: rests - 1]) for part in (np.full(200, m[0]), m)]
    )
    assert estimate_resolution([count * np.round(codes)]) == 0.0


@pytest.mark.parametrize("decimals", [5, 6, 7])
def test_counts_of_an_encoder_printed_with_few_digits_are_its_step(decimals):
    # 2 pi / 2048 rad: distances of many counts are no whole numbers of the smallest one once they are rounded for printing.
    count, rng = 2 * np.pi / 2048, np.random.default_rng(decimals)
    motion = np.concatenate([np.zeros(300), np.cumsum(60 * rng.normal(size=900))])
    printed = np.round(count * np.round(motion), decimals)
    assert estimate_written_step([printed]) == pytest.approx(count, rel=1e-4)


def test_a_record_without_noise_has_a_ceiling_only():
    u = multisine(np.random.default_rng(6), 0.05)
    bound = bound_of(u, resonance(u))
    assert bound.direction is BoundDirection.AT_MOST and bound.floor is None


def test_a_hysteresis_without_noise_is_not_called_noise():
    # Bouc-Wen: m 2, c 10, k 5e4, alpha 5e4, beta 800, gamma -1100, at 750 Hz with 5 to 150 Hz, 50 N rms
    rng = np.random.default_rng(7)
    rows, rate, fine = 4096, 750.0, 20
    spectrum = np.zeros(rows + 1, complex)
    frequency = np.arange(rows + 1) * rate / (2 * rows)
    band = (frequency >= 5) & (frequency <= 150)
    spectrum[band] = np.exp(2j * np.pi * rng.random(band.sum()))
    dense = np.fft.irfft(np.concatenate([spectrum, np.zeros(rows * (fine - 1))]), 2 * rows * fine)[: rows * fine]
    force = 50 * dense / dense.std()
    x = v = z = 0.0
    y, h = [], 1 / (rate * fine)
    for k, f in enumerate(force):
        if k % fine == 0:
            y.append(x)
        v += h * (f - 10 * v - 5e4 * x - 5e4 * z) / 2
        x += h * v
        z += h * (v - 800 * abs(v) * z + 1100 * v * abs(z))
    y = np.array(y)
    level = spectral_level([leftover_spectrum(force[::fine][:, None], y)])
    linear_misfit = np.sqrt(leftover_spectrum(force[::fine][:, None], y).power.mean())
    assert not level.is_noise
    # A record without noise is one of which a filter took all.
    assert level.is_filtered and level.most < linear_misfit


@pytest.mark.crossed(3)
@pytest.mark.parametrize(
    ("file", "inputs", "output", "low", "high"),
    [
        # Both were filtered: the best models leave 2.3e-4 V of the one; the encoder of the other has steps of some 1e-7 m.
        ("silverbox/train_multisine.csv", [1], 2, 2.3e-4, 1e-3),
        ("emps/train.csv", [1], 2, 1e-7, 1e-5),
        ("cascaded_tanks/train.csv", [1], 2, 1e-3, 0.2),
        ("hydraulic_motor/train.csv", [1], 2, 1e-3, 0.03),
        ("hanging_load/train.csv", [3], 2, 5e-4, 0.01),
        ("two_cylinders/train.csv", [1, 2], 3, 5e-4, 0.03),
        ("two_cylinders/train.csv", [1, 2], 4, 5e-4, 0.03),
        ("dc_motor_tacho/escada500.csv", [1], 2, 9e-3, 0.035),
    ],
)
def test_measured_records_bound_their_noise_far_below_what_a_plain_model_leaves(
    shared_data, file, inputs, output, low, high
):
    table = np.genfromtxt(shared_data / file, delimiter=",", skip_header=1)
    names = [f"u{k}" for k in inputs]
    record = Experiment(
        "r", table[:, 0], {n: table[:, k] for n, k in zip(names, inputs, strict=True)}, {"y": table[:, output]}
    )
    one = model()
    several = Model("m", one.states, [Input(n, "V") for n in names], one.outputs, one.parameters, one.balances)
    bound = estimate_noise(several, [record], {}).bound("y")
    assert low < bound.ceiling < high
