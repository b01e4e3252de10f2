"""The variational equations, integrated along a trajectory together with it.

Perturbations s of a motor's states obey M ds/dt = A(t) s + g(t). Over each step A and g are taken as the parabola through
their values at its begin, middle and end, and the same Rosenbrock method as for the trajectory turns that into matrices:
s1 = Phi s0 + Gamma_0 g(begin) + Gamma_m g(middle) + Gamma_1 g(end). They cost the same for any number of columns.

Like `loop` this is ordinary Python, copied below the line into generated modules.
"""

from typing import Any

from motorlens_physics.compile.loop import SPEED
from motorlens_physics.compile.rodas import ALPHA, GAMMA, GAMMAS, A, C

Matrix = Any


# ---- compiled from here on ----
def accumulate(begin: float, end: float, over: Matrix, total: Matrix) -> None:
    """Put a step behind those before it in its sample, for forcings that run linearly over the sample.

    total[0] (n, 3 n) holds Phi and the Gammas of the forcing at the sample's begin and end; total[1] is for working.
    """
    now, new, n = total[0], total[1], total.shape[1]
    for r in range(n):
        for c in range(3 * n):
            new[r, c] = 0.0
            for q in range(n):
                new[r, c] += over[r, q] * now[q, c]
        for c in range(n):
            first = over[r, n + c] + 0.5 * over[r, 2 * n + c]
            last = over[r, 3 * n + c] + 0.5 * over[r, 2 * n + c]
            new[r, n + c] += (1.0 - begin) * first + (1.0 - end) * last
            new[r, 2 * n + c] += begin * first + end * last
    for r in range(n):
        for c in range(3 * n):
            now[r, c] = new[r, c]


def transfer(h: float, m: Matrix, a: Matrix, k: Matrix, over: Matrix) -> None:
    """Phi, Gamma_0, Gamma_m and Gamma_1 of a step side by side, over (n, 4 n); a (5, n, n), k (7, n, 4 n) for working."""
    w, at, n = a[3], a[4], m.size
    for r in range(n):
        for c in range(n):
            w[r, c] = -a[0, r, c]
        w[r, r] += m[r] / (GAMMA * h)
    for q in range(n):
        for r in range(q + 1, n):
            w[r, q] /= w[q, q]
            for c in range(q + 1, n):
                w[r, c] -= w[r, q] * w[q, c]
    for s in range(6):
        alpha = ALPHA[s]
        first, last = (1.0 - alpha) * (1.0 - 2.0 * alpha), alpha * (2.0 * alpha - 1.0)
        middle = 1.0 - first - last
        for r in range(n):
            for c in range(n):
                at[r, c] = first * a[0, r, c] + middle * a[1, r, c] + last * a[2, r, c]
        stage, y = k[s], k[6]
        for r in range(n):
            for c in range(4 * n):
                y[r, c] = 1.0 if r == c else 0.0
                stage[r, c] = 0.0
            for q in range(s):
                for c in range(4 * n):
                    y[r, c] += A[s][q] * k[q, r, c]
                    stage[r, c] += C[s][q] / h * m[r] * k[q, r, c]
        for r in range(n):
            for q in range(n):
                for c in range(4 * n):
                    stage[r, c] += at[r, q] * y[q, c]
                stage[r, q] += GAMMAS[s] * (4.0 * a[1, r, q] - 3.0 * a[0, r, q] - a[2, r, q])
            stage[r, n + r] += first - 3.0 * GAMMAS[s]
            stage[r, 2 * n + r] += middle + 4.0 * GAMMAS[s]
            stage[r, 3 * n + r] += last - GAMMAS[s]
        for q in range(n):
            for r in range(q + 1, n):
                for c in range(4 * n):
                    stage[r, c] -= w[r, q] * stage[q, c]
        for q in range(n - 1, -1, -1):
            for c in range(4 * n):
                for r in range(q + 1, n):
                    stage[q, c] -= w[q, r] * stage[r, c]
                stage[q, c] /= w[q, q]
    # Stiffly accurate: the result is the last stage's argument and the last stage.
    for r in range(n):
        for c in range(4 * n):
            over[r, c] = k[6, r, c] + k[5, r, c]


def propagate(
    linear: Any, x: Matrix, p: Matrix, t: float, u: Matrix, h: float, side: float, go: float, y: Matrix, z: Matrix,
    begin: float, end: float, S: Matrix, work: Any,
) -> None:  # fmt: skip
    """Carry the sensitivities S (n, columns), and the matrices of the sample so far, over one step."""
    a, g, stages, over, slots, T, total, m = work
    n = m.size
    linear(x, p, t, u, 0.0, side, slots, a[0], g[0])
    linear(z, p, t, u, 0.5 * h, side, slots, a[1], g[1])
    linear(y, p, t, u, h, side, slots, a[2], g[2])
    if go == 0.0:
        for q in range(3):
            for c in range(n):
                a[q, SPEED, c] = 0.0
            for j in range(g.shape[2]):
                g[q, SPEED, j] = 0.0
    transfer(h, m, a, stages, over)
    if go == 0.0:
        # What rests has no speed to be perturbed.
        for c in range(4 * n):
            over[SPEED, c] = 0.0
    columns, forced = S.shape[1], g.shape[2] - 1
    for r in range(n):
        for j in range(columns):
            T[r, j] = 0.0
        for c in range(n):
            phi, first, middle, last = over[r, c], over[r, n + c], over[r, 2 * n + c], over[r, 3 * n + c]
            for j in range(columns):
                T[r, j] += phi * S[c, j]
            for j in range(forced):
                T[r, j] += first * g[0, c, j] + middle * g[1, c, j] + last * g[2, c, j]
    for r in range(n):
        for j in range(columns):
            S[r, j] = T[r, j]
    if total.size > 0:
        accumulate(begin, end, over, total)
