"""A new sensor in service: no sample lost, the bits of a sensor that had run from the start, and back when it is no good."""

import json
import os
import threading
from dataclasses import replace

import numpy as np
import onnx
import pytest
from helpers.processes import eventually
from helpers.sensor_files import make_spec, seal, write_sensor

from motorlens_runtime.cli import main
from motorlens_runtime.estimate.core_estimator import open_estimator
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.sensor.sensor import load_sensor
from motorlens_runtime.service.swap import Swap, carried

pytestmark = pytest.mark.usefixtures("engine")


def alike(folder, name, seed=0, shift=0.0, sigma=1.0):
    """The same network with its outputs shifted by a share of their scale."""
    path = folder / name
    write_sensor(path, seed=seed)
    model = onnx.load(path)
    model.metadata_props.add(key="motorlens.note", value=name)
    if shift:
        size = next(t for t in model.graph.initializer if t.name == "size")
        offset = onnx.numpy_helper.from_array(shift * onnx.numpy_helper.to_array(size), "offset")
        model.graph.initializer.append(offset)
        last = next(node for node in model.graph.node if node.output[0] == "estimate")
        last.output[0] = "unshifted"
        model.graph.node.append(onnx.helper.make_node("Add", ["unshifted", "offset"], ["estimate"]))
        golden = next(p for p in model.metadata_props if p.key == "motorlens.golden")
        document = json.loads(golden.value)
        scale = [output["scale"] for output in make_spec()["outputs"]]
        document["estimate"] = (np.array(document["estimate"]) + shift * np.array(scale)).tolist()
        golden.value = json.dumps(document)
    path.write_bytes(seal(model.SerializeToString()))
    return load_sensor(path)


def stream(n):
    t = np.arange(n)
    rng = np.random.default_rng(0)
    return Samples(t * 1_000_000, 100 + 5 * np.sin(t / 90) + rng.normal(size=n), 8 + rng.normal(size=n))


def drive(first, offers, n=4000, block=10, shadow_s=0.5):
    """Feed blocks, offering sensors at given samples; returns estimates, events, and the sensor in service by block."""
    samples, swap, estimator = stream(n), Swap(first.path, shadow_s=shadow_s), open_estimator(first, 1e-3)
    parts, served = [], []
    for at in range(0, n, block):
        if at in offers:
            swap.offer(offers[at])
        rows = slice(at, at + block)
        part = Samples(samples.time_ns[rows], samples.voltage_V[rows], samples.current_A[rows])
        every = np.arange(block)
        served.append(estimator.sensor.digest)
        estimates = estimator.push(part, every)
        estimator, estimates = swap.follow(estimator, 1e-3, part, every, estimates)
        parts.append(estimates)
    fields = Estimates.__dataclass_fields__
    return (
        Estimates(*(np.concatenate([getattr(p, f) for p in parts]) for f in fields)),
        list(swap.events),
        np.repeat(served, block),
    )


def test_after_the_swap_it_is_as_if_the_new_one_had_run_from_the_start(tmp_path):
    a, b = alike(tmp_path, "a.onnx"), alike(tmp_path, "b.onnx", shift=0.01)
    result, events, served = drive(a, {1000: b})
    assert (
        len(result) == 4000
        and [e["event"] for e in events] == ["sensor"]
        and "taken into service" in events[0]["message"]
    )
    changed = int(np.flatnonzero(served == b.digest)[0])
    assert 1500 <= changed <= 1530
    for sensor, rows in ((a, slice(0, changed)), (b, slice(changed, 4000))):
        alone = open_estimator(sensor, 1e-3).push(stream(4000))
        for field in Estimates.__dataclass_fields__:
            assert np.array_equal(getattr(result, field)[rows], getattr(alone, field)[rows]), field


@pytest.mark.fit
def test_swaps_by_the_dozen_lose_nothing(tmp_path):
    a, b = alike(tmp_path, "a.onnx"), alike(tmp_path, "b.onnx", shift=0.01)
    offers = {at: (b, a)[(at // 500) % 2] for at in range(0, 20_000, 500)}
    result, events, served = drive(a, offers, n=20_000, shadow_s=0.1)
    assert np.array_equal(result.time_ns, stream(20_000).time_ns) and len(events) == 40
    assert (np.diff(served == b.digest) != 0).sum() == 39 + 1


@pytest.mark.parametrize(
    ("shift", "words"), [(50.0, "standard deviations from the old"), (float("nan"), "no usable value")]
)
def test_what_does_not_agree_is_not_taken(tmp_path, shift, words):
    a = alike(tmp_path, "a.onnx")
    b = alike(tmp_path, "b.onnx", shift=shift if shift == shift else 0.0)
    if shift != shift:
        b = replace(b, backend=Broken(b.backend, 0), checker=None)
    result, events, served = drive(a, {1000: b})
    assert (served == a.digest).all() and len(events) == 1
    assert "not taken into service" in events[0]["message"] and words in events[0]["message"]
    assert np.array_equal(result.values, open_estimator(a, 1e-3).push(stream(4000)).values)


class Broken:
    """A backend that gives NaN after a number of calls."""

    name = "broken"

    def __init__(self, backend, good):
        self._backend, self._good = backend, good

    def evaluate(self, features):
        estimate, sigma = self._backend.evaluate(features)
        self._good -= 1
        return (estimate if self._good >= 0 else estimate * np.nan), sigma


def test_one_that_breaks_in_service_is_rolled_back_without_a_bad_row(tmp_path):
    a, b = alike(tmp_path, "a.onnx"), alike(tmp_path, "b.onnx", shift=0.01)
    result, events, served = drive(a, {1000: replace(b, backend=Broken(b.backend, 70), checker=None)})
    assert [("back in service" in e["message"]) for e in events] == [False, True]
    assert served[0] == served[-1] == a.digest and (served == b.digest).any()
    assert np.isfinite(result.values).all() and not (result.quality & Quality.NOT_FINITE).any()
    back = int(np.flatnonzero(served == b.digest)[-1]) + 1
    assert np.array_equal(result.values[back:], open_estimator(a, 1e-3).push(stream(4000)).values[back:])


def test_refusals_are_events(tmp_path):
    a = alike(tmp_path, "a.onnx")
    write_sensor(tmp_path / "one.onnx", outputs=1)
    _, events, served = drive(
        a, {500: "b.onnx: altered or cut short", 1500: load_sensor(tmp_path / "one.onnx"), 2000: a}
    )
    assert (served == a.digest).all()
    assert ["altered" in events[0]["message"], "other outputs" in events[1]["message"], len(events)] == [
        True,
        True,
        2,
    ]


def test_other_filters_take_over_what_they_share(tmp_path):
    a = alike(tmp_path, "a.onnx")
    spec = make_spec()
    spec["filters"][2] = {"signal": "current", "tau_s": 77.0}
    write_sensor(tmp_path / "c.onnx", spec=spec)
    c = load_sensor(tmp_path / "c.onnx")
    estimator = open_estimator(a, 1e-3)
    estimator.push(stream(500))
    state, complete = carried(estimator.state, a, c)
    old = a.bank.values(estimator.state.bank)
    expected = [0.0 if k == 2 else value for k, value in enumerate(old)]
    assert not complete and c.bank.values(state.bank).tolist() == expected


@pytest.mark.fit
def test_the_file_is_watched_by_the_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    alike(tmp_path, "s.onnx")
    alike(tmp_path, "new.onnx", shift=0.01)
    (tmp_path / "rec.csv").write_text(
        "time_s,voltage_V,current_A\n"
        + "".join(f"{k / 1000},{100 + k % 7},{8 + k % 3}\n" for k in range(6000))
    )
    running = tmp_path / "out.csv"

    def replace_when_running():
        eventually(lambda: running.exists() and running.stat().st_size > 1000, "the first rows")
        os.replace("new.onnx", "s.onnx")

    threading.Thread(target=replace_when_running, daemon=True).start()
    arguments = ["run", "--source", "file:rec.csv?speed=1", "--sensor", "s.onnx", "--swap", "0.5"]
    assert main([*arguments, "--publish", "csv:out.csv", "--json", "report.json"]) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["samples"] == 6000 and report["lost"] == 0
    # A machine that is busy for a quarter of a second sees the last row again, marked stale.
    qualities = [int(row.rpartition(",")[2]) for row in (tmp_path / "out.csv").read_text().splitlines()[1:]]
    assert sum(not quality & Quality.STALE for quality in qualities) == 600
    assert any("taken into service" in event["message"] for event in report["events"])
