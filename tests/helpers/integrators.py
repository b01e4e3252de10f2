"""A motor integrated by scipy: its own methods on numbers, none of the compiled code."""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from motorlens_physics.motor import Motor
from motorlens_physics.simulation import Inputs


def scipy_solution(motor: Motor, inputs: Inputs, start: Mapping[str, float]) -> dict[str, np.ndarray]:
    """States at each sample, from sample to sample by Radau; friction is smooth."""
    names = list(motor.states())
    x = np.array([{**motor.states(), **start}[name] for name in names])
    rows = [x]
    for k, (t0, t1) in enumerate(zip(inputs.time_s[:-1], inputs.time_s[1:], strict=True)):

        def at(values: np.ndarray, t: float, k: int = k, t0: float = t0, t1: float = t1) -> float:
            share = 0.0 if inputs.held else (t - t0) / (t1 - t0)
            return float(values[k] + share * (values[k + 1] - values[k]))

        def rates(t: float, y: np.ndarray, at: Any = at) -> list[float]:
            u = SimpleNamespace(
                v=at(inputs.voltage_V, t),
                load=at(inputs.load_torque_Nm, t),
                ambient=at(inputs.ambient_C, t),
                t=t,
            )
            rate = motor.rates(SimpleNamespace(**dict(zip(names, y, strict=True))), u)
            return [float(rate[name]) for name in names]

        solution = solve_ivp(rates, (t0, t1), x, method="Radau", rtol=1e-9, atol=1e-11)
        x = solution.y[:, -1]
        rows.append(x)
    return {name: np.array(rows)[:, j] for j, name in enumerate(names)}
