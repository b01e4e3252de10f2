"""Unbalance torque."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect, State
from motorlens_physics.ops import sin
from motorlens_physics.parameter import param, phase


@dataclass(frozen=True)
class UnbalanceTorque(Effect):
    """Gravity on a rotor or load whose centre of mass is off the shaft: -A sin(phi + p), once a revolution.

    A = m g e with the unbalance m e of ISO 21940-11:2016, Procedures and tolerances for rotors with rigid behaviour.
    The shaft angle starts with the heavy side down (phi = 0). Of a rotor alone A is small; of an arm or a pendulum it may be
    as much as the motor can give for a short while, some three times its rated torque.

    >>> from types import SimpleNamespace as At
    >>> round(UnbalanceTorque(A=0.05, p=0.4).torque(None, At(phi=1.1), None), 6)  # 0.05 sin(1.5)
    -0.049875
    """

    states: ClassVar[Mapping[str, State]] = {"phi": State("rad", "shaft angle", kind="angle")}
    excited_by: ClassVar[tuple[str, ...]] = ("slow_ramp",)

    A: float = param(
        0.0,
        "N*m",
        "weight times eccentricity",
        bounds=(0.0, 1e3),
        prior=0.02,
        of="torque",
        null=0.0,
        largest=3.0,
    )
    p: float = phase("angle of the heavy side at phi = 0")

    def torque(self, m: Any, x: Any, u: Any) -> Any:
        return -self.A * sin(x.phi + self.p)

    def rates(self, m: Any, x: Any, u: Any) -> Mapping[str, Any]:
        return {"phi": x.w}
