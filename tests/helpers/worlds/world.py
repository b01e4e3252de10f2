"""A world: how the motor is driven and loaded, what motor it is, and how voltage and current are measured; drawn from
a seed."""

from dataclasses import dataclass, replace

import numpy as np
from helpers.worlds.plant import OPEN, Array, Constants, Loop, run

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
    "lacks": ("nothing", "1.5 V drop"),
}
# What the shipped sensors were trained with, V and A; the worlds' noise is in multiples of it.
NOISE_V, NOISE_A = 0.48, 0.0509
RATED_V, RATED_NM = 240.0, 6.455
# Full scale of the converters, V and A.
SCALE_V, SCALE_A = 300.0, 75.0
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

    `counted` (N,): from ten seconds after the motor was first excited. `quiet_s` (N,): since the voltage or the load last
    stepped. `noise_V`, `noise_A`: of a sample. `brake_Nm` (N,): the true load.
    """

    time_s: Array
    voltage_V: Array
    current_A: Array
    ambient_C: Array
    truth: Array
    counted: Array
    noise_V: float
    noise_A: float
    load_Nm: Array
    constants: Constants


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


def constants(world: World) -> Constants:
    """The motor of this world."""
    found = Constants()
    if world.factors["motor"] != "the file's":
        off = world.rng(1).uniform(0.9, 1.1, 10)
        off[5] = 1.0  # alpha is copper's
        found = Constants(*(value * share for value, share in zip(found, [*off, 1.0], strict=True)))
    return found._replace(drop=1.5) if world.factors["lacks"] != "nothing" else found


def record(world: World) -> Recorded:
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
    voltage = _voltage(kind, time, rest, rng)
    reference, loop = None, OPEN
    if kind == "loop":
        reference = 0.85 * voltage / 0.9346
        loop = Loop(min(2.0, 0.0082 * rate), 8.0, RATED_V)
    load = _stretches(time, rng, 2.0, 60.0, lambda r: r.uniform(0.0, 1.4) * RATED_NM)
    drive = world.factors["load"] == "drive"
    torque = _stretches(time, rng, 2.0, 60.0, lambda r: r.uniform(-0.6, 0.6) * RATED_NM) * drive
    brake = load * (0.1 if drive else 0.15 if kind == "creep" else 1.0)
    motor = constants(world)
    start = np.array([0.0, 0.0, 0.0 if world.factors["start"] == "cold" else rng.uniform(20.0, 80.0)])
    held = world.factors["between"] == "held" or kind == "loop"
    states, voltage = run(motor, time, voltage, held, brake, torque, start, reference, loop)
    first = n // 3 if late else 0
    return _measured(
        world, motor, time[first:], voltage[first:], states[first:], (brake + torque)[first:], rate
    )


def _measured(world, motor, time, voltage, states, load, rate):
    rng = world.rng(4)
    low, high = map(float, world.factors["noise"].split("-"))
    factor = np.exp(rng.uniform(np.log(low), np.log(high)))
    sds = (factor * NOISE_V, factor * np.exp(rng.uniform(-np.log(2), np.log(2))) * NOISE_A)
    ripple = 0.004 * SCALE_A * 0.1 if world.factors["excitation"] == "dither" else 0.0
    channels = []
    for true, sd, scale, more in ((voltage, sds[0], SCALE_V, 0.0), (states[:, 0], sds[1], SCALE_A, ripple)):
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
    excited = (np.abs(voltage) > RATED_V / 50) | (np.abs(states[:, 0]) > 0.5)
    begun = time[int(np.argmax(excited))] if excited.any() else time[-1]
    ambient = np.full(len(time), rng.uniform(0.0, 40.0))
    return Recorded(time, *channels, ambient, truth, time >= begun + 10.0, *sds, load, motor)


def _lagged(white, keep):
    from scipy.signal import lfilter

    return lfilter([1.0], [1.0, -keep], white)


def _stretches(time, rng, shortest, longest, draw):
    """Piecewise constant: stretches of random length, their values drawn."""
    out, begin = np.zeros(len(time)), 0.0
    while begin < time[-1]:
        length = np.exp(rng.uniform(np.log(shortest), np.log(longest)))
        out[np.searchsorted(time, begin) :] = draw(rng)
        begin += length
    return out


def _voltage(kind, time, rest, rng):
    """The voltage (or the speed wanted, as a voltage) of an excitation, 0 for the first `rest` seconds."""
    if kind == "constant":
        return np.where(time < rest, 0.0, rng.uniform(30.0, RATED_V))
    points, values, t = [0.0, rest], [0.0, 0.0], rest
    waves = np.zeros(len(time))
    while t < time[-1]:
        length = np.exp(rng.uniform(0.0, np.log(60.0)))
        new = rng.uniform(30.0, RATED_V) if rng.random() > 0.15 else 0.0
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
        voltage += 0.02 * RATED_V * bits[(time / 0.05).astype(int)] * (voltage > 0)
    return voltage
