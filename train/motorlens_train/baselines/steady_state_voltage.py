"""The steady-state voltage equation: w = (v - R i) / ke, with R and ke fitted and nothing remembered."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_runtime.errors import DataError
from motorlens_train.baselines.method import Estimate, inputs, residual_sd, truth


@dataclass(frozen=True)
class SteadyStateVoltage:
    """v = R i + ke w, the winding at its mean temperature; what a drive without a model does (IEEE Std 113-1985, 5.5).

    R (ohm) and ke (V s/rad) are those of least squares on the measured voltage; the temperature is the one at which the
    motor file has that resistance, and stays there.
    """

    R: float = 0.0
    ke: float = 1.0
    rise: float = 0.0
    sd: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def fit(self, recordings: Sequence[Recording], motor_file: MotorFile) -> "SteadyStateVoltage":
        """R and ke by least squares; the deviations are the errors on the recordings. See `Method.fit`."""
        rows, right = [], []
        for recording in recordings:
            if not recording.has("speed"):
                raise DataError(
                    f"{recording.name}: no speed column; the voltage equation is fitted to a measured speed"
                )
            _, v, i = inputs(recording)
            known = np.isfinite(recording.channels["speed"])
            rows.append(np.column_stack([i, recording.channels["speed"]])[known])
            right.append(v[known])
        (R, ke), *_ = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)
        motor = motor_file.motor
        rises = np.concatenate([truth(recording, motor_file)[:, 1] for recording in recordings])
        known = np.isfinite(rises)
        rise = float(rises[known].mean()) if known.any() else float((R / motor.R_a0 - 1) / motor.alpha)
        fitted = replace(self, R=float(R), ke=float(ke), rise=rise)
        s = residual_sd(fitted, recordings, motor_file)
        return replace(fitted, sd=(float(s[0]), float(s[1]), float(s[2])))

    def estimate(self, recording: Recording) -> Estimate:
        """See `Method.estimate`."""
        _, v, i = inputs(recording)
        ones = np.ones_like(v)
        values = np.column_stack([(v - self.R * i) / self.ke, self.rise * ones, self.R * ones])
        return Estimate.of(values, np.outer(ones, np.asarray(self.sd)))
