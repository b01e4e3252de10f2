"""Effects as textbooks write them, hidden in a plant of its own: what `diagnose` says of motors from 12 V to 60 V.

    python benchmarks/textbook_plant.py --count 34 --seed 1

The plant shares nothing with `physics/` nor with the worlds of `hidden_effects.py`: classical Runge-Kutta with fixed steps,
friction as tanh(w / w_s), a brush drop that heats nothing, iron that saturates to a floor, a shaft of two masses. Motor,
drive (steps, ramps, a chirp, a random binary sequence), rate, noise, whether load and winding temperature are measured, and
how far the motor file is off (up to a tenth) are drawn. Of each kind there are as many worlds. Some 20 s of processor time a
world.
"""

import argparse
import sys
import time
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

HERE = Path(__file__).resolve().parent
sys.path = [str(HERE), str(HERE.parent / "tests"), *(p for p in sys.path if Path(p).resolve() != HERE)]

from helpers.hidden.score import Rate  # noqa: E402

from motorlens_physics.motor import Motor  # noqa: E402
from motorlens_physics.motor_file import MotorFile  # noqa: E402
from motorlens_physics.parameter import Rated  # noqa: E402
from motorlens_physics.recording import Recording  # noqa: E402
from motorlens_workbench.diagnose import diagnose  # noqa: E402
from motorlens_workbench.report.json import sentence  # noqa: E402
from motorlens_workbench.verdict import settle  # noqa: E402

Array = NDArray[np.float64]

# R (ohm), L (H), k (V s/rad), J (kg m^2), b (N m s/rad), alpha (1/K), k0 (W/K), H (J/K), rated voltage (V) and current (A).
MOTORS = {
    "24 V coreless": (2.32, 2.38e-4, 0.0234, 1.08e-6, 1e-6, 3.9e-3, 0.07, 3.4, 24.0, 1.2),
    "12 V": (3.6, 2.0e-3, 0.0185, 4.5e-6, 4e-6, 3.9e-3, 0.09, 14.0, 12.0, 0.9),
    "60 V, 1 kW": (0.29, 2.1e-3, 0.27, 9e-3, 3e-3, 3.9e-3, 4.0, 900.0, 60.0, 18.0),
    "36 V servo": (1.1, 6e-4, 0.055, 4.2e-5, 3e-5, 3.9e-3, 0.3, 30.0, 36.0, 4.0),
}
RATES_HZ, SECONDS, NOISES, MOST_SAMPLES = (200, 500, 1000, 2000), (10, 20, 40), (0.001, 0.003, 0.01), 40_000
DRIVES = ("steps", "ramps", "chirp", "binary")
# What is hidden -> every name that is right, and the equation where none is.
RIGHT: dict[str, tuple[tuple[str, ...], str | None]] = {
    "nothing": ((), None),
    "Coulomb friction": (("coulomb_friction", "hysteresis_iron_loss"), "mechanical"),
    "Stribeck friction": (("stribeck_friction",), "mechanical"),
    "quadratic drag": (("quadratic_drag",), "mechanical"),
    "brush drop": (("brush_voltage_drop", "dead_time"), "electrical"),
    "cogging": (("cogging_torque",), "mechanical"),
    "ripple of k": (("commutation_ripple",), "coupling"),
    "saturation": (("inductance_saturation",), "electrical"),
    "magnets that warm": (("magnet_temperature",), "coupling"),
    "current sensor's gain": (tuple(f"{c}_sensor_gain" for c in ("current", "speed", "voltage", "load_torque")), "current"),
    "speed sensor's offset": (("speed_sensor_offset", "voltage_sensor_offset"), "speed"),
    "speed sensor's lag": (("speed_sensor_lag",), "speed"),
    "elastic shaft": ((), "mechanical"),
    "a load from a moment on": (("constant_torque", "coulomb_friction"), "mechanical"),
}  # fmt: skip
TOO_MANY = "right, and a name too many"
# What may be named beside it: these worlds have that too.
BESIDE = {"Stribeck friction": ("coulomb_friction", "hysteresis_iron_loss")}


@dataclass(frozen=True)
class Lacking:
    """What the motor file does not know, in SI, in the order in which `_rates` takes it."""

    coulomb: float = 0.0
    stribeck: float = 0.0
    stribeck_speed: float = 1.0
    sharp: float = 1.0
    drag: float = 0.0
    drop: float = 0.0
    cogging: float = 0.0
    ripple: float = 0.0
    count: float = 6.0
    saturates: float = 1e9
    magnets: float = 0.0
    outer: float = 0.0
    stiffness: float = 0.0


@njit(cache=True)
def _rates(y: Array, v: float, load: float, m: Array, e: Array) -> Array:
    # Current, speed and angle of the rotor, rise of the winding, speed of the outer mass, twist of the shaft.
    i, w, phi, theta, outer, twist = y[0], y[1], y[2], y[3], y[4], y[5]
    R, L, k, J, b, alpha, k0, H, _, rated = m
    coulomb, stribeck, at, sharp, drag, drop, cogging, ripple, count, saturates, magnets, J2, stiff = e
    flux = k * (1 - magnets * theta) * (1 + ripple * np.sin(count * phi))
    inductance = L * (0.3 + 0.7 / (1 + (i / saturates) ** 2))
    friction = (
        b * w + (coulomb + stribeck * np.exp(-((w / at) ** 2))) * np.tanh(w / sharp) + drag * w * abs(w)
    )
    friction += cogging * np.sin(count * phi)
    dy = np.zeros(6)
    hot = R * (1 + alpha * theta)
    dy[0] = (v - hot * i - flux * w - drop * np.tanh(i / (0.02 * rated))) / inductance
    passed = stiff * twist + 0.05 * np.sqrt(stiff * J2) * (w - outer)
    dy[1] = (flux * i - friction - (passed if J2 > 0 else load)) / (J - J2)
    dy[2] = w
    dy[3] = (hot * i * i - k0 * theta) / H
    if J2 > 0:
        dy[4], dy[5] = (passed - load) / J2, w - outer
    return dy


@njit(cache=True)
def _simulated(voltage: Array, load: Array, m: Array, e: Array, step: float, steps: int) -> Array:
    out, y, h = np.zeros((len(voltage), 6)), np.zeros(6), step / steps
    for n in range(len(voltage)):
        out[n] = y
        for _ in range(steps):
            a = _rates(y, voltage[n], load[n], m, e)
            b = _rates(y + h / 2 * a, voltage[n], load[n], m, e)
            c = _rates(y + h / 2 * b, voltage[n], load[n], m, e)
            d = _rates(y + h * c, voltage[n], load[n], m, e)
            y = y + h / 6 * (a + 2 * b + 2 * c + d)
    return out


def lacking(kind: str, rng: np.random.Generator, m: Array) -> Lacking:
    """A healthy size of an effect, from half to one and a half of a typical one."""
    torque, speed, size = m[2] * m[9], m[8] / m[2], rng.uniform(0.5, 1.5)
    count, plain = float(rng.choice([5, 6, 7, 12])), Lacking(sharp=max(1e-3 * speed, 0.05))
    outer, ringing = 0.6 * m[3], 2 * np.pi * rng.uniform(8, 30)
    return {
        "Coulomb friction": replace(plain, coulomb=0.08 * torque * size),
        "Stribeck friction": replace(
            plain, coulomb=0.05 * torque * size, stribeck=0.1 * torque * size, stribeck_speed=0.06 * speed
        ),
        "quadratic drag": replace(plain, drag=0.2 * torque * size / speed**2),
        "brush drop": replace(plain, drop=0.02 * m[8] * size),
        "cogging": replace(plain, cogging=0.08 * torque * size, count=count),
        "ripple of k": replace(plain, ripple=0.03 * size, count=count),
        "saturation": replace(plain, saturates=2.5 * m[9] / size),
        "magnets that warm": replace(plain, magnets=0.002 * size),
        "elastic shaft": replace(plain, outer=outer, stiffness=ringing**2 * outer * (m[3] - outer) / m[3]),
    }.get(kind, plain)


def driven(rng: np.random.Generator, time_s: Array, m: Array) -> tuple[str, Array, Array]:
    """A drive, its voltage (N,), and a load in steps (N,), scaled by how soon the motor answers."""
    n, answers = len(time_s), m[3] * m[0] / m[2] ** 2
    per_s = (n - 1) / time_s[-1]
    kind = str(rng.choice(DRIVES))

    def in_steps(least: float, most: float, levels: Array) -> Array:
        lengths = np.maximum(rng.uniform(least, most, n) * answers * per_s, 2).astype(int)
        return np.asarray(np.repeat(rng.choice(levels, n), lengths)[:n])

    if kind == "steps":
        volts = in_steps(2, 12, np.array([0, 0.3, 0.5, 0.8, 1, -0.4, -0.8]))
    elif kind == "binary":
        volts = in_steps(1.5, 6, np.array([-0.8, 0.8]))
    elif kind == "chirp":
        volts = 0.9 * np.sin(2 * np.pi * np.cumsum(np.geomspace(0.05, 1.2, n)) / (6 * answers * per_s))
    else:
        corners = np.cumsum(rng.uniform(8, 30, n) * answers)
        volts = np.interp(time_s, corners, rng.uniform(-1, 1, n))
    return kind, m[8] * volts, in_steps(10, 40, 0.6 * rng.random(64)) * m[2] * m[9]


def _late(y: Array, lag: float) -> Array:
    """(N,) behind a first-order filter of so many samples."""
    out, keep = y.copy(), np.exp(-1 / lag)
    for n in range(1, len(y)):
        out[n] = keep * out[n - 1] + (1 - keep) * y[n]
    return out


def world(kind: str, rng: np.random.Generator) -> tuple[str, MotorFile, Recording]:
    """What was drawn in words, the motor file, and the recording."""
    name = str(rng.choice(list(MOTORS)))
    stated = np.array(MOTORS[name])
    m = stated * np.concatenate([rng.uniform(0.9, 1.1, 5), np.ones(5)])
    rate = int(rng.choice(RATES_HZ))
    time_s = np.arange(min(int(rng.choice(SECONDS)) * rate, MOST_SAMPLES)) / rate
    noise, n = float(rng.choice(NOISES)), len(time_s)
    drive, voltage, load = driven(rng, time_s, m)
    loaded, heated = rng.random() < 0.3, kind == "magnets that warm" or rng.random() < 0.5
    load = load * loaded
    hidden = np.zeros(n)
    if kind == "a load from a moment on":
        hidden = 0.15 * m[2] * m[9] * (time_s > rng.uniform(0.3, 0.6) * time_s[-1])
    e = np.array([*vars(lacking(kind, rng, m)).values()])
    steps = int(np.clip(6 / rate / min(m[1] / m[0], m[3] * m[0] / m[2] ** 2), 8, 60))
    states = _simulated(voltage, load + hidden, m, e, 1 / rate, steps)
    torque, speed = m[2] * m[9], m[8] / m[2]
    current, shown = states[:, 0], states[:, 1]
    size = rng.uniform(0.5, 1.5)
    if kind == "current sensor's gain":
        current = current * (1 + 0.06 * size)
    if kind == "speed sensor's offset":
        shown = shown + 0.01 * speed * size
    if kind == "speed sensor's lag":
        shown = _late(shown, rng.uniform(3, 8))
    channels = {
        "voltage": voltage + 0.3 * noise * m[8] * rng.standard_normal(n),
        "current": current + noise * max(np.ptp(current) / 2, m[9]) * rng.standard_normal(n),
        "speed": shown + noise * speed * rng.standard_normal(n),
    }
    if loaded:
        channels["load_torque"] = load + noise * torque * rng.standard_normal(n)
    if heated:
        channels["temperature"] = 25 + states[:, 3] + 0.2 * rng.standard_normal(n)
    keys = ("R_a0", "L", "ke", "J", "b", "alpha", "k0", "H")
    motor = replace(Motor(), **dict(zip(keys, stated, strict=False)), kT=0.0, k_ir=0.0)
    plate = Rated(voltage_V=m[8], current_A=m[9], speed_rad_s=0.9 * speed, torque_Nm=torque, ambient_C=25.0)
    measured = "".join(f", {what}" for what, there in (("load", loaded), ("temperature", heated)) if there)
    words = f"{name}, {drive}, {rate} Hz, {time_s[-1]:.0f} s, noise {100 * noise:g} %{measured}"
    return words, MotorFile("textbook", motor, plate), Recording("textbook.csv", time_s, channels)


def judged(kind: str, verdict: str, equation: str | None, groups: tuple[tuple[str, ...], ...]) -> str:
    """One word: right (also with a name too many), wrong, missed, or unknown, in the right equation or another."""
    names, where = RIGHT[kind]
    if kind == "nothing":
        return "right" if verdict == "adequate" else "unknown" if verdict == "unknown" else "wrong"
    if verdict in ("adequate", "not_testable"):
        return "missed"
    if any(name in group for group in groups for name in names):
        able = {*names, *BESIDE.get(kind, ())}
        return "right" if verdict == "unknown" or all(able & {*group} for group in groups) else TOO_MANY
    if verdict != "unknown":
        return "wrong"
    return "unknown, right equation" if equation == where else "unknown, another equation"


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=len(RIGHT))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=list(RIGHT), help="one thing that is hidden")
    args = parser.parse_args()
    kinds = [args.only] if args.only else list(RIGHT)
    said: dict[str, Counter[str]] = {kind: Counter() for kind in kinds}
    for number in range(args.count):
        kind, began = kinds[number % len(kinds)], time.process_time()
        words, file, recording = world(kind, np.random.default_rng([args.seed, number]))
        found = diagnose(file, [recording])
        verdict = settle(found)
        word = judged(kind, verdict.kind, verdict.equation, verdict.groups)
        said[kind][word] += 1
        print(f"{number} {kind} ({words}): {word}; {time.process_time() - began:.0f} s", flush=True)
        print(f"    {sentence(found, verdict)}", flush=True)
    for kind in kinds:
        print(f"{kind:24s} " + ", ".join(f"{word} {count}" for word, count in said[kind].most_common()))
    total: Counter[str] = sum(said.values(), Counter())
    quiet = sum(said.get("nothing", Counter()).values())
    if quiet:
        print(f"nothing hidden, and said to be adequate: {Rate(said['nothing']['right'], quiet)}")
    print(f"a name that is wrong, all worlds: {Rate(total['wrong'] + total[TOO_MANY], args.count)}")
    hidden = args.count - quiet
    if hidden:
        right = sum(
            said[kind]["right"] + said[kind][TOO_MANY] + said[kind]["unknown, right equation"]
            for kind in kinds
            if kind != "nothing"
        )
        print(f"hidden, and told by name or equation: {Rate(right, hidden)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
