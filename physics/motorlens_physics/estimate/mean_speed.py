"""A speed that is the mean since the sample before: what a controller gets that counts an encoder's lines.

The mean of the speed over a sample follows from what is simulated at its ends. While the inputs hold, the rates of change of
current and speed go as Phi(t), from f at its begin; so in a sample of T

    x_after - x_before = S f,  S = integral of Phi(t) dt
    mean of x - x_before = Q f,  Q = integral of (1 - t/T) Phi(t) dt

of which f is eliminated. Inputs that run linearly besides would take the motor along a ramp, of which the mean is that of
both ends, and what is left goes by itself. The columns of S and Q are, but for factors that cancel, how the states answer to
a voltage and a torque that hold, and to such that rise linearly from nought: the motor along its trajectory knows them
(`Linearisation`), with all that acts in it. How the mean depends on the motor's parameters is told by the textbook's motor,
of which Phi(t) = exp(A t) and Q S^-1 = (A T)^-1 - (exp(A T) - 1)^-1.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from motorlens_physics.inputs import Inputs
from motorlens_physics.motor import Motor
from motorlens_physics.sensitivity import Linearisation

Array = NDArray[np.float64]

# The name of the mean among the states of a motor.
MEAN = "mean of w"
# Below this, in samples, the series of three terms has more digits than the difference it stands for.
SERIES = 0.1
# Rates that are as near to each other, in samples, are taken to be so far apart.
APART = 1e-5
# Share of itself by which a parameter is changed to see what depends on it.
CHANGED = 1e-4
# Those on which the mean depends.
KEYS = ("R_a0", "L", "ke", "J", "b")


@dataclass(frozen=True)
class Changes:
    """How current and speed (N - 1,) change over each sample, in A and rad/s."""

    current: Array
    speed: Array


@dataclass(frozen=True)
class Mean:
    """How the mean of the speed over each sample follows from the speed at its begin and what changes until its end.

    Attributes:
        of_current: (N - 1,) by a change of the current, rad/s/A.
        of_speed: (N - 1,) by a change of the speed: a half where it changes evenly.
    """

    of_current: Array
    of_speed: Array

    def since_last(self, speed: Array, current: Array) -> Array:
        """The mean speed since the sample before; at the first the speed there.

        Args:
            speed, current: (N, ...) at the samples, or changes of them.

        >>> even = Mean(np.ones(2), np.full(2, 0.5))
        >>> even.since_last(np.array([0.0, 2.0, 4.0]), np.ones(3))
        array([0., 1., 3.])
        """
        mean, across = speed.copy(), (-1, *(1,) * (speed.ndim - 1))
        mean[1:] = speed[:-1] + self.of_speed.reshape(across) * (speed[1:] - speed[:-1])
        mean[1:] += self.of_current.reshape(across) * (current[1:] - current[:-1])
        return mean

    def along(self, ramps: Changes) -> Array:
        """(N - 1,) what the mean over each sample is more where inputs take the motor along ramps."""
        return (0.5 - self.of_speed) * ramps.speed - self.of_current * ramps.current


def mean_of(linear: Linearisation) -> Mean:
    """How the mean of the speed follows from what is simulated at the samples."""
    holding, rising, _ = _answers(linear)
    (to_volts, to_torque), (spun, pushed) = np.moveaxis(holding, 0, -1)
    q_volts, q_torque = rising[:, 1].T
    free = to_volts * pushed - to_torque * spun
    # A rotor or a current that is held answers to nothing.
    either = free != 0
    over, alone = np.where(either, free, 1.0), np.where(pushed != 0, pushed, 1.0)
    return Mean(
        np.where(either, (q_volts * pushed - q_torque * spun) / over, 0.0),
        np.where(
            either,
            (q_torque * to_volts - q_volts * to_torque) / over,
            np.where(pushed != 0, q_torque / alone, 0.5),
        ),
    )


def ramps_of(linear: Linearisation, inputs: Inputs) -> Changes:
    """How current and speed would change over each sample if inputs had run as linearly for long; hardly where they hold."""
    holding, _, left = _answers(linear)
    forced = np.einsum("krc,kc->kr", holding, np.column_stack(_linear_changes(inputs)))
    free = left[:, 0, 0] * left[:, 1, 1] - left[:, 0, 1] * left[:, 1, 0]
    # What is held follows no ramp.
    over = np.where(free != 0, free, np.inf)
    return Changes(
        (left[:, 1, 1] * forced[:, 0] - left[:, 0, 1] * forced[:, 1]) / over,
        (left[:, 0, 0] * forced[:, 1] - left[:, 1, 0] * forced[:, 0]) / over,
    )


def with_mean(linear: Linearisation) -> Linearisation:
    """With the mean of the speed over each sample as one more state, the last: what a counted speed shows.

    Of states that are off and go on by themselves it is exact, and of disturbances that hold.
    """
    mean, i, w = mean_of(linear), linear.states.index("i"), linear.states.index("w")
    of_current, of_speed = mean.of_current[:, None], mean.of_speed[:, None]
    steps, n = linear.matrices.shape[:2]
    of_states, of_forcings = linear.matrices[:, :, :n], linear.matrices[:, :, n:]
    wider = np.zeros((steps, n + 1, n + 7))
    wider[:, :n, :n], wider[:, :n, n + 1 :] = of_states, of_forcings
    wider[:, n, :n] = of_speed * of_states[:, w] + of_current * of_states[:, i]
    wider[:, n, w] += 1 - of_speed[:, 0]
    wider[:, n, i] -= of_current[:, 0]
    wider[:, n, n + 1 :] = of_speed * of_forcings[:, w] + of_current * of_forcings[:, i]
    return Linearisation((*linear.states, MEAN), wider)


def of_parameters(motor: Motor, inputs: Inputs, theta: Array, changes: Changes) -> dict[str, Array]:
    """(N - 1,) by how much the mean over each sample changes with parameters beside what the states at its ends do.

    Args:
        motor: with its parameters as they are.
        inputs: what acts on it.
        theta: (N,) rise of the winding, K.
        changes: from sample to sample.
    """
    known = np.array([getattr(motor, key) for key in KEYS])
    # A viscosity may be nought.
    steps = CHANGED * np.where(known > 0, known, motor.ke**2 / motor.R_a0)
    hotter = 1 + motor.alpha * theta[:-1]
    volts, torque = _linear_changes(inputs)
    told = {}
    for k, (key, step) in enumerate(zip(KEYS, steps, strict=True)):
        up, down = known.copy(), known.copy()
        up[k], down[k] = known[k] + step, known[k] - step
        after, before = (
            _textbook(values, np.diff(inputs.time_s), hotter, volts, torque, changes.current, changes.speed)
            for values in (up, down)
        )
        told[key] = (after - before) / (2 * step)
    return told


def _answers(linear: Linearisation) -> tuple[Array, Array, Array]:
    """(N - 1, 2, 2) how current and speed answer to voltage and torque that hold, and that rise; what they lose."""
    n, at = len(linear.states), [linear.states.index(state) for state in ("i", "w")]
    own = linear.matrices[:, at]
    rising = own[:, :, n + 3 : n + 5]
    return rising + own[:, :, n : n + 2], rising, np.eye(2) - own[:, :, at]


def _linear_changes(inputs: Inputs) -> tuple[Array, Array]:
    """(N - 1,) changes of the voltage, and of the torque that drives, where they run linearly; nothing where they hold."""
    of_voltage, of_load, _ = inputs.hold
    return np.diff(inputs.voltage_V) * (not of_voltage), -np.diff(inputs.load_torque_Nm) * (not of_load)


@njit(cache=True, nogil=True, error_model="numpy")
def _textbook(values, T, hotter, volts, torque, current, speed):  # type: ignore[no-untyped-def]
    """(N - 1,) mean of the speed less that at the begin of each sample, of the textbook's motor.

    Args:
        values: (5,) of `KEYS`.
        T: (N - 1,) how long each sample lasts, s.
        hotter: (N - 1,) its resistance over that of `R_a0`.
        volts, torque: (N - 1,) changes of what drives it where that runs linearly.
        current, speed: (N - 1,) changes of its states.
    """
    cold, L, ke, J, b = values
    mean = np.empty(len(T))
    for k in range(len(T)):
        resistance = cold * hotter[k]
        ramp = (ke * volts[k] + resistance * torque[k]) / (resistance * b + ke**2)
        ramp_current = (b * ramp - torque[k]) / ke
        # The matrix A T, and a function of it as the line through its values at both rates.
        ii, iw, wi, ww = -resistance / L * T[k], -ke / L * T[k], ke / J * T[k], -b / J * T[k]
        middle = 0.5 * (ii + ww)
        square = 0.25 * (ii - ww) ** 2 + iw * wi
        half = max(math.sqrt(abs(square)), APART)
        if square < 0:
            level, slope = _share(middle, half)
            slope /= half
        else:
            (first, _), (second, _) = _share(middle + half, 0.0), _share(middle - half, 0.0)
            level, slope = 0.5 * (first + second), 0.5 * (first - second) / half
        of_current, of_speed = slope * wi, level + slope * (ww - middle)
        mean[k] = of_current * (current[k] - ramp_current) + of_speed * (speed[k] - ramp) + 0.5 * ramp
    return mean


@njit(cache=True, nogil=True, error_model="numpy")
def _share(x, y):  # type: ignore[no-untyped-def]
    """1/z - 1/(exp(z) - 1) of z = x + y i, its real and its imaginary part; by its series where that cancels."""
    if x * x + y * y < SERIES**2:
        z = complex(x, y)
        w = z * z
        share = 0.5 - z * (1 / 12 - w * (1 / 720 - w / 30240))
        return share.real, share.imag
    # exp(z) - 1
    real, imag = math.expm1(x) * math.cos(y) - 2 * math.sin(y / 2) ** 2, math.exp(x) * math.sin(y)
    size, other = x * x + y * y, real * real + imag * imag
    return x / size - real / other, imag / other - y / size
