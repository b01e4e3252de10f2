"""Models with the same effects are compared with a torque that nobody measured lasting as long as each has found."""

from dataclasses import replace

import pytest
from helpers.plain_motor import RATED
from helpers.short_torque import recorded

from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.run import prepare_all
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.parameter import Rated
from motorlens_workbench.diagnose import fitted_of
from motorlens_workbench.fitted import Fitted
from motorlens_workbench.standing import stand, unlikely_as_lasting, unlikely_from

PLATE = Rated(
    voltage_V=RATED["voltage"], current_A=RATED["current"], speed_rad_s=RATED["speed"],
    torque_Nm=RATED["load_torque"], rise_K=RATED["temperature"],
)  # fmt: skip


def _lasting(fitted: Fitted, samples: float) -> Fitted:
    """The same model with a torque that lasts otherwise."""
    runs = (
        replace(run, noise=run.noise.lasting(samples * run.period_s) if run.noise else None)
        for run in fitted.runs
    )
    return replace(fitted, runs=tuple(runs))


@pytest.mark.fit
def test_the_model_that_knows_how_long_a_torque_lasts_is_likelier_whichever_of_them_stands() -> None:
    file = MotorFile("plate", Motor(), PLATE)
    right = fitted_of(estimate(file, prepare_all([recorded(loaded=True)], file)))
    wrong = _lasting(right, 3000.0)
    for one in (right, wrong):
        here = stand(one)
        assert unlikely_as_lasting(here, wrong) - unlikely_as_lasting(here, right) > 100.0
        # Otherwise it lasts as in the model that stands.
        assert unlikely_from(here, wrong) == pytest.approx(unlikely_from(here, right), abs=1e-6)
        assert unlikely_as_lasting(here, one) == pytest.approx(unlikely_from(here, one), abs=1e-6)
