"""Flux that falls with the current."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.ops import magnitude
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class ArmatureReaction(Effect):
    """The armature's field saturates the pole tips: ke / (1 + s |i|) in the place of ke, in back-EMF and torque alike.

    Some 3 % at rated current and 15 % at five times that. Both faces of ke are changed, so no energy is made: i times the
    voltage and w times the torque cancel.
    Fitzgerald, Kingsley and Umans (2003), Electric Machinery, 6th edition, ISBN 978-0-07-366009-7, section 7.3.

    >>> from types import SimpleNamespace as At
    >>> reaction, m, x = ArmatureReaction(s=0.05, i_r=1e-9), At(ke=0.6), At(i=-5.0, w=80.0)
    >>> round(reaction.voltage(m, x, None), 6), round(reaction.torque(m, x, None), 6)  # 0.6 80 0.2, 0.6 5 0.2
    (9.6, 0.6)
    """

    excited_by: ClassVar[tuple[str, ...]] = ("load_steps", "direct_on_line")

    s: float = param(
        0.0,
        "1/A",
        "inverse of the current that halves the flux",
        bounds=(0.0, 1e3),
        prior=0.03,
        of="1/current",
        null=0.0,
    )
    i_r: float = param(
        0.05,
        "A",
        "current within which |i| is rounded off",
        bounds=(1e-9, 10.0),
        prior=0.01,
        of="current",
        fixed=True,
    )

    def voltage(self, m: Any, x: Any, u: Any) -> Any:
        return m.ke * x.w * self._loss(x)

    def torque(self, m: Any, x: Any, u: Any) -> Any:
        return -m.ke * x.i * self._loss(x)

    def _loss(self, x: Any) -> Any:
        reaction = self.s * magnitude(x.i, self.i_r)
        return reaction / (1 + reaction)
