"""Friction that differs with the direction of rotation."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.ops import tanh
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class DirectionalFriction(Effect):
    """Coulomb friction that acts forwards only: -tau_d tanh(w / w_s) (1 + tanh(w / w_s)) / 2.

    Brushes trail one way and dig in the other. Less friction forwards than backwards is a negative tau_d beside a
    `coulomb_friction` of at least its size. It holds a resting rotor from turning forwards, and not from turning backwards.
    Armstrong-Hélouvry, Dupont and Canudas de Wit (1994), A survey of models, analysis tools and compensation methods
    for the control of machines with friction, doi:10.1016/0005-1098(94)90209-7.

    >>> from types import SimpleNamespace as At
    >>> round(DirectionalFriction(tau_d=0.3, w_s=2.0).torque(None, At(w=1.0), None), 6)  # 0.3 tanh(0.5) (1 + tanh(0.5)) / 2
    -0.10135
    """

    excited_by: ClassVar[tuple[str, ...]] = ("no_load_steps", "slow_ramp")
    friction: ClassVar[bool] = True

    tau_d: float = param(
        0.0,
        "N*m",
        "friction forwards above friction backwards",
        bounds=(-1e3, 1e3),
        prior=0.02,
        of="torque",
        null=0.0,
    )
    w_s: float = param(
        0.5,
        "rad/s",
        "speed at which it has built up",
        bounds=(1e-3, 50.0),
        prior=0.02,
        of="speed",
        role="width",
    )

    def torque(self, m: Any, x: Any, u: Any) -> Any:
        return -self.stiction(m, x, u) * tanh(x.w / self.w_s)

    def stiction(self, m: Any, x: Any, u: Any) -> Any:
        return self.tau_d * (1 + tanh(x.w / self.w_s)) / 2
