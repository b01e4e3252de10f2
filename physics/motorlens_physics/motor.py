"""The textbook motor: three balances, and the sum of the effects in each.

Mellah, Hemsas and Taleb (2016), doi:10.14569/IJACSA.2016.070731, equations (1) to (9), after Acarnley and Al-Tayie
(1997), doi:10.1049/ip-epa:19970927. Equation (9) of the paper prints T_l/H in the speed equation; the torque balance
(2) gives T_l/J, which is what stands here. Cooling uses |w|: the paper's motor turns one way only.

The paper's iron loss k_ir w^2 heats without braking, so its model creates energy; the effect `iron_loss_torque` adds
the brake that belongs to it.
"""

from dataclasses import dataclass, replace
from typing import Any

from motorlens_physics.effect import Effect, State
from motorlens_physics.ops import turning
from motorlens_physics.parameter import param
from motorlens_runtime.errors import ModelError

# Armature current (A), speed (rad/s), rise of the winding above ambient (K).
TEXTBOOK_STATES = ("i", "w", "theta")


@dataclass(frozen=True)
class Motor:
    """L di/dt = v - R i - ke w,  J dw/dt = ke i - b w - T_load,  H dtheta/dt = R i^2 + k_ir w^2 - k0 (1 + kT |w|) theta.

    R = R_a0 (1 + alpha theta); theta is the rise of the winding above ambient, in K. Parameters may be floats, arrays
    (a batch of motors), SymPy symbols or quantities with units. `effects` add to the right-hand sides.
    """

    R_a0: float = param(
        3.5,
        "ohm",
        "armature resistance at ambient temperature",
        bounds=(1e-4, 1e4),
        prior=0.3,
        of="voltage/current",
    )
    L: float = param(0.034, "H", "armature inductance", bounds=(0.0, 10.0), prior=0.001, of="voltage/current")
    ke: float = param(
        0.9346, "V*s/rad", "back-EMF and torque constant", bounds=(1e-6, 1e3), prior=0.9, of="voltage/speed"
    )
    J: float = param(
        0.0328,
        "kg*m^2",
        "moment of inertia, rotor and load",
        bounds=(1e-9, 1e4),
        prior=0.5,
        of="torque/speed",
    )
    b: float = param(
        0.00154, "N*m*s/rad", "viscous friction", bounds=(0.0, 1e2), prior=0.05, of="torque/speed"
    )
    alpha: float = param(
        0.004, "1/K", "temperature coefficient of the winding's resistance", bounds=(0.0, 0.01), prior=0.0039
    )
    k0: float = param(
        4.33, "W/K", "thermal conductance to ambient at rest", bounds=(1e-5, 1e4), prior=0.1, of="power/rise"
    )
    kT: float = param(
        0.0028,
        "s/rad",
        "relative growth of the conductance with speed",
        bounds=(0.0, 1.0),
        prior=0.6,
        of="1/speed",
    )
    k_ir: float = param(
        0.00667, "W*s^2/rad^2", "iron loss constant", bounds=(0.0, 1e2), prior=0.1, of="power/speed^2"
    )
    H: float = param(18e3, "J/K", "heat capacity", bounds=(1e-4, 1e8), prior=500.0, of="power/rise")
    effects: tuple[Effect, ...] = ()

    @property
    def response_s(self) -> float:
        """How long the shaft takes to follow a voltage or a torque, driven by a voltage: the mechanical time constant."""
        return self.J * self.R_a0 / self.ke**2

    def resistance(self, theta: Any) -> Any:
        """Armature resistance at a winding rise theta (K), in ohm."""
        return self.R_a0 * (1 + self.alpha * theta)

    def inductance(self, x: Any, u: Any) -> Any:
        """The inductance that stands before di/dt, effects included, in H."""
        L = self.L
        for effect in self.effects:
            L = L + effect.inductance(self, x, u)
        return L

    def friction_power(self, x: Any, u: Any) -> Any:
        """What friction takes from the shaft, viscous and that of the effects, in W."""
        power = self.b * x.w**2
        for effect in self.effects:
            if effect.friction:
                power = power - effect.torque(self, x, u) * x.w
        return power

    def balances(self, x: Any, u: Any) -> tuple[Any, Any, Any]:
        """Right-hand sides of the three balances: voltage (V), torque (N m), heat (W), effects included."""
        R = self.resistance(x.theta)
        cooling = self.k0 * (1 + self.kT * turning(x.w)) * x.theta
        voltage = u.v - R * x.i - self.ke * x.w
        torque = self.ke * x.i - self.b * x.w - u.load
        heat = R * x.i**2 + self.k_ir * x.w**2 - cooling
        for effect in self.effects:
            voltage = voltage + effect.voltage(self, x, u)
            torque = torque + effect.torque(self, x, u)
            heat = heat + effect.heat(self, x, u)
        return voltage, torque, heat

    def rates(self, x: Any, u: Any) -> dict[str, Any]:
        """Time derivatives of all states: i (A/s), w (rad/s^2), theta (K/s) and those the effects bring."""
        voltage, torque, heat = self.balances(x, u)
        rates = {"i": voltage / self.inductance(x, u), "w": torque / self.J, "theta": heat / self.H}
        for effect in self.effects:
            rates |= effect.rates(self, x, u)
        return rates

    def states(self) -> dict[str, float]:
        """Names of all states and where they start unless told otherwise: at rest, at ambient temperature.

        Raises:
            ModelError: two effects use one name for different states.
        """
        extra: dict[str, State] = {}
        for effect in self.effects:
            for name, state in effect.states.items():
                if name in TEXTBOOK_STATES or extra.setdefault(name, state) != state:
                    raise ModelError(
                        f"{effect.name()} brings a state {name!r} that means something else in this motor"
                    )
        return dict.fromkeys(TEXTBOOK_STATES, 0.0) | {name: state.initial for name, state in extra.items()}

    def effect(self, name: str) -> Effect | None:
        """The effect of that name, or None if the motor has it not."""
        return next((effect for effect in self.effects if effect.name() == name), None)

    def with_effect(self, effect: Effect) -> "Motor":
        """This motor with the effect added, or put in the place of its namesake."""
        others = tuple(other for other in self.effects if other.name() != effect.name())
        return replace(self, effects=(*others, effect))

    def without_effect(self, name: str) -> "Motor":
        """This motor without the effect of that name."""
        return replace(self, effects=tuple(effect for effect in self.effects if effect.name() != name))
