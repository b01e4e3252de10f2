"""The extended Kalman filter after Acarnley and Al-Tayie: current, speed, winding temperature, and the load as disturbance.

Acarnley and Al-Tayie (1997), Estimation of speed and armature temperature in a brushed DC drive using the extended Kalman
filter, doi:10.1049/ip-epa:19970927. Beyond the paper: the load torque is a state (a random walk) instead of a known
constant, the effects of the motor file take part, steps may be irregular, and the covariance is updated in Joseph's form.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
from numba import njit

from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.parameter import Rated
from motorlens_physics.recording import Recording
from motorlens_train.baselines.calibration import calibrated
from motorlens_train.baselines.method import Array, Estimate, inputs, steps_of, truth
from motorlens_train.bound import between, transition
from motorlens_train.observer.model import linearised, without_angle

# Candidates of the tuning: walks of the load in rated torques, of the winding in kelvin, per square root of a second.
LOAD_WALKS = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
THERMAL_WALKS = (0.0, 0.01, 0.03, 0.1, 0.3)
# Samples of all recordings together on which the walks are tuned.
TUNING_SAMPLES = 60_000


@dataclass(frozen=True)
class ExtendedKalman:
    """States i, w, theta, those of effects, and T_load; measurement i; input v.

    Attributes:
        motor: the model.
        rated: rating plate: sizes of the prior.
        voltage_sd, current_sd: noise of a sample.
        load_walk: N m per square root of a second.
        thermal_walk: K per square root of a second.
        rise, rise_sd: the prior of the winding's temperature.
        refit: whether `fit` fits the motor's parameters, or takes those of the file.
    """

    motor: Motor = field(default_factory=Motor)
    rated: Rated = Rated(240.0, 7.27, 221.0, 6.455, 80.0)  # noqa: RUF009 -- frozen
    voltage_sd: float = 0.5
    current_sd: float = 0.05
    load_walk: float = 0.5
    thermal_walk: float = 0.01
    rise: float = 0.0
    rise_sd: float = 1.0
    refit: bool = True

    def fit(self, recordings: Sequence[Recording], motor_file: MotorFile) -> "ExtendedKalman":
        """Parameters by `calibrated`, noise from the recordings, walks by the errors on them. See `Method.fit`."""
        file = calibrated(motor_file, recordings) if self.refit else motor_file
        v_sd, i_sd = noise_of(recordings, motor_file.rated)
        rise = 0.3 * file.rated.rise_K
        tuned = replace(
            self, motor=without_angle(file.motor), rated=file.rated, voltage_sd=v_sd, current_sd=i_sd, rise=rise,
            rise_sd=1.5 * rise,
        )  # fmt: skip
        parts = _shortened(recordings)
        torque = file.rated.torque_Nm
        walks = [replace(tuned, load_walk=share * torque) for share in LOAD_WALKS]
        tuned = min(walks, key=lambda each: each.error(parts, file))
        return min(
            (replace(tuned, thermal_walk=walk) for walk in THERMAL_WALKS),
            key=lambda each: each.error(parts, file),
        )

    def error(self, recordings: Sequence[Recording], file: MotorFile) -> float:
        """Mean logarithm of the root mean square errors of the outputs that were measured."""
        errors = np.concatenate([self.estimate(r).values - truth(r, file) for r in recordings])
        squares = np.array([np.mean(c[np.isfinite(c)] ** 2) for c in errors.T if np.isfinite(c).any()])
        return float(np.mean(np.log(squares + 1e-12))) if np.isfinite(squares).all() else np.inf

    def estimate(self, recording: Recording) -> Estimate:
        """See `Method.estimate`."""
        time, v, i = inputs(recording)
        names, _ = linearised(self.motor)
        ambient = recording.channels.get("ambient", np.full(len(v), self.rated.ambient_C))
        sd = {
            "i": self.current_sd,
            "w": self.rated.speed_rad_s / 4,
            "theta": self.rise_sd,
            "load": self.rated.torque_Nm,
        }
        x = np.array([{"i": i[0], "theta": self.rise}.get(name, 0.0) for name in names])
        # A slow state that effects bring (housing, magnets) starts anywhere the winding may.
        P = np.diag([sd.get(name, self.rise_sd if name.startswith("theta") else 0.0) ** 2 for name in names])
        walks = np.array(
            [{"load": self.load_walk, "theta": self.thermal_walk}.get(name, 0.0) ** 2 for name in names]
        )
        columns = (np.ascontiguousarray(u, dtype=np.float64) for u in (steps_of(time), v, i, ambient))
        means, variances = _run(
            _equations(self.motor),
            *columns,
            x,
            P,
            walks,
            float(self.motor.L),
            float(self.voltage_sd),
            self.current_sd**2,
        )
        w, theta = names.index("w"), names.index("theta")
        per_K = self.motor.R_a0 * self.motor.alpha
        values = np.column_stack([means[:, w], means[:, theta], self.motor.resistance(means[:, theta])])
        sds = np.sqrt(np.column_stack([variances[:, w], variances[:, theta], per_K**2 * variances[:, theta]]))
        return Estimate.of(values, sds)


def noise_of(recordings: Sequence[Recording], rated: Rated) -> tuple[float, float]:
    """Standard deviation of the white noise of voltage (V) and current (A): from second differences, robustly.

    Not below a thousandth of the rating plate: a voltage that was commanded has no noise, and is not exact either.
    """

    def noise(y: Array) -> float:
        return float(1.4826 * np.median(np.abs(np.diff(y, 2))) / np.sqrt(6)) if len(y) > 2 else 0.0

    found = [[noise(y) for y in inputs(recording)[1:]] for recording in recordings]
    v, i = np.median(found, axis=0)
    return max(float(v), 1e-3 * rated.voltage_V), max(float(i), 1e-3 * rated.current_A)


def _shortened(recordings: Sequence[Recording]) -> list[Recording]:
    each = max(1000, TUNING_SAMPLES // len(recordings))
    return [recording.part(slice(0, each)) for recording in recordings[: max(1, TUNING_SAMPLES // 1000)]]


@cache
def _equations(motor: Motor) -> Any:
    """The motor's rates and Jacobian as machine code of one type for all motors, so that the filter compiles once."""
    _, program = linearised(motor)
    return program.compiled()


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _run(
    equations: Any, dt: Array, v: Array, i: Array, ambient: Array, x: Array, P: Array, walks: Array, L: float, v_sd: float,
    r: float,
) -> tuple[Array, Array]:  # fmt: skip  # pragma: no cover - compiled
    n = len(x)
    arguments, results = np.empty(n + 2), np.empty(n + n * n)
    means, variances = np.empty((len(v), n)), np.empty((len(v), n))
    augmented, K = np.zeros((n + 1, n + 1)), np.empty(n)
    F, G = np.empty((n, n)), np.eye(n)
    x, P = x.copy(), P.copy()
    for k in range(len(v)):
        if k > 0:
            step = dt[k]
            for j in range(n):
                arguments[j] = x[j]
            arguments[n], arguments[n + 1] = 0.5 * (v[k - 1] + v[k]), ambient[k]
            equations(arguments, results)
            for a in range(n):
                augmented[a, n] = results[a]
                for b in range(n):
                    augmented[a, b] = results[n + a * n + b]
            E, half = transition(augmented, step), transition(augmented, 0.5 * step)
            for a in range(n):
                x[a] += E[a, n]
                for b in range(n):
                    F[a, b] = E[a, b]
            P = between(F, P)
            # The noise of the voltage, and that nobody knows where in the step the voltage changed.
            change = max(0.0, (v[k] - v[k - 1]) ** 2 - 18 * v_sd**2) / 12
            driven = (step / L) ** 2 * (v_sd**2 + change)
            for a in range(n):
                P[a, a] += 0.5 * walks[a] * step
                for b in range(n):
                    P[a, b] += driven * half[a, 0] * half[b, 0]
                    for j in range(n):
                        P[a, b] += 0.5 * walks[j] * step * F[a, j] * F[b, j]
        S = P[0, 0] + r
        surprise = i[k] - x[0]
        for a in range(n):
            K[a] = P[a, 0] / S
            x[a] += K[a] * surprise
            G[a, 0] = (1.0 if a == 0 else 0.0) - K[a]
        P = between(G, P)
        for a in range(n):
            for b in range(n):
                P[a, b] += r * K[a] * K[b]
            means[k, a], variances[k, a] = x[a], P[a, a]
    return means, variances
