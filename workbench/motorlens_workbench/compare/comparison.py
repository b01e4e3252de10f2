"""How far a motor file is from recordings, and where: by channel, equation, operating region, time and time scale.

Nothing in the motor is fitted: the model runs freely, driven by the measured voltage, load and ambient, from the start that
fits all samples (`free_run`), or the beginning of a long recording (`long_recordings`). Which equation is to blame
is a question of its own (`equations`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from motorlens_physics.estimate.run import STATE_OF, UNIT_OF
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_physics.scenario import time_constants
from motorlens_runtime.errors import DataError, ModelError
from motorlens_workbench.compare.equations import Equation, equations_of
from motorlens_workbench.compare.long_recordings import PART, beside, block, is_long
from motorlens_workbench.compare.overlay import NOISELESS, Overlay, overlay_of
from motorlens_workbench.compare.time_scales import bands_of, orders_of
from motorlens_workbench.compare.where import Region, Stretch, map_of, pooled_error, regions_of, shortest_half

# Error over noise floor up to which a model follows to the noise: less than half of what is seen is then missing physics,
# and the floor's own error is far smaller (`benchmarks/floors.py`).
FOLLOWS = 1.2


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
class Comparison:
    """All that `motorlens compare` found; `notes` are what was done to long recordings, in words."""

    file: MotorFile
    overlays: tuple[Overlay, ...]
    channels: Mapping[str, Channel]
    equations: Mapping[str, Equation]
    map: tuple[Region, ...]  # speed by current
    regions: Mapping[str, Region]  # in words: "forwards", "near standstill", "warmest third", ...
    half: Stretch  # of the worst channel's squared error
    bands: Mapping[str, Mapping[str, float]]  # channel -> time scale -> share of the error's power
    orders: tuple[
        tuple[float, float], ...
    ]  # (order of the shaft, amplitude in rad/s) of the speed error, strongest first
    notes: tuple[str, ...] = ()

    @property
    def worst(self) -> str:
        """The channel with the largest error in units of its floor."""
        return self.half.channel

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
        overlays.append(overlay_of(model, r, whole.pop(0)))
    measured = [channel for channel in STATE_OF if any(channel in o.run.channels for o in overlays)]
    channels = {channel: _channel(channel, overlays) for channel in measured}
    sizes = pooled_error(overlays)
    return Comparison(
        file,
        tuple(overlays),
        channels,
        equations_of(model, recordings, overlays),
        map_of(overlays, sizes),
        regions_of(overlays, sizes),
        shortest_half(max(channels, key=lambda name: channels[name].times_noise), overlays),
        {channel: bands_of(channel, overlays, time_constants(file.motor)) for channel in measured},
        orders_of(overlays),
        tuple(_note(one) for one in recordings if is_long(one)),
    )


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
