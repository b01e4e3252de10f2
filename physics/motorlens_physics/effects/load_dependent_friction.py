"""Friction that grows with the torque carried."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.ops import magnitude, tanh
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class LoadDependentFriction(Effect):
    """Friction of gears and bearings under load: -mu |ke i + T_load| / 2 tanh(w / w_s).

    The mean of the torques on both sides of the gear presses its teeth together; 1 - mu is close to its efficiency.
    Duclusaud, Passault, Padois and Ly (2024), Extended friction models for the physics simulation of servo actuators,
    arXiv:2410.08650, model M3.

    >>> from types import SimpleNamespace as At
    >>> friction = LoadDependentFriction(mu=0.1, w_s=2.0, tau_r=1e-6)
    >>> round(friction.torque(At(ke=0.5), At(i=3.0, w=4.0), At(load=0.7)), 6)  # 0.1 (1.5 + 0.7) / 2 tanh(2)
    -0.106043
    """

    excited_by: ClassVar[tuple[str, ...]] = ("overhauling_load", "load_steps", "no_load_steps")
    friction: ClassVar[bool] = True

    mu: float = param(0.0, "1", "friction per torque carried", bounds=(0.0, 1.0), prior=0.05, null=0.0)
    w_s: float = param(
        0.5,
        "rad/s",
        "speed at which it has built up",
        bounds=(1e-3, 50.0),
        prior=0.02,
        of="speed",
        role="width",
    )
    tau_r: float = param(
        1e-3,
        "N*m",
        "torque within which the magnitude is rounded off",
        bounds=(1e-9, 10.0),
        prior=0.001,
        of="torque",
        fixed=True,
    )

    def torque(self, m: Any, x: Any, u: Any) -> Any:
        return -self.stiction(m, x, u) * tanh(x.w / self.w_s)

    def stiction(self, m: Any, x: Any, u: Any) -> Any:
        return self.mu * magnitude(m.ke * x.i + u.load, self.tau_r) / 2
