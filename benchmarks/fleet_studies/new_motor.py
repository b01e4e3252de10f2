"""A new motor of a known make, calibrated on one start: how well a sensor made of it shows its temperature."""

import csv
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
from fleet_studies.plant import HEATED_S, fleet, make_file
from helpers.plain_fleet import Array, World, simulated, write
from helpers.plain_motor import AMBIENT_C, RATED

from motorlens_runtime.cli import main as motorlens

# Motors that the make is known from, and the first number of those that are new.
KNOWN, NEW = 20, 1000
# Of a sample: 0.2 % of the rated voltage and 0.7 % of the rated current, as `motorlens train` takes them.
NOISE_V, NOISE_A, NOISE_K = 0.002 * RATED["voltage"], 0.007 * RATED["current"], 0.5
# A start: seconds, samples a second, of the rated voltage and torque. A duty: the same, and how long a level lasts.
START = (4.0, 500.0, 0.5, 0.5)
DUTY_S, RATE_Hz, LEVEL_S = 1800.0, 100.0, 60.0


def new_motor(place: Path, count: int, seed: int, workers: int) -> None:
    """Temperature after one start, beside the sensor of the make and that of the motor file."""
    world = World(KNOWN, 5, heated_s=HEATED_S)
    world.write(place / "plant", seed)
    rough = make_file(place / "make.toml")
    fleet(place / "plant", rough, place / "out", "--as-it-is", "--workers", str(workers))
    make = place / "out" / "population.toml"
    sensors = {"the motor file": _sensor(rough), "the make": _sensor(make)}
    errors: dict[str, list[float]] = {}
    for k in range(count):
        motor, rng = world.motor(NEW + k, seed), np.random.default_rng([seed, NEW + k])
        start, duty = place / f"start_{k}.csv", place / f"duty_{k}.csv"
        _start(motor, rng, start)
        truth = _duty(motor, rng, duty)
        for title, file in (("its start", rough), ("its start and the make", make)):
            own = place / f"own_{k}_{file.stem}.toml"
            words = ["--fit-load", "--accept-unconverged", "-o", str(own), "--json", str(place / "said.json")]
            motorlens(["calibrate", str(start), "--motor", str(rough), *_make(file, rough), *words])
            sensors[title] = _sensor(own)
        for title, sensor in sensors.items():
            errors.setdefault(title, []).append(_rms(duty, sensor, truth))
        told = ", ".join(f"{title} {row[-1]:.2f} K" for title, row in errors.items())
        print(f"new motor {k}: by {told}", flush=True)
    print(
        f"new motors, {count}, rms of the temperature over {DUTY_S / 60:g} min at varying voltage and load, by:"
    )
    for title, row in errors.items():
        print(f"  {title:24} {np.sqrt(np.mean(np.square(row))):6.2f} K, worst {max(row):.2f} K")


def _make(file: Path, rough: Path) -> list[str]:
    return [] if file == rough else ["--make", str(file)]


def _sensor(motor: Path) -> Path:
    """An observer of a motor file: nothing is trained."""
    out = motor.with_suffix(".onnx")
    words = ["--cycles", "10", "--worlds", "0", "--rate", f"{RATE_Hz:g}", "-o", str(out)]
    assert motorlens(["train", "--motor", str(motor), "--observer", str(motor), *words]) == 0
    return out


def _start(motor: dict[str, float], rng: np.random.Generator, path: Path) -> None:
    """From rest and cold, at half of the voltage and of a torque that nobody measures: voltage, current, how warm."""
    seconds, rate, volts, torque = START
    n = round(seconds * rate)
    voltage = np.where(np.arange(n) < 0.05 * n, 0.0, volts * RATED["voltage"])
    load = np.where(voltage > 0, torque * RATED["load_torque"], 0.0)
    states = simulated(motor, voltage, load, 1 / rate)
    # A thermometer lies on the cold motor: how warm it is when it starts is known.
    warm = AMBIENT_C + states[:, 2] + NOISE_K * rng.standard_normal(n)
    _write(voltage, states[:, 0], rate, rng, path, {"temperature": warm})


def _duty(motor: dict[str, float], rng: np.random.Generator, path: Path) -> Array:
    """Levels of voltage and load; the true temperature."""
    dwell, n = round(LEVEL_S * RATE_Hz), round(DUTY_S * RATE_Hz)
    levels = n // dwell + 1
    voltage = np.repeat(rng.uniform(0.4, 1.0, levels) * RATED["voltage"], dwell)[:n]
    load = np.repeat(rng.uniform(0.1, 1.0, levels) * RATED["load_torque"], dwell)[:n]
    # At rest for the first second: what comes next is a start.
    voltage[: round(RATE_Hz)], load[: round(RATE_Hz)] = 0.0, 0.0
    states = simulated(motor, voltage, load, 1 / RATE_Hz)
    _write(voltage, states[:, 0], RATE_Hz, rng, path)
    return states[:, 2]


def _write(
    voltage: Array, current: Array, rate: float, rng: np.random.Generator, path: Path,
    more: Mapping[str, Array] = MappingProxyType({}),
) -> None:  # fmt: skip
    n = len(voltage)
    columns = {
        "time": np.arange(n) / rate, "voltage": voltage + NOISE_V * rng.standard_normal(n),
        "current": current + NOISE_A * rng.standard_normal(n), "ambient": np.full(n, AMBIENT_C),
        **more,
    }  # fmt: skip
    write(columns, path)


def _rms(duty: Path, sensor: Path, truth: Array) -> float:
    """Root mean square error of the temperature, from a second after the start on."""
    out = duty.with_suffix(".out.csv")
    assert motorlens(["infer", str(duty), "--sensor", str(sensor), "-o", str(out)]) == 0
    with out.open() as file:
        rows = [(float(row["time_s"]), float(row["temperature_rise_K"])) for row in csv.DictReader(file)]
    time_s, shown = np.array(rows).T
    actual = np.interp(time_s, np.arange(len(truth)) / RATE_Hz, truth)
    counted = time_s > 2.0
    return float(np.sqrt(np.mean((shown - actual)[counted] ** 2)))
