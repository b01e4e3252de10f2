"""Working on a part of a recording: `--range FROM:TO`, in seconds since its first sample."""

import math
import re
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from motorlens_physics.recording import Recording
from motorlens_runtime.errors import DataError

_RANGE = re.compile(r"(?:(?P<name>.+)=)?(?P<start>[^:=]*):(?P<stop>[^:=]*)")
FEWEST = 40
Spans = Mapping[str, tuple[float, float]]


def parse_ranges(ranges: Sequence[str], names: Collection[str]) -> Spans:
    """Recording, "" for all others, to its first and last second; a later option counts before an earlier one.

    Args:
        ranges: what stands after `--range`: FROM:TO or REC=FROM:TO; either side may be left out.
        names: the recordings as the user named them.

    Raises:
        DataError: an option is not of the form, or names no recording.

    >>> parse_ranges(["2:8.5", "b.csv=:3"], ["a.csv", "b.csv"])
    {'': (2.0, 8.5), 'b.csv': (0.0, 3.0)}
    """
    spans: dict[str, tuple[float, float]] = {}
    for text in ranges:
        found = _RANGE.fullmatch(text)
        if found is None:
            raise DataError(f"--range {text}: write [REC=]FROM:TO in seconds, for example 2:8.5")
        try:
            span = (_seconds(found["start"], 0.0), _seconds(found["stop"], math.inf))
        except ValueError:
            raise DataError(f"--range {text}: write [REC=]FROM:TO in seconds, for example 2:8.5") from None
        name = found["name"] or ""
        if name and name not in names:
            raise DataError(f"--range {text}: there is no recording {name}; there are {', '.join(names)}")
        spans[name] = span
    return spans


def within(recording: Recording, name: str, spans: Spans) -> Recording:
    """The part of a recording that is asked for. Raises DataError if that leaves too few samples."""
    span = spans.get(name, spans.get(""))
    return recording if span is None else _part(recording, name, *span)


def _seconds(text: str, fallback: float) -> float:
    value = float(text) if text.strip() else fallback
    if math.isnan(value):
        raise ValueError
    return value


def _part(recording: Recording, name: str, start: float, stop: float) -> Recording:
    time = recording.time_s - recording.time_s[0]
    near = 1e-3 * recording.period_s  # stamps are rounded
    first, last = np.searchsorted(time, (start - near, stop + near))
    if last - first < FEWEST:
        raise DataError(
            f"{name}: {max(last - first, 0)} samples from {start:g} to {stop:g} s; at least {FEWEST} are needed, "
            f"and it lasts {time[-1]:g} s"
        )
    return recording.part(slice(int(first), int(last)))
