"""Resistance between the voltage that is known and the motor."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class SupplyResistance(Effect):
    """Cable, bridge and shunt between the voltage recorded and the terminals: -R_s i, which heats none of the winding.

    It differs from R_a0 by neither warming nor heating the winding; without a warm-up the two are twins.
    Mohan, Undeland and Robbins (2003), Power Electronics, 3rd edition, ISBN 978-0-471-22693-2, chapter 2.

    >>> from types import SimpleNamespace as At
    >>> SupplyResistance(R_s=0.25).voltage(None, At(i=3.0), None)  # 0.25 3
    -0.75
    """

    excited_by: ClassVar[tuple[str, ...]] = ("direct_on_line", "duty")

    R_s: float = param(
        0.0,
        "ohm",
        "resistance of supply and cable",
        bounds=(0.0, 1e4),
        prior=0.01,
        of="voltage/current",
        null=0.0,
    )

    def voltage(self, m: Any, x: Any, u: Any) -> Any:
        return -self.R_s * x.i
