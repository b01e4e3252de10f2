"""From symbols to machine code: the step, the loop and the sensitivities of one motor's structure.

Parameters are arguments, so one structure is compiled once. What differs between structures is straight-line code, which
`native` compiles in a tenth of a second; what they share, the loops, numba compiles once and for all. Both keep the
machine code in a per-user cache folder, in files named after the content of the source.
"""

import hashlib
import importlib.util
import inspect
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import sympy as sp

from motorlens_physics.compile import loop, types, variational
from motorlens_physics.compile.native import native
from motorlens_physics.compile.rodas import jacobian_of, step_source
from motorlens_physics.symbols import INPUTS, LOAD, SIDE, System, named

_LINEAR = "linear(x, p, t, u, ahead, side, slots, a, g)"
_STIFFNESS = "stiffness(p, h, flow, a)"
_TRANSFER = "transfer(p, h, flow, a, left, right, over)"
_PROPAGATE = "propagate(linear, stiffness, transfer, x, p, t, u, h, side, go, y, z, begin, end, to)"
_SIGNATURES = {
    name: getattr(types, f"of_{name}")
    for name in ("step", "rest", "balance", "linear", "stiffness", "transfer", "propagate")
}
# The types are part of what is compiled: other types, another file.
_HEAD = (
    f"# {hashlib.sha256(inspect.getsource(types).encode()).hexdigest()}\n"
    "from motorlens_physics.compile.types import *\n"
)


@dataclass(frozen=True)
class Compiled:
    """Machine code of a motor's structure."""

    integrate: Callable[..., int]
    functions: tuple[Any, ...]

    def __call__(self, *arguments: Any) -> int:
        """Run `loop.integrate` with the functions of this structure."""
        return self.integrate(*self.functions, *arguments)


def compiled(system: System) -> Compiled:
    """The machine code of a system, from the cache if it is there."""
    own = native(source(system), _SIGNATURES, cache_folder())
    shared = _load(shared_source(loop, "of_integrate"))
    functions = [own[name] for name in _SIGNATURES]
    if system.forcings:
        functions[-1] = _load(shared_source(variational, "of_propagate")).propagate
    return Compiled(shared.integrate, tuple(functions))


def source(system: System) -> str:
    """The generated source of a system, with the arguments used in `loop` and `variational`.

    step: one step of length h from x; y the new state, e the estimate of its error, z the state in the middle. u is what
    acts at t, see `types`.
    rest: torque on a rotor at rest with the load's full share, that load, and stiction forwards and backwards; inputs at
        t + ahead.
    balance: right-hand sides of the electrical and the mechanical balance.
    linear: a (n, n + 1), the Jacobian of the motor's own balances and what each has of a unit more, and forcings
        g (n, columns), the k-th going to column slots[k].
    stiffness, transfer: see `variational`.
    propagate: nothing, in the place of `variational`.
    """
    forced = bool(system.forcings)
    functions = [
        _balances(system),
        _linearised(system),
        _function("step(x, p, t, u, h, side, go, y, e, z)", step_source(system)),
        _rest(system),
        _balance(system),
        _linear(system) if forced else _function(_LINEAR, ["pass"]),
        _function(_STIFFNESS, variational.stiffness_source(system) if forced else ["return 0.0"]),
        _function(_TRANSFER, variational.transfer_source(system) if forced else ["pass"]),
        # Without forcings there is nothing to propagate; with them, it is the same for all structures.
        _function(_PROPAGATE, ["pass"]),
    ]
    return "\n\n\n".join(functions) + "\n"


def shared_source(module: ModuleType, signature: str) -> str:
    """The source of what all structures share: a module's functions below the line, the last with this signature."""
    below = inspect.getsource(module).partition("# ---- compiled from here on ----\n")[2]
    *inner, outer = ["def " + part.rstrip() for part in ("\n" + below).split("\ndef ")[1:]]
    decorated = [
        *(f"@njit(**options)\n{text}\n" for text in inner),
        f"@njit({signature}, **options)\n{outer}\n",
    ]
    return "\n\n".join([_HEAD, *_constants(), *decorated])


def _constants() -> list[str]:
    return [
        f"SHRINK, GROW, SAFETY, OPENING = {loop.SHRINK}, {loop.GROW}, {loop.SAFETY}, {loop.OPENING}",
        f"LOCATED, INDUCTANCE = {loop.LOCATED}, {loop.INDUCTANCE}",
        f"RESOLVED, HALVINGS, DECAYED = {variational.RESOLVED}, {variational.HALVINGS}, {variational.DECAYED}",
    ]


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


def _linearised(system: System) -> str:
    """Right-hand side, its Jacobian and its derivative with respect to time."""
    slopes = [sp.Symbol(f"d_{name}", real=True) for name in INPUTS]
    names = {f"f{j}": f for j, f in enumerate(system.balances)}
    names |= {f"a{r}_{c}": entry for (r, c), entry in jacobian_of(system).items()}
    inputs = [named(f"u_{name}") for name in INPUTS]
    for j, f in enumerate(system.balances):
        along = sum(
            (sp.diff(f, u) * slope for u, slope in zip(inputs, slopes, strict=True)), sp.diff(f, named("u_t"))
        )
        names[f"ft{j}"] = along
    head = f"linearised({_arguments(system)}, {', '.join(map(str, slopes))})"
    return _function(head, [*_assigned(names, system), f"return {', '.join(names)},"])


def _rest(system: System) -> str:
    speed = named("x_w")
    torque = system.balances[system.states.index("w")]
    outputs = {
        "torque": torque.subs({speed: sp.Integer(0), SIDE: sp.Integer(0)}),
        "forwards": system.stiction.subs({speed: sp.Integer(0), SIDE: sp.Integer(1)}),
        "backwards": system.stiction.subs({speed: sp.Integer(0), SIDE: sp.Integer(-1)}),
    }
    lines = [*_at(system), *_assigned(outputs, system), f"return torque, {LOAD}, forwards, backwards"]
    return _function("rest(x, p, t, u, ahead)", lines)


def _linear(system: System) -> str:
    """Jacobian of the motor's own balances at a point of the trajectory, what each has of a unit more, and forcings."""
    n = system.of_motor
    outputs = {f"a[{r}, {c}]": entry for (r, c), entry in jacobian_of(system).items() if max(r, c) < n}
    outputs |= {f"a[{r}, {n}]": system.per_volt if r == types.CURRENT else sp.Integer(1) for r in range(3)}
    for k, forcing in enumerate(system.forcings.values()):
        outputs |= {f"g[{r}, slots[{k}]]": entry for r, entry in enumerate(forcing) if entry != 0}
    lines = [*_at(system), *_assigned(outputs, system)]
    return _function(_LINEAR, lines)


def _balance(system: System) -> str:
    outputs = {"electrical": system.balances[types.CURRENT], "mechanical": system.balances[types.SPEED]}
    lines = [*_at(system), *_assigned(outputs, system), "return electrical, mechanical"]
    return _function("balance(x, p, t, u, ahead, side)", lines)


def _at(system: System) -> list[str]:
    """Lines that give names to states and inputs."""
    lines = [f"{x} = x[{j}]" for j, x in enumerate(system.x)]
    lines += [f"u_{name} = u[{j}] + u[{types.SLOPES + j}] * ahead" for j, name in enumerate(INPUTS)]
    return [*lines, "u_t = t + ahead"]


@cache
def _load(text: str) -> ModuleType:
    """Import generated source from the cache folder, writing it there first if it is new."""
    name = "motorlens_" + hashlib.sha256(text.encode()).hexdigest()[:24]
    path = cache_folder() / f"{name}.py"
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
def cache_folder() -> Path:
    """The cache folder: $XDG_CACHE_HOME/motorlens, or a temporary one where that cannot be written."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "motorlens"
    try:
        base.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=base):
            return base
    except OSError:
        return Path(tempfile.mkdtemp(prefix="motorlens-"))
