"""What a calibration fits: unknowns with priors, runs that are simulated, what they predict and its derivatives."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_physics.sensitivity import INITIAL, sensitivities
from motorlens_physics.simulation import Array, Inputs, simulate
from motorlens_physics.symbols import forcing_keys
from motorlens_runtime.errors import DataError, ModelError

# The state that each measured channel shows; a temperature is the rise above ambient.
STATE_OF_CHANNEL = {"current": "i", "speed": "w", "temperature": "theta"}
LOAD = "input.load_torque"
# A positive parameter without a stated deviation is known to a factor of about e^0.5.
LOG_PRIOR = 0.5


@dataclass(frozen=True)
class Unknown:
    """One number to be found.

    Attributes:
        key: of a parameter, "initial.STATE", or "input.load_torque".
        recording: the recording it belongs to; None for a parameter, which all share.
        run: for initial states, the run it belongs to.
        mean: centre of the prior, in natural units; the fit starts there.
        sd: of the prior, in coordinates: of the logarithm if `log`.
        log: whether the coordinate is the logarithm.
        bounds: in natural units.
    """

    key: str
    recording: int | None
    run: int | None
    mean: float
    sd: float
    log: bool
    bounds: tuple[float, float]

    def coordinate(self, value: float) -> float:
        """The coordinate of a value."""
        return float(np.log(value)) if self.log else value

    def value(self, coordinate: float) -> float:
        """The value at a coordinate, within bounds."""
        value = float(np.exp(coordinate)) if self.log else coordinate
        return min(max(value, self.bounds[0]), self.bounds[1])

    def slope(self, value: float) -> float:
        """Derivative of the value with respect to the coordinate."""
        return value if self.log else 1.0


@dataclass(frozen=True)
class Run:
    """A recording, or a window of one, that is simulated from an initial state of its own.

    Attributes:
        recording: index of the recording.
        rows: where in the recording it lies; neighbouring windows share a row.
        inputs: what acts on the motor, as recorded.
        measured: channel to (N,); missing samples are NaN.
        start: initial state at the centre of its prior.
    """

    recording: int
    rows: slice
    inputs: Inputs
    measured: Mapping[str, Array]
    start: Mapping[str, float]


def parameter_unknowns(file: MotorFile, free: Sequence[str]) -> list[Unknown]:
    """The free parameters with their priors: from the motor file's deviations, or else from their declarations.

    Raises:
        ModelError: a parameter that the motor file does not have, or that is stated by choice.
    """
    values = file.values()
    unknowns = []
    for key in free:
        if key not in values:
            raise ModelError(f"cannot fit {key!r}: {file.name} has {', '.join(values)}")
        meaning, value = file.meaning(key), values[key]
        if meaning.fixed:
            raise ModelError(f"cannot fit {key!r}: it is stated by choice, not measured")
        known = file.knowledge.get(key)
        log = meaning.null is None and meaning.bounds[0] >= 0 and value > 0
        if known is not None and known.sd:
            sd = known.sd / value if log else known.sd
        else:
            sd = LOG_PRIOR if log else meaning.sd(file.rated)
        unknowns.append(Unknown(key, None, None, value, sd, log, meaning.bounds))
    return unknowns


def runs_of(
    file: MotorFile, recordings: Sequence[Recording], *, held: bool, window_s: float | None
) -> list[Run]:
    """The runs that recordings are simulated in.

    Raises:
        DataError: a recording too short, or without any measured output.
    """
    runs = []
    for r, recording in enumerate(recordings):
        channels = recording.channels
        if len(recording) < 10:
            raise DataError(f"{recording.name}: {len(recording)} rows are too few to calibrate on")
        if not any(channel in channels for channel in STATE_OF_CHANNEL):
            raise DataError(f"{recording.name}: neither current, speed nor temperature was measured")
        nothing = np.zeros(len(recording))
        ambient = channels.get("ambient", nothing + file.rated.ambient_C)
        inputs = Inputs(
            recording.time_s, channels["voltage"], channels.get("load_torque", nothing), ambient, held
        )
        for rows in _windows(recording.time_s, window_s):
            part = Inputs(
                inputs.time_s[rows],
                inputs.voltage_V[rows],
                inputs.load_torque_Nm[rows],
                inputs.ambient_C[rows],
                held,
            )
            measured = {c: channels[c][rows] for c in STATE_OF_CHANNEL if c in channels}
            runs.append(Run(r, rows, part, measured, _start(file, part, measured)))
    return runs


def local_unknowns(
    file: MotorFile, runs: Sequence[Run], *, fit_load: bool, start_sd_K: float
) -> list[Unknown]:
    """The unknowns of each run, its initial states, and of each recording, its load if asked for."""
    unknowns = []
    everything = (-np.inf, np.inf)
    extra = {name: state for effect in file.motor.effects for name, state in effect.states.items()}
    first_runs: set[int] = set()
    for k, run in enumerate(runs):
        first = run.recording not in first_runs
        for state, mean in run.start.items():
            sd = _start_sd(file, run, state, start_sd_K, extra.get(state)) if first else 1e3
            if sd > 0:
                unknowns.append(Unknown(INITIAL + state, run.recording, k, mean, sd, False, everything))
        if fit_load and first:
            unknowns.append(Unknown(LOAD, run.recording, None, 0.0, file.rated.torque_Nm, False, everything))
        first_runs.add(run.recording)
    return unknowns


def _windows(time_s: Array, window_s: float | None) -> list[slice]:
    if window_s is None:
        return [slice(0, len(time_s))]
    count = max(1, round((time_s[-1] - time_s[0]) / window_s))
    edges = np.searchsorted(time_s, np.linspace(time_s[0], time_s[-1], count + 1)[1:-1])
    marks = [0, *(int(edge) for edge in edges), len(time_s) - 1]
    return [slice(a, b + 1) for a, b in pairwise(marks) if b - a >= 2]


def _start(file: MotorFile, inputs: Inputs, measured: Mapping[str, Array]) -> dict[str, float]:
    """The initial state as far as the channels show it; else at rest, cold, without current."""
    motor = file.motor
    start = dict(motor.states())

    def first(channel: str) -> float | None:
        values = measured.get(channel)
        valid = np.empty(0) if values is None else values[:20][np.isfinite(values[:20])]
        return float(valid[0]) if valid.size else None

    current, speed, temperature = first("current"), first("speed"), first("temperature")
    if temperature is not None:
        start["theta"] = temperature - float(inputs.ambient_C[0])
    if current is not None:
        start["i"] = current
    if speed is not None:
        start["w"] = speed
        if abs(speed) <= max(4 * _roughness(measured["speed"]), 1e-3 * np.nanmax(np.abs(measured["speed"]))):
            start["w"] = 0.0  # what does not stand out of the noise rests
    elif current is not None:
        start["w"] = float((inputs.voltage_V[0] - motor.resistance(start["theta"]) * current) / motor.ke)
    if current is None and speed is not None:
        start["i"] = float((inputs.voltage_V[0] - motor.ke * speed) / motor.resistance(start["theta"]))
        if start["w"] == 0.0 and inputs.voltage_V[0] == 0.0:
            start["i"] = 0.0
    return start


def _roughness(y: Array) -> float:
    """Deviation of the white noise on a channel, from its second differences."""
    bends = np.abs(np.diff(y[np.isfinite(y)], 2))
    return float(1.4826 * np.median(bends) / np.sqrt(6)) if bends.size else 0.0


def _start_sd(file: MotorFile, run: Run, state: str, start_sd_K: float, extra: object) -> float:
    """How far the initial state may lie from where it is taken to start; 0: it does not."""
    scale = {"i": file.rated.current_A, "w": file.rated.speed_rad_s}
    if state == "w" and run.start["w"] == 0.0:
        return 0.0  # a rotor that rests, rests
    if state in scale:
        return scale[state]
    if state == "theta":
        return 10 * start_sd_K if "temperature" in run.measured else start_sd_K
    return start_sd_K if getattr(extra, "unit", "") == "K" else 0.0


@dataclass(frozen=True)
class Assignment:
    """A run at some coordinates of the unknowns.

    Attributes:
        file: the motor file with their values.
        start: initial state.
        load: torque added to the load as recorded, in N m.
        own: indices of the unknowns that concern the run.
    """

    file: MotorFile
    start: Mapping[str, float]
    load: float
    own: tuple[int, ...]


def assign(file: MotorFile, unknowns: Sequence[Unknown], q: Array, k: int, run: Run) -> Assignment:
    """Run k at the coordinates q of the unknowns."""
    values: dict[str, float] = {}
    start, load, own = dict(run.start), 0.0, []
    for j, unknown in enumerate(unknowns):
        value = unknown.value(q[j])
        if unknown.recording is None:
            values[unknown.key] = value
        elif unknown.run == k:
            start[unknown.key.removeprefix(INITIAL)] = value
        elif unknown.run is None and unknown.recording == run.recording:
            load = value
        else:
            continue
        own.append(j)
    return Assignment(file.with_values(values), start, load, tuple(own))


def predict(run: Run, at: Assignment, *, tolerance: float) -> tuple[dict[str, Array], Array]:
    """What the sensors of a run show, by channel, and the states at its end."""
    trajectory = simulate(at.file.motor, _inputs(at.file, run, at.load), at.start, tolerance=tolerance)
    shown = {c: _shown(at.file, run, c, trajectory.states[STATE_OF_CHANNEL[c]]) for c in run.measured}
    return shown, np.array([trajectory.states[name][-1] for name in at.file.motor.states()])


def differentiate(
    run: Run, at: Assignment, keys: Sequence[str], *, tolerance: float
) -> tuple[dict[str, Array], dict[str, Array], Array, Array]:
    """As `predict`, with derivatives: by channel (N, keys), of the states at the end (n, keys)."""
    motor, states = at.file.motor, list(at.file.motor.states())
    known = {*forcing_keys(motor), *(INITIAL + name for name in states)}
    analytic = [key for key in keys if key in known]
    trajectory, slope = sensitivities(
        motor, _inputs(at.file, run, at.load), at.start, analytic, tolerance=tolerance
    )
    differences = {key: _difference(run, at, key, tolerance) for key in keys if key not in known}
    shown, slopes = {}, {}
    for channel in run.measured:
        state = STATE_OF_CHANNEL[channel]
        y = trajectory.states[state]
        shown[channel] = _shown(at.file, run, channel, y)
        slopes[channel] = np.empty((y.size, len(keys)))
        for j, key in enumerate(keys):
            own = differences[key][channel] if key in differences else None
            slopes[channel][:, j] = (
                _along(at.file, run, channel, y, slope[key][state]) if own is None else own
            )
    end = np.array([trajectory.states[name][-1] for name in states])
    ends = [[slope[key][name][-1] if key in known else 0.0 for key in keys] for name in states]
    return shown, slopes, end, np.array(ends).reshape(len(states), len(keys))


def _inputs(file: MotorFile, run: Run, load: float) -> Inputs:
    """What acted on the motor, given what the sensors of the inputs showed."""
    inputs = run.inputs
    truth = {"voltage": inputs.voltage_V, "load_torque": inputs.load_torque_Nm}
    for sensor in reversed(file.sensors):
        if sensor.channel in truth:
            shown = truth[sensor.channel]
            truth[sensor.channel] = np.asarray(sensor.unread(shown, np.gradient(shown, inputs.time_s)))
    return replace(inputs, voltage_V=truth["voltage"], load_torque_Nm=truth["load_torque"] + load)


def _shown(file: MotorFile, run: Run, channel: str, y: Array) -> Array:
    """What the sensors of a channel show of the state behind it."""
    shown = y + run.inputs.ambient_C if channel == "temperature" else y
    for sensor in file.sensors:
        # Faults act on whole columns, a lag exactly; noise and converters are no part of what is expected.
        if sensor.channel == channel and sensor.switch() is not None:
            shown = sensor.record(run.inputs.time_s, shown, np.random.default_rng(0))
    return shown


def _along(file: MotorFile, run: Run, channel: str, y: Array, direction: Array) -> Array:
    """Derivative of what is shown along a direction of the state."""
    if not any(sensor.channel == channel for sensor in file.sensors):
        return direction
    size = float(np.max(np.abs(direction)))
    if size == 0.0:
        return direction
    step = 1e-6 * max(float(np.max(np.abs(y))), 1e-3) / size
    return (
        _shown(file, run, channel, y + step * direction) - _shown(file, run, channel, y - step * direction)
    ) / (2 * step)


def _difference(run: Run, at: Assignment, key: str, tolerance: float) -> dict[str, Array]:
    """Derivative with respect to a sensor's parameter, by a central difference of the whole prediction."""
    meaning, value = at.file.meaning(key), at.file.values()[key]
    step = 1e-4 * max(meaning.typical(at.file.rated), 1e-9)
    high, low = value + step, max(value - step, meaning.bounds[0])
    above, _ = predict(run, replace(at, file=at.file.with_values({key: high})), tolerance=tolerance)
    below, _ = predict(run, replace(at, file=at.file.with_values({key: low})), tolerance=tolerance)
    return {channel: (above[channel] - below[channel]) / (high - low) for channel in above}
