"""Changes of a parameter over dates: how often one is claimed where there is none, and which kind is named."""

import numpy as np
import pytest
from scipy.stats import binom

from motorlens_workbench.fleet.history import change

DAYS = np.cumsum([0, 30, 31, 28, 30, 31, 30, 5, 60, 30])


@pytest.mark.parametrize("wander", [0.0, 2.0])
@pytest.mark.parametrize("known", [True, False])
@pytest.mark.fit
def test_false_alarms_are_as_rare_as_stated(wander, known):
    rng, level, count = np.random.default_rng(0), 0.05, 400
    sd = np.full(len(DAYS), 0.1)
    alarms = 0
    for _ in range(count):
        value = 3.5 + 0.1 * np.sqrt(1 + wander**2) * rng.standard_normal(len(DAYS))
        seen = change(DAYS, value, sd, 0.1 * wander if known else None)
        alarms += seen is not None and seen.p < level
    assert alarms <= binom.isf(0.001, count, level)
    assert alarms >= (binom.isf(0.999, count, level / 4) if known else 0)


def test_a_step_and_a_drift_are_named_with_their_size():
    rng, sd = np.random.default_rng(1), np.full(len(DAYS), 0.1)
    right = {"step": 0, "drift": 0}
    for _ in range(40):
        noise = 0.1 * rng.standard_normal(len(DAYS))
        step = change(DAYS, 3.5 + (np.arange(len(DAYS)) >= 4) + noise, sd)
        right["step"] += step is not None and step.p < 1e-3 and step.kind == "step" and step.at == 4
        drift = change(DAYS, 3.5 + DAYS / DAYS[-1] + noise, sd)
        right["drift"] += drift is not None and drift.p < 1e-3 and drift.kind == "drift"
        assert step is not None and abs(step.size - 1) < 5 * step.sd
        assert drift is not None and abs(drift.size - 1) < 5 * drift.sd
    assert right["step"] >= 38
    # A drift of ten deviations over ten recordings may pass for two levels.
    assert right["drift"] >= 30


def test_too_few_recordings_or_one_date_say_nothing():
    assert change(np.arange(3.0), np.array([1.0, 2.0, 3.0]), np.full(3, 0.1)) is None
    assert change(np.zeros(6), np.arange(6.0), np.full(6, 0.1)) is None
