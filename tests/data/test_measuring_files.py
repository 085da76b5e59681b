"""Files of measuring systems, written by the libraries of their formats: two rates, two clocks, one record."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

import greybox as gb
from greybox.base.errors import DataError
from greybox.data.columns import SignalKind
from greybox.data.findings import RecordCode
from greybox.data.policy import ReadingPolicy
from greybox.data.survey import survey_file
from greybox.data.time_base import (
    ChannelUse,
    Samples,
    _error_of_mean,
    bring_to_one_base,
    estimate_clock_offset,
    interpolate_band_limited,
)
from greybox.model.balance import Balance
from greybox.model.model import Model
from greybox.model.signals import Input, Output, Parameter, State

FAST, SLOW, OFFSET = 0.001, 0.01, 0.2373
LAG = 0.05


def drive(t: np.ndarray) -> np.ndarray:
    return np.sin(5 * t) + 0.5 * np.sin(13.3 * t + 1) + 0.3 * np.sin(31 * t)


def answer(t: np.ndarray) -> np.ndarray:
    """Steady answer of ``LAG x' = u - x`` to `drive`, in millimetres."""
    tones = ((5.0, 0.0, 1.0), (13.3, 1.0, 0.5), (31.0, 0.0, 0.3))
    return sum(a * np.sin(w * t + p - np.arctan(w * LAG)) / np.hypot(1, w * LAG) for w, p, a in tones)


TIME_A = FAST * np.arange(4000)
TIME_B = SLOW * np.arange(350)
"""Stamps of the second device: its clock shows 0 when the first shows `OFFSET`."""
U, SYNC_A = drive(TIME_A), np.sin(3 * TIME_A + 0.2) + 0.2 * np.sin(17 * TIME_A)
X = answer(TIME_B + OFFSET)
SYNC_B = np.sin(3 * (TIME_B + OFFSET) + 0.2) + 0.2 * np.sin(17 * (TIME_B + OFFSET))


LAG_MODEL = Model(
    "lag",
    states=[State("x", "mm")],
    inputs=[Input("u", "V")],
    outputs=[Output("y", "mm", lambda x, u, p: x.x)],
    parameters=[Parameter("T", "s", 0.2, bounds=(1e-3, 1.0)), Parameter("g", "mm/V", 1.0, fixed=True)],
    balances=lambda x, u, p: [Balance("lag", "mm", p.T, "x", drive=p.g * u.u, back=-x.x)],
)


# --- files, each written by the library of its format: name -> writer


def write_mdf(path: Path) -> None:
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(version="4.10") as file:
        fast = [asammdf.Signal(v, TIME_A, unit=unit, name=n) for n, v, unit in (("u", U, "V"), ("sync", SYNC_A, "V"))]
        slow = [asammdf.Signal(v, TIME_B, unit=unit, name=n) for n, v, unit in (("y", X, "mm"), ("sync", SYNC_B, "V"))]
        file.append(fast, acq_name="DAQ")
        file.append(slow, acq_name="Laser")
        file.save(path, overwrite=True)


def write_tdms(path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")

    def channel(group: str, name: str, values: np.ndarray, unit: str, step: float) -> object:
        return nptdms.ChannelObject(group, name, values, properties={"wf_increment": step, "unit_string": unit})

    with nptdms.TdmsWriter(path) as file:
        file.write_segment(
            [
                channel("DAQ", "u", U, "V", FAST),
                channel("DAQ", "sync", SYNC_A, "V", FAST),
                channel("Laser", "y", X, "mm", SLOW),
                channel("Laser", "sync", SYNC_B, "V", SLOW),
            ]
        )


def write_hdf5(path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        daq, laser = file.create_group("DAQ"), file.create_group("Laser")
        daq["time"], daq["u"], daq["sync"] = 1e3 * TIME_A, U, SYNC_A
        daq["time"].attrs["units"] = "ms"
        laser["y"], laser["sync"] = X, SYNC_B
        laser.attrs["sampling_rate"] = 1 / SLOW
        for name, unit in (("DAQ/u", "V"), ("Laser/y", "mm")):
            file[name].attrs["unit"] = unit


def write_excel(path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    daq, laser = book.active, book.create_sheet("Laser")
    daq.title = "DAQ"
    for page, head, units, columns in (
        (daq, ["time", "u", "sync"], ["s", "V", "V"], (TIME_A, U, SYNC_A)),
        (laser, ["time", "y", "sync"], ["s", "mm", "V"], (TIME_B, X, SYNC_B)),
    ):
        page.append(["made by a rig"])
        page.append(head)
        page.append(units)
        for row in zip(*columns, strict=True):
            page.append([float(v) for v in row])
    book.save(path)


EPOCH = 1_790_000_000_000_000_000


def ros_messages() -> list[tuple[str, int, int, float, float]]:
    """Topic, stamp (ns), when it was recorded (ns), signal and sync of every message, in the order of recording."""
    made = [("/daq", round(1e9 * t), round(1e9 * t) + 400_000, u, s) for t, u, s in zip(TIME_A, U, SYNC_A, strict=True)]
    made += [
        ("/laser", round(1e9 * t), round(1e9 * (t + OFFSET)) + 900_000, x, s)
        for t, x, s in zip(TIME_B, X, SYNC_B, strict=True)
    ]
    return sorted(made, key=lambda message: message[2])


def write_mcap(path: Path) -> None:
    writer = pytest.importorskip("mcap.writer")
    with open(path, "wb") as stream:
        file = writer.Writer(stream)
        file.start()
        schema = file.register_schema("sample", "jsonschema", b'{"type": "object"}')
        topics = {topic: file.register_channel(topic, "json", schema) for topic in ("/daq", "/laser")}
        for topic, stamp, recorded, value, sync in ros_messages():
            seconds, rest = divmod(EPOCH + stamp, 10**9)
            content = {"header": {"stamp": {"sec": seconds, "nanosec": rest}}, "value": value, "sync": sync}
            file.add_message(topics[topic], EPOCH + recorded, json.dumps(content).encode(), EPOCH + recorded)
        file.finish()


def write_ros(path: Path) -> None:
    """A ROS 1 bag, or a ROS 2 recording as MCAP or SQLite: points with a stamp, x the signal and y the sync."""
    pytest.importorskip("rosbags")
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    one = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if one else Stores.ROS2_HUMBLE)
    kind = "geometry_msgs/msg/PointStamped"
    plugin = StoragePlugin.MCAP if path.suffix == ".mcap" else StoragePlugin.SQLITE3
    make = {
        name: store.types[f"{name}"]
        for name in (kind, "std_msgs/msg/Header", "builtin_interfaces/msg/Time", "geometry_msgs/msg/Point")
    }
    with Writer1(path) if one else Writer2(path.with_suffix(""), version=9, storage_plugin=plugin) as file:
        topics = {topic: file.add_connection(topic, kind, typestore=store) for topic in ("/daq", "/laser")}
        for topic, stamp, recorded, value, sync in ros_messages():
            seconds, rest = divmod(EPOCH + stamp, 10**9)
            time = make["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest)
            more = {"seq": 0} if one else {}
            header = make["std_msgs/msg/Header"](stamp=time, frame_id="rig", **more)
            content = make[kind](header=header, point=make["geometry_msgs/msg/Point"](x=value, y=sync, z=0.0))
            pack = store.serialize_ros1 if one else store.serialize_cdr
            file.write(topics[topic], EPOCH + recorded, pack(content, kind))
    if not one:
        for part in path.with_suffix("").iterdir():
            part.rename(path.parent / (path.name if part.suffix == path.suffix else part.name))
        text = (path.parent / "metadata.yaml").read_text()
        (path.parent / "metadata.yaml").write_text(text.replace(f"{path.stem}{path.suffix}", path.name))


PLAIN = {"u": "u", "y": "y"}
JSON_TOPICS = {"u": "/daq.value", "y": "/laser.value"}
POINTS = {"u": "/daq.point.x", "y": "/laser.point.x"}
WRITERS: dict[str, tuple[str, Callable[[Path], None], dict[str, str]]] = {
    "mdf": ("run.mf4", write_mdf, PLAIN),
    "tdms": ("run.tdms", write_tdms, PLAIN),
    "hdf5": ("run.h5", write_hdf5, PLAIN),
    "excel": ("run.xlsx", write_excel, PLAIN),
    "mcap": ("run.mcap", write_mcap, JSON_TOPICS),
    "ros1": ("run.bag", write_ros, POINTS),
    "ros2-mcap": ("run.mcap", write_ros, POINTS),
    "ros2-sqlite": ("run.db3", write_ros, POINTS),
}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The file of a kind, written once."""
    written: dict[str, Path] = {}

    def get(kind: str) -> Path:
        if kind not in written:
            name, write, _ = WRITERS[kind]
            path = tmp_path_factory.mktemp(kind) / name
            write(path)
            written[kind] = path
        return written[kind]

    return get


def codes(record: gb.Experiment) -> dict[str, dict]:
    return {str(f.code): dict(f.values) for f in record.findings}


@pytest.mark.crossed(3)
@pytest.mark.parametrize("kind", WRITERS)
def test_two_rates_and_two_clocks_become_one_record(files: Callable[[str], Path], kind: str) -> None:
    record = gb.read_csv(files(kind), LAG_MODEL, columns=WRITERS[kind][2])
    assert record.sampling_time == pytest.approx(FAST, rel=1e-6)
    assert np.isfinite(record.inputs["u"]).all()
    measured = np.isfinite(record.outputs["y"])
    assert measured.sum() == pytest.approx(len(TIME_B), abs=2)
    start = TIME_A[np.argmin(np.abs(U - record.inputs["u"][0]))]
    true_time = start + record.time - record.time[0]
    np.testing.assert_allclose(record.inputs["u"], drive(true_time), atol=1e-9)
    # Moved along a chord of 10 ms; the recorder of the messages is 0.5 ms off.
    limit = 1e-3 if WRITERS[kind][2] is PLAIN else 1e-2
    np.testing.assert_allclose(record.outputs["y"][measured], answer(true_time[measured]), atol=limit)
    found = codes(record)
    if WRITERS[kind][2] is PLAIN:
        assert found["clock_offset"]["offset"] == pytest.approx(OFFSET, abs=2e-5)
        assert abs(found["clock_offset"]["drift"]) < 1e-5
    else:  # only the recorder saw both clocks, half a millisecond apart
        assert found["clock_offset_by_recorder"]["offset"] == pytest.approx(OFFSET + 5e-4, abs=1e-6)
    assert "brought_to_one_time" in found


def test_a_fit_of_the_joined_record_returns_the_constant(files: Callable[[str], Path]) -> None:
    record = gb.read_csv(files("mdf"), LAG_MODEL, hold="first")
    fit = gb.fit(LAG_MODEL, record)
    assert fit.parameters["T"].value == pytest.approx(LAG, rel=2e-3)


@pytest.mark.crossed(3)
@pytest.mark.parametrize("kind", WRITERS)
def test_a_file_is_looked_at_without_a_model(files: Callable[[str], Path], kind: str) -> None:
    survey = survey_file(files(kind))
    signals = {s.header.partition(" [")[0]: s for s in survey.signals}
    u, y = (signals[WRITERS[kind][2][name]] for name in ("u", "y"))
    assert (u.rows, y.rows) == (len(TIME_A), len(TIME_B))
    assert (u.step, y.step) == pytest.approx((FAST, SLOW), rel=1e-6) and u.regular and y.regular
    assert u.clock != y.clock
    if WRITERS[kind][2] is PLAIN:
        assert (u.unit, y.unit, u.use, y.use) == ("V", "mm", "input", "output")
        offset = next(f for f in survey.findings if f.code == RecordCode.CLOCK_OFFSET)
        assert offset.values["offset"] == pytest.approx(OFFSET, abs=2e-5)
    else:
        assert survey.columns[u.name] == u.header and u.name.isidentifier()
    assert str(survey) and survey.as_dict()["columns"]


def test_doubtful_sensors_and_holes_are_said_without_a_model(tmp_path: Path) -> None:
    time = np.delete(0.01 * np.arange(600), np.arange(300, 320))
    u, y = np.sin(9 * time), np.cos(3 * time)
    y[100:160], y[400] = y[100], 40.0
    rows = "\n".join(f"{t!r},{a!r},{b!r},7" for t, a, b in zip(time.tolist(), u.tolist(), y.tolist(), strict=True))
    (tmp_path / "run.csv").write_text(f"time [s],valve [V],x [mm],k\n{rows}\n")
    survey = survey_file(tmp_path / "run.csv")
    uses = {s.header: (s.use, s.gaps) for s in survey.signals}
    assert uses == {"time [s]": ("time", 1), "valve [V]": ("input", 1), "x [mm]": ("output", 1), "k": ("constant", 1)}
    assert [(str(f.code), f.subject) for f in survey.findings] == [("time_gap", ""), ("sensor_frozen", "x [mm]")]


# --- what belongs to each signal


def as_input(course: str) -> ChannelUse:
    return ChannelUse("u", SignalKind.INPUT, course)  # type: ignore[arg-type]


OUTPUT = ChannelUse("y", SignalKind.OUTPUT, "first")


def test_a_held_input_counts_by_its_mean_in_each_interval() -> None:
    switch = Samples(np.array([0.0, 0.25, 0.66]), np.array([0.0, 1.0, 3.0]))
    fast = Samples(np.arange(0, 1.01, 0.1), np.zeros(11))
    base = bring_to_one_base({1: switch, 2: fast}, {1: as_input("zero"), 2: OUTPUT})
    held = base.columns[1]
    np.testing.assert_allclose(held[:8], [0, 0, 0.5, 1, 1, 1, 1 + 2 * 0.4, 3], atol=1e-12)
    exact = 0.41 * 1 + (1.0 - 0.66) * 3
    assert np.sum(held[:-1]) * 0.1 == pytest.approx(exact)


def test_a_measurement_is_counted_once_and_lies_on_its_line() -> None:
    slow = Samples(0.037 + 0.1 * np.arange(10), 5 * (0.037 + 0.1 * np.arange(10)) + 1)
    fast = Samples(0.01 * np.arange(101), np.zeros(101))
    base = bring_to_one_base({1: fast, 2: slow}, {1: as_input("first"), 2: OUTPUT})
    measured = np.isfinite(base.columns[2])
    assert measured.sum() == 10
    np.testing.assert_allclose(base.columns[2][measured][1:-1], 5 * base.time[measured][1:-1] + 1)


def test_a_band_limited_signal_is_interpolated_between_its_samples() -> None:
    time, at = 0.01 * np.arange(400), np.linspace(0.6, 3.3, 999)
    tones = [(2 * np.pi * f, p) for f, p in ((3.0, 0.1), (20.0, 1.0), (38.0, 2.0))]
    result = interpolate_band_limited(Samples(time, sum(np.sin(w * time + p) for w, p in tones)), at)
    np.testing.assert_allclose(result, sum(np.sin(w * at + p) for w, p in tones), atol=3e-5)


def test_rows_in_a_gap_of_an_input_are_left_out() -> None:
    holed = np.delete(0.01 * np.arange(200), np.arange(50, 90))
    u, y = Samples(holed, np.sin(holed)), Samples(0.001 * np.arange(1990), np.zeros(1990))
    base = bring_to_one_base({1: u, 2: y}, {1: as_input("first"), 2: OUTPUT})
    assert not np.any((base.time > 0.5001) & (base.time < 0.8999))
    np.testing.assert_allclose(base.columns[1], np.sin(base.time), atol=2e-5)


def test_a_step_given_makes_a_grid() -> None:
    u, y = Samples(0.013 * np.arange(100), np.arange(100.0)), Samples(0.01 * np.arange(120), np.arange(120.0))
    base = bring_to_one_base({1: u, 2: y}, {1: as_input("first"), 2: OUTPUT}, step=0.05)
    np.testing.assert_allclose(np.diff(base.time), 0.05)
    np.testing.assert_allclose(base.columns[2], base.time / 0.01)
    np.testing.assert_allclose(base.columns[1], base.time / 0.013)


def test_clocks_are_compared_by_offset_and_drift() -> None:
    fast, slow = 0.001 * np.arange(10_000), 0.01 * np.arange(900)
    noise = 0.01 * np.random.default_rng(1).standard_normal(900)
    offset = estimate_clock_offset(Samples(fast, drive(fast)), Samples(slow, drive(slow * (1 + 1e-3) + 0.3) + noise))
    assert offset is not None
    assert offset.correct(np.array([1.0, 8.0])) == pytest.approx([1.301, 8.308], abs=5e-4)
    assert abs(offset.offset - 0.3 - 1e-3 * offset.middle) < 4 * offset.std
    assert estimate_clock_offset(Samples(fast, drive(fast)), Samples(slow, np.cos(40 * slow**2))) is None


# --- what is refused


def test_a_missing_library_is_named_with_the_line_that_installs_it(
    files: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    for kind, package, extra in (("mdf", "asammdf", "mdf"), ("tdms", "nptdms", "tdms"), ("excel", "openpyxl", "excel")):
        path = files(kind)
        monkeypatch.setitem(sys.modules, package, None)
        with pytest.raises(
            DataError, match=rf"needs the package {package}; install it with: pip install .*\[{extra}\]"
        ):
            survey_file(path)


@pytest.mark.parametrize("kind", WRITERS)
def test_a_damaged_file_is_one_sentence(files: Callable[[str], Path], kind: str, tmp_path: Path) -> None:
    whole = files(kind)
    content = whole.read_bytes()
    if kind == "ros2-sqlite":
        (tmp_path / "metadata.yaml").write_bytes((whole.parent / "metadata.yaml").read_bytes())
    for size in (3, 100, len(content) // 3):
        path = tmp_path / whole.name
        path.write_bytes(content[:size])
        with pytest.raises(DataError) as error:
            gb.read_csv(path, LAG_MODEL, columns=WRITERS[kind][2])
        assert whole.name in str(error.value) and str(error.value).replace("\n", "").isprintable()


@pytest.mark.parametrize("kind", WRITERS)
def test_limits_hold_before_anything_is_loaded(files: Callable[[str], Path], kind: str) -> None:
    with pytest.raises(DataError, match="limit"):
        gb.read_csv(files(kind), LAG_MODEL, columns=WRITERS[kind][2], reading=ReadingPolicy(largest_unpacked=10_000))


def test_the_course_of_an_unknown_input_is_refused(files: Callable[[str], Path]) -> None:
    with pytest.raises(DataError, match="no input"):
        gb.read_csv(files("mdf"), LAG_MODEL, interpolation={"v": "first"})
    with pytest.raises(DataError, match="hold 'cubic' of 'u' is unknown"):
        gb.read_csv(files("mdf"), LAG_MODEL, interpolation={"u": "cubic"})  # type: ignore[dict-item]
    with pytest.raises(DataError, match="'u', 'y': a mean belongs to an interval of its own clock"):
        gb.read_csv(files("mdf"), LAG_MODEL, hold="mean")


def test_electrical_signals_are_the_likely_inputs_where_no_name_says_so(tmp_path: Path) -> None:
    time = 0.01 * np.arange(200)
    rows = np.column_stack([time, 800 * np.sin(7 * time), 30 * np.cos(5 * time)])
    np.savetxt(
        tmp_path / "bench.csv", rows, delimiter=",", header="time [s],Motor current [mA],Speed [rpm]", comments=""
    )
    uses = {s.header: s.use for s in survey_file(tmp_path / "bench.csv").signals}
    assert uses == {"time [s]": "time", "Motor current [mA]": "input", "Speed [rpm]": "output"}
    np.savetxt(tmp_path / "speeds.csv", rows, delimiter=",", header="time [s],a [rpm],b [rpm]", comments="")
    assert "input" not in {s.use for s in survey_file(tmp_path / "speeds.csv").signals}


def _one_pole(values: np.ndarray, lag: float) -> np.ndarray:
    """What a filter of ``lag`` steps leaves of ``values`` (N,)."""
    return lfilter([1 - np.exp(-1 / lag)], [1, -np.exp(-1 / lag)], values)


def test_edges_that_lie_alike_between_two_samples_have_one_error() -> None:
    """At whole seconds, of which one is missing: they do not average out, and the variance is that of a uniform second."""
    bounds = np.array([0.0, 1.0, 2.0, 4.0, 5.0])[:, None] + np.array([-0.5, 0.5])
    assert _error_of_mean(bounds, np.ones(5, bool)) == pytest.approx(1 / 12)


def _two_clocks(seed: int, kind: str, drift: float) -> tuple[float, float, float, float]:
    """Error of the offset, its stated standard deviation, the drift found, and the largest error over the record: two clocks of which the
    second reads ``t - 0.237 s`` and loses ``drift``, each of which samples one signal at its own rate and phase."""
    random = np.random.default_rng(seed)
    first, second = (np.arange(0, 20, step) + random.uniform(0, step) for step in (1e-3, 2.5e-3))
    truth = second + 0.237 + drift * (second - second.mean())
    edges = (
        np.sort(random.uniform(1, 19, 40))
        if kind in ("trigger", "behind a filter")
        else np.add.outer(np.cumsum(random.uniform(0.4, 1.1, 24)), [0, 0.1]).ravel()
        if kind == "pulses of one length"
        else 1 + random.uniform(0, 0.01) + 0.5 * np.arange(30)
    )
    frequency, phase = 2 * np.pi * random.uniform(0.5, 5, 6), random.uniform(0, 6, 6)

    def signal(t: np.ndarray) -> np.ndarray:
        if kind == "shared":
            return np.sin(np.outer(t, frequency) + phase).sum(axis=1)
        return 5.0 * (np.searchsorted(edges, t, side="right") % 2)

    noise = 0.05
    a, b = (signal(t) + noise * random.standard_normal(len(t)) for t in (first, truth))
    if kind == "behind a filter":  # of 2 ms, before the second clock
        fine = np.arange(truth[0] - 0.1, truth[-1], 1e-4)
        b = np.interp(truth, fine, _one_pole(signal(fine), 20)) + noise * random.standard_normal(len(truth))
    offset = estimate_clock_offset(Samples(first, a), Samples(second, b))
    assert offset is not None
    at = offset.middle
    right = 0.237 + drift * (at - second.mean())
    return offset.offset - right, offset.std, offset.drift, float(np.abs(offset.correct(second) - truth).max())


@pytest.mark.crossed(3)
@pytest.mark.parametrize(
    "kind", ["trigger", "pulses of whole samples", "pulses of one length", "behind a filter", "shared"]
)
@pytest.mark.parametrize("drift", [8e-4, 0.0, pytest.param(-8e-4, marks=pytest.mark.slow)])
def test_the_uncertainty_of_a_clock_is_that_of_its_truth(kind: str, drift: float) -> None:
    errors, stated, drifts, largest = np.array([_two_clocks(seed, kind, drift) for seed in range(100, 140)]).T
    assert 0.6 < np.sqrt(np.mean((errors / stated) ** 2)) < 1.5
    assert np.all(np.abs(drifts - drift) < 2.5e-4)
    assert np.median(largest) < 3e-3
