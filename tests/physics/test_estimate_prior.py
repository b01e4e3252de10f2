"""What is known of parameters beforehand: densities by scipy, and motors of which recordings tell little else."""

from dataclasses import dataclass

import numpy as np
import pytest
from helpers.hidden import plant
from scipy.stats import gamma, norm

from motorlens_physics.effect import Effect
from motorlens_physics.effects.coulomb_friction import CoulombFriction
from motorlens_physics.effects.stribeck_friction import StribeckFriction
from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.fit import Fit
from motorlens_physics.estimate.model import Model
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.estimate.prior import TAKEN, Prior, base_prior
from motorlens_physics.estimate.report import findings
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import Knowledge, MotorFile, Stated, voltage_commanded
from motorlens_physics.ops import tanh
from motorlens_physics.parameter import Rated, param
from motorlens_physics.recording import Recording

CENTRE, SD = 0.47, 0.12
KNOWN = Prior({"ke": CENTRE, "load": 0.0}, {"ke": SD, "load": 0.3}, {"ke": (0.02, 9.0), "load": (-1.0, 1.0)},
              frozenset({"ke"}))  # fmt: skip


@pytest.mark.parametrize("ke", [0.03, 0.2, 0.46])
def test_below_its_centre_what_cannot_be_nought_has_a_gamma_density(ke):
    shape = (CENTRE / SD) ** 2
    density = gamma(shape + 1, scale=CENTRE / shape)
    expected = 2 * (density.logpdf(CENTRE) - density.logpdf(ke))
    assert KNOWN.penalties({"ke": ke, "load": 0.0})[0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("ke", [0.48, 0.7, 4.0])
def test_above_it_and_where_either_sign_may_be_the_density_is_normal(ke):
    for key, value, density in (("ke", ke, norm(CENTRE, SD)), ("load", ke, norm(0.0, 0.3))):
        values = {"ke": CENTRE, "load": 0.0, key: value}
        expected = 2 * (density.logpdf(density.mean()) - density.logpdf(value))
        assert KNOWN.penalty(values) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("ke", [0.03, 0.2, 0.46, 0.48, 0.7])
def test_widths_and_pulls_are_those_of_the_density(ke):
    step = 1e-4 * ke
    below, here, above = (KNOWN.penalty({"ke": ke + by, "load": 0.1}) for by in (-step, 0.0, step))
    width, pull = (of({"ke": ke, "load": 0.1})[0] for of in (KNOWN.width, KNOWN.pull))
    assert 1 / width**2 == pytest.approx(0.5 * (below - 2 * here + above) / step**2, rel=1e-4)
    assert pull / width == pytest.approx(-0.5 * (above - below) / (2 * step), rel=1e-4, abs=1e-4)


@dataclass(frozen=True)
class SharpDrop(Effect):
    """A drop that has built up at a current: its width is none of the speed's."""

    V: float = param(0.0, "V", "drop", bounds=(0.0, 10.0), prior=0.01, of="voltage", null=0.0)
    i_s: float = param(0.1, "A", "width", bounds=(1e-6, 9.0), prior=0.02, of="current", role="width")

    def voltage(self, m, x, u):
        return -self.V * tanh(x.i / self.i_s)


@pytest.mark.parametrize(("noise", "shows"), [(0.01, True), (10.0, False)])
def test_a_width_ends_where_the_speed_shows_no_sharper_if_it_is_that_of_a_speed(noise, shows):
    plate = Rated(voltage_V=240.0, current_A=7.27, speed_rad_s=221.0, torque_Nm=6.455, rise_K=80.0)
    friction, drop = CoulombFriction.typical(plate), SharpDrop.typical(plate)
    file = MotorFile("plate", Motor(effects=(friction, drop)), plate)
    time, rng = np.arange(4000) * 0.01, np.random.default_rng(0)
    speed = 100 * np.sin(time) + noise * rng.standard_normal(4000)
    runs = prepare_all([Recording("a.csv", time, {"voltage": 100 * np.sin(time), "speed": speed})], file)
    bounds = base_prior(file, runs).bounds
    ends = {key: bounds[key][0] for key in ("coulomb_friction.w_s", "sharp_drop.i_s")}
    assert ends["sharp_drop.i_s"] == pytest.approx(0.1 * drop.i_s)
    assert ends["coulomb_friction.w_s"] == pytest.approx(noise if shows else 0.1 * friction.w_s, rel=0.1)


@pytest.mark.long
@pytest.mark.fit
@pytest.mark.parametrize("cogging", [0.0, 0.01, 0.015, 0.02])
def test_a_step_a_file_does_not_end_at_a_twentieth_of_the_motor_constant(cogging):
    """A geared motor with friction that its file lacks, five steps from rest; speed comes late and in whole degrees.

    A motor that brakes itself by b in the place of its EMF settles as fast, and what is left passes for a torque. With a
    cogging of 0.015 N m a fit is led there, and back only from where ke and b are as the file has them; with 0.02 N m its
    steps have to be shortened, not turned.
    """
    true = {"R": 6.7, "L": 0.005, "ke": 0.6, "J": 0.0035, "b": 2e-4, "alpha": 0.0039, "k0": 0.05, "H": 20.0}
    plate = Rated(voltage_V=9.0, current_A=0.4, speed_rad_s=17.0, torque_Nm=0.17, rise_K=60.0, ambient_C=22.0)
    rough = Motor(
        R_a0=6.7, L=0.005, ke=0.468, J=0.0015, b=7e-4, alpha=0.0039, k0=0.05, kT=0.0, k_ir=0.0, H=20.0
    )
    stated = {"R_a0": 0.7, "L": 0.002, "ke": 0.06}
    knowledge = {key: Knowledge(sd, "data sheet") for key, sd in stated.items()}
    file = voltage_commanded(MotorFile("geared", rough, plate, knowledge=knowledge))
    recordings = []
    for volts in (-3.95, -3.16, -2.37, -1.58, -0.79):
        inputs = np.zeros((4800, plant.INPUTS))
        inputs[:, plant.VOLTAGE], inputs[:, plant.FLUX] = volts, 1.0
        p = plant.vector(**true, tau_c=0.022, cog=cogging, cog_N=12.0)
        w = plant.simulate(0.0006, inputs, plant.rest(), p)[:, plant.W]
        late = np.convolve(np.r_[np.zeros(66), w], np.full(66, 1 / 66), "valid")[: len(w) : 10]
        speed = np.radians(np.round(np.degrees(late)))
        time = 0.006 * np.arange(len(speed))
        recordings.append(
            Recording(f"{volts} V", time, {"voltage": np.full(len(time), volts), "speed": speed})
        )
    found = estimate(file, prepare_all(recordings, file))
    assert found.converged
    ke = found.fit.model.values()["ke"]
    # Friction makes it look larger than it is, by a tenth.
    assert 0.9 * true["ke"] < ke < 1.2 * true["ke"]
    left = [float(np.sqrt(np.mean(residual**2))) for residual in found.fit.residuals]
    assert max(left) < 0.5, "left to itself the other motor is 5 rad/s off"


@pytest.mark.parametrize(("deviations", "told"), [(4.0, False), (6.0, True)])
def test_what_has_gone_far_is_not_put_back_though_hardly_better_known(deviations: float, told: bool) -> None:
    """Recordings that move a parameter by six deviations say something of it, however much they leave open."""
    centre, sd = 0.00154, 0.0002
    plate = Rated(voltage_V=240.0, current_A=7.27, speed_rad_s=221.0, torque_Nm=6.455, rise_K=80.0)
    file = MotorFile("plate", Motor(b=centre + deviations * sd), plate)
    prior = Prior({"b": centre}, {"b": sd}, {"b": (0.0, 1.0)})
    said = findings(Fit(Model(file, (), ()), prior, np.array([[(0.97 * sd) ** 2]]), ()))
    assert ("b" in said.told) == told and ("b" in said.far) == told
    assert said.value["b"] == pytest.approx(centre + told * deviations * sd)


@pytest.mark.parametrize(
    ("known", "far"),
    [
        (Knowledge(), False),
        (Knowledge(2.0, "fitted to a.csv", prior=Stated(5.0, 5.0, TAKEN)), False),
        (Knowledge(5.0, "measured by hand"), True),
        (Knowledge(2.0, "fitted to a.csv", prior=Stated(5.0, 5.0, "measured by hand")), True),
    ],
)
def test_nothing_is_far_from_a_file_that_says_nothing_of_it(known: Knowledge, far: bool) -> None:
    """Of the shape of an effect something is taken where nothing is stated: no sentence says that a file is wrong there."""
    key = "stribeck_friction.w_k"
    plate = Rated(voltage_V=24.0, current_A=2.0, speed_rad_s=200.0, torque_Nm=0.1)
    motor = Motor(effects=(StribeckFriction(tau_s=0.01, w_k=50.0),))
    file = MotorFile("plate", motor, plate, knowledge={key: known})
    prior = Prior({key: 5.0}, {key: 5.0}, {key: (0.01, 500.0)})
    said = findings(Fit(Model(file, (), ()), prior, np.array([[0.1**2]]), ()))
    assert (key in said.far) == far
    assert said.told == (key,) and said.value[key] == 50.0
