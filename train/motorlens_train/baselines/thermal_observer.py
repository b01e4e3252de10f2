"""The open-loop thermal observer: the thermal model run on the measured current, corrected by nothing."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit

from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_train.baselines.calibration import calibrated
from motorlens_train.baselines.method import Array, Estimate, inputs, low_pass, residual_sd, steps_of


@dataclass(frozen=True)
class ThermalObserver:
    """H dtheta/dt = R i^2 + k_ir w^2 - k0 (1 + kT |w|) theta with w = (v - R i - L di/dt) / ke, from ambient temperature.

    The thermal-model protection of IEC 60255-149 with the paper's losses. Effects of the motor file are left out: it is the
    textbook's observer.
    """

    motor: Motor = field(default_factory=Motor)
    smoothing_s: float = 0.02
    sd: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def fit(self, recordings: Sequence[Recording], motor_file: MotorFile) -> "ThermalObserver":
        """Parameters by `calibrated`, deviations from the errors on the recordings. See `Method.fit`."""
        motor = calibrated(motor_file, recordings).motor
        fitted = replace(self, motor=motor, smoothing_s=0.15 * motor.R_a0 * motor.J / motor.ke**2)
        s = residual_sd(fitted, recordings, motor_file)
        return replace(fitted, sd=(float(s[0]), float(s[1]), float(s[2])))

    def estimate(self, recording: Recording) -> Estimate:
        """See `Method.estimate`."""
        time, v, i = inputs(recording)
        m = self.motor
        smooth_v, smooth_i = (low_pass(time, u, self.smoothing_s) for u in (v, i))
        # The derivative of the filtered current: what the filter still lacks, over its time constant.
        drop = smooth_v - m.L * (i - smooth_i) / self.smoothing_s
        theta, w = _run(
            steps_of(time), drop, smooth_i, np.array([m.R_a0, m.alpha, m.ke, m.k_ir, m.k0, m.kT, m.H])
        )
        values = np.column_stack([w, theta, m.resistance(theta)])
        return Estimate.of(values, np.outer(np.ones_like(w), np.asarray(self.sd)))


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _run(dt: Array, drop: Array, i: Array, p: Array) -> tuple[Array, Array]:  # pragma: no cover - compiled
    R_a0, alpha, ke, k_ir, k0, kT, H = p
    theta, w = np.empty_like(drop), np.empty_like(drop)
    now = 0.0
    for k in range(len(drop)):
        w[k] = (drop[k] - R_a0 * (1 + alpha * now) * i[k]) / ke
        heat = R_a0 * i[k] ** 2 + k_ir * w[k] ** 2
        cooling = k0 * (1 + kT * abs(w[k])) - R_a0 * alpha * i[k] ** 2
        # Exact over the step for constant heat; thermal runaway (cooling < 0) grows as it should.
        now += (heat - cooling * now) * -np.expm1(-cooling * dt[k] / H) / cooling
        theta[k] = now
    return theta, w
