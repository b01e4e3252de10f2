"""What the rows of the table share: how sensors are trained, what is tried on them, and how figures are printed."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from motorlens_physics.motor_file import MotorFile, read_motor_file
from motorlens_physics.recording import Recording
from motorlens_physics.scenario import chosen_scenario, measure, perform, time_constants
from motorlens_train.baselines.method import OUTPUTS, UNITS, Estimate, inputs, truth
from motorlens_train.bound import Noise
from motorlens_train.build import Recipe, build
from motorlens_train.data import cycle
from motorlens_train.duty_cycles import Noise as White
from motorlens_train.duty_cycles import duty_cycle, instants
from motorlens_train.evaluation.scores import Evaluation, text_table
from motorlens_train.features import feature_rows, motor_bank
from motorlens_train.observer.design import ObserverSettings, with_observer
from motorlens_train.sensor import Sensor
from motorlens_train.specification import Bank, Rate
from motorlens_train.trainer import Settings

ROOT = Path(__file__).resolve().parents[2]
MELLAH = read_motor_file(ROOT / "models" / "motors" / "mellah2016.toml")
WHITE = White(0.5, 0.05)
MEASURED = {"voltage": WHITE.voltage_V, "current": WHITE.current_A}
BOUND = Noise(WHITE.voltage_V, WHITE.current_A, 0.02)
WATCHING = ObserverSettings(voltage_sd=WHITE.voltage_V, current_sd=WHITE.current_A)


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
    """A sensor of this bank: three quarters of the cycles to train on, one to calibrate; of a single one all to train on."""
    seen = [
        cycle(r, bank, OUTPUTS, instants(r, rows, WHITE, np.random.default_rng([3, k])))
        for k, r in enumerate(cycles)
    ]
    rate = Rate(1 / float(np.median([r.period_s for r in cycles])), 50.0, 10000.0)
    settings = Settings(iterations=size.iterations, time_series=bank.observer is not None)
    recipe = Recipe("benchmark", bank, OUTPUTS, hidden, rate, 1.0, 0, settings, skips=skips)
    quarter = min(max(1, len(seen) // 4), len(seen) - 1)
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


@cache
def exact_material(size: Size) -> tuple[Recording, ...]:
    """Cycles of the exact motor, for every network that is trained on them."""
    return tuple(material(MELLAH, size, 11))


@cache
def exact_hybrid(size: Size) -> Network:
    """The network beside an observer that most rows are about."""
    return trained(with_observer(filters(MELLAH), MELLAH, WATCHING), exact_material(size), size, (6,))


def show(title: str, evaluation: Evaluation) -> None:
    print(f"\n## {title}\n{text_table(evaluation)}", flush=True)


def goal(what: str, value: float, limit: float, least: float | None = None) -> None:
    """A figure beside its goal: at most `limit`, or between `least` and `limit`."""
    met = value <= limit and (least is None or value >= least)
    wanted = f"at most {limit:.4g}" if least is None else f"{least:.4g} to {limit:.4g}"
    print(f"  {'met   ' if met else 'MISSED'}  {what}: {value:.4g} (goal: {wanted})", flush=True)


def better(what: str, evaluation: Evaluation, name: str, other: str, share: float = 1.0) -> None:
    """The goal that one method's error is below that share of another's, in every output both estimate."""
    for output in OUTPUTS:
        ours, theirs = (evaluation.scores[key][output].rms for key in (name, other))
        if np.isfinite(ours) and np.isfinite(theirs):
            goal(f"{what}, {output} ({UNITS[output]})", ours, share * theirs)
