"""A world: how the motor is driven and loaded, what motor it is, and how voltage and current are measured; drawn from
a seed."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from motorlens_train.evaluation.worlds.drive import Drive
from motorlens_train.evaluation.worlds.plant import OPEN, Array, Constants, Loop, run

# The factors of a world and their cells; the table has one row for each.
FACTORS: dict[str, tuple[str, ...]] = {
    "excitation": ("steps", "ramps", "sinusoids", "creep", "dither", "loop", "constant"),
    "rate": ("200", "500", "1000", "5000", "20000"),
    "between": ("held", "linear"),
    "jitter": ("none", "5 %"),
    "converter": ("exact", "12 bit", "10 bit"),
    "noise": ("0.05-0.2", "0.2-0.5", "0.5-2", "2-4", "4-10"),
    "colour": ("white", "coloured"),
    "load": ("brake", "drive"),
    "start": ("cold", "warm", "late"),
    "motor": ("the file's", "10 % off"),
    "lacks": ("nothing", "brush drop"),
}
# At most so many samples a world.
MOST = 600_000


@dataclass(frozen=True)
class World:
    """One world; `factors` names its cell of each factor, the numbers are drawn from the seed."""

    seed: tuple[int, ...]
    factors: dict[str, str]

    def rng(self, purpose: int) -> np.random.Generator:
        """Randomness of one purpose of this world."""
        return np.random.default_rng([*self.seed, purpose])


@dataclass(frozen=True)
class Recorded:
    """What is measured, (N,) each: stamps s, V, A, degC; and the truth (N, 3): speed rad/s, rise K, resistance ohm.

    `counted` (N,): from ten seconds after the motor was first excited. `noise_V`, `noise_A`: of a sample. `load_Nm` (N,):
    brake and torque as they were set. `true_V`, `true_A`, `shaft_Nm` (N,): without noise, and what acted on the shaft.
    `sizes` (3,): errors that matter.
    """

    time_s: Array
    voltage_V: Array
    current_A: Array
    ambient_C: Array
    truth: Array
    counted: NDArray[np.bool_]
    noise_V: float
    noise_A: float
    load_Nm: Array
    true_V: Array
    true_A: Array
    shaft_Nm: Array
    constants: Constants
    sizes: Array


def drawn(seed: int, number: int) -> World:
    """World `number` of a seed; three motors of four are the file's, and five drives of six lack nothing."""
    rng = np.random.default_rng([seed, number])
    chosen = {factor: cells[rng.integers(len(cells))] for factor, cells in FACTORS.items()}
    if rng.random() < 0.5:
        chosen["motor"] = "the file's"
    if rng.random() < 2 / 3:
        chosen["lacks"] = "nothing"
    return World((seed, number), chosen)


def at(world: World, **cells: str) -> World:
    """The world with some of its cells chosen."""
    return replace(world, factors=world.factors | cells)


def constants(world: World, drive: Drive) -> Constants:
    """The motor of this world."""
    found = drive.constants
    if world.factors["motor"] != "the file's":
        off = world.rng(1).uniform(0.9, 1.1, 10)
        off[5] = 1.0  # alpha is copper's
        named = zip(Constants._fields, found, off, strict=False)
        found = found._replace(**{name: value * share for name, value, share in named})
    return found._replace(drop=drive.drop_V) if world.factors["lacks"] != "nothing" else found


def record(world: World, drive: Drive) -> Recorded:
    """Drive the motor and measure it."""
    kind, rate = world.factors["excitation"], float(world.factors["rate"])
    rng = world.rng(2)
    late = world.factors["start"] == "late"
    seconds = min((600.0 if kind == "constant" else 150.0), MOST / rate) * (1.5 if late else 1.0)
    n = int(seconds * rate)
    time = np.arange(n) / rate
    if world.factors["jitter"] != "none":
        time[1:] += 0.05 / rate * world.rng(3).uniform(-1, 1, n - 1)
    rest = float(rng.uniform(0.5, 3.0))
    voltage = _voltage(kind, time, rest, rng) * (drive.rated_V / 240.0)
    reference, loop = None, OPEN
    if kind == "loop":
        m = drive.constants
        reference = 0.85 * voltage / m.ke
        pace = m.R * m.J / m.ke**2
        # No faster than the rotor follows within a few samples.
        loop = Loop(min(2.14 * m.ke, rate * m.J / 4), 1.125 * m.ke / pace, drive.rated_V)
    load = _stretches(time, rng, 2.0, 60.0, lambda r: r.uniform(0.0, 1.4) * drive.rated_Nm)
    driven = world.factors["load"] == "drive"
    torque = _stretches(time, rng, 2.0, 60.0, lambda r: r.uniform(-0.6, 0.6) * drive.rated_Nm) * driven
    brake = load * (0.1 if driven else 0.15 if kind == "creep" else 1.0)
    motor = constants(world, drive)
    start = np.array(
        [0.0, 0.0, 0.0 if world.factors["start"] == "cold" else rng.uniform(0.25, 1.0) * drive.rise_K]
    )
    held = world.factors["between"] == "held" or kind == "loop"
    states, voltage = run(motor, time, voltage, held, brake, torque, start, reference, loop)
    first = n // 3 if late else 0
    shaft = motor.at_the_shaft(brake, torque, states[:, 1])
    return _measured(
        world, drive, motor, time[first:], voltage[first:], states[first:], (brake + torque)[first:], shaft[first:], rate
    )  # fmt: skip


def _measured(
    world: World,
    drive: Drive,
    motor: Constants,
    time: Array,
    voltage: Array,
    states: Array,
    load: Array,
    shaft: Array,
    rate: float,
) -> Recorded:
    rng = world.rng(4)
    noise_V, noise_A = _noise(world, rng)
    sds = noise_V * drive.noise_V, noise_A * drive.noise_A
    ripple = 0.0004 * drive.scale_A if world.factors["excitation"] == "dither" else 0.0
    channels = []
    for true, sd, scale, more in (
        (voltage, sds[0], drive.scale_V, 0.0),
        (states[:, 0], sds[1], drive.scale_A, ripple),
    ):
        noise = rng.standard_normal(len(true))
        if world.factors["colour"] == "coloured":
            # White through a first-order lag of one to ten milliseconds, as of an anti-aliasing filter or a supply.
            keep = np.exp(-1.0 / (rate * np.exp(rng.uniform(np.log(1e-3), np.log(1e-2)))))
            noise = _lagged(noise, keep) * np.sqrt(1 - keep * keep)
        seen = true + sd * noise + more * np.sign(rng.standard_normal(len(true)))
        if world.factors["converter"] != "exact":
            step = 2 * scale / 2 ** int(world.factors["converter"][:2])
            seen = step * np.round(seen / step)
        channels.append(seen)
    time = time - time[0]
    rise = states[:, 2]
    truth = np.column_stack([states[:, 1], rise, motor.R * (1 + motor.alpha * rise)])
    excited = (np.abs(voltage) > drive.rated_V / 50) | (np.abs(states[:, 0]) > drive.rated_A / 15)
    begun = time[int(np.argmax(excited))] if excited.any() else time[-1]
    ambient = np.full(len(time), rng.uniform(0.0, 40.0))
    seen_V, seen_A = channels
    return Recorded(
        time, seen_V, seen_A, ambient, truth, time >= begun + 10.0, *sds, load, voltage, states[:, 0], shaft, motor,
        drive.sizes,
    )  # fmt: skip


def noise(world: World) -> tuple[float, float]:
    """Noise of voltage and current, in multiples of the drive's."""
    return _noise(world, world.rng(4))


def _noise(world: World, rng: np.random.Generator) -> tuple[float, float]:
    low, high = map(float, world.factors["noise"].split("-"))
    voltage = np.exp(rng.uniform(np.log(low), np.log(high)))
    return float(voltage), float(voltage * np.exp(rng.uniform(-np.log(2), np.log(2))))


def _lagged(white: Array, keep: float) -> Array:
    return np.asarray(lfilter([1.0], [1.0, -keep], white))


def _stretches(
    time: Array,
    rng: np.random.Generator,
    shortest: float,
    longest: float,
    draw: Callable[[np.random.Generator], float],
) -> Array:
    """Piecewise constant: stretches of random length, their values drawn."""
    out, begin = np.zeros(len(time)), 0.0
    while begin < time[-1]:
        length = np.exp(rng.uniform(np.log(shortest), np.log(longest)))
        out[np.searchsorted(time, begin) :] = draw(rng)
        begin += length
    return out


def _voltage(kind: str, time: Array, rest: float, rng: np.random.Generator) -> Array:
    """The voltage (or the speed wanted, as a voltage) of an excitation of a motor for 240 V, 0 for the first `rest` s."""
    if kind == "constant":
        return np.where(time < rest, 0.0, rng.uniform(30.0, 240.0))
    points, values, t = [0.0, rest], [0.0, 0.0], rest
    waves = np.zeros(len(time))
    while t < time[-1]:
        length = np.exp(rng.uniform(0.0, np.log(60.0)))
        new = rng.uniform(30.0, 240.0) if rng.random() > 0.15 else 0.0
        if kind == "creep":
            new = rng.uniform(2.0, 20.0) if rng.random() > 0.15 else 0.0
        ramp = rng.uniform(0.0, 0.5) * length if kind in ("ramps", "creep") else 1e-6
        if kind == "loop" and rng.random() < 0.5:
            ramp = rng.uniform(0.1, 0.5) * length
        if kind == "sinusoids":
            new, ramp = rng.uniform(60.0, 180.0), 0.3 * length
            part = (time >= t) & (time < t + length)
            hertz = np.exp(rng.uniform(np.log(0.05), np.log(5.0)))
            waves[part] = rng.uniform(3.0, 55.0) * np.sin(2 * np.pi * hertz * (time[part] - t))
        points += [t + ramp, t + length]
        values += [new, new]
        t += length
    voltage = np.interp(time, points, values) + waves
    if kind == "dither":
        bits = rng.choice([-1.0, 1.0], int(time[-1] / 0.05) + 2)
        voltage += 0.02 * 240.0 * bits[(time / 0.05).astype(int)] * (voltage > 0)
    return voltage
