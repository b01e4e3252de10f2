"""A sensor for motors of a make: how much they differ is what the fleet found, and what the motor file states less of."""

import numpy as np
import pytest

from motorlens_physics.make import of_make
from motorlens_physics.motor_file import Knowledge, read_motor_file
from motorlens_runtime.cli import main
from motorlens_train.material import evenly, of_the_make, spread_of, tolerant
from motorlens_train.observer.design import ObserverSettings

FILE = read_motor_file("mellah2016")
MAKE = FILE.with_values(
    {"R_a0": 3.8, "ke": 0.9, "H": 17e3},
    {"R_a0": Knowledge(0.19, "fleet"), "ke": Knowledge(0.018, "fleet"), "H": Knowledge(850.0, "fleet")},
)


def test_motors_differ_as_the_fleet_says():
    spread = spread_of(of_make(FILE, MAKE))
    assert {key: round(spread[key], 6) for key in ("R_a0", "ke", "H")} == {
        "R_a0": 0.05,
        "ke": 0.02,
        "H": 0.05,
    }
    rng = np.random.default_rng(1)
    drawn = [of_the_make(MAKE, spread, rng).values() for _ in range(2000)]
    for key, sd in (("R_a0", 0.05), ("ke", 0.02), ("H", 0.05)):
        logarithms = np.log([one[key] / MAKE.values()[key] for one in drawn])
        # Of 2000: a mean within 4 of its deviations, a spread within 7 %.
        assert abs(logarithms.mean()) < 4 * sd / 2000**0.5
        assert np.std(logarithms) == pytest.approx(sd, rel=0.07)
    # What nobody states does not differ, alpha is copper's.
    assert {one["alpha"] for one in drawn} == {MAKE.motor.alpha}


def test_an_observer_is_as_unsure_as_motors_differ():
    settings = tolerant(ObserverSettings(), {"R_a0": 0.05, "ke": 0.02, "H": 0.06})
    assert settings.tolerances == (("R_a0", 0.05), ("ke", 0.02))
    # The same walk as an even tolerance has where H alone differs by as much in the mean of the three.
    assert settings.thermal_walk == pytest.approx(0.1 * 3**0.5 * 0.06 / 3**0.5)
    assert tolerant(ObserverSettings(), evenly(0.1)).thermal_walk == pytest.approx(0.01)
    assert tolerant(ObserverSettings(), {}) == ObserverSettings()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--recordings", "a.csv"], "--make says more of a motor file"),
        (["--motor", "mellah2016", "--tolerance", "10"], "leave out --tolerance"),
    ],
)
def test_bad_usage_is_one_line(words, said, capsys, tmp_path):
    assert main(["train", *words, "--make", "mellah2016", "-o", str(tmp_path / "a.onnx")]) == 1
    err = capsys.readouterr().err
    assert said in err and len(err.splitlines()) == 1
