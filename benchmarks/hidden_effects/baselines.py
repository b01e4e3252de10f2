"""What a user would try instead of `motorlens diagnose`: PySINDy, plain and in weak form, and a test of whiteness.

Each gets the terms that the textbook holds and, beside them, the catalogue's terms by name, all scaled to unit deviation,
and the threshold that predicts the last quarter best. What is left beyond the textbook is the answer. They see the same
files; sensor faults and channels that are absent are beyond them, and where the speed is not measured they have no answer.
"""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
THRESHOLDS = (0.003, 0.01, 0.03, 0.1)
STATES = (("current", "electrical"), ("speed", "mechanical"), ("temperature", "thermal"))
HEADINGS = {
    "voltage": "voltage_V",
    "current": "current_A",
    "speed": "speed_rad_s",
    "temperature": "temperature_C",
    "load": "load_torque_Nm",
    "angle": "angle_rad",
}


def read(paths: list[Path]) -> dict[str, Array] | None:
    """The columns of the fast record (of the slow one, if that is all), on an even grid; None without speed."""
    path = sorted(paths)[0]
    with path.open(encoding="utf-8") as file:
        names = file.readline().strip().split(",")
        table = np.loadtxt(file, delimiter=",")
    columns = dict(zip(names, table.T, strict=True))
    if HEADINGS["speed"] not in columns:
        return None
    t = columns["time_s"]
    grid = np.linspace(t[0], t[-1], min(len(t), 20_000))
    return {"t": grid} | {
        key: np.interp(grid, t, columns[heading]) for key, heading in HEADINGS.items() if heading in columns
    }


def terms(d: dict[str, Array], rated_speed: float) -> tuple[dict[str, Array], dict[str, dict[str, Array]]]:
    """Textbook terms of all equations, and the catalogue's by the effect they stand for."""
    i, w, v = d["current"], d["speed"], d["voltage"]
    theta = d["temperature"] - 20 if "temperature" in d else np.zeros_like(i)
    load = d.get("load", np.zeros_like(i))
    turn = np.sign(w)
    base = {"v": v, "i": i, "w": w, "theta i": theta * i, "load": load, "i2": i**2, "theta i2": theta * i**2, "w2": w**2,
            "theta": theta, "|w| theta": np.abs(w) * theta}  # fmt: skip
    extra: dict[str, dict[str, Array]] = {
        "electrical": {
            "brush_voltage_drop": np.sign(i), "contact_resistance": np.abs(w) * i, "inductance_saturation": i**2 * v,
            "armature_reaction": i**2 * w, "magnet_temperature": theta * w,
        },
        "mechanical": {
            "coulomb_friction": turn, "stribeck_friction": np.exp(-((w / (0.03 * rated_speed)) ** 2)) * turn,
            "quadratic_drag": w * np.abs(w), "load_dependent_friction": np.abs(i) * turn,
            "directional_friction": (w > 0).astype(float), "temperature_dependent_viscosity": theta * w,
            "constant_torque": np.ones_like(w), "stray_load_loss": i**2 * w, "armature_reaction": i**3,
        },
        "thermal": {
            "radiation": theta**2, "hysteresis_iron_loss": np.abs(w), "fan_cooling_exponent": np.abs(w) ** 0.7 * theta,
        },
    }  # fmt: skip
    if "angle" in d:
        extra["mechanical"] |= {
            "cogging_torque": np.sin(12 * d["angle"]),
            "unbalance_torque": np.sin(d["angle"]),
        }
    return base, extra


def sindy(paths: list[Path], rated_speed: float, weak: bool) -> dict[str, Any] | None:
    """PySINDy's answer: the terms it keeps beyond the textbook, the strongest first."""
    import pysindy

    d = read(paths)
    if d is None:
        return None
    base, extra = terms(d, rated_speed)
    found: list[tuple[float, str, str]] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for channel, equation in STATES:
            if channel not in d:
                continue
            columns = {f"base {key}": value for key, value in base.items()} | extra[equation]
            columns = {
                key: value
                for key, value in columns.items()
                if value[: len(value) // 2].std() > 0 or key == "constant_torque"
            }
            x = d[channel] / (d[channel].std() + 1e-30)
            u = np.column_stack([value / (value.std() or 1.0) for value in columns.values()])
            kept = _best(pysindy, d["t"], x, u, weak)
            for name, size in zip(columns, kept, strict=True):
                if size != 0 and not name.startswith("base "):
                    found.append((float(abs(size)), name, equation))
    found.sort(reverse=True)
    chosen = [name for _, name, _ in found]
    verdict = "named" if chosen else "adequate"
    return {"verdict": verdict, "chosen": chosen[:1], "groups": [chosen[:6]], "equation": found[0][2] if found else None,
            "candidates": [{"name": name} for name in chosen]}  # fmt: skip


def _best(pysindy: Any, t: Array, x: Array, u: Array, weak: bool) -> Array:
    """Coefficients at the threshold that predicts the smoothed derivative of the last quarter best."""
    n = 3 * len(t) // 4
    method = pysindy.SmoothedFiniteDifference(smoother_kws={"window_length": 11})
    slope = np.asarray(method(x[n:, None], t[n:])).ravel()
    results = []
    for threshold in THRESHOLDS:
        library = pysindy.PolynomialLibrary(degree=1, include_bias=False)
        if weak:
            library = pysindy.WeakPDELibrary(
                function_library=library, spatiotemporal_grid=t[:n], K=200, is_uniform=True
            )
        optimizer = pysindy.STLSQ(threshold=threshold, alpha=1e-6, normalize_columns=True)
        model = pysindy.SINDy(optimizer=optimizer, feature_library=library, differentiation_method=method)
        np.random.seed(0)  # noqa: NPY002 - PySINDy places its weak domains with the global generator
        try:
            model.fit(x[:n, None], t=t[:n], u=u[:n])
        except np.linalg.LinAlgError:
            continue
        coefficients = np.asarray(model.coefficients())[0]
        error = np.mean((np.column_stack([x[n:], u[n:]]) @ coefficients - slope) ** 2)
        results.append((float(error), coefficients))
    return min(results, key=lambda pair: pair[0])[1][1:] if results else np.zeros(u.shape[1])


def whiteness(paths: list[Path], rated_speed: float, lags: int = 25) -> dict[str, Any] | None:
    """Ljung and Box (1978) on the one-step residuals of the textbook's regressions, at 1 % over the equations."""
    from scipy.stats import chi2

    d = read(paths)
    if d is None:
        return None
    base, _ = terms(d, rated_speed)
    worst, equation = 1.0, None
    for channel, name in STATES:
        if channel not in d:
            continue
        y = d[channel]
        rows = np.column_stack([np.ones_like(y[:-1]), y[:-1], *(value[:-1] for value in base.values())])
        rows = rows / (np.abs(rows).max(axis=0) + 1e-30)
        e = y[1:] - rows @ np.linalg.lstsq(rows, y[1:], rcond=None)[0]
        n = len(e)
        r = np.array([e[:-k] @ e[k:] for k in range(1, lags + 1)]) / (e @ e)
        p = float(chi2.sf(n * (n + 2) * np.sum(r**2 / (n - np.arange(1, lags + 1))), lags))
        if p < worst:
            worst, equation = p, name
    found = worst < 0.01 / 3
    return {
        "verdict": "unknown" if found else "adequate",
        "chosen": [],
        "groups": [],
        "equation": equation,
        "candidates": [],
    }
