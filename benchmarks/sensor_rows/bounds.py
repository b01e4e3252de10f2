"""How near a sensor file comes to what is possible: its rms errors over the posterior Cramer-Rao bound of each drive.

The motor is the file's, the noise white; start, load and size of the noise are drawn. The bound is taken along what truly
happened, with the torque that acted on the shaft: with a brake's setting for a torque, a rotor that creeps under its brake
would be known to rest, and one that is turned backwards would be elsewhere. It knows the noise and is told by how much that
torque changes at every sample, which no estimator knows; it starts from the same ignorance as the sensor. The columns
`untold` leave out the samples to which it is told something: those within a second of a jump, and at rest, where a brake
takes what it is asked for.

Beside the largest error of the temperature stands what can be known at that instant, `least K`, by one who is told
nothing of the load: in that bound it is changing all the time, as fast as the observer takes one to change. While the
voltage stands still, any resistance has a load that explains what is measured, and none is shown.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from sensor_rows.common import MELLAH
from sensor_rows.worlds import DRIVE, Published, published

from motorlens_runtime.sensor.sensor import load_sensor
from motorlens_train.bound import Noise, bound
from motorlens_train.evaluation.scores import plate_prior
from motorlens_train.evaluation.worlds.judge import ROWS, Verdict, verdict
from motorlens_train.evaluation.worlds.world import Recorded, World, at, drawn, record
from motorlens_train.observer.layout import ObserverSettings

PLAIN = {
    "motor": "the file's", "lacks": "nothing", "jitter": "none", "converter": "exact", "colour": "white", "between": "held",
    "rate": "500",
}  # fmt: skip
# Excitation and the largest ratio asked for.
ASKED = {"steps": 1.5, "loop": 1.5, "ramps": 2.0}
# What the load does between its jumps, N m per root second.
LOAD_WALK = 0.02
# The same of a load of which nothing is told: the observer's while it changes.
_MOTOR = MELLAH.motor
UNTOLD_WALK = (
    ObserverSettings().load_jump * MELLAH.rated.torque_Nm / (_MOTOR.R_a0 * _MOTOR.J / _MOTOR.ke**2) ** 0.5
)
# How long after a jump of the load the bound is ahead by knowing of it, s; and below which share of the rated speed a rotor
# under a dry brake rests.
TOLD_S, RESTING = 1.0, 0.005


def bounds(path: Path, drives: int) -> int:
    """Print one line an excitation and start: rms and largest errors, median ratio to the bound; the number missed."""
    sensor, missed = load_sensor(str(path)), 0
    print(f"\n## {path.name} beside the bound, {drives} drives each from each start\n{_HEAD}")
    for kind, asked in ASKED.items():
        for start in ("cold", "warm"):
            rows, worst = [], (0.0, 0.0)
            for world, recorded in _drives(kind, start, drives):
                least, found = _bound(recorded), published(sensor, world, recorded)
                untold = replace(recorded, counted=recorded.counted & _untold(recorded))
                rows += [[(_judged(world, one, found), _rms(least, one)) for one in (recorded, untold)]]
                worst = max(worst, _largest(recorded, found, worst[0]))
            missed += _show(kind, start, asked, rows, worst)
    return missed


_HEAD = (
    f"{'drive':<16}{'rms rad/s':>11}{'x bound':>9}{'untold':>9}{'rms K':>9}{'x bound':>9}{'untold':>9}{'largest K':>11}"
    f"{'least K':>9}{'good %':>8}{'asked':>7}"
)


def _show(
    kind: str,
    start: str,
    asked: float,
    rows: list[list[tuple[Verdict, np.ndarray]]],
    worst: tuple[float, float],
) -> int:
    every, untold = (_ratios([row[k] for row in rows]) for k in range(2))
    found = [row[0][0] for row in rows]
    good = 100 * np.mean([one.good for one in found])
    middle = np.median([one.rms[:2] for one in found if one.good > 0], axis=0)
    print(
        f"{kind + ', ' + start:<16}{middle[0]:>11.3g}{every[0]:>9.2f}{untold[0]:>9.2f}{middle[1]:>9.3g}{every[1]:>9.2f}"
        f"{untold[1]:>9.2f}{worst[0]:>11.3g}{worst[1]:>9.3g}{good:>8.1f}{asked:>7}",
        flush=True,
    )
    return int((every > asked).sum())


def _ratios(rows: list[tuple[Verdict, np.ndarray]]) -> np.ndarray:
    """Median ratio (2,) of rms errors to the bound's."""
    return np.median([found.rms[:2] / bound for found, bound in rows if found.good > 0], axis=0)


def _drives(kind: str, start: str, drives: int) -> Iterator[tuple[World, Recorded]]:
    for number in range(drives):
        world = at(drawn(47, number), **PLAIN, excitation=kind, noise="0.5-2", start=start)
        yield world, record(world, DRIVE)


def _judged(world: World, recorded: Recorded, found: Published) -> Verdict:
    return verdict(world, recorded, found.rows, found.values, found.sds, found.good)


def _largest(recorded: Recorded, found: Published, at_least: float) -> tuple[float, float]:
    """The largest error of the temperature, and what can be known then, K; the latter of one larger than `at_least`."""
    counted = recorded.counted[found.rows] & found.good
    errors = np.where(counted, np.abs(found.values[:, 1] - recorded.truth[found.rows, 1]), 0.0)
    worst = int(errors.argmax())
    if errors[worst] <= at_least:
        return float(errors[worst]), 0.0
    return float(errors[worst]), float(_bound(recorded, UNTOLD_WALK)[found.rows[worst], 1])


def _bound(recorded: Recorded, load_walk: float = LOAD_WALK) -> np.ndarray:
    """Deviations (N, 2) of speed and temperature."""
    states = {
        "i": recorded.true_A, "w": recorded.truth[:, 0], "theta": recorded.truth[:, 1], "load": recorded.shaft_Nm
    }  # fmt: skip
    noise = Noise(recorded.noise_V, recorded.noise_A, load_walk)
    found = bound(
        MELLAH.motor, recorded.time_s, states, recorded.true_V, recorded.ambient_C, noise, plate_prior(MELLAH)
    )
    return found.outputs[:, :2]


def _rms(bound: np.ndarray, recorded: Recorded) -> np.ndarray:
    """Of the bound (2,), over the rows that count."""
    rows = np.unique(np.linspace(0, len(recorded.time_s) - 1, ROWS).astype(np.intp))
    return np.sqrt((bound[rows[recorded.counted[rows]]] ** 2).mean(0))


def _untold(recorded: Recorded) -> np.ndarray:
    """Where the bound is told nothing (N,): the rotor turns, and the load has not jumped for TOLD_S."""
    jumps = np.diff(recorded.load_Nm, prepend=recorded.load_Nm[:1]) != 0
    last = np.maximum.accumulate(np.where(jumps, recorded.time_s, -np.inf))
    turns = np.abs(recorded.truth[:, 0]) > RESTING * MELLAH.rated.speed_rad_s
    return (recorded.time_s >= last + TOLD_S) & turns
