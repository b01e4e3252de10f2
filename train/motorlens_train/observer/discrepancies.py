"""What sensors and motor have that the motor file does not know, told from the innovations: Friedland's bias filter.

Beside the filter each discrepancy b has the sensitivity V of the states' error to it. Over a window of states'
Jacobian F and
gain K, with H the slopes of the innovation e over the states, G and D what b itself adds to the states and to e,

    U = F V + G,  g = D + H U,  V = U - K g,  e = g b + white noise of variance S

so that sum g e / S and sum g^2 / S, score and information, tell b and how well it is known (Friedland 1969,
doi:10.1109/TAC.1969.1099223; the score as a test: Rao 1948). How the voltage runs between samples is found and made good;
the others are weighed only: what they say of the motor is `belief`'s to tell.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from motorlens_train.observer.algebra import dot
from motorlens_train.observer.belief import HOLD_KNOWN, STAMPED
from motorlens_train.observer.layout import DISCREPANCIES, PAIRS, Layout
from motorlens_train.observer.program import Value
from motorlens_train.observer.signals import WINDOWS, Signals, beyond

# What a discrepancy shows by must be beyond so many deviations of noise: its product with an innovation holds the noise's
# square, which would add up. The currents' share of the noise is known to a factor of two only.
CLEAR = 10.0
# What is left of the variance of a window in which the voltage changed, once it is known how it runs between samples.
LEFT = STAMPED * HOLD_KNOWN
# A change that tells how the voltage runs is worth so many deviations of what else a window may be off by.
PLAIN = 3.0
# The innovations' excess from which on the noise is taken to have changed: they are twice as large (squared) as stated.
RESTLESS = 1.0
# A change of the current tells of the inductance beyond this share of the rated one.
LARGE = 0.3
# Beyond this share of the rated current it is; on the way there the filter may have taken part of it for a speed.
FIRM = 0.3
# Scores and information fade with this time constant, s: what was true of the motor ten minutes ago need not be.
FADE_S = 600.0


@dataclass(frozen=True)
class Window:
    """One window of the filter: innovation `error` (V) of variance S (V^2), gain K, slopes H, Jacobian F, rates of the
    states; `near` is 1 where the rotor may rest, `changes` what a change of the voltage adds to S, not knowing when it came,
    `changing` the probability that the load does."""

    error: Any
    S: Any
    K: list[Any]
    H: list[Any]
    F: list[list[Any]]
    rates: list[Any]
    near: Any
    changes: Any
    changing: Any


def told(
    layout: Layout, known: Mapping[str, Any], common: Mapping[str, Any], window: Mapping[str, Value],
    memory: Mapping[str, Value], found: Signals, filtered: Window, believed: Any,
) -> tuple[list[Any], Any, list[Any]]:  # fmt: skip
    """After a window: what is kept of all discrepancies, the new `hold`, and by how much the states move with it."""
    w, T, n = layout.at["w"], window["time"], len(layout.states)
    H, S, rated = filtered.H, filtered.S, layout.rated
    weight = 1.0 / S
    change = window["current"] - window["current_start"]
    swing = (found.level * (2 * layout.i_sd**2)).sqrt() * CLEAR + LARGE * rated.current_A
    direct = {
        "hold": found.lean,
        "inertia": 0.0,
        # Only a change that the voltage drives, and far above its noise, tells of the inductance.
        "inductance": beyond(change, swing) * found.free * layout.motor.L / T,
        "drop": found.side,
    }
    # On the way through zero nobody knows what part of a drop is there already.
    limit = FIRM * rated.current_A + 3.0 * found.noise
    firm = limit * limit <= found.slope * (window["sum_current"] / T)
    # While the noise is being found, or has just changed, nothing stands above it for certain.
    settled = (WINDOWS <= memory["count"]) * (memory["restless"] <= RESTLESS)
    kept: list[Any] = []
    slopes: dict[str, Any] = {}
    moves: Any = 0.0
    stays = 1.0 - (T * (1 / FADE_S)).min(1.0) * believed
    hold, shift = window["hold"], [0.0] * n
    for name in DISCREPANCIES:
        V, information, score = known[name]
        U = [dot(row, V) * believed for row in filtered.F]
        g = direct[name] + dot(H, U)
        if name == "inertia":
            pushed = (
                beyond(filtered.rates[w], found.noise * (CLEAR * layout.motor.ke / layout.motor.J))
                * T
                * believed
            )
            U[w] = U[w] - pushed
            # As in the filter: of what drives the speed, its mean over the window has seen half.
            g = g - 0.5 * H[w] * pushed
        g = g * believed
        V = [U[j] - filtered.K[j] * g for j in range(n)]
        # While the load is whatever holds the rotor, or is changing, an innovation tells of the load.
        g = g * (1.0 - filtered.near) * (1.0 - filtered.changing)
        g = g * firm if name == "drop" else g
        slopes[name] = g
        if name == "hold":
            # Only a change of the voltage that stands above all that a window may be off by tells how it ran.
            S_known = S - filtered.changes * (1.0 - LEFT)
            g = g * settled * (S_known * PLAIN**2 <= found.lean * found.lean)
            information = information + g * g / S_known
            step = g * filtered.error / (S_known * (information + HOLD_KNOWN))
            held = (hold + step).max(-0.5).min(0.5)
            moves = held - hold
            hold, shift = held, [v * moves for v in V]
        else:
            information = information + g * g * weight
            # Had the voltage been taken to run as it is now known to, the innovations would have been others.
            score = score - common[name] * moves if name in PAIRS else score
            information, score = information * stays, (score + g * (filtered.error * weight)) * stays
        kept += [*V, information, score]
    for name, shared in common.items():
        one, other = PAIRS[name]
        kept.append((shared + slopes[one] * slopes[other] * weight) * stays)
    return kept, hold, shift
