"""One case: a specimen of a motor, how it was driven, what is hidden in it, and what its sensors wrote down."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from helpers.hidden import effects as hidden_effects
from helpers.hidden import plant
from helpers.hidden.excitation import Programme, programme
from helpers.hidden.motors import MOTORS, HiddenMotor
from helpers.hidden.plant import Array
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

OUTPUTS = ("current", "speed", "temperature")
CHANNEL_SETS = {
    "all": ("voltage", "current", "speed", "temperature", "load_torque"),
    "no_torque": ("voltage", "current", "speed", "temperature"),
    "no_temperature": ("voltage", "current", "speed", "load_torque"),
    "voltage_current": ("voltage", "current"),
}
HEADINGS = {
    "voltage": "voltage_V", "current": "current_A", "speed": "speed_rad_s", "temperature": "temperature_C",
    "load_torque": "load_torque_Nm",
}  # fmt: skip
# How often a turn of the shaft what goes with its angle comes round again.
PERIODS: Mapping[str, Callable[[Mapping[str, float]], float]] = {
    "commutation_ripple": lambda shape: shape["ripple_N"],
    "cogging_torque": lambda shape: shape["cog_N"],
    "unbalance_torque": lambda shape: 1.0,
}
# By so much of its period at most that goes on in a step of the integration. The error that leaves is less than a thousandth
# of what goes with the angle; of a ripple at four steps a sample it is more than a tenth (`test_hidden_generator.py`).
TURNS_RAD = 0.25
# No motor turns this many times as fast as it is rated.
FASTEST = 1.6
# Purposes of the random streams of a case; each draws from its own, so that a changed case keeps the others.
_SPECIMEN, _SHAPE, _PROGRAMME, _NOISE, _TORQUE, _CONTACT, _START, _DECOY = range(8)


@dataclass(frozen=True)
class Case:
    """What the plan says of a case; `hidden` holds (name, multiple of the detectable size)."""

    id: str
    seed: int
    motor: str
    kind: str  # none, single, pair, outside
    hidden: tuple[tuple[str, float], ...] = ()
    noise: float = 0.01
    noise_kind: str = "white"  # white, coloured, 12bit, 10bit
    records: str = "both"  # fast, slow, both
    excitation: str = "rich"
    channels: str = "all"
    pwm_ripple: bool = False
    stamped: bool = True  # whether the jittering instants are written down, or nominal ones
    small: bool = False

    def rng(self, *purpose: int) -> np.random.Generator:
        """The random stream of a purpose."""
        return np.random.default_rng([self.seed, *purpose])

    def of_motor(self) -> HiddenMotor:
        """The motor."""
        return MOTORS[self.motor]

    def as_json(self) -> dict[str, object]:
        """For the plan."""
        return asdict(self)


@dataclass(frozen=True)
class Sized:
    """A hidden effect with its size (in the unit of the catalogue's parameter) and its shape."""

    name: str
    size: float
    shape: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Record:
    """How one recording of a case is driven; `slow` ones are for heat."""

    slow: bool
    drive: Programme
    disturbance: Array  # unmeasured torque N m
    start: Array
    locked: bool = False
    open_from_s: float = np.inf  # the terminals are open from then on


def records_of(case: Case) -> list[Record]:
    """The recordings of a case, the fast one first."""
    motor = case.of_motor()
    loaded = "load_torque" in CHANNEL_SETS[case.channels]
    found = []
    for number, slow in enumerate((False, True)):
        if case.records == ("fast" if slow else "slow"):
            continue
        seconds, dt = _span(case, slow)
        drive = programme(motor, case.excitation, seconds, dt, slow, loaded, case.rng(_PROGRAMME, number))
        rng = case.rng(_TORQUE, number)
        sd = motor.torque_Nm * (0.01 if case.noise_kind == "coloured" else 0.002)
        keep = np.exp(-dt / 1.0)
        wander = (
            lfilter([1.0], [1.0, -keep], rng.standard_normal(len(drive.load))) * sd * np.sqrt(1 - keep**2)
        )
        start = case.rng(_START, number)
        hot = not slow and case.records == "fast" and start.random() < 0.4
        theta = start.uniform(0.2, 0.6) * motor.rise_K if hot else start.uniform(0.0, 2.0)
        x0 = plant.rest(theta, 0.8 * theta, 0.7 * theta)
        found.append(Record(slow, drive, wander - wander.mean(), x0))
    return found


def _span(case: Case, slow: bool) -> tuple[float, float]:
    if slow:
        return (10_800.0 if case.motor == "frame_240V" or not case.small else 3600.0), (
            1.0 if case.small else 0.1
        )
    return (20.0, 0.002) if case.small else (90.0, 0.001)


def specimen(case: Case) -> dict[str, float]:
    """The textbook parameters of the motor in hand."""
    return case.of_motor().drawn(case.rng(_SPECIMEN))


def shaped(case: Case, name: str) -> dict[str, float]:
    """The shape of a hidden effect of this case."""
    names = (*hidden_effects.CATALOGUE, *hidden_effects.OUTSIDE)
    if name not in names:
        return {}
    return hidden_effects.shape(name, case.of_motor(), case.rng(_SHAPE, names.index(name)))


def build(
    case: Case, record: Record, textbook: Mapping[str, float], hidden: list[Sized]
) -> tuple[Array, Array]:
    """Plant parameters and inputs [n, 5] of a record with `hidden` in it, the unmeasured torque left out."""
    drive = record.drive
    n = len(drive.load)
    time = np.arange(n) * drive.dt
    inputs = np.zeros((n, plant.INPUTS))
    inputs[:, plant.VOLTAGE], inputs[:, plant.LOAD], inputs[:, plant.FLUX] = drive.voltage, drive.load, 1.0
    values = dict(textbook)
    opened = time >= record.open_from_s
    inputs[opened, plant.VOLTAGE] = 0.0
    inputs[opened, plant.SERIES] = 1e5 * values["R"]
    for effect in hidden:
        entry = hidden_effects.lookup(effect.name, case.of_motor())
        if ":" in entry.key or (record.slow and "angle" in entry.needs):
            continue  # a sensor's fault is not the plant's; a slow record averages out what goes with the angle
        shape = dict(effect.shape)
        values |= {name: value for name, value in shape.items() if name in plant.INDEX}
        if entry.key:
            values[entry.key] = effect.size
        if effect.name == "ambient_drift":
            inputs[:, plant.AMBIENT] = effect.size * (1 - np.exp(-time / shape["drift_tau"]))
        elif effect.name == "thermostat_fan":
            values["thermostat_off"] = 0.7 * shape["thermostat_on"]
        elif effect.name == "shaft_backlash":
            share = shape["shaft_share"]
            reduced = values["J"] * share * (1 - share)
            values["shaft_k"] = (2 * np.pi * shape["shaft_hz"]) ** 2 * reduced
            # A tenth of critical damping at the twist of rated torque.
            damping = 2 * 0.1 * 2 * np.pi * shape["shaft_hz"] * reduced
            values["shaft_c"] = damping * values["shaft_k"] / case.of_motor().torque_Nm
        elif effect.name == "demagnetisation_step":
            if not record.slow or case.records == "slow":
                inputs[time > shape["step_at"] * time[-1], plant.FLUX] = 1 - effect.size
        elif effect.name == "loose_connector":
            inputs[:, plant.SERIES] += effect.size * _telegraph(case, record, n, shape)
        elif effect.name == "soft_presliding":
            values["bristle_k"] = effect.size / shape["presliding_rad"]
        elif effect.name == "running_in":
            values["run_in_tau"] = shape["run_in_share"] * time[-1]
    if record.locked:
        values["tau_c"] = 1e9
    return plant.vector(**values), inputs


def _telegraph(case: Case, record: Record, n: int, shape: Mapping[str, float]) -> Array:
    rng = case.rng(_CONTACT, int(record.slow))
    mean = shape["contact_s"] * (100.0 if record.slow else 1.0) / record.drive.dt
    state, out, at = 0.0, np.zeros(n), 0
    while at < n:
        length = 1 + int(rng.exponential(mean if state else mean * (1 / shape["contact_share"] - 1)))
        out[at : at + length] = state
        at, state = at + length, 1 - state
    return out


def substeps(case: Case, record: Record, hidden: Sequence[Sized] = ()) -> int:
    """Integration steps a sample: more where something hidden goes with the angle of a shaft that turns fast."""
    if record.slow:
        return 10 if case.small else 4
    turns = max((PERIODS[one.name](one.shape) for one in hidden if one.name in PERIODS), default=0.0)
    fast = turns * FASTEST * case.of_motor().speed_rad_s * record.drive.dt
    return max(4 if case.small else 2, math.ceil(fast / TURNS_RAD))


def run_truth(
    case: Case, record: Record, textbook: Mapping[str, float], hidden: list[Sized]
) -> tuple[Array, Array]:
    """States at all substeps and the inputs [n, 5] as they truly were, with unmeasured torque and controlled voltage."""
    p, inputs = build(case, record, textbook, hidden)
    inputs[:, plant.LOAD] += record.disturbance
    drive = record.drive
    states = plant.simulate(
        drive.dt,
        inputs,
        record.start,
        p,
        substeps(case, record, hidden),
        drive.reference,
        drive.controller,
        between=True,
    )
    if not np.isfinite(states).all():
        raise FloatingPointError(f"{case.id}: the simulated motor blew up")
    return states, inputs


def true_channels(case: Case, record: Record, states: Array, inputs: Array) -> dict[str, Array]:
    """What ideal sensors would show, without the unmeasured torque: inputs at the samples, the rest as `states` is."""
    at_samples = states[:: (len(states) - 1) // (len(inputs) - 1)]
    voltage = inputs[:, plant.VOLTAGE].copy()
    opened = np.arange(len(voltage)) * record.drive.dt >= record.open_from_s
    # Behind the open switch the terminals show the back-EMF.
    voltage[opened] -= inputs[opened, plant.SERIES] * at_samples[opened, plant.I]
    # A locked shaft's torque sensor shows what the lock bears.
    load = specimen(case)["ke"] * at_samples[:, plant.I] if record.locked else record.drive.load
    return {
        "voltage": voltage, "current": states[:, plant.I], "speed": states[:, plant.W],
        "temperature": states[:, plant.THETA] + case.of_motor().ambient_C, "load_torque": load,
    }  # fmt: skip


def lagged(y: Array, dt: float, tau: float) -> Array:
    """First-order lag of a signal that is linear between samples, exactly: tau ds/dt = y - s, at rest before."""
    keep = np.exp(-dt / tau)
    # s[k+1] = keep s[k] + (a) y[k] + (c) y[k+1] for a ramp between the samples.
    late = 1 - tau / dt * (1 - keep)
    early = 1 - keep - late
    return y[0] + lfilter([late, early], [1.0, -keep], y - y[0])


def faulty(channel: str, y: Array, dt: float, hidden: list[Sized]) -> Array:
    """A channel as its sensor shows it, before noise."""
    for effect in hidden:
        if effect.name.startswith(f"{channel}_sensor_"):
            kind = effect.name.rpartition("_")[2]
            y = {
                "gain": lambda y, s: y * (1 + s),
                "offset": lambda y, s: y + s,
                "lag": lambda y, s: lagged(y, dt, s),
            }[kind](y, effect.size)
    return y


def measured(
    case: Case, record: Record, channels: Mapping[str, Array], hidden: list[Sized]
) -> tuple[Array, dict[str, Array]]:
    """Time stamps and channels as recorded: sensor faults, jitter, converter ripple, noise, quantisation."""
    motor, dt = case.of_motor(), record.drive.dt
    rng = case.rng(_NOISE, int(record.slow))
    n = len(record.drive.load)
    grid = np.arange(n) * dt
    instants = grid + 0.01 * dt * np.clip(rng.standard_normal(n), -3, 3)
    instants[0] = max(instants[0], 0.0)
    span = {
        "voltage": 1.25 * motor.voltage_V, "current": 1.3 * motor.voltage_V / motor.textbook["R"],
        "speed": 1.6 * motor.speed_rad_s, "temperature": 160.0, "load_torque": 1.6 * motor.torque_Nm,
    }  # fmt: skip
    level = 0.002 if case.noise_kind in ("10bit", "12bit") else case.noise
    shown = {}
    # Every channel draws its noise whether or not it is recorded, so that a case with fewer channels keeps the rest.
    for channel in CHANNEL_SETS["all"]:
        fine = np.linspace(0, grid[-1], len(channels[channel]))
        y = faulty(channel, channels[channel], fine[1], hidden)
        # Current and speed are smooth between samples, inputs have their corners there.
        y = (
            CubicSpline(fine, y)(instants)
            if channel in ("current", "speed")
            else np.interp(instants, fine, y)
        )
        white = rng.standard_normal(n)
        drift = lfilter([1.0], [1.0, -0.95], rng.standard_normal(n)) * np.sqrt(1 - 0.95**2)
        phase = rng.uniform(-1, 1, n)
        noise = 0.5 * white + 0.87 * drift if case.noise_kind == "coloured" else white
        # Voltages are measured better than the rest: a divider, where the others are transducers.
        y = y + noise * level * motor.scale(channel) * (1 / 3 if channel == "voltage" else 1.0)
        if channel == "current" and case.pwm_ripple:
            duty = np.minimum(np.abs(channels["voltage"]) / motor.voltage_V, 1.0)
            y = y + phase * 0.03 * motor.current_A * 4 * duty * (1 - duty)
        if case.noise_kind in ("10bit", "12bit"):
            step = 2 * span[channel] / (1024 if case.noise_kind == "10bit" else 4096)
            y = np.clip(np.round(y / step) * step, -span[channel], span[channel])
        if channel in CHANNEL_SETS[case.channels]:
            shown[channel] = y
    return (instants if case.stamped else grid), shown


def decoys(case: Case, record: Record, time: Array, current: Array) -> dict[str, Array]:
    """Columns that have nothing to do with the motor: mains hum, a shuffled current, the speed of another run.

    They are named so that no reader takes them for a quantity. A decoy is accepted if a diagnosis names one of them, or
    if it changes its answer because of them, which a tool that regresses on every column of a file would do.
    """
    rng = case.rng(_DECOY, int(record.slow))
    motor = case.of_motor()
    n = len(time)
    other = lfilter([1.0], [1.0, -0.999], rng.standard_normal(n))
    return {
        "decoy_1": np.sin(2 * np.pi * 50 * time + rng.uniform(0, 6)) * motor.current_A,
        "decoy_2": rng.permutation(current),
        "decoy_3": other / (np.abs(other).max() + 1e-12) * motor.speed_rad_s,
    }


def write_csv(path: Path, columns: Mapping[str, Array]) -> None:
    """Write columns with six significant digits, time with microseconds."""
    names = list(columns)
    form = ",".join("%.6f" if name == "time_s" else "%.6g" for name in names)
    rows = np.column_stack([columns[name] for name in names])
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(names) + "\n")
        for start in range(0, len(rows), 20_000):
            block = rows[start : start + 20_000]
            file.write("\n".join(form % tuple(row) for row in block.tolist()) + "\n")
