"""The analogue-digital converter of a drive: what a channel's value becomes on its way into a frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.line.framing import Channel

Array = NDArray[np.float64]
Codes = NDArray[np.int16]


@dataclass(frozen=True)
class Adc:
    """A bipolar converter: `bits` codes spread over plus and minus `full_scale` of the channel's unit.

    One code is worth full_scale / 2^(bits-1); values beyond the rails stay at the rail (IEEE Std 1241-2010, 4.1).
    """

    bits: int
    full_scale: float

    @property
    def step(self) -> float:
        """One least significant bit, in the channel's unit."""
        return self.full_scale * 2.0 ** (1 - self.bits)

    @property
    def rails(self) -> tuple[int, int]:
        """The lowest and the highest code."""
        return -(2 ** (self.bits - 1)), 2 ** (self.bits - 1) - 1

    def convert(self, values: Array) -> Codes:
        """Codes (N,) of values (N,), rounded to the nearest."""
        return np.clip(np.rint(values / self.step), *self.rails).astype(np.int16)

    def value(self, codes: Codes) -> Array:
        """What a receiver makes of codes (N,)."""
        return self.step * codes.astype(np.float64)

    def saturated(self, codes: Codes) -> NDArray[np.bool_]:
        """Whether each code is at a rail."""
        low, high = self.rails
        return np.asarray((codes == low) | (codes == high))

    def channel(self, name: str, unit: str) -> Channel:
        """How HELLO describes a channel that this converter digitises."""
        low, high = self.rails
        return Channel(name, unit, "i2", scale=self.step, minimum=low, maximum=high)
