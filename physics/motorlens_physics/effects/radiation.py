"""Thermal radiation."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.ops import kelvin
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class Radiation(Effect):
    """Cooling that grows with the fourth power of absolute temperature: -G_r (T^4 - T_a^4) / (4 T_r^3).

    T = T_a + theta; G_r = 4 A eps sigma T_r^3 is the conductance of a surface barely warmer than an ambient of T_r.
    Natural convection also grows with the rise, if less, and is not told from it.
    Incropera, DeWitt, Bergman and Lavine (2007), Fundamentals of Heat and Mass Transfer, 6th edition,
    ISBN 978-0-471-45728-2, equation (1.7).

    >>> from types import SimpleNamespace as At
    >>> radiation = Radiation(G_r=0.5, T_r=290.0)
    >>> round(radiation.heat(None, At(theta=60.0), At(ambient=26.85)), 3)  # 0.5 (360^4 - 300^4) / (4 290^3)
    -44.57
    """

    excited_by: ClassVar[tuple[str, ...]] = ("direct_on_line", "heat_soak")

    G_r: float = param(
        0.0,
        "W/K",
        "radiative conductance",
        bounds=(0.0, 1e4),
        prior=0.05,
        of="power/rise",
        null=0.0,
    )

    T_r: float = param(
        293.15, "K", "temperature at which G_r is stated", bounds=(200.0, 400.0), prior=293.15, fixed=True
    )

    def heat(self, m: Any, x: Any, u: Any) -> Any:
        ambient = kelvin(u.ambient)
        return -self.G_r * ((ambient + x.theta) ** 4 - ambient**4) / (4 * self.T_r**3)
