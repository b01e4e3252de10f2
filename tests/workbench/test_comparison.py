"""Compare: its tools against closed forms, its judgement on data made by an integrator of this file's own."""

import base64
import json
import re
import struct
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.recordings import FOLDER, REGBOT_LEFT, needs_recordings, regbot
from scipy.integrate import solve_ivp

from motorlens_physics.effect import catalogue
from motorlens_physics.motor_file import MotorFile, read_motor_file, write_motor_file
from motorlens_physics.parameter import Rated
from motorlens_physics.recording import Recording, read_recording, under, write_recording
from motorlens_runtime.cli import main
from motorlens_runtime.errors import DataError
from motorlens_workbench.balances import lowpass
from motorlens_workbench.compare.comparison import compare
from motorlens_workbench.report.comparison import to_html, to_json
from motorlens_workbench.report.page import Page, Section
from motorlens_workbench.report.pictures import Axes, Line, packed, time_plots
from motorlens_workbench.report.thinning import thinned

pytestmark = pytest.mark.fit

PAPER = read_motor_file(Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml")
# A 24 V servo motor: none of these figures is a default anywhere.
VALUES = {
    "R_a0": 0.6, "L": 5e-4, "ke": 0.05, "J": 8e-5, "b": 2e-5,
    "alpha": 0.0039, "k0": 0.8, "kT": 0.001, "k_ir": 1e-5, "H": 90.0,
}  # fmt: skip
SERVO = MotorFile("servo", PAPER.motor, Rated(24.0, 6.0, 420.0, 0.28)).with_values(VALUES)
NOISE = {"current": 0.02, "speed": 0.3, "temperature": 0.05}

Term = Callable[[float, float, float], float]


@cache
def bench(volts: Term, torque: Term, heat: Term, seed: int = 0) -> Recording:
    """Thirty seconds at 250 Hz of voltage and load steps both ways; extra terms of (i, w, theta) in each balance."""
    p = VALUES
    rng = np.random.default_rng(seed)
    time = np.arange(0, 30, 0.004)
    knots = np.arange(0, 31, 0.5)
    # Never so little voltage that the brake would stop the motor: what then happens is another test's subject.
    level, load = (
        rng.choice([-1, 1], len(knots)) * rng.uniform(8, 24, len(knots)),
        rng.uniform(0, 0.25, len(knots)),
    )
    level[0] = 0.0

    def ramp(t: float | np.ndarray, values: np.ndarray) -> np.ndarray:
        # Steps that take 20 ms, so that linear interpolation between samples is true to what was applied.
        k = np.minimum((np.asarray(t) / 0.5).astype(int), len(knots) - 2)
        share = np.clip((t - knots[k]) / 0.02, 0, 1)
        return values[np.maximum(k - 1, 0)] * (1 - share) + values[k] * share

    def rates(t: float, x: np.ndarray) -> list[float]:
        i, w, theta = x
        v = float(ramp(t, level))
        drag = float(ramp(t, load * np.sign(level)))
        R = p["R_a0"] * (1 + p["alpha"] * theta)
        return [
            (v - R * i - p["ke"] * w + volts(i, w, theta)) / p["L"],
            (p["ke"] * i - p["b"] * w - drag + torque(i, w, theta)) / p["J"],
            (R * i * i + p["k_ir"] * w * w - p["k0"] * (1 + p["kT"] * abs(w)) * theta + heat(i, w, theta))
            / p["H"],
        ]

    run = solve_ivp(rates, (0, time[-1]), [0.0, 0.0, 0.0], "LSODA", time, rtol=1e-7, atol=1e-8)
    i, w, theta = run.y
    channels = {
        "voltage": ramp(time, level), "load_torque": ramp(time, load * np.sign(level)), "ambient": 0 * time + 20.0,
        "current": i + NOISE["current"] * rng.standard_normal(len(time)),
        "speed": w + NOISE["speed"] * rng.standard_normal(len(time)),
        "temperature": 20 + theta + NOISE["temperature"] * rng.standard_normal(len(time)),
    }  # fmt: skip
    return Recording("bench.csv", time, channels)


def nothing(i: float, w: float, theta: float) -> float:
    return 0.0


MISSING: dict[str, tuple[Term, Term, Term]] = {
    "electrical": (lambda i, w, theta: -0.8 * np.tanh(i / 0.2), nothing, nothing),
    "mechanical": (nothing, lambda i, w, theta: -0.02 * np.tanh(w / 3), nothing),
    "thermal": (nothing, nothing, lambda i, w, theta: 0.05 * abs(w)),
}


def test_lowpass_is_that_of_scipy() -> None:
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.01, 0.3, 200))
    y = rng.normal(size=200)
    run = solve_ivp(
        lambda t, s: (np.interp(t, time, y) - s) / 0.7, (time[0], time[-1]), [y[0]], t_eval=time, rtol=1e-9, atol=1e-10,
        max_step=0.02,
    )  # fmt: skip
    np.testing.assert_allclose(lowpass(y, time, 0.7), run.y[0], atol=1e-6)


def test_a_model_that_is_right_is_at_the_noise() -> None:
    found = compare(SERVO, [bench(nothing, nothing, nothing)])
    for name, sd in NOISE.items():
        channel = found.channels[name]
        assert channel.noise_floor == pytest.approx(sd, rel=0.1)
        assert channel.rmse == pytest.approx(sd, rel=0.1)
        assert abs(channel.bias) < 0.2 * sd
        # 100 (1 - rmse / spread), by its definition.
        assert 90 < channel.fit_percent < 100 or name == "temperature"
    assert all(0.8 < region.rms_in_sigma < 1.3 for region in found.regions.values())


@pytest.mark.parametrize("equation", sorted(MISSING))
def test_the_failing_equation_gets_the_blame(equation: str) -> None:
    found = compare(SERVO, [bench(*MISSING[equation])])
    assert max(c.rmse / c.noise_floor for c in found.channels.values()) > 1.5
    shares = {name: e.share for name, e in found.equations.items()}
    assert all(e.testable for e in found.equations.values())
    assert sum(shares.values()) == pytest.approx(1.0)
    assert shares[equation] > 0.8


def test_what_an_equation_lacks_is_the_missing_term() -> None:
    found = compare(SERVO, [bench(*MISSING["mechanical"])])
    (overlay,) = found.overlays
    w = overlay.run.measured[:, overlay.run.channels.index("speed")]
    steady = np.abs(w) > 30
    lacking = overlay.missing["mechanical"][steady]
    # -0.02 N m against the motion, within what smoothing leaves of noise and transients.
    assert np.median(lacking[w[steady] > 0]) == pytest.approx(-0.02, abs=0.003)
    assert np.median(lacking[w[steady] < 0]) == pytest.approx(0.02, abs=0.003)


def test_what_goes_with_an_angle_nobody_knows_is_left_out() -> None:
    """Samples half a second apart say nothing of the shaft's angle: the model has no detents there."""
    coarse = bench(nothing, nothing, nothing)
    every = slice(None, None, 125)
    channels = {quantity: values[every] for quantity, values in coarse.channels.items()}
    recording = Recording("coarse", coarse.time_s[every], channels)
    detents = catalogue()["cogging_torque"].typical(SERVO.rated)
    with_detents = replace(SERVO, motor=SERVO.motor.with_effect(detents))
    plain, toothed = (compare(file, [recording]).overlays[0].missing for file in (SERVO, with_detents))
    assert all(np.array_equal(plain[equation], toothed[equation]) for equation in plain)


def test_absent_channels_are_said_in_words() -> None:
    whole = bench(nothing, nothing, nothing)
    channels = {q: y for q, y in whole.channels.items() if q not in ("temperature", "load_torque", "current")}
    found = compare(SERVO, [Recording("part.csv", whole.time_s, channels)])
    document = to_json(found, ["part.csv"], "servo.toml")
    assert set(document["channels"]) == {"speed"}
    assert not any(equation["testable"] or equation["share"] for equation in document["equations"].values())
    assert document["equations"]["thermal"]["why"] == "temperature is not measured"
    assert document["equations"]["electrical"]["why"] == "current is not measured"
    json.dumps(document, allow_nan=False)
    inputs_only = Recording("in.csv", whole.time_s, {"voltage": whole.channels["voltage"]})
    with pytest.raises(DataError, match=r"in\.csv: only inputs are recorded"):
        compare(SERVO, [inputs_only])


def test_imposed_current_and_speed_leave_the_heat_to_be_tested() -> None:
    """Behind a speed controller the voltage on record is not the motor's: of what is imposed no equation is tested."""
    recording = under(bench(*MISSING["thermal"]), "current", "turned")
    found = compare(
        SERVO, [replace(recording, channels={**recording.channels, "voltage": np.full(len(recording), 24.0)})]
    )
    assert set(found.channels) == {"temperature"} and not found.follows
    assert "imposed" in found.equations["electrical"].why and "imposed" in found.equations["mechanical"].why
    assert found.equations["thermal"].testable and found.equations["thermal"].share == pytest.approx(1.0)
    # What drives the heat is drawn, and what no drive imposes is not said to be imposed.
    for drawn, imposed in ((found, True), (compare(SERVO, [bench(*MISSING["thermal"])]), False)):
        text = "".join(to_html(drawn, ["bench.csv"], "servo.toml", "motorlens compare ..."))
        (pictures,) = re.findall(r'id="pictures">(.*?)</script>', text)
        assert all((f"imposed {what}" in pictures) == imposed for what in ("current", "speed"))


@pytest.mark.long
def test_several_recordings_are_pooled() -> None:
    one, other = bench(*MISSING["mechanical"], seed=1), bench(*MISSING["mechanical"], seed=2)
    together = compare(SERVO, [one, other]).channels["speed"].rmse
    apart = [compare(SERVO, [recording]).channels["speed"].rmse for recording in (one, other)]
    assert together == pytest.approx(np.sqrt(np.mean(np.square(apart))), rel=1e-9)


def test_the_page_stands_alone_and_holds_every_sample() -> None:
    recording = bench(nothing, nothing, nothing)
    found = compare(SERVO, [recording])
    text = "".join(to_html(found, ["bench.csv"], "servo.toml", "motorlens compare ..."))
    without_scripts = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)
    assert "http" not in without_scripts.replace("http-equiv", "")
    assert "The model follows these recordings to their noise" in without_scripts
    (specs,) = re.findall(r'id="pictures">(.*?)</script>', text)
    pictures = json.loads(specs)
    assert [picture["kind"] for picture in pictures] == ["time", "cloud", "cloud", "cloud", "curves"]
    time = pictures[0]
    # Every sample as float32, by a decoder of this test's own.
    series = dict(re.findall(r'type="text/plain" id="(data-[\d-]+)">([^<]*)</script>', text))
    for channel in ("current", "speed", "temperature"):
        octets = base64.b64decode(series[time["data"][f"{channel}, measured"]])
        values = struct.unpack(f"<{len(recording)}f", octets)
        assert np.array_equal(values, recording.channels[channel].astype(np.float32))
    stamps = time["time"]["start"] + time["time"]["step"] * np.arange(time["time"]["count"])
    assert np.abs(stamps - (recording.time_s - recording.time_s[0])).max() < 1e-3 * time["time"]["step"]


def test_a_long_recording_is_thinned_to_its_peaks_and_says_so() -> None:
    time = np.arange(0, 3000, 0.01)
    rng = np.random.default_rng(3)
    measured = np.sin(time / 50) + 0.1 * rng.standard_normal(len(time))
    model = np.sin(time / 50)
    measured[[123_457, 200_001]] = 9.0, -7.0
    model[77_777] = 5.0
    measured[5_000:5_400] = np.nan
    lines = [Line("measured", "measured", "m"), Line("predicted", "predicted", "p")]
    axes = [Axes("speed", "rad/s", lines), Axes("error", "rad/s", [Line("error", "lacking", "m", "p")])]
    plot = time_plots("long", time, axes, {"m": measured, "p": model}, {"speed": "m"}, caption="Long.")
    few = thinned(plot, 2000)
    at = np.searchsorted(time, few.data["time_s"] - 1e-9)
    assert 1000 < len(at) <= 2500 and {0, 123_457, 200_001, 77_777, len(time) - 1} <= set(at.tolist())
    # What is there is the recording's own, all lines of one sample together.
    np.testing.assert_allclose(few.data["time_s"], time[at], rtol=1e-12)
    np.testing.assert_array_equal(few.data["m"], measured[at])
    np.testing.assert_array_equal(few.data["p"], model[at])
    for begin in range(0, len(time), 30_000):
        # No peak is lost: what is at least a stretch away from both ends is not above what is kept between them.
        inside = at[(at >= begin) & (at < begin + 30_000)]
        assert np.nanmax(measured[inside]) >= np.nanmax(measured[begin + 2_000 : begin + 28_000])
        assert np.nanmin(measured[inside]) <= np.nanmin(measured[begin + 2_000 : begin + 28_000])
    assert "Of 300000 samples" in few.caption and thinned(plot, 400_000) is plot
    whole = Page("t", "v", [], [Section("s", [plot, plot])], [])
    assert 200_000 < len("".join(whole)) < 1_500_000
    assert "Every sample is here." in "".join(replace(whole, budget_octets=1e8))


def test_uneven_stamps_are_kept_one_by_one() -> None:
    stamps = np.array([0.0, 0.1, 0.25, 0.3])
    assert np.array_equal(np.frombuffer(base64.b64decode(packed(stamps, "<f8"))), stamps)
    plot = time_plots("r", stamps, [], {}, {})
    assert plot.spec["time"] == {"data": "time_s"} and plot.data["time_s"] is stamps


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_motor_file(SERVO, tmp_path / "servo.toml")
    write_recording(bench(*MISSING["mechanical"]), tmp_path / "bench.csv")
    arguments = ["compare", str(tmp_path / "bench.csv"), "--motor", str(tmp_path / "servo.toml")]
    assert main([*arguments, "--json", str(tmp_path / "c.json"), "--html", str(tmp_path / "c.html")]) == 0
    assert "in the mechanical equation" in capsys.readouterr().out
    document = json.loads((tmp_path / "c.json").read_text())
    assert document["schema"] == "motorlens.compare/1"
    assert {"unit", "rmse", "nrmse_percent", "bias", "max", "noise_floor"} == set(
        document["channels"]["speed"]
    )
    half = document["half_of_the_error"]
    assert half["channel"] in document["channels"] and 0 <= half["start_s"] < half["stop_s"] <= 30.0
    assert {"speed", "current", "rms_in_sigma", "samples"} == set(document["regions"][0])
    assert (tmp_path / "c.html").stat().st_size > 300_000
    assert main([*arguments[:2], "--motor", str(tmp_path / "none.toml")]) == 1


def test_a_motor_at_rest_is_followed_and_has_a_page() -> None:
    """Nothing moves and nothing is noisy: no division by what is not there."""
    time = np.arange(0, 2, 0.01)
    rest = {
        "voltage": 0 * time,
        "current": 0 * time,
        "speed": 0 * time,
        "temperature": 20 + 0 * time,
        "ambient": 20 + 0 * time,
    }
    found = compare(SERVO, [Recording("rest", time, rest)])
    assert found.follows and all(channel.rmse < 1e-9 for channel in found.channels.values())
    assert "</html>" in "".join(to_html(found, ["rest.csv"], "servo.toml", "motorlens compare"))
    stuck = rest | {"voltage": 5 + 0 * time, "current": 1 + 0 * time, "speed": 3 + 0 * time}
    found = compare(SERVO, [Recording("stuck", time, stuck)])
    assert found.channels["speed"].times_noise > 10
    assert "</html>" in "".join(to_html(found, ["stuck.csv"], "servo.toml", "motorlens compare"))


@needs_recordings
def test_real_recordings_are_compared() -> None:
    robot = read_recording(regbot(1), REGBOT_LEFT)
    # The documented wheel motor: 3 ohm with its driver, 6.6 mH, 0.0105 V s/rad times 9.68.
    wheel = SERVO.with_values({"R_a0": 3.0, "L": 6.6e-3, "ke": 0.1016, "J": 1.5e-4, "b": 1e-3})
    found = compare(wheel, [robot])
    assert 0.5 < found.channels["speed"].rmse < 10
    assert not found.equations["thermal"].testable
    lab = read_recording(FOLDER / "fra233" / "studyV4_Ramp_1.csv.gz")
    assert set(compare(SERVO, [lab]).channels) == {"speed"}
