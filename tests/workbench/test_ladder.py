"""Effects added one after the other and at once: what was known of a motor before counts, and each is judged beside all."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorlens_physics.effect import catalogue
from motorlens_physics.estimate.prior import TAKEN
from motorlens_physics.motor_file import Knowledge, MotorFile, Stated, read_motor_file, write_motor_file
from motorlens_physics.recording import Recording
from motorlens_physics.scenario import measure, perform, scenarios
from motorlens_runtime.errors import DataError
from motorlens_workbench.ladder import Ladder, add
from motorlens_workbench.report.ladder import sentence

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


@pytest.fixture(scope="module")
def one_by_one(steps) -> list[MotorFile]:
    """The motor files that adding one effect and then the other has written."""
    return [file for file, _ in steps]


@pytest.fixture(scope="module")
def steps(rough, recording, tmp_path_factory) -> list[tuple[MotorFile, Ladder]]:
    """The motor file that each addition has written, and its ladder."""
    path, file, steps = tmp_path_factory.mktemp("ladder") / "motor.toml", rough, []
    for key in SIZES:
        ladder = add(file, [key.partition(".")[0]], [recording])
        write_motor_file(ladder.rungs[-1].file, path)
        file = read_motor_file(path)
        steps.append((file, ladder))
    return steps


@pytest.mark.fit
def test_what_a_file_states_is_kept_from_one_addition_to_the_next(rough, one_by_one):
    """Voltage and speed alone tell a motor but for a factor of all torques, to which only what is stated of R_a0 holds."""
    size = KNOWN * read_motor_file(MOTOR).motor.R_a0
    for file in one_by_one:
        known = file.knowledge["R_a0"]
        assert known.prior == Stated(rough.motor.R_a0, size, "bridge")
        assert file.knowledge["J"].prior == Stated(rough.motor.J, 0.5 * rough.motor.J, TAKEN)
        # Nothing else tells it.
        assert known.sd == pytest.approx(size, rel=0.02)
        assert file.motor.R_a0 == pytest.approx(known.prior.value, abs=0.2 * size)
    for key, true in SIZES.items():
        sd = one_by_one[-1].knowledge[key].sd
        assert sd is not None and KNOWN < sd / abs(true) < 4 * KNOWN
        assert abs(one_by_one[-1].values()[key] - true) < 3 * sd


@pytest.mark.fit
def test_the_next_addition_begins_where_the_first_did(steps):
    """What a file has learnt from a recording is no place to begin with it again: its fit might end elsewhere."""
    (_, first), (_, second) = steps
    for again, rung in zip(second.rungs, first.rungs, strict=False):
        assert again.held_out == pytest.approx(rung.held_out, rel=1e-6)
        assert again.file.values() == pytest.approx(rung.file.values(), rel=1e-4)


@pytest.mark.long
@pytest.mark.fit
def test_what_is_far_from_the_motor_file_is_said(rough, recording):
    """In the words of the other commands; an inertia stated a third too low."""
    wrong, far = 0.02, "standard deviations from the motor file's"
    off = rough.with_values({"J": wrong}, {"J": Knowledge(0.03 * wrong, "drawing")})
    said = add(off, ["coulomb_friction"], [recording]).rungs[-1].said
    assert any(line.startswith("J: ") and far in line for line in said)
    assert not any(far in line for line in add(rough, ["coulomb_friction"], [recording]).rungs[-1].said)


@pytest.mark.fit
def test_several_at_once_are_what_they_are_one_after_the_other(rough, recording, one_by_one):
    """As far as fits go to the end (`points.CLOSE`)."""
    both, last = add(rough, [key.partition(".")[0] for key in SIZES], [recording]), one_by_one[-1]
    assert both.supported and both.new == 2
    assert [rung.added for rung in both.rungs] == ["", "coulomb_friction", "constant_torque"]
    found = both.rungs[-1].file
    for key in (*SIZES, "R_a0", "J", "b"):
        sd = last.knowledge[key].sd
        assert sd is not None
        assert found.values()[key] == pytest.approx(last.values()[key], abs=0.7 * sd)
        assert found.knowledge[key].sd == pytest.approx(sd, rel=0.1)


@pytest.mark.long
@pytest.mark.fit
def test_of_several_that_which_explains_nothing_is_named(rough, recording):
    found = add(rough, ["coulomb_friction", "constant_torque", "quadratic_drag"], [recording])
    assert not found.supported
    assert found.why.startswith("what quadratic drag explains is within chance")
    with pytest.raises(DataError, match="coulomb_friction is named twice"):
        add(rough, ["coulomb_friction", "constant_torque", "coulomb_friction"], [recording])


@pytest.mark.parametrize(
    ("judged", "said"),
    [
        (
            (38.29, 125.9),
            "is 50.0 % lower, but 228.8 % higher on recordings not fitted; written to better.toml.",
        ),
        ((8.0, 6.0), "is 50.0 % lower, and 25.0 % lower on recordings not fitted; written to better.toml."),
        ((), "is 50.0 % lower; written to better.toml."),
    ],
)
def test_what_became_of_recordings_not_fitted_is_said(judged, said):
    rungs = [
        {"held_out": {"speed": error}, "judged": {"speed": judged[k]} if judged else {}}
        for k, error in enumerate((2.0, 1.0))
    ]
    document = {
        "effect": "stribeck_friction",
        "supported": True,
        "ladder": rungs,
        "new": 1,
        "written": "better.toml",
    }
    assert sentence(document).endswith(said)
