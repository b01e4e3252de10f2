"""Heat of friction that reaches the winding."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class FrictionHeat(Effect):
    """A share of the power that friction takes from the shaft heats the winding: +s P_f, P_f = b w^2 + other friction.

    P_f includes the friction of all effects of the motor (`Motor.friction_power`); the rest of it heats the bearings or
    the air. Brushes rub on the commutator, whose heat is the winding's.
    IEC 60034-2-1:2014, Rotating electrical machines, losses and efficiency: friction loss of bearings and brushes.

    >>> from types import SimpleNamespace as At
    >>> from motorlens_physics.motor import Motor
    >>> round(FrictionHeat(s=0.3).heat(Motor(b=0.002), At(w=50.0), None), 6)  # 0.3 0.002 2500
    1.5
    """

    excited_by: ClassVar[tuple[str, ...]] = ("direct_on_line", "heat_soak")

    s: float = param(
        0.0, "1", "share of the friction that heats the winding", bounds=(0.0, 1.0), prior=0.3, null=0.0
    )

    def heat(self, m: Any, x: Any, u: Any) -> Any:
        return self.s * m.friction_power(x, u)
