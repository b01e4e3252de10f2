"""Constant torque."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class ConstantTorque(Effect):
    """A load that nobody measured and that does not turn with the motion: -tau_0.

    A hanging weight, a spring, the zero of a torque sensor. Only a reversal tells it from Coulomb friction.
    Leonhard (2001), Control of Electrical Drives, 3rd edition, ISBN 978-3-540-41820-7, chapter 1: hoists.

    >>> from types import SimpleNamespace as At
    >>> ConstantTorque(tau_0=0.4).torque(None, At(w=-7.0), None)
    -0.4
    """

    excited_by: ClassVar[tuple[str, ...]] = ("no_load_steps", "slow_ramp")

    tau_0: float = param(
        0.0, "N*m", "torque against positive rotation", bounds=(-1e3, 1e3), prior=0.03, of="torque", null=0.0
    )

    def torque(self, m: Any, x: Any, u: Any) -> Any:
        return -self.tau_0
