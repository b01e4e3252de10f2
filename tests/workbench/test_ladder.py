"""Effects added one after the other: what was known of a motor before the first is known beside the last."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorlens_physics.effect import catalogue
from motorlens_physics.motor_file import Knowledge, Stated, read_motor_file, write_motor_file
from motorlens_physics.scenario import measure, perform, scenarios
from motorlens_workbench.ladder import add

MOTOR = Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml"
SEEN = ("voltage", "speed", "ambient")
SIZES = {"coulomb_friction.tau_c": 0.3, "constant_torque.tau_0": -0.15}
# Of what the motor file states, relative.
KNOWN = 0.01


@pytest.mark.fit
def test_what_a_file_states_is_kept_from_one_addition_to_the_next(tmp_path):
    """Voltage and speed alone tell a motor but for a factor of all torques, to which only what is stated of R_a0 holds."""
    truth = read_motor_file(MOTOR)
    size = KNOWN * truth.motor.R_a0
    stated = {key: Knowledge(KNOWN * truth.values()[key], "bridge") for key in ("R_a0", "ke")}
    file = truth.with_values({"R_a0": truth.motor.R_a0 - size, "J": 0.04, "b": 0.0018}, stated)
    for name in SIZES:
        effect = catalogue()[name.partition(".")[0]].typical(truth.rated)
        truth = replace(truth, motor=truth.motor.with_effect(effect))
    truth = truth.with_values(SIZES)
    rng = np.random.default_rng(4)
    shown = measure(
        perform(truth, scenarios()["no_load_steps"](10.0, 0.01), rng), (), {"voltage": 0.3, "speed": 0.3}, rng
    )
    recording = replace(
        shown,
        channels={quantity: shown.channels[quantity] for quantity in SEEN if quantity in shown.channels},
    )
    for effect in ("coulomb_friction", "constant_torque"):
        write_motor_file(add(file, effect, [recording]).rungs[-1].file, tmp_path / "motor.toml")
        file = read_motor_file(tmp_path / "motor.toml")
        known = file.knowledge["R_a0"]
        assert known.prior == Stated(truth.motor.R_a0 - size, size, "bridge")
        assert file.knowledge["J"].prior is None
        # Nothing else tells it.
        assert known.sd == pytest.approx(size, rel=0.02)
        assert file.motor.R_a0 == pytest.approx(known.prior.value, abs=0.2 * size)
    for key, true in SIZES.items():
        sd = file.knowledge[key].sd
        assert sd is not None and KNOWN < sd / abs(true) < 4 * KNOWN
        assert abs(file.values()[key] - true) < 3 * sd
