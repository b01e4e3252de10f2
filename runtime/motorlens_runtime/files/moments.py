"""Dates and times of day in the cells of a recording: seconds since the first of the column."""

import re
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta, timezone

_TIME = r"(?P<hour>\d{1,2}):(?P<minute>\d{2})(?::(?P<second>\d{2})(?:[.,](?P<part>\d+))?)?(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?"
_FORMS = [
    re.compile(form + r"\s*(?P<zone>Z|UTC|[+-]\d{2}:?\d{2})?", re.IGNORECASE)
    for form in (
        r"(?P<year>\d{4})[-/.](?P<month>\d{1,2})[-/.](?P<day>\d{1,2})[T ,;_-]+" + _TIME,
        r"(?P<day>\d{1,2})[-/.](?P<month>\d{1,2})[-/.](?P<year>\d{4}|\d{2})[T ,;_-]+" + _TIME,
        _TIME,
    )
]
_DAY_S = 86400.0


@dataclass
class Moments:
    """The clock of one column, row by row."""

    _first: datetime | None = None
    _last_s: float = 0.0
    _days: int = 0

    def seconds(self, cell: str) -> float | None:
        """Seconds since the first cell; None if it is no date and time.

        Times of day go on over midnight. Where a date may be read in two ways (03/04/2026), the day comes first; with AM or
        PM beside it, or where there is no such month, the month.
        """
        read = _read(cell.strip())
        if read is None:
            return None
        moment, dated = read
        if self._first is None:
            self._first = moment
        if (moment.tzinfo is None) != (self._first.tzinfo is None):
            return None
        elapsed = (moment - self._first).total_seconds()
        if not dated:
            elapsed += self._days * _DAY_S
            if elapsed < self._last_s - _DAY_S / 2:
                self._days += 1
                elapsed += _DAY_S
        self._last_s = elapsed
        return elapsed


def _read(cell: str) -> tuple[datetime, bool] | None:
    """The moment, and whether it has a date."""
    for form in _FORMS:
        match = form.fullmatch(cell)
        if match is None:
            continue
        parts = match.groupdict()
        day, month = int(parts.get("day") or 1), int(parts.get("month") or 1)
        if month > 12 or (parts["half"] and "/" in cell):
            day, month = month, day
        hour = int(parts["hour"])
        if parts["half"]:
            hour = hour % 12 + (12 if parts["half"] in "pP" else 0)
        year = int(parts.get("year") or 2000)
        try:
            moment = datetime.combine(
                date(year + 2000 if year < 100 else year, month, day), datetime.min.time()
            )
        except ValueError:
            return None
        seconds = int(parts["second"] or 0) + float(f"0.{parts['part'] or 0}")
        moment += timedelta(hours=hour, minutes=int(parts["minute"]), seconds=seconds)
        return moment.replace(tzinfo=_zone(parts["zone"])), "year" in parts
    return None


def _zone(text: str | None) -> timezone | None:
    if not text:
        return None
    if text.upper() in ("Z", "UTC"):
        return UTC
    size = timedelta(hours=int(text[1:3]), minutes=int(text[-2:]))
    return timezone(-size if text[0] == "-" else size)
