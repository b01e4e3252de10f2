"""The thermal equation alone: between its sources the motor follows the recording, and warms as the textbook says."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorlens_physics.estimate.fit import start_model
from motorlens_physics.estimate.model import predict
from motorlens_physics.estimate.prepare import prepare
from motorlens_physics.estimate.prior import base_prior
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import Recording
from motorlens_runtime.errors import DataError
from motorlens_workbench.driven import driven, freed

FILE = read_motor_file(Path(__file__).resolve().parents[2] / "examples" / "real_recordings" / "mega.toml")


def bench() -> Recording:
    """Half an hour of current and speed that no voltage on record explains; the warmth by Euler steps of 0.05 s."""
    time = np.arange(0.0, 1800.0, 0.5)
    on = (time % 600) < 250
    current, speed = np.where(on, 40.0, 0.0), np.where(on, 300.0, 0.0)
    m, rise, shown = FILE.motor, 10.0, []
    for i, w in zip(current, speed, strict=True):
        shown.append(rise)
        for _ in range(10):
            heat = m.R_a0 * (1 + m.alpha * rise) * i * i + m.k_ir * w * w - m.k0 * (1 + m.kT * w) * rise
            rise += 0.05 * heat / m.H
    channels = {"voltage": np.full(len(time), 48.0), "current": current, "speed": speed}
    channels |= {"temperature": 24.0 + np.array(shown), "ambient": np.full(len(time), 24.0)}
    return Recording("stand.csv", time, channels)


def test_current_and_speed_are_imposed_and_the_warmth_follows() -> None:
    recording = bench()
    file, (fed,) = driven(FILE, [recording])
    run = prepare(fed, file)
    assert run.channels == ("temperature",)
    model = replace(start_model(file, [run]), held=(True,))
    trajectory, shown = predict(model, run, 0)
    # A source follows within a sample of each switching.
    for drawn, asked in ((trajectory.current_A, "current"), (trajectory.speed_rad_s, "speed")):
        off = np.abs(drawn - recording.channels[asked]) > 2e-3 * recording.channels[asked].max()
        assert 0 < np.count_nonzero(off) <= 12
    # The start is a median of the first samples; what that is off by has cooled away after 200 s.
    off = np.abs(shown[:, 0] - recording.channels["temperature"])
    assert 0.1 < np.max(off[:5]) < 1.0
    assert 0.0 < np.max(off[400:]) < 0.05


def test_only_what_is_thermal_is_fitted_and_the_rest_comes_back() -> None:
    file, (fed,) = driven(FILE, [bench()])
    keys = {key for key in base_prior(file, [prepare(fed, file)]).keys if "@" not in key}
    assert keys == {"R_a0", "alpha", "k0", "kT", "k_ir", "H"}
    back = freed(file.with_values({"H": 120.0}), FILE)
    assert back.values() == FILE.values() | {"H": 120.0}


def test_what_is_missing_is_said() -> None:
    whole = bench()
    part = replace(whole, channels={q: y for q, y in whole.channels.items() if q != "speed"})
    with pytest.raises(DataError, match="speed not recorded"):
        driven(FILE, [part])
