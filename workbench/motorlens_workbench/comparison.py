"""How far a motor file is from recordings, and where: by channel, equation, operating region, time scale and shaft angle.

Nothing in the motor is fitted: the model runs freely, driven by the measured voltage, load and ambient, from the start that
fits all samples (`free_run`), or the beginning of a long recording (`long_recordings`). Which equation is to blame
is a question of its own: how much of the error of the free run a free force in that equation, and in no other, would take
away.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from motorlens_physics.estimate.free_run import FreeRun
from motorlens_physics.estimate.model import Model
from motorlens_physics.estimate.run import STATE_OF, UNIT_OF, prepare
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_physics.scenario import TimeConstants, time_constants
from motorlens_runtime.errors import DataError, ModelError
from motorlens_workbench.balances import EQUATIONS, missing_of
from motorlens_workbench.hypotheses.curves import free_curves
from motorlens_workbench.hypotheses.line import Line
from motorlens_workbench.long_recordings import PART, beside, block, is_long, means

Array = NDArray[np.float64]

_BALANCE = {"electrical": "voltage", "mechanical": "torque", "thermal": "heat"}
# Cells of the map of speed and current, in each direction; cells with fewer samples say nothing.
CELLS, FEWEST = 6, 20
# Share of the top speed below which the rotor counts as near standstill.
STANDSTILL = 0.02
# Error over noise floor up to which a model follows to the noise: less than half of what is seen is then missing physics,
# and the floor's own error is far smaller (`benchmarks/floors.py`).
FOLLOWS = 1.2
# No channel is measured to so little (A, rad/s, K): the least noise by which an error is divided.
NOISELESS = 1e-12


@dataclass(frozen=True)
class Overlay(FreeRun):
    """One recording and the model's free run on it, of whose states those that were not measured, and what each equation
    lacks."""

    missing: Mapping[str, NDArray[np.float32]]  # equation -> (N,) in the unit of `EQUATIONS`, as it is drawn

    def error_of(self, channel: str) -> Array:
        """(N,) measured less predicted; 0 where nothing was measured."""
        k = self.run.channels.index(channel)
        return np.where(self.run.valid, self.run.measured[:, k] - self.predicted[:, k], 0.0)

    @property
    def band_Hz(self) -> tuple[float, float]:
        """The lowest and the highest frequency of its spectra."""
        time = self.run.inputs.time_s
        samples = next_fast_len(len(time), real=True)
        lowest = (1 - 1 / samples) / float(time[-1] - time[0])
        return lowest, lowest * (samples // 2)

    def spectrum(self, channel: str) -> tuple[Array, Array]:
        """Frequencies (Hz) and power (unit^2, one-sided, sums to the mean square) of the error of a channel."""
        time = self.run.inputs.time_s
        # Evenly resampled, to as many samples as have a fast transform.
        even = np.linspace(time[0], time[-1], next_fast_len(len(time), real=True))
        power = _power(np.interp(even, time, self.error_of(channel)))
        return np.fft.rfftfreq(len(even), even[1] - even[0]), power

    @property
    def noise(self) -> Array:
        """(C,) the floor, in the order of `run.channels`; a channel at rest has none, and is given `NOISELESS`."""
        return np.maximum(self.floor, NOISELESS)


@dataclass(frozen=True)
class Channel:
    """Error of one channel over all recordings that hold it, in `unit`; `fit_percent` is 100 (1 - rmse / spread)."""

    unit: str
    rmse: float
    fit_percent: float
    bias: float
    largest: float
    noise_floor: float

    @property
    def times_noise(self) -> float:
        """The error in units of the floor."""
        return self.rmse / max(self.noise_floor, NOISELESS)


@dataclass(frozen=True)
class Equation:
    """One balance driven by the measured others: what it lacks (rms, in `unit`), and its share of the error
    that free forces would remove."""

    unit: str
    rms: float
    share: float
    testable: bool
    why: str = ""


@dataclass(frozen=True)
class Region:
    """A part of the operating range: which, how many samples, error in standard deviations of the noise."""

    within: Mapping[str, tuple[float, float]]
    rms_in_sigma: float
    samples: int


@dataclass(frozen=True)
class Comparison:
    """All that `motorlens compare` found; `notes` are what was done to long recordings, in words."""

    file: MotorFile
    overlays: tuple[Overlay, ...]
    channels: Mapping[str, Channel]
    equations: Mapping[str, Equation]
    map: tuple[Region, ...]  # speed by current
    regions: Mapping[str, Region]  # in words: "forwards", "near standstill", "warmest third", ...
    bands: Mapping[str, Mapping[str, float]]  # channel -> time scale -> share of the error's power
    orders: tuple[
        tuple[float, float], ...
    ]  # (order of the shaft, amplitude in rad/s) of the speed error, strongest first
    notes: tuple[str, ...] = ()

    @property
    def worst(self) -> str:
        """The channel with the largest error in units of its floor."""
        return max(self.channels, key=lambda name: self.channels[name].times_noise)

    @property
    def follows(self) -> bool:
        """Whether the model follows the recordings to their noise."""
        return self.channels[self.worst].times_noise < FOLLOWS


def compare(
    file: MotorFile, recordings: Sequence[Recording], progress: Callable[[str], None] = lambda text: None
) -> Comparison:
    """Run the model beside recordings and say where they part.

    Args:
        file: the motor.
        recordings: of it.
        progress: is told what is done next.

    Raises:
        DataError: a recording holds no measured output, or is too short.
        ModelError: the model cannot be simulated on one of them; the message says which.
    """
    try:
        model, whole = beside(file, recordings, progress)
    except ModelError as error:
        names = ", ".join(recording.name for recording in recordings)
        raise ModelError(f"{names}: the model cannot follow this recording: {error}") from None
    progress("looking where it fails")
    overlays: list[Overlay] = []
    for r in range(len(recordings)):
        overlays.append(_overlay(model, r, whole.pop(0)))
    measured = [channel for channel in STATE_OF if any(channel in o.run.channels for o in overlays)]
    return Comparison(
        file,
        tuple(overlays),
        {channel: _channel(channel, overlays) for channel in measured},
        _equations(model, recordings, overlays),
        _map(overlays),
        _regions(overlays),
        {channel: _bands(channel, overlays, time_constants(file.motor)) for channel in measured},
        _orders(overlays),
        tuple(_note(one) for one in recordings if is_long(one)),
    )


def _overlay(model: Model, r: int, one: FreeRun) -> Overlay:
    missing = missing_of(model, one.run, r, one.trajectory, one.predicted)
    drawn = {name: missing.pop(name).astype(np.float32) for name in EQUATIONS}
    # What was measured is drawn and sorted by as measured: of the simulation the rest is kept.
    seen = {STATE_OF[channel] for channel in one.run.channels}
    unseen = {name: y.copy() for name, y in one.trajectory.states.items() if name not in seen}
    return Overlay(one.run, replace(one.trajectory, states=unseen), one.predicted, one.floor, drawn)


def _note(recording: Recording) -> str:
    step_s = block(recording) * recording.period_s
    return (
        f"{recording.name}: its start is that of the first {PART} samples; delays and noise are those of the {PART} in "
        f"which the inputs change most; the shares of the equations are those of means over {step_s:.3g} s; "
        f"the errors are of all {len(recording)}"
    )


def _channel(channel: str, overlays: Sequence[Overlay]) -> Channel:
    holding = [(o, o.run.channels.index(channel)) for o in overlays if channel in o.run.channels]
    error = np.concatenate([o.error_of(channel)[o.run.valid] for o, _ in holding])
    measured = np.concatenate([o.run.measured[o.run.valid, k] for o, k in holding])
    if not len(error):
        raise DataError(f"{holding[0][0].run.name}: no row holds all measured outputs")
    rmse = float(np.sqrt(np.mean(error**2)))
    spread = float(np.std(measured))
    floor = float(np.sqrt(np.mean([o.noise[k] ** 2 for o, k in holding])))
    fit = 100 * (1 - rmse / spread) if spread > 0 else 0.0
    return Channel(UNIT_OF[channel], rmse, fit, float(np.mean(error)), float(np.abs(error).max()), floor)


def _equations(
    model: Model, recordings: Sequence[Recording], overlays: Sequence[Overlay]
) -> dict[str, Equation]:
    reasons = {name: _untestable(name, overlays) for name in EQUATIONS}
    tested = [name for name in EQUATIONS if not reasons[name]]
    removable = _removable(model, recordings, overlays, tested)
    whole = sum(removable.values())
    found = {}
    for name, unit in EQUATIONS.items():
        lacking = np.concatenate([o.missing[name] for o in overlays])
        rms = float(np.sqrt(np.mean(lacking**2, dtype=np.float64)))
        share = removable.get(name, 0.0) / whole if whole > 0 else 0.0
        found[name] = Equation(unit, rms, share, not reasons[name], reasons[name])
    return found


def _line(model: Model, r: int, recording: Recording, overlay: Overlay) -> Line:
    """The linear problem of a recording, along the means of its blocks if it is long."""
    if not is_long(recording):
        return Line.of(model, overlay.run, r, ())
    return Line.of(model, replace(prepare(means(recording), model.file), turns=overlay.run.turns), r, ())


def _removable(
    model: Model, recordings: Sequence[Recording], overlays: Sequence[Overlay], names: Sequence[str]
) -> dict[str, float]:
    """How much of the squared error, in units of the noise, only a free force in each of these equations takes away.

    The force is a sum of free curves against speed, current, temperature and time; it costs something beyond a tenth of
    what the equation carries at rated load.
    """
    rated, motor = model.file.rated, model.file.motor
    carried = {
        "electrical": rated.voltage_V,
        "mechanical": rated.torque_Nm,
        "thermal": motor.k0 * rated.rise_K,
    }
    lines = [
        _line(model, r, recording, o)
        for r, (recording, o) in enumerate(zip(recordings, overlays, strict=True))
    ]
    free = free_curves([line.trajectory for line in lines], [_BALANCE[name] for name in names])
    if not free:
        return {}
    owner = np.array(
        [name for curve in free for name in names if _BALANCE[name] == curve.balance for _ in curve.knots]
    )
    gram, gradient = np.zeros((len(owner), len(owner))), np.zeros(len(owner))
    for recording, line, overlay in zip(recordings, lines, overlays, strict=True):
        rows = line.run
        size = block(recording) * rows.every
        sigma = overlay.noise / np.sqrt(size)
        kept = rows.fresh()
        columns, at = np.empty((int(kept.sum()), len(sigma), len(owner))), 0
        for curve in free:
            columns[:, :, at : at + curve.width] = (
                rows.average(curve.columns(line))[kept] / sigma[None, :, None]
            )
            at += curve.width
        blocks = replace(overlay.run, every=size)
        errors = [blocks.average(overlay.error_of(channel)) for channel in blocks.channels]
        error = np.stack(errors, axis=1)[kept] / sigma
        flat = columns.reshape(-1, len(owner))
        gram += flat.T @ flat
        gradient += flat.T @ error.ravel()
    cost = np.diag([(0.1 * carried[name]) ** -2 for name in owner])

    def fall(of: NDArray[np.bool_]) -> float:
        if not of.any():
            return 0.0
        inside = np.ix_(of, of)
        return float(
            gradient[of] @ np.linalg.lstsq(gram[inside] + cost[inside], gradient[of], rcond=1e-14)[0]
        )

    everything = fall(np.ones(len(owner), dtype=bool))
    return {name: max(everything - fall(owner != name), 0.0) for name in names}


def _untestable(name: str, overlays: Sequence[Overlay]) -> str:
    """Why an equation cannot be tested on its own; empty if it can."""
    channels = {channel for o in overlays for channel in o.run.channels}
    needed = {
        "electrical": ("current", "speed"),
        "mechanical": ("current", "speed"),
        "thermal": ("temperature",),
    }[name]
    absent = [channel for channel in needed if channel not in channels]
    if absent:
        return f"{' and '.join(absent)} {'is' if len(absent) == 1 else 'are'} not measured"
    if name == "thermal" and "current" not in channels:
        return "current is not measured"
    return ""


def remark(name: str, overlays: Sequence[Overlay]) -> str:
    """What a tested equation takes for granted, in words; empty if nothing."""
    if name == "mechanical" and any("load_torque" not in o.run.known for o in overlays):
        return "the load torque was not measured and is taken as none"
    if name == "thermal" and any("ambient" not in o.run.known for o in overlays):
        return "the ambient was not measured and is taken from the rating plate"
    return ""


def _in_sigma(overlay: Overlay) -> Array:
    """(N,) error of a sample in standard deviations of the noise, over its channels."""
    channels = overlay.run.channels
    whole = np.zeros(len(overlay.run.valid))
    for channel, noise in zip(channels, overlay.noise, strict=True):
        whole += (overlay.error_of(channel) / noise) ** 2
    return np.sqrt(whole / len(channels))


def _state(overlay: Overlay, channel: str) -> Array:
    """(N,) a measured output, or the simulated one where it was not measured."""
    run = overlay.run
    if channel in run.channels:
        return run.measured[:, run.channels.index(channel)]
    simulated = overlay.trajectory.states[STATE_OF[channel]]
    return simulated + overlay.trajectory.inputs.ambient_C if channel == "temperature" else simulated


def _pooled(overlays: Sequence[Overlay], channel: str) -> Array:
    return np.concatenate([_state(o, channel)[o.run.valid] for o in overlays])


def _map(overlays: Sequence[Overlay]) -> tuple[Region, ...]:
    error = np.concatenate([_in_sigma(o)[o.run.valid] for o in overlays])
    speed, current = _pooled(overlays, "speed"), _pooled(overlays, "current")
    edges = [_edges(speed), _edges(current)]
    at = [
        np.clip(np.searchsorted(e, y, side="right") - 1, 0, CELLS - 1)
        for e, y in zip(edges, (speed, current), strict=True)
    ]
    found = []
    for row in range(CELLS):
        for column in range(CELLS):
            inside = (at[0] == row) & (at[1] == column)
            if inside.sum() >= FEWEST:
                within = {"speed": _span(edges[0], row), "current": _span(edges[1], column)}
                found.append(_region(within, error[inside]))
    return tuple(found)


def _edges(y: Array) -> Array:
    """(CELLS + 1,) increasing over all of `y`, also where that never changes."""
    low, high = float(y.min()), float(y.max())
    margin = 0.0 if high > low else 0.5 * max(abs(low), 1.0)
    return np.linspace(low - margin, high + margin, CELLS + 1)


def _span(edges: Array, k: int) -> tuple[float, float]:
    return float(edges[k]), float(edges[k + 1])


def _region(within: Mapping[str, tuple[float, float]], error: Array) -> Region:
    return Region(within, float(np.sqrt(np.mean(error**2))), len(error))


def _regions(overlays: Sequence[Overlay]) -> dict[str, Region]:
    error = np.concatenate([_in_sigma(o)[o.run.valid] for o in overlays])
    speed, temperature = _pooled(overlays, "speed"), _pooled(overlays, "temperature")
    slow = STANDSTILL * float(np.abs(speed).max())
    third, two_thirds = np.percentile(temperature, (33.3, 66.7))
    low, high = float(temperature.min()), float(temperature.max())
    named = {
        "forwards": ({"speed": (slow, float(speed.max()))}, speed > slow),
        "backwards": ({"speed": (float(speed.min()), -slow)}, speed < -slow),
        "near standstill": ({"speed": (-slow, slow)}, np.abs(speed) <= slow),
        "coldest third": ({"temperature": (low, float(third))}, temperature <= third),
        "warmest third": ({"temperature": (float(two_thirds), high)}, temperature >= two_thirds),
    }
    return {
        name: _region(within, error[rows]) for name, (within, rows) in named.items() if rows.sum() >= FEWEST
    }


def _bands(channel: str, overlays: Sequence[Overlay], pace: TimeConstants) -> dict[str, float]:
    """Share of the error's power by time scale; the borders are the geometric means between the motor's time constants."""
    borders = (
        1 / (2 * np.pi * np.sqrt(pace.mechanical_s * pace.thermal_s)),
        1 / (2 * np.pi * np.sqrt(pace.electrical_s * pace.mechanical_s)),
    )
    power = {"thermal": 0.0, "mechanical": 0.0, "electrical": 0.0}
    for o in overlays:
        if channel not in o.run.channels:
            continue
        frequency, density = o.spectrum(channel)
        band = np.searchsorted(borders, frequency)
        for k, name in enumerate(power):
            power[name] += float(density[band == k].sum())
    whole = sum(power.values())
    return {name: value / whole if whole > 0 else 0.0 for name, value in power.items()}


def _power(y: Array) -> Array:
    power = np.abs(np.fft.rfft(y)) ** 2 / len(y) ** 2
    power[1 : -1 if len(y) % 2 == 0 else None] *= 2
    return np.asarray(power)


def _orders(
    overlays: Sequence[Overlay], highest: int = 60, fewest_turns: float = 3.0
) -> tuple[tuple[float, float], ...]:
    """The strongest whole orders of the shaft in the speed error, where the shaft's angle was measured."""
    found = np.zeros(highest)
    counted = 0
    for o in overlays:
        angle = o.run.angle
        if angle is None or "speed" not in o.run.channels:
            continue
        if abs(angle[-1] - angle[0]) < 2 * np.pi * fewest_turns:
            continue
        error = o.error_of("speed")
        waves = np.exp(-1j * np.outer(np.arange(1, highest + 1), angle))
        found += np.abs(waves @ error) * 2 / len(error)
        counted += 1
    if not counted:
        return ()
    strongest = np.argsort(-found)[:3]
    return tuple((float(k + 1), float(found[k] / counted)) for k in strongest)
