"""A speed that is the mean since the sample before: what a controller gets that counts an encoder's lines.

The mean of the speed over a sample follows from what is simulated at its ends. While the inputs hold, the rates of change of
current and speed go as Phi(t), from f at its begin; so in a sample of T

    x_after - x_before = S f,  S = integral of Phi(t) dt
    mean of x - x_before = Q f,  Q = integral of (1 - t/T) Phi(t) dt

of which f is eliminated. The columns of S and Q are, but for factors that cancel, how the states answer to a voltage and a
torque that hold, and to such that rise linearly from nought: the motor along its trajectory knows them (`Linearisation`),
with all that acts in it. How the mean depends on the motor's parameters is told as if neither acted on the other: with r the
winding's time constant in samples, a the acceleration by the change of the current, and c what viscosity alone makes of it,

    a (r^2 - r/2 coth(1/(2 r))) - c/12

is added to the mean of both ends, of which -a/12 is left where the current bends slowly, or runs linearly as the voltage
does (Hermite's rule).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.motor import Motor
from motorlens_physics.sensitivity import Linearisation

Array = NDArray[np.float64]

# Shortest electrical time constant, in samples, that is told from none: below, nothing bends.
BRIEFEST = 1e-6
# Longest, in samples, that the closed form is used for: there the series of two terms has seven digits of it.
SLOW = 10.0


@dataclass(frozen=True)
class Mean:
    """How the mean of the speed over each sample differs from the speed at its begin, and what that depends on.

    Attributes:
        of_current: (N - 1,) by a change of the current from its begin to its end, rad/s/A.
        of_speed: (N - 1,) by a change of the speed: a half where it changes evenly.
        slope: (N - 1,) change of `of_current` with the logarithm of the electrical time constant.
        damped_s: (N - 1,) change of `of_speed` with what viscosity takes off the speed in a second.
    """

    of_current: Array
    of_speed: Array
    slope: Array
    damped_s: Array

    def since_last(self, speed: Array, current: Array) -> Array:
        """The mean speed since the sample before; at the first the speed there.

        Args:
            speed, current: (N, ...) at the samples, or changes of them.

        >>> even = Mean(np.ones(2), np.full(2, 0.5), np.zeros(2), np.zeros(2))
        >>> even.since_last(np.array([0.0, 2.0, 4.0]), np.ones(3))
        array([0., 1., 3.])
        """
        mean, across = speed.copy(), (-1, *(1,) * (speed.ndim - 1))
        mean[1:] = speed[:-1] + self.of_speed.reshape(across) * (speed[1:] - speed[:-1])
        mean[1:] += self.of_current.reshape(across) * (current[1:] - current[:-1])
        return mean

    def of_parameters(self, motor: Motor, speed: Array, current: Array) -> dict[str, Array]:
        """(N - 1,) by how much the mean over each sample changes with parameters beside what the speed at its ends does.

        Args:
            motor: with its parameters as they are.
            speed, current: (N,) at the samples.
        """
        bent, jump = self.of_current * np.diff(current), np.diff(current)
        return {
            "L": self.slope * jump / motor.L,
            "R_a0": -self.slope * jump / motor.R_a0,
            "J": -bent / motor.J,
            "ke": bent / motor.ke,
            "b": self.damped_s * np.diff(speed) / motor.J,
        }


def mean_of(time_s: Array, linear: Linearisation, decay_s: float, *, held: bool) -> Mean:
    """How the mean of the speed follows from what is simulated at the samples.

    Args:
        time_s: (N,) of the samples.
        linear: the motor along its trajectory.
        decay_s: the electrical time constant.
        held: whether the voltage holds from one sample to the next, or runs linearly.
    """
    n, i, w = len(linear.states), linear.states.index("i"), linear.states.index("w")
    decay = np.maximum(decay_s / np.diff(time_s), BRIEFEST)
    # Of the current that was there before, a share of this has acted on the speed.
    gain = linear.matrices[:, w, i] / (-decay * np.expm1(-1 / decay))
    if not held:
        nothing = np.zeros(len(gain))
        return Mean(-gain / 12, np.full(len(gain), 0.5), nothing, nothing)
    slope = gain * _slope(decay) * decay
    # (N - 1, 2, 2) how current and speed answer to voltage and torque.
    answers = linear.matrices[:, [i, w]]
    rising = answers[:, :, n + 3 : n + 5]
    holding = rising + answers[:, :, n : n + 2]
    (to_volts, to_torque), (spun, pushed) = np.moveaxis(holding, 0, -1)
    q_volts, q_torque = rising[:, 1].T
    free = to_volts * pushed - to_torque * spun
    # A rotor or a current that is held answers to nothing.
    either = free != 0
    over, alone = np.where(either, free, 1.0), np.where(pushed != 0, pushed, 1.0)
    of_current = np.where(either, (q_volts * pushed - q_torque * spun) / over, 0.0)
    of_speed = np.where(
        either,
        (q_torque * to_volts - q_volts * to_torque) / over,
        np.where(pushed != 0, q_torque / alone, 0.5),
    )
    return Mean(of_current, of_speed, slope, np.diff(time_s) / 12)


def _slope(decay: Array) -> Array:
    """Derivative of r^2 - r/2 coth(1/(2 r)), by the series where that cancels."""
    slow, fast = np.maximum(decay, SLOW), np.minimum(decay, SLOW)
    half = np.minimum(0.5 / fast, 300.0)
    slope = 2 * fast - 0.5 / np.tanh(half) - 0.25 / (fast * np.sinh(half) ** 2)
    return np.where(decay > SLOW, -1 / (360 * slow**3), slope)
