"""Brush contact voltage drop."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.ops import tanh
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class BrushVoltageDrop(Effect):
    """A voltage drop at the brushes that hardly depends on the current: -V_b tanh(i / i_s), always against the current.

    The drop times the current heats the commutator, which shares its heat with the winding: +V_b tanh(i / i_s) i.
    IEEE Std 113-1985, Guide: Test Procedures for Direct-Current Machines, 5.7 (2 V for a pair of carbon brushes).

    >>> from types import SimpleNamespace as At
    >>> round(BrushVoltageDrop(V_b=1.5, i_s=0.5).heat(None, At(i=0.4), None), 6)  # 1.5 tanh(0.8) 0.4
    0.398422
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
    )

    def voltage(self, m: Any, x: Any, u: Any) -> Any:
        return -self.V_b * tanh(x.i / self.i_s)

    def heat(self, m: Any, x: Any, u: Any) -> Any:
        return self.V_b * tanh(x.i / self.i_s) * x.i
