"""Magnets that weaken as they warm."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect, State
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class MagnetTemperature(Effect):
    """ke (1 - beta theta_m) in the place of ke, in back-EMF and torque alike: +ke beta theta_m w and -ke beta theta_m i.

    The magnets follow the winding's rise: n H / k0 dtheta_m/dt = f theta - theta_m; what they take from it is small.
    IEC 60404-8-1:2023, Magnetic materials, hard magnetic materials: 0.2 %/K ferrite, 0.11 %/K NdFeB, 0.04 %/K SmCo,
    0.02 %/K AlNiCo. A field winding weakens at constant voltage like a magnet of 0.4 %/K.

    >>> from types import SimpleNamespace as At
    >>> magnet, m = MagnetTemperature(beta=0.002, f=0.6, n=1.5), At(ke=0.5, H=200.0, k0=4.0)
    >>> x = At(i=3.0, w=80.0, theta=50.0, theta_m=10.0)
    >>> round(magnet.voltage(m, x, None), 6), round(magnet.torque(m, x, None), 6)  # 0.5 0.002 10 80, 0.5 0.002 10 3
    (0.8, -0.03)
    >>> round(magnet.rates(m, x, None)["theta_m"], 6)  # (0.6 50 - 10) 4 / (1.5 200)
    0.266667
    """

    states: ClassVar[Mapping[str, State]] = {
        "theta_m": State("K", "rise of the magnets above ambient", kind="rise")
    }
    excited_by: ClassVar[tuple[str, ...]] = ("direct_on_line", "duty", "heat_soak")

    beta: float = param(
        0.0,
        "1/K",
        "relative loss of flux per kelvin",
        bounds=(0.0, 0.01),
        prior=0.002,
        null=0.0,
        # A little more than a field winding.
        largest=0.005,
    )
    f: float = param(
        0.7, "1", "rise of the magnets as a share of the winding's", bounds=(0.0, 1.0), prior=0.3, fixed=True
    )
    n: float = param(
        1.0,
        "1",
        "time constant of the magnets, in multiples of the winding's H / k0",
        bounds=(0.01, 100.0),
        prior=1.0,
    )

    def voltage(self, m: Any, x: Any, u: Any) -> Any:
        return m.ke * self.beta * x.theta_m * x.w

    def torque(self, m: Any, x: Any, u: Any) -> Any:
        return -m.ke * self.beta * x.theta_m * x.i

    def rates(self, m: Any, x: Any, u: Any) -> Mapping[str, Any]:
        return {"theta_m": (self.f * x.theta - x.theta_m) * m.k0 / (self.n * m.H)}
