"""The variational equations, integrated along a trajectory together with it.

Perturbations s of a motor's states obey M ds/dt = A(t) s + g(t). Over each step they are integrated by Lobatto IIIC of
three stages (Hairer and Wanner, Solving Ordinary Differential Equations II, 2nd ed., 1996, table IV.5.10): order 4,
L-stable and stiffly accurate like the method of the trajectory, and with its stages where the trajectory is known, at the
begin, the middle and the end. That gives s1 = Phi s0 + Gamma_0 g(begin) + Gamma_m g(middle) + Gamma_1 g(end), whose matrices
cost the same for any number of columns. They are worked out by straight-line code over the non-zero entries of A, all
columns of a row side by side in one vector.

Like `loop` this is ordinary Python, copied below the line into generated modules.
"""

from typing import Any

from motorlens_physics.compile.rodas import jacobian_of
from motorlens_physics.compile.types import CURRENT, IMPOSED, SHORTED, SPEED
from motorlens_physics.symbols import System

Matrix = Any
LOBATTO = ((1 / 6, -1 / 3, 1 / 6), (1 / 6, 5 / 12, -1 / 12), (1 / 6, 2 / 3, 1 / 6))


def transfer_source(system: System) -> list[str]:
    """The lines of `transfer(p, h, flow, a, over)`: Phi, Gamma_0, Gamma_m and Gamma_1 of a step side by side, (n, 4 n).

    `a` (3, n, n) holds the Jacobians at begin, middle and end; flow is 0 where the current is imposed, whose equation is
    then di/dt = 0 whatever the inductance.
    """
    n = system.of_motor
    masses = system.masses[:n]
    lines = [f"{p} = p[{k}]" for k, p in enumerate(system.p) if p in set(masses)]
    lines += [f"m{r} = {mass}" for r, mass in enumerate(masses)]
    lines += [f"m{CURRENT} = m{CURRENT} + (1.0 - flow)"]
    entries = {at for at in jacobian_of(system) if max(at) < n}
    # Row i n + r is the r-th balance of stage i, column j n + c the c-th state at stage j.
    pattern = set()
    for j in range(3):
        lines += [f"b{j}_{r}_{c} = h * a[{j}, {r}, {c}]" for r, c in sorted(entries)]
        for i in range(3):
            for r, c in sorted(entries | {(r, r) for r in range(n)}):
                inside = f"{-LOBATTO[i][j]!r} * b{j}_{r}_{c}" if (r, c) in entries else ""
                mass = f"m{r}" if i == j and r == c else ""
                if inside or mass:
                    lines += [f"w{i * n + r}_{j * n + c} = " + " + ".join(filter(None, (mass, inside)))]
                    pattern.add((i * n + r, j * n + c))
    for i in range(3):
        for r in range(n):
            row = f"y{i * n + r}"
            lines += [f"{row} = np.zeros({4 * n})", f"{row}[{r}] = m{r}"]
            lines += [f"{row}[{(1 + j) * n + r}] = h * {LOBATTO[i][j]!r}" for j in range(3)]
    last = range(2 * n, 3 * n)
    for pivot in range(3 * n):
        lines += [f"i{pivot} = 1.0 / w{pivot}_{pivot}"]
        for r in range(pivot + 1, 3 * n):
            if (r, pivot) not in pattern:
                continue
            lines += [f"l{r}_{pivot} = w{r}_{pivot} * i{pivot}"]
            for c in range(pivot + 1, 3 * n):
                if (pivot, c) in pattern:
                    product = f"l{r}_{pivot} * w{pivot}_{c}"
                    lines += [
                        f"w{r}_{c} = " + (f"w{r}_{c} - {product}" if (r, c) in pattern else f"-{product}")
                    ]
                    pattern.add((r, c))
            lines += [f"y{r} = y{r} - l{r}_{pivot} * y{pivot}"]
    # The method is stiffly accurate: its result is its last stage, so nothing before that is solved for.
    for pivot in reversed(last):
        terms = "".join(f" - w{pivot}_{c} * y{c}" for c in last if c > pivot and (pivot, c) in pattern)
        lines += [f"y{pivot} = (y{pivot}{terms}) * i{pivot}", f"over[{pivot - 2 * n}, :] = y{pivot}"]
    return lines


# ---- compiled from here on ----
def withhold(row: int, a: Matrix, g: Matrix) -> None:
    """Nothing enters an equation, at the three instants: that of what is imposed or at rest."""
    for q in range(3):
        for c in range(a.shape[2]):
            a[q, row, c] = 0.0
        for j in range(g.shape[2]):
            g[q, row, j] = 0.0


def unmoved(row: int, over: Matrix) -> None:
    """No forcing of this equation moves anything."""
    n = over.shape[0]
    for r in range(n):
        for q in range(1, 4):
            over[r, q * n + row] = 0.0


def propagate(
    linear: Any, transfer: Any, x: Matrix, p: Matrix, t: float, u: Matrix, h: float, side: float, go: float, y: Matrix,
    z: Matrix, begin: float, end: float, to: Any,
) -> None:  # fmt: skip
    """Carry the sensitivities over one step, from the share `begin` of the sample to `end`."""
    S, T, a, g, over = to.S, to.T, to.a, to.g, to.over
    n, flow = S.shape[0], 1.0 - u[IMPOSED + CURRENT]
    linear(x, p, t, u, 0.0, side, to.slots, a[0], g[0])
    linear(z, p, t, u, 0.5 * h, side, to.slots, a[1], g[1])
    linear(y, p, t, u, h, side, to.slots, a[2], g[2])
    if flow == 0.0:
        withhold(CURRENT, a, g)
    if go == 0.0:
        withhold(SPEED, a, g)
    if u[SHORTED] != 0.0 and to.beside[0] >= 0:
        # No constant is added to a voltage of zero.
        for q in range(3):
            for r in range(n):
                g[q, r, to.beside[0]] = 0.0
    transfer(p, h, flow, a, over)
    if flow == 0.0:
        unmoved(CURRENT, over)
    if go == 0.0:
        unmoved(SPEED, over)
    if go == 0.0 and u[IMPOSED + SPEED] == 0.0:
        # What rests has no speed to be perturbed.
        for c in range(4 * n):
            over[SPEED, c] = 0.0
    columns, forced = S.shape[1], g.shape[2] - 1
    for r in range(n):
        for j in range(columns):
            T[r, j] = over[r, 0] * S[0, j]
        for c in range(1, n):
            phi = over[r, c]
            if phi != 0.0:
                for j in range(columns):
                    T[r, j] += phi * S[c, j]
        for c in range(n):
            first, middle, last = over[r, n + c], over[r, 2 * n + c], over[r, 3 * n + c]
            if first != 0.0 or middle != 0.0 or last != 0.0:
                for j in range(forced):
                    T[r, j] += first * g[0, c, j] + middle * g[1, c, j] + last * g[2, c, j]
        if to.matrices.size > 0:
            # Forcings of the three balances that run from one to zero over the sample, and from zero to one.
            for c in range(3):
                first = over[r, n + c] + 0.5 * over[r, 2 * n + c]
                last = over[r, 3 * n + c] + 0.5 * over[r, 2 * n + c]
                T[r, columns - 6 + c] += (1.0 - begin) * first + (1.0 - end) * last
                T[r, columns - 3 + c] += begin * first + end * last
    for r in range(n):
        for j in range(columns):
            S[r, j] = T[r, j]
