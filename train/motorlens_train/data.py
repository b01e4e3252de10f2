"""Data sets: features and targets from recordings, split by whole duty cycle.

Splitting one trajectory at random into train and test leaks the answer from one to the other, so the sets here are made of
different cycles. The paper's own 50/25/25 split of one run is kept as `paper_split`, for its labelled row.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.recording import Recording
from motorlens_runtime.errors import DataError
from motorlens_train.features import feature_rows
from motorlens_train.source import Arrays
from motorlens_train.specification import Array, Bank, Output

Rows = NDArray[np.int64]


@dataclass(frozen=True)
class Cycle:
    """One duty cycle as the network sees it.

    Attributes:
        name: of the recording.
        time_s: `[N]` instants of the rows.
        x: `[N, F]` features.
        y: `[N, K]` targets.
        voltage_V, current_A: lowest and highest value of the whole recording.
        rows: number of samples of the recording.
    """

    name: str
    time_s: Array
    x: Array
    y: Array
    voltage_V: tuple[float, float]
    current_A: tuple[float, float]
    rows: int

    def part(self, which: NDArray[np.bool_]) -> "Cycle":
        """Some of its rows, `which` (N,)."""
        return replace(self, time_s=self.time_s[which], x=self.x[which], y=self.y[which])


def target(recording: Recording, output: str, ambient: bool) -> Array:
    """A promised quantity `[N]` in its unit: temperature is the rise above ambient unless the sensor knows the ambient.

    Raises:
        DataError: it was not recorded.
    """
    channels = recording.channels
    if output not in channels:
        raise DataError(f"{recording.name}: no {output} was recorded")
    if output != "temperature" or ambient:
        return np.asarray(channels[output])
    if "ambient" not in channels:
        raise DataError(f"{recording.name}: temperature without ambient; add an ambient_C column")
    return np.asarray(channels["temperature"] - channels["ambient"])


def cycle(recording: Recording, bank: Bank, outputs: Sequence[str], rows: Rows | None = None) -> Cycle:
    """Features and targets of a recording.

    Args:
        recording: voltage, current and the targets.
        bank: the features.
        outputs: names of the promised quantities.
        rows: which samples to keep, ascending; None means all. Rows without a target are left out.

    Raises:
        DataError: current or a target was not recorded.
    """
    channels = recording.channels
    if "current" not in channels:
        raise DataError(
            f"{recording.name}: no current; a sensor needs voltage and current: --column current=NAME"
        )
    voltage, current = np.asarray(channels["voltage"]), np.asarray(channels["current"])
    ambient = np.asarray(channels["ambient"]) if bank.ambient else None
    y = np.stack([target(recording, name, bank.ambient) for name in outputs], axis=1)
    chosen = np.arange(len(recording)) if rows is None else rows
    chosen = chosen[np.isfinite(y[chosen]).all(1)]
    x = feature_rows(bank, recording.time_s, voltage, current, chosen, ambient)
    return Cycle(
        recording.name,
        recording.time_s[chosen],
        x,
        y[chosen],
        (float(voltage.min()), float(voltage.max())),
        (float(current.min()), float(current.max())),
        len(recording),
    )


def arrays(cycles: Sequence[Cycle]) -> Arrays:
    """All rows of some cycles, one after another, as the trainer reads them."""
    return Arrays(
        np.concatenate([c.x for c in cycles]),
        np.concatenate([c.y for c in cycles]),
        tuple(len(c.x) for c in cycles),
    )


def errors(cycles: Sequence[Cycle], estimates: Sequence[Array]) -> dict[str, Array]:
    """Root mean square, largest and worst cycle's root mean square error of each output, `[K]` each."""
    off = [estimate - c.y for c, estimate in zip(cycles, estimates, strict=True)]
    joined = np.concatenate(off)
    return {
        "rmse": np.sqrt((joined**2).mean(0)),
        "max": np.abs(joined).max(0),
        "worst_cycle_rmse": np.max([np.sqrt((part**2).mean(0)) for part in off], axis=0),
    }


def paper_split(rows: int, rng: np.random.Generator) -> tuple[Rows, Rows, Rows]:
    """The paper's protocol: samples of one run drawn at random into 50 % training, 25 % validation and 25 % test."""
    order = rng.permutation(rows)
    half, three = rows // 2, 3 * rows // 4
    return np.sort(order[:half]), np.sort(order[half:three]), np.sort(order[three:])


def scale_of(cycles: Sequence[Cycle], names: Sequence[str]) -> tuple[Output, ...]:
    """The promised outputs with the size of each: its standard deviation over the training data, two digits."""
    units = {"speed": "rad/s", "temperature": "K", "resistance": "ohm"}
    y = np.concatenate([c.y for c in cycles])
    return tuple(
        Output(name, units[name], float(f"{max(float(y[:, k].std()), 1e-9):.2g}"))
        for k, name in enumerate(names)
    )
