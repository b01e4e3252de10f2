"""A recording made ready for modelling: inputs without gaps, outputs with their valid samples, and how finely to look.

Rows are averaged in groups of `every` after simulation, so that an hour at 10 Hz or a minute at 10 kHz costs no more
than some 30 000 rows; the simulation itself runs on every sample.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.converter import LastingError
from motorlens_physics.estimate.readings import resting
from motorlens_physics.estimate.signals import decaying
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import IMPOSED_BY
from motorlens_physics.simulation import Inputs

if TYPE_CHECKING:
    from motorlens_physics.estimate.noise import Noise

Array = NDArray[np.float64]

# Measured outputs in the order of their states.
STATE_OF = {"current": "i", "speed": "w", "temperature": "theta"}
UNIT_OF = {"current": "A", "speed": "rad/s", "temperature": "degC", "voltage": "V", "load_torque": "N*m"}
# From the next lower level to the next higher one, in steps of a converter, with room for rounding.
WITHIN = 2.5
# The start is guessed from this many samples: their median is no outlier.
FIRST = 3


@dataclass(frozen=True, eq=False)
class Run:
    """One recording, prepared.

    Attributes:
        name: of the recording.
        inputs: as the sensors show them; a load torque or an ambient that was not recorded is zero or the rating plate's.
        channels: the measured outputs, C of `STATE_OF`.
        measured: (N, C), interpolated where missing.
        valid: (N,) whether all outputs were measured.
        every: rows averaged into one.
        start: first guess of the initial states.
        known: which inputs were recorded beside the voltage.
        bare: whether a load of exactly 0 throughout says that nothing is on the shaft: then no sensor is, and no torque but
            the motor's own.
        floor: (C,) smallest believable noise of an averaged row: quantisation, or a ten-thousandth of the range.
        angle: (N,) shaft angle, if recorded.
        shaft: (N,) the angle that effects go with, as recorded or as `shaft.followed` has it, rad; None: not known.
        there: (N, C) which samples of each output were measured, and not imposed on the motor.
        steps: (C,) least significant bit of the converter of each output, 0 if continuous.
        converter_errors: input -> what lasts of its converter's error, where that matters, see `converter.lasting_error`.
        input_step: the least significant bit of voltage and load torque, 0 if continuous.
        corrections: (N, 2) what the sensors of voltage (V) and load torque (N m) showed too little, as a fit expects it
            given all that was measured; None is nothing.
        turns: whether what goes with the shaft angle is looked for in it, see `prepare_all`.
        offset_below: channel -> the largest offset that its sensor can have, where it reads exactly zero at rest.
        hung: channel -> when it first and last hung, in s; these samples are not valid.
        saturated: channel -> how many of its samples are at the end of its converter's range; these are not valid.
        repeats: channel -> how many of its samples are the one before again, see `repeating`; these are not valid.
        spikes: channel or input -> how many of its samples stand alone as no motor makes or follows them, and were left out.
        hum: channel and frequency in Hz -> the amplitude of a line that was taken out of what it shows.
        noise: of its sensors and inputs, as an estimate found it.
        late: channel -> by how many samples it was recorded late, and was moved.
        unmoved: the run before its channels were moved; None if none was.
        mean_speed: whether the speed shows its mean since the sample before, as one that is counted from an encoder does.
        from_angle: whether it was computed from the angle: then it certainly does.
        coarse: channel -> the step of its converter that it stays within, and was left out for, see `without_coarse`.
    """

    name: str
    inputs: Inputs
    channels: tuple[str, ...]
    measured: Array
    valid: NDArray[np.bool_]
    there: NDArray[np.bool_]
    steps: Array
    every: int
    start: dict[str, float]
    known: tuple[str, ...]
    floor: Array
    bare: bool = False
    angle: Array | None = None
    input_step: tuple[float, float] = (0.0, 0.0)
    corrections: Array | None = None
    offset_below: Mapping[str, float] = field(default_factory=dict)
    converter_errors: Mapping[str, LastingError] = field(default_factory=dict)
    turns: bool = True
    shaft: Array | None = None
    hung: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    saturated: Mapping[str, int] = field(default_factory=dict)
    repeats: Mapping[str, int] = field(default_factory=dict)
    spikes: Mapping[str, int] = field(default_factory=dict)
    hum: Mapping[tuple[str, float], float] = field(default_factory=dict)
    late: Mapping[str, int] = field(default_factory=dict)
    noise: "Noise | None" = None
    unmoved: "Run | None" = None
    mean_speed: bool = False
    from_angle: bool = False
    coarse: Mapping[str, float] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.measured) // self.every

    @property
    def time_s(self) -> Array:
        """(rows,) of the averaged rows."""
        return self.average(self.inputs.time_s)

    @property
    def period_s(self) -> float:
        """Between two samples as recorded, the median."""
        return float(np.median(np.diff(self.inputs.time_s)))

    def average(self, y: Array) -> Array:
        """(N, ...) to (rows, ...): the mean of each `every` consecutive samples; a remainder at the end is left out."""
        if self.every == 1:
            return y
        rows = len(y) // self.every
        return np.asarray(y[: rows * self.every].reshape(rows, self.every, *y.shape[1:]).mean(axis=1))

    @property
    def imposed(self) -> tuple[str, ...]:
        """What was measured and is no output, for something imposes it on the motor throughout."""
        ends = {channel: (getattr(self.inputs, end), to) for channel, (end, to) in IMPOSED_BY.items()}
        return tuple(name for name, (tied, to) in ends.items() if tied is not None and np.all(tied == to))

    @property
    def moves(self) -> bool:
        """Whether anything that was measured changes: what stands still, whatever it shows, tells nothing."""
        told = [y[there] for y, there in zip(self.measured.T, self.there.T, strict=True)]
        return any(len(y) > 0 and bool(np.ptp(y) > 0) for y in told)

    @cached_property
    def rests(self) -> NDArray[np.bool_]:
        """(N,) samples amid many at which nothing that was recorded changes: they tell nothing of the noise.

        An encoder of a motor that stands counts nothing, however noisy it is when the motor turns.
        """
        return resting([*self.measured.T, self.inputs.voltage_V, self.inputs.load_torque_Nm])

    @property
    def load_known(self) -> bool:
        """Whether it is known what torque acts on the shaft."""
        return self.bare or "load_torque" in self.known

    def holding(self, held: tuple[bool, bool, bool]) -> "Run":
        """With voltage, load torque and ambient holding between samples, or running linearly, each."""
        return self if self.inputs.hold == held else replace(self, inputs=replace(self.inputs, held=held))

    @property
    def as_recorded(self) -> "Run":
        """Before anything was found of when it was sampled and of its noise; what its speed shows stays."""
        return replace(self.unmoved or self, corrections=None, noise=None, mean_speed=self.mean_speed)

    def showing(self, mean_speed: bool) -> "Run":
        """With a speed that is the mean since the sample before, or that at the sample unless it is known to be a mean."""
        mean_speed |= self.from_angle
        return self if self.mean_speed == mean_speed else replace(self, mean_speed=mean_speed)

    def corrected(self, errors: Array) -> "Run":
        """With what the inputs' sensors are taken to have shown too little (N, 2), V and N m."""
        return replace(self, corrections=errors)

    def delayed(self, channel: str, samples: int) -> "Run":
        """With a channel, or the voltage, taken to be recorded this many samples late; what is lost at an end is missing."""
        if not samples:
            return self
        late = dict(self.late) | {channel: self.late.get(channel, 0) + samples}
        unmoved = self.unmoved or self
        if channel == "voltage":
            errors = dict(self.converter_errors)
            if channel in errors:
                errors[channel] = replace(errors[channel], stays=_earlier(errors[channel].stays, samples))
            # What was applied is what was recorded later; beyond the end, the last.
            moved = _earlier(self.inputs.voltage_V, samples)
            inputs = replace(self.inputs, voltage_V=moved)
            return replace(self, inputs=inputs, late=late, unmoved=unmoved, converter_errors=errors)
        c = self.channels.index(channel)
        measured, there = self.measured.copy(), self.there.copy()
        measured[:, c] = _earlier(measured[:, c], samples)
        there[:, c] = _earlier(there[:, c], samples) & _inside(len(there), samples)
        valid = np.all(there, axis=1)
        return replace(
            self,
            measured=measured,
            there=there,
            valid=valid,
            late=late,
            unmoved=unmoved,
        )

    def without(self, spikes: Mapping[str, NDArray[np.bool_]]) -> "Run":
        """With samples (N,) of channels and inputs left out that stand alone; an input runs on from those beside them."""
        spikes = {name: alone for name, alone in spikes.items() if alone.any()}
        if not spikes:
            return self
        unmoved = self.unmoved
        if unmoved is not None:
            unmoved = unmoved.without(
                {
                    name: _earlier(alone, -lag) & _inside(len(alone), -lag)
                    for name, alone in spikes.items()
                    for lag in [self.late.get(name, 0)]
                }
            )
        time, there, measured, inputs = (
            self.inputs.time_s,
            self.there.copy(),
            self.measured.copy(),
            self.inputs,
        )
        for name, alone in spikes.items():
            if name in self.channels:
                c = self.channels.index(name)
                there[:, c] &= ~alone
                measured[:, c] = _bridged(time, measured[:, c], alone)
            elif name == "voltage":
                inputs = replace(inputs, voltage_V=_bridged(time, inputs.voltage_V, alone))
            else:
                inputs = replace(inputs, load_torque_Nm=_bridged(time, inputs.load_torque_Nm, alone))
        counts = dict(self.spikes)
        for name, alone in spikes.items():
            counts[name] = counts.get(name, 0) + int(alone.sum())
        return replace(
            self, inputs=inputs, measured=measured, there=there, valid=np.all(there, axis=1), spikes=counts, unmoved=unmoved
        )  # fmt: skip

    def less(self, channel: str, frequency_Hz: float, line: Array) -> "Run":
        """With a line (N,) of this frequency taken out of what a channel shows."""
        measured, c = self.measured.copy(), self.channels.index(channel)
        measured[:, c] -= line
        unmoved = self.unmoved
        if unmoved is not None:
            unmoved = unmoved.less(channel, frequency_Hz, _earlier(line, -self.late.get(channel, 0)))
        amplitude = float(np.sqrt(2 * np.mean(line**2)))
        return replace(
            self,
            measured=measured,
            hum=dict(self.hum) | {(channel, frequency_Hz): amplitude},
            unmoved=unmoved,
        )

    def without_channel(self, channel: str) -> "Run":
        """Without one of its channels."""
        keep = [c for c, name in enumerate(self.channels) if name != channel]
        return replace(
            self,
            channels=tuple(self.channels[c] for c in keep),
            measured=self.measured[:, keep],
            floor=self.floor[keep],
            there=self.there[:, keep],
            steps=self.steps[keep],
            valid=np.all(self.there[:, keep], axis=1),
            noise=None,
            mean_speed=self.mean_speed and channel != "speed",
            from_angle=self.from_angle and channel != "speed",
        )

    def without_coarse(self) -> "Run":
        """Without a current that goes no further from one level of its converter than to the next, where the speed tells.

        Noise of a voltage stirs the simulated current at once. A reading is off by anything up to half a step, whatever that
        noise does, unless the current stays where one level goes on: then it is off by just what the noise has stirred, and
        a motor is likeliest that is stirred less, of several times the resistance.
        """
        if not {"current", "speed"} <= set(self.channels):
            return self
        current, speed = (self.channels.index(channel) for channel in ("current", "speed"))
        if self._goes_on(current) or not self._goes_on(speed):
            return self
        return replace(self.without_channel("current"), coarse={"current": float(self.steps[current])})

    def _goes_on(self, c: int) -> bool:
        """Whether a channel goes further than from one level of its converter to the next."""
        told = self.measured[self.there[:, c], c]
        return len(told) > 0 and float(np.ptp(told)) > WITHIN * float(self.steps[c])

    def part(self, rows: slice, file: MotorFile) -> "Run":
        """Some consecutive samples as a run of its own, as they are: none is averaged with another."""
        inputs, measured = self.inputs.part(rows), self.measured[rows]
        shaft = None if self.shaft is None else self.shaft[rows]
        start = first_states(file, self.channels, measured, inputs.ambient_C, inputs.voltage_V)
        errors = {name: replace(one, stays=one.stays[rows]) for name, one in self.converter_errors.items()}
        return replace(
            self, inputs=inputs, measured=measured, valid=self.valid[rows], there=self.there[rows], every=1, start=start,
            floor=self.floor * np.sqrt(self.every), angle=None if self.angle is None else self.angle[rows], shaft=shaft,
            corrections=None if self.corrections is None else self.corrections[rows], unmoved=None, converter_errors=errors,
        )  # fmt: skip

    def liveliest(self, rows: int, motor: Motor) -> slice:
        """The `rows` consecutive samples in which changes of the inputs tell most, relative to how much they ever change.

        A change tells by the answer of the motor, with its mechanical time constant: one at a piece's end tells nothing.
        """
        inputs = (self.inputs.voltage_V, self.inputs.load_torque_Nm)
        change = sum(np.diff(y) ** 2 / spread for y in inputs if (spread := float(np.var(y))) > 0)
        changes = np.concatenate([[0.0], np.broadcast_to(change, len(self.measured) - 1)])
        remains = float(np.exp(-self.period_s / motor.response_s))
        total = np.append(0.0, np.cumsum(changes))
        unanswered = np.append(0.0, decaying(changes, remains))
        # What changed until the first sample of a piece shows in none of them.
        first, last = slice(1, len(total) - rows + 1), slice(rows, None)
        told = total[last] - total[first] - unanswered[last] + remains ** (rows - 1) * unanswered[first]
        begin = int(np.argmax(told))
        return slice(begin, min(begin + rows, len(self.measured)))

    def fresh(self) -> NDArray[np.bool_]:
        """(rows,) averaged rows of which every sample is valid."""
        return np.asarray(self.average(self.valid.astype(np.float64)) > 0.999)


def first_states(
    file: MotorFile, used: Sequence[str], measured: Array, ambient_C: Array, voltage_V: Array
) -> dict[str, float]:
    """First guess of where a motor starts, from the first samples of its measured channels (N, C)."""
    start = {"i": 0.0, "w": 0.0, "theta": 0.0}
    for k, channel in enumerate(used):
        first = max(FIRST, len(measured) // 1000) if channel == "temperature" else FIRST
        start[STATE_OF[channel]] = float(np.median(measured[:first, k]))
    if "temperature" in used:
        start["theta"] -= float(ambient_C[0])
    # What was not measured follows from the voltage balance at its steady state.
    resistance = file.motor.resistance(start["theta"])
    if "speed" not in used and "current" in used:
        start["w"] = float((voltage_V[0] - resistance * start["i"]) / file.motor.ke)
    if "current" not in used and "speed" in used:
        start["i"] = float((voltage_V[0] - file.motor.ke * start["w"]) / resistance)
    return start


def _bridged(time_s: Array, y: Array, out: NDArray[np.bool_]) -> Array:
    """(N,) with the samples that are `out` between those beside them."""
    return np.where(out, np.interp(time_s, time_s[~out], y[~out]), y)


def _earlier(y: NDArray[Any], samples: int) -> NDArray[Any]:
    """(N,) moved earlier by some samples (later if negative), the value at the end repeated."""
    at = np.clip(np.arange(len(y)) + samples, 0, len(y) - 1)
    return np.asarray(y[at])


def _inside(rows: int, samples: int) -> NDArray[np.bool_]:
    at = np.arange(rows) + samples
    return np.asarray((at >= 0) & (at < rows))
