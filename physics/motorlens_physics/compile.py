"""From symbols to machine code: a Rosenbrock step with analytic Jacobian, written out for one motor's structure.

The step is RODAS of Hairer and Wanner (Solving Ordinary Differential Equations II, 2nd ed., 1996, section IV.10 and its
code RODAS, METHOD=1): six stages, order 4 with an estimate of order 3, L-stable and stiffly accurate, so that R dt/L may
be anything and L may be zero. The linear systems are solved by an elimination written out over the non-zero entries.

Parameters are arguments, so one structure is compiled once. The generated source lies in a per-user cache folder, named
after its content; numba keeps the machine code beside it, so other runs and processes find both.
"""

import hashlib
import importlib.util
import inspect
import os
import sys
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import sympy as sp

from motorlens_physics import compile_loop
from motorlens_physics.symbols import INPUTS, LOAD, SIDE, System, named

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

_JIT = "@njit(cache=True, nogil=True, error_model='numpy', fastmath={'contract'})\n"


def compiled(system: System) -> ModuleType:
    """The module with the function `integrate` for this system (see `compile_loop`), from the cache if it is there."""
    return _load(source(system))


def source(system: System) -> str:
    """The generated source of a system's module."""
    loop = inspect.getsource(compile_loop).partition("# ---- compiled from here on ----\n")[2]
    functions = [part.rstrip() + "\n" for part in ("\n" + loop).split("\ndef ")[1:]]
    # Called functions first: numba compiles a function when its caller is compiled.
    functions.sort(key=lambda text: text.startswith("integrate("))
    constants = f"SHRINK, GROW, SAFETY = {compile_loop.SHRINK}, {compile_loop.GROW}, {compile_loop.SAFETY}\n"
    pieces = [
        "import math\n\nimport numpy as np\nfrom numba import njit\n\nVector = object",
        constants + f"LOCATED, INDUCTANCE = {compile_loop.LOCATED}, {compile_loop.INDUCTANCE}",
        *(_JIT + text for text in (_balances(system), _linearised(system), _step(system), _rest(system))),
        *(_JIT + text for text in _variational(system)),
        *(_JIT + "def " + text for text in functions),
    ]
    return "\n\n".join(pieces)


def _arguments(system: System) -> str:
    return ", ".join([*(str(x) for x in system.x), *(f"u_{name}" for name in INPUTS), "u_t", "side", "p"])


def _assigned(outputs: dict[str, Any], system: System) -> list[str]:
    """Lines that assign expressions to names, common subexpressions first."""
    printer = _printer()
    used = set().union(*(sp.sympify(e).free_symbols for e in outputs.values()), set())
    lines = [f"{p} = p[{k}]" for k, p in enumerate(system.p) if p in used]
    shared, reduced = sp.cse(list(outputs.values()), symbols=sp.numbered_symbols("c"), order="none")
    lines += [f"{name} = {printer.doprint(expression)}" for name, expression in shared]
    return lines + [f"{name} = {printer.doprint(e)}" for name, e in zip(outputs, reduced, strict=True)]


def _printer() -> Any:
    from sympy.printing.pycode import PythonCodePrinter

    class Printer(PythonCodePrinter):  # type: ignore[misc]
        def _print_sign(self, e: Any) -> str:
            return f"np.sign({self._print(e.args[0])})"

    return Printer({"fully_qualified_modules": True})


def _function(head: str, lines: Sequence[str]) -> str:
    return f"def {head}:\n" + "\n".join("    " + line for line in lines)


def _balances(system: System) -> str:
    names = {f"f{j}": f for j, f in enumerate(system.balances)}
    return _function(
        f"balances({_arguments(system)})", [*_assigned(names, system), f"return {', '.join(names)},"]
    )


def _jacobian(system: System) -> dict[tuple[int, int], Any]:
    entries = {
        (r, c): sp.diff(f, x)
        for r, f in enumerate(system.balances)
        for c, x in enumerate(system.x)
        if f.has(x)
    }
    return {at: entry for at, entry in entries.items() if entry != 0}


def _linearised(system: System) -> str:
    """Right-hand side, its Jacobian and its derivative with respect to time."""
    slopes = [sp.Symbol(f"d_{name}", real=True) for name in INPUTS]
    names = {f"f{j}": f for j, f in enumerate(system.balances)}
    names |= {f"a{r}_{c}": entry for (r, c), entry in _jacobian(system).items()}
    inputs = [named(f"u_{name}") for name in INPUTS]
    for j, f in enumerate(system.balances):
        along = sum(
            (sp.diff(f, u) * slope for u, slope in zip(inputs, slopes, strict=True)), sp.diff(f, named("u_t"))
        )
        names[f"ft{j}"] = along
    head = f"linearised({_arguments(system)}, {', '.join(map(str, slopes))})"
    return _function(head, [*_assigned(names, system), f"return {', '.join(names)},"])


def _step(system: System) -> str:
    n = len(system.states)
    jacobian = _jacobian(system)
    speed = system.states.index("w")
    x = [str(symbol) for symbol in system.x]
    lines = [f"{name} = x[{j}]" for j, name in enumerate(x)]
    lines += [f"{p} = p[{k}]" for k, p in enumerate(system.p) if p in set(system.masses)]
    lines += ["v, load, ambient, dv, dload, dambient = u"]
    names = [*(f"f{j}" for j in range(n)), *(f"a{r}_{c}" for r, c in jacobian), *(f"ft{j}" for j in range(n))]
    lines += [
        f"{', '.join(names)} = linearised({', '.join(x)}, v, load, ambient, t, side, p, dv, dload, dambient)"
    ]
    # A resting rotor's row is emptied, so that its speed stays as it is.
    lines += [f"a{r}_{c} *= go" for r, c in jacobian if r == speed]
    lines += [f"f{speed} *= go", f"ft{speed} *= go", "r = 1.0 / h"]
    lines += [f"m{j} = {mass} * r" if mass != 1 else f"m{j} = r" for j, mass in enumerate(system.masses)]
    filled, elimination = _elimination(n, jacobian)
    lines += elimination
    for s in range(6):
        if s > 0:
            stage = [" + ".join([x[j], *(f"{a!r} * k{q}_{j}" for q, a in enumerate(A[s]))]) for j in range(n)]
            ahead = f"{ALPHA[s]!r} * h"
            inputs = f"v + {ahead} * dv, load + {ahead} * dload, ambient + {ahead} * dambient, t + {ahead}"
            if s < 5:
                lines += [f"y{j} = {stage[j]}" for j in range(n)]
            else:
                lines += [f"y{j} = y{j} + k4_{j}" for j in range(n)]
            right = "".join(f"f{j}, " for j in range(n))
            states = ", ".join(f"y{j}" for j in range(n))
            lines += [f"{right} = balances({states}, {inputs}, side, p)"]
            lines += [f"f{speed} *= go"]
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
    return _function("step(x, p, t, u, h, side, go, y, e, z)", lines)


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


def _rest(system: System) -> str:
    at_rest = {named("x_w"): sp.Integer(0), SIDE: sp.Integer(0)}
    torque = system.balances[system.states.index("w")].subs(at_rest)
    lines = [f"{x} = x[{j}]" for j, x in enumerate(system.x)]
    lines += [f"u_{name} = u[{j}] + u[{3 + j}] * ahead" for j, name in enumerate(INPUTS)]
    lines += [
        "u_t = t + ahead",
        *_assigned({"torque": torque, "stiction": system.stiction.subs(at_rest)}, system),
    ]
    return _function("rest(x, p, t, u, ahead)", [*lines, f"return torque, {LOAD}, stiction"])


def _variational(system: System) -> list[str]:
    """The functions that carry sensitivities along; without forcings they do nothing."""
    return [
        _function("propagate(x, p, t, u, h, side, go, y, z, S, work)", ["pass"]),
        _function("turn(y, p, t, u, h, side, then, S)", ["pass"]),
        _function("keep(k, S, work, kept, matrices)", ["pass"]),
    ]


@cache
def _load(text: str) -> ModuleType:
    """Import generated source from the cache folder, writing it there first if it is new."""
    name = "motorlens_" + hashlib.sha256(text.encode()).hexdigest()[:24]
    path = _folder() / f"{name}.py"
    if not path.exists():
        # Written aside and moved into place: another process never reads half a file.
        handle, aside = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        os.replace(aside, path)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@cache
def _folder() -> Path:
    """The cache folder: $XDG_CACHE_HOME/motorlens, or a temporary one where that cannot be written."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "motorlens"
    try:
        base.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=base):
            return base
    except OSError:
        return Path(tempfile.mkdtemp(prefix="motorlens-"))
