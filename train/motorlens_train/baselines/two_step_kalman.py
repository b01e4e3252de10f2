"""The two-step Kalman filter after Pantonial: a fast one with constant gain for speed, a slow one for temperature.

Pantonial, Kilantang and Buenaobra (2012), Real time thermal estimation of a brushed DC motor by a steady-state Kalman filter
algorithm in multi-rate sampling scheme, doi:10.1109/TENCON.2012.6412196.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit
from scipy.linalg import expm, solve_discrete_are

from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_train.baselines.calibration import calibrated
from motorlens_train.baselines.extended_kalman import LOAD_WALKS, noise_of
from motorlens_train.baselines.method import Array, Estimate, inputs, residual_sd, steps_of

# Pace of the slow filter, s.
SLOW_S = 1.0


@dataclass(frozen=True)
class TwoStepKalman:
    """Step one: i, w, T_load with the resistance of the last slow step, gain of the discrete Riccati equation.

    Step two, once a second: theta by the thermal model, corrected by the resistance that (v - L di/dt - ke w) / i shows.
    """

    motor: Motor = field(default_factory=Motor)
    voltage_sd: float = 0.5
    current_sd: float = 0.05
    load_walk: float = 0.5
    rated_current: float = 7.27
    rise: float = 0.0
    rise_sd: float = 1.0
    sd: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def fit(self, recordings: Sequence[Recording], motor_file: MotorFile) -> "TwoStepKalman":
        """Parameters by `calibrated`, the load's walk by the errors on the recordings. See `Method.fit`."""
        file = calibrated(motor_file, recordings)
        v_sd, i_sd = noise_of(recordings, file.rated)
        fitted = replace(
            self, motor=replace(file.motor, effects=()), voltage_sd=v_sd, current_sd=i_sd,
            rated_current=file.rated.current_A, rise=0.3 * file.rated.rise_K, rise_sd=0.45 * file.rated.rise_K,
        )  # fmt: skip
        candidates = [replace(fitted, load_walk=share * file.rated.torque_Nm) for share in LOAD_WALKS]
        sds = [residual_sd(candidate, recordings, file) for candidate in candidates]
        scores = [float(np.nansum(np.log(s + 1e-12))) for s in sds]
        best = int(np.argmin(np.where(np.isfinite(scores), scores, np.inf)))
        s = sds[best]
        return replace(candidates[best], sd=(float(s[0]), float(s[1]), float(s[2])))

    def estimate(self, recording: Recording) -> Estimate:
        """See `Method.estimate`."""
        time, v, i = inputs(recording)
        m, period = self.motor, recording.period_s
        # The gain is that of a winding at its rated temperature; a constant gain is the point of the method.
        R = m.resistance(self.rise)
        A = np.array([[-R / m.L, -m.ke / m.L, 0.0], [m.ke / m.J, -m.b / m.J, -1 / m.J], [0.0, 0.0, 0.0]])
        F = expm(A * period)
        g = expm(0.5 * A * period)[:, 0] * self.voltage_sd * period / m.L
        walk = F[:, 2] * self.load_walk * np.sqrt(period)
        Q = np.outer(g, g) + np.outer(walk, walk) + 1e-12 * np.eye(3)
        H = np.array([[1.0, 0.0, 0.0]])
        P = solve_discrete_are(F.T, H.T, Q, np.array([[self.current_sd**2]]))
        K = P[:, 0] / (P[0, 0] + self.current_sd**2)
        speed_sd = float(np.sqrt(P[1, 1] - K[1] * P[0, 1]))
        parameters = np.array([m.R_a0, m.alpha, m.ke, m.L, m.J, m.b, m.k_ir, m.k0, m.kT, m.H])
        w, theta = _run(
            steps_of(time),
            v,
            i,
            K,
            parameters,
            self.rise,
            self.rise_sd**2,
            speed_sd,
            self.voltage_sd,
            self.rated_current,
        )
        values = np.column_stack([w, theta, m.resistance(theta)])
        return Estimate.of(values, np.outer(np.ones_like(w), np.asarray(self.sd)))


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _run(
    dt: Array, v: Array, i: Array, K: Array, p: Array, theta: float, variance: float, speed_sd: float,
    v_sd: float, rated: float,
) -> tuple[Array, Array]:  # fmt: skip  # pragma: no cover - compiled
    R_a0, alpha, ke, L, J, b, k_ir, k0, kT, H = p
    x_i, x_w, load = i[0], 0.0, 0.0
    w_out, theta_out = np.empty_like(v), np.empty_like(v)
    past, sum_ii, sum_iu, sum_heat, sum_cool, first = 0.0, 0.0, 0.0, 0.0, 0.0, i[0]
    samples = 0
    for k in range(len(v)):
        R = R_a0 * (1 + alpha * theta)
        if k > 0:
            # Current: exact over the step at constant speed; speed: by the trapezoidal rule over the current.
            u = 0.5 * (v[k] + v[k - 1])
            decay = np.exp(-R * dt[k] / L)
            ahead = (u - ke * x_w) / R + (x_i - (u - ke * x_w) / R) * decay
            mean = 0.5 * (x_i + ahead)
            x_w += dt[k] * (ke * mean - b * x_w - load) / J
            x_i = ahead
        error = i[k] - x_i
        x_i += K[0] * error
        x_w += K[1] * error
        load += K[2] * error
        past += dt[k]
        samples += 1
        sum_ii += i[k] * i[k] * dt[k]
        sum_iu += i[k] * (v[k] - ke * x_w) * dt[k]
        sum_heat += (R * i[k] * i[k] + k_ir * x_w * x_w) * dt[k]
        sum_cool += k0 * (1 + kT * abs(x_w)) * dt[k]
        if past >= SLOW_S:
            # The thermal model over the slow step, exact for constant heat.
            cool = sum_cool / past
            decay = np.exp(-sum_cool / H)
            theta = theta * decay + sum_heat / past / cool * (1 - decay)
            variance = variance * decay * decay + 1e-4 * past
            mean_ii = sum_ii / past
            if mean_ii > (0.05 * rated) ** 2:
                # i L di/dt integrates to the change of L i^2 / 2.
                shown = (sum_iu - 0.5 * L * (i[k] ** 2 - first**2)) / sum_ii
                # White noise averages out; the error of the speed does not.
                r = ((ke * speed_sd) ** 2 + v_sd**2 / samples) / mean_ii / (R_a0 * alpha) ** 2
                gain = variance / (variance + r)
                theta += gain * ((shown / R_a0 - 1) / alpha - theta)
                variance *= 1 - gain
            past, sum_ii, sum_iu, sum_heat, sum_cool, first, samples = 0.0, 0.0, 0.0, 0.0, 0.0, i[k], 0
        w_out[k], theta_out[k] = x_w, theta
    return w_out, theta_out
