"""What goes with the shaft angle must be seen while the shaft turns, not at rest."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.textbook import textbook_on, with_name

from motorlens_physics.effect import catalogue
from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.forcing import forcing
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.estimate.report import findings
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import Recording
from motorlens_physics.simulation import Inputs, simulate
from motorlens_workbench.diagnose import fitted_of
from motorlens_workbench.hypotheses.effects import EffectShape
from motorlens_workbench.hypotheses.line import Line
from motorlens_workbench.standing import stand

MOTOR = Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml"
TIME = np.arange(10_000) * 0.002
# Two stops of 4 s.
RUNS = (TIME % 10.0) < 6.0


def recording(unbalance_Nm: float, at_stops_Nm: float) -> Recording:
    """20 s at 500 Hz with two stops, a torque of its own sign at each of them, which nobody measured."""
    file = read_motor_file(MOTOR)
    rng = np.random.default_rng(3)
    voltage = np.where(RUNS, np.repeat(rng.uniform(25.0, 50.0, 20), 500), 0.0)
    load = np.where(
        RUNS, 0.0, at_stops_Nm * np.where(TIME < 10.0, 1.0, -1.0) * np.sin(np.pi * (TIME % 10.0 - 6.0) / 4.0)
    )
    ambient = np.full(len(TIME), 20.0)
    motor = file.motor
    if unbalance_Nm:
        motor = motor.with_effect(
            replace(catalogue()["unbalance_torque"].typical(file.rated), A=unbalance_Nm)
        )
    true = simulate(motor, Inputs(TIME, voltage, load, ambient, held=True))
    return Recording(
        "stops", TIME,
        {"voltage": voltage, "load_torque": np.zeros(len(TIME)),
         "current": true.current_A + 0.02 * rng.standard_normal(len(TIME)),
         "speed": true.speed_rad_s + 0.05 * rng.standard_normal(len(TIME))},
    )  # fmt: skip


@pytest.mark.fit
@pytest.mark.parametrize(("unbalance_Nm", "at_stops_Nm"), [(0.05, 0.0), (0.0, 0.05)])
def test_torques_at_rest_do_not_pass_for_what_goes_with_the_angle(unbalance_Nm, at_stops_Nm):
    file = read_motor_file(MOTOR)
    here = stand(fitted_of(estimate(file, prepare_all([recording(unbalance_Nm, at_stops_Nm)], file))))
    assert here.null is not None
    seen = here.look.best().get("unbalance_torque")
    # Only one is seen while the shaft turns.
    if unbalance_Nm:
        assert seen is not None and here.null.excess(seen.weight) > 200
    else:
        assert seen is None or here.null.excess(seen.weight) < 5


@pytest.mark.fit
def test_what_goes_with_the_angle_shows_nothing_at_rest():
    """The column of an effect of the angle along a run that stands half of the time, beside its forcing in full."""
    file = read_motor_file(MOTOR)
    effect = replace(catalogue()["unbalance_torque"].typical(file.rated), A=0.2)
    base = estimate(file, prepare_all([recording(0.05, 0.0)], file))
    line = Line.of(base.fit.model, base.runs[0], 0, ())
    masked = EffectShape((effect,), (0.0, np.inf)).columns(line)[:, :, 0]
    whole = line.of_forcing(forcing(effect, line.trajectory))[:, :, 0]
    # Once the last turn before a stop has died out, nothing is left of it there; before, it is all there.
    still = (TIME % 10.0) > 9.0
    assert np.abs(masked[still]).max() < 0.02 * np.abs(whole[~still]).max()
    assert np.abs(whole[still]).max() > 0.2 * np.abs(whole[~still]).max()


@pytest.mark.fit
@pytest.mark.parametrize("phase", [3.13, pytest.param(-3.13, marks=pytest.mark.long)])
def test_a_phase_has_no_end(tmp_path: Path, phase: float) -> None:
    """Of a cogging torque of which a fit goes past half a turn from where its shape begins."""
    hidden = {"name": "cogging_torque", "size": 0.0006, "shape": {"cog_N": 12.0, "cog_p": phase}}
    _, fitted = with_name(textbook_on(tmp_path, "gear_12V", [hidden], "slow_ramp", 10.0), "cogging_torque")
    told, sd = fitted.model.values()["cogging_torque.p"], fitted.fit.sd()["cogging_torque.p"]
    assert told > np.pi and sd < 0.05
    assert abs(np.angle(np.exp(1j * (told - phase)))) < 3 * sd
    assert "cogging_torque.p" not in findings(fitted.fit).at_bound
