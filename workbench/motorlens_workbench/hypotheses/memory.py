"""What a balance lacks that depends on what went before: free terms with a memory.

A curve of speed or current says nothing of a shaft that twists, of bristles that bend, of brushes that bounce: there the
missing torque or voltage follows the past of the motion. Any such linear dependence is a sum of the answers of resonators
whose frequencies lie an octave apart (a Kautz basis: Wahlberg 1994, doi:10.1109/9.293196). What they explain of the
residual cannot be noise, however coloured, because they know nothing but the inputs (residual analysis: Ljung, System
Identification, 2nd ed., section 16.6).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.forcing import Forcing
from motorlens_physics.simulation import Trajectory
from motorlens_workbench.hypotheses.curves import Term
from motorlens_workbench.hypotheses.hypothesis import Hypothesis
from motorlens_workbench.hypotheses.line import Line

Array = NDArray[np.float64]

# Whose past each balance is given.
PAST = {"voltage": "current", "torque": "speed"}
# Damping ratio: resonators an octave apart then leave no gap between them.
DAMPING = 0.5
# The highest frequency has this many samples a period, the lowest this many periods in the recording.
SAMPLES, PERIODS = 8.0, 20.0
MOST = 9


@dataclass(frozen=True)
class Memory(Term):
    """A voltage or torque as a free function of the past of a state; values are for a swing of its standard deviation.

    Attributes:
        frequencies_Hz: (f,) of the resonators.
    """

    frequencies_Hz: Array

    @property
    def against(self) -> str:
        """What it is drawn against."""
        return "frequency"

    @property
    def past(self) -> str:
        """The state it follows."""
        return PAST[self.balance]

    @property
    def width(self) -> int:
        """How many columns it has."""
        return 2 * len(self.frequencies_Hz)

    @property
    def name(self) -> str:
        """What it is called where hypotheses are listed."""
        return f"{self.balance} against past {self.past}"

    def columns(self, line: Line) -> Array:
        """(N, C, 2 f) what a unit of each resonator would change in the channels."""
        return line.of_forcing(self.forcing(line.trajectory))

    def forcing(self, trajectory: Trajectory) -> Forcing:
        """What a unit of each resonator adds to the balances, (N, 2 f) each; the state is taken per standard deviation."""
        signal = trajectory.speed_rad_s if self.past == "speed" else trajectory.current_A
        scale = max(float(np.std(signal)), 1e-12)
        return self.adding(resonances(signal / scale, trajectory.inputs.time_s, self.frequencies_Hz))

    def values(self, coefficient: Array, covariance: Array) -> tuple[Array, Array, Array]:
        """(f,) the frequencies in Hz, what is missing at each in `unit`, and its standard deviation."""
        s = 1j * self.frequencies_Hz[:, None] / self.frequencies_Hz
        below = s**2 + 2 * DAMPING * s + 1
        answers = np.stack([s**2 / below, s / below], axis=2).reshape(len(s), -1)
        response = answers @ coefficient
        size = np.abs(response)
        slope = np.real(answers * (np.conj(response) / np.maximum(size, 1e-300))[:, None])
        spread = np.sqrt(np.maximum(np.einsum("fi,ij,fj->f", slope, covariance, slope), 0))
        return self.frequencies_Hz, size, spread


def memories(trajectories: Sequence[Trajectory]) -> list[Hypothesis]:
    """Both balances with the frequencies that the recordings can show, an octave apart."""
    periods = [float(np.median(np.diff(t.inputs.time_s))) for t in trajectories]
    spans = [float(t.inputs.time_s[-1] - t.inputs.time_s[0]) for t in trajectories]
    highest, lowest = 1 / (SAMPLES * min(periods)), PERIODS / max(spans)
    octaves = min(int(np.log2(highest / lowest)), MOST) if highest > lowest else 0
    frequencies = np.array([highest / 2.0**k for k in reversed(range(octaves))])
    made = [Memory(balance, frequencies) for balance in PAST] if octaves else []
    return [Hypothesis(memory.name, "unnamed", memory.equation, (memory,)) for memory in made]


def resonances(y: Array, time_s: Array, frequencies_Hz: Array) -> Array:
    """(N, 2 f) answers of resonators to y (N,), which runs linearly between its samples: acceleration and velocity.

    Each begins at rest about y[0] and passes nothing constant: x'' + 2 d W x' + W^2 x = y'', columns x' / W and x.
    """
    out = np.empty((len(y), 2 * len(frequencies_Hz)))
    for k, hertz in enumerate(frequencies_Hz):
        out[:, 2 * k], out[:, 2 * k + 1] = _resonator(y, time_s, 2 * np.pi * hertz, DAMPING)
    return out


@numba.njit(cache=True, nogil=True)
def _resonator(y, time, omega, damping):  # type: ignore[no-untyped-def]
    # Low-pass p'' + 2 d W p' + W^2 p = W^2 y in the real and imaginary part of its modal state, exact for a ramp;
    # p'/W passes a band, (p'' = W^2 (y - p) - 2 d W p') / W^2 passes what is high.
    root = omega * np.sqrt(1.0 - damping**2)
    pole = complex(-damping * omega, root)
    band, high = np.empty(len(y)), np.empty(len(y))
    # z' = pole z + y; impulse response of p is W^2/root * imag(exp(pole t)), of p' is W^2/root * imag(pole exp(pole t)).
    z = -y[0] / pole
    for n in range(len(y)):
        if n:
            dt = time[n] - time[n - 1]
            grow = np.exp(pole * dt)
            slope = (y[n] - y[n - 1]) / dt
            hold = (grow - 1.0) / pole
            z = grow * z + y[n - 1] * hold + slope * (hold - dt) / pole
        p = omega**2 / root * z.imag
        rate = omega**2 / root * (pole * z).imag
        band[n] = rate / omega
        high[n] = y[n] - p - 2 * damping * rate / omega
    return high, band
