"""How far a stream lies behind its own best: whether this PC is too slow for it.

The clocks of a device and of this PC began at different times, so that only a difference tells: the least time from stamp to
arrival that was seen so far is the line's own; whoever comes much later than that has waited for us.
"""

# The stream may lie this far behind its own best before the PC counts as too slow.
_BEHIND_NS = 250_000_000
# A device's clock may drift this much against ours; the best is forgotten at this pace.
_DRIFT = 5e-4
# Before the first sample nothing is late.
_NEVER = -(1 << 62)


class Lag:
    """See the module; times are nanoseconds, of arrival by this PC's clock, of the newest sample by the device's stamps."""

    def __init__(self) -> None:
        self._best_ns: float | None = None
        self._at_ns = 0

    def late_ns(self, arrival_ns: int) -> int:
        """Samples that arrive now are late if the newest of them was taken at this time or before."""
        if self._best_ns is None:
            return _NEVER
        best_ns = self._best_ns + _DRIFT * (arrival_ns - self._at_ns)
        return int(arrival_ns - best_ns - _BEHIND_NS)

    def note(self, arrival_ns: int, newest_ns: int) -> None:
        """Samples have arrived, of which the newest was taken then."""
        lag_ns = arrival_ns - newest_ns
        forgotten = _DRIFT * (arrival_ns - self._at_ns)
        self._best_ns = lag_ns if self._best_ns is None else min(self._best_ns + forgotten, lag_ns)
        self._at_ns = arrival_ns

    def late(self, arrival_ns: int, newest_ns: int) -> bool:
        """Whether samples that have arrived are late; they are noted."""
        late_ns = self.late_ns(arrival_ns)
        self.note(arrival_ns, newest_ns)
        return newest_ns <= late_ns
