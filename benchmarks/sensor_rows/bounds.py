"""How near a sensor file comes to what is possible: its rms errors over the posterior Cramer-Rao bound of each drive.

The motor is the file's, the noise white; start, load and size of the noise are drawn. The bound knows the noise and is told
how the load jumps, which no estimator knows; it starts from the same ignorance as the sensor.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from sensor_rows.common import MELLAH
from sensor_rows.worlds import DRIVE, judged

from motorlens_physics.recording import Recording
from motorlens_runtime.sensor.sensor import load_sensor
from motorlens_train.bound import Noise, bound_of_recording
from motorlens_train.evaluation.scores import plate_prior
from motorlens_train.evaluation.worlds.judge import ROWS, Verdict
from motorlens_train.evaluation.worlds.world import Recorded, World, at, drawn, record

PLAIN = {
    "motor": "the file's", "lacks": "nothing", "jitter": "none", "converter": "exact", "colour": "white", "between": "held",
    "rate": "500",
}  # fmt: skip
# Excitation and the largest ratio asked for.
ASKED = {"steps": 1.5, "loop": 1.5, "ramps": 2.0}
# What the load does between its jumps, N m per root second.
LOAD_WALK = 0.02


def bounds(path: Path, drives: int) -> int:
    """Print one line an excitation and start: rms and largest errors, median ratio to the bound; the number missed."""
    sensor, missed = load_sensor(str(path)), 0
    print(f"\n## {path.name} beside the bound, {drives} drives each from each start\n{_HEAD}")
    for kind, asked in ASKED.items():
        for start in ("cold", "warm"):
            rows = [
                (judged(sensor, world, recorded), _bound(recorded))
                for world, recorded in _drives(kind, start, drives)
            ]
            missed += _show(kind, start, asked, rows)
    return missed


_HEAD = f"{'drive':<16}{'rms rad/s':>11}{'x bound':>9}{'rms K':>9}{'x bound':>9}{'largest K':>11}{'good %':>8}{'asked':>7}"


def _show(kind: str, start: str, asked: float, rows: list[tuple[Verdict, np.ndarray]]) -> int:
    seen = [(found, bound) for found, bound in rows if found.good > 0]
    rms = np.array([found.rms[:2] for found, _ in seen])
    ratio = np.median(rms / np.array([bound for _, bound in seen]), axis=0)
    good = 100 * np.mean([found.good for found, _ in rows])
    middle, largest = np.median(rms, axis=0), max(found.largest[1] for found, _ in seen)
    print(
        f"{kind + ', ' + start:<16}{middle[0]:>11.3g}{ratio[0]:>9.2f}{middle[1]:>9.3g}{ratio[1]:>9.2f}{largest:>11.3g}"
        f"{good:>8.1f}{asked:>7}",
        flush=True,
    )
    return int((ratio > asked).sum())


def _drives(kind: str, start: str, drives: int) -> Iterator[tuple[World, Recorded]]:
    for number in range(drives):
        world = at(drawn(47, number), **PLAIN, excitation=kind, noise="0.5-2", start=start)
        yield world, record(world, DRIVE)


def _bound(recorded: Recorded) -> np.ndarray:
    """Rms of the bound (2,) of speed and temperature over the rows that count."""
    channels = {
        "voltage": recorded.voltage_V, "current": recorded.current_A, "speed": recorded.truth[:, 0],
        "temperature": recorded.truth[:, 1] + recorded.ambient_C, "ambient": recorded.ambient_C,
        "load_torque": recorded.load_Nm,
    }  # fmt: skip
    noise = Noise(recorded.noise_V, recorded.noise_A, LOAD_WALK)
    found = bound_of_recording(
        MELLAH.motor, Recording("drive", recorded.time_s, channels), noise, plate_prior(MELLAH)
    )
    rows = np.unique(np.linspace(0, len(recorded.time_s) - 1, ROWS).astype(np.intp))
    counted = rows[recorded.counted[rows]]
    return np.sqrt((found.outputs[counted, :2] ** 2).mean(0))
