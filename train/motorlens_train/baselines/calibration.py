"""Textbook parameters fitted to recordings: the balances, integrated over windows, are linear in them.

Equation-error least squares (Ljung 1999, System Identification, 2nd ed., sections 7.3 and 16.8) with the motor file as the
prior: what the recordings do not show stays what it was. Effects of the motor file are not refitted; `motorlens add` does
that.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_train.baselines.method import Array, inputs, truth

# Relative standard deviation of a parameter of which the motor file does not state one.
UNSTATED = 0.3


def calibrated(motor_file: MotorFile, recordings: Sequence[Recording]) -> MotorFile:
    """The motor file with R_a0, L, ke, J, b, and k0, kT, k_ir, H fitted as far as the recordings show them.

    Without a measured temperature the winding is taken to be at ambient; without a measured load its constant part is
    fitted and dropped. Recordings without speed leave the file as it is.
    """
    usable = [recording for recording in recordings if recording.has("speed") and recording.has("current")]
    if not usable:
        return motor_file
    file = motor_file
    fitted = _fit(file, ("R_a0", "L", "ke"), [_electrical(file, recording) for recording in usable])
    file = file.with_values(fitted)
    rows = [_mechanical(file, recording) for recording in usable]
    values = _fit(file, ("J", "b"), rows)
    file = file.with_values(values)
    heated = [recording for recording in usable if recording.has("temperature")]
    if heated:
        # k0 kT is what the balance is linear in; its prior follows from that of kT.
        values = _fit(file, ("H", "k0", "kT", "k_ir"), [_thermal(file, recording) for recording in heated])
        values["kT"] = values["kT"] / values["k0"]
        file = file.with_values(values)
    return file


def _fit(
    file: MotorFile, names: tuple[str, ...], systems: Sequence[tuple[Array, Array, Array]]
) -> dict[str, float]:
    """Ridge solution: `systems` are rows (n, p), right-hand sides (n,) and nuisance columns (n, q) of each recording.

    The noise of the rows is estimated from a first fit, so that priors and data are weighed as they deserve.
    """
    nuisances = sum(system[2].shape[1] for system in systems)
    matrix = np.zeros((sum(len(system[0]) for system in systems), len(names) + nuisances))
    right = np.concatenate([system[1] for system in systems])
    row, column = 0, len(names)
    for rows, _, nuisance in systems:
        matrix[row : row + len(rows), : len(names)] = rows
        matrix[row : row + len(rows), column : column + nuisance.shape[1]] = nuisance
        row, column = row + len(rows), column + nuisance.shape[1]
    good = np.isfinite(matrix).all(axis=1) & np.isfinite(right)
    matrix, right = matrix[good], right[good]
    prior = np.array([_prior(file, name) for name in names])
    mean = np.r_[prior[:, 0], np.zeros(nuisances)]
    precision = np.r_[1 / np.square(prior[:, 1]), np.full(nuisances, 1e-12)]
    if len(right) < 3 * len(mean):
        # As few windows as unknowns: they would be met exactly, and believed.
        return {name: file.values()[name] * (file.values()["k0"] if name == "kT" else 1.0) for name in names}
    solution, noise = mean, float("inf")
    for _ in range(3):
        residual = (
            right - matrix @ solution
            if np.isfinite(noise)
            else right - matrix @ np.linalg.lstsq(matrix, right)[0]
        )
        # Robust: a window in which the model's intersample behaviour fails does not count for more than it must.
        scale = 1.4826 * np.median(np.abs(residual)) + 1e-12
        weight = 1 / np.square(scale) / np.maximum(1.0, np.abs(residual) / (3 * scale))
        normal = matrix.T @ (weight[:, None] * matrix) + np.diag(precision)
        solution = mean + np.linalg.solve(normal, matrix.T @ (weight * (right - matrix @ mean)))
        noise = scale
    lows = [file.meaning(name).bounds for name in names]
    bounded = [
        float(
            np.clip(value, max(low, 1e-3 * abs(m)) if name != "kT" else 0.0, high if name != "kT" else np.inf)
        )
        for name, value, m, (low, high) in zip(names, solution, prior[:, 0], lows, strict=False)
    ]
    return dict(zip(names, bounded, strict=True))


def _prior(file: MotorFile, name: str) -> tuple[float, float]:
    """Mean and standard deviation; of k0 kT where kT is asked for."""
    values = file.values()
    known = file.knowledge.get(name)
    sd = known.sd if known is not None and known.sd else UNSTATED * max(abs(values[name]), 1e-9)
    scale = values["k0"] if name == "kT" else 1.0
    return scale * values[name], scale * sd


def _windows(recording: Recording, length_s: float) -> NDArray[np.intp]:
    """Edges (indices) of consecutive windows of about `length_s`, at least one sample each."""
    stride = max(1, round(length_s / recording.period_s))
    return np.arange(0, len(recording), stride)


def _integral(time: Array, y: Array, edges: NDArray[np.intp]) -> Array:
    """Integral of y over each window, by the trapezoidal rule."""
    total = np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(time))])
    return np.diff(total[edges])


def _channels(file: MotorFile, recording: Recording) -> Mapping[str, Array]:
    _, v, i = inputs(recording)
    actual = truth(recording, file)
    theta = (
        np.where(np.isfinite(actual[:, 1]), actual[:, 1], 0.0)
        if not recording.has("temperature")
        else actual[:, 1]
    )
    return {"v": v, "i": i, "w": actual[:, 0], "theta": theta}


def _electrical(file: MotorFile, recording: Recording) -> tuple[Array, Array, Array]:
    m, x, t = file.motor, _channels(file, recording), recording.time_s
    e = _windows(recording, m.R_a0 * m.J / m.ke**2 / 4)
    rows = [
        _integral(t, (1 + m.alpha * x["theta"]) * x["i"], e), np.diff(x["i"][e]), _integral(t, x["w"], e),
    ]  # fmt: skip
    return np.column_stack(rows), _integral(t, x["v"], e), np.zeros((len(e) - 1, 0))


def _mechanical(file: MotorFile, recording: Recording) -> tuple[Array, Array, Array]:
    m, x, t = file.motor, _channels(file, recording), recording.time_s
    e = _windows(recording, m.R_a0 * m.J / m.ke**2 / 4)
    load = recording.channels.get("load_torque")
    torque = _integral(t, m.ke * x["i"] - (0.0 if load is None else load), e)
    nuisance = np.zeros((len(e) - 1, 0)) if load is not None else _integral(t, np.ones_like(t), e)[:, None]
    resting = (np.abs(x["w"][e[:-1]]) < 1e-9) & (np.abs(x["w"][e[1:]]) < 1e-9)
    torque = np.where(resting, np.nan, torque)
    return np.column_stack([np.diff(x["w"][e]), _integral(t, x["w"], e)]), torque, nuisance


def _thermal(file: MotorFile, recording: Recording) -> tuple[Array, Array, Array]:
    m, x, t = file.motor, _channels(file, recording), recording.time_s
    e = _windows(recording, m.H / m.k0 / 200)
    theta = np.convolve(np.pad(x["theta"], 8, mode="edge"), np.ones(17) / 17, mode="valid")
    rows = [
        np.diff(theta[e]), _integral(t, theta, e), _integral(t, np.abs(x["w"]) * theta, e), -_integral(t, x["w"] ** 2, e),
    ]  # fmt: skip
    return (
        np.column_stack(rows),
        _integral(t, m.resistance(theta) * x["i"] ** 2, e),
        np.zeros((len(e) - 1, 0)),
    )
