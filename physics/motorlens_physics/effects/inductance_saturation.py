"""Inductance that falls with the current."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class InductanceSaturation(Effect):
    """Saturated iron carries less additional flux: L (r + (1 - r) / (1 + s i^2)) in the place of L.

    L is the incremental inductance before di/dt; s = 1 / i_half^2, where half of the part of the iron is lost. A share
    r, of the flux that never was in the iron, stays.
    Fitzgerald, Kingsley and Umans (2003), Electric Machinery, 6th edition, ISBN 978-0-07-366009-7, section 1.3.

    >>> from types import SimpleNamespace as At
    >>> round(InductanceSaturation(s=0.01).inductance(At(L=0.03), At(i=5.0), None), 9)  # 0.03 (1 / 1.25 - 1)
    -0.006
    """

    excited_by: ClassVar[tuple[str, ...]] = ("direct_on_line", "duty")

    s: float = param(
        0.0,
        "1/A^2",
        "inverse square of the current that halves the iron's part of L",
        bounds=(0.0, 1e6),
        prior=0.05,
        of="1/current^2",
        null=0.0,
    )
    r: float = param(
        0.0, "1", "share of L that does not saturate", bounds=(0.0, 0.95), prior=0.3, role="share"
    )

    def inductance(self, m: Any, x: Any, u: Any) -> Any:
        saturation = self.s * x.i**2
        return -(1 - self.r) * m.L * saturation / (1 + saturation)
