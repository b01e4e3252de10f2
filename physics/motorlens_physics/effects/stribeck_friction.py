"""Stribeck friction."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.ops import exp, tanh
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class StribeckFriction(Effect):
    """Friction that is higher near rest, beyond Coulomb: -tau_s exp(-(w / w_k)^2) tanh(w / w_s).

    The lubricant film builds up with speed, so friction falls first: below w_k the rotor sticks and slips.
    Olsson, Åström, Canudas de Wit, Gäfvert and Lischinsky (1998), Friction models and friction compensation, European
    Journal of Control 4, 176-195, doi:10.1016/S0947-3580(98)70113-X.

    >>> from types import SimpleNamespace as At
    >>> round(StribeckFriction(tau_s=0.2, w_k=5.0, w_s=0.4).torque(None, At(w=3.0), None), 6)  # 0.2 exp(-0.36) tanh(7.5)
    -0.139535
    """

    excited_by: ClassVar[tuple[str, ...]] = ("slow_ramp", "no_load_steps")
    friction: ClassVar[bool] = True

    tau_s: float = param(
        0.0,
        "N*m",
        "breakaway torque above Coulomb friction",
        bounds=(0.0, 1e3),
        prior=0.02,
        of="torque",
        null=0.0,
    )
    w_k: float = param(
        5.0,
        "rad/s",
        "Stribeck speed, at which the excess has fallen to 37 %",
        bounds=(1e-2, 500.0),
        prior=0.03,
        of="speed",
    )
    w_s: float = param(
        0.5,
        "rad/s",
        "width of the smoothing",
        bounds=(1e-3, 50.0),
        prior=0.002,
        of="speed",
        fixed=True,
        role="width",
    )

    def torque(self, m: Any, x: Any, u: Any) -> Any:
        return -self.tau_s * exp(-((x.w / self.w_k) ** 2)) * tanh(x.w / self.w_s)

    def stiction(self, m: Any, x: Any, u: Any) -> Any:
        return self.tau_s
