"""In which stretch of time a model fails: against the closed form."""

from types import SimpleNamespace

import numpy as np
import pytest

from motorlens_workbench.compare.where import shortest_half

TIME = np.linspace(0.0, 100.0, 20_001)


def overlay(name, **errors):
    run = SimpleNamespace(name=name, channels=tuple(errors), inputs=SimpleNamespace(time_s=TIME))
    return SimpleNamespace(run=run, error_of=errors.__getitem__)


def test_half_of_a_bell_lies_within_its_probable_error():
    """Of exp(-x^2 / s^2) one half lies within 0.476936 s of its middle (the inverse of erf at one half)."""
    bell = 3.0 * np.exp(-0.5 * ((TIME - 40.0) / 5.0) ** 2)
    quiet = np.full(len(TIME), 0.1)
    found = shortest_half(
        "speed", [overlay("quiet", speed=quiet), overlay("bell", speed=-bell, current=quiet)]
    )
    assert found.recording == "bell" and found.channel == "speed"
    assert found.start_s == pytest.approx(40.0 - 0.476936 * 5.0, abs=0.02)
    assert found.stop_s == pytest.approx(40.0 + 0.476936 * 5.0, abs=0.02)
    assert found.share == pytest.approx(2 * 0.476936 * 5.0 / 100, abs=2e-4)


def test_an_error_that_is_everywhere_has_half_in_half_of_the_time():
    assert shortest_half("speed", [overlay("even", speed=np.ones(len(TIME)))]).share == pytest.approx(
        0.5, abs=1e-3
    )


def test_a_single_sample_and_no_error_at_all_take_no_time():
    peak = np.zeros(len(TIME))
    peak[7000] = 1.0
    assert shortest_half("speed", [overlay("peak", speed=peak)]).start_s == TIME[7000]
    assert shortest_half("speed", [overlay("none", speed=np.zeros(len(TIME)))]).share == 0.0
