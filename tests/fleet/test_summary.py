"""What one recording claims: no more than it knows where its errors do not tell how noisy its inputs are."""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.plain_fleet import TYPICAL, WANDERS, World, simulated, write
from helpers.plain_motor import AMBIENT_C, RATED

from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.noise import LOAD
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import read_recording
from motorlens_workbench.fleet import summary

pytestmark = pytest.mark.fit
SEED = 3


def score(parabola, truth):
    """By how many of its own deviations the slope in b is off where the parameters are the true ones."""
    off = np.array([truth[key] for key in parabola.keys]) - parabola.at
    k = parabola.keys.index("b")
    return float((parabola.gradient - parabola.information @ off)[k] / np.sqrt(parabola.information[k, k]))


def test_noise_of_the_load_that_the_errors_do_not_tell_counts(tmp_path):
    """Scores at the truth scatter by one, as Fisher's information says."""
    world, file = World(6, 1, poor=1), read_motor_file("mellah2016")
    told = []
    for m in range(6):
        path = tmp_path / f"{m}.csv"
        write(world.recorded(m, 0, SEED), path)
        truth, rng = world.motor(m, SEED), np.random.default_rng([SEED, m, 0])
        for key, sd in WANDERS.items():
            truth[key] *= float(np.exp(sd * rng.standard_normal()))
        found = estimate(file, prepare_all([read_recording(path)], file))
        told.append(score(summary.parabola(found), truth))
    # Of six, one in fifty is beyond by chance.
    assert 0.38 < np.sqrt(np.mean(np.square(told))) < 1.67


def test_a_load_that_truly_shakes_is_no_noise(tmp_path):
    rng, n, period_s = np.random.default_rng(2), 800, 5e-3
    voltage = np.repeat(rng.uniform(-1, 1, 8) * RATED["voltage"], 100)
    shakes = 0.2 * RATED["load_torque"]
    load = 0.3 * RATED["load_torque"] + shakes * rng.standard_normal(n)
    states = simulated({**TYPICAL, "V_b": 0.0, "tau_c": 0.0}, voltage, load, period_s)
    columns = {
        "time": np.arange(n) * period_s, "voltage": voltage, "load_torque": load,
        "current": states[:, 0] + 0.002 * RATED["current"] * rng.standard_normal(n),
        "speed": states[:, 1] + 1e-4 * RATED["speed"] * rng.standard_normal(n),
        "ambient": np.full(n, AMBIENT_C),
    }  # fmt: skip
    write(columns, tmp_path / "a.csv")
    file = read_motor_file("mellah2016")
    found = estimate(file, prepare_all([read_recording(tmp_path / "a.csv")], file))
    (part,) = summary._point(found.fit.model, found, found.fit.prior.keys).parts
    assert part.noise.disturbances[LOAD] < 0.05 * shakes**2


def test_what_a_speed_shows_is_known_where_an_estimate_goes_on(tmp_path):
    path, file = tmp_path / "a.csv", read_motor_file("mellah2016")
    write(World(1, 1).recorded(0, 0, SEED), path)
    runs = prepare_all([read_recording(path)], file)
    found = estimate(file, runs)
    for mean in (False, True):
        end = summary.ended(replace(found, runs=(found.runs[0].showing(mean),)))
        _, (run,) = summary.where_it_ended(end, file, runs, found.fit.prior)
        assert run.mean_speed == mean
    # A file of before says nothing of it.
    del end["mean_speed"]
    _, (run,) = summary.where_it_ended(end, file, runs, found.fit.prior)
    assert not run.mean_speed


def test_uneven_noise_is_known_where_an_estimate_goes_on(tmp_path):
    path, file = tmp_path / "a.csv", read_motor_file("mellah2016")
    write(World(1, 1).recorded(0, 0, SEED), path)
    runs = prepare_all([read_recording(path)], file)
    found = estimate(file, runs)
    noise = found.runs[0].noise.uneven(found.runs[0])
    assert len(noise.edges_V) > 2
    noise = replace(noise, sensors=noise.sensors * np.linspace(1, 4, noise.sensors.shape[1]))
    run = replace(found.runs[0], noise=noise)
    end = json.loads(json.dumps(summary.ended(replace(found, runs=(run,)))))
    _, (again,) = summary.where_it_ended(end, file, runs, found.fit.prior)
    np.testing.assert_allclose(again.noise.of_samples(run), noise.of_samples(run), rtol=1e-12)
    # A file of before has one variance of each channel.
    even = {name: told for name, told in end["noise"].items() if name not in ("sensors", "edges_V")}
    end["noise"] = {**even, "channels": [2.0] * len(run.channels)}
    _, (again,) = summary.where_it_ended(end, file, runs, found.fit.prior)
    assert np.all(again.noise.of_samples(run) == 2.0)
