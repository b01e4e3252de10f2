"""Dead time of the bridge."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.ops import saturated
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class DeadTime(Effect):
    """While both switches are off, the diodes choose the voltage against the current: -V_dt s(i).

    V_dt = f_s t_d V_bus, of a voltage computed from the duty cycle; measured terminal voltage has it not. The current's
    ripple, of amplitude i_r, smooths it: s(i) = i / (|i|^m + i_r^m)^(1/m). Unlike a brush drop it heats none of the motor;
    without temperature the two are twins.
    Jeong and Park (1991), The analysis and compensation of dead-time effects in PWM inverters, doi:10.1109/41.88903.

    >>> from types import SimpleNamespace as At
    >>> round(DeadTime(V_dt=0.8, i_r=0.4).voltage(None, At(i=-0.3), None), 4)  # 0.8 0.3 / 0.5
    0.48
    """

    excited_by: ClassVar[tuple[str, ...]] = ("load_steps", "slow_ramp", "locked_rotor")

    V_dt: float = param(
        0.0, "V", "voltage lost in the dead time", bounds=(0.0, 100.0), prior=0.01, of="voltage", null=0.0
    )
    i_r: float = param(
        0.5,
        "A",
        "amplitude of the current ripple",
        bounds=(1e-4, 100.0),
        prior=0.05,
        of="current",
        role="onset",
    )
    m: float = param(2.0, "1", "sharpness of the knee", bounds=(1.5, 8.0), prior=2.0, role="knee")

    def voltage(self, m: Any, x: Any, u: Any) -> Any:
        return -self.V_dt * saturated(x.i, self.i_r, self.m)
