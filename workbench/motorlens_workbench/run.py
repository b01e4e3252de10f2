"""A recording made ready for modelling: inputs without gaps, outputs with their valid samples, and how finely to look.

Rows are averaged in groups of `every` after simulation, so that an hour at 10 Hz or a minute at 10 kHz costs no more
than some 30 000 rows; the simulation itself runs on every sample.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_physics.simulation import Inputs
from motorlens_runtime.errors import DataError
from motorlens_workbench.converter import Converter, converter_of, leaning, quantisation_step
from motorlens_workbench.denoise import Noise, moving_mean, noise_of_input, noise_sd, smoothed

Array = NDArray[np.float64]

# Measured outputs in the order of their states.
STATE_OF = {"current": "i", "speed": "w", "temperature": "theta"}
UNIT_OF = {"current": "A", "speed": "rad/s", "temperature": "degC", "voltage": "V", "load_torque": "N*m"}
ROWS = 30_000
# Levels up to the largest value below which these are no converter's, but steps of a command.
COARSEST = 32
# Noise, in steps, from which on levels are a converter's.
TOGGLES = 0.05
# The lean of a converter from which on its steps show.
LEANS = 0.05
# From one sample to the next at rated speed, rad: further, the angle is anybody's guess.
HALF_TURN = 3.14
# Consecutive samples of exactly 0, at the start or the end, that are no chance.
AT_REST = 5
# Consecutive samples with the same number that are a channel that hangs, where noise keeps others from being equal: the
# share of equal neighbours elsewhere, and the noise as a share of the range.
HANGS, EQUAL, NOISY = 100, 0.2, 1e-4
# The ambient temperature is averaged over this long.
AMBIENT_S = 60.0


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
        floor: (C,) smallest believable noise of an averaged row: quantisation, or a ten-thousandth of the range.
        angle: (N,) shaft angle, if recorded.
        shaft: where its angle is known, the states along the way, (N,) each: phi, w, i and theta, see `shaft.followed`.
        input_noise: of the voltage (V) and the load torque (N m), where it is their sensors' and was not truly applied.
        smooth: whether it was smoothed away as far as it can be.
        input_step: the least significant bit of either, 0 if continuous.
        converters: of the channels.
        turns: whether what goes with the shaft angle is looked for in it, see `prepare_all`.
        offset_below: channel -> the largest offset that its sensor can have, where it reads exactly zero at rest.
        hung: channel -> when it first and last hung, in s; these samples are not valid.
        late: whether the voltage acts one sample later than recorded, see `later`.
    """

    name: str
    inputs: Inputs
    channels: tuple[str, ...]
    measured: Array
    valid: NDArray[np.bool_]
    every: int
    start: dict[str, float]
    known: tuple[str, ...]
    floor: Array
    angle: Array | None = None
    input_noise: tuple[Noise, Noise] = (Noise(), Noise())
    input_step: tuple[float, float] = (0.0, 0.0)
    smooth: bool = False
    offset_below: Mapping[str, float] = field(default_factory=dict)
    converters: tuple[Converter, ...] = ()
    turns: bool = True
    shaft: Mapping[str, Array] | None = None
    hung: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    late: bool = False

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

    def quieter(self) -> "Run":
        """With the noise of the measured inputs smoothed away, see `denoise`; itself if the sampling is uneven."""
        time = self.inputs.time_s
        steps = np.diff(time)
        if np.std(steps) > 0.1 * np.median(steps):
            return self
        shown = self.inputs
        voltage, load = zip((shown.voltage_V, shown.load_torque_Nm), self.input_step, strict=True)
        smooth = replace(shown, voltage_V=smoothed(*voltage), load_torque_Nm=smoothed(*load))
        noise = (noise_of_input(*voltage), noise_of_input(*load))
        return replace(self, inputs=smooth, input_noise=noise, smooth=True)

    def later(self) -> "Run":
        """With the voltage one sample later: a command that the drive computes in one period and applies in the next."""
        shown = self.inputs
        applied = np.concatenate([shown.voltage_V[:1], shown.voltage_V[:-1]])
        return replace(self, inputs=replace(shown, voltage_V=applied), late=True)

    @property
    def disturbed(self) -> bool:
        """Whether the errors of its inputs are known to be worth a thought."""
        return any(self.input_noise) or any(self.input_step)

    @property
    def coarse(self) -> bool:
        """Whether a channel's converter leans: its noise does not blur its steps."""
        return any(converter.lean > LEANS for converter in self.converters)

    def stirred(self, seed: int, sign: float) -> "Run":
        """With errors of its inputs as large again as those that smoothing left; itself if they were not smoothed.

        Args:
            seed: of the errors.
            sign: 1, or -1 for the same errors the other way.
        """
        if not self.disturbed:
            return self
        rng = np.random.default_rng(seed)
        stirred = []
        shown = (self.inputs.voltage_V, self.inputs.load_torque_Nm)
        for y, noise, step in zip(shown, self.input_noise, self.input_step, strict=True):
            noisy = y + sign * noise.draw(rng, len(y))
            if step:
                # The same converter with its levels shifted: errors that last as long as a level is held.
                shift = sign * step * rng.uniform(-0.5, 0.5)
                noisy = np.round((noisy + shift) / step) * step - shift
            stirred.append(smoothed(noisy, step) if (noise or step) and self.smooth else noisy)
        voltage, load = stirred
        return replace(self, inputs=replace(self.inputs, voltage_V=voltage, load_torque_Nm=load))

    def leaning(self, truth: Array) -> "Run":
        """With its converters' lean towards their levels improved by what a fit (N, C) leaves."""
        found = [
            leaning(converter, truth[self.valid, k], (self.measured - truth)[self.valid, k])
            for k, converter in enumerate(self.converters)
        ]
        return replace(self, converters=tuple(found))

    def fresh(self) -> NDArray[np.bool_]:
        """(rows,) averaged rows of which every sample is valid."""
        return np.asarray(self.average(self.valid.astype(np.float64)) > 0.999)


def prepare(recording: Recording, file: MotorFile, channels: Sequence[str] = tuple(STATE_OF)) -> Run:
    """Make a recording ready.

    Args:
        recording: with at least one of current, speed and temperature.
        file: for what was not recorded (ambient).
        channels: the outputs to look at.

    Raises:
        DataError: nothing measured but inputs, or too short.
    """
    used = tuple(c for c in STATE_OF if c in channels and recording.has(c))
    if not used:
        raise DataError(
            f"{recording.name}: only inputs are recorded; at least one of current, speed and temperature is needed"
        )
    rows = len(recording)
    if rows < 40:
        raise DataError(f"{recording.name}: {rows} samples are too few to compare with a model")
    time = recording.time_s - recording.time_s[0]
    measured = np.empty((rows, len(used)))
    valid = np.ones(rows, dtype=bool)
    floor = np.empty(len(used))
    start = {"i": 0.0, "w": 0.0, "theta": 0.0}
    # The rise is what is measured less the ambient: noise of the one sensor must not pass for a response of the other, and a
    # winding does not follow a draught.
    ambient = recording.channels.get("ambient", np.full(rows, file.rated.ambient_C))
    ambient = moving_mean(time, ambient, AMBIENT_S)
    every = max(1, -(-rows // ROWS))
    hung: dict[str, tuple[float, float]] = {}
    for k, channel in enumerate(used):
        y = recording.channels[channel]
        there, hangs = np.isfinite(y), hanging(y)
        valid &= there & ~hangs
        if hangs.any():
            first, last = recording.time_s[np.flatnonzero(hangs)[[0, -1]]].tolist()
            hung[channel] = (first, last)
        measured[:, k] = y if there.all() else np.interp(time, time[there], y[there])
        spread = float(np.sqrt(np.mean((measured[:, k] - np.median(measured[:, k])) ** 2)))
        # While a coarse converter shows the same number, its error stays the same too: the whole dwell counts as one sample.
        dwell = rows / (1 + np.count_nonzero(np.diff(measured[:, k])))
        coarse = quantisation_step(y) / np.sqrt(12) * np.sqrt(dwell if dwell > 3 else 1.0)
        floor[k] = max(coarse, 1e-4 * spread, 1e-9) / np.sqrt(every)
        start[STATE_OF[channel]] = float(np.median(measured[:3, k]))
    if "temperature" in used:
        start["theta"] = float(
            np.median(measured[: max(3, rows // 1000), used.index("temperature")]) - ambient[0]
        )
    load = recording.channels.get("load_torque", np.zeros(rows))
    inputs = Inputs(time, recording.channels["voltage"], load, ambient)
    known = tuple(q for q in ("load_torque", "ambient") if recording.has(q))
    angle = recording.channels.get("angle")
    if angle is not None and not np.isfinite(angle).all():
        angle = None
    shaft = None
    if angle is not None:
        # What was not measured is roughly known only; `shaft.followed` takes it from a simulation.
        rough = {
            "phi": angle,
            "w": np.gradient(angle, time),
            "i": np.zeros(rows),
            "theta": np.full(rows, start["theta"]),
        }
        seen = {STATE_OF[c]: measured[:, k] for k, c in enumerate(used) if c != "temperature"}
        shaft = {**rough, **seen}
    coarse = (_least_bit(inputs.voltage_V), _least_bit(inputs.load_torque_Nm))
    exact = {
        q: limit for q in ("voltage", *used) if (limit := largest_offset(recording.channels[q])) is not None
    }
    return Run(
        recording.name, inputs, used, measured, valid, every, start, known, floor, angle, input_step=coarse,
        offset_below=exact, converters=tuple(converter_of(recording.channels[q]) for q in used),
        shaft=shaft, hung=hung,
    )  # fmt: skip


def prepare_all(recordings: Sequence[Recording], file: MotorFile) -> tuple[Run, ...]:
    """Make recordings of one motor ready, see `prepare`.

    Where the shaft stood at the start of a recording without an angle is not known, so what goes with the angle (cogging,
    say) is looked for where the angle was measured, or in the most finely sampled recording alone, if it is fine enough.
    """
    runs = tuple(prepare(recording, file) for recording in recordings)
    measured = any(run.angle is not None for run in runs)
    finest = min(runs, key=lambda run: run.period_s)
    fine = finest.period_s * file.rated.speed_rad_s < HALF_TURN
    return tuple(
        replace(run, turns=run.angle is not None if measured else run is finest and fine) for run in runs
    )


def hanging(y: Array) -> NDArray[np.bool_]:
    """(N,) whether a channel shows one number, not 0, for so long that its noise cannot have let it.

    >>> noise = np.random.default_rng(0).standard_normal(1000)
    >>> stuck = np.where(np.arange(1000) < 700, noise, noise[700])
    >>> int(hanging(noise).sum()), int(hanging(stuck).sum()), int(hanging(np.round(noise)).sum())
    (0, 300, 0)
    """
    begins = np.flatnonzero(np.concatenate([[True], np.diff(y) != 0]))
    lengths = np.diff(np.append(begins, len(y)))
    hangs = np.repeat((lengths >= HANGS) & (y[begins] != 0), lengths)
    rest = y[~hangs & np.isfinite(y)]
    if not hangs.any() or len(rest) < HANGS or np.mean(np.diff(rest) == 0) > EQUAL:
        return np.zeros(len(y), dtype=bool)
    noisy = noise_sd(rest) > NOISY * float(np.ptp(rest))
    return np.asarray(hangs & noisy)


def largest_offset(y: Array) -> float | None:
    """The largest offset of a sensor that shows exactly 0 at the start or the end; None if it does not.

    A sensor with an offset shows the offset at rest, and noise around it; one that counts (an encoder) shows 0. An offset
    below half its smallest step could hide.

    >>> largest_offset(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.2, 0.9, 1.4]))
    0.1
    """
    if not (np.all(y[:AT_REST] == 0) or np.all(y[-AT_REST:] == 0)):
        return None
    shown = np.abs(y[np.isfinite(y) & (y != 0)])
    return float(0.5 * shown.min()) if len(shown) else None


def _least_bit(y: Array) -> float:
    """The least significant bit of a measured input; 0 if it looks continuous, or if its levels are those of a command."""
    step = quantisation_step(y)
    # A converter toggles between two levels where the signal is steady, however few levels are used; a command does not.
    toggles = noise_sd(y, step) > TOGGLES * step
    return step if toggles or COARSEST * step <= np.max(np.abs(y)) else 0.0
