"""Opening the key: rates of a set of diagnoses against what was hidden, with Wilson intervals.

An answer is the JSON of `motorlens diagnose`. Definitions that a reader may want to dispute:

- A case counts at or above 3 times the detectable size if its effect is testable (see `size_up`) and its factor is 3 or
  more; a pair's at 5 or more. Cases at once the detectable size are reported in a row of their own.
- Detected: any verdict but `adequate` and `not_testable`. A diagnosis that failed is neither detected nor right.
- The name given first: the first chosen, else the first of the first group, else the first candidate.
- Separable: the generator's own Fisher information leaves no rival closer than 2 dlogL = 25.
- Wrong with confidence: verdict `named` or `sensor_fault` (or a group of one beside others), and the name is neither
  hidden nor inseparable from what is.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from helpers.hidden.effects import CHANNELS
from helpers.hidden.motors import MOTORS
from numpy.typing import NDArray
from scipy.stats import norm

Truth = dict[str, Any]
Answer = dict[str, Any] | None
Row = tuple[Truth, Answer, float]


@dataclass(frozen=True)
class Rate:
    """So many of so many, with the Wilson interval of the rate."""

    hits: int
    of: int

    def interval(self, confidence: float = 0.95) -> tuple[float, float]:
        """Wilson (1927), doi:10.1080/01621459.1927.10502953.

        >>> [round(x, 3) for x in Rate(9, 10).interval()]
        [0.596, 0.982]
        """
        if self.of == 0:
            return 0.0, 1.0
        z = float(norm.ppf((1 + confidence) / 2))
        p, n = self.hits / self.of, self.of
        centre = (p + z * z / (2 * n)) / (1 + z * z / n)
        half = z / (1 + z * z / n) * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
        # A rate of 0 is in its interval, to the last digit.
        return max(float(centre - half), 0.0), min(float(centre + half), 1.0)

    def __str__(self) -> str:
        if self.of == 0:
            return "-"
        low, high = self.interval()
        return f"{100 * self.hits / self.of:5.1f} % ({100 * low:.1f}-{100 * high:.1f}), {self.hits}/{self.of}"


def rate(rows: Iterable[Row], of: Callable[[Row], bool], hit: Callable[[Row], bool]) -> Rate:
    """The rate of `hit` among the rows that `of` selects."""
    found = [hit(row) for row in rows if of(row)]
    return Rate(sum(found), len(found))


def named_first(answer: Answer) -> str | None:
    """The name that an answer puts first, if it detected anything."""
    if not detected(answer):
        return None
    assert answer is not None
    groups = [group for group in answer.get("groups") or [] if group]
    candidates = [candidate["name"] for candidate in answer.get("candidates") or []]
    return next(iter([*(answer.get("chosen") or []), *(groups[0] if groups else []), *candidates]), None)


def detected(answer: Answer) -> bool:
    """Whether an answer says that something is missing or at fault."""
    return answer is not None and answer.get("verdict") not in ("adequate", "not_testable")


def names_given(answer: Answer, most: int = 6) -> set[str]:
    """All names an answer offers: the chosen ones and their groups; a group of more than `most` offers none."""
    if not detected(answer):
        return set()
    assert answer is not None
    given = set(answer.get("chosen") or [])
    for group in answer.get("groups") or []:
        given |= set(group) if len(group) <= most else set()
    return given


def is_sensor(name: str | None) -> bool:
    """Whether a name is that of a sensor's fault."""
    return name is not None and any(name.startswith(f"{channel}_sensor_") for channel in CHANNELS)


def strong(row: Row) -> bool:
    """Testable, and at least 3 times (a pair: 5 times) the detectable size."""
    least = 5 if row[0]["kind"] == "pair" else 3
    return bool(row[0]["hidden"]) and all(e["testable"] and e["factor"] >= least for e in row[0]["hidden"])


def separable(row: Row) -> bool:
    """Whether the channels tell each hidden effect from every rival."""
    return all(not effect["group"] for effect in row[0]["hidden"])


def wrong_name(row: Row) -> bool:
    """A wrong name given with confidence."""
    truth, answer, _ = row
    if answer is None or answer.get("verdict") not in ("named", "sensor_fault", "group"):
        return False
    given = set(answer.get("chosen") or [])
    if answer["verdict"] == "group":
        given = {group[0] for group in answer.get("groups") or [] if len(group) == 1}
    allowed = {effect["name"] for effect in truth["hidden"]}
    for effect in truth["hidden"]:
        # Outside the catalogue no name is right, however alike.
        allowed |= set() if effect["outside"] else set(effect["group"])
    return bool(given - allowed)


def right_kind(row: Row) -> bool:
    """A sensor's fault called one, physics called physics, with no group that leaves it open."""
    truth, answer, _ = row
    offered = names_given(answer) | ({named_first(answer)} - {None})
    wanted = truth["hidden"][0]["sensor"]
    return bool(offered) and all(is_sensor(name) == wanted for name in offered)


def kind_separable(row: Row) -> bool:
    """Whether no rival of the other kind (sensor, physics) is inseparable."""
    effect = row[0]["hidden"][0]
    return not any(is_sensor(rival) != effect["sensor"] for rival in effect["group"])


def right_equation(row: Row) -> bool:
    """Whether an effect outside the catalogue is located in its equation (coupling enters two)."""
    truth, answer, _ = row
    if answer is None:
        return False
    equation = truth["hidden"][0]["equation"]
    allowed = {"coupling", "electrical", "mechanical"} if equation == "coupling" else {equation}
    return answer.get("equation") in allowed


def sizes(rows: Sequence[Row]) -> tuple[list[float], list[bool]]:
    """Relative errors of the sizes of rightly named single effects, and whether their 90 % intervals hold the truth."""
    errors, inside = [], []
    for truth, answer, _ in rows:
        if truth["kind"] != "single" or answer is None:
            continue
        effect = truth["hidden"][0]
        for candidate in answer.get("candidates") or []:
            told = (candidate.get("parameters") or {}).get(effect["parameter"])
            if (
                candidate["name"] == effect["name"]
                and effect["name"] in (answer.get("chosen") or [])
                and told
            ):
                unit = catalogue_unit(truth, effect["name"])
                off = abs(told["value"] - effect["size"] * unit)
                errors.append(off / abs((effect["size"] - effect["null"]) * unit))
                inside.append(off <= 1.6449 * (told.get("sd") or 0.0))
    return errors, inside


def catalogue_unit(truth: Truth, name: str) -> float:
    """What a hidden size is multiplied by to be the catalogue's parameter.

    The generator has a flux that falls with r i^2, r in 1/A^2; the catalogue s i_n (i / i_n)^n, with i_n the rated current.
    """
    return MOTORS[truth["case"]["motor"]].current_A if name == "armature_reaction" else 1.0


def calibration(rows: Sequence[Row]) -> str:
    """Calibration error of the probability stated for the name given first, and what is expected of as many that hold."""
    stated, right = [], []
    for truth, answer, _ in rows:
        first = named_first(answer)
        if answer is None or first is None or answer.get("verdict") == "unknown":
            continue
        for candidate in answer.get("candidates") or []:
            if candidate["name"] == first and candidate.get("probability") is not None:
                stated.append(float(candidate["probability"]))
                right.append(first in {effect["name"] for effect in truth["hidden"]})
    if not stated:
        return "nan, n = 0"
    error, by_chance = calibration_error(np.array(stated), np.array(right, float))
    return f"{error:.3f}, n = {len(stated)} ({by_chance:.3f} if right as often as stated)"


def calibration_error(
    p: NDArray[np.float64], right: NDArray[np.float64], bins: int = 10
) -> tuple[float, float]:
    """Mean distance between what is stated and what is right, bin by bin, and its expectation if `p` (N,) holds.

    In few cases the distance is large by chance alone: how many of a bin are right is a sum of Bernoulli variables.

    >>> calibration_error(np.array([0.5, 0.5]), np.array([1.0, 0.0]))  # by chance both or none are right every other time
    (0.0, 0.25)
    """
    which = np.minimum((p * bins).astype(int), bins - 1)
    error = by_chance = 0.0
    for k in set(which):
        of = p[which == k]
        chances = np.ones(1)
        for one in of:
            chances = np.convolve(chances, [1 - one, one])
        error += abs(right[which == k].sum() - of.sum())
        by_chance += float(chances @ np.abs(np.arange(len(chances)) - of.sum()))
    return float(error / len(p)), by_chance / len(p)


def error_after(rows: Sequence[Row]) -> list[float]:
    """Held-out RMSE after adding over the noise floor that the answer states, in the channel that gained the most."""
    ratios = []
    for truth, answer, _ in rows:
        error = (answer or {}).get("error") or {}
        before, after = error.get("before") or {}, error.get("after") or {}
        floor = error.get("noise_floor") or {}
        gain = {c: before[c] / after[c] for c in after if after[c] and before.get(c) and floor.get(c)}
        if gain and truth["kind"] in ("single", "pair") and strong((truth, answer, 0.0)):
            channel = max(gain, key=lambda c: gain[c])
            ratios.append(after[channel] / floor[channel])
    return ratios


def mentions_decoy(row: Row) -> bool:
    """Whether an answer names a decoy column anywhere among its names."""
    answer = row[1] or {}
    offered = [
        *(answer.get("chosen") or []),
        *(name for group in answer.get("groups") or [] for name in group),
    ]
    offered += [candidate["name"] for candidate in answer.get("candidates") or []]
    return any("decoy" in name for name in offered)


def summary(rows: Sequence[Row]) -> list[tuple[str, str, str]]:
    """The table of rates: what, goal, measured; wrong names first."""
    single = [row for row in rows if row[0]["kind"] == "single"]
    pairs = [row for row in rows if row[0]["kind"] == "pair"]
    outside = [row for row in rows if row[0]["kind"] == "outside"]
    none = [row for row in rows if row[0]["kind"] == "none"]
    every = lambda row: True  # noqa: E731
    errors, inside = sizes([row for row in single if strong(row)])
    after = error_after(rows)
    seconds = np.array([row[2] for row in rows]) if rows else np.zeros(1)
    right = lambda r: strong(r) and separable(r)  # noqa: E731
    kind = lambda r: strong(r) and kind_separable(r)  # noqa: E731
    once = lambda r: r[0]["hidden"][0]["factor"] == 1  # noqa: E731
    truth_in = lambda row: row[0]["hidden"][0]["name"] in names_given(row[1])  # noqa: E731
    first = lambda row: named_first(row[1]) == row[0]["hidden"][0]["name"]  # noqa: E731
    both = lambda row: {e["name"] for e in row[0]["hidden"]} <= names_given(row[1])  # noqa: E731
    unknown = lambda row: (row[1] or {}).get("verdict") == "unknown"  # noqa: E731
    return [
        ("wrong name with confidence, all cases", "<= 2 %", str(rate(rows, every, wrong_name))),
        ("wrong name with confidence, 3 x and above", "<= 2 %", str(rate(rows, strong, wrong_name))),
        ("nothing missing: false alarm", "<= 1 %", str(rate(none, every, lambda row: detected(row[1])))),
        ("detection, 3 x and above", ">= 97 %", str(rate(rows, strong, lambda row: detected(row[1])))),
        ("right name first, separable", ">= 95 %", str(rate(single, right, first))),
        ("truth in the reported group (<= 6)", ">= 98 %", str(rate(single, strong, truth_in))),
        ("sensor told from physics, separable", ">= 95 %", str(rate(single, kind, right_kind))),
        ("two effects (5 x): both found", ">= 85 %", str(rate(pairs, strong, both))),
        ("two effects (5 x), separable: both found", ">= 85 %", str(rate(pairs, right, both))),
        ("outside the catalogue: unknown", ">= 90 %", str(rate(outside, strong, unknown))),
        ("outside the catalogue: right equation", ">= 90 %", str(rate(outside, strong, right_equation))),
        ("decoys accepted", "0", str(rate(rows, every, mentions_decoy))),
        ("stated probability: calibration error", "<= 0.05", calibration(rows)),
        ("size: median error", "<= 3 %", f"{100 * np.median(errors):.1f} %, n = {len(errors)}" if errors else "-"),
        ("size: inside the 90 % interval", "85-95 %", str(Rate(sum(inside), len(inside)))),
        ("held-out RMSE / floor: median", "<= 1.05", f"{np.median(after):.3f}, n = {len(after)}" if after else "-"),
        ("held-out RMSE / floor: 90th percentile", "<= 1.15", f"{np.percentile(after, 90):.3f}" if after else "-"),
        ("detection at 1 x", "", str(rate(single, once, lambda r: detected(r[1])))),
        ("diagnoses that failed", "0", str(rate(rows, every, lambda row: row[1] is None))),
        ("seconds: median, 90th percentile", "<= 30", f"{np.median(seconds):.0f}, {np.percentile(seconds, 90):.0f}"),
    ]  # fmt: skip


def strata(rows: Sequence[Row]) -> list[tuple[str, str, str, str, str, str]]:
    """A line a stratum: cases, wrong names, false alarms, detection and right name of those that count."""
    lines = []
    keys: dict[str, Callable[[Row], str]] = {
        factor: lambda row, factor=factor: str(row[0]["case"][factor])  # type: ignore[misc]
        for factor in ("motor", "noise_kind", "noise", "records", "excitation", "channels", "pwm_ripple")
    }
    keys["factor"] = lambda row: (
        f"{row[0]['hidden'][0]['factor']:g}" if row[0]["kind"] == "single" else row[0]["kind"]
    )
    keys["hidden"] = lambda row: (
        row[0]["hidden"][0]["name"] if row[0]["kind"] in ("single", "outside") else row[0]["kind"]
    )
    for factor, key in keys.items():
        right = lambda r: strong(r) and separable(r)  # noqa: E731
        first = lambda r: named_first(r[1]) == r[0]["hidden"][0]["name"]  # noqa: E731
        for value in sorted({key(row) for row in rows}):
            own = [row for row in rows if key(row) == value]
            single = [row for row in own if row[0]["kind"] == "single"]
            none = [row for row in own if row[0]["kind"] == "none"]
            lines.append((
                f"{factor} = {value}", str(rate(own, lambda r: True, wrong_name)),
                str(rate(none, lambda r: True, lambda r: detected(r[1]))), str(rate(own, strong, lambda r: detected(r[1]))),
                str(rate(single, right, first)),
                str(rate(single, strong, lambda r: r[0]["hidden"][0]["name"] in names_given(r[1]))),
            ))  # fmt: skip
    return lines


def failing(row: Row) -> list[str]:
    """What is wrong with an answer, in words; empty if nothing."""
    truth, answer, _ = row
    if answer is None:
        return ["no answer"]
    said = []
    if wrong_name(row):
        said.append("wrong name with confidence")
    if truth["kind"] == "none" and detected(answer):
        said.append("false alarm")
    if strong(row):
        if not detected(answer):
            said.append("missed")
        elif truth["kind"] == "outside":
            if answer.get("verdict") != "unknown":
                said.append("not called unknown")
            if not right_equation(row):
                said.append("wrong equation")
        else:
            absent = {effect["name"] for effect in truth["hidden"]} - names_given(answer)
            if absent:
                said.append("not offered: " + ", ".join(sorted(absent)))
            elif (
                truth["kind"] == "single"
                and separable(row)
                and named_first(answer) != truth["hidden"][0]["name"]
            ):
                said.append("not first")
    return said
