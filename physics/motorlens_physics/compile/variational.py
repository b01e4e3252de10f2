"""The variational equations, integrated along a trajectory together with it.

Perturbations s of a motor's states obey M ds/dt = A(t) s + g(t). Over each step they are integrated by Lobatto IIIC of
three stages (Hairer and Wanner, Solving Ordinary Differential Equations II, 2nd ed., 1996, table IV.5.10): order 4,
L-stable and stiffly accurate like the method of the trajectory, and with its stages where the trajectory is known, at the
begin, the middle and the end. That gives s1 = Phi s0 + Gamma_0 g(begin) + Gamma_m g(middle) + Gamma_1 g(end), whose matrices
cost the same for any number of columns. They are worked out by straight-line code over the non-zero entries of A, all
columns of a row side by side in one vector.

The trajectory's steps are as long as the trajectory allows. Where the motor is steady that may be many of its time
constants, but a perturbation of it decays within one. Such a step is gone in parts, the first within a time constant and
each next one as long as all before it, along Jacobians interpolated between those three instants; what a part ends with, the
next one begins with.

Like `loop` this is ordinary Python, copied below the line into generated modules.
"""

import math
import sys
from typing import Any

from motorlens_physics.compile.rodas import jacobian_of
from motorlens_physics.compile.types import CURRENT, IMPOSED, SHORTED, SPEED
from motorlens_physics.symbols import System

Matrix = Any
# Time constants in the first part of a step, or in all of it: an exponential is then off by at most 0.002 of where it began
# (`test_sensitivity.py`). And how often a step is halved at most: what is faster than its thousandth the method damps.
RESOLVED, HALVINGS = 1.0, 11
# An oscillation has decayed when as much as that is left of it, what one part may be off by. Until then each radian adds to
# the error: 0.004 of where it began if it decays within one turn, 0.02 if it rings (`test_sensitivity.py`).
DECAYED = 0.002
LOBATTO = ((1 / 6, -1 / 3, 1 / 6), (1 / 6, 5 / 12, -1 / 12), (1 / 6, 2 / 3, 1 / 6))


def transfer_source(system: System) -> list[str]:
    """The lines of `transfer(p, h, flow, a, left, right, over)`: from one share of a step of length h to another.

    Carried on is `over` (n, 4 n): Phi, Gamma_0, Gamma_m and Gamma_1 side by side, of what lies before. `a` (3, n, n + 1)
    holds the Jacobians at begin, middle and end of the whole step, and beside them what each balance has of a unit more (of
    a volt, L over the inductance as it is); flow is 0 where the current is imposed, whose equation is then di/dt = 0
    whatever the inductance.
    """
    n = system.of_motor
    lines = _masses(system)
    entries = {at for at in jacobian_of(system) if max(at) < n}
    # Weights of begin, middle and end in what lies between them, by a parabola.
    lines += ["span = h * (right - left)", "mid = 0.5 * (left + right)"]
    for j, share in enumerate(("left", "mid", "right")):
        lines += [f"first{j} = (2.0 * {share} - 1.0) * ({share} - 1.0)"]
        lines += [
            f"middle{j} = 4.0 * {share} * (1.0 - {share})",
            f"last{j} = {share} * (2.0 * {share} - 1.0)",
        ]
    # Row i n + r is the r-th balance of stage i, column j n + c the c-th state at stage j.
    pattern = set()
    for j in range(3):
        lines += [
            f"b{j}_{r}_{c} = span * (first{j} * a[0, {r}, {c}] + middle{j} * a[1, {r}, {c}] + last{j} * a[2, {r}, {c}])"
            for r, c in sorted(entries)
        ]
        for i in range(3):
            for r, c in sorted(entries | {(r, r) for r in range(n)}):
                inside = f"{-LOBATTO[i][j]!r} * b{j}_{r}_{c}" if (r, c) in entries else ""
                mass = f"m{r}" if i == j and r == c else ""
                if inside or mass:
                    lines += [f"w{i * n + r}_{j * n + c} = " + " + ".join(filter(None, (mass, inside)))]
                    pattern.add((i * n + r, j * n + c))
    width = 4 * n
    for q in range(3):
        # Where the forcings at an instant stand, of all balances and, below, those of a balance.
        lines += [f"at{q} = np.zeros({width})", *(f"at{q}[{(1 + q) * n + r}] = 1.0" for r in range(n))]
    for i in range(3):
        for q, of in enumerate(("first", "middle", "last")):
            lines += [f"d{q} = span * ({' + '.join(f'{LOBATTO[i][j]!r} * {of}{j}' for j in range(3))})"]
        lines += [f"forced{i} = d0 * at0 + d1 * at1 + d2 * at2"]
    for r in range(n):
        lines += [f"own = np.zeros({width})", *(f"own[{(1 + q) * n + r}] = 1.0" for q in range(3))]
        lines += [f"before = m{r} * over[{r}, 0:{width}]"]
        lines += [f"y{i * n + r} = before + forced{i} * own" for i in range(3)]
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


def stiffness_source(system: System) -> list[str]:
    """The lines of `stiffness(p, h, flow, a)`: the length of a step in time constants of its fastest state.

    Gershgorin's bound in the middle, of the Jacobian scaled to pairs of equal size. Arguments as of `transfer_source`.
    """
    n = system.of_motor
    entries = {at for at in jacobian_of(system) if max(at) < n}
    lines = _masses(system)
    bounds = [
        " + ".join(
            f"math.sqrt(abs(a[1, {r}, {c}] * a[1, {c}, {r}] / max(m{r} * m{c}, {sys.float_info.min})))"
            for c in range(n)
            if {(r, c), (c, r)} <= entries
        )
        for r in range(n)
    ]
    return [*lines, f"return h * max({', '.join(['0.0', *filter(None, bounds)])})"]


def _masses(system: System) -> list[str]:
    """Lines that name the masses; an imposed current needs no inductance."""
    masses = system.masses[: system.of_motor]
    lines = [f"{p} = p[{k}]" for k, p in enumerate(system.p) if p in set(masses)]
    lines += [f"m{r} = {mass}" for r, mass in enumerate(masses)]
    return [*lines, f"m{CURRENT} = m{CURRENT} + (1.0 - flow)"]


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


def hindered(u: Matrix, go: float, over: Matrix) -> None:
    """What is imposed, or rests, is moved by nothing."""
    if u[IMPOSED + CURRENT] != 0.0:
        unmoved(CURRENT, over)
    if go == 0.0:
        unmoved(SPEED, over)
    if go == 0.0 and u[IMPOSED + SPEED] == 0.0:
        # What rests has no speed to be perturbed.
        for c in range(over.shape[1]):
            over[SPEED, c] = 0.0
        for r in range(over.shape[0]):
            over[r, SPEED] = 0.0


def oscillating(over: Matrix, most: float) -> Any:
    """First parts, whose matrices are in `over`, in a radian of the fastest oscillation, and until all have decayed.

    A pair of states oscillates if the eigenvalues of its own part of Phi are complex: their angle, and their modulus. What
    turns by less than a radian in as many parts as there are at most is none.
    """
    n = over.shape[0]
    radian, until = most, 0.0
    for r in range(n):
        for c in range(r):
            mean = 0.5 * (over[r, r] + over[c, c])
            determinant = over[r, r] * over[c, c] - over[r, c] * over[c, r]
            if mean * mean < determinant < 1.0:
                one = 1.0 / math.acos(mean / math.sqrt(determinant))
                if one < most:
                    radian = min(radian, one)
                    until = max(until, 2.0 * math.log(DECAYED) / math.log(determinant))
    return radian, until


def in_parts(transfer: Any, p: Matrix, h: float, flow: float, long: float, a: Matrix, over: Matrix) -> None:
    """The matrices of a step that is so many time constants long, to `over`, through those of its parts."""
    first_part = 2.0 ** -math.ceil(min(math.log2(long / RESOLVED), HALVINGS))
    left, right, radian, until = 0.0, first_part, 1.0, 0.0
    while left < 1.0:
        transfer(p, h, flow, a, left, right, over)
        if left == 0.0:
            radian, until = oscillating(over, 1.0 / first_part)
        longest = first_part * max(radian, 1.0) if right < first_part * until else math.inf
        left, right = right, min(right + min(right, longest), 1.0)


def propagate(
    linear: Any, stiffness: Any, transfer: Any, x: Matrix, p: Matrix, t: float, u: Matrix, h: float, side: float, go: float,
    y: Matrix, z: Matrix, begin: float, end: float, to: Any,
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
    for r in range(n):
        for c in range(4 * n):
            over[r, c] = 1.0 if r == c else 0.0
    long = stiffness(p, h, flow, a)
    if long > RESOLVED:
        in_parts(transfer, p, h, flow, long, a, over)
    else:
        transfer(p, h, flow, a, 0.0, 1.0, over)
    hindered(u, go, over)
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
                middle = 0.5 * over[r, 2 * n + c] * a[1, c, n]
                first = over[r, n + c] * a[0, c, n] + middle
                last = over[r, 3 * n + c] * a[2, c, n] + middle
                T[r, columns - 6 + c] += (1.0 - begin) * first + (1.0 - end) * last
                T[r, columns - 3 + c] += begin * first + end * last
    for r in range(n):
        for j in range(columns):
            S[r, j] = T[r, j]
