"""The brake that belongs to the iron loss."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.effect import Effect
from motorlens_physics.parameter import param


@dataclass(frozen=True)
class IronLossTorque(Effect):
    """The iron loss k_ir w^2 must come from somewhere: -s k_ir w brakes the rotor. Energy is conserved at s = 1.

    The textbook model (Mellah 2016) heats the winding with k_ir w^2 without braking. Without knowledge of k_ir from
    temperature this is a twin of viscous friction: only their sum is seen.
    Bertotti (1988), General properties of power losses in soft ferromagnetic materials, doi:10.1109/20.43994.

    >>> from types import SimpleNamespace as At
    >>> round(IronLossTorque(s=0.9).torque(At(k_ir=0.007), At(w=200.0), None), 6)  # 0.9 0.007 200
    -1.26
    """

    excited_by: ClassVar[tuple[str, ...]] = ("coast_down", "no_load_steps")

    s: float = param(0.0, "1", "share of the iron loss that brakes", bounds=(0.0, 1.0), prior=1.0, null=0.0)

    def torque(self, m: Any, x: Any, u: Any) -> Any:
        return -self.s * m.k_ir * x.w
