"""Whether the motor is the file's: three hypotheses, weighed by what the discrepancies show (Bayes factors; Kass and Raftery
1995, doi:10.1080/01621459.1995.10476572), and what the others do to the intervals.

The file's motor has every discrepancy b at 0, but for SLACK; another motor of the make has J/ke^2 and L anywhere within the
maker's tolerance, and the same of R_a0 and ke, which voltage and current alone do not show; a motor with a voltage drop of
its own, at the brushes or of a sensor, is the file's in all else. An estimate b of variance s^2 is N(0, s^2 + slack^2) for
the one and N(0, s^2 + spread^2) for the other.

Until a start or a step has shown which, the intervals hold all three; what is then shown narrows them, or says in the
quality that another motor is likelier than the file's.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from motorlens_train.observer.layout import Layout
from motorlens_train.observer.signals import rounding

# A maker's tolerance: evenly spread within 10 %.
TOLERANCE = 0.1
# Of J/ke^2 and of L, from J, ke and L each so spread: one deviation, as a share.
SPREAD = {"inertia": TOLERANCE * (5 / 3) ** 0.5, "inductance": TOLERANCE / 3**0.5}
# What the numbers of a motor file are good to, as shares.
SLACK = {"inertia": 0.002, "inductance": 0.005}
# A drop: one deviation as a share of the rated voltage, the prior of `brush_voltage_drop` in the catalogue of effects.
DROP = 0.01
# An interval of 1.96 deviations may leave out one in twenty of the motors of each hypothesis, not of all motors together:
# who has another motor than the file's is not helped by those who have not. One of 4.0: one motor in two thousand.
ONE_IN_TWENTY, HARDLY_ANY = (0.05, 1.96), (0.0005, 4.0)
# Of a motor that creeps or follows a controller, estimates of discrepancies lie up to three of their deviations off.
COUNTED = 1 / 9
# Odds are kept within exp(-+MOST).
MOST = 50.0
# A winding colder than ambient by COLDEST or warmer by WARMEST, K, is none.
WARMEST, COLDEST = 250.0, 20.0


def tested(layout: Layout) -> tuple[str, ...]:
    """Of `SPREAD`: not the inertia where J or ke is a state, nor L where there is none."""
    free = {"inertia": {"J", "ke"} & set(layout.parameters), "inductance": layout.motor.L <= 0}
    return tuple(name for name in SPREAD if not free[name])


def weight(score: Any, information: Any, slack: Any, spread: Any) -> Any:
    """Logarithm of the Bayes factor of N(0, spread) against N(0, slack), variances both, from score and information."""
    # With I the information, 1 + I slack and 1 + I spread are the variances over 1/I.
    near, far = information * slack + 1.0, information * spread + 1.0
    return score * score * (spread - slack) / (near * far) * 0.5 - (far / near).log() * 0.5


def doubt(
    layout: Layout, known: Mapping[str, Any], memory: Mapping[str, Any], x: Sequence[Any], resistance: Any
) -> tuple[Any, dict[str, Any]]:
    """Logarithm of the odds against the file's motor, and by how much the variances of states (by name) grow.

    Args:
        layout: the observer's.
        known: sensitivities of the states, information and score of each discrepancy.
        memory: of the observer, by name.
        x: states.
        resistance: of the winding, ohm.
    """
    w, theta = layout.at["w"], layout.at["theta"]
    rated, other = layout.rated, known["drop"][1] * 0.0
    for name in tested(layout):
        _, information, score = known[name]
        other = other + weight(score, information, SLACK[name] ** 2, SPREAD[name] ** 2)
    moved, told, shown = known["drop"]
    volts, amps = rounding(layout, memory)
    offset = volts + resistance * resistance * amps + (layout.settings.model_sd * rated.voltage_V) ** 2
    missing = weight(shown, told, offset, (DROP * rated.voltage_V) ** 2)
    prior = layout.settings.others / (1.0 - 2.0 * layout.settings.others)
    # Where J or ke is a state, a motor of its own is what the observer looks for.
    another = 0.0 if {"J", "ke"} & set(layout.parameters) else exponent(other) * prior
    drop = exponent(missing) * prior
    either = another + drop
    others = layout.settings.others
    share = 0.0 if isinstance(another, float) else widened(another / (either + 1.0), others)
    lost = widened(drop / (either + 1.0), others)
    grown = {}
    # Another motor is off by as much as its tolerance, and by what its J and L have done to the states.
    for state, size in ((w, x[w]), (theta, x[theta] + 1 / layout.motor.alpha)):
        total = (share * size * TOLERANCE) * (share * size * TOLERANCE) + moved[state] * moved[state] * offset
        for name in tested(layout):
            V, information, score = known[name]
            spread = remaining(score, information, SPREAD[name] ** 2)
            total = total + V[state] * V[state] * (share * share * spread + SLACK[name] ** 2)
        grown[layout.states[state]] = total
    # A drop as large as may remain has moved the states; the speed by all of it, whichever way and whether or not it acts
    # at a current near zero.
    gone = lost * remaining(shown, told, (DROP * rated.voltage_V) ** 2).sqrt()
    for state, moves in ((w, moved[w].abs().max(1 / layout.motor.ke)), (theta, moved[theta])):
        name = layout.states[state]
        grown[name] = grown[name] + gone * moves * (gone * moves)
    hot = (x[theta] - WARMEST).max(-COLDEST - x[theta])
    return (0.0 <= hot).select(MOST, either.log()), grown


def remaining(score: Any, information: Any, spread: Any) -> Any:
    """Half the width, squared, of an even spread with the mean square of a discrepancy, given what has shown of it.

    Windows in a row err alike, so that they count for fewer: see COUNTED.
    """
    variance = 1.0 / (information * COUNTED + 1 / spread)
    mean = score * variance * COUNTED
    return (mean * mean + variance) * 3.0


def exponent(logarithm: Any) -> Any:
    """exp, of a logarithm kept within `MOST`."""
    return logarithm.max(-MOST).min(MOST).exp()


def widened(probability: Any, prior: float) -> Any:
    """Deviation, in terms of half the width of an even spread, by which intervals must be wider that hold with a probability
    what is so spread.

    Beyond a share x of the half width lies (1 - x) of it: an interval that leaves out q reaches to 1 - q / probability. A
    hypothesis of a `prior` that has become twenty times less likely is refuted.
    """
    widest: Any = 0.0
    for left_out, deviations in ((ONE_IN_TWENTY[0] * prior, ONE_IN_TWENTY[1]), HARDLY_ANY):
        widest = ((1.0 - left_out / probability) * (1.0 / deviations)).max(widest)
    return widest
