"""Who goes on, from what a read of the line gave, further than to samples."""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.records import record


@record(frozen=True)
class Estimated:
    """What was made of the samples of a read.

    Attributes:
        count, first_ns, newest_ns: how many they were, when the first and the last of them were taken.
        estimates: at m of them.
        inputs: voltage in V and current in A there, (m, 2).
        samples, rows: what gives them, and which were evaluated (None: all); to be called before the next read.
    """

    count: int
    first_ns: int
    newest_ns: int
    estimates: Estimates
    inputs: NDArray[np.float64]
    samples: Callable[[], Samples]
    rows: Callable[[], NDArray[np.intp] | None]

    def __len__(self) -> int:
        return self.count


class Follower(Protocol):
    """On the bytes that `CoreLink` is given."""

    def take(self, data: bytes, now_ns: int) -> int:
        """Call `motorlens_stream_take`; gives how many bytes were taken."""
        ...

    def estimated(self) -> Estimated:
        """What was made of the samples of that call."""
        ...
