"""An observer as a sensor file holds it: three straight-line programs and the layout of its state; and how to run it.

`accumulate` runs at every sample, `correct` when the window is full, `read` when a value is asked for. A state of zeros is a
fresh observer.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from motorlens_train.observer.program import Program

Array = NDArray[np.float64]

# What `accumulate` keeps, in this order; behind it stand `MEMORY` and, for each of the `BRANCHES`, the states and the upper
# half of their covariance.
WINDOW = (
    "alive", "voltage", "current", "drag", "current_start", "time", "sum_voltage", "sum_current", "sum_square", "sum_bends",
    "sum_steps", "sum_changes", "sum_lean", "hold",
)  # fmt: skip
WIDTH, TIME = len(WINDOW), WINDOW.index("time")
# Kept from window to window. `odds`: logarithm of the odds that the load is changing or the rotor at rest, less those at the
# start; `restless`: the innovations' excess over what was expected, an average over a hundred windows; the noise's
# `log_level` and `colour`, the last innovation's `error` and the `count` of windows behind them; the `slope` of innovations
# over the resistance; the voltage as it has `drive`n, and the current it has `driven`; the smallest changes seen, as
# reciprocals; `drift` of the innovations, and what of it is `unseen`; how `calm` the load is taken to be should the rotor
# turn out not to rest: by how much the probability that it changes is less than one half.
MEMORY = (
    "odds", "restless", "log_level", "colour", "error", "count", "slope", "drive", "driven", "fine_voltage", "fine_current",
    "last_voltage", "drift", "unseen", "calm",
)  # fmt: skip
# Of these, what noise the signals have.
NOISE = ("log_level", "colour", "error", "count")
BRANCHES = ("steady", "changing")


@dataclass(frozen=True)
class Observer:
    """The observer of a sensor.

    Attributes:
        period_s: a window is full after this time.
        size: length S of the state.
        accumulate: (voltage, current, ambient, dt, state) -> the first `len(WINDOW)` entries of the state.
        correct: (ambient, state) -> state.
        read: (ambient, state) -> outputs.
        outputs: names of what `read` gives.
        ambient_C: the ambient temperature where none is measured.
    """

    period_s: float
    size: int
    accumulate: Program
    correct: Program
    read: Program
    outputs: tuple[str, ...]
    ambient_C: float = 20.0

    def document(self) -> dict[str, Any]:
        """As it stands under `observer` in a sensor's specification."""
        programs = {name: getattr(self, name).document() for name in ("accumulate", "correct", "read")}
        sizes = {"size": self.size, "window": len(WINDOW), "time": TIME}
        return {
            "period_s": self.period_s,
            "ambient_C": self.ambient_C,
            **sizes,
            "noise": [WIDTH + MEMORY.index(name) for name in NOISE],
            "outputs": list(self.outputs),
            **({"distrust": self.outputs.index("distrust")} if "distrust" in self.outputs else {}),
        } | programs

    @staticmethod
    def from_document(document: Mapping[str, Any]) -> "Observer":
        """The inverse of `document`.

        Raises:
            KeyError, ValueError: it is not one.
        """
        programs = {name: Program.from_document(document[name]) for name in ("accumulate", "correct", "read")}
        if document["window"] != len(WINDOW) or document["time"] != TIME:
            raise ValueError("an observer with another window")
        return Observer(
            float(document["period_s"]), int(document["size"]), outputs=tuple(document["outputs"]),
            ambient_C=float(document["ambient_C"]), **programs,
        )  # fmt: skip

    @property
    def full_s(self) -> float:
        """A window is full when its time reaches this: a millionth below the period, for grids that miss it by rounding."""
        return self.period_s * (1 - 1e-6)

    def run(
        self, dt_s: Array, voltage_V: Array, current_A: Array, ambient_C: Array, state: Array | None = None
    ) -> tuple[Array, Array]:
        """Outputs (N, M) at every sample, and the state (S,) after the last; all inputs (N,)."""
        start = np.zeros(self.size) if state is None else np.array(state, dtype=np.float64)
        columns = np.column_stack([voltage_V, current_A, ambient_C, dt_s])
        out = np.empty((len(columns), len(self.outputs)))
        _run(*_programs(self), self.full_s, np.ascontiguousarray(columns), start, out)
        return out, start


@cache
def _programs(design: Observer) -> tuple[Any, ...]:
    return tuple(program.compiled() for program in (design.accumulate, design.correct, design.read))


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _run(
    accumulate: Any, correct: Any, read: Any, full_s: float, columns: Array, state: Array, out: Array
) -> None:  # pragma: no cover - compiled
    # One by one: the compiler takes a second and a half over parts of arrays, for a message of theirs.
    width, size = WIDTH, len(state)
    sample, window, new = np.empty(4 + width), np.empty(1 + size), np.empty(size)
    for k in range(len(columns)):
        for j in range(4):
            sample[j] = columns[k, j]
        for j in range(width):
            sample[4 + j] = state[j]
        accumulate(sample, state[:width])
        if state[TIME] >= full_s:
            _seen(columns[k, 2], state, window)
            correct(window, new)
            for j in range(size):
                state[j] = new[j]
        _seen(columns[k, 2], state, window)
        read(window, out[k])


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _seen(ambient_C: float, state: Array, window: Array) -> None:  # pragma: no cover - compiled
    """What a window's programs are given: the ambient temperature and the state."""
    window[0] = ambient_C
    for j in range(len(state)):
        window[1 + j] = state[j]
