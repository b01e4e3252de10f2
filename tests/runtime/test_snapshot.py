"""Memory of heat: the closed form of cooling, whose snapshot it is, and what a crash at any instant leaves behind."""

import json
import math
import random
import sys
import textwrap
import time
from dataclasses import replace

import numpy as np
import pytest
from helpers.processes import Program
from helpers.sensor_files import features_by_loop, make_spec, write_sensor

from motorlens_runtime.estimate.core_estimator import open_estimator
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.sensor.sensor import load_sensor
from motorlens_runtime.service import snapshot

S = 1_000_000_000
pytestmark = pytest.mark.usefixtures("engine")


@pytest.fixture(scope="module", params=["plain", "ambient", "observer"])
def sensor(engine, request, tmp_path_factory):
    path = tmp_path_factory.mktemp("sensor") / "s.onnx"
    if request.param == "observer":
        write_with_observer(path)
    else:
        write_sensor(path, ambient=request.param == "ambient")
    return load_sensor(path)


TAU_S = 600.0


def program(inputs, constants, steps, outputs):
    return {"inputs": ["x"] * inputs, "constants": constants, "steps": steps, "outputs": outputs}


def write_with_observer(path):
    """A sensor with an observer of one state, which follows the square of the current with a time constant of 600 s."""
    spec = make_spec()
    # Registers of `accumulate`: v, i, ambient, dt, state, time, the constant, then one for each step.
    decay = [
        ["mul", 3, 6],
        ["exp", 7],
        ["mul", 1, 1],
        ["sub", 4, 9],
        ["mul", 10, 8],
        ["add", 9, 11],
        ["add", 5, 3],
    ]
    spec["observer"] = {
        "period_s": 0.01, "ambient_C": 20.0, "size": 2, "window": 2, "time": 1, "outputs": ["heat"],
        "accumulate": program(6, [-1 / TAU_S], decay, [12, 13]),
        "correct": program(3, [0.0], [], [1, 3]),
        "read": program(3, [], [], [1]),
    }  # fmt: skip
    spec["features"].append({"kind": "observer", "output": 0})
    n = len(spec["features"])
    spec["envelope"]["features"] = {
        "mean": [0.0] * n,
        "precision_cholesky": np.eye(n).tolist(),
        "limit": 1e12,
    }

    def features(spec, time_s, voltage, current, ambient=None):
        plain = {**spec, "features": spec["features"][:-1]}
        state, heat = 0.0, []
        for dt, i in zip(np.diff(time_s, prepend=time_s[0] - 0.001), current, strict=True):
            state = i * i + (state - i * i) * math.exp(-dt / TAU_S)
            heat.append([state])
        return np.hstack((features_by_loop(plain, time_s, voltage, current), heat))

    write_sensor(path, spec=spec, features=features)


def test_an_observer_cools_by_its_own_model(tmp_path):
    write_with_observer(tmp_path / "s.onnx")
    sensor = load_sensor(tmp_path / "s.onnx")
    taken = snapshot.take(sensor, "", hot_estimator(sensor).state, 10**18)
    heat = 400 * (1 - math.exp(-5 / TAU_S))
    assert taken.observer[0] == pytest.approx(heat, rel=1e-9)
    for off_s in (0.0, 0.5, 60.0, 3600.0):
        restored = snapshot.restore(taken, sensor, "", 10**18 + round(off_s * S))
        assert restored.state.observer[0] == pytest.approx(heat * math.exp(-off_s / TAU_S), rel=1e-9)
    assert "does not fit" in snapshot.restore(replace(taken, observer=()), sensor, "", 10**18)


def samples(n, start_s=0.0, voltage=150.0, current=20.0, ambient=31.0):
    time_ns = round(start_s * S) + np.arange(n) * 1_000_000
    return Samples(time_ns, np.full(n, voltage), np.full(n, current), np.full(n, ambient))


def hot_estimator(sensor):
    estimator = open_estimator(sensor, 0.001)
    estimator.push(samples(5000))
    return estimator


@pytest.mark.parametrize("off_s", [0.0, 1.0, 3600.0, 86_400.0])
def test_a_motor_off_for_a_while_has_cooled_by_the_closed_form(sensor, off_s, tmp_path):
    estimator = hot_estimator(sensor)
    taken = snapshot.take(sensor, "drive-7", estimator.state, 10**18)
    snapshot.save(tmp_path / "heat.json", taken)
    loaded = snapshot.load(tmp_path / "heat.json")
    assert loaded == taken
    restored = snapshot.restore(loaded, sensor, "drive-7", 10**18 + round(off_s * S))
    assert restored.off_s == pytest.approx(off_s, abs=1e-9)
    before = sensor.bank.values(estimator.state.bank)
    after = sensor.bank.values(restored.state.bank)
    at_rest = {"one": 1.0, "ambient": 31.0}
    for f, entry in enumerate(sensor.specification.filters):
        u = at_rest.get(entry.signal, 0.0)
        expected = u + (before[f] - u) * math.exp(-off_s / entry.tau_s)
        assert after[f] == pytest.approx(expected, rel=1e-12, abs=1e-12 * max(abs(before[f]), 1.0))


def test_a_restored_estimator_goes_on_as_one_that_saw_the_motor_stand_still(sensor):
    """Second way to the same state: feed the rest as samples instead of remembering it."""
    estimator = hot_estimator(sensor)
    taken = snapshot.take(sensor, "", estimator.state, 10**18)
    restored = snapshot.restore(taken, sensor, "", 10**18 + 200 * S)
    through = open_estimator(sensor, 0.001, estimator.state)
    through.push(Samples(np.array([204_999_000_000]), np.zeros(1), np.zeros(1), np.array([31.0])))
    again = samples(2000, start_s=205.0)
    expected = through.push(again)
    resumed = open_estimator(sensor, 0.001, restored.state).push(again)
    scale = np.array([output.scale for output in sensor.specification.outputs])
    assert np.abs((resumed.values - expected.values) / scale).max() < 1e-5


def test_without_memory_the_same_start_looks_cold(sensor):
    """That remembering matters: the slow filter of losses differs by what the heat was."""
    taken = snapshot.take(sensor, "", hot_estimator(sensor).state, 10**18)
    slow = int(np.argmax([f.tau_s for f in sensor.specification.filters]))
    restored = snapshot.restore(taken, sensor, "", 10**18 + 60 * S)
    assert sensor.bank.values(restored.state.bank)[slow] > 0.9 * taken.values[slow] > 0


def test_only_the_same_sensor_and_device_get_it_back(sensor):
    taken = snapshot.take(sensor, "drive-7", hot_estimator(sensor).state, 10**18)
    assert "not of 'drive-8'" in snapshot.restore(taken, sensor, "drive-8", 10**18)
    assert "another sensor's" in snapshot.restore(replace(taken, sensor="00" * 32), sensor, "drive-7", 10**18)
    assert "does not fit" in snapshot.restore(replace(taken, values=(1.0,)), sensor, "drive-7", 10**18)


def test_a_clock_that_stands_before_the_snapshot_counts_no_cooling(sensor):
    taken = snapshot.take(sensor, "", hot_estimator(sensor).state, 10**18)
    restored = snapshot.restore(taken, sensor, "", 5 * S)
    assert restored.off_s == 0.0 and "before the snapshot" in restored.message
    assert sensor.bank.values(restored.state.bank) == pytest.approx(taken.values, rel=1e-15)


def test_restored_samples_say_so_until_the_warm_up_is_over():
    flagged = snapshot.flagged(samples(10), 4_000_000)
    assert (flagged.flags & Quality.RESTORED > 0).tolist() == [True] * 4 + [False] * 6
    assert snapshot.flagged(samples(3, start_s=1), 4_000_000).flags is None


def test_a_damaged_file_is_named_and_not_used(sensor, tmp_path):
    path = tmp_path / "heat.json"
    assert snapshot.load(path) is None
    snapshot.save(path, snapshot.take(sensor, "d", hot_estimator(sensor).state, 10**18))
    good = path.read_bytes()
    generator = np.random.default_rng(0)
    for _ in range(200):
        broken = bytearray(good)
        broken[int(generator.integers(len(good) - 1))] ^= 1 << int(generator.integers(8))
        path.write_bytes(broken)
        loaded = snapshot.load(path)
        assert (isinstance(loaded, str) and str(path) in loaded) or json.loads(broken) == json.loads(good)
    for text in (b"", b"{}", b"[1]", b'{"content": 3, "sha256": "x"}', good[: len(good) // 2], b"\xff\xfe"):
        path.write_bytes(text)
        assert "damaged" in snapshot.load(path)


def test_a_disk_that_refuses_leaves_the_old_file(sensor, tmp_path):
    path = tmp_path / "heat.json"
    taken = snapshot.take(sensor, "d", hot_estimator(sensor).state, 10**18)
    snapshot.save(path, taken)
    (tmp_path / ".heat.json.draft").mkdir()
    with pytest.raises(OSError):
        snapshot.save(path, replace(taken, device="e"))
    assert snapshot.load(path) == taken


@pytest.mark.fit
def test_killed_while_writing_leaves_an_old_or_a_new_snapshot_never_a_torn_one(tmp_path):
    path = tmp_path / "heat.json"
    script = f"""
        from motorlens_runtime.service.snapshot import Snapshot, save
        k = 0
        while True:
            k += 1
            save({str(path)!r}, Snapshot("s", "d", k, (float(k),) * 50, None))
            print(k, flush=True)
    """
    chance = random.Random(7)
    for _ in range(8):
        with Program([sys.executable, "-c", textwrap.dedent(script)]) as program:
            program.line()
            time.sleep(chance.uniform(0.0, 0.01))
        done = [int(line) for line in program.out.splitlines(keepends=True) if line.endswith("\n")]
        loaded = snapshot.load(path)
        assert isinstance(loaded, snapshot.Snapshot)
        assert loaded.wall_time_ns >= max(done, default=1)  # what was reported saved is saved
        assert loaded.values == (float(loaded.wall_time_ns),) * 50
