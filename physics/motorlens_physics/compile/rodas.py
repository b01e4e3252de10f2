"""The Rosenbrock step of a motor, written out as Python source.

RODAS of Hairer and Wanner (Solving Ordinary Differential Equations II, 2nd ed., 1996, section IV.10 and its code RODAS,
METHOD=1): six stages, order 4 with an estimate of order 3, L-stable and stiffly accurate, so that R dt/L may be anything
and L may be zero. The linear systems are solved by an elimination written out over the non-zero entries.
"""

from typing import Any

import sympy as sp

from motorlens_physics.symbols import System

GAMMA = 0.25
ALPHA = (0.0, 0.386, 0.21, 0.63, 1.0, 1.0)
GAMMAS = (0.25, -0.1043, 0.1035, -0.03620000000000023, 0.0, 0.0)
A = (
    (),
    (1.544,),
    (0.9466785280815826, 0.2557011698983284),
    (3.314825187068521, 2.896124015972201, 0.9986419139977817),
    (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950),
    (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 1.0),
)
C = (
    (),
    (-5.6688,),
    (-2.430093356833875, -0.2063599157091915),
    (-0.1073529058151375, -9.594562251023355, -20.47028614809616),
    (7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160),
    (8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054),
)
# The state in the middle of the step, from the stages (dense output at one half): y0/2 + y1/2 + sum of D_j k_j.
D2 = (10.12623508344586, -7.487995877610167, -34.80091861555747, -7.992771707568823, 1.025137723295662)
D3 = (-0.6762803392801253, 6.087714651680015, 16.43084320892478, 24.76722511418386, -6.594389125716872)


def jacobian_of(system: System) -> dict[tuple[int, int], Any]:
    """The non-zero entries of the Jacobian of the balances, by row and column."""
    entries = {
        (r, c): sp.diff(f, x)
        for r, f in enumerate(system.balances)
        for c, x in enumerate(system.x)
        if f.has(x)
    }
    return {at: entry for at, entry in entries.items() if entry != 0}


def step_source(system: System) -> list[str]:
    """The lines of `step(x, p, t, u, h, side, go, y, e, z)`, see `loop`."""
    n = len(system.states)
    jacobian = jacobian_of(system)
    current, speed = system.states.index("i"), system.states.index("w")
    x = [str(symbol) for symbol in system.x]
    lines = [f"{name} = x[{j}]" for j, name in enumerate(x)]
    lines += [f"{p} = p[{k}]" for k, p in enumerate(system.p) if p in set(system.masses)]
    lines += [
        "v, load, ambient, angle, dv, dload, dambient, dangle, di, dw, imposed, turned, shorted = u",
        "flow = 1.0 - imposed",
    ]
    names = [*(f"f{j}" for j in range(n)), *(f"a{r}_{c}" for r, c in jacobian), *(f"ft{j}" for j in range(n))]
    given = "v, load, ambient, angle, t, side, p, dv, dload, dambient, dangle"
    lines += [f"{', '.join(names)} = linearised({', '.join(x)}, {given})"]
    lines += ["r = 1.0 / h"]
    lines += [f"m{j} = {mass} * r" if mass != 1 else f"m{j} = r" for j, mass in enumerate(system.masses)]
    # The row of a resting rotor, or of what is imposed, is emptied: it keeps its state, or follows the slope it is given. An
    # imposed current needs no inductance.
    lines += [f"m{current} = m{current} + imposed * r"]
    lines += [f"rate{current} = m{current} * h * imposed * di", f"rate{speed} = m{speed} * h * turned * dw"]
    emptied = {current: "flow", speed: "go"}
    lines += [f"a{r}_{c} *= {emptied[r]}" for r, c in jacobian if r in emptied]
    lines += [f"ft{r} *= {factor}" for r, factor in emptied.items()]
    follow = [f"f{r} = {factor} * f{r} + rate{r}" for r, factor in emptied.items()]
    lines += follow
    filled, elimination = _elimination(n, jacobian)
    lines += elimination
    for s in range(6):
        if s > 0:
            stage = [" + ".join([x[j], *(f"{a!r} * k{q}_{j}" for q, a in enumerate(A[s]))]) for j in range(n)]
            ahead = f"{ALPHA[s]!r} * h"
            inputs = ", ".join(f"{u} + {ahead} * d{u}" for u in ("v", "load", "ambient", "angle"))
            if s < 5:
                lines += [f"y{j} = {stage[j]}" for j in range(n)]
            else:
                lines += [f"y{j} = y{j} + k4_{j}" for j in range(n)]
            right = "".join(f"f{j}, " for j in range(n))
            states = ", ".join(f"y{j}" for j in range(n))
            lines += [f"{right} = balances({states}, {inputs}, t + {ahead}, side, p)"]
            lines += follow
        for j in range(n):
            history = " + ".join(f"{c!r} * k{q}_{j}" for q, c in enumerate(C[s]))
            terms = [f"f{j}"]
            terms += [f"m{j} * ({history})"] if history else []
            terms += [f"{GAMMAS[s]!r} * h * ft{j}"] if GAMMAS[s] else []
            lines += [f"k{s}_{j} = {' + '.join(terms)}"]
        lines += _substitution(n, filled, f"k{s}_")
    for j in range(n):
        dense = [
            f"{0.25 * (d2 + 0.5 * d3)!r} * k{q}_{j}" for q, (d2, d3) in enumerate(zip(D2, D3, strict=True))
        ]
        lines += [f"y[{j}] = y{j} + k5_{j}", f"e[{j}] = k5_{j}"]
        lines += [f"z[{j}] = 0.5 * ({x[j]} + y{j} + k5_{j}) + {' + '.join(dense)}"]
    return lines


def _elimination(
    n: int, jacobian: dict[tuple[int, int], Any]
) -> tuple[list[tuple[int, list[int], list[int]]], list[str]]:
    """Gaussian elimination of M/(gamma h) - A over its non-zero entries: for each pivot its rows and columns; the code."""
    pattern = set(jacobian) | {(j, j) for j in range(n)}
    lines = [f"w{r}_{c} = -a{r}_{c}" for r, c in jacobian if r != c]
    for j in range(n):
        lines += [f"w{j}_{j} = {1 / GAMMA!r} * m{j}" + (f" - a{j}_{j}" if (j, j) in jacobian else "")]
    left, filled = set(range(n)), []
    while left:
        # Markowitz: the pivot that fills least. The diagonal dominates for small steps, so no other pivots are needed.
        costs = {
            j: sum((r, j) in pattern for r in left - {j}) * sum((j, c) in pattern for c in left - {j})
            for j in sorted(left)
        }
        pivot = min(costs, key=costs.__getitem__)
        left -= {pivot}
        rows = sorted(r for r in left if (r, pivot) in pattern)
        columns = sorted(c for c in left if (pivot, c) in pattern)
        lines += [f"i{pivot} = 1.0 / w{pivot}_{pivot}"]
        for r in rows:
            lines += [f"l{r}_{pivot} = w{r}_{pivot} * i{pivot}"]
            for c in columns:
                product = f"l{r}_{pivot} * w{pivot}_{c}"
                lines += [f"w{r}_{c} = " + (f"w{r}_{c} - {product}" if (r, c) in pattern else f"-{product}")]
                pattern |= {(r, c)}
        filled.append((pivot, rows, columns))
    return filled, lines


def _substitution(n: int, filled: list[tuple[int, list[int], list[int]]], k: str) -> list[str]:
    lines = [f"{k}{r} -= l{r}_{pivot} * {k}{pivot}" for pivot, rows, _ in filled for r in rows]
    for pivot, _, columns in reversed(filled):
        terms = "".join(f" - w{pivot}_{c} * {k}{c}" for c in columns)
        lines += [f"{k}{pivot} = ({k}{pivot}{terms}) * i{pivot}"]
    return lines
