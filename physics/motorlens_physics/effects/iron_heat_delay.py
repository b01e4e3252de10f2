"""Iron loss that reaches the winding late."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect, State
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class IronHeatDelay(Effect):
    """A share of the iron loss warms the core first: +s (p - k_ir w^2), tau dp/dt = k_ir w^2 - p.

    p is the iron loss as it leaves the core, tau s p the heat under way. It goes on arriving after the motor has
    stopped, when no fan cools any more: the winding of a motor just switched off warms for a while (heat soak). What
    goes in comes out.
    Kirchgässner, Wallscheid and Böcker (2023), Thermal neural networks, doi:10.1016/j.engappai.2022.105537, section 2:
    a loss enters the node in which it arises.

    >>> from types import SimpleNamespace as At
    >>> delay, m, x = IronHeatDelay(s=0.5, tau=40.0), At(k_ir=0.002), At(w=100.0, p=12.0)
    >>> round(delay.heat(m, x, None), 6), round(delay.rates(m, x, None)["p"], 6)  # 0.5 (12 - 20), (20 - 12) / 40
    (-4.0, 0.2)
    """

    states: ClassVar[Mapping[str, State]] = {"p": State("W", "iron loss as it leaves the core")}
    excited_by: ClassVar[tuple[str, ...]] = ("heat_soak", "duty")

    s: float = param(
        0.0, "1", "share of the iron loss that is delayed", bounds=(0.0, 1.0), prior=0.5, null=0.0
    )
    tau: float = param(100.0, "s", "time constant of the delay", bounds=(0.1, 1e5), prior=100.0)

    def heat(self, m: Any, x: Any, u: Any) -> Any:
        return self.s * (x.p - m.k_ir * x.w**2)

    def rates(self, m: Any, x: Any, u: Any) -> Mapping[str, Any]:
        return {"p": (m.k_ir * x.w**2 - x.p) / self.tau}
