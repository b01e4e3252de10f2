"""The quality word: one bit for each reason to trust an estimate less, and what other systems call it.

OPC UA status codes are those of OPC 10000-4 and -8; Sparkplug B knows GOOD 192, BAD 0 and STALE 500 only.
"""

from enum import IntEnum, IntFlag
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Quality(IntFlag):
    """Reasons; 0 is good."""

    WARM_UP = 1  # less history than the sensor's warm-up time
    BRIDGED = 2  # samples are missing shortly before or at this instant
    STALE = 4  # no sample has come since; the value is the last one
    SATURATED = 8  # a converter code is at its rail
    OUTSIDE_ENVELOPE = 16  # inputs, rate or features the sensor was not trained on
    NOT_FINITE = 32  # the sample was NaN or infinite and was left out, or the estimate is
    RESTORED = 64  # the state comes from a snapshot and has not been confirmed by a warm-up time yet
    OVERLOAD = 128  # the PC is behind the stream
    SIMULATED = 256  # the source says it is not a real drive
    BACKEND_MISMATCH = 512  # two implementations of the network disagree
    STUCK = 1024  # a channel repeats itself while the other one moves
    JUMP = 2048  # the current changed faster than the inductance allows
    ASSUMED_COLD = 4096  # the motor is taken to have started at ambient temperature, and nothing has shown it
    LINE_LOST = 8192  # nothing has come for seconds, or samples have only just begun to come again
    UNFORETOLD = 16384  # the voltage shows that the motor is likelier another than the observer's


class OpcUa(IntEnum):
    """The status codes that are used here."""

    GOOD = 0x00000000
    UNCERTAIN_LAST_USABLE = 0x40900000
    UNCERTAIN_SUBSTITUTE = 0x40910000
    UNCERTAIN_INITIAL = 0x40920000
    UNCERTAIN_NOT_ACCURATE = 0x40930000
    UNCERTAIN_UNITS_EXCEEDED = 0x40940000
    UNCERTAIN_SIMULATED = 0x42090000
    BAD_NO_COMMUNICATION = 0x80310000
    BAD_SENSOR_FAILURE = 0x808C0000


_BAD = Quality.BACKEND_MISMATCH | Quality.NOT_FINITE | Quality.STUCK
# In order of severity: the first that applies is reported.
_CODES = (
    (_BAD, OpcUa.BAD_SENSOR_FAILURE),
    (Quality.LINE_LOST, OpcUa.BAD_NO_COMMUNICATION),
    (Quality.STALE, OpcUa.UNCERTAIN_LAST_USABLE),
    (Quality.OUTSIDE_ENVELOPE, OpcUa.UNCERTAIN_UNITS_EXCEEDED),
    (Quality.SATURATED | Quality.JUMP | Quality.UNFORETOLD, OpcUa.UNCERTAIN_NOT_ACCURATE),
    (Quality.BRIDGED | Quality.OVERLOAD, OpcUa.UNCERTAIN_SUBSTITUTE),
    (Quality.WARM_UP | Quality.RESTORED | Quality.ASSUMED_COLD, OpcUa.UNCERTAIN_INITIAL),
    (Quality.SIMULATED, OpcUa.UNCERTAIN_SIMULATED),
)


def mark(words: NDArray[np.uint32], rows: Any, reason: Quality) -> None:
    """Set a reason in the quality words of `rows` (any numpy index)."""
    words[rows] |= np.uint32(reason)


def names(word: int) -> list[str]:
    """The reasons in a quality word, lower case; empty when it is good.

    >>> names(3)
    ['warm_up', 'bridged']
    """
    return [bit.name.lower() for bit in Quality if word & bit and bit.name]


def opc_ua(word: int) -> OpcUa:
    """The status code of a quality word: its severest reason.

    >>> opc_ua(Quality.WARM_UP | Quality.STALE).name
    'UNCERTAIN_LAST_USABLE'
    """
    return next((code for bits, code in _CODES if word & bits), OpcUa.GOOD)


def sparkplug(word: int) -> int:
    """192 good, 500 stale, 0 bad. What is merely uncertain is good here, as Sparkplug has no word for it."""
    if word & _BAD:
        return 0
    return 500 if word & (Quality.STALE | Quality.LINE_LOST) else 192
