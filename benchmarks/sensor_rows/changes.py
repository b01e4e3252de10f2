"""What becomes of a sensor file's intervals as a drive changes under it: noise that jumps, a voltage scale off, a day
at constant load. Plant, sensors and judge are those of `worlds`."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from sensor_rows.worlds import DRIVE, judged

from motorlens_runtime.sensor.sensor import load_sensor
from motorlens_train.evaluation.worlds.judge import Verdict
from motorlens_train.evaluation.worlds.plant import run
from motorlens_train.evaluation.worlds.world import Recorded, World, at, drawn, record

# What the motor is in every row: the file's, so that nothing but the change is to be told.
PLAIN = {"motor": "the file's", "lacks": "nothing", "jitter": "none", "converter": "exact", "colour": "white"}
# Seconds after a change from which on it counts.
GRACE_S = 10.0
DAY_S, DAY_RATE_HZ = 86_400.0, 200.0


def changes(path: Path, seeds: int, day: bool) -> int:
    """Print one line a row: how much is good, how often 95 % intervals hold, errors; the number confidently wrong."""
    sensor, wrong = load_sensor(str(path)), 0
    print(f"\n## {path.name}: what changes under it, {seeds} drives each\n{_HEAD}")
    for name, rows in (
        ("noise x 5", _louder),
        ("noise / 5", _quieter),
        ("voltage + 3 %", _scaled),
        ("drop missing", _dropped),
    ):
        found = [judged(sensor, *row) for row in rows(seeds)]
        wrong += _show(name, found)
    if day:
        wrong += _show("24 h constant", [judged(sensor, *_day())])
    return wrong


_HEAD = f"{'change':<16}{'good %':>8}{'rad/s in 95 %':>15}{'K in 95 %':>11}{'rms rad/s':>11}{'rms K':>8}{'wrong':>7}"


def _show(name: str, found: list[Verdict]) -> int:
    seen = [one for one in found if one.good > 0]
    wrong = sum(one.confidently_wrong for one in found)
    text = f"{name:<16}{100 * np.mean([one.good for one in found]):>8.1f}"
    if seen:
        weights = [one.good for one in seen]
        covered = 100 * np.average([one.covered for one in seen], axis=0, weights=weights)
        rms = np.median([one.rms for one in seen], axis=0)
        text += f"{covered[0]:>15.1f}{covered[1]:>11.1f}{rms[0]:>11.3g}{rms[1]:>8.3g}"
    print(f"{text}{wrong:>7}", flush=True)
    return wrong


def _drives(seeds: int, noise: str) -> Iterator[tuple[World, Recorded]]:
    for number in range(seeds):
        kind = ("steps", "ramps", "loop")[number % 3]
        world = at(drawn(41, number), **PLAIN, excitation=kind, rate="500", noise=noise, start="cold")
        yield world, record(world, DRIVE)


def _jump(seeds: int, noise: str, factors: tuple[float, float]) -> Iterator[tuple[World, Recorded]]:
    """Noise added so that it is `factors` times the recording's in the first half and in the second."""
    for world, recorded in _drives(seeds, noise):
        n, rng = len(recorded.time_s), world.rng(9)
        factor = np.where(np.arange(n) < n // 2, *factors)
        more = np.sqrt(np.maximum(factor**2 - 1.0, 0.0))
        changed = recorded.time_s[n // 2]
        yield (
            world,
            replace(
                recorded,
                voltage_V=recorded.voltage_V + more * recorded.noise_V * rng.standard_normal(n),
                current_A=recorded.current_A + more * recorded.noise_A * rng.standard_normal(n),
                counted=recorded.time_s >= changed + GRACE_S,
            ),
        )


def _louder(seeds: int) -> Iterator[tuple[World, Recorded]]:
    return _jump(seeds, "0.2-0.5", (1.0, 5.0))


def _quieter(seeds: int) -> Iterator[tuple[World, Recorded]]:
    return _jump(seeds, "0.2-0.5", (5.0, 1.0))


def _scaled(seeds: int) -> Iterator[tuple[World, Recorded]]:
    for world, recorded in _drives(seeds, "0.5-2"):
        yield world, replace(recorded, voltage_V=1.03 * recorded.voltage_V)


def _dropped(seeds: int) -> Iterator[tuple[World, Recorded]]:
    for world, _ in _drives(seeds, "0.5-2"):
        lacking = at(world, lacks="brush drop")
        yield lacking, record(lacking, DRIVE)


def _day() -> tuple[World, Recorded]:
    """Switched on once from ambient, then a day of nothing that excites."""
    rng, n = np.random.default_rng(43), int(DAY_S * DAY_RATE_HZ)
    time, motor = np.arange(n) / DAY_RATE_HZ, DRIVE.constants
    voltage, load = np.where(time < 1.0, 0.0, 200.0), np.full(n, 5.0)
    states, voltage = run(
        motor, time, voltage, True, load, np.zeros(n), np.zeros(3), longest_s=1 / DAY_RATE_HZ
    )
    rise = states[:, 2]
    truth = np.column_stack([states[:, 1], rise, motor.R * (1 + motor.alpha * rise)])
    recorded = Recorded(
        time, voltage + DRIVE.noise_V * rng.standard_normal(n), states[:, 0] + DRIVE.noise_A * rng.standard_normal(n),
        np.full(n, 20.0), truth, time > 11.0, DRIVE.noise_V, DRIVE.noise_A, load, voltage, states[:, 0], load, motor,
        DRIVE.sizes,
    )  # fmt: skip
    return at(drawn(43, 0), **PLAIN, excitation="constant", rate="200", start="cold"), recorded
