"""From recordings to the make: what all of them show goes into the motor file; a fault of the sensors is no part of it.

The parabolas are drawn, not fitted: every true value is known, and no recording is simulated.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorlens_physics.motor_file import read_motor_file, to_toml
from motorlens_physics.queue import Done
from motorlens_workbench.fleet.manifest import Entry
from motorlens_workbench.fleet.store import Store
from motorlens_workbench.fleet.study import study
from motorlens_workbench.fleet.summary import Parabola, switch_of, with_candidates
from motorlens_workbench.fleet.work import Job
from motorlens_workbench.report.fleet import to_text

KEYS = ("R_a0", "ke", "b", "coulomb_friction.tau_c", switch_of("speed_sensor_gain"))
MAKE, SPREAD = np.array([3.8, 0.9, 0.0017]), np.array([0.06, 0.03, 0.15])
# Standard deviations of one recording: relative, then of friction and of the gain.
OWN = np.array([0.01, 0.002, 0.1, 0.02, 0.004])
MOTORS, EACH, DRAGS = 24, 3, 11


def recorded(folder: Path, gains: np.ndarray) -> tuple[list[Entry], dict[str, Parabola], float]:
    """Recordings of motors of one make, each by a tachometer with a gain, and their mean ke; one of the motors drags."""
    rng, null = np.random.default_rng(4), np.array([*MAKE, 0.0, 1.0])
    width = OWN * np.array([*MAKE, 1.0, 1.0])
    # A tachometer that shows too much and a small ke are alike, but for what the start shows.
    correlation = np.eye(len(KEYS))
    correlation[1, 4] = correlation[4, 1] = 0.8
    covariance = correlation * np.outer(width, width)
    information, root = np.linalg.inv(covariance), np.linalg.cholesky(covariance)
    entries, parabolas, ke = [], {}, []
    for m in range(MOTORS):
        truth = np.array(
            [*MAKE * np.exp(SPREAD * rng.standard_normal(3)), 0.3 if m == DRAGS else 0.0, gains[m]]
        )
        ke.append(truth[1])
        for r in range(EACH):
            path = folder / f"m{m:02d}-{r}.csv"
            path.write_text(path.name, encoding="ascii")  # what is read of it: results are kept by content
            top = truth + root @ rng.standard_normal(len(KEYS))
            parabolas[path.name] = Parabola(KEYS, null, information @ (top - null), information)
            entries.append(Entry(f"m{m:02d}", path, path.name))
    return entries, parabolas, float(np.mean(ke))


def studied(folder: Path, gain: float, spread: float = 0.0, away: float = 0.0):
    """The study; of the beginnings of recordings too, which lead `away` from ke, if they lead anywhere."""
    half = np.random.default_rng(0).standard_normal(MOTORS // 2)
    gains = gain + spread * np.concatenate([half, -half])
    entries, parabolas, ke = recorded(folder, gains)

    def work(jobs):
        rng = np.random.default_rng(6)
        for number, job in enumerate(jobs):
            told = parabolas[job.paths[0].name]
            if getattr(job, "seconds", None) is not None:
                led = away * MAKE[1] * rng.standard_normal() * (np.array(KEYS) == "ke")
                told = replace(told, gradient=told.gradient + told.information @ led)
            yield Done(number, {"parabola": told.as_json()})

    template = Job(entries[0].path, read_motor_file("mellah2016"))
    brief_s = 0.1 if away else None
    found = study(entries, template, Store(folder / "results"), work, brief_s=brief_s)
    return found, template.file, ke


@pytest.mark.fit
def test_a_fault_of_the_sensors_of_all_is_fitted_along_and_the_make_says_how_far_sensors_may_be_off(tmp_path):
    fleet, file, ke = studied(tmp_path, 1.03)
    assert [fault.name for fault in fleet.faults] == ["speed_sensor_gain"] and fleet.effects == ()
    assert fleet.faults[0].of_sensor and fleet.faults[0].share > 0.9
    # It is in the file that the motors are fitted with, and told to what all recordings together say ...
    assert {sensor.name() for sensor in fleet.population.file.sensors} == {"speed_sensor_gain"}
    mean, sd = fleet.population.mean()
    at = fleet.population.keys.index(KEYS[4])
    assert abs(mean[at] - 1.03) < 3 * sd[at] and sd[at] < 0.002
    # ... and ke is that of the motors: beside a gain of one it would be 1.2 % less (0.8 x 0.2 % / 0.4 % x 3 %).
    assert mean[fleet.population.keys.index("ke")] == pytest.approx(ke, rel=0.002)
    # A new motor is measured by other sensors, which are right for all that is known; or off as far, either way.
    assert file.sensors == () and [sensor.gain for sensor in fleet.make.sensors] == [1.0]
    assert fleet.make.knowledge[KEYS[4]].sd == pytest.approx(0.03, abs=0.003)
    assert fleet.brief is None and "brief" not in to_toml(fleet.make)
    assert fleet.make.motor.R_a0 == pytest.approx(mean[fleet.population.keys.index("R_a0")])
    # Nobody is odd for what all show; the one that drags is.
    assert [fleet.population.motors[m] for m in fleet.odd] == [f"m{DRAGS:02d}"]


@pytest.mark.fit
def test_a_fault_that_is_another_one_in_each_motor_is_part_of_the_make(tmp_path):
    """On-board sensors: their gains are 1 in the mean, so that neither half of the motors outvotes the other."""
    fleet, _, ke = studied(tmp_path, 1.0, 0.03)
    assert [fault.name for fault in fleet.faults] == ["speed_sensor_gain"] and fleet.effects == ()
    (sensor,), knowledge = fleet.make.sensors, fleet.make.knowledge[KEYS[4]]
    # 24 draws: the mean is known to 0.03 / sqrt(24), the spread to 15 %.
    assert abs(sensor.gain - 1.0) < 3 * 0.03 / np.sqrt(MOTORS)
    assert 0.03 * 0.6 < knowledge.sd < 0.03 * 1.5
    mean, _ = fleet.population.mean()
    assert mean[fleet.population.keys.index("ke")] == pytest.approx(ke, rel=0.002)
    assert [fleet.population.motors[m] for m in fleet.odd] == [f"m{DRAGS:02d}"]


@pytest.mark.fit
def test_sound_sensors_are_not_blamed(tmp_path):
    fleet, file, _ = studied(tmp_path, 1.0)
    assert fleet.faults == () and fleet.effects == ()
    assert fleet.population.file == with_candidates(file, ())
    assert [fleet.population.motors[m] for m in fleet.odd] == [f"m{DRAGS:02d}"]


@pytest.mark.fit
def test_by_how_much_brief_recordings_lead_away_comes_with_the_make(tmp_path):
    fleet, _, _ = studied(tmp_path, 1.0, away=0.05)
    make = fleet.make
    assert fleet.brief.seconds == make.brief_s == 0.1
    # 72 beginnings: one in sqrt(144), and what is not known of each motor.
    assert make.knowledge["ke"].brief_sd == pytest.approx(0.05 * MAKE[1], rel=3 / np.sqrt(144))
    # The others lead nowhere: less than a third of what one recording tells of them.
    assert make.knowledge["R_a0"].brief_sd < 0.01 * MAKE[0] / 3
    # It changes nothing of what is known of the make.
    assert make.knowledge["ke"].sd < 2 * SPREAD[1] * MAKE[1]
    assert any(line.startswith("The first 0.1 s of a recording alone lead away") for line in to_text(fleet))
