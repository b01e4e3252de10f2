"""Contact resistance that grows with speed."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.ops import turning
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class ContactResistance(Effect):
    """Brushes lift as the commutator turns faster: -K_B |w| i, and K_B |w| i^2 of heat.

    A contact resistance that does not grow with speed is part of R_a0; resistance in rotation was measured up to a fifth
    above that at rest.
    Isermann (2011), Fault-Diagnosis Applications, ISBN 978-3-642-12766-3, chapter 3: the K_B of the DC motor.

    >>> from types import SimpleNamespace as At
    >>> contact, x = ContactResistance(K_B=0.002), At(i=3.0, w=-200.0)
    >>> round(contact.voltage(None, x, None), 4), round(contact.heat(None, x, None), 4)  # 0.002 200 3, 0.002 200 9
    (-1.2, 3.6)
    """

    excited_by: ClassVar[tuple[str, ...]] = ("load_steps", "duty")

    K_B: float = param(
        0.0,
        "ohm*s/rad",
        "contact resistance per speed",
        bounds=(0.0, 10.0),
        prior=0.01,
        of="voltage/current/speed",
        null=0.0,
    )

    def voltage(self, m: Any, x: Any, u: Any) -> Any:
        return -self.K_B * turning(x.w) * x.i

    def heat(self, m: Any, x: Any, u: Any) -> Any:
        return self.K_B * turning(x.w) * x.i**2
