"""Air around the motor that warms."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect, State
from motorlens_physics.ops import turning
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class AmbientDrift(Effect):
    """The motor's surroundings leave the ambient recorded: +k0 (1 + kT |w|) d z, tau dz/dt = 1 - z.

    The winding is cooled towards ambient + d z, its rise still counted from the ambient recorded. A sensor on the other
    side of the room, a cabinet that warms up, a sun-lit wall.
    IEC 60034-1:2022, Rotating electrical machines, rating and performance: temperature of the coolant at the machine.

    >>> from types import SimpleNamespace as At
    >>> drift, m, x = AmbientDrift(d=8.0, tau=500.0), At(k0=2.0, kT=0.01), At(z=0.3, w=50.0)
    >>> round(drift.heat(m, x, None), 3), round(drift.rates(m, x, None)["z"], 6)  # 2 1.5 8 0.3, 0.7 / 500
    (7.2, 0.0014)
    """

    states: ClassVar[Mapping[str, State]] = {"z": State("1", "share of the drift that has come about")}
    excited_by: ClassVar[tuple[str, ...]] = ("heat_soak", "direct_on_line")

    d: float = param(
        0.0, "K", "final distance from the ambient recorded", bounds=(-100.0, 100.0), prior=5.0, null=0.0
    )
    tau: float = param(1800.0, "s", "time constant of the drift", bounds=(1.0, 1e6), prior=1800.0)

    def heat(self, m: Any, x: Any, u: Any) -> Any:
        return m.k0 * (1 + m.kT * turning(x.w)) * self.d * x.z

    def rates(self, m: Any, x: Any, u: Any) -> Mapping[str, Any]:
        return {"z": (1 - x.z) / self.tau}
