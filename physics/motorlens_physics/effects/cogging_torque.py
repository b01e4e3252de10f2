"""Cogging torque."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect, State
from motorlens_physics.ops import sin
from motorlens_physics.parameter import param, phase


@dataclass(frozen=True)
class CoggingTorque(Effect):
    """Magnets pull the teeth of the armature into detents: -A sin(N phi + p).

    Zhu and Howe (2000), Influence of design parameters on cogging torque in permanent magnet machines,
    doi:10.1109/60.900501. The shaft angle starts in a detent (phi = 0). A detent passes within
    milliseconds: simulate seconds of it, not hours.

    >>> from types import SimpleNamespace as At
    >>> round(CoggingTorque(A=0.05, N=7.0, p=0.3).torque(None, At(phi=0.2), None), 6)  # 0.05 sin(1.7)
    -0.049583
    """

    states: ClassVar[Mapping[str, State]] = {"phi": State("rad", "shaft angle", kind="angle")}
    excited_by: ClassVar[tuple[str, ...]] = ("slow_ramp",)

    A: float = param(0.0, "N*m", "amplitude", bounds=(0.0, 1e3), prior=0.02, of="torque", null=0.0)
    N: float = param(
        12.0,
        "1",
        "detents a revolution: least common multiple of slots and poles",
        bounds=(1.0, 1000.0),
        prior=12.0,
        fixed=True,
        role="count",
    )
    p: float = phase("phase at phi = 0")

    def torque(self, m: Any, x: Any, u: Any) -> Any:
        return -self.A * sin(self.N * x.phi + self.p)

    def rates(self, m: Any, x: Any, u: Any) -> Mapping[str, Any]:
        return {"phi": x.w}
