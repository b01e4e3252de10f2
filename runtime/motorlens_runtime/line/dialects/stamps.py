"""When a sample was taken, on the host's clock: from the device's own stamps, from a known rate, or from its arrival.

All three never run backwards. A device's clock is followed with a limited slew, so that neither its drift over months nor
a host that was busy for a moment shows as a jump.
"""

import numpy as np
from numpy.typing import NDArray

# A ceramic resonator is good to half a percent; following at twice that keeps up with any device.
_SLEW = 0.01
# A step back of more than this is a restart; a stamp further than this in the future is of another epoch.
_JUMP_NS = 1_000_000_000
# A step of more than this is rubbish or a restart; how much time went by, the host knows.
_STEP_NS = 3600 * 1_000_000_000
# Arrival jitters by this much, so a stamp may lie that far ahead of the host, and not more.
_LEAD_NS = 50_000_000

Times = NDArray[np.int64]


class DeviceStamps:
    """Stamps of a device clock that may wrap around, drift and restart.

    Args:
        modulus_ns: after how many nanoseconds the device's counter wraps; None if it does not.
        patience_ns: how far the device may fall behind the host (whose reader was busy) before the host is believed.
    """

    def __init__(self, modulus_ns: int | None = None, patience_ns: int = 10_000_000_000) -> None:
        self._modulus_ns = modulus_ns
        self._patience_ns = patience_ns
        self._raw_ns = 0
        self._device_ns = 0
        self._offset_ns: int | None = None
        self._last_ns = int(np.iinfo(np.int64).min)

    def host_times(self, device_ns: Times, now_ns: int) -> Times:
        """Host times (n,) of the device stamps (n,), the last of which has just arrived; within +-2^62 ns each."""
        if not len(device_ns):
            return device_ns
        if self._offset_ns is None:
            self._raw_ns = int(device_ns[0])
        steps = np.diff(device_ns, prepend=self._raw_ns)
        if self._modulus_ns is not None:
            # The shorter way round: a step back by more than half the range is a wrap.
            half = self._modulus_ns // 2
            steps = (steps + half) % self._modulus_ns - half
        restarted = bool((steps < -_JUMP_NS).any())
        steps[np.abs(steps) > _STEP_NS] = 0
        since_ns = np.cumsum(steps)
        unwrapped = self._device_ns + since_ns
        elapsed_ns = max(int(since_ns[-1]), 0)
        self._raw_ns, self._device_ns = int(device_ns[-1]), int(unwrapped[-1])
        ahead_ns = now_ns - self._device_ns  # the offset that this arrival alone would say
        error_ns = 0 if self._offset_ns is None else ahead_ns - self._offset_ns
        if self._offset_ns is None or restarted or not -_JUMP_NS < error_ns < self._patience_ns:
            self._offset_ns = ahead_ns
            times = unwrapped + ahead_ns
        else:
            # Spread over the block, so that no single period is longer or shorter than the slew allows.
            slew = min(max(error_ns / max(elapsed_ns, 1), -_SLEW), _SLEW)
            times = (
                unwrapped
                + self._offset_ns
                + np.round(slew * np.clip(since_ns, 0, elapsed_ns)).astype(np.int64)
            )
            self._offset_ns += round(slew * elapsed_ns)
        times = np.minimum(times, now_ns + _LEAD_NS)
        times = np.maximum.accumulate(np.maximum(times, self._last_ns))
        self._last_ns = int(times[-1])
        return times


class RateStamps:
    """Stamps of samples that come at a known rate without a clock of their own."""

    def __init__(self, rate_Hz: float) -> None:
        self._period_ns = 1e9 / rate_Hz
        self._count = 0
        # Without numbers, lost samples show only as time that is missing: half a second of it is a gap.
        self._stamps = DeviceStamps(patience_ns=500_000_000)

    def host_times(self, count: int, now_ns: int) -> Times:
        """Host times (count,) of the next samples, the last of which has just arrived."""
        index = np.arange(self._count, self._count + count)
        self._count += count
        return self._stamps.host_times(np.round(index * self._period_ns).astype(np.int64), now_ns)


class ArrivalStamps:
    """Stamps of samples of which only the arrival is known: those that come together are spread over the time since
    the ones before, at the spacing that is usual on this line."""

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._spacing_ns = 0.0

    def host_times(self, count: int, now_ns: int) -> Times:
        """Host times (count,) of the next samples, the last of which has just arrived."""
        if not count:
            return np.zeros(0, dtype=np.int64)
        if self._last_ns is None:
            self._last_ns = now_ns
            return np.full(count, now_ns, dtype=np.int64)
        now_ns = max(now_ns, self._last_ns)
        spacing = (now_ns - self._last_ns) / count
        # After a silence, a burst is not spread over the silence.
        if self._spacing_ns:
            spacing = min(spacing, 4 * self._spacing_ns)
        self._spacing_ns += (spacing - self._spacing_ns) * (0.1 if self._spacing_ns else 1.0)
        times = now_ns - np.round(spacing * np.arange(count - 1, -1, -1)).astype(np.int64)
        self._last_ns = now_ns
        return times
