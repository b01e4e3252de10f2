"""A housing that warms behind the winding."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect, State
from motorlens_physics.ops import turning
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class TwoNodeThermal(Effect):
    """The winding also heats a housing: -G_h (theta - theta_h).

    C_h dtheta_h/dt = G_h (theta - theta_h) - G_a (1 + kT |w|) theta_h. The winding follows
    quickly, the housing slowly; the fan cools both. A winding that cools through its housing only has a small k0.
    Kirchgässner, Wallscheid and Böcker (2023), Thermal neural networks, doi:10.1016/j.engappai.2022.105537, section 2.

    >>> from types import SimpleNamespace as At
    >>> node, m, x = TwoNodeThermal(G_h=3.0, G_a=0.5, C_h=200.0), At(kT=0.01), At(theta=60.0, theta_h=20.0, w=50.0)
    >>> node.heat(m, x, None)  # -3 (60 - 20)
    -120.0
    >>> round(node.rates(m, x, None)["theta_h"], 4)  # (120 - 0.5 1.5 20) / 200
    0.525
    """

    states: ClassVar[Mapping[str, State]] = {
        "theta_h": State("K", "rise of the housing above ambient", kind="rise")
    }
    excited_by: ClassVar[tuple[str, ...]] = ("heat_soak", "duty", "direct_on_line")

    G_h: float = param(
        0.0,
        "W/K",
        "thermal conductance from winding to housing",
        bounds=(0.0, 1e5),
        prior=0.2,
        of="power/rise",
        null=0.0,
    )
    G_a: float = param(
        1.0,
        "W/K",
        "thermal conductance from housing to ambient",
        bounds=(1e-6, 1e5),
        prior=0.1,
        of="power/rise",
    )
    C_h: float = param(
        1000.0, "J/K", "heat capacity of the housing", bounds=(1e-3, 1e8), prior=300.0, of="power/rise"
    )

    def heat(self, m: Any, x: Any, u: Any) -> Any:
        return -self.G_h * (x.theta - x.theta_h)

    def rates(self, m: Any, x: Any, u: Any) -> Mapping[str, Any]:
        cooling = self.G_a * (1 + m.kT * turning(x.w)) * x.theta_h
        return {"theta_h": (self.G_h * (x.theta - x.theta_h) - cooling) / self.C_h}
