"""Flux that falls with the current."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.ops import sqrt
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class ArmatureReaction(Effect):
    """The armature's field saturates the pole tips: ke / (1 + r) in the place of ke, in back-EMF and torque alike.

    r = s i_n (|i| / i_n)^n, with n between 1 (a flux that falls in proportion to the current) and 2 (iron that begins to
    saturate); at the rated current i_n both are s i_n. Some 3 % there and 15 % at five times that. Both faces of ke are
    changed, so no energy is made: i times the voltage and w times the torque cancel.
    Fitzgerald, Kingsley and Umans (2003), Electric Machinery, 6th edition, ISBN 978-0-07-366009-7, section 7.3.

    >>> from types import SimpleNamespace as At
    >>> reaction, m, x = ArmatureReaction(s=0.05, n=1.0, i_r=1e-9), At(ke=0.6), At(i=-5.0, w=80.0)
    >>> round(reaction.voltage(m, x, None), 6), round(reaction.torque(m, x, None), 6)  # 0.6 80 0.2, 0.6 5 0.2
    (9.6, 0.6)
    >>> strong = ArmatureReaction(s=0.05, n=2.0, i_n=2.5, i_r=1e-9)
    >>> round(strong.voltage(m, x, None), 6)  # r = 0.05 2.5 2^2
    16.0
    """

    excited_by: ClassVar[tuple[str, ...]] = ("load_steps", "direct_on_line")

    s: float = param(
        0.0,
        "1/A",
        "share of the flux lost at rated current, over that current",
        bounds=(0.0, 1e3),
        prior=0.03,
        of="1/current",
        null=0.0,
    )
    n: float = param(1.4, "1", "exponent of the current", bounds=(1.0, 2.0), prior=1.4)
    i_n: float = param(
        5.0,
        "A",
        "current at which the exponent changes nothing",
        bounds=(1e-6, 1e4),
        prior=1.0,
        of="current",
        fixed=True,
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
        current = sqrt(x.i * x.i + self.i_r * self.i_r) / self.i_n
        reaction = self.s * self.i_n * (current**self.n - (self.i_r / self.i_n) ** self.n)
        return reaction / (1 + reaction)
