"""The decoder of our frames in the C core: the same samples and counters as `link.Link`, a call for each read of the line.

HELLO and all other frames that are not SAMPLES are Python's to understand; until the first HELLO everything is. With a
`follower`, the call goes on to the estimates; see `service.core_stream`.
"""

import ctypes
from typing import Any

import numpy as np

from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.line.follower import Estimated, Follower
from motorlens_runtime.line.framing import Frame, run_of
from motorlens_runtime.line.link import Counters, Link, joined
from motorlens_runtime.sensor.core_library import LinkMemory, StreamTable, core

# More samples than one read of a line can hold: of 65536 bytes, a frame of 20 gives two at most.
ROOM = 1 << 14
_COUNTERS = tuple(Counters.__dataclass_fields__)
# Products of times and rates stay below 2^63 in the core; odd rates such as 10 000 000 / 10 007 are left to Python.
_LARGEST_PRODUCT = 1 << 62


def open_link() -> Link:
    """A decoder of frames: in the C core where there is one, else in Python."""
    library = core().library
    return Link() if library is None else CoreLink(library)


class CoreLink(Link):
    """See `Link`.

    Attributes:
        stream: the core's own, of which decoding uses `link`, `samples` and `other`.
        follower: who goes on to estimates, None: nobody.
        says_ambient: whether the ambient temperature is among the channels.
    """

    in_core = True

    def __init__(self, library: ctypes.CDLL) -> None:
        super().__init__()
        self._library = library
        self._memory, self.stream = LinkMemory(), StreamTable()
        # Once: a look at a structure within one makes an object.
        self._table, self._frame, self._block = self.stream.samples, self.stream.other, self.stream.block
        self._decoding = self._memory.decoder
        self._out_ns, self._out_flags = np.empty(ROOM, dtype=np.int64), np.empty(ROOM, dtype=np.uint32)
        self._out_values = np.empty((3, ROOM))
        table = self._table
        table.time_ns, table.flags, table.room = self._out_ns.ctypes.data, self._out_flags.ctypes.data, ROOM
        table.voltage_V, table.current_A, table.ambient_C = (row.ctypes.data for row in self._out_values)
        self.stream.link = ctypes.addressof(self._memory)
        self._addresses = [ctypes.addressof(part) for part in (self._memory, self._table, self._frame)]
        self.follower: Follower | None = None
        self._running = self.says_ambient = False

    @property
    def counters(self) -> Counters:
        """See `Link.counters`."""
        if not self._running:
            return super().counters
        clock = self._memory.clock
        return Counters(**{name: getattr(clock, name) for name in _COUNTERS})

    def feed(self, data: bytes, now_ns: int) -> Samples:
        """See `Dialect.feed`; stamps are the device's."""
        if not self._running:
            samples = super().feed(data, now_ns)
            self._enter()
            return samples
        self._table.count, self._frame.payload = 0, None
        return self._rest(data, 0, now_ns)

    def followed(self, data: bytes, now_ns: int) -> Samples | Estimated:
        """As `feed`; on to the estimates where there is a follower and the read holds nothing but samples."""
        if self.follower is None or not self._running or not data:
            return self.feed(data, now_ns)
        taken = self.follower.take(data, now_ns)
        if not self._block.n:
            return self._rest(data, taken, now_ns)
        self.bytes_seen += len(data)
        self.bad_frames = self._decoding.bad_frames
        return self.follower.estimated()

    def _rest(self, data: bytes, taken: int, now_ns: int) -> Samples:
        """The samples after so many bytes were taken, with those that this gave."""
        self.bytes_seen += len(data)
        parts: list[Samples] = []
        link, table, frame = self._addresses
        while True:
            if self._table.count:
                parts.append(self.samples())
            if self._frame.payload:
                self._understand(parts, now_ns)
                if not self._running:
                    if taken < len(data):
                        self.bytes_seen -= len(data) - taken
                        parts.append(super().feed(data[taken:], now_ns))
                    return joined(parts)
            if taken == len(data):
                self.bad_frames = self._decoding.bad_frames
                return joined(parts)
            self._table.count = 0
            rest = data[taken:] if taken else data
            taken += self._library.motorlens_link_feed(link, rest, len(rest), now_ns, table, frame)

    def samples(self) -> Samples:
        """Those of the last call of the core."""
        n = self._table.count
        voltage_V, current_A, ambient_C = self._out_values
        return Samples(
            self._out_ns[:n].copy(),
            voltage_V[:n].copy(),
            current_A[:n].copy(),
            ambient_C[:n].copy() if self.says_ambient else None,
            self._out_flags[:n].copy(),
        )

    def _understand(self, parts: list[Samples], now_ns: int) -> None:
        """A frame that is not SAMPLES, with what Python knows and then the core's again."""
        given = self._frame
        payload = ctypes.string_at(given.payload, given.length)
        frame = Frame(int(given.kind), int(given.sequence), int(given.t0_us), payload, int(given.flags))
        self._leave()
        self._take(run_of([frame], len(payload)), parts, now_ns)
        self._enter()

    def _leave(self) -> None:
        """From the core into Python."""
        clock, decoder = self._memory.clock, self._memory.decoder
        self._anchor_ns, self._count, self._offset_ns = clock.anchor_ns, clock.count, clock.offset_ns
        self._started, self._restarted = bool(clock.started), bool(clock.restarted)
        self._sequence = None if clock.sequence < 0 else clock.sequence
        self._last_arrival_ns = clock.last_arrival_ns
        self._count_of = {name: int(getattr(clock, name)) for name in _COUNTERS}
        self._decoder.hold(bytes(decoder.body[: decoder.length]), bool(decoder.overlong), decoder.bad_frames)
        self.bad_frames = self._decoder.bad_frames
        self._running = False

    def _enter(self) -> None:
        """From Python into the core, if it is known what the numbers mean and the rate suits."""
        scaling, (numerator, step_ns) = self._scaling, self._rate
        if scaling is None or numerator * step_ns >= _LARGEST_PRODUCT:
            return
        clock, decoder, into = self._memory.clock, self._memory.decoder, self._memory.scaling
        values: dict[str, Any] = {
            "anchor_ns": self._anchor_ns, "count": self._count, "numerator": numerator, "step_ns": step_ns,
            "offset_ns": self._offset_ns, "last_arrival_ns": self._last_arrival_ns, "started": self._started,
            "restarted": self._restarted, "sequence": -1 if self._sequence is None else self._sequence, **self._count_of,
        }  # fmt: skip
        for name, value in values.items():
            setattr(clock, name, value)
        rest, decoder.overlong, decoder.bad_frames = self._decoder.held()
        decoder.body[: len(rest)], decoder.length = rest, len(rest)
        into.channels, into.schema, into.floats = scaling.channels, scaling.schema, scaling.floats
        into.rails_known, into.flags = scaling.rails_known, scaling.flags
        for place, quantity in enumerate(("voltage", "current", "ambient")):
            channel, numbers = into.channel[place], scaling.numbers.get(quantity)
            channel.used = numbers is not None
            if numbers is not None:
                (
                    channel.index, channel.scale, channel.offset, channel.factor, channel.shift, channel.least, channel.most,
                ) = numbers  # fmt: skip
        self.says_ambient = bool(into.channel[2].used)
        self._running = True
