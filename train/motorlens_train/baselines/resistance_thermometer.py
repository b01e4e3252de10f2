"""The resistance-only thermometer: the winding's resistance from changes of voltage and current, without a thermal model.

Recursive least squares with forgetting (Ljung 1999, System Identification, 2nd ed., section 11.2) on high-passed signals:
what the load holds constant drops out, and the speed moves as the current moves it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit

from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_train.baselines.calibration import calibrated
from motorlens_train.baselines.extended_kalman import noise_of
from motorlens_train.baselines.method import Array, Estimate, inputs, residual_sd, steps_of


@dataclass(frozen=True)
class ResistanceThermometer:
    """High-passed: v = R i + L di/dt + ke w with J dw/dt = ke i; R by least squares, theta = (R / R_a0 - 1) / alpha."""

    motor: Motor = field(default_factory=Motor)
    voltage_sd: float = 0.5
    rise: float = 0.0
    rise_sd: float = 1.0
    forgetting_s: float = 60.0
    sd: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def fit(self, recordings: Sequence[Recording], motor_file: MotorFile) -> "ResistanceThermometer":
        """Parameters by `calibrated`, the forgetting by the errors on the recordings. See `Method.fit`."""
        file = calibrated(motor_file, recordings)
        v_sd, _ = noise_of(recordings, file.rated)
        rise = 0.3 * file.rated.rise_K
        fitted = replace(self, motor=file.motor, voltage_sd=v_sd, rise=rise, rise_sd=1.5 * rise)
        candidates = [replace(fitted, forgetting_s=tau) for tau in (10.0, 30.0, 100.0, 300.0, 1000.0)]
        sds = [residual_sd(candidate, recordings, file) for candidate in candidates]
        scores = [float(np.nan_to_num(s[1], nan=s[0])) for s in sds]
        s = sds[int(np.argmin(scores))]
        return replace(candidates[int(np.argmin(scores))], sd=(float(s[0]), float(s[1]), float(s[2])))

    def estimate(self, recording: Recording) -> Estimate:
        """See `Method.estimate`. The temperature's deviation is that of the least squares, the speed's that of the fit."""
        time, v, i = inputs(recording)
        m = self.motor
        corner = m.R_a0 * m.J / m.ke**2
        w, R, variance = _run(
            steps_of(time), v, i, np.array([m.ke, m.L, m.J]), corner, self.forgetting_s,
            float(m.resistance(self.rise)), (m.R_a0 * m.alpha * self.rise_sd) ** 2, self.voltage_sd,
            20 * self.voltage_sd,
        )  # fmt: skip
        theta = (R / m.R_a0 - 1) / m.alpha
        sd = np.sqrt(variance)
        return Estimate.of(
            np.column_stack([w, theta, R]),
            np.column_stack([np.full_like(w, self.sd[0]), sd / (m.R_a0 * m.alpha), sd]),
        )


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _run(
    dt: Array, v: Array, i: Array, p: Array, corner: float, forgetting: float, R: float, variance: float, v_sd: float,
    threshold: float,
) -> tuple[Array, Array, Array]:  # fmt: skip  # pragma: no cover - compiled
    ke, L, J = p
    first, start = variance, R
    speed, resistance, variances = np.empty_like(v), np.empty_like(v), np.empty_like(v)
    smooth = 0.1 * corner
    smooth_v, smooth_i, low_v = v[0], i[0], v[0]
    # Twice high-passed: the once more low-passed remainders of voltage drop and current.
    low, lower = np.array([v[0], i[0]]), np.zeros(2)
    for k in range(len(v)):
        a, f = np.exp(-dt[k] / corner), np.exp(-dt[k] / smooth)
        smooth_v = v[k] + (smooth_v - v[k]) * f
        smooth_i = i[k] + (smooth_i - i[k]) * f
        slope = (i[k] - smooth_i) / smooth
        now = np.array([smooth_v - L * slope, smooth_i])
        low = now + (low - now) * a
        once = now - low
        lower = once + (lower - once) * a
        twice = once - lower
        # s^2 / (s + a)^2 of the speed ke i / (J s) is ke / J times the low-pass of the high-passed current.
        y, x = twice[0] - ke * ke / J * corner * lower[1], twice[1]
        # Old knowledge fades towards the prior; errors of the smoothed signals are alike over its time constant.
        fade = np.exp(-dt[k] / forgetting)
        R = start + (R - start) * fade
        variance = first + (variance - first) * fade * fade
        noise = v_sd**2 * max(1.0, smooth / dt[k])
        once_v = smooth_v - low_v
        low_v = smooth_v + (low_v - smooth_v) * a
        # Only where the voltage excites: a change of the current alone is the load's.
        gain = variance * x / (noise + x * x * variance) if abs(once_v) > threshold else 0.0
        R = min(max(R + gain * (y - R * x), 0.5 * start), 2.0 * start)
        variance *= 1 - gain * x
        speed[k] = (now[0] - R * smooth_i) / ke
        resistance[k], variances[k] = R, variance
    return speed, resistance, variances
