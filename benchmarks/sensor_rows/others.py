"""Rows on simulated motors that differ from the file the sensor was made of: tolerance, and missing physics."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
from sensor_rows.common import (
    MELLAH,
    WATCHING,
    WHITE,
    Observing,
    Size,
    better,
    duty,
    filters,
    goal,
    show,
    trained,
)

from motorlens_physics.motor_file import MotorFile, with_overrides
from motorlens_physics.recording import Recording
from motorlens_train.baselines import ExtendedKalman, Method
from motorlens_train.baselines.calibration import calibrated
from motorlens_train.baselines.method import UNITS
from motorlens_train.duty_cycles import duty_cycle
from motorlens_train.evaluation.scores import Evaluation, evaluate
from motorlens_train.material import evenly, relative, tolerant
from motorlens_train.observer.design import with_observer

CASES = {
    "magnet": ("magnets, -0.2 %/K", {"magnet_temperature.beta": 0.002}),
    "brush": ("brushes, 1.5 V", {"brush_voltage_drop.V_b": 1.5}),
    "node": (
        "a second thermal node",
        {"two_node_thermal.G_h": 8.0, "two_node_thermal.G_a": 3.0, "two_node_thermal.C_h": 9000.0},
    ),
}


def tolerance(size: Size, quick: bool) -> None:
    """Motors that differ by up to 10 % in R, ke, J and the thermal parameters from the file the sensor was made of."""

    def another(seed: int, k: int) -> MotorFile:
        return relative(MELLAH, 0.1, np.random.default_rng([seed, k]))

    bank = with_observer(filters(MELLAH), MELLAH, tolerant(WATCHING, evenly(0.1)))
    cycles = [
        duty_cycle(another(61, k), WHITE, 200.0, 600.0, np.random.default_rng([62, k]), k % 2 == 1)
        for k in range(size.training)
    ]
    methods: Mapping[str, Method] = {
        "hybrid": trained(bank, cycles, size, (6,)), "observer alone": Observing(bank, MELLAH),
        "EKF, nominal": ExtendedKalman(refit=False).fit(cycles[:2], MELLAH),
    }  # fmt: skip
    tests = [duty(another(63, k), replace(size, testing=1), 64 + k)[0] for k in range(size.testing)]
    found = evaluate(methods, tests, MELLAH)
    show("motors with a tolerance of 10 %", found)
    better("below the EKF with nominal parameters", found, "hybrid", "EKF, nominal")


def missing(case: str, size: Size, quick: bool) -> None:
    """A true motor with an effect that its file lacks; sensor and EKF are given the same half hour on the bench."""
    title, effect = CASES[case]
    true = with_overrides(MELLAH, effect)
    bench, tests = on_the_bench(true, quick)
    wrong = calibrated(MELLAH, bench)
    blind = with_observer(filters(wrong), wrong, replace(WATCHING, thermal_walk=0.02))
    told = with_observer(filters(true), true, WATCHING)
    methods: Mapping[str, Method] = {
        "hybrid, without effect": trained(blind, bench, size, (4,), rows=5000),
        "hybrid, effect added": trained(told, bench, size, (4,), rows=5000),
        "observer, without effect": Observing(blind, wrong),
        "EKF, fitted": ExtendedKalman().fit(bench, MELLAH),
    }
    found = evaluate(methods, tests, true)
    show(f"{title}: 30 min of bench recordings", found)
    better(
        "without the effect, half of the fitted EKF's", found, "hybrid, without effect", "EKF, fitted", 0.5
    )
    better(
        "with the effect, half of that without", found, "hybrid, effect added", "hybrid, without effect", 0.5
    )
    for output, score in exact_motor(size, quick).scores["exact"].items():
        ours = found.scores["hybrid, effect added"][output].rms
        goal(f"with the effect, over the exact motor's, {output} ({UNITS[output]})", ours, 1.3 * score.rms)
        if found.scores["hybrid, without effect"][output].rms <= 1.3 * score.rms:
            print(
                f"  {output}: within 1.3 of the exact motor's without the effect; there is nothing to halve"
            )


def on_the_bench(true: MotorFile, quick: bool) -> tuple[list[Recording], list[Recording]]:
    """Half an hour to train on, and half hours to test on: what is missing shows once the motor is warm."""
    bench = duty(true, Size(0, 1, 1800.0, 0), 71, ambient_start=True)
    tests = duty(true, Size(0, 2 if quick else 4, 1800.0, 0), 72, 100.0, ambient_start=True)
    return bench, tests


@cache
def exact_motor(size: Size, quick: bool) -> Evaluation:
    """A motor of which the file lacks nothing, its sensor trained on as much."""
    bench, tests = on_the_bench(MELLAH, quick)
    bank = with_observer(filters(MELLAH), MELLAH, WATCHING)
    found = evaluate({"exact": trained(bank, bench, size, (4,), rows=5000)}, tests, MELLAH)
    show("nothing is missing: 30 min of bench recordings", found)
    return found


def magnet(size: Size, quick: bool) -> None:
    """Magnets that weaken as they warm."""
    missing("magnet", size, quick)


def brush(size: Size, quick: bool) -> None:
    """A voltage drop at the brushes."""
    missing("brush", size, quick)


def node(size: Size, quick: bool) -> None:
    """A housing behind the winding."""
    missing("node", size, quick)
