"""Alarms against rows written by hand and against the closed form of a body that warms up."""

import math
from dataclasses import replace

import numpy as np
import pytest

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.sensor.specification import parse_specification
from motorlens_runtime.service.alarms import Limit, Quantity, TimeToLimit, Watch, parse_alarm

HEAT = Quantity(column=0, heading="temperature_rise_K", side=1, sigmas=0.0)


def rows(values, start_s=0.0, step_s=1.0, quality=0, sigma=0.0):
    values = np.asarray(values, dtype=float)
    time_ns = np.round((start_s + step_s * np.arange(len(values))) * 1e9).astype(np.int64)
    word = np.broadcast_to(np.asarray(quality, dtype=np.uint32), values.shape)
    return Estimates(time_ns, values[:, None], np.full((len(values), 1), sigma), word)


def changes(alarm, *blocks):
    watch = Watch([alarm])
    return [(event.time_ns / 1e9, event.active) for block in blocks for event in watch.look(block)]


def test_hysteresis():
    alarm = Limit("hot", HEAT, limit=90.0, hysteresis=5.0)
    values = [80, 90, 90.1, 89, 86, 85, 84.9, 88, 91, 84]
    whole = changes(alarm, rows(values))
    assert whole == [(2.0, True), (6.0, False), (8.0, True), (9.0, False)]
    for cut in range(1, len(values)):
        assert changes(alarm, rows(values[:cut]), rows(values[cut:], start_s=cut)) == whole


def test_a_limit_must_be_passed_for_as_long_as_it_says():
    alarm = Limit("hot", HEAT, limit=90.0, hysteresis=5.0, hold_s=2.0)
    values = [95, 95, 80, 95, 95, 95, 95, 80, 95, 95]
    whole = changes(alarm, rows(values))
    assert whole == [(5.0, True), (7.0, False)]
    for cut in range(1, len(values)):
        assert changes(alarm, rows(values[:cut]), rows(values[cut:], start_s=cut)) == whole
    # One row a block: what was waited for is forgotten when it passes.
    assert changes(alarm, *(rows([v], start_s=k) for k, v in enumerate(values))) == whole


def test_bad_and_stale_rows_change_nothing():
    alarm = Limit("hot", HEAT, limit=90.0, hysteresis=5.0)
    for word in (Quality.STALE, Quality.NOT_FINITE, Quality.STUCK, Quality.BACKEND_MISMATCH):
        watch = Watch([alarm])
        assert not watch.look(rows([200.0, math.nan], quality=word))
        assert watch.look(rows([100.0], start_s=2))[0].active
        assert not watch.look(rows([0.0], start_s=3, quality=word))
        assert not watch.look(rows([0.0], start_s=4, quality=Quality.BRIDGED))[0].active


def test_below_and_deviations():
    slow = Limit("slow", Quantity(0, "speed_rad_s", side=-1, sigmas=2.0), limit=10.0, hysteresis=1.0)
    watch = Watch([slow])
    assert not watch.look(rows([13.0], sigma=1.0))  # 13 - 2 = 11
    event = watch.look(rows([11.5], start_s=1, sigma=1.0))[0]  # 9.5 with two deviations
    assert event.active and event.message == "speed_rad_s is 9.5, below 10"
    assert event.document() == {
        "event": "alarm", "alarm": "slow", "active": True, "timestamp": 1.0, "value": 9.5, "limit": 10.0,
        "message": "speed_rad_s is 9.5, below 10",
    }  # fmt: skip


@pytest.mark.parametrize("tau_s", [300.0, 900.0, math.inf])
@pytest.mark.parametrize("step_s", [0.01, 0.5])
def test_time_to_limit_is_that_of_the_closed_form(tau_s, step_s):
    """A winding from 20 K towards 120 K (or 0.1 K/s for ever): when will it be at 90 K?"""
    time_s = step_s * np.arange(1, round(200 / step_s))
    if math.isinf(tau_s):
        curve, truth = 20 + 0.1 * time_s, (90 - 20) / 0.1
    else:
        curve, truth = 120 - 100 * np.exp(-time_s / tau_s), tau_s * math.log(100 / 30)
    alarm = TimeToLimit("soon", HEAT, 90.0, within_s=60.0, hysteresis_s=10.0, tau_s=tau_s, window_s=30.0)
    watch = Watch([alarm])
    raised_at = None
    for k in range(0, len(time_s), 7):
        events = watch.look(rows(curve[k : k + 7], start_s=time_s[k], step_s=step_s))
        raised_at = (
            events[0].time_ns / 1e9 if events and events[0].active and raised_at is None else raised_at
        )
        now = time_s[min(k + 6, len(time_s) - 1)]
        left = watch.time_to_limit_s()["soon"]
        if now > 40 and now < truth - 5:
            assert left == pytest.approx(truth - now, rel=0.02)
        if now < 29:
            assert math.isinf(left)  # too little seen
    assert (raised_at is not None) == (truth < time_s[-1] + 60)
    if raised_at is not None:
        assert raised_at == pytest.approx(max(truth - 60, 30), abs=4)


def test_a_motor_that_settles_below_the_limit_raises_no_alarm():
    time_s = 0.5 * np.arange(6000)
    curve = 80 * (1 - np.exp(-time_s / 600))
    watch = Watch([TimeToLimit("soon", HEAT, 90.0, within_s=720.0, hysteresis_s=10.0, tau_s=600.0)])
    assert not [e for k in range(0, 6000, 50) for e in watch.look(rows(curve[k : k + 50], time_s[k], 0.5))]
    # The straight line, which knows no end, cries wolf early on: the price of not knowing tau.
    line = Watch([TimeToLimit("soon", HEAT, 90.0, within_s=720.0, hysteresis_s=10.0)])
    assert [e for k in range(0, 6000, 50) for e in line.look(rows(curve[k : k + 50], time_s[k], 0.5))]


SPECIFICATION = parse_specification(
    """{"schema": "motorlens.spec/1", "inputs": ["voltage", "current"], "resistance_ohm": 3.5,
    "outputs": [{"name": "speed", "unit": "rad/s", "scale": 1}, {"name": "temperature", "unit": "K", "scale": 1}],
    "filters": [{"signal": "one", "tau_s": 5000}, {"signal": "current_squared", "tau_s": 800},
                {"signal": "power", "tau_s": 90}],
    "features": [{"kind": "raw", "signal": "voltage"}], "sample_rate_Hz": {"nominal": 1000, "minimum": 1, "maximum": 20000},
    "warm_up_s": 1, "envelope": {"voltage_V": [0, 1], "current_A": [0, 1]}}""",
    "test",
)


def test_events_name_the_file_that_says_more():
    for text in ("speed>90", "speed>90,within_s=120,window_s=1"):
        alarm = parse_alarm(f"{text},file=fleet/index.html", SPECIFICATION)
        seen = Watch([alarm]).look(rows(np.linspace(60.0, 120.0, 100)))
        assert [event.document()["file"] for event in seen] == ["fleet/index.html"]
        assert "file" not in replace(seen[0], file="").document()


def test_alarms_are_read_from_text():
    alarm = parse_alarm("temperature_rise_K>90,hysteresis=5,hold_s=2,sigmas=1.5,name=hot", SPECIFICATION)
    assert alarm == Limit("hot", Quantity(1, "temperature_rise_K", 1, 1.5), 90.0, 5.0, 2.0)
    alarm = parse_alarm("temperature > 90, within_s=120", SPECIFICATION)
    assert alarm == TimeToLimit(
        "temperature within 120 s", Quantity(1, "temperature_rise_K", 1, 0.0), 90.0, 120.0, 60.0, 800.0, 30.0
    )
    assert parse_alarm("speed<-1e2", SPECIFICATION).quantity.side == -1
    for text, message in {
        "temperatur>90": "does not estimate 'temperatur'; did you mean 'temperature_rise_K'",
        "temperature=90": "write QUANTITY>NUMBER",
        "temperature>90,hysteresys=1": "no option 'hysteresys'; did you mean 'hysteresis'",
        "temperature>90,hold_s": "'hold_s' is no key=value",
        "temperature>1e": "limit=1e",
    }.items():
        with pytest.raises(DataError, match=message):
            parse_alarm(text, SPECIFICATION)
