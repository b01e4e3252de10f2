"""What the observer finds of its signals while it runs, window by window: their noise, the slope that weighs an
innovation, the steps of the converters. None of it is assumed; the settings only say where the search begins.

A square holds its noise's square. So whatever is multiplied with an innovation (the current in R(theta) i, a change of the
voltage or of the current) enters by what of it stands above its noise, `above`: averaged, two noises in one product would
heat or cool a winding without end (errors in variables; Söderström 2007, doi:10.1016/j.automatica.2006.11.025).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from motorlens_train.observer.layout import Layout
from motorlens_train.observer.program import Value

# A value counts by d^2 / (d^2 + (10 sd)^2): of pure noise 3 in 100 are left.
ABOVE = 100.0
# The slope's average takes in at least this share of a window: a second's memory at 10 ms.
LEAST = 0.01
# What the voltage drives: currents beyond this share of the rated one.
DRIVEN = 0.05
# A current drives to one side from this share of the rated one on: a brush drop is then as large as it gets.
SATURATED = 0.02
# What lies within so many deviations may be noise.
MAY_BE_NOISE = 3.0
# The level of the noise is an average over so many windows, the settings' level at the start worth 2 of them: one window
# tells the logarithm of a variance to pi/sqrt(2), and two the deviation to a factor of 2.2. A drive whose noise is more than
# that from the settings' must be found out before its first innovations have moved the winding.
WINDOWS, PRIOR = 42.0, 2.0
# The mean of the logarithm of a squared normal deviate is -1.2704 (-ln 2 minus Euler's constant); one window moves the
# average by at most exp(4), and it stays within a hundredth and a hundred times (in sd) of where it began.
LOG_SQUARE, MOST_LOG, RANGE = 1.2704, 4.0, 9.2
# Coloured noise weighs (1 + c)/(1 - c) times as much as white: c is at most this.
MOST_COLOUR = 0.8
# Two innovations in a row, of either sign and of 4 white deviations each: once in hours of noise that is as loud as it is
# said to be. What a load, a motor or its states do to them has one sign.
ALTERNATE = 16.0
# Until a change has shown a converter's step, it may be as large as this many of the settings' deviations.
COARSEST = 3.5


def above(value: Any, variance: Any) -> Any:
    """What of a value stands above noise of a variance."""
    square = value * value
    return value * (square / (square + variance * ABOVE + 1e-12))


def beyond(value: Any, limit: Any) -> Any:
    """What of a value is beyond a limit, of either sign: what may be noise is nothing."""
    return value - value.min(limit).max(-limit)


@dataclass(frozen=True)
class Signals:
    """Of one window.

    Attributes:
        level: variance of white noise, in terms of the settings'.
        colour: factor by which it weighs more, being coloured.
        white: variance that white noise gives an innovation, V^2.
        share: sum of squared steps over the squared length: 1 / samples.
        slope: mean of the current, A; `weighing` weighs an innovation: what of it was beyond its noise before this window,
            and a change since that no noise can be.
        side: the side to which the current drives the rotor, -1 or 1, and less where noise hides it.
        free: share of the current's change that the voltage drives.
        turned: change of the slope that the load made, over ke; see `correction`.
        lean: by how much the mean voltage is less if it stood between samples than if it ran linearly, V.
        noise: one deviation of the mean current, A.
        coarse: variance that rounding in the converters adds to a window's mean voltage.
        memory: what is kept for the next window, by name.
    """

    level: Any
    colour: Any
    white: Any
    share: Any
    slope: Any
    weighing: Any
    side: Any
    free: Any
    turned: Any
    lean: Any
    noise: Any
    coarse: Any
    memory: dict[str, Any]


def signals(layout: Layout, window: Mapping[str, Value], memory: Mapping[str, Value], gap: Any) -> Signals:
    """What this window shows; the noise is what the windows before have shown."""
    m, T = layout.motor, window["time"]
    level, share = memory["log_level"].exp(), window["sum_steps"] / (T * T)
    volts = gap.select(window["voltage"], window["sum_voltage"] / T)
    moved = above(volts - memory["drive"], share * (layout.v_sd**2) * level)
    # The current that the voltage's changes drive, and that dies away as the rotor follows.
    decay = (T * (-(m.ke**2) / (m.R_a0 * m.J))).exp()
    driven = (memory["driven"] + moved * (1 / m.R_a0)) * decay
    free = driven * driven / (driven * driven + (DRIVEN * layout.rated.current_A) ** 2)
    spread = share * (layout.i_sd**2) * level
    away = window["sum_current"] / T - memory["slope"]
    square = away * away
    followed = away * (square / (square + spread * ABOVE + 1e-12)).max(LEAST)
    slope = memory["slope"] + followed
    # A current that may be noise says nothing about the resistance.
    noise = spread.sqrt()
    now, before = (beyond(y, noise * MAY_BE_NOISE) for y in (slope, memory["slope"]))
    # An innovation holds the noise of this window's current: with that in the slope as well, their product would heat or
    # cool the winding without end. The slope before is another window's (instrumental variables; Söderström 2007), and a
    # change is this one's own where it is beyond all the noise that is found, were it the current's alone. There is but one
    # slope: gains that are of one and covariances that are of another let loads that change pass for temperatures.
    most = noise * math.sqrt(1.0 + (layout.v_sd / (m.R_a0 * layout.i_sd)) ** 2)
    weighing = before + beyond(now - before, most * MAY_BE_NOISE)
    lean = gap.select(0.0, window["sum_lean"] / T)
    coarse, kept = _coarse(layout, window, memory, level)
    kept |= {"drive": memory["drive"] + moved, "driven": driven, "slope": slope}
    # Of the resistance at the start: the current's noise is the smaller one there, and the level makes good for the rest.
    sample = layout.v_sd**2 + (m.resistance(layout.start[layout.at["theta"]]) * layout.i_sd) ** 2
    white = level * (share * sample + (2 * (m.L * layout.i_sd) ** 2) / (T * T))
    colour = (1.0 + memory["colour"]) / (1.0 - memory["colour"])
    turned = (1.0 - free) * (weighing - before) * (1 / m.ke)
    side = (weighing * (1 / (SATURATED * layout.rated.current_A))).max(-1.0).min(1.0)
    return Signals(
        level, colour, white, share, slope, weighing, side, free, turned, lean, noise, coarse, kept
    )


def noise_memory(memory: Mapping[str, Value], error: Any, told: Any, believed: Any) -> dict[str, Any]:
    """Level and colour of the noise after an innovation `error`, in its own white deviations.

    The level follows the mean logarithm, which an outlier moves no more than a small one. A window counts by what of its
    variance is white noise, `told`: where the states are hardly known, an innovation tells of them. Noise that has become
    louder is sought anew: as it is, its innovations would pass for loads that jump and motors of which nothing is known.
    """
    product = error * memory["error"]
    count = ((-ALTERNATE <= product) * memory["count"] + told).min(WINDOWS)
    pace = told / (count + PRIOR)
    larger = ((error * error + 1e-9).log() + LOG_SQUARE).max(-MOST_LOG).min(MOST_LOG)
    product = product.max(-MOST_LOG).min(MOST_LOG)
    return {
        "log_level": (memory["log_level"] + pace * larger).max(-RANGE).min(RANGE),
        "colour": (memory["colour"] + pace * (product - memory["colour"])).max(0.0).min(MOST_COLOUR),
        "error": error * believed,
        "count": count,
    }


def rounding(layout: Layout, memory: Mapping[str, Value], level: Any = None) -> tuple[Any, Any]:
    """Variance that rounding leaves in a steady voltage (V^2) and current (A^2), from the smallest changes seen.

    Those (`fine_...`, as reciprocals) are the converter's steps q; where noise does not carry a signal over a step, what is
    lost in rounding, q^2 / 12, stays for as long as the signal stands. Of noise sd the share exp(-2 pi^2 sd^2 / q^2) of it
    is left (Widrow and Kollar 2008, Quantization Noise, ch. 4).
    """
    level = memory["log_level"].exp() if level is None else level
    found = []
    for channel, sd in (("voltage", layout.v_sd), ("current", layout.i_sd)):
        step = 1.0 / memory[f"fine_{channel}"].max(1 / (COARSEST * sd))
        square = step * step
        found.append(square * (level * (-2 * math.pi**2 * sd**2) / square).max(-50.0).exp() * (1 / 12))
    return found[0], found[1]


def _coarse(
    layout: Layout, window: Mapping[str, Value], memory: Mapping[str, Value], level: Any
) -> tuple[Any, dict[str, Any]]:
    """Variance that converters add to a window's mean voltage, and the smallest changes seen (as reciprocals).

    The motor settles with its mechanical time constant tau, so what rounding leaves weighs as 2 tau / T windows' worth of
    white noise. L (i_end - i_start) / T holds two rounded currents.
    """
    T, m = window["time"], layout.motor
    kept = {"last_voltage": window["voltage"] * 1.0}
    for channel, before in (("voltage", memory["last_voltage"]), ("current", window["current_start"])):
        change = (window[channel] - before).abs()
        finest = (1e-9 <= change).select(1.0 / change.max(1e-9), 0.0)
        kept[f"fine_{channel}"] = memory[f"fine_{channel}"].max(finest)
    lasts = 2 * m.R_a0 * m.J / m.ke**2 / layout.period
    volts, amps = rounding(layout, kept, level)
    return volts * lasts + amps * (lasts * m.R_a0**2) + amps * (2 * m.L**2) / (T * T), kept
