"""What a recording is compared with: a motor file, where each run started, and the run's own nuisances.

`predict` runs forwards and puts the sensors in between; `sensitivities_of` gives the same for a small change of every
parameter. A key names a parameter of the motor file ("R_a0", "coulomb_friction.tau_c", "speed_sensor_gain.gain"), or one of
a single run, written "NAME@RUN": its initial states, and what was not measured or not synchronised.

Friction is taken in its smooth form: a measured load is the torque that acts, noise included, also on a rotor at rest, and
derivatives exist everywhere.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from motorlens_physics.effect import Effect
from motorlens_physics.estimate.forcing import SETTLED
from motorlens_physics.estimate.mean_speed import Changes, mean_of, of_parameters, ramps_of
from motorlens_physics.estimate.run import STATE_OF, Run
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.sensitivity import Linearisation, differentiate, sensitivities
from motorlens_physics.sensor_model import SensorModel
from motorlens_physics.simulation import Inputs, Trajectory

Array = NDArray[np.float64]

# Relative error of the simulation: a hundredth of the noise of a good sensor. Noise on the voltage makes every sample a
# transient of its own, and the next decade would cost twice the time.
TOLERANCE = 1e-5


@dataclass(frozen=True)
class Model:
    """A motor file and what belongs to each run.

    Attributes:
        file: the motor, its effects and its sensors.
        own: per run, by name: "initial.STATE", "load" (N m, an unmeasured constant load), "ambient" (K, an unmeasured
            ambient), "skew.CHANNEL" (s, how late a channel is sampled).
        held: per run, whether voltage, load torque and ambient were held between samples, each.
        tolerance: relative error of the simulation.
    """

    file: MotorFile
    own: tuple[Mapping[str, float], ...]
    held: tuple[tuple[bool, bool, bool], ...] = field(default=())
    tolerance: float = TOLERANCE

    def values(self) -> dict[str, float]:
        """All parameters by key."""
        local = {f"{name}@{r}": value for r, own in enumerate(self.own) for name, value in own.items()}
        return {**self.file.values(), **local}

    def with_values(self, values: Mapping[str, float]) -> "Model":
        """A copy with some parameters changed."""
        shared = {key: value for key, value in values.items() if "@" not in key}
        own = [dict(one) for one in self.own]
        for key, value in values.items():
            name, _, r = key.partition("@")
            if r:
                own[int(r)][name] = value
        return replace(self, file=self.file.with_values(shared), own=tuple(own))


def without_angle(model: Model, run: Run) -> tuple[Effect, ...]:
    """What goes with the shaft angle, in a run of which that is not known: it averages out."""
    return () if run.turns else tuple(one for one in model.file.motor.effects if one.turns())


def motor_of(model: Model, run: Run) -> Motor:
    """The motor that is simulated: without what an unknown angle averages."""
    away, motor = without_angle(model, run), model.file.motor
    return replace(motor, effects=tuple(effect for effect in motor.effects if effect not in away))


def inputs_of(model: Model, run: Run, r: int) -> Inputs:
    """What truly acted on the motor if the model is right: sensor models of inputs undone, nuisances added."""
    own, shown = model.own[r], run.inputs
    held = model.held[r] if model.held else shown.hold
    voltage, load, ambient = shown.voltage_V, shown.load_torque_Nm, shown.ambient_C
    if run.corrections is not None:
        # Of what the sensors show, before their faults are undone: a gain must not make their noise smaller.
        voltage, load = voltage + run.corrections[:, 0], load + run.corrections[:, 1]
    voltage, load = _acted(model, run, voltage, load)
    # Of a long recording each array counts: what adds nothing makes no other.
    if "load" in own:
        load = load + own["load"]
    if "ambient" in own:
        ambient = ambient + own["ambient"]
    # An angle from a simulated speed would drift by whole teeth.
    turns = any(effect.turns() for effect in motor_of(model, run).effects)
    return replace(
        shown, voltage_V=voltage, load_torque_Nm=load, ambient_C=ambient, held=held,
        angle_rad=run.shaft if turns else None,
    )  # fmt: skip


def start_of(model: Model, r: int) -> dict[str, float]:
    """The initial states of a run; those of effects that are not named start at their default."""
    named = {name[8:]: value for name, value in model.own[r].items() if name.startswith("initial.")}
    known = model.file.motor.states()
    known.pop("phi", None)
    return {name: value for name, value in named.items() if name in known}


def predict(model: Model, run: Run, r: int) -> tuple[Trajectory, Array]:
    """Simulate a run: the trajectory, and what the sensors would show, (N, C).

    Raises:
        ModelError: the simulation cannot go on.
    """
    motor, inputs, start = motor_of(model, run), inputs_of(model, run, r), start_of(model, r)
    # With the machine code that sensitivities need as well.
    if run.mean_speed:
        trajectory, _, linear = differentiate(
            motor, inputs, start, (), tolerance=model.tolerance, smooth=True
        )
        return trajectory, shown(model, run, r, true_outputs(model, run, trajectory, linear))
    trajectory, _ = sensitivities(motor, inputs, start, (), tolerance=model.tolerance, smooth=True)
    return trajectory, shown(model, run, r, _stack(run, trajectory))


def shown(model: Model, run: Run, r: int, y: Array) -> Array:
    """(N, C) true outputs to what the sensors show, before converters make steps of it."""
    out = np.array(y, dtype=np.float64)
    for k, channel in enumerate(run.channels):
        out[:, k] = _skewed(model, run, r, channel, _sensed(model, run, channel, out[:, k]))
    return out


def _sensed(model: Model, run: Run, channel: str, y: Array) -> Array:
    """(N,) of a channel as its sensor has it when it is sampled."""
    for sensor in model.file.sensors:
        if sensor.channel == channel:
            y = _record(sensor, run.inputs.time_s, y)
    return y


def _skewed(model: Model, run: Run, r: int, channel: str, y: Array) -> Array:
    """(N, ...) of a channel as they are sampled, a part of a sample late."""
    skew = model.own[r].get(f"skew.{channel}", 0.0)
    if not skew or not y.size:
        return y
    return y - skew * _rate(y, run.inputs.time_s)


def _rate(y: Array, time_s: Array) -> Array:
    """Rate of change (N, ...) of columns, of the parabola through three samples; at the ends, of the line through two.

    As numpy's `gradient`, which makes many arrays of this size on the way.
    """
    rate = np.empty(y.shape)
    _write_rate(np.ascontiguousarray(y).reshape(len(y), -1), time_s, rate.reshape(len(y), -1))
    return rate


@njit(cache=True, nogil=True)
def _write_rate(y, time_s, rate):  # type: ignore[no-untyped-def]
    last = len(y) - 1
    for k in range(len(y)):
        before, after = time_s[k] - time_s[max(k - 1, 0)], time_s[min(k + 1, last)] - time_s[k]
        if k == 0:
            back, ahead = 0.0, 1.0 / after
        elif k == last:
            back, ahead = 1.0 / before, 0.0
        else:
            back, ahead = after / (before * (before + after)), before / (after * (before + after))
        for j in range(y.shape[1]):
            rate[k, j] = back * (y[k, j] - y[max(k - 1, 0), j]) + ahead * (y[min(k + 1, last), j] - y[k, j])


def through_sensors(model: Model, run: Run, r: int, columns: Array) -> Array:
    """(N, C, m) changes of true outputs to changes of what is shown; sensor models are affine, and skews linear."""
    out = columns
    for k, channel in enumerate(run.channels):
        for sensor in model.file.sensors:
            if sensor.channel != channel:
                continue
            out = out.copy() if out is columns else out
            zero = _record(sensor, run.inputs.time_s, np.zeros(len(out)))
            out[:, k] = _record(sensor, run.inputs.time_s, out[:, k]) - zero[:, None]
        if model.own[r].get(f"skew.{channel}"):
            out = out.copy() if out is columns else out
            out[:, k] = _skewed(model, run, r, channel, out[:, k])
    return out


def sensitivities_of(
    model: Model, run: Run, r: int, keys: Sequence[str]
) -> tuple[Trajectory, Array, Array, Linearisation]:
    """Trajectory, shown outputs (N, C), their derivatives (N, C, m) to parameters of the model, and the linearised motor.

    Keys of sensors and of nuisances are differentiated directly, those of the motor by the forward pass.
    """
    inputs, start = inputs_of(model, run, r), start_of(model, r)
    motor = motor_of(model, run)
    absent = tuple(f"{effect.name()}." for effect in without_angle(model, run))
    local = [key.partition("@")[0] if key.endswith(f"@{r}") else key for key in keys]
    of_motor = tuple(
        name
        for key, name in zip(keys, local, strict=True)
        if ("@" not in key and not _is_sensor(model, key) and not key.startswith(absent))
        or name.startswith("initial.")
    )
    trajectory, derivative, linear = differentiate(
        motor, inputs, start, of_motor, tolerance=model.tolerance, smooth=True
    )
    y = true_outputs(model, run, trajectory, linear)
    columns = np.zeros((len(y), len(run.channels), len(keys)))
    at: slice | list[int] = [j for j, name in enumerate(local) if name in of_motor]
    if at == list(range(len(of_motor))):
        at = slice(len(of_motor))  # written in one go, not one by one
    for c, channel in enumerate(run.channels if of_motor else ()):
        columns[:, c, at] = derivative[:, linear.states.index(STATE_OF[channel])]
        if channel == "speed" and run.mean_speed:
            speed, current = (derivative[:, linear.states.index(state)] for state in ("w", "i"))
            columns[:, c, at] = mean_of(linear).since_last(speed, current)
            # The same changes of current and speed bend it otherwise in another motor.
            states = trajectory.states
            changes = Changes(np.diff(states["i"]), np.diff(states["w"]))
            bent = of_parameters(motor, trajectory.inputs, states["theta"], changes)
            for key in bent.keys() & set(local):
                columns[1:, c, local.index(key)] += bent[key]
    outside = [
        key for key in keys if _is_sensor(model, key) and _sensor(model, key).channel not in run.channels
    ]
    for j, name in enumerate(local):
        if name == "load":
            braked = linear.respond(torque_Nm=-np.ones((len(y), 1)))
            columns[:, :, j] = changed_outputs(model, run, linear, braked)[:, :, 0]
        elif name == "ambient" and "temperature" in run.channels:
            columns[:, run.channels.index("temperature"), j] = 1.0
    columns = through_sensors(model, run, r, columns)
    out = shown(model, run, r, y)
    for j, (key, name) in enumerate(zip(keys, local, strict=True)):
        if name.startswith("skew."):
            k = run.channels.index(name[5:])
            columns[:, k, j] = -_rate(_sensed(model, run, name[5:], y[:, k]), run.inputs.time_s)
        elif _is_sensor(model, key):
            value = model.file.values()[key]
            step = 1e-3 * max(abs(value), model.file.meaning(key).sd(model.file.rated))
            nudged = model.with_values({key: value + step})
            if key not in outside:
                columns[:, :, j] = (shown(nudged, run, r, y) - out) / step
                continue
            other = inputs_of(nudged, run, r)
            moved = linear.respond(
                voltage_V=(other.voltage_V - inputs.voltage_V)[:, None] / step,
                torque_Nm=-(other.load_torque_Nm - inputs.load_torque_Nm)[:, None] / step,
                held=inputs.hold,
            )
            columns[:, :, j] = through_sensors(model, run, r, changed_outputs(model, run, linear, moved))[
                :, :, 0
            ]
    return trajectory, out, columns, linear


def error_of(model: Model, run: Run, r: int, difference: Array, linear: Linearisation) -> Array:
    """(N, C) the error beside the inputs as they were recorded, from that beside the corrected ones, linearised."""
    if run.corrections is None:
        return difference
    return difference + response_to_inputs(model, run, r, linear, *run.corrections.T)


def response_to_inputs(
    model: Model, run: Run, r: int, linear: Linearisation, voltage_V: Array, load_torque_Nm: Array
) -> Array:
    """(N, C) what the channels show more if the sensors of the inputs show so much more (N,), linearised."""
    voltage, load = run.inputs.voltage_V, run.inputs.load_torque_Nm
    acted = _acted(model, run, voltage + voltage_V, load + load_torque_Nm)
    added = np.column_stack(acted) - np.column_stack(_acted(model, run, voltage, load))
    moved = linear.respond(voltage_V=added[:, :1], torque_Nm=-added[:, 1:], held=model.held[r])
    return through_sensors(model, run, r, changed_outputs(model, run, linear, moved))[:, :, 0]


def as_shown(model: Model, run: Run, voltage_V: Array, load_torque_Nm: Array) -> tuple[Array, Array]:
    """Changes (N,) of what acted on the motor to what the sensors of the inputs make of them."""
    out = []
    for channel, y in (("voltage", voltage_V), ("load_torque", load_torque_Nm)):
        for sensor in model.file.sensors:
            if sensor.channel == channel and (channel == "voltage" or channel in run.known):
                time = run.inputs.time_s
                y = _record(sensor, time, y) - _record(sensor, time, np.zeros_like(y))
        out.append(y)
    return out[0], out[1]


def _acted(model: Model, run: Run, voltage_V: Array, load_torque_Nm: Array) -> tuple[Array, Array]:
    """What acted on the motor where its sensors show this, (N,) each."""
    time, load = run.inputs.time_s, load_torque_Nm
    if "load_torque" in run.known:  # a sensor that was not there shows nothing wrong
        load = _unread(model.file.sensors, "load_torque", time, load)
    return _unread(model.file.sensors, "voltage", time, voltage_V), load


def _sensor(model: Model, key: str) -> SensorModel:
    owner = key.rpartition(".")[0]
    return next(sensor for sensor in model.file.sensors if sensor.name() == owner)


def _is_sensor(model: Model, key: str) -> bool:
    owner = key.rpartition(".")[0]
    return any(sensor.name() == owner for sensor in model.file.sensors)


def _stack(run: Run, trajectory: Trajectory) -> Array:
    y = np.column_stack([trajectory.states[STATE_OF[channel]] for channel in run.channels])
    if "temperature" in run.channels:
        y[:, run.channels.index("temperature")] += trajectory.inputs.ambient_C
    return y


def true_outputs(model: Model, run: Run, trajectory: Trajectory, linear: Linearisation) -> Array:
    """(N, C) what the channels measure, before their sensors."""
    y = _stack(run, trajectory)
    if run.mean_speed:
        mean = mean_of(linear)
        speed = mean.since_last(trajectory.states["w"], trajectory.states["i"])
        speed[1:] += mean.along(ramps_of(linear, trajectory.inputs))
        y[:, run.channels.index("speed")] = speed
    return y


def changed_outputs(model: Model, run: Run, linear: Linearisation, states: Mapping[str, Array]) -> Array:
    """(N, C, m) by how much it changes if the states change (N, m) so much."""
    out = np.stack([states[STATE_OF[channel]] for channel in run.channels], axis=1)
    if run.mean_speed:
        mean = mean_of(linear).since_last(states["w"], states["i"])
        out[:, run.channels.index("speed")] = mean
    return out


def _record(sensor: SensorModel, time_s: Array, y: Array) -> Array:
    """What a sensor shows of samples (N,) or (N, m)."""
    # Only a lag looks at the history; its own filter is exact where the first-order form is not.
    if sensor.kind == "lag":
        shown = np.empty(y.shape)
        for j in np.ndindex(y.shape[1:]):
            shown[:, *j] = sensor.record(time_s, y[:, *j], np.random.default_rng(0))
        return shown
    return np.asarray(sensor.read(y, 0.0), dtype=np.float64)


def _unread(sensors: Sequence[SensorModel], channel: str, time_s: Array, y: Array) -> Array:
    for sensor in reversed(sensors):
        if sensor.channel == channel:
            y = sensor.unrecord(time_s, y)
    return y


def parts_of(file: MotorFile) -> tuple[Effect | SensorModel, ...]:
    """Effects and sensor models of a motor file."""
    parts: list[Effect | SensorModel] = [*file.motor.effects]
    parts += file.sensors
    return tuple(parts)


def with_effect(model: Model, effect: Effect) -> Model:
    """The model with an effect added; another part that warms with the winding starts nearly as warm."""
    warm = [f"initial.{state}" for state, what in effect.states.items() if what.kind == "rise"]
    own = [{**one, **{name: SETTLED * one["initial.theta"] for name in warm}} for one in model.own]
    return replace(
        model, file=replace(model.file, motor=model.file.motor.with_effect(effect)), own=tuple(own)
    )


def with_sensor(model: Model, sensor: SensorModel) -> Model:
    """The model with a sensor model added."""
    others = tuple(other for other in model.file.sensors if other.name() != sensor.name())
    return replace(model, file=replace(model.file, sensors=(*others, sensor)))


def without_part(model: Model, name: str) -> Model:
    """The model without an effect or a sensor model."""
    motor = model.file.motor.without_effect(name)
    kept = {
        f"initial.{state}" for state in ("i", "w", "theta", *(s for e in motor.effects for s in e.states))
    }
    own = [
        {key: y for key, y in one.items() if not key.startswith("initial.") or key in kept}
        for one in model.own
    ]
    sensors = tuple(sensor for sensor in model.file.sensors if sensor.name() != name)
    return replace(model, file=replace(model.file, motor=motor, sensors=sensors), own=tuple(own))
