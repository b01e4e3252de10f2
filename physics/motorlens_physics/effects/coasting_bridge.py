"""A bridge that lets the motor coast while it is off."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.ops import magnitude
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class CoastingBridge(Effect):
    """A fast-decay bridge opens in the off time, and the back-EMF is not held there: +s (1 - |v| / V_bus) ke w.

    v is the commanded voltage, duty times V_bus. With s = 1 the current dies at once: the motor runs at a speed that
    hardly depends on the duty, and coasts at v = 0; s = 0 is a bridge that brakes (slow decay, as the textbook assumes).
    Mohan, Undeland and Robbins (2003), Power Electronics, 3rd edition, ISBN 978-0-471-22693-2, section 7-3-3:
    discontinuous conduction.

    >>> from types import SimpleNamespace as At
    >>> bridge = CoastingBridge(s=0.5, V_bus=12.0, v_r=1e-9)
    >>> round(bridge.voltage(At(ke=0.05), At(w=80.0), At(v=-9.0)), 6)  # 0.5 (1 - 9 / 12) 0.05 80
    0.5
    """

    excited_by: ClassVar[tuple[str, ...]] = ("no_load_steps", "slow_ramp")

    s: float = param(
        0.0, "1", "share of the off time without current", bounds=(0.0, 1.0), prior=0.5, null=0.0
    )
    V_bus: float = param(
        24.0, "V", "supply voltage of the bridge", bounds=(0.1, 1e4), prior=1.0, of="voltage"
    )
    v_r: float = param(
        0.1,
        "V",
        "voltage within which |v| is rounded off",
        bounds=(1e-9, 10.0),
        prior=0.002,
        of="voltage",
        fixed=True,
    )

    def voltage(self, m: Any, x: Any, u: Any) -> Any:
        return self.s * (1 - magnitude(u.v, self.v_r) / self.V_bus) * m.ke * x.w
