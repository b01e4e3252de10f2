"""Effects added one after the other: what was known of a motor before the first is known beside the last."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorlens_physics.effect import catalogue
from motorlens_physics.motor_file import Knowledge, MotorFile, Stated, read_motor_file, write_motor_file
from motorlens_physics.recording import Recording
from motorlens_physics.scenario import measure, perform, scenarios
from motorlens_runtime.errors import DataError
from motorlens_workbench.ladder import add

MOTOR = Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml"
SEEN = ("voltage", "speed", "ambient")
SIZES = {"coulomb_friction.tau_c": 0.3, "constant_torque.tau_0": -0.15}
# Of what the motor file states, relative.
KNOWN = 0.01


@pytest.fixture(scope="module")
def rough() -> MotorFile:
    """What is stated of the motor, a bridge's resistance one deviation too low."""
    truth = read_motor_file(MOTOR)
    stated = {key: Knowledge(KNOWN * truth.values()[key], "bridge") for key in ("R_a0", "ke")}
    return truth.with_values({"R_a0": (1 - KNOWN) * truth.motor.R_a0, "J": 0.04, "b": 0.0018}, stated)


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Voltage and speed of the motor with both effects, nothing on the shaft."""
    truth = read_motor_file(MOTOR)
    for name in SIZES:
        effect = catalogue()[name.partition(".")[0]].typical(truth.rated)
        truth = replace(truth, motor=truth.motor.with_effect(effect))
    rng = np.random.default_rng(4)
    run = perform(truth.with_values(SIZES), scenarios()["no_load_steps"](10.0, 0.01), rng)
    shown = measure(run, (), {"voltage": 0.3, "speed": 0.3}, rng).channels
    return Recording(
        "bench.csv", run.time_s, {quantity: shown[quantity] for quantity in SEEN if quantity in shown}
    )


@pytest.mark.fit
def test_what_a_file_states_is_kept_from_one_addition_to_the_next(rough, recording, tmp_path):
    """Voltage and speed alone tell a motor but for a factor of all torques, to which only what is stated of R_a0 holds."""
    file, size = rough, KNOWN * read_motor_file(MOTOR).motor.R_a0
    for effect in ("coulomb_friction", "constant_torque"):
        write_motor_file(add(file, [effect], [recording]).rungs[-1].file, tmp_path / "motor.toml")
        file = read_motor_file(tmp_path / "motor.toml")
        known = file.knowledge["R_a0"]
        assert known.prior == Stated(rough.motor.R_a0, size, "bridge")
        assert file.knowledge["J"].prior is None
        # Nothing else tells it.
        assert known.sd == pytest.approx(size, rel=0.02)
        assert file.motor.R_a0 == pytest.approx(known.prior.value, abs=0.2 * size)
    for key, true in SIZES.items():
        sd = file.knowledge[key].sd
        assert sd is not None and KNOWN < sd / abs(true) < 4 * KNOWN
        assert abs(file.values()[key] - true) < 3 * sd

    # In one step the same, as far as fits go to the end (`weighed.CLOSE`), each judged beside the other.
    both = add(rough, [name.partition(".")[0] for name in SIZES], [recording])
    assert both.supported and both.new == 2
    assert [rung.added for rung in both.rungs] == ["", "coulomb_friction", "constant_torque"]
    for key in (*SIZES, "R_a0", "J", "b"):
        assert both.rungs[-1].file.values()[key] == pytest.approx(
            file.values()[key], abs=0.7 * (file.knowledge[key].sd or 0.0)
        )
        assert both.rungs[-1].file.knowledge[key].sd == pytest.approx(file.knowledge[key].sd, rel=0.1)


@pytest.mark.fit
def test_of_several_that_which_explains_nothing_is_named(rough, recording):
    found = add(rough, ["coulomb_friction", "constant_torque", "quadratic_drag"], [recording])
    assert not found.supported
    assert found.why.startswith("what quadratic drag explains is within chance")
    with pytest.raises(DataError, match="coulomb_friction is named twice"):
        add(rough, ["coulomb_friction", "constant_torque", "coulomb_friction"], [recording])
