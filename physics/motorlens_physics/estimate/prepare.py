"""Recordings made ready for modelling: inputs without gaps, what is no reading of an output left out, how finely to look."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.converter import (
    LastingError,
    counted_step,
    lasting_error,
    quantisation_step,
    saturated,
)
from motorlens_physics.estimate.readings import hanging, largest_offset, repeating, resting
from motorlens_physics.estimate.run import STATE_OF, Run, first_states
from motorlens_physics.estimate.signals import level_of, noise_sd
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import IMPOSED_BY, Recording, inputs_of
from motorlens_runtime.errors import DataError

Array = NDArray[np.float64]

# Averaged rows of a recording, at most.
ROWS = 30_000
# Levels up to the largest value below which these are no converter's, but steps of a command.
COARSEST = 32
# Noise, in steps, from which on levels are a converter's.
TOGGLES = 0.05
# From one sample to the next at rated speed, rad: further, the angle is anybody's guess.
HALF_TURN = 3.14
# The ambient temperature follows no faster than this: a winding does not follow a draught.
AMBIENT_S = 60.0


def prepare(recording: Recording, file: MotorFile, channels: Sequence[str] = tuple(STATE_OF)) -> Run:
    """Make a recording ready.

    Args:
        recording: with at least one of current, speed and temperature.
        file: for what was not recorded (ambient).
        channels: the outputs to look at.

    Raises:
        DataError: nothing measured but inputs, or too short.
    """
    # What something imposes on the motor is an input while it does.
    imposed = {channel: _tied(recording, end, to) for channel, (end, to) in IMPOSED_BY.items()}
    used = tuple(
        c for c in STATE_OF if c in channels and recording.has(c) and not (c in imposed and imposed[c].all())
    )
    if not used:
        raise DataError(
            f"{recording.name}: only inputs are recorded; at least one of current, speed and temperature is needed, "
            "measured while nothing imposes it"
        )
    rows = len(recording)
    if rows < 40:
        raise DataError(f"{recording.name}: {rows} samples are too few to compare with a model")
    begin = recording.time_s[0]
    time = recording.time_s - begin if begin else recording.time_s
    measured = np.empty((rows, len(used)))
    present = np.ones((rows, len(used)), dtype=bool)
    floor, least_bits = np.empty(len(used)), np.empty(len(used))
    # The rise is what is measured less the ambient: noise of the one sensor must not pass for a response of the other.
    ambient = recording.channels.get("ambient", np.full(rows, file.rated.ambient_C))
    ambient = level_of(time, ambient, AMBIENT_S)
    inputs = replace(inputs_of(recording, file.rated.ambient_C), time_s=time, ambient_C=ambient)
    counted = recording.speed_from_angle and "speed" in used
    every, period_s = max(1, -(-rows // ROWS)), float(np.median(np.diff(time)))
    for k, y in enumerate(recording.channels[channel] for channel in used):
        there = np.isfinite(y)
        measured[:, k] = y if there.all() else np.interp(time, time[there], y[there])
    # An encoder at rest counts nothing, however noisy it is when the motor turns.
    tells = ~resting([*measured.T, inputs.voltage_V, inputs.load_torque_Nm])
    hung: dict[str, tuple[float, float]] = {}
    ends: dict[str, int] = {}
    repeats: dict[str, int] = {}
    errors: dict[str, LastingError] = {}
    for k, channel in enumerate(used):
        y = recording.channels[channel]
        hangs, beyond = hanging(y), saturated(y)
        # A temperature changes so slowly that the last reading is as good.
        again = repeating(y, tells & (channel != "temperature")) & ~hangs & ~beyond
        present[:, k] = np.isfinite(y) & ~hangs & ~beyond & ~again & ~imposed.get(channel, False)
        if again.any():
            repeats[channel] = int(again.sum())
        if beyond.any():
            ends[channel] = int(beyond.sum())
        if hangs.any():
            first, last = recording.time_s[np.flatnonzero(hangs)[[0, -1]]].tolist()
            hung[channel] = (first, last)
        spread = float(np.sqrt(np.mean((measured[:, k] - np.median(measured[:, k])) ** 2)))
        least_bits[k] = quantisation_step(y)
        if counted and channel == "speed":
            # The errors of two counts, and steps of time may vary.
            least_bits[k] = np.sqrt(2) * counted_step(recording.channels["angle"]) / period_s
        floor[k] = max(least_bits[k] / np.sqrt(12), 1e-4 * spread, 1e-9) / np.sqrt(every)
    start = first_states(file, used, measured, ambient, recording.channels["voltage"])
    bare = recording.has("load_torque") and not recording.channels["load_torque"].any()
    known = tuple(
        q for q in ("load_torque", "ambient") if recording.has(q) and not (bare and q == "load_torque")
    )
    angle = recording.channels.get("angle")
    if angle is not None and not np.isfinite(angle).all():
        angle = None
    coarse_inputs = (_least_bit(inputs.voltage_V), _least_bit(inputs.load_torque_Nm))
    shown = {"voltage": inputs.voltage_V, "load_torque": inputs.load_torque_Nm}
    for (name, y), step in zip(shown.items(), coarse_inputs, strict=True):
        lasts = lasting_error(y, step, tells=tells)
        if lasts is not None:
            errors[name] = lasts
    exact = {
        q: limit for q in ("voltage", *used) if (limit := largest_offset(recording.channels[q])) is not None
    }
    return Run(
        recording.name, inputs, used, measured, np.all(present, axis=1), present, least_bits, every, start, known, floor,
        bare, angle, input_step=coarse_inputs, offset_below=exact, converter_errors=errors,
        shaft=angle, hung=hung, saturated=ends, repeats=repeats,
        mean_speed=counted, from_angle=counted,
    )  # fmt: skip


def _tied(recording: Recording, quantity: str, to: int) -> NDArray[np.bool_]:
    """(N,) where the terminals or the shaft are tied to this."""
    return np.asarray(recording.channels.get(quantity, np.full(len(recording), -1.0)) == to)


def prepare_all(recordings: Sequence[Recording], file: MotorFile) -> tuple[Run, ...]:
    """Make recordings of one motor ready, see `prepare`.

    Where the shaft stood at the start of a recording without an angle is not known, so what goes with the angle (cogging,
    say) is looked for where the angle was measured, or in the most finely sampled recording alone, if it is fine enough.
    """
    runs = _with_steps_of_others([prepare(recording, file) for recording in recordings])
    measured = any(run.angle is not None for run in runs)
    finest = min(runs, key=lambda run: run.period_s)
    fine = finest.period_s * file.rated.speed_rad_s < HALF_TURN
    return tuple(
        replace(run, turns=run.angle is not None if measured else run is finest and fine) for run in runs
    )


def prepare_to_fit(recordings: Sequence[Recording], file: MotorFile) -> tuple[Run, ...]:
    """Make recordings of one motor ready for a fit of it: see `prepare_all`, and `Run.without_coarse`."""
    return tuple(run.without_coarse() for run in prepare_all(recordings, file))


def _with_steps_of_others(runs: Sequence[Run]) -> list[Run]:
    """Runs of which a channel never left one reading with the converter that the same channel has in others.

    One reading tells no step, and would be taken to be exact.
    """
    known: dict[str, float] = {}
    for run in runs:
        for channel, step in zip(run.channels, run.steps.tolist(), strict=True):
            known[channel] = max(known.get(channel, 0.0), step)
    others = []
    for run in runs:
        steps = np.array([known[channel] for channel in run.channels])
        steps = np.where((run.steps == 0) & (np.ptp(run.measured, axis=0) == 0), steps, run.steps)
        floor = np.maximum(run.floor, steps / np.sqrt(12 * run.every))
        others.append(replace(run, steps=steps, floor=floor))
    return others


def _least_bit(y: Array) -> float:
    """The least significant bit of a measured input; 0 if it looks continuous, or if its levels are those of a command."""
    step = quantisation_step(y)
    # A converter toggles between two levels where the signal is steady, however few levels are used; a command does not.
    toggles = noise_sd(y, step) > TOGGLES * step
    return step if toggles or COARSEST * step <= np.max(np.abs(y)) else 0.0
