"""What can be hidden: the physics of the catalogue, sensor faults, and physics that is in no catalogue.

The names, and for the catalogue the constitutive laws, are those a user reads in `motorlens effects`; the code is not.
Sizes are stated in the unit of the catalogue's first parameter, so that a reported size can be compared.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from helpers.hidden.motors import HiddenMotor

CHANNELS = ("voltage", "current", "speed", "temperature", "load_torque")
FAULTS = ("gain", "offset", "lag")


@dataclass(frozen=True)
class HiddenEffect:
    """One thing that can be hidden.

    Attributes:
        name: as in the catalogue, or a name of ours if it is in none.
        equation: electrical, coupling, mechanical or thermal.
        key: the plant's parameter that holds the size; "" if the size is a course of an input (`inputs`).
        parameter: the catalogue's name of that parameter; "" outside the catalogue.
        typical, largest: sizes as multiples of `unit(motor)`.
        of: powers of rated quantities that make the unit, such as {"torque": 1, "speed": -2}.
        null: the size at which it vanishes.
        either: the sign may be negative.
        needs: of "heat" (a slow record), "fast", "slow" (that record alone), "angle", "load", "reversal".
    """

    name: str
    equation: str
    key: str
    parameter: str
    typical: float
    largest: float
    of: Mapping[str, int]
    null: float = 0.0
    either: bool = False
    needs: tuple[str, ...] = ()

    def unit(self, motor: HiddenMotor) -> float:
        """What sizes are multiples of for this motor, in the unit of `parameter`."""
        rated = {
            "voltage": motor.voltage_V, "current": motor.current_A, "speed": motor.speed_rad_s,
            "torque": motor.torque_Nm, "rise": motor.rise_K, "power": motor.voltage_V * motor.current_A,
            "inductance": motor.textbook["L"],
        }  # fmt: skip
        return float(np.prod([rated[name] ** power for name, power in self.of.items()]))


_H, _F, _A, _B = ("heat",), ("fast",), ("fast", "angle"), ("fast", "fast_only", "reversal")
_OHM = {"voltage": 1, "current": -1}
CATALOGUE = {
    effect.name: effect
    for effect in (
        HiddenEffect("brush_voltage_drop", "electrical", "brush_V", "V_b", 0.02, 0.15, {"voltage": 1}),
        HiddenEffect("inductance_saturation", "electrical", "L_sat", "s", 0.05, 1.0, {"current": -2}, needs=_F),
        HiddenEffect("contact_resistance", "electrical", "K_B", "K_B", 0.01, 0.1, _OHM | {"speed": -1}),
        HiddenEffect("dead_time", "electrical", "dead_V", "V_dt", 0.02, 0.15, {"voltage": 1}),
        HiddenEffect("supply_resistance", "electrical", "supply_R", "R_s", 0.01, 0.1, _OHM, needs=_H),
        HiddenEffect("coasting_bridge", "electrical", "coasting", "s", 0.3, 1.0, {}),
        HiddenEffect("magnet_temperature", "coupling", "magnet_k", "beta", 0.002, 0.006, {}, needs=_H),
        HiddenEffect("armature_reaction", "coupling", "reaction", "s", 0.03, 0.3, {"current": -2}),
        HiddenEffect("commutation_ripple", "coupling", "ripple", "eps", 0.05, 0.15, {}, needs=_A),
        HiddenEffect("coulomb_friction", "mechanical", "tau_c", "tau_c", 0.03, 0.3, {"torque": 1}),
        HiddenEffect("stribeck_friction", "mechanical", "tau_s", "tau_s", 0.03, 0.2, {"torque": 1}, needs=_F),
        HiddenEffect("quadratic_drag", "mechanical", "drag", "c", 0.03, 0.4, {"torque": 1, "speed": -2}),
        HiddenEffect("load_dependent_friction", "mechanical", "mu", "mu", 0.05, 0.3, {}, needs=("load",)),
        HiddenEffect("directional_friction", "mechanical", "tau_d", "tau_d", 0.02, 0.2, {"torque": 1}, needs=("reversal",)),
        HiddenEffect("temperature_dependent_viscosity", "mechanical", "kappa", "kappa", 0.01, 0.05, {}, needs=_H),
        HiddenEffect("cogging_torque", "mechanical", "cog", "A", 0.03, 0.3, {"torque": 1}, needs=_A),
        HiddenEffect("unbalance_torque", "mechanical", "unbalance", "A", 0.03, 0.3, {"torque": 1}, needs=_A),
        HiddenEffect("iron_loss_torque", "mechanical", "iron_brake", "s", 0.5, 1.0, {}, needs=_H),
        HiddenEffect("constant_torque", "mechanical", "tau_0", "tau_0", 0.03, 0.3, {"torque": 1}, either=True),
        HiddenEffect("stray_load_loss", "mechanical", "stray", "c", 0.02, 0.2, {"torque": 1, "speed": -1, "current": -2}),
        HiddenEffect("two_node_thermal", "thermal", "node_G", "G_h", 0.1, 1.0, {"power": 1, "rise": -1}, needs=_H),
        HiddenEffect("radiation", "thermal", "radiation", "G_r", 0.05, 0.3, {"power": 1, "rise": -1}, needs=_H),
        HiddenEffect("friction_heat", "thermal", "friction_heat", "s", 0.5, 1.0, {}, needs=_H),
        HiddenEffect("hysteresis_iron_loss", "thermal", "hysteresis", "k_h", 0.03, 0.2, {"torque": 1}),
        HiddenEffect("fan_cooling_exponent", "thermal", "fan_n", "n", 0.3, 0.7, {}, 1.0, True, _H),
        HiddenEffect("ambient_drift", "thermal", "", "d", 5.0, 25.0, {}, either=True, needs=_H),
        HiddenEffect("iron_heat_delay", "thermal", "delay", "s", 0.5, 1.0, {}, needs=_H),
    )
}  # fmt: skip

OUTSIDE = {
    effect.name: effect
    for effect in (
        HiddenEffect("friction_bump", "mechanical", "bump", "", 0.1, 0.6, {"torque": 1}),
        HiddenEffect("brush_bounce", "electrical", "bounce_R", "", 0.2, 3.0, _OHM),
        HiddenEffect("thermostat_fan", "thermal", "thermostat", "", 1.0, 4.0, {}, needs=_H),
        HiddenEffect("shaft_backlash", "mechanical", "shaft_gap", "", 0.1, 3.0, {}, needs=_B),
        HiddenEffect("demagnetisation_step", "coupling", "", "", 0.05, 0.4, {}),
        HiddenEffect("loose_connector", "electrical", "", "", 0.1, 1.0, {"voltage": 1, "current": -1}),
        HiddenEffect("speed_dependent_inductance", "electrical", "L_speed", "", 0.3, 0.6, {"speed": -1}, needs=_F),
        HiddenEffect("soft_presliding", "mechanical", "bristle_tau", "", 0.05, 0.4, {"torque": 1}, needs=_B),
        HiddenEffect("running_in", "mechanical", "run_in", "", 0.1, 0.5, {"torque": 1}),
    )
}  # fmt: skip

_FAULT = {"gain": (0.03, 0.15, True), "offset": (0.02, 0.15, True), "lag": (1.0, 8.0, False)}
# Typical time constants of a lagging sensor in s.
_LAG = {"voltage": 1e-3, "current": 1e-3, "speed": 1e-2, "temperature": 30.0, "load_torque": 2e-2}


def sensor_faults(motor: HiddenMotor) -> dict[str, HiddenEffect]:
    """`<channel>_sensor_<fault>` for every channel; a gain's size is its distance from 1, a lag's is in s."""
    faults = {}
    for channel in CHANNELS:
        for kind in FAULTS:
            typical, largest, either = _FAULT[kind]
            unit = {"gain": 1.0, "offset": motor.scale(channel), "lag": _LAG[channel]}[kind]
            name = f"{channel}_sensor_{kind}"
            needs = {"load_torque": ("load",)}.get(channel, ())
            if kind == "lag":
                needs += ("heat",) if channel == "temperature" else ("fast",)
            elif channel == "temperature":
                needs += ("heat",)
            parameter = {"gain": "gain", "offset": "offset", "lag": "tau"}[kind]
            faults[name] = HiddenEffect(
                name,
                channel,
                f"{channel}:{kind}",
                parameter,
                typical * unit,
                largest * unit,
                {},
                0.0,
                either,
                needs,
            )
    return faults


SENSOR_NAMES = tuple(f"{channel}_sensor_{kind}" for channel in CHANNELS for kind in FAULTS)


def lookup(name: str, motor: HiddenMotor) -> HiddenEffect:
    """The effect of that name for this motor."""
    return CATALOGUE.get(name) or OUTSIDE.get(name) or sensor_faults(motor)[name]


def shape(name: str, motor: HiddenMotor, rng: np.random.Generator) -> dict[str, float]:
    """Draw the parameters that shape an effect, by name of the plant's parameters (`drift_tau` etc.: of the inputs)."""
    w, i = motor.speed_rad_s, motor.current_A
    draws: dict[str, dict[str, float]] = {
        "brush_voltage_drop": {"brush_i": 0.02 * i},
        "dead_time": {"dead_i": 0.05 * i},
        "coasting_bridge": {"bus_V": motor.voltage_V},
        "stribeck_friction": {"w_k": w * rng.uniform(0.015, 0.06)},
        "cogging_torque": {"cog_N": 12.0, "cog_p": rng.uniform(-3.1, 3.1)},
        "unbalance_torque": {"unbalance_p": rng.uniform(-3.1, 3.1)},
        "commutation_ripple": {"ripple_N": 6.0, "ripple_p": rng.uniform(-3.1, 3.1)},
        "magnet_temperature": {
            "magnet_f": 0.7,
            "magnet_tau": motor.textbook["H"] / motor.textbook["k0"] * rng.uniform(0.5, 2),
        },
        "two_node_thermal": {
            "node_k": motor.textbook["k0"] * rng.uniform(0.5, 1.5),
            "node_H": motor.textbook["H"] * rng.uniform(1.5, 4),
        },
        "radiation": {"ambient_K": motor.ambient_C + 273.15},
        "fan_cooling_exponent": {"fan_w": w},
        "ambient_drift": {"drift_tau": rng.uniform(900, 3600)},
        "iron_heat_delay": {"delay_tau": rng.uniform(60, 300)},
        "friction_bump": {"bump_w": w * rng.uniform(0.25, 0.6), "bump_width": w * rng.uniform(0.03, 0.09)},
        "brush_bounce": {"bounce_w": w * rng.uniform(0.45, 0.7)},
        "thermostat_fan": {"thermostat_on": motor.rise_K * rng.uniform(0.3, 0.5)},
        "shaft_backlash": {"shaft_share": rng.uniform(0.3, 0.6), "shaft_hz": rng.uniform(15, 40)},
        "demagnetisation_step": {"step_at": rng.uniform(0.3, 0.6)},
        "loose_connector": {"contact_s": rng.uniform(0.02, 0.05), "contact_share": rng.uniform(0.1, 0.25)},
        "soft_presliding": {"presliding_rad": rng.uniform(0.5, 2.0)},
        "running_in": {"run_in_share": rng.uniform(0.15, 0.4)},
    }  # fmt: skip
    return draws.get(name, {})
