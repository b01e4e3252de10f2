"""Recordings as MDF 3 and 4, what measurement systems of vehicles write: every numeric channel by its name and unit."""

import gc
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from motorlens_physics.reading import Array, Table
from motorlens_runtime.errors import DataError

SUFFIXES = (".mf4", ".mdf")
EXTRA = "mdf"


def read(path: Path) -> Table:
    """Open an MDF file.

    Channels may be sampled apart. The instants are those of the fastest one asked for; a sample of a slower one stands at
    the instant next to it, and the others are missing.
    """
    file = _opened(path)
    places: dict[str, tuple[int, int]] = {}
    for group, content in enumerate(file.groups):
        master = file.masters_db.get(group)
        for index, channel in enumerate(content.channels):
            if index != master:
                unit = file.get_channel_unit(group=group, index=index)
                places.setdefault(f"{channel.name} [{unit}]" if unit else channel.name, (group, index))
    headings = ("time [s]", *places)

    def numbers(used: Sequence[int]) -> Mapping[int, Array]:
        signals = {}
        for k in used:
            if k > 0:
                group, index = places[headings[k]]
                signal = file.get(group=group, index=index)
                if signal.samples.dtype.kind not in "fiub" or signal.samples.ndim != 1:
                    raise DataError(f"{path}: channel {headings[k]!r} does not hold numbers")
                signals[k] = signal
        if not signals:
            raise DataError(f"{path}: no channel was chosen")
        time = max((signal.timestamps for signal in signals.values()), key=len)
        table = {0: np.asarray(time, dtype=np.float64)}
        for k, signal in signals.items():
            table[k] = _beside(time, signal.timestamps, signal.samples.astype(np.float64))
        return table

    return Table(headings, numbers, 1, [])


def _opened(path: Path) -> Any:
    import asammdf

    # What asammdf leaves of a damaged file complains on its way out.
    hook, sys.unraisablehook = sys.unraisablehook, lambda complaint: None
    try:
        return asammdf.MDF(path)
    except Exception as error:  # asammdf raises what its parser meets
        why = " ".join(str(error).split())[:200]
    finally:
        gc.collect()
        sys.unraisablehook = hook
    raise DataError(f"{path}: not an MDF file ({why})")


def _beside(time: Array, own: Array, samples: Array) -> Array:
    """Samples taken at `own` times, at the next instants of `time`; NaN elsewhere."""
    if len(own) == len(time) and np.array_equal(own, time):
        return samples
    placed = np.full(len(time), np.nan)
    after = np.clip(np.searchsorted(time, own), 1, len(time) - 1)
    nearest = np.where(own - time[after - 1] < time[after] - own, after - 1, after)
    placed[nearest] = samples
    return placed
