"""Quadratic drag."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.ops import turning
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class QuadraticDrag(Effect):
    """Windage of rotor and fan, and propellers: -c w |w|.

    Vrancik (1968), Prediction of windage power loss in alternators, NASA TN D-4849: turbulent drag grows with the
    square of speed.

    >>> from types import SimpleNamespace as At
    >>> round(QuadraticDrag(c=2e-6).torque(None, At(w=-300.0), None), 5)  # 2e-6 300^2
    0.18
    """

    excited_by: ClassVar[tuple[str, ...]] = ("coast_down", "no_load_steps")
    friction: ClassVar[bool] = True

    c: float = param(
        0.0, "N*m*s^2/rad^2", "drag constant", bounds=(0.0, 1e2), prior=0.02, of="torque/speed^2", null=0.0
    )

    def torque(self, m: Any, x: Any, u: Any) -> Any:
        return -self.c * x.w * turning(x.w)
