"""The virtual sensor against other methods and the bound: unseen duty cycles, hot restarts, tolerance, missing physics.

`--quick` trains on little and shows a part, in under two minutes. Errors count from one second after the first voltage step.
Every start temperature is unknown to every method. The bound's genie is told when and by how much the load jumps; no
estimator knows that.
"""

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from motorlens_physics.calibration import calibrate
from motorlens_physics.motor_file import MotorFile, read_motor_file, with_overrides
from motorlens_physics.recording import Recording, read_recording
from motorlens_physics.scenario import chosen_scenario, measure, perform, time_constants
from motorlens_physics.simulation import Inputs, simulate
from motorlens_train.baselines import (
    ExtendedKalman,
    Method,
    Perceptron,
    SteadyStateVoltage,
    ThermalObserver,
    TwoStepKalman,
)
from motorlens_train.baselines.calibration import calibrated
from motorlens_train.baselines.extended_kalman import noise_of
from motorlens_train.baselines.method import OUTPUTS, Estimate, inputs, truth
from motorlens_train.bound import Noise
from motorlens_train.build import Recipe, build
from motorlens_train.data import cycle
from motorlens_train.duty_cycles import Noise as White
from motorlens_train.duty_cycles import duty_cycle, instants
from motorlens_train.evaluation import Evaluation, evaluate, text_table
from motorlens_train.features import feature_rows, motor_bank
from motorlens_train.observer import ObserverSettings, with_observer
from motorlens_train.sensor import Sensor
from motorlens_train.specification import Bank, Rate
from motorlens_train.trainer import Settings

ROOT = Path(__file__).resolve().parents[1]
MELLAH = read_motor_file(ROOT / "models" / "motors" / "mellah2016.toml")
RECORDINGS = ROOT.parent / "shared" / "recordings"
WHITE = White(0.5, 0.05)
MEASURED = {"voltage": WHITE.voltage_V, "current": WHITE.current_A}
BOUND = Noise(WHITE.voltage_V, WHITE.current_A, 0.02)


@dataclass(frozen=True)
class Size:
    """How much is simulated: cycles to train on, cycles to test on, seconds of each, iterations."""

    training: int
    testing: int
    seconds: float
    iterations: int


@dataclass(frozen=True)
class Network:
    """A trained sensor, before it is a file, as a method among others."""

    sensor: Sensor

    def fit(self, recordings: Sequence[Recording], motor_file: MotorFile) -> "Network":
        return self

    def estimate(self, recording: Recording) -> Estimate:
        moment, v, i = inputs(recording)
        values, sds = (np.full((len(v), 3), np.nan) for _ in range(2))
        columns = [OUTPUTS.index(output.name) for output in self.sensor.specification.outputs]
        values[:, columns], sds[:, columns] = self.sensor.evaluate(
            feature_rows(self.sensor.bank, moment, v, i)
        )
        return Estimate.of(values, sds)


@dataclass(frozen=True)
class Observing:
    """The observer of a sensor without its network."""

    bank: Bank
    motor_file: MotorFile

    def fit(self, recordings: Sequence[Recording], motor_file: MotorFile) -> "Observing":
        return self

    def estimate(self, recording: Recording) -> Estimate:
        moment, v, i = inputs(recording)
        observer = self.bank.observer
        assert observer is not None
        dt = np.diff(moment, prepend=moment[0] - recording.period_s)
        found, _ = observer.run(dt, v, i, np.full(len(v), observer.ambient_C))
        seen = dict(zip(observer.outputs, found.T, strict=True))
        return Estimate.of(
            np.column_stack([seen[name] for name in OUTPUTS]),
            np.exp(0.5 * np.column_stack([seen[f"log_{name}"] for name in OUTPUTS])),
        )


def filters(file: MotorFile) -> Bank:
    m, pace = file.motor, time_constants(file.motor)
    return motor_bank(m.R_a0, m.L, pace.electrical_s, pace.mechanical_s, pace.thermal_s)


def trained(
    bank: Bank,
    cycles: Sequence[Recording],
    size: Size,
    hidden: tuple[int, ...],
    skips: bool = True,
    rows: int = 500,
) -> Network:
    """A sensor of this bank: three quarters of the cycles to train on, one to calibrate."""
    seen = [
        cycle(r, bank, OUTPUTS, instants(r, rows, WHITE, np.random.default_rng([3, k])))
        for k, r in enumerate(cycles)
    ]
    rate = Rate(1 / float(np.median([r.period_s for r in cycles])), 50.0, 10000.0)
    settings = Settings(iterations=size.iterations, time_series=bank.observer is not None)
    recipe = Recipe("benchmark", bank, OUTPUTS, hidden, rate, 1.0, 0, settings, skips=skips)
    quarter = max(1, len(seen) // 4)
    return Network(build(recipe, seen[quarter:], seen[:quarter], []).sensor)


def material(file: MotorFile, size: Size, seed: int) -> list[Recording]:
    """Cycles to train on: at 1000, 500 and 200 Hz, every second one with an unknown history."""
    return [
        duty_cycle(
            file, WHITE, 1000.0 / (1, 2, 5)[k % 3], 600.0, np.random.default_rng([seed, k]), k % 2 == 1
        )
        for k in range(size.training)
    ]


def duty(
    file: MotorFile, size: Size, seed: int, rate_Hz: float = 200.0, ambient_start: bool = False
) -> list[Recording]:
    """Duty cycles as `motorlens simulate --scenario duty` makes them, measured; none of them was trained on."""
    made: list[Recording] = []
    for k in range(1000):
        rng = np.random.default_rng([seed, k])
        run = perform(file, chosen_scenario("duty", size.seconds, rate_Hz), rng)
        if not ambient_start or truth(run, file)[0, 1] < 0.5:
            made.append(measure(run, (), MEASURED, rng))
        if len(made) == size.testing:
            break
    return made


def show(title: str, evaluation: Evaluation) -> None:
    print(f"\n## {title}\n{text_table(evaluation)}")


def exact_motor(size: Size, quick: bool) -> Network:
    """Which network, on unseen duty cycles of the exact motor with unknown load; coverage by excitation; ladder."""
    bank = with_observer(
        filters(MELLAH), MELLAH, ObserverSettings(voltage_sd=WHITE.voltage_V, current_sd=WHITE.current_A)
    )
    cycles = material(MELLAH, size, 11)
    hybrid = trained(bank, cycles, size, (6,))
    methods: dict[str, Method] = {"hybrid": hybrid, "observer alone": Observing(bank, MELLAH)}
    methods["cascade alone"] = trained(filters(MELLAH), cycles, size, (12, 8))
    if not quick:
        methods["plain feed-forward"] = trained(filters(MELLAH), cycles, size, (12, 8), skips=False)
    bench = duty(MELLAH, replace(size, testing=3), 21)
    methods["EKF, exact parameters"] = ExtendedKalman(refit=False).fit(bench, MELLAH)
    if not quick:
        others = {
            "two-step Kalman": TwoStepKalman(), "thermal observer": ThermalObserver(), "perceptron": Perceptron(),
            "steady-state voltage": SteadyStateVoltage(),
        }  # fmt: skip
        methods |= {name: method.fit(bench, MELLAH) for name, method in others.items()}
    found = evaluate(methods, duty(MELLAH, size, 31, ambient_start=True), MELLAH, BOUND)
    show("unseen duty cycles from ambient temperature, exact motor, unknown load, 200 Hz", found)
    anything = evaluate(methods, duty(MELLAH, size, 41), MELLAH, BOUND)
    show("the same from any start temperature", anything)
    print("\ncoverage of 95 % intervals of the hybrid by thirds of the time since the last excitation:")
    for output, shares in anything.coverage_by_excitation()["hybrid"].items():
        print(f"  {output:<12}" + "".join(f"{100 * share:8.1f} %" for share in shares))
    return hybrid


def hot_restart(hybrid: Network, size: Size) -> None:
    """Error one second after the first step of at least a fifth of rated voltage, from an unknown 0 to 80 K."""
    errors = []
    for k in range(4 * size.testing):
        rng = np.random.default_rng([51, k])
        n = 1500
        time_s = np.arange(n) * 1e-3
        voltage = np.where(time_s < 0.2, 0.0, MELLAH.rated.voltage_V * rng.uniform(0.2, 1.0))
        load = np.full(n, MELLAH.rated.torque_Nm * rng.uniform(0.0, 1.0))
        run = simulate(
            MELLAH.motor,
            Inputs(time_s, voltage, load, np.full(n, 20.0), held=True),
            {"theta": rng.uniform(0, 80)},
        )
        channels = {
            "voltage": voltage + WHITE.voltage_V * rng.standard_normal(n),
            "current": run.current_A + WHITE.current_A * rng.standard_normal(n),
        }
        seen = hybrid.estimate(Recording("hot restart", time_s, channels)).temperature[1200]
        errors.append(abs(seen - run.rise_K[1200]))
    print(
        f"\n## hot restart at unknown 0-80 K, a step of 0.2 to 1 of rated voltage, 1 kHz, {len(errors)} starts\n"
        f"  error one second after the step: rms {np.sqrt(np.mean(np.square(errors))):.2f} K, "
        f"95 % below {np.quantile(errors, 0.95):.2f} K, largest {np.max(errors):.2f} K"
    )


def tolerance(size: Size) -> None:
    """Motors that differ by up to 10 % in R, ke, J and the thermal parameters from the file the sensor was made of."""
    names = ("R_a0", "ke", "J", "H", "k0", "k_ir")

    def another(rng: np.random.Generator) -> MotorFile:
        return MELLAH.with_values({name: MELLAH.values()[name] * rng.uniform(0.9, 1.1) for name in names})

    settings = ObserverSettings(
        voltage_sd=WHITE.voltage_V, current_sd=WHITE.current_A, thermal_walk=0.01,
        tolerances=(("R_a0", 0.058), ("ke", 0.058), ("J", 0.058)),
    )  # fmt: skip
    bank = with_observer(filters(MELLAH), MELLAH, settings)
    cycles = [
        duty_cycle(
            another(np.random.default_rng([61, k])),
            WHITE,
            200.0,
            600.0,
            np.random.default_rng([62, k]),
            k % 2 == 1,
        )
        for k in range(size.training)
    ]
    hybrid = trained(bank, cycles, size, (6,))
    tests = [
        duty(another(np.random.default_rng([63, k])), replace(size, testing=1), 64 + k)[0]
        for k in range(size.testing)
    ]
    methods: Mapping[str, Method] = {
        "hybrid": hybrid, "observer alone": Observing(bank, MELLAH),
        "EKF, nominal": ExtendedKalman(refit=False).fit(cycles[:2], MELLAH),
    }  # fmt: skip
    show("motors with a tolerance of 10 %", evaluate(methods, tests, MELLAH))


def missing_physics(size: Size, quick: bool) -> None:
    """A true motor with an effect that its file lacks; sensor and EKF are given the same half hour on the bench."""
    cases = {
        "magnet -0.2 %/K": {"magnet_temperature.beta": 0.002},
        "brush drop 1.5 V": {"brush_voltage_drop.V_b": 1.5},
        "second thermal node": {
            "two_node_thermal.G_h": 8.0,
            "two_node_thermal.G_a": 3.0,
            "two_node_thermal.C_h": 9000.0,
        },
    }
    for title, effect in list(cases.items())[: 1 if quick else None]:
        true = with_overrides(MELLAH, effect)
        bench = duty(true, Size(0, 6, 300.0, 0), 71, ambient_start=True)
        tests = duty(true, size, 72, ambient_start=True)
        wrong = calibrated(MELLAH, bench)
        settings = ObserverSettings(voltage_sd=WHITE.voltage_V, current_sd=WHITE.current_A, thermal_walk=0.02)
        blind = with_observer(filters(wrong), wrong, settings)
        told = with_observer(filters(true), true, replace(settings, thermal_walk=0.0))
        methods: Mapping[str, Method] = {
            "hybrid, without effect": trained(blind, bench, size, (6,), rows=2000),
            "hybrid, effect added": trained(told, bench, size, (6,), rows=2000),
            "observer, without effect": Observing(blind, wrong),
            "EKF, fitted": ExtendedKalman().fit(bench, MELLAH),
        }
        show(f"{title}: 30 min of bench recordings", evaluate(methods, tests, true))


def wheels() -> None:
    """Real wheel motors: trained on robots 01 and 03, tested on 04 and 05."""
    if not RECORDINGS.is_dir():
        print("\n## real wheel motors: the recordings are not here")
        return
    columns = ("voltage=vL_V", "current=iL_A", "speed=wL_rad_s")
    runs = {k: read_recording(RECORDINGS / "regbot" / f"robot_{k:02d}.csv", columns) for k in (1, 3, 4, 5)}
    bench = [runs[1], runs[3]]
    plain = wheel_file()
    # Friction and a drop at brushes and driver are known to be there; the bench says how large they are.
    effects = {
        "coulomb_friction.tau_c": 0.01, "coulomb_friction.w_s": 0.5, "brush_voltage_drop.V_b": 0.3,
        "brush_voltage_drop.i_s": 0.02,
    }  # fmt: skip
    keys = ["R_a0", "L", "ke", "J", "b", "coulomb_friction.tau_c", "brush_voltage_drop.V_b"]
    file = calibrate(with_overrides(plain, effects), bench, keys).file
    v_sd, i_sd = noise_of(bench, file.rated)
    # Two runs of half a second support a linear correction, no more.
    bank = with_observer(
        filters(file), file, ObserverSettings(voltage_sd=v_sd, current_sd=i_sd, model_sd=0.03, load_walk=0.05)
    )
    outputs = ("speed",)
    seen = [cycle(r, bank, outputs) for r in bench]
    recipe = Recipe(
        "wheel", bank, outputs, (), Rate(1000.0, 500.0, 2000.0), 0.1, 0,
        Settings(iterations=60, time_series=True, single=False, ridge=1.0),
    )  # fmt: skip
    methods: Mapping[str, Method] = {
        "hybrid": Network(build(recipe, seen, [], []).sensor),
        "observer alone": Observing(bank, file),
        "EKF, same motor file": ExtendedKalman(refit=False).fit(bench, file),
        "EKF, textbook fitted": ExtendedKalman().fit(bench, plain),
        "steady-state voltage": SteadyStateVoltage().fit(bench, plain),
    }
    for robot in (4, 5):
        show(f"regbot robot {robot:02d}, left wheel", evaluate(methods, [runs[robot]], file))


def wheel_file() -> MotorFile:
    """What is documented of the robots' wheel motors, at the wheel; the friction is known to be there, not how large."""
    file = MELLAH.with_values(
        {
            "R_a0": 3.0,
            "L": 0.0066,
            "ke": 0.1016,
            "J": 5e-4,
            "b": 1e-4,
            "H": 20.0,
            "k0": 0.1,
            "k_ir": 0.0,
            "kT": 0.0,
        }
    )
    rated = replace(file.rated, voltage_V=12.0, current_A=0.5, speed_rad_s=100.0, torque_Nm=0.05, rise_K=30.0)
    sds = {
        key: replace(file.knowledge[key], sd=0.5 * file.values()[key])
        for key in ("R_a0", "L", "ke", "J", "b")
    }
    return replace(file, rated=rated, knowledge={**file.knowledge, **sds})


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="train on little, show a part")
    quick = parser.parse_args().quick
    size = Size(16, 3, 150.0, 25) if quick else Size(36, 8, 400.0, 50)
    started = time.monotonic()
    hybrid = exact_motor(size, quick)
    hot_restart(hybrid, size)
    wheels()
    if not quick:
        tolerance(size)
    missing_physics(size, quick)
    print(f"\n{time.monotonic() - started:.0f} s", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
