"""Three motors two decades of power apart, and the datasheets that `motorlens diagnose --motor` reads.

The datasheet holds the nominal values; the motor in hand is off by up to 20 % in every one (copper's temperature
coefficient by 2 %).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

# Textbook parameters: unit, tolerance of the datasheet.
TEXTBOOK = {
    "R": ("ohm", 0.2), "L": ("H", 0.2), "ke": ("V*s/rad", 0.2), "J": ("kg*m^2", 0.2), "b": ("N*m*s/rad", 0.2),
    "alpha": ("1/K", 0.02), "k0": ("W/K", 0.2), "kT": ("s/rad", 0.2), "k_ir": ("W*s^2/rad^2", 0.2), "H": ("J/K", 0.2),
}  # fmt: skip


@dataclass(frozen=True)
class HiddenMotor:
    """A motor's rating plate and nominal textbook parameters, SI."""

    name: str
    voltage_V: float
    current_A: float
    speed_rad_s: float
    torque_Nm: float
    rise_K: float
    textbook: dict[str, float]
    ambient_C: float = 20.0

    def drawn(self, rng: np.random.Generator) -> dict[str, float]:
        """The parameters of one specimen."""
        return {
            name: value * (1 + TEXTBOOK[name][1] * rng.uniform(-1, 1))
            for name, value in self.textbook.items()
        }

    def scale(self, channel: str) -> float:
        """What noise and offsets of a channel are shares of."""
        return {
            "voltage": self.voltage_V, "current": self.current_A, "speed": self.speed_rad_s,
            "temperature": 30.0, "load_torque": self.torque_Nm,
        }[channel]  # fmt: skip

    def datasheet(self) -> str:
        """The motor file: nominal values, with the standard deviation of their tolerance."""
        lines = [
            'schema = "motorlens.motor/1"', f'name = "{self.name}"', "", "[rated]", f"voltage_V = {self.voltage_V!r}",
            f"current_A = {self.current_A!r}", f"speed_rad_s = {self.speed_rad_s!r}", f"torque_Nm = {self.torque_Nm!r}",
            f"rise_K = {self.rise_K!r}", f"ambient_C = {self.ambient_C!r}", "", "[parameters]",
        ]  # fmt: skip
        for name, value in self.textbook.items():
            unit, tolerance = TEXTBOOK[name]
            key = {"R": "R_a0"}.get(name, name)
            sd = value * tolerance / np.sqrt(3)  # of a uniform distribution
            lines.append(
                f'{key} = {{ value = {value!r}, unit = "{unit}", sd = {sd:.4g}, source = "datasheet" }}'
            )
        return "\n".join(lines) + "\n"

    def write_datasheet(self, path: Path) -> Path:
        """Write the motor file."""
        path.write_text(self.datasheet(), encoding="utf-8")
        return path


# The 3 kW frame of Mellah, Hemsas and Taleb (2016), a 24 V servo motor and a 12 V gear motor of usual proportions.
MOTORS = {
    motor.name: motor
    for motor in (
        HiddenMotor("frame_240V", 240.0, 7.27, 221.0, 6.455, 80.0, {
            "R": 3.5, "L": 0.034, "ke": 0.9346, "J": 0.0328, "b": 0.00154, "alpha": 0.004, "k0": 4.33, "kT": 0.0028,
            "k_ir": 0.00667, "H": 18e3}),
        HiddenMotor("servo_24V", 24.0, 8.0, 308.0, 0.5, 60.0, {
            "R": 0.5, "L": 0.5e-3, "ke": 0.065, "J": 6e-5, "b": 8e-5, "alpha": 0.0039, "k0": 0.52, "kT": 0.0015,
            "k_ir": 5.3e-5, "H": 400.0}),
        HiddenMotor("gear_12V", 12.0, 0.9, 440.0, 0.0172, 50.0, {
            "R": 4.0, "L": 2.5e-3, "ke": 0.02, "J": 2.5e-6, "b": 2e-6, "alpha": 0.0039, "k0": 0.066, "kT": 0.0008,
            "k_ir": 2.5e-6, "H": 40.0}),
    )
}  # fmt: skip
