"""What reaches the state and what the quality word says of it; bits that do not depend on how samples arrive."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.sensor_files import write_sensor
from hypothesis import given, settings
from hypothesis import strategies as st

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.core_estimator import open_estimator
from motorlens_runtime.estimate.estimator import Estimates, EstimatorState
from motorlens_runtime.estimate.gate import GateState, Samples
from motorlens_runtime.estimate.quality import OpcUa, Quality, names, opc_ua, sparkplug
from motorlens_runtime.sensor.sensor import load_sensor

pytestmark = pytest.mark.usefixtures("engine")
SHIPPED = Path(__file__).resolve().parents[2] / "models/sensors"


@pytest.fixture(scope="module")
def sensor(engine, tmp_path_factory):
    path = tmp_path_factory.mktemp("sensor") / "s.onnx"
    write_sensor(path)
    return load_sensor(path)


def stream(n, seed=0, period_ns=1_000_000):
    rng = np.random.default_rng(seed)
    t = np.arange(n)
    voltage = 100 + 80 * np.sign(np.sin(t / 40)) + rng.normal(size=n)
    return Samples(t * period_ns + 5_000_000_000, voltage, 8 + 3 * np.sin(t / 70) + 0.2 * rng.normal(size=n))


def part(samples, rows):
    return Samples(samples.time_ns[rows], samples.voltage_V[rows], samples.current_A[rows])


def run(sensor, samples, edges=()):
    estimator = open_estimator(sensor, 1e-3)
    results = [
        estimator.push(part(samples, rows))
        for rows in np.split(np.arange(len(samples)), np.sort(edges).astype(int))
    ]
    return estimator, Estimates(
        *(np.concatenate([getattr(r, f) for r in results]) for f in Estimates.__dataclass_fields__)
    )


def damaged(samples, rng):
    """With gaps, NaN, infinities, rubbish and repeated stamps strewn in."""
    n = len(samples)
    keep = np.sort(rng.choice(n, n - n // 10, replace=False))
    result = part(samples, keep)
    result.voltage_V[rng.integers(0, len(keep), 5)] = [np.nan, np.inf, -np.inf, 1e30, 300.0]
    result.current_A[rng.integers(0, len(keep), 3)] = [np.nan, 1e200, 80.0]
    result.time_ns[7] = result.time_ns[6]
    return result


@pytest.mark.fit
@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.integers(0, 500), max_size=40), st.booleans(), st.integers(0, 2**32 - 1), st.sampled_from([0.05, 0.5])
)  # fmt: skip
def test_the_same_bits_however_samples_arrive(sensor, edges, broken, seed, share):
    samples = stream(500, seed)
    if broken:
        samples = damaged(samples, np.random.default_rng(seed))
    _, whole = run(sensor, samples)
    _, cut = run(sensor, samples, edges)
    for field in Estimates.__dataclass_fields__:
        assert np.array_equal(getattr(whole, field), getattr(cut, field)), field
    # and when only some rows are asked for, as a live publisher does
    rows = np.flatnonzero(np.random.default_rng(seed).random(len(samples)) < share)
    some = open_estimator(sensor, 1e-3).push(samples, rows)
    for field in Estimates.__dataclass_fields__:
        assert np.array_equal(getattr(some, field), getattr(whole, field)[rows]), field
    # and block by block, with no row, one or a few of each
    estimator, few, at = open_estimator(sensor, 1e-3), [], 0
    for block in np.split(np.arange(len(samples)), np.sort(edges).astype(int)):
        asked = rows[(rows >= at) & (rows < at + len(block))] - at
        few.append(estimator.push(part(samples, block), asked))
        at += len(block)
    for field in Estimates.__dataclass_fields__:
        assert np.array_equal(np.concatenate([getattr(p, field) for p in few]), getattr(some, field)), field


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30])
@pytest.mark.parametrize("channel", ["voltage_V", "current_A"])
def test_rubbish_is_left_out_exactly_as_if_it_had_never_come(sensor, value, channel):
    samples = stream(200)
    bad = replace(samples, **{channel: getattr(samples, channel).copy()})
    getattr(bad, channel)[50:53] = value
    estimator, result = run(sensor, bad)
    keep = np.delete(np.arange(200), [50, 51, 52])
    clean_estimator, clean = run(sensor, part(samples, keep))
    assert np.isfinite(result.values).all()
    reason = Quality.OUTSIDE_ENVELOPE if value == 1e30 else Quality.NOT_FINITE
    assert all(q & reason and q & Quality.BRIDGED for q in result.quality[50:53])
    assert not (result.quality[60:] & reason).any()
    # The state is that of the stream without them, to rounding: the blocks of the scan lie elsewhere.
    bank = sensor.bank
    ours, theirs = bank.values(estimator.state.bank), bank.values(clean_estimator.state.bank)
    assert np.abs(ours - theirs).max() <= 1e-13 * np.abs(theirs).max()
    assert np.abs(result.values[keep] - clean.values).max() < 1e-3


def test_gap_is_flagged_for_its_length_and_warm_up_for_its_time(sensor):
    samples = part(stream(1000), np.r_[0:500, 520:1000])
    _, result = run(sensor, samples)
    warm = (result.quality & Quality.WARM_UP) > 0
    assert warm[:50].all() and not warm[50:].any()  # 0.05 s in the helper's specification
    bridged = np.flatnonzero(result.quality & Quality.BRIDGED)
    assert bridged.tolist() == list(range(500, 521))  # 21 ms long at 1 kHz


def test_a_start_taken_for_cold_is_said_until_it_is_forgotten(sensor):
    slowest = max(f.tau_s for f in sensor.specification.filters)
    early = stream(500)
    jump = int(3e9 * slowest) - 300_000_000
    samples = replace(early, time_ns=early.time_ns + np.where(np.arange(500) < 100, 0, jump))
    for edges in ([], range(500)):
        _, result = run(sensor, samples, edges)
        cold = (result.quality & Quality.ASSUMED_COLD) > 0
        assert cold[:300].all() and not cold[300:].any()
    remembered = open_estimator(sensor, 1e-3, EstimatorState(sensor.bank.start(), GateState(remembered=True)))
    assert not (remembered.push(early).quality & Quality.ASSUMED_COLD).any()


def test_speed_alone_or_an_observer_assumes_no_cold_start(sensor):
    specification = sensor.specification
    speed = replace(specification, outputs=specification.outputs[:1])
    assert specification.outputs[0].name == "speed" and specification.cold_ns > 0 and speed.cold_ns == 0
    assert load_sensor(SHIPPED / "mellah2016_observer.onnx").specification.cold_ns == 0
    assert load_sensor(SHIPPED / "mellah2016.onnx").specification.cold_ns == round(3e9 * 4157.0)


def test_a_gap_longer_than_the_slowest_rate_and_values_outside_are_outside_the_envelope(sensor):
    samples = stream(300)
    samples.time_ns[100:] += 60_000_000
    samples.voltage_V[200] = 270.0
    _, result = run(sensor, samples)
    assert np.flatnonzero(result.quality & Quality.OUTSIDE_ENVELOPE).tolist() == [100, 200]


def test_feature_cloud_limits_the_envelope(tmp_path):
    write_sensor(tmp_path / "s.onnx", limit=60.0**2)
    samples = stream(400)
    samples.voltage_V[:] = np.where(np.arange(400) < 200, 1.0, 100.0)
    samples.current_A[:] = 0.0
    _, result = run(load_sensor(tmp_path / "s.onnx"), samples)
    assert np.flatnonzero(result.quality & Quality.OUTSIDE_ENVELOPE).tolist() == list(range(200, 400))


def test_stuck_current_and_dead_voltage_are_told_within_a_block(sensor):
    stuck = stream(600)
    stuck.current_A[300:] = stuck.current_A[300]
    _, result = run(sensor, stuck)
    told = np.flatnonzero(result.quality & Quality.STUCK)
    swing = np.flatnonzero(np.abs(np.diff(stuck.voltage_V)) > 100) + 1
    first = swing[swing > 300][0]
    assert told.tolist() == list(range(first + 64, 600))
    dead = stream(600)
    dead.voltage_V[300:] = 0.0
    dead.current_A[:] += 5.0
    _, result = run(sensor, dead)
    assert np.flatnonzero(result.quality & Quality.STUCK).tolist() == list(range(363, 600))


def test_a_stiff_supply_is_not_a_stuck_channel(sensor):
    samples = stream(2000)
    samples.voltage_V[:] = 240.0
    _, result = run(sensor, samples)
    assert not (result.quality & Quality.STUCK).any()


def test_jump_of_the_current_that_the_inductance_forbids(sensor):
    samples = stream(300)
    samples.current_A[150] += 60.0
    _, result = run(sensor, samples)
    assert np.flatnonzero(result.quality & Quality.JUMP).tolist() == [150, 151]


def test_two_backends_that_disagree_are_not_believed(sensor):
    class Wrong:
        name = "wrong"

        def evaluate(self, features):
            estimate, sigma = sensor.backend.evaluate(features)
            return estimate + 1.0, sigma

    _, result = run(replace(sensor, checker=Wrong()), stream(100))
    assert (result.quality & Quality.BACKEND_MISMATCH).all()
    _, result = run(sensor, stream(100))
    assert not (result.quality & Quality.BACKEND_MISMATCH).any()


def test_time_backwards_and_missing_ambient_are_refused(sensor, tmp_path):
    samples = stream(10)
    samples.time_ns[5] = samples.time_ns[3]
    with pytest.raises(DataError, match=r"backwards at 5\.00"):
        run(sensor, samples)
    write_sensor(tmp_path / "a.onnx", ambient=True)
    with pytest.raises(DataError, match="ambient"):
        run(load_sensor(tmp_path / "a.onnx"), stream(10))


def test_quality_in_the_words_of_others():
    assert names(Quality.STALE | Quality.SIMULATED) == ["stale", "simulated"]
    assert opc_ua(0) == OpcUa.GOOD and sparkplug(0) == 192
    assert (
        opc_ua(Quality.STALE | Quality.WARM_UP) == OpcUa.UNCERTAIN_LAST_USABLE
        and sparkplug(Quality.STALE) == 500
    )
    assert (
        opc_ua(Quality.NOT_FINITE | Quality.STALE) == OpcUa.BAD_SENSOR_FAILURE
        and sparkplug(Quality.NOT_FINITE) == 0
    )
    severity = {0: "GOOD", 1: "UNCERTAIN", 2: "BAD"}
    for bit in Quality:  # every reason has a code, and its top two bits say the severity
        assert opc_ua(bit).name.startswith(severity[opc_ua(bit) >> 30]) and opc_ua(bit) != OpcUa.GOOD


@pytest.mark.fit
@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 2**32 - 1), st.integers(1, 64), st.sampled_from([1_000_000, 40_000]), st.floats(50.0, 400.0),
    st.floats(0.0, 120.0), st.booleans(),
)  # fmt: skip
def test_few_samples_are_judged_as_many(sensor, seed, block, period_ns, volts, amperes, still):
    """The short way of the gate and the long way: levels in and out of range, currents that stand still, odd rates."""
    rng = np.random.default_rng(seed)
    n = round(1.5 * sensor.specification.warm_up_s * 1e9 / period_ns) + 400
    voltage = volts + 0.5 * rng.normal(size=n)
    voltage[n // 2 :: 97] += 30.0
    current = np.repeat(amperes + 0.3 * rng.normal(size=n), 80 if still else 1)[:n]
    samples = Samples(np.arange(n) * period_ns, voltage, current)
    first = open_estimator(sensor, period_ns * 1e-9)
    whole = first.push(samples)
    second = open_estimator(sensor, period_ns * 1e-9)
    parts = [second.push(part(samples, slice(at, at + block))) for at in range(0, n, block)]
    for field in Estimates.__dataclass_fields__:
        assert np.array_equal(np.concatenate([getattr(p, field) for p in parts]), getattr(whole, field)), (
            field
        )
    assert first.state.gate == second.state.gate
