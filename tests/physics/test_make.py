"""A make's file beside that of one of its motors."""

from dataclasses import replace

from motorlens_physics.make import of_make
from motorlens_physics.motor_file import Knowledge, read_motor_file, with_overrides


def test_what_the_make_knows_better_is_taken_from_it():
    file = read_motor_file("mellah2016")
    file = replace(
        file, knowledge={**file.knowledge, "L": Knowledge(0.0, "measured"), "J": Knowledge(1e-4, "measured")}
    )
    make = with_overrides(file, {"R_a0": 3.7, "L": 0.03, "J": 0.04, "coulomb_friction.tau_c": 0.2})
    told = {"R_a0": 0.05, "L": 0.001, "J": 0.001, "coulomb_friction.tau_c": 0.03}
    make = replace(
        make, knowledge={**file.knowledge, **{k: Knowledge(sd, "population") for k, sd in told.items()}}
    )
    found = of_make(file, make)
    assert found.values()["R_a0"] == 3.7
    assert found.knowledge["R_a0"] == Knowledge(0.05, "population")
    # What the motor's own file knows exactly, or better, stays.
    assert (found.motor.L, found.motor.J) == (file.motor.L, file.motor.J)
    assert found.knowledge["L"].sd == 0
    assert found.values()["coulomb_friction.tau_c"] == 0.2
    assert found.knowledge["coulomb_friction.tau_c"].sd == 0.03
    assert found.knowledge["k0"] == file.knowledge["k0"]
