"""A motor whose resistance and constant change while it runs, solved sample by sample in closed form."""

import tomllib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]

MOTOR = Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml"


def textbook() -> dict[str, float]:
    """The motor file's parameters."""
    table = tomllib.loads(MOTOR.read_text(encoding="utf-8"))["parameters"]
    return {name: float(entry["value"]) for name, entry in table.items()}


def drive(
    voltage: Array, load: Array, dt: float, resistance: Array | float = 1.0, flux: Array | float = 1.0
) -> tuple[Array, Array]:
    """Current (N,), A, and speed (N,), rad/s, with voltage and load held between samples.

    The textbook's two balances with all held over a sample are linear: x' = A x + u, solved by the matrix exponential. The
    winding warms by the heat of a first pass.

    Args:
        voltage: (N,) in V.
        load: (N,) torque in N m.
        dt: between samples, s.
        resistance: (N,) or a number, share of the cold armature's.
        flux: (N,) or a number, share of the motor constant.
    """
    p, n = textbook(), len(voltage)
    rise = np.zeros(n)
    for _ in range(2):
        r = p["R_a0"] * (1 + p["alpha"] * rise) * resistance
        k = np.broadcast_to(p["ke"] * flux, (n,))
        # The last two states are the inputs, which stay as they are.
        a = np.zeros((n, 4, 4))
        a[:, 0, 0], a[:, 0, 1], a[:, 0, 2] = -r / p["L"], -k / p["L"], 1 / p["L"]
        a[:, 1, 0], a[:, 1, 1], a[:, 1, 3] = k / p["J"], -p["b"] / p["J"], -1 / p["J"]
        over_a_sample = expm(a * dt)
        x = np.column_stack([np.zeros((n, 2)), voltage, load])
        for t in range(n - 1):
            x[t + 1, :2] = (over_a_sample[t] @ x[t])[:2]
        i, w = x[:, 0], x[:, 1]
        heat = r * i**2 + p["k_ir"] * w**2
        for t in range(n - 1):
            cooling = p["k0"] * (1 + p["kT"] * abs(w[t])) * rise[t]
            rise[t + 1] = rise[t] + dt * (heat[t] - cooling) / p["H"]
    return i, w
