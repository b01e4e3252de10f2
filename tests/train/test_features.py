"""The filter bank of training: closed forms, and equality with the runtime's, written by others from the same document."""

import json
import math

import numpy as np
import pytest

from motorlens_train.features import feature_rows, motor_bank, recording_bank, signal
from motorlens_train.specification import (
    Bank,
    Cloud,
    Envelope,
    Feature,
    Filter,
    Output,
    Rate,
    Specification,
    bank_from,
)


def test_step_response_is_exponential_over_any_spacing() -> None:
    bank = Bank(
        2.0,
        0.0,
        (Filter("voltage", 0.3),),
        (Feature("lowpass", filters=(0,)), Feature("difference", "voltage", (0,))),
    )
    time = np.cumsum([0.001, 0.2, 0.0005, 3.0, 0.01])
    rows = feature_rows(bank, time, np.full(5, 10.0), np.zeros(5), first_dt_s=0.001)
    expected = 10 * (1 - np.exp(-time / 0.3))
    assert rows[:, 0] == pytest.approx(expected, rel=1e-12)
    assert rows[:, 1] == pytest.approx(10 - expected, rel=1e-9)


def test_signals_by_hand() -> None:
    v, i, a = np.array([10.0]), np.array([2.0]), np.array([25.0])
    by_hand = {"one": 1, "voltage": 10, "current": 2, "current_squared": 4, "voltage_squared": 100, "power": 20,
               "emf": 4, "emf_squared": 16, "emf_power": 8, "ambient": 25}  # fmt: skip
    assert {name: float(signal(name, v, i, 3.0, a)[0]) for name in by_hand} == by_hand


def by_the_document(
    spec: dict, time_s: np.ndarray, voltage_V: np.ndarray, current_A: np.ndarray
) -> np.ndarray:
    """docs/sensor-file.md read sentence by sentence from the JSON: a second implementation in plain loops."""
    state, rows, before = [0.0] * len(spec["filters"]), [], None
    for t, v, i in zip(time_s, voltage_V, current_A, strict=True):
        dt = 1 / spec["sample_rate_Hz"]["nominal"] if before is None else t - before
        before = t
        e = v - spec["resistance_ohm"] * i
        u = {"one": 1.0, "voltage": v, "current": i, "current_squared": i**2, "voltage_squared": v**2, "power": v * i,
             "emf": e, "emf_squared": e**2, "emf_power": e * i}  # fmt: skip
        for k, f in enumerate(spec["filters"]):
            state[k] = u[f["signal"]] + (state[k] - u[f["signal"]]) * math.exp(-dt / f["tau_s"])
        row = []
        for f in spec["features"]:
            match f["kind"]:
                case "raw":
                    row.append(u[f["signal"]])
                case "lowpass":
                    row.append(state[f["filter"]])
                case "difference":
                    row.append(u[f["signal"]] - state[f["filter"]])
                case "between":
                    row.append(state[f["filters"][0]] - state[f["filters"][1]])
        rows.append(row)
    return np.array(rows)


@pytest.mark.parametrize(
    "bank", [motor_bank(3.5, 0.034, 0.01, 0.13, 4000.0), recording_bank(1.0, 0.0, 0.001, 0.5)]
)
def test_rows_are_those_of_the_document(bank: Bank) -> None:
    generator = np.random.default_rng(4)
    n = 700
    time = np.cumsum(generator.choice([0.001, 0.0010001, 0.25], n, p=[0.6, 0.39, 0.01]))
    voltage, current = 100 * generator.standard_normal(n), 10 * generator.standard_normal(n)
    width = len(bank.features)
    specification = Specification(
        (Output("speed", "rad/s", 1.0),), bank, Rate(1000.0, 100.0, 2000.0), 1.0,
        Envelope((-1.0, 1.0), (-1.0, 1.0), Cloud(np.zeros(width), np.eye(width), 1.0)),
    )  # fmt: skip
    document = json.loads(json.dumps(specification.document()))
    theirs = by_the_document(document, time, voltage, current)
    ours = feature_rows(bank, time, voltage, current, first_dt_s=0.001)
    assert np.abs(ours - theirs).max() / np.abs(theirs).max() < 1e-12
    assert bank_from(document) == bank


def test_chosen_rows_are_rows_of_all() -> None:
    bank = motor_bank(3.5, 0.034, 0.01, 0.13, 4000.0)
    generator = np.random.default_rng(1)
    time, voltage, current = (
        np.arange(500) * 1e-3,
        generator.standard_normal(500),
        generator.standard_normal(500),
    )
    some = np.array([0, 3, 17, 499])
    assert np.array_equal(
        feature_rows(bank, time, voltage, current, some), feature_rows(bank, time, voltage, current)[some]
    )
