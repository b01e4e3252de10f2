"""What sensors and motor have that the motor file does not know, told from the innovations: Friedland's bias filter.

Beside the filter each discrepancy b has the sensitivity V of the states' error to it. Over a window of states'
Jacobian F and
gain K, with H the slopes of the innovation e over the states, G and D what b itself adds to the states and to e,

    U = F V + G,  g = D + H U,  V = U - K g,  e = g b + white noise of variance S

so that sum g e / S and sum g^2 / S, score and information, tell b and how well it is known (Friedland 1969,
doi:10.1109/TAC.1969.1099223; the score as a test: Rao 1948). How the voltage runs between samples is found and made good;
the others are tested only: where one stands out, the motor is not the file's, and the observer says that it foretells
nothing.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from motorlens_train.observer.algebra import dot
from motorlens_train.observer.layout import DISCREPANCIES, Layout
from motorlens_train.observer.program import Value
from motorlens_train.observer.signals import DRIVEN, Signals, above

# Held or linear, nobody knows: 0.5 with a deviation of 0.5, whose square's reciprocal is this information.
HOLD_KNOWN = 4.0
# A drop is as large as it gets from this share of the rated current on.
SATURATED = 0.02
# Scores and information fade with this time constant, s: what was true of the motor ten minutes ago need not be.
FADE_S = 600.0
# A discrepancy is told when its score is this many deviations off.
SIGNIFICANT = 4.5
# To what each must be known (one deviation: shares of J and of L, and of the rated voltage) before its score says anything,
# and before the observer is believed: 0.5 % of J is 1 rad/s of an inrush to 200 rad/s, 0.25 V of 240 a sixth of a
# brush drop.
RESOLVED = {"inertia": 0.005, "inductance": 0.02, "drop": 0.001}
# A short rest or a slow drive tells nothing of L; without it the observer may still be believed.
ASKED = ("inertia", "drop")
# A winding colder than ambient by COLDEST or warmer by WARMEST, K, is none.
WARMEST, COLDEST = 250.0, 20.0


@dataclass(frozen=True)
class Window:
    """One window of the filter: innovation `error` (V) of variance S (V^2), gain K, slopes H, Jacobian F, rates of the
    states."""

    error: Any
    S: Any
    K: list[Any]
    H: list[Any]
    F: list[list[Any]]
    rates: list[Any]


def tested(layout: Layout) -> tuple[str, ...]:
    """The discrepancies that are tested: not the inertia where J or ke is a state, nor L where there is none."""
    free = {"inertia": {"J", "ke"} & set(layout.parameters), "inductance": layout.motor.L <= 0}
    return tuple(name for name in RESOLVED if not free.get(name))


def told(
    layout: Layout, known: Mapping[str, Any], window: Mapping[str, Value], found: Signals, filtered: Window, believed: Any
) -> tuple[list[Any], Any, list[Any]]:  # fmt: skip
    """After a window: what is kept of all discrepancies, the new `hold`, and by how much the states move with it."""
    w, T, n = layout.at["w"], window["time"], len(layout.states)
    H, S, rated = filtered.H, filtered.S, layout.rated
    change = window["current"] - window["current_start"]
    noise = found.level * (8 * layout.i_sd**2) + (0.1 * DRIVEN * rated.current_A) ** 2
    saturated = (found.slope * (1 / (SATURATED * rated.current_A))).max(-1.0).min(1.0)
    direct = {
        "hold": found.lean,
        "inertia": 0.0,
        # Only a change that the voltage drives, and far above its noise, tells of the inductance.
        "inductance": above(change, noise) * found.free * layout.motor.L / T,
        "drop": saturated,
    }
    # The states feel all of it; the score counts what is beyond the voltage's noise.
    told_by = above(found.lean, found.share * found.share * found.level * (0.5 * layout.v_sd**2)) - found.lean
    kept: list[Any] = []
    hold, shift = window["hold"], [0.0] * n
    for name in DISCREPANCIES:
        V, information, score = known[name]
        U = [dot(row, V) * believed for row in filtered.F]
        g = direct[name] + dot(H, U)
        if name == "inertia":
            pushed = filtered.rates[w] * T * believed
            U[w] = U[w] - pushed
            # As in the filter: of what drives the speed, its mean over the window has seen half.
            g = g - 0.5 * H[w] * pushed
        g = g * believed
        V = [U[j] - filtered.K[j] * g for j in range(n)]
        if name == "hold":
            g = g + told_by * believed
        information = information + g * g / S
        if name == "hold":
            step = g * filtered.error / S / (information + HOLD_KNOWN)
            hold, shift = hold + step, [v * step for v in V]
        else:
            stays = 1.0 - (T * (1 / FADE_S)).min(1.0) * believed
            information, score = information * stays, (score + g * filtered.error / S) * stays
        kept += [*V, information, score]
    return kept, hold, shift


def distrust(layout: Layout, known: Mapping[str, Any], theta: Any) -> tuple[Any, Any]:
    """Reasons not to believe the observer, above 1 where there is one: all of them, and those that are shown to be there.

    A motor that nothing has excited has not shown that it is the file's.
    """
    shown = (theta - WARMEST).max(-COLDEST - theta).min(1.0) + 1.0
    unproven: Any = 0.0
    for name in tested(layout):
        _, information, score = known[name]
        size = RESOLVED[name] * (layout.rated.voltage_V if name == "drop" else 1.0)
        needed = 1 / size**2
        shown = shown.max(score.abs() / (information + 0.1 * needed).sqrt() * (1 / SIGNIFICANT))
        if name in ASKED:
            unproven = (needed / information.max(1e-4 * needed)).sqrt().max(unproven)
    return shown.max(unproven).max(0.01).min(100.0), shown
