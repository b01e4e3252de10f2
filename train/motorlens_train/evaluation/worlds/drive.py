"""What is driven, and with what it is measured: read off a motor file, in the shares of its rating plate."""

from dataclasses import dataclass

import numpy as np

from motorlens_physics.motor_file import MotorFile
from motorlens_train.evaluation.worlds.plant import Array, Constants


@dataclass(frozen=True)
class Drive:
    """A motor file as the worlds see it.

    Attributes:
        constants: the textbook part of the motor; the plant has no effects.
        rated_V, rated_A, rated_Nm, rise_K: of the plate.
        noise_V, noise_A: of a sample; the worlds' noise is in multiples of it.
        scale_V, scale_A: full scale of the converters.
        drop_V: what a brush drop may be that the file lacks.
        sizes: (3,) errors of speed, rise and resistance that matter to somebody: rad/s, K, ohm.
    """

    constants: Constants
    rated_V: float
    rated_A: float
    rated_Nm: float
    rise_K: float
    noise_V: float
    noise_A: float
    scale_V: float
    scale_A: float
    drop_V: float
    sizes: Array

    @staticmethod
    def of(file: MotorFile) -> "Drive":
        """The drive of a motor file: noise of 0.2 % and 0.7 % of the plate, converters for a quarter more than its voltage
        and for a tenth more than the current of a locked rotor, a drop of 1.5 V in 240 V."""
        m, plate = file.motor, file.rated
        constants = Constants(
            m.R_a0, m.L, m.ke, m.J, m.b, m.alpha, m.k0, m.kT, m.k_ir, m.H,
            turning=plate.speed_rad_s / 740, knee=plate.current_A / 73,
        )  # fmt: skip
        return Drive(
            constants, plate.voltage_V, plate.current_A, plate.torque_Nm, plate.rise_K, 0.002 * plate.voltage_V,
            0.007 * plate.current_A, 1.25 * plate.voltage_V, 1.1 * plate.voltage_V / m.R_a0, plate.voltage_V / 160,
            np.array([plate.speed_rad_s / 442, 1.0, m.R_a0 * m.alpha]),
        )  # fmt: skip
