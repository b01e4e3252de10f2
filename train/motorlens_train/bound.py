"""The posterior Cramer-Rao bound: how well any estimator could do on a trajectory, from voltage and current alone.

For a Markov process observed in Gaussian noise, the covariance of every estimator is bounded by the inverse of the
information matrix of Tichavsky, Muravchik and Nehorai (1998), doi:10.1109/78.668800. With small process noise its
expectations are taken along the true trajectory, and the recursion is the Riccati recursion of the model linearised there
(van Trees and Bell 2007, Bayesian Bounds, part 1): what a Kalman filter that knew the linearisation would reach.

The states are those of the motor with its effects, and the load torque as a random walk. The current is measured with
white noise; the noise of the measured voltage enters where the voltage does, as process noise of the current. Everything
assumed is an argument; a larger prior, walk or noise gives a larger bound.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from motorlens_physics.motor import Motor
from motorlens_physics.recording import Recording
from motorlens_physics.simulation import Inputs, simulate
from motorlens_runtime.errors import DataError
from motorlens_train.observer.model import along, linearised

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Noise:
    """What the bound assumes of noise.

    Attributes:
        voltage_V, current_A: standard deviation of a sample, white.
        load_walk: of the load torque, N m per square root of a second.
        thermal_walk: of the winding's temperature beyond its thermal model, K per square root of a second.
        voltage_bias_V: prior standard deviation of a constant error of the measured voltage.
    """

    voltage_V: float = 0.5
    current_A: float = 0.05
    load_walk: float = 0.02
    thermal_walk: float = 0.0
    voltage_bias_V: float = 0.0


@dataclass(frozen=True)
class Bound:
    """Least standard deviations at each instant: speed (rad/s), temperature (K), resistance (ohm), load (N m); (N,) each.

    `covariance` (N, n, n) is over `states`.
    """

    time_s: Array
    states: tuple[str, ...]
    covariance: Array
    resistance_per_K: float

    def sd(self, state: str) -> Array:
        """Least standard deviation (N,) of a state."""
        k = self.states.index(state)
        return np.asarray(np.sqrt(self.covariance[:, k, k]))

    @property
    def outputs(self) -> Array:
        """(N, 3): speed, temperature, resistance."""
        theta = self.sd("theta")
        return np.column_stack([self.sd("w"), theta, self.resistance_per_K * theta])

    def correlation(self, one: str, other: str) -> Array:
        """Correlation (N,) of the errors of two states."""
        a, b = self.states.index(one), self.states.index(other)
        scale = np.sqrt(self.covariance[:, a, a] * self.covariance[:, b, b])
        return np.asarray(self.covariance[:, a, b] / scale)


@dataclass(frozen=True)
class Prior:
    """Standard deviations before the first sample, by state; those not named are known exactly."""

    sd: Mapping[str, float] = field(
        default_factory=lambda: {"w": 50.0, "theta": 40.0, "load": 10.0, "i": 1.0}
    )


def bound(
    motor: Motor,
    time_s: Array,
    states: Mapping[str, Array],
    voltage_V: Array,
    ambient_C: Array,
    noise: Noise,
    prior: Prior,
) -> Bound:
    """The bound along a true trajectory.

    A genie tells when the load steps, and by about how much: the size of each change into a sample is a further standard
    deviation of it. A rotor whose speed is exactly 0 is known to rest: no process noise, no deviation. An estimator that
    must notice both itself cannot do better.

    Args:
        motor: the true motor.
        time_s: (N,).
        states: each of the motor's states and "load", (N,).
        voltage_V: true terminal voltage (N,).
        ambient_C: ambient temperature (N,).
        noise: what is assumed of sensors and walks.
        prior: what is known before the first sample.
    """
    names, _ = linearised(motor)
    A = along(motor, [states[name] for name in names], voltage_V, ambient_C)
    size = len(names)
    resting = np.asarray(states["w"]) == 0.0
    biased = noise.voltage_bias_V > 0
    if biased:
        # The bias is one more state that adds to the voltage.
        wider = np.zeros((len(time_s), size + 1, size + 1))
        wider[:, :size, :size] = A
        wider[:, 0, size] = 1 / motor.L
        A, size, names = wider, size + 1, (*names, "voltage_bias")
    P = np.diag([prior.sd.get(name, 0.0) ** 2 for name in names])
    if biased:
        P[-1, -1] = noise.voltage_bias_V**2
    walks = np.zeros(size)
    walks[names.index("theta")] = noise.thermal_walk**2
    walks[names.index("load")] = noise.load_walk**2
    changes = np.square(np.diff(states["load"], prepend=states["load"][:1]))
    drive = np.zeros(size)
    drive[0] = noise.voltage_V / motor.L
    covariance = riccati(
        np.asarray(time_s, dtype=np.float64), A, P, walks, changes, names.index("load"), drive, noise.current_A**2,
        resting, names.index("w"),
    )  # fmt: skip
    return Bound(np.asarray(time_s), names, covariance, motor.R_a0 * motor.alpha)


def bound_of_recording(motor: Motor, recording: Recording, noise: Noise, prior: Prior) -> Bound:
    """The bound along what a recording says happened: its true speed, where it has one, temperature and load torque; what
    it does not say, the current without noise above all, is simulated from its inputs.

    Args:
        motor: the true motor.
        recording: voltage, load torque, ambient and temperature. A measured voltage will do where steps excite the motor.
            Where little does, its noise passes for an excitation, which shows a temperature that nothing shows.
        noise: what is assumed.
        prior: what is known before the first sample.

    Raises:
        DataError: the recording lacks a channel.
    """
    for quantity in ("load_torque", "ambient", "temperature"):
        if not recording.has(quantity):
            raise DataError(f"{recording.name}: the bound needs the {quantity} channel")
    c = recording.channels
    inputs = Inputs(recording.time_s, c["voltage"], c["load_torque"], c["ambient"])
    true = {"theta": c["temperature"] - c["ambient"]}
    true |= {"w": c["speed"]} if recording.has("speed") else {}
    simulated = simulate(motor, inputs, {name: float(values[0]) for name, values in true.items()}).states
    states = {**simulated, **true, "load": c["load_torque"]}
    return bound(motor, recording.time_s, states, c["voltage"], c["ambient"], noise, prior)


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def transition(A: Array, dt: float) -> Array:  # pragma: no cover - compiled
    """exp(A dt) by scaling, Taylor's series and squaring."""
    n = A.shape[0]
    norm = 0.0
    for r in range(n):
        total = 0.0
        for c in range(n):
            total += abs(A[r, c]) * dt
        norm = max(norm, total)
    halvings = 0
    while norm > 0.25:
        norm *= 0.5
        halvings += 1
    scale = dt / 2.0**halvings
    F = np.eye(n)
    term = np.eye(n)
    for k in range(1, 9):
        term = product(term, A, scale / k)
        for r in range(n):
            for c in range(n):
                F[r, c] += term[r, c]
    for _ in range(halvings):
        F = product(F, F)
    return F


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def product(A: Array, B: Array, scale: float = 1.0) -> Array:  # pragma: no cover - compiled
    """scale A B of small square matrices, written out: numba takes ten times as long to compile its own."""
    n = A.shape[0]
    out = np.empty((n, n))
    for r in range(n):
        for c in range(n):
            total = 0.0
            for k in range(n):
                total += A[r, k] * B[k, c]
            out[r, c] = scale * total
    return out


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def between(F: Array, P: Array) -> Array:  # pragma: no cover - compiled
    """F P F' of small square matrices."""
    back: Array = product(product(F, P), F.T.copy())
    return back


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def riccati(
    time: Array, A: Array, P: Array, walks: Array, changes: Array, load: int, drive: Array, r: float,
    resting: NDArray[np.bool_], w: int,
) -> Array:  # fmt: skip  # pragma: no cover - compiled
    """Covariances (N, n, n) after each measurement of the first state (the current) with variance r.

    Between samples: exp(A dt); process noise `walks` (n,) per second, by the trapezoidal rule; `drive` (n,) is the rate at
    which one sample's voltage noise drives the states over that sample's step; `changes` (N,) adds to the load's variance.
    """
    n, N = A.shape[1], A.shape[0]
    out = np.empty((N, n, n))
    P = P.copy()
    mean, G, K, g = np.empty((n, n)), np.eye(n), np.empty(n), np.empty(n)
    for k in range(N):
        if k > 0:
            dt = time[k] - time[k - 1]
            still = resting[k - 1] and resting[k]
            for a in range(n):
                for b in range(n):
                    mean[a, b] = 0.0 if still and a == w else 0.5 * (A[k - 1, a, b] + A[k, a, b])
            F, half = transition(mean, dt), transition(mean, 0.5 * dt)
            for a in range(n):
                g[a] = 0.0
                for b in range(n):
                    g[a] += half[a, b] * drive[b] * dt
            P[load, load] += changes[k]
            P = between(F, P)
            # Half of the walk before the step and half after it: right to second order in the step.
            for a in range(n):
                P[a, a] += 0.5 * walks[a] * dt
                for b in range(n):
                    P[a, b] += g[a] * g[b]
                    for j in range(n):
                        P[a, b] += 0.5 * walks[j] * dt * F[a, j] * F[b, j]
        if resting[k]:
            for a in range(n):
                P[w, a] = 0.0
                P[a, w] = 0.0
        S = P[0, 0] + r
        # Joseph's form: symmetric and positive whatever the rounding.
        for a in range(n):
            K[a] = P[a, 0] / S
            G[a, 0] = (1.0 if a == 0 else 0.0) - K[a]
        P = between(G, P)
        for a in range(n):
            for b in range(n):
                P[a, b] += r * K[a] * K[b]
                out[k, a, b] = P[a, b]
    return out
