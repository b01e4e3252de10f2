"""Viscous friction that falls with temperature."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.ops import exp
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class TemperatureDependentViscosity(Effect):
    """Grease thins as it warms, b exp(-kappa theta) in the place of b: +b w (1 - exp(-kappa theta)).

    The winding's rise stands for that of the bearings. It only returns what the textbook's b w takes.
    Reynolds (1886), On the theory of lubrication, doi:10.1098/rstl.1886.0005: viscosity falls exponentially.

    >>> from types import SimpleNamespace as At
    >>> motor, hot = At(b=0.02), At(w=50.0, theta=40.0)
    >>> round(TemperatureDependentViscosity(kappa=0.01).torque(motor, hot, None), 6)  # 0.02 50 (1 - exp(-0.4))
    0.32968
    """

    excited_by: ClassVar[tuple[str, ...]] = ("direct_on_line", "duty", "heat_soak")
    friction: ClassVar[bool] = True

    kappa: float = param(
        0.0, "1/K", "relative fall of viscosity per kelvin", bounds=(0.0, 0.1), prior=0.01, null=0.0
    )

    def torque(self, m: Any, x: Any, u: Any) -> Any:
        return m.b * x.w * (1 - exp(-self.kappa * x.theta))
