"""What looks wrong in a recording: words for "no value", counts taken for units, dead and clipped channels, gaps, signs."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.conditions import Terminal

Array = NDArray[np.float64]

# A word for "no value" stands alone, is a whole number, and comes back: so often, for so many samples, so many times as far
# from its neighbours as these are from each other.
_TIMES, _LONGEST, _FAR = 3, 10, 5.0
# So much of the voltage is explained by current and speed where their signs can be judged, and so many deviations.
_EXPLAINED, _SURE = 0.5, 5.0
# A winding is no colder, and its insulation no longer one.
COLDEST_C, HOTTEST_C = -100.0, 400.0
# A channel that nowhere leaves a multiple of the voltage by more than this share of itself was computed from it, if the
# voltage takes at least so many values: a motor has an inductance, turns and warms, and a sensor has noise.
_ROUNDED, _VALUES = 1e-5, 16
# So many rows show a sign, or a time constant.
_ROWS = 50_000
# So much of the time a motor is driven backwards on purpose.
_BACK = 0.05
# A motor stands still without a current below this share of the largest speed and current.
_STILL = 0.02
# A channel that is clipped shows the same again at its extreme this many times as often as elsewhere.
_OFTENER = 2
# Steps within this share of a whole number of periods are those of a steady clock; of more periods than that, a gap.
_WHOLE, _GAP = 0.1, 10
# Time constants with which the speed of a motor follows its voltage, s: a coreless one of a few grams takes 1 ms or more,
# one of kilowatts with its load a second or two. Milliseconds for seconds are a factor of a thousand.
_FASTEST_S, _SLOWEST_S = 3e-4, 10.0
# So much of the speed must follow from the voltage where that is judged.
_FOLLOWS = 0.8


def no_value(y: Array, voltage: Array | None) -> float | None:
    """A whole number that stands for "no value" (-9999, -1, 0): the channel jumps to it and back, again and again.

    Args:
        y: (N,) one channel; NaN where missing.
        voltage: (N,) what drove the motor; where it jumps as well, the channel had reason to. None for the voltage itself,
            which may be given in pulses: of it only what is far out of all others is a word.
    """
    starts = np.flatnonzero(np.r_[True, y[1:] != y[:-1]])  # of runs of equal numbers
    inner = starts[1:-1]
    at = 1 + np.flatnonzero(y[inner] == np.round(y[inner]))  # the runs of whole numbers
    if len(at) < _TIMES:
        return None
    value, before, after = y[starts[at]], y[starts[at - 1]], y[starts[at + 1]]
    jump = np.minimum(np.abs(value - before), np.abs(value - after))
    alone = (jump > _FAR * np.abs(after - before)) & (starts[at + 1] - starts[at] <= _LONGEST)
    if voltage is None:
        near = np.zeros(len(at), dtype=bool)
    else:
        usual = 3 * float(np.nanmedian(np.abs(np.diff(y[starts]))))
        driven = np.abs(voltage[starts[at]] - (voltage[starts[at] - 1] + voltage[starts[at + 1]]) / 2)
        near = alone & (jump > _FAR * usual) & (driven <= 0.1 * np.ptp(voltage))
    words, times = np.unique(value[alone], return_counts=True)
    words = words[times >= _TIMES]
    if not len(words):
        return None
    largest = words[np.argmax(np.abs(words))]
    others = np.nanmax(np.abs(y), where=np.isfinite(y) & (y != largest), initial=0.0)
    if (
        others > 0
        and abs(largest) > 10 * others
        and 2 * np.sum(value[alone] == largest) >= np.sum(value == largest)
    ):
        return float(largest)
    words, times = np.unique(value[near], return_counts=True)
    for word, count in zip(words, times, strict=True):
        if count >= max(_TIMES, 0.5 * np.sum(value == word)):
            return float(word)
    return None


def computed_from(y: Array, voltage: Array) -> float | None:
    """How many times the voltage a channel (N,) is where it is that in every sample, as nothing measured is; else None.

    >>> volts = np.sin(np.arange(100.0))
    >>> computed_from(35.15 * volts, volts), computed_from(35.15 * volts + 1e-3 * np.cos(np.arange(100.0)), volts)
    (35.15, None)
    """
    there = np.isfinite(y) & np.isfinite(voltage)
    y, voltage = y[there], voltage[there]
    if len(np.unique(voltage[:_ROWS])) < _VALUES or not np.ptp(y):
        return None
    factor = float(voltage @ y / (voltage @ voltage))
    rest = y - factor * voltage
    return float(f"{factor:.6g}") if np.abs(rest).max() <= _ROUNDED * np.abs(y).max() else None


def lost_samples(time: Array) -> list[str]:
    """Samples that lie between the rows of a steady clock, in words; longer gaps are told by `gaps_and_channels`."""
    steps = np.diff(time)
    period = float(np.median(steps))
    whole = np.round(steps / period)
    lost = int(np.sum(whole - 1))
    if not lost or steps.max() > _GAP * period or np.any(np.abs(steps / period - whole) > _WHOLE * whole):
        return []
    return [
        f"{lost} samples of a steady clock are not there, the first after {time[np.argmax(whole > 1)]:.6g} s"
    ]


def gaps_and_channels(time: Array, channels: Mapping[str, Array]) -> list[str]:
    """Gaps, dead and clipped channels, reversed signs, in words: they look wrong, but may be meant."""
    notes = []
    steps = np.diff(time)
    gaps = np.flatnonzero(steps > _GAP * np.median(steps))
    if len(gaps):
        notes.append(
            f"{len(gaps)} gaps in time, the longest {steps.max():.3g} s after {time[np.argmax(steps)]:.6g} s"
        )
    for quantity in ("voltage", "current", "speed", "temperature"):
        y = channels.get(quantity)
        if y is None:
            continue
        if quantity == "temperature" and (np.nanmin(y) < COLDEST_C or np.nanmax(y) > HOTTEST_C):
            notes.append(
                f"temperature runs from {np.nanmin(y):.4g} to {np.nanmax(y):.4g} degC: counts of a converter, or another "
                "unit?"
            )
        if np.nanmin(y) == np.nanmax(y):
            if quantity == "voltage" and (not _drives(channels) or (y[0] != 0 and _answered(channels))):
                continue  # a step that is commanded
            notes.append(f"{quantity} never changes ({np.nanmin(y) + 0.0:g}): a dead channel?")
            continue
        ends = (np.nanmin(y), np.nanmax(y))
        within = (y[:-1] != ends[0]) & (y[:-1] != ends[1]) & (y[:-1] != 0)
        again = np.diff(y) == 0
        for limit in ends:
            at_limit = y[:-1] == limit
            runs = np.sum(at_limit & again)
            # A commanded voltage rests at its levels, and a motor rests at zero; a measured signal does not rest at a peak
            # more than elsewhere, where it is as coarse.
            if (
                quantity in ("current", "speed")
                and limit != 0
                and runs > 0.02 * len(y)
                and runs * np.sum(within) >= _OFTENER * np.sum(within & again) * np.sum(at_limit)
            ):
                notes.append(
                    f"{quantity} stays at its extreme value {limit:g} for {int(runs)} samples: clipped?"
                )
    return notes + standstill(channels) + signs(channels) + without_sign(channels) + pace(time, channels)


def _drives(channels: Mapping[str, Array]) -> bool:
    """Whether the voltage drives the terminals at any time."""
    return "terminal" not in channels or bool(np.any(channels["terminal"] == Terminal.DRIVEN))


def _answered(channels: Mapping[str, Array]) -> bool:
    """Whether a motor answers to its voltage: its current or its speed changes."""
    return any(np.nanmin(y) < np.nanmax(y) for name, y in channels.items() if name in ("current", "speed"))


def standstill(channels: Mapping[str, Array]) -> list[str]:
    """Whether a voltage stands while no current flows and nothing turns: at a motor's terminals it drives v / R."""
    if not {"voltage", "current", "speed"} <= set(channels):
        return []
    v, i, w = (np.abs(np.nan_to_num(channels[q])) for q in ("voltage", "current", "speed"))
    v = v * (channels.get("terminal", 0 * v) == Terminal.DRIVEN)
    if not (v.max() and i.max() and w.max()):
        return []
    still = (i < _STILL * i.max()) & (w < _STILL * w.max())
    at_rest = still & (v > 0.5 * v.max())
    # A few samples are the beginning of a step, before the current has risen.
    if at_rest.sum() < max(_STILL * len(v), 20) or at_rest.sum() < 0.5 * still.sum():
        return []
    return [
        f"the voltage stays at {np.median(v[at_rest]):.3g} V while no current flows and nothing turns: that of a supply, or "
        "before a speed controller, and not the motor's? --terminal current --shaft turned looks at its heat alone"
    ]


def pace(time: Array, channels: Mapping[str, Array]) -> list[str]:
    """Whether the stamps are in the unit they are said to be in: how fast the speed follows the voltage tells.

    The balance of torques is integrated, so that no noise is differentiated:
    w = a int(v) - int(w) / tau - c int(sign w) + d t + e.
    """
    if not {"voltage", "speed"} <= set(channels):
        return []
    v, w = channels["voltage"], np.nan_to_num(channels["speed"])
    held = np.diff(time, prepend=time[0])
    # Of a rotor that turns one way only, friction is part of d.
    both = [np.sign(w)] if w.min() < 0 < w.max() else []
    integrals = [np.cumsum(held * y) for y in (v, w, *both)]
    rows = slice(None, None, 1 + len(w) // _ROWS)
    columns = np.column_stack([y[rows] for y in (*integrals, time - time[0], np.ones(len(w)))])
    y = w[rows]
    size = np.abs(columns).max(axis=0)
    if len(y) < 20 or not np.ptp(y) or not size.all():
        return []
    columns /= size
    slopes, _, rank, _ = np.linalg.lstsq(columns, y, rcond=1e-10)
    rest = y - columns @ slopes
    if rank < columns.shape[1] or rest @ rest > (1 - _FOLLOWS) * np.sum((y - y.mean()) ** 2):
        return []
    # Residuals hang together; a tenth of the samples count.
    sd = np.sqrt(10 * (rest @ rest) / len(y) * np.diag(np.linalg.pinv(columns.T @ columns)))
    if slopes[0] < _SURE * sd[0]:
        return []
    rate, sure = -slopes[1] / size[1], 3 * sd[1] / size[1]
    if 0 < rate and rate + sure < 1 / _SLOWEST_S:
        return [
            f"as stamped, the speed follows the voltage in {1 / (rate + sure):.2g} s or more, as only a flywheel does: are "
            "the stamps in ms or us? --column time_ms=NAME"
        ]
    if rate - sure > 1 / _FASTEST_S:
        return [
            f"as stamped, the speed follows the voltage in {1 / (rate - sure):.2g} s or less, as no motor does: are the "
            "stamps in s? --column time_s=NAME"
        ]
    return []


def without_sign(channels: Mapping[str, Array]) -> list[str]:
    """Whether a current never falls below zero though the voltage does.

    So show a shunt behind a rectifier, and the sense output of a bridge. A motor that is driven backwards takes a current
    that is negative, but for moments in which it brakes.
    """
    if not {"voltage", "current"} <= set(channels):
        return []
    v, i = channels["voltage"], np.nan_to_num(channels["current"])
    back = (v < 0) & (channels.get("terminal", 0 * v) == Terminal.DRIVEN)
    some = _STILL * i.max()
    if i.min() < -some or back.mean() < _BACK or np.median(i[back]) <= some:
        return []
    return [
        f"the current never falls below zero, though the voltage is negative in {back.mean():.0%} of the samples: shown "
        "without its sign? --column 'current=NAME*sign(VOLTAGE)'"
    ]


def signs(channels: Mapping[str, Array]) -> list[str]:
    """Whether the voltage falls with current or speed, which it does at no motor (v = R i + ke w, R and ke above 0)."""
    if not {"voltage", "current", "speed"} <= set(channels):
        return []
    every = 1 + len(channels["voltage"]) // _ROWS
    table = np.column_stack([channels[q][::every] for q in ("voltage", "current", "speed")])
    table = table[np.isfinite(table).all(axis=1)]
    if len(table) < 10 or not np.ptp(table, axis=0).all():
        return []
    v, columns = table[:, 0], table[:, 1:] / np.ptp(table[:, 1:], axis=0)
    slopes, _, rank, _ = np.linalg.lstsq(columns, v, rcond=None)
    rest = v - columns @ slopes
    # Of its changes, not of its size: a supply that sags under load is no motor's voltage.
    if rank < 2 or rest @ rest > (1 - _EXPLAINED) * np.sum((v - v.mean()) ** 2):
        return []
    # Residuals hang together; a tenth of the samples count.
    sd = np.sqrt(10 * (rest @ rest) / len(v) * np.diag(np.linalg.inv(columns.T @ columns)))
    if slopes[0] < -_SURE * sd[0]:
        return [
            "the voltage falls with the current at equal speed: is the current reversed (--column 'current=-NAME'), or is "
            "this the voltage of a supply, before the bridge?"
        ]
    if slopes[1] < -_SURE * sd[1]:
        return [
            "the voltage falls with the speed at equal current: is the speed reversed, or are voltage and current swapped? "
            "--column 'speed=-NAME', or --column voltage=NAME --column current=NAME"
        ]
    return []
