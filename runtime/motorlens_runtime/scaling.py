"""From the codes of a SAMPLES frame to volts and amperes, as HELLO says."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.columns import Column
from motorlens_runtime.framing import SAMPLE_TYPES, Hello
from motorlens_runtime.gate import Samples
from motorlens_runtime.quality import Quality

SATURATED = np.uint32(Quality.SATURATED)


class Scaling:
    """What HELLO says of the numbers in SAMPLES, as arrays with a row for each quantity that is used."""

    def __init__(self, hello: Hello, columns: dict[str, Column]) -> None:
        used = [hello.channels[column.index] for column in columns.values()]
        self.schema, self.layout = hello.schema, SAMPLE_TYPES[hello.channels[0].type]
        self.width = len(hello.channels) * self.layout.itemsize
        self.rate = hello.rate_Hz[0], 10**9 * hello.rate_Hz[1]
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
        self._flags = np.uint32(Quality.SIMULATED if hello.simulated else 0)
        self._channels = len(hello.channels)
        arrays = (self._scale, self._offset, self._factor, self._shift, self._least, self._most)
        numbers = zip(*(array[:, 0].tolist() for array in arrays), strict=True)
        self._numbers = {
            quantity: (column.index, *row)
            for (quantity, column), row in zip(columns.items(), numbers, strict=True)
        }

    def few(self, codes: NDArray[Any], times: NDArray[np.int64]) -> Samples | None:
        """What `samples` gives, of whole-numbered codes (n * channels,) none of which is at a rail; else None."""
        if self.layout.kind != "i":
            return None
        flat = codes.tolist()
        values = {}
        for quantity, (index, scale, offset, factor, shift, least, most) in self._numbers.items():
            column = flat[index :: self._channels]
            if min(column) <= least or max(column) >= most:
                return None
            values[quantity] = np.array([(code * scale + offset) * factor + shift for code in column])
        flags = np.full(len(times), self._flags)
        return Samples(times, values["voltage"], values["current"], values.get("ambient"), flags)

    def samples(self, codes: NDArray[Any], times: NDArray[np.int64]) -> Samples:
        """Samples of codes (n, channels)."""
        code = codes.T[self._index].astype(np.float64)
        flags = np.full(len(times), self._flags)
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
