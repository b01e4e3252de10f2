"""Brush contact voltage drop."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.ops import saturated
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class BrushVoltageDrop(Effect):
    """A voltage drop at the brushes that hardly depends on the current: -V_b s(i), always against the current.

    s(i) = i / (|i|^m + i_s^m)^(1/m) is a smooth sign, whose knee differs from brush to brush. The drop times the current
    heats brushes and commutator, of which a share h reaches the winding: +h V_b s(i) i.
    IEEE Std 113-1985, Guide: Test Procedures for Direct-Current Machines, 5.7 (2 V for a pair of carbon brushes).

    >>> from types import SimpleNamespace as At
    >>> round(BrushVoltageDrop(V_b=1.5, i_s=0.3).heat(None, At(i=0.4), None), 4)  # 1.5 0.4 / 0.5 0.4
    0.48
    """

    excited_by: ClassVar[tuple[str, ...]] = ("load_steps", "locked_rotor")

    V_b: float = param(
        0.0, "V", "drop of a brush pair", bounds=(0.0, 10.0), prior=0.01, of="voltage", null=0.0
    )
    i_s: float = param(
        0.1,
        "A",
        "current at which the drop has built up",
        bounds=(1e-4, 100.0),
        prior=0.02,
        of="current",
        role="onset",
    )
    m: float = param(2.0, "1", "sharpness of the knee", bounds=(1.5, 8.0), prior=2.0, role="knee")
    h: float = param(
        1.0, "1", "share of its heat that warms the winding", bounds=(0.0, 1.0), prior=1.0, role="share"
    )

    def voltage(self, m: Any, x: Any, u: Any) -> Any:
        return -self.V_b * saturated(x.i, self.i_s, self.m)

    def heat(self, m: Any, x: Any, u: Any) -> Any:
        return self.h * self.V_b * saturated(x.i, self.i_s, self.m) * x.i
