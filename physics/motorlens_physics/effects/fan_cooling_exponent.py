"""A fan whose cooling does not grow in proportion to speed."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.ops import SPEED_ROUNDING, sqrt, unit
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class FanCoolingExponent(Effect):
    """k0 (1 + kT w_r (|w| / w_r)^n) theta of cooling in the place of k0 (1 + kT |w|) theta.

    Forced convection grows with a power of speed, n = 0.5 (laminar) to 0.8 (turbulent); w_r, where the textbook's law and
    this one agree, is the rated speed.
    Staton and Cavagnino (2008), Convection heat transfer and flow calculations suitable for electric machines thermal
    models, doi:10.1109/TIE.2008.922604.

    >>> from types import SimpleNamespace as At
    >>> fan, m, x = FanCoolingExponent(n=0.5, w_r=400.0), At(k0=2.0, kT=0.005), At(w=100.0, theta=30.0)
    >>> round(fan.heat(m, x, None), 1)  # -2 0.005 30 (400 / 2 - 100)
    -29.8
    """

    excited_by: ClassVar[tuple[str, ...]] = ("heat_soak", "duty")

    n: float = param(1.0, "1", "exponent of speed", bounds=(0.1, 3.0), prior=0.3, null=1.0)
    w_r: float = param(
        200.0,
        "rad/s",
        "speed at which the exponent changes nothing",
        bounds=(1e-2, 1e4),
        prior=1.0,
        of="speed",
        fixed=True,
    )

    def heat(self, m: Any, x: Any, u: Any) -> Any:
        rounding = SPEED_ROUNDING * unit(x.w)
        turn = sqrt(x.w * x.w + rounding * rounding) / self.w_r
        rest = rounding / self.w_r
        growth = turn**self.n - rest**self.n - (turn - rest)
        return -m.k0 * m.kT * self.w_r * growth * x.theta
