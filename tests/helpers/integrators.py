"""A motor integrated by scipy: its own methods on numbers, none of the compiled code."""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from motorlens_physics.motor import Motor
from motorlens_physics.simulation import Inputs


def scipy_solution(motor: Motor, inputs: Inputs, start: Mapping[str, float]) -> dict[str, np.ndarray]:
    """States at each sample, from sample to sample by Radau; friction is smooth, and a known shaft angle no state."""
    turned = inputs.angle_rad is not None
    names = [name for name in motor.states() if not (turned and name == "phi")]
    x = np.array([{**motor.states(), **start}[name] for name in names])
    rows = [x]
    for k, (t0, t1) in enumerate(zip(inputs.time_s[:-1], inputs.time_s[1:], strict=True)):

        def between(values: np.ndarray, t: float, k: int = k, t0: float = t0, t1: float = t1) -> float:
            return float(values[k] + (t - t0) / (t1 - t0) * (values[k + 1] - values[k]))

        def at(values: np.ndarray, t: float, k: int = k, between: Any = between) -> float:
            return float(values[k]) if inputs.held else between(values, t)

        def rates(t: float, y: np.ndarray, at: Any = at, between: Any = between) -> list[float]:
            u = SimpleNamespace(
                v=at(inputs.voltage_V, t),
                load=at(inputs.load_torque_Nm, t),
                ambient=at(inputs.ambient_C, t),
                t=t,
            )
            known = {"phi": between(inputs.angle_rad, t)} if turned else {}
            rate = motor.rates(SimpleNamespace(**dict(zip(names, y, strict=True)), **known), u)
            return [float(rate[name]) for name in names]

        solution = solve_ivp(rates, (t0, t1), x, method="Radau", rtol=1e-9, atol=1e-11)
        x = solution.y[:, -1]
        rows.append(x)
    return {name: np.array(rows)[:, j] for j, name in enumerate(names)}
