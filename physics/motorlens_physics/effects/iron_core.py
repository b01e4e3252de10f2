"""A core that its own loss warms, beside the winding."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect, State
from motorlens_physics.ops import turning
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class IronCore(Effect):
    """The iron loss warms the core, which warms the winding: +s (G_c (theta_c - theta) - k_ir w^2).

    C_c dtheta_c/dt = k_ir w^2 - G_c (theta_c - theta) - G_a (1 + kT |w|) theta_c. The share s of the core is apart from the
    winding; its loss, its capacity and its conductances are s times those above, so that what goes in comes out. A core
    that runs hotter than the winding between its teeth warms it for minutes once no fan cools it any more (heat soak).
    Kirchgässner, Wallscheid and Böcker (2023), Thermal neural networks, doi:10.1016/j.engappai.2022.105537, section 2:
    a loss enters the node in which it arises.

    >>> from types import SimpleNamespace as At
    >>> core, m = IronCore(s=0.5, G_c=3.0, G_a=0.5, C_c=200.0), At(kT=0.01, k_ir=0.002)
    >>> x = At(theta=20.0, theta_c=60.0, w=100.0)
    >>> core.heat(m, x, None)  # 0.5 (3 (60 - 20) - 0.002 100^2)
    50.0
    >>> round(core.rates(m, x, None)["theta_c"], 4)  # (20 - 120 - 0.5 2 60) / 200
    -0.8
    """

    states: ClassVar[Mapping[str, State]] = {
        "theta_c": State("K", "rise of the core above ambient", kind="rise")
    }
    excited_by: ClassVar[tuple[str, ...]] = ("heat_soak", "duty", "direct_on_line")

    s: float = param(
        0.0, "1", "share of the core that is apart from the winding", bounds=(0.0, 1.0), prior=0.5, null=0.0
    )
    G_c: float = param(
        1.0,
        "W/K",
        "thermal conductance from the core to the winding",
        bounds=(1e-6, 1e5),
        prior=0.2,
        of="power/rise",
    )
    G_a: float = param(
        1.0,
        "W/K",
        "thermal conductance from the core to ambient",
        bounds=(1e-6, 1e5),
        prior=0.1,
        of="power/rise",
    )
    C_c: float = param(
        1000.0, "J/K", "heat capacity of the core", bounds=(1e-3, 1e8), prior=300.0, of="power/rise"
    )

    def heat(self, m: Any, x: Any, u: Any) -> Any:
        return self.s * (self.G_c * (x.theta_c - x.theta) - m.k_ir * x.w**2)

    def rates(self, m: Any, x: Any, u: Any) -> Mapping[str, Any]:
        cooling = self.G_a * (1 + m.kT * turning(x.w)) * x.theta_c
        return {"theta_c": (m.k_ir * x.w**2 - self.G_c * (x.theta_c - x.theta) - cooling) / self.C_c}
