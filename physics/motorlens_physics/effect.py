"""What an effect is: one frozen dataclass in one file, entering the balances whose methods it defines.

An effect adds a term to the textbook motor. `voltage` adds to the electrical balance (V, L di/dt), `torque` to the
mechanical one (N m, J dw/dt), `heat` to the thermal one (W, H dtheta/dt); `rates` gives the time derivatives of states
the effect brings along. An effect may read the motor's parameters and all states, never another effect.

Signs: a term that opposes the current or the motion is negative, as it stands on the right-hand side.
"""

import importlib
import pkgutil
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any, ClassVar

from motorlens_physics.parameter import Parameter, parameters


@dataclass(frozen=True)
class State:
    """An extra state that an effect integrates. All states start at `initial` unless told otherwise."""

    unit: str
    description: str
    initial: float = 0.0


@dataclass(frozen=True)
class Effect:
    """Base of all effects; contributes nothing.

    In every method `m` is the motor (its textbook parameters), `x` the states (`x.i` A, `x.w` rad/s, `x.theta` K above
    ambient, and the states effects bring) and `u` the inputs (`u.v` V, `u.load` N m, `u.ambient` degC, `u.t` s).
    """

    states: ClassVar[Mapping[str, State]] = {}
    # Names of the scenarios of `motorlens simulate` that make the effect visible, the best first.
    excited_by: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def name(cls) -> str:
        """The name in the catalogue: that of the class in lower case with underscores."""
        return re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()

    @classmethod
    def parameters(cls) -> dict[str, Parameter]:
        """The parameters by name."""
        return parameters(cls)

    def voltage(self, m: Any, x: Any, u: Any) -> Any:
        """Added to v - R i - ke w, in V."""
        return 0.0

    def torque(self, m: Any, x: Any, u: Any) -> Any:
        """Added to ke i - b w - T_load, in N m."""
        return 0.0

    def heat(self, m: Any, x: Any, u: Any) -> Any:
        """Added to the losses minus the cooling of the winding, in W."""
        return 0.0

    def rates(self, m: Any, x: Any, u: Any) -> Mapping[str, Any]:
        """Time derivative of each state in `states`."""
        return {}

    def stiction(self, m: Any, x: Any, u: Any) -> Any:
        """Largest torque with which the effect holds a resting rotor, in N m; 0 if it has no part in holding it."""
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
