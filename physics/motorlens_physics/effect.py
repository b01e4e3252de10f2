"""What an effect is: one frozen dataclass in one file, entering the balances whose methods it defines.

An effect adds a term to the textbook motor. `voltage` adds to the electrical balance (V, L di/dt), `torque` to the
mechanical one (N m, J dw/dt), `heat` to the thermal one (W, H dtheta/dt), `inductance` to L (H); `rates` gives the time
derivatives of states the effect brings along. An effect may read the motor's parameters and all states, never another
effect; two effects may share a state (the shaft angle `phi`) if they give it the same rate.

Signs: a term that opposes the current or the motion is negative, as it stands on the right-hand side.

Exactly one parameter has a `null`: the switch. With it at null every term is exactly zero in every state, the effect's
own states included: they run along and act on nothing. So whether the effect is missing is one question, and the
derivative of the terms to the switch says how it would show.
"""

import importlib
import importlib.util
import pkgutil
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar, Self

from motorlens_physics.parameter import Parameter, Rated, parameters
from motorlens_runtime.errors import DataError


@dataclass(frozen=True)
class State:
    """An extra state that an effect integrates. All states start at `initial` unless told otherwise.

    Attributes:
        unit: as pint reads it.
        description: one phrase.
        initial: at the start of a recording.
        kind: "angle" of the shaft, which every effect that has one shares; "rise" of another part that warms with the
            winding; "" for anything else.
    """

    unit: str
    description: str
    initial: float = 0.0
    kind: str = ""


@dataclass(frozen=True)
class Effect:
    """Base of all effects; contributes nothing.

    In every method `m` is the motor (its textbook parameters), `x` the states (`x.i` A, `x.w` rad/s, `x.theta` K above
    ambient, and the states effects bring) and `u` the inputs (`u.v` V, `u.load` N m, `u.ambient` degC, `u.t` s).
    """

    states: ClassVar[Mapping[str, State]] = {}
    # Names of the scenarios of `motorlens simulate` that make the effect visible, the best first.
    excited_by: ClassVar[tuple[str, ...]] = ()
    # Whether `torque` is friction: `friction_heat` returns a share of its power to the winding.
    friction: ClassVar[bool] = False

    @classmethod
    def name(cls) -> str:
        """The name in the catalogue: that of the class in lower case with underscores."""
        return re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()

    @classmethod
    def parameters(cls) -> dict[str, Parameter]:
        """The parameters by name."""
        return parameters(cls)

    @classmethod
    def switch(cls) -> Parameter:
        """The parameter that switches the effect on: the one with a `null`."""
        (switch,) = (parameter for parameter in cls.parameters().values() if parameter.null is not None)
        return switch

    @classmethod
    def with_role(cls, role: str) -> str:
        """The name of the parameter that is the "phase" or the "count" of what goes with the shaft's angle; "" for none."""
        return next((name for name, parameter in cls.parameters().items() if parameter.role == role), "")

    @classmethod
    def turns(cls) -> bool:
        """Whether it goes with the shaft's angle."""
        return any(state.kind == "angle" for state in cls.states.values())

    @classmethod
    def holds(cls) -> bool:
        """Whether it is a torque that may hold a rotor at rest: stiction, or one that goes with the shaft's angle."""
        return cls.stiction is not Effect.stiction or (cls.turns() and cls.voltage is Effect.voltage)

    @classmethod
    def at_null(cls, rated: Rated) -> Self:
        """The effect switched off, its shape as it is typical for a motor of this rating plate."""
        switch = cls.switch()
        return cls(
            **{name: p.typical(rated) for name, p in cls.parameters().items()} | {switch.name: switch.null}
        )

    @classmethod
    def typical(cls, rated: Rated) -> Self:
        """The effect at its typical size for a motor of this rating plate."""
        return cls(**{name: p.typical(rated) for name, p in cls.parameters().items()})

    def voltage(self, m: Any, x: Any, u: Any) -> Any:
        """Added to v - R i - ke w, in V."""
        return 0.0

    def torque(self, m: Any, x: Any, u: Any) -> Any:
        """Added to ke i - b w - T_load, in N m."""
        return 0.0

    def heat(self, m: Any, x: Any, u: Any) -> Any:
        """Added to the losses minus the cooling of the winding, in W."""
        return 0.0

    def inductance(self, m: Any, x: Any, u: Any) -> Any:
        """Added to the inductance L that stands before di/dt, in H."""
        return 0.0

    def rates(self, m: Any, x: Any, u: Any) -> Mapping[str, Any]:
        """Time derivative of each state in `states`."""
        return {}

    def stiction(self, m: Any, x: Any, u: Any) -> Any:
        """Largest torque with which the effect holds a resting rotor from turning the way of x.w, in N m; 0 without any."""
        return 0.0


def catalogue() -> dict[str, type[Effect]]:
    """All effects of the package by name; the folder `effects/` is the catalogue."""
    from motorlens_physics import effects

    found: dict[str, type[Effect]] = {}
    for module in pkgutil.iter_modules(effects.__path__):
        found |= effects_in(importlib.import_module(f"{effects.__name__}.{module.name}"))
    return dict(sorted(found.items()))


def effects_in(module: ModuleType) -> dict[str, type[Effect]]:
    """The effects that a module defines, by name; a user's own file works like one of the package."""
    return {
        thing.name(): thing
        for thing in vars(module).values()
        if isinstance(thing, type) and issubclass(thing, Effect) and thing.__module__ == module.__name__
    }


def load_effects(path: Path | str) -> dict[str, type[Effect]]:
    """The effects in a user's own Python file, by name: what `--effects-from my_effects.py` reads.

    Raises:
        DataError: the file is not there, does not run, holds no effect, or one that is not of the shape of an effect.
    """
    path = Path(path)
    where = str(path)
    if not path.is_file():
        raise DataError(f"{where}: no such file; give the Python file that holds your effects")
    # A name of its own per file: dataclasses and pickling look the module up again.
    name = "motorlens_effects_from_" + re.sub(r"\W", "_", str(path.resolve()))
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise DataError(f"{where}: not a Python file; effects are written in a file that ends in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except SyntaxError as error:
        raise DataError(f"{where}, line {error.lineno}: not Python: {error.msg}") from None
    except Exception as error:
        raise DataError(f"{where}: does not run: {type(error).__name__}: {error}") from None
    found = effects_in(module)
    if not found:
        raise DataError(f"{where}: defines no effect; write a frozen dataclass derived from Effect")
    for own in found.values():
        _check_shape(own, where)
    taken = sorted(found.keys() & catalogue().keys())
    if taken:
        raise DataError(f"{where}: {taken[0]} is already in the catalogue; give your effect another name")
    return found


def _check_shape(effect: type[Effect], where: str) -> None:
    """Refuse an effect that would fail far from here, with the reason."""
    # A subclass of a frozen dataclass that forgot the decorator would silently have no parameters.
    if not (is_dataclass(effect) and "__dataclass_params__" in vars(effect)):
        raise DataError(
            f"{where}: {effect.__name__} is not a frozen dataclass; decorate it with @dataclass(frozen=True)"
        )
    switches = [name for name, parameter in effect.parameters().items() if parameter.null is not None]
    if len(switches) != 1:
        raise DataError(
            f"{where}: {effect.__name__} needs exactly one parameter with null=..., the value at which it vanishes; "
            f"it has {', '.join(switches) or 'none'}"
        )
    balances = ("voltage", "torque", "heat", "inductance")
    if all(getattr(effect, name) is getattr(Effect, name) for name in balances):
        raise DataError(f"{where}: {effect.__name__} enters no balance; define one of {', '.join(balances)}")
    angles = [name for name, state in effect.states.items() if state.kind == "angle" and name != "phi"]
    if angles:
        raise DataError(
            f"{where}: {effect.__name__} calls the shaft's angle {angles[0]}; all effects share it under the name phi"
        )
