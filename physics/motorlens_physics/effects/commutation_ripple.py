"""Ripple of the motor constant with the angle."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect, State
from motorlens_physics.ops import cos
from motorlens_physics.parameter import param, phase


@dataclass(frozen=True)
class CommutationRipple(Effect):
    """Segments of the commutator switch in turn: ke (1 + eps cos(N phi + p)) in the place of ke, in EMF and torque alike.

    Of an odd number n of segments the ripple is 1 - cos(pi / (2 n)) from peak to peak, 13 % for 3 and 1 % for 11, and
    there are 2 n of them a revolution.
    Kenjo and Nagamori (1985), Permanent-Magnet and Brushless DC Motors, ISBN 978-0-19-856217-7.

    >>> from types import SimpleNamespace as At
    >>> ripple, m, x = CommutationRipple(eps=0.1, N=6.0, p=0.3), At(ke=0.5), At(i=3.0, w=80.0, phi=0.2)
    >>> round(ripple.voltage(m, x, None), 6), round(ripple.torque(m, x, None), 6)  # -0.05 80 cos(1.5), 0.05 3 cos(1.5)
    (-0.282949, 0.010611)
    """

    states: ClassVar[Mapping[str, State]] = {"phi": State("rad", "shaft angle", kind="angle")}
    excited_by: ClassVar[tuple[str, ...]] = ("slow_ramp", "no_load_steps")

    eps: float = param(0.0, "1", "relative amplitude", bounds=(-0.5, 0.5), prior=0.05, null=0.0)
    N: float = param(
        6.0, "1", "ripples a revolution", bounds=(1.0, 1000.0), prior=6.0, fixed=True, role="count"
    )
    p: float = phase("phase at phi = 0")

    def voltage(self, m: Any, x: Any, u: Any) -> Any:
        return -m.ke * self.eps * cos(self.N * x.phi + self.p) * x.w

    def torque(self, m: Any, x: Any, u: Any) -> Any:
        return m.ke * self.eps * cos(self.N * x.phi + self.p) * x.i

    def rates(self, m: Any, x: Any, u: Any) -> Mapping[str, Any]:
        return {"phi": x.w}
