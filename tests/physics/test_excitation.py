"""Each scenario that an effect names does make it visible: the channel it acts on moves by more than noise would."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorlens_physics.effect import catalogue
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.scenario import perform, scenarios

PAPER = read_motor_file(Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml")
SCALES = {"voltage": 240.0, "current": 7.27, "speed": 221.0, "temperature": 80.0}
# Share of the rated quantity, root mean square over a run: what a 12-bit converter resolves many times over.
VISIBLE = 1e-3
KNOWN = [(name, scenario) for name, effect in catalogue().items() for scenario in effect.excited_by]


def run(effect, scenario):
    file = replace(PAPER, motor=PAPER.motor.with_effect(effect))
    return perform(file, scenarios()[scenario](), np.random.default_rng(0)).channels


@pytest.mark.parametrize("name, scenario", KNOWN)
def test_the_scenario_shows_the_effect(name, scenario):
    effect = catalogue()[name]
    with_it, without = (run(e, scenario) for e in (effect.typical(PAPER.rated), effect.at_null(PAPER.rated)))
    seen = {
        channel: np.sqrt(np.mean((with_it[channel] - without[channel]) ** 2)) / scale
        for channel, scale in SCALES.items()
    }
    assert VISIBLE < max(seen.values()) < 1.0, seen
