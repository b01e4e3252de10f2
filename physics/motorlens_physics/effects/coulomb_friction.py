"""Coulomb friction."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.ops import tanh
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class CoulombFriction(Effect):
    """A constant torque against the motion, smoothed through zero: -tau_c tanh(w / w_s).

    Armstrong-Hélouvry, Dupont and Canudas de Wit (1994), A survey of models, analysis tools and compensation methods
    for the control of machines with friction, doi:10.1016/0005-1098(94)90209-7.

    >>> from types import SimpleNamespace as At
    >>> round(CoulombFriction(tau_c=0.3, w_s=2.0).torque(None, At(w=-4.0), None), 6)  # 0.3 tanh(2)
    0.289208
    """

    excited_by: ClassVar[tuple[str, ...]] = ("no_load_steps", "coast_down")
    friction: ClassVar[bool] = True

    tau_c: float = param(0.0, "N*m", "Coulomb torque", bounds=(0.0, 1e3), prior=0.03, of="torque", null=0.0)
    w_s: float = param(
        0.5,
        "rad/s",
        "speed at which it has built up",
        bounds=(1e-3, 50.0),
        prior=0.02,
        of="speed",
        role="width",
    )

    def torque(self, m: Any, x: Any, u: Any) -> Any:
        return -self.tau_c * tanh(x.w / self.w_s)

    def stiction(self, m: Any, x: Any, u: Any) -> Any:
        return self.tau_c
