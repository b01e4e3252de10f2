"""Hysteresis loss in the armature's iron."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.ops import tanh
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class HysteresisIronLoss(Effect):
    """Each turn of the magnetisation costs the same energy: -k_h tanh(w / w_s), and all that it brakes is heat.

    The brake alone is a twin of Coulomb friction; the heat tells them apart. The textbook's k_ir w^2 is the eddy part.
    Bertotti (1988), General properties of power losses in soft ferromagnetic materials, doi:10.1109/20.43994.

    >>> from types import SimpleNamespace as At
    >>> loss, x = HysteresisIronLoss(k_h=0.2, w_s=4.0), At(w=2.0)
    >>> round(loss.torque(None, x, None), 6), round(loss.heat(None, x, None), 6)  # 0.2 tanh(0.5), 0.4 tanh(0.5)
    (-0.092423, 0.184847)
    """

    excited_by: ClassVar[tuple[str, ...]] = ("direct_on_line", "no_load_steps", "duty")

    k_h: float = param(0.0, "N*m", "hysteresis torque", bounds=(0.0, 1e3), prior=0.03, of="torque", null=0.0)
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
        return -self.k_h * tanh(x.w / self.w_s)

    def heat(self, m: Any, x: Any, u: Any) -> Any:
        return self.k_h * tanh(x.w / self.w_s) * x.w

    def stiction(self, m: Any, x: Any, u: Any) -> Any:
        return self.k_h
