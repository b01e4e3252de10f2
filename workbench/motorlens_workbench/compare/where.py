"""Where a model fails: in which part of the operating range, and in which stretch of time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motorlens_workbench.compare.overlay import Overlay

Array = NDArray[np.float64]

# Cells of the map of speed and current, in each direction; cells with fewer samples say nothing.
CELLS, FEWEST = 6, 20
# Share of the top speed below which the rotor counts as near standstill.
STANDSTILL = 0.02


@dataclass(frozen=True)
class Region:
    """A part of the operating range: which, how many samples, error in standard deviations of the noise."""

    within: Mapping[str, tuple[float, float]]
    rms_in_sigma: float
    samples: int


@dataclass(frozen=True)
class Stretch:
    """The shortest stretch of a recording that holds half of a channel's squared error; `share` is its share of the time."""

    recording: str
    channel: str
    start_s: float
    stop_s: float
    share: float


def shortest_half(channel: str, overlays: Sequence[Overlay]) -> Stretch:
    """Of the recording with the largest error in that channel; near a half, `share` says that the error is everywhere."""
    holding = [o for o in overlays if channel in o.run.channels]
    worst = max(holding, key=lambda o: float(np.mean(o.error_of(channel) ** 2)))
    time = worst.run.inputs.time_s
    sums = np.concatenate([[0.0], np.cumsum(worst.error_of(channel) ** 2)])
    # From each first sample to the first by which half is reached; none from where less than half is left.
    first = np.arange(min(np.searchsorted(sums, sums[-1] / 2, side="right"), len(time)))
    last = np.searchsorted(sums, sums[first] + sums[-1] / 2)
    last = np.clip(last - 1, first, len(time) - 1)
    k = int(np.argmin(time[last] - time[first]))
    start, stop = float(time[first[k]]), float(time[last[k]])
    return Stretch(worst.run.name, channel, start, stop, (stop - start) / float(time[-1] - time[0]))


def pooled_error(overlays: Sequence[Overlay]) -> Array:
    """(M,) of all valid samples, in standard deviations of the noise."""
    return np.concatenate([o.in_sigma[o.run.valid] for o in overlays])


def _pooled(overlays: Sequence[Overlay], channel: str) -> Array:
    return np.concatenate([o.state(channel)[o.run.valid] for o in overlays])


def map_of(overlays: Sequence[Overlay], error: Array) -> tuple[Region, ...]:
    """Cells of speed by current that hold enough samples; `error` is theirs, see `pooled_error`."""
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


def regions_of(overlays: Sequence[Overlay], error: Array) -> dict[str, Region]:
    """Parts of the operating range that have a name; `error` is of all samples, see `pooled_error`."""
    speed = _pooled(overlays, "speed")
    slow = STANDSTILL * float(np.abs(speed).max())
    named = {
        "forwards": ({"speed": (slow, float(speed.max()))}, speed > slow),
        "backwards": ({"speed": (float(speed.min()), -slow)}, speed < -slow),
        "near standstill": ({"speed": (-slow, slow)}, np.abs(speed) <= slow),
    }
    # By the winding's temperature only where that was measured: the model's own is as doubtful as the model.
    if all("temperature" in o.run.channels for o in overlays):
        temperature = _pooled(overlays, "temperature")
        third, two_thirds = np.percentile(temperature, (33.3, 66.7))
        cold, warm = (float(temperature.min()), float(third)), (float(two_thirds), float(temperature.max()))
        named["coldest third"] = {"temperature": cold}, temperature <= third
        named["warmest third"] = {"temperature": warm}, temperature >= two_thirds
    return {
        name: _region(within, error[rows]) for name, (within, rows) in named.items() if rows.sum() >= FEWEST
    }
