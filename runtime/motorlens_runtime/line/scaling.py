"""From the codes of a SAMPLES frame to volts and amperes, as HELLO says."""

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.files.columns import Column
from motorlens_runtime.line.framing import SAMPLE_TYPES, Hello

SATURATED = np.uint32(Quality.SATURATED)
# Up to so many instants, plain numbers are faster than arrays.
FEW = 16
_LETTERS = {"i": "h", "f": "f"}  # of `struct`


class Scaling:
    """What HELLO says of the numbers in SAMPLES, as arrays with a row for each quantity that is used.

    Attributes:
        schema, channels, floats: of the frames: which HELLO they follow, how many channels, float32 rather than int16.
        rails_known: whether the codes at the rails are.
        flags: quality of every sample.
        numbers: of each quantity its channel, scale, offset, factor, shift, least and most code.
    """

    def __init__(self, hello: Hello, columns: dict[str, Column]) -> None:
        used = [hello.channels[column.index] for column in columns.values()]
        self.schema, self.layout = hello.schema, SAMPLE_TYPES[hello.channels[0].type]
        self.floats = self.layout.kind == "f"
        self._letter = _LETTERS[self.layout.kind]
        self.width = len(hello.channels) * self.layout.itemsize
        self.rails_known = any(c.minimum is not None or c.maximum is not None for c in used)
        self._quantities = list(columns)
        self._index = np.array([column.index for column in columns.values()])
        self._scale, self._offset, self._factor, self._shift, self._least, self._most = (
            np.array(values, dtype=np.float64)[:, None]
            for values in (
                [c.scale for c in used],
                [c.offset for c in used],
                [column.factor for column in columns.values()],
                [column.offset for column in columns.values()],
                [-np.inf if c.minimum is None else c.minimum for c in used],
                [np.inf if c.maximum is None else c.maximum for c in used],
            )
        )
        self.flags = np.uint32(Quality.SIMULATED if hello.simulated else 0)
        self._usual = np.full(FEW, self.flags)
        self._usual.setflags(write=False)  # samples share it
        self.channels = len(hello.channels)
        arrays = (self._scale, self._offset, self._factor, self._shift, self._least, self._most)
        numbers = zip(*(array[:, 0].tolist() for array in arrays), strict=True)
        self.numbers = {
            quantity: (column.index, *row)
            for (quantity, column), row in zip(columns.items(), numbers, strict=True)
        }

    def few(self, payload: bytes, times: NDArray[np.int64]) -> Samples | None:
        """What `samples` gives, of a payload of up to `FEW` instants with no code at a rail; else None."""
        n = len(times)
        if n > FEW:
            return None
        flat = struct.unpack_from(f"<{n * self.channels}{self._letter}", payload, 2)
        values = {}
        for quantity, (index, scale, offset, factor, shift, least, most) in self.numbers.items():
            row = []
            for code in flat[index :: self.channels]:
                if not least < code < most:  # nor is NaN
                    return None
                row.append((code * scale + offset) * factor + shift)
            values[quantity] = np.array(row)
        return Samples(times, values["voltage"], values["current"], values.get("ambient"), self._usual[:n])

    def samples(self, codes: NDArray[Any], times: NDArray[np.int64]) -> Samples:
        """Samples of codes (n, channels)."""
        code = codes.T[self._index].astype(np.float64)
        flags = np.full(len(times), self.flags)
        if self.rails_known:
            at_rail = (code <= self._least) | (code >= self._most)
            if at_rail.any():
                flags[at_rail.any(axis=0)] |= SATURATED
        code *= self._scale
        code += self._offset
        code *= self._factor
        code += self._shift
        values = dict(zip(self._quantities, code, strict=True))
        return Samples(times, values["voltage"], values["current"], values.get("ambient"), flags)
