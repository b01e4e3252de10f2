"""Whether the motor is the file's: three hypotheses, weighed by what the discrepancies show (Bayes factors; Kass and Raftery
1995, doi:10.1080/01621459.1995.10476572), and what the others do to the intervals.

The file's motor has every discrepancy b at 0, but for SLACK; another motor of the make has J/ke^2 and L anywhere within the
maker's tolerance, and the same of R_a0 and ke, which voltage and current alone do not show; a motor with a voltage drop of
its own, at the brushes or of a sensor, is the file's in all else. An estimate b of variance s^2 is N(0, s^2 + slack^2) for
the one and N(0, s^2 + spread^2) for the other. Inertia and inductance are weighed together, and with how the voltage runs
between samples (`hold`) as open as it is: at one frequency what one of them does to the voltage cancels another, and each
alone looks like the file's. A few motors have both by chance: R_a0, as far as a cold start shows it, is
weighed with them (`cold`).

Until a start or a step has shown which, the intervals hold all three; what is then shown narrows them, or says in the
quality that another motor is likelier than the file's.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from motorlens_physics.motor_file import Knowledge
from motorlens_train.observer.algebra import probability
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
# Held or linear, nobody knows: 0.5 with a deviation of 0.5, whose square's reciprocal is this information.
HOLD_KNOWN = 4.0
# Of either it is good to a tenth of a step: so are its stamps.
STAMPED = 0.1**2
# Odds are kept within exp(-+MOST).
MOST = 50.0
# A winding colder than ambient by COLDEST or warmer by WARMEST, K, is none.
WARMEST, COLDEST = 250.0, 20.0


def left_open(known: Knowledge, value: float) -> float:
    """Half the width, as a share, of a parameter's even spread: what the file leaves open, at most a maker's tolerance."""
    return TOLERANCE if known.sd is None or not value else min(TOLERANCE, 3**0.5 * known.sd / abs(value))


def open_resistance(layout: Layout) -> float:
    """The same of R_a0; 0 where `tolerances` has it already."""
    if "R_a0" in dict(layout.settings.tolerances):
        return 0.0
    return left_open(layout.knowledge.get("R_a0", Knowledge()), layout.motor.R_a0)


def variances(layout: Layout, shares: Mapping[str, float]) -> tuple[float, float]:
    """Of inertia and inductance, from `SLACK` or `SPREAD`: none where J or ke is a state, or where there is no L."""
    free = bool({"J", "ke"} & set(layout.parameters)), layout.motor.L <= 0
    one, other = (
        0.0 if none else shares[name] ** 2 for name, none in zip(("inertia", "inductance"), free, strict=True)
    )
    return one, other


@dataclass(frozen=True)
class Shown:
    """What innovations show of two discrepancies: `score` and `information` of each, and the information they have in
    `common`."""

    score: tuple[Any, Any]
    information: tuple[Any, Any]
    common: Any

    def _shrunk(self, variances: tuple[float, float]) -> tuple[tuple[Any, Any, Any], Any]:
        """Posterior variances of both and their covariance under N(0, `variances`), times det(1 + information variances);
        and that determinant."""
        (a, d), c, (p, q) = self.information, self.common, variances
        # Not negative but for rounding (Cauchy and Schwarz).
        apart = (a * d - c * c).max(0.0)
        one, other = a * p + 1.0, d * q
        return (other * p + p, one * q, c * (-p * q)), one + other + apart * (p * q)

    def weight(self, slack: tuple[float, float], spread: tuple[float, float]) -> Any:
        """Logarithm of the Bayes factor of N(0, `spread`) against N(0, `slack`), variances both."""
        (near, small), (far, large) = self._shrunk(slack), self._shrunk(spread)
        return (
            _square(far, self.score) / large - _square(near, self.score) / small - (large / small).log()
        ) * 0.5

    def remaining(self, variances: tuple[float, float], slopes: tuple[Any, Any]) -> Any:
        """Half the width, squared, of an even spread of what both move by `slopes`, given what has shown of them.

        Windows in a row err alike, so that they count for fewer: see COUNTED.
        """
        # A ninth of the information under a prior is all of it under a ninth of the prior, but for a factor of nine.
        p, q = variances
        (one, other, both), det = self._shrunk((p * COUNTED, q * COUNTED))
        (s, t), (u, v) = self.score, slopes
        share = 1.0 / det
        mean = ((s * one + t * both) * u + (s * both + t * other) * v) * share
        return mean * mean * 3.0 + _square((one, other, both), slopes) * (3.0 / COUNTED) * share


def _square(matrix: tuple[Any, Any, Any], vector: tuple[Any, Any]) -> Any:
    """The quadratic form of a symmetric matrix (two diagonal entries, the other one) and a vector."""
    (one, other, both), (s, t) = matrix, vector
    return s * s * one + t * t * other + s * t * (both * 2.0)


def unmasked(shown: Shown, common: Mapping[str, Any], hold: Any, information: Any) -> Shown:
    """What inertia and inductance show when the voltage between samples is held or linear, and nothing in between.

    The filter makes good whatever looks like another `hold`, and another motor at one frequency does: what it took for
    that is given back, and what is not known of it is taken off the information (Schur's complement).

    Args:
        shown: as it was with that hold.
        common: information that each shares with it.
        hold, information: what the filter found.
    """
    # Of the two the nearer one, as far as it is known which.
    known = information + HOLD_KNOWN
    mode = probability(hold * known / (known * STAMPED + 1.0)) - 0.5
    variance = STAMPED + 1 / HOLD_KNOWN - mode * mode
    share = 1.0 / (variance * common["hold"] + 1.0)
    h, k = common["inertia"], common["inductance"]
    (s, t), (a, d) = shown.score, shown.information
    off, open_ = (hold - mode) * share, variance * share
    return Shown(
        (s + h * off, t + k * off), (a - h * h * open_, d - k * k * open_), shown.common - h * k * open_
    )


def doubt(
    layout: Layout, known: Mapping[str, Any], common: Mapping[str, Any], hold: Any, memory: Mapping[str, Any],
    x: Sequence[Any], resistance: Any, resistive: Any = 1.0,
) -> tuple[Any, dict[str, Any], Any]:  # fmt: skip
    """Logarithm of the odds against the file's motor, by how much the variances of states (by name) grow, and of the
    resistance (as a temperature's, K^2), and what of the temperature's is R_a0's alone.

    Args:
        layout: the observer's.
        known: sensitivities of the states, information and score of each discrepancy.
        common: information that pairs of them share.
        hold: how the voltage is taken to run between samples, from -0.5, linear, to 0.5, held.
        memory: of the observer, by name.
        x: states.
        resistance: of the winding, ohm.
        resistive: Bayes factor of another motor against the file's from R_a0.
    """
    w, theta = layout.at["w"], layout.at["theta"]
    rated = layout.rated
    (V, a, s), (W, d, t) = known["inertia"], known["inductance"]
    motor = unmasked(Shown((s, t), (a, d), common["motor"]), common, hold, known["hold"][1])
    slack, spread = (variances(layout, of) for of in (SLACK, SPREAD))
    other = motor.weight(slack, spread)
    moved, told, shown = known["drop"]
    volts, amps = rounding(layout, memory)
    offset = volts + resistance * resistance * amps + (layout.settings.model_sd * rated.voltage_V) ** 2
    lacking, largest = Shown((shown, 0.0), (told, 0.0), 0.0), ((DROP * rated.voltage_V) ** 2, 0.0)
    missing = lacking.weight((offset, 0.0), largest)
    prior = layout.settings.others / (1.0 - 2.0 * layout.settings.others)
    # Where J or ke is a state, a motor of its own is what the observer looks for.
    free = bool({"J", "ke"} & set(layout.parameters))
    alike = 0.0 if free else exponent(other) * prior
    another, drop = alike * resistive, exponent(missing) * prior
    either = another + drop
    others = layout.settings.others
    share = 0.0 if free else widened((either + 1.0) / another, others)
    # What R_a0 is, the resistance itself is none the better or worse known for.
    unaware = 0.0 if free else widened((alike + drop + 1.0) / alike, others)
    lost = widened((either + 1.0) / drop, others)
    # Another motor is off by as much as its tolerance, and by what its J and L have done to the states.
    grown, off_K = {}, (x[theta] + 1 / layout.motor.alpha) * TOLERANCE
    for state, size in ((w, x[w] * TOLERANCE), (theta, off_K)):
        either_way = moved[state] * moved[state] * offset
        either_way = either_way + V[state] * V[state] * slack[0] + W[state] * W[state] * slack[1]
        off = size * size + motor.remaining(spread, (V[state], W[state]))
        grown[layout.states[state]] = either_way + share * share * off
    grown["resistance"] = either_way + unaware * unaware * off
    # A drop as large as may remain has moved the states; the speed by all of it, whichever way and whether or not it acts
    # at a current near zero.
    gone = lost * lacking.remaining(largest, (1.0, 0.0)).sqrt()
    for name, moves in (
        ("w", moved[w].abs().max(1 / layout.motor.ke)), ("theta", moved[theta]), ("resistance", moved[theta])
    ):  # fmt: skip
        grown[name] = grown[name] + gone * moves * (gone * moves)
    hot = (x[theta] - WARMEST).max(-COLDEST - x[theta])
    return (0.0 <= hot).select(MOST, either.log()), grown, (share * off_K) * (share * off_K)


def exponent(logarithm: Any) -> Any:
    """exp, of a logarithm kept within `MOST`."""
    return logarithm.max(-MOST).min(MOST).exp()


def widened(reciprocal: Any, prior: float) -> Any:
    """Deviation, in terms of half the width of an even spread, by which intervals must be wider that hold with a probability
    what is so spread; of the probability the `reciprocal`.

    Beyond a share x of the half width lies (1 - x) of it: an interval that leaves out q reaches to 1 - q / probability. A
    hypothesis of a `prior` that has become twenty times less likely is refuted.
    """
    widest: Any = 0.0
    for left_out, deviations in ((ONE_IN_TWENTY[0] * prior, ONE_IN_TWENTY[1]), HARDLY_ANY):
        widest = ((1.0 - reciprocal * left_out) * (1.0 / deviations)).max(widest)
    return widest
