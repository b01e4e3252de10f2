"""Stray load loss."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class StrayLoadLoss(Effect):
    """Eddy currents that the armature's own field drives, in iron and coils: -c i^2 w, and c i^2 w^2 of heat.

    IEEE Std 113-1985, Guide: Test Procedures for Direct-Current Machines: 1 % of the output by convention; it grows
    with the square of the current. In speed as in the eddy currents of Bertotti (1988), doi:10.1109/20.43994.

    >>> from types import SimpleNamespace as At
    >>> loss, x = StrayLoadLoss(c=2e-5), At(i=7.0, w=200.0)
    >>> round(loss.torque(None, x, None), 6), round(loss.heat(None, x, None), 6)  # 2e-5 49 200, 2e-5 49 200^2
    (-0.196, 39.2)
    """

    excited_by: ClassVar[tuple[str, ...]] = ("load_steps", "direct_on_line")

    c: float = param(
        0.0,
        "N*m*s/rad/A^2",
        "stray loss constant",
        bounds=(0.0, 1e2),
        prior=0.01,
        of="torque/speed/current^2",
        null=0.0,
    )

    def torque(self, m: Any, x: Any, u: Any) -> Any:
        return -self.c * x.i**2 * x.w

    def heat(self, m: Any, x: Any, u: Any) -> Any:
        return self.c * x.i**2 * x.w**2
