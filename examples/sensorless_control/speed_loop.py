"""A speed loop without a tachometer, on the simulated motor.

    python examples/sensorless_control/speed_loop.py --sensor models/sensors/mellah2016_observer.onnx

Three things that a virtual sensor is for:

1. Speed: the loop is closed on the sensor's speed, and for comparison on the back-EMF (v - R i) / ke with the cold
   resistance, and on the true speed. Cold, and hot from an earlier run that the sensor knows nothing of.
2. Resistance: the current loop's gains by pole placement, Kp = a L and Ki = a R, with the cold R and with the estimated one.
   The current is to follow its reference as a first-order lag of 1/a.
3. Temperature: when the winding reaches its insulation class at the present load, said while it still can be prevented.

The sensor runs as its step graph, as on any host that has nothing but an ONNX runtime.
"""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnxruntime

from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile, read_motor_file
from motorlens_physics.simulation import Inputs, Stepper, simulate

ROOT = Path(__file__).resolve().parents[2]
PERIOD_S = 0.002
VOLTAGE_SD, CURRENT_SD = 0.5, 0.05
# Winding temperature at which each insulation class is used up (IEC 60085), degC.
INSULATION_C = {"B": 130.0, "F": 155.0, "H": 180.0}
# Bandwidth of the current loop and of the speed loop, rad/s.
CURRENT_BANDWIDTH, SPEED_BANDWIDTH = 60.0, 8.0


class VirtualSensor:
    """The step graph of a sensor file and its state."""

    def __init__(self, path: Path) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads, options.log_severity_level = 1, 3
        self._session = onnxruntime.InferenceSession(
            path.with_suffix(".step.onnx").read_bytes(), options, providers=["CPUExecutionProvider"]
        )
        self._state = np.zeros(self._session.get_inputs()[-1].shape[0])

    def step(self, voltage: float, current: float, dt: float) -> tuple[float, float, float]:
        """Speed (rad/s), rise of the winding (K) and resistance (ohm) after one more sample."""
        feed = {"voltage": np.array([voltage]), "current": np.array([current]), "dt": np.array([dt])}
        estimate, _, self._state = self._session.run(None, feed | {"state": self._state})
        speed, rise, resistance = (float(value) for value in estimate)
        return speed, rise, resistance


@dataclass(frozen=True)
class Run:
    """What happened: all (N,)."""

    time_s: np.ndarray
    wanted: np.ndarray
    speed: np.ndarray
    current: np.ndarray
    reference: np.ndarray
    resistance: np.ndarray


def drive(
    file: MotorFile, sensor: Path, rise_K: float, feedback: str, adaptive: bool, seconds: float, seed: int = 0
) -> Run:
    """Run the loop; `feedback` is "sensor", "back-EMF" or "tachometer"."""
    m, plate, rng = file.motor, file.rated, np.random.default_rng(seed)
    plant, virtual = Stepper(m, {"theta": rise_K}), VirtualSensor(sensor)
    rows = round(seconds / PERIOD_S)
    time = np.arange(rows) * PERIOD_S
    # A staircase of speeds; the load rises and falls in between, unknown to the controller.
    wanted = plate.speed_rad_s * np.array([0.3, 0.8, 0.5, 0.9])[(time // (seconds / 4)).astype(int) % 4]
    wanted[time < 0.2] = 0.0
    load = plate.torque_Nm * np.where((time // (seconds / 7)).astype(int) % 2 == 1, 1.0, 0.4)
    kp, ki = SPEED_BANDWIDTH * m.J / m.ke, SPEED_BANDWIDTH**2 * m.J / m.ke / 4
    kept = {name: np.zeros(rows) for name in ("speed", "current", "reference", "resistance")}
    voltage = integral_w = integral_i = 0.0
    resistance = m.R_a0
    for k in range(rows):
        truth = plant.step(voltage, float(load[k]) * (truth_sign(plant)), plate.ambient_C, PERIOD_S)
        shown = truth["i"] + CURRENT_SD * rng.standard_normal()
        seen_w, _, seen_R = virtual.step(voltage + VOLTAGE_SD * rng.standard_normal(), shown, PERIOD_S)
        speed = {"sensor": seen_w, "back-EMF": (voltage - m.R_a0 * shown) / m.ke, "tachometer": truth["w"]}[
            feedback
        ]
        if adaptive:
            # A resistance is trusted within what copper can do between frost and the end of its insulation.
            resistance += 0.01 * (float(np.clip(seen_R, 0.9 * m.R_a0, 1.7 * m.R_a0)) - resistance)
        error_w = wanted[k] - speed
        reference = float(np.clip(kp * error_w + integral_w, -4 * plate.current_A, 4 * plate.current_A))
        if abs(reference) < 4 * plate.current_A:
            integral_w += ki * error_w * PERIOD_S
        error_i = reference - shown
        asked = CURRENT_BANDWIDTH * m.L * error_i + integral_i + m.ke * speed
        voltage = float(np.clip(asked, -1.1 * plate.voltage_V, 1.1 * plate.voltage_V))
        if asked == voltage:
            integral_i += CURRENT_BANDWIDTH * resistance * error_i * PERIOD_S
        for name, value in (
            ("speed", truth["w"]),
            ("current", truth["i"]),
            ("reference", reference),
            ("resistance", seen_R),
        ):
            kept[name][k] = value
    return Run(time, wanted, **kept)


def truth_sign(plant: Stepper) -> float:
    """The load is a brake: it follows the direction of the motion."""
    return -1.0 if plant.states["w"] < 0 else 1.0


def steady_error(run: Run) -> float:
    """Root mean square speed error in the last third of every step."""
    quarter = run.time_s[-1] / 4
    late = (run.time_s % quarter) > 2 * quarter / 3
    return float(np.sqrt(np.mean((run.speed - run.wanted)[late] ** 2)))


def current_error(run: Run) -> float:
    """Root mean square distance of the current from the first-order lag that was asked for."""
    lagged, state = np.empty_like(run.reference), 0.0
    decay = np.exp(-CURRENT_BANDWIDTH * PERIOD_S)
    for k, reference in enumerate(run.reference):
        state = reference + (state - reference) * decay
        lagged[k] = state
    return float(np.sqrt(np.mean((run.current - lagged)[run.time_s > 1] ** 2)))


def time_to_limit(m: Motor, limit_K: float, rise: float, speed: float, current: float) -> float:
    """Seconds until the winding reaches `limit_K` at this speed and current; infinity if it never does.

    H dtheta/dt = q - c theta with q and c constant at constant load.
    """
    q = m.R_a0 * current**2 + m.k_ir * speed**2
    c = m.k0 * (1 + m.kT * abs(speed)) - m.R_a0 * m.alpha * current**2
    end = q / c
    if rise >= limit_K:
        return 0.0
    if c > 0 and end <= limit_K:
        return float("inf")
    return float(m.H / c * np.log((end - rise) / (end - limit_K)))


def protect(file: MotorFile, sensor: Path, overload: float, seconds: float) -> None:
    """Start cold into an overload and say when each insulation class is used up, beside when it really is."""
    m, plate, rng = file.motor, file.rated, np.random.default_rng(1)
    time = np.arange(0.0, 4 * 3600.0, 1.0)
    ones = np.ones_like(time)
    future = simulate(
        m,
        Inputs(
            time, plate.voltage_V * ones, overload * plate.torque_Nm * ones, plate.ambient_C * ones, held=True
        ),
    )
    rows = round(seconds / PERIOD_S)
    fine = np.arange(rows) * PERIOD_S
    start = simulate(
        m, Inputs(fine, np.where(fine < 0.1, 0.0, plate.voltage_V), np.full(rows, overload * plate.torque_Nm),
                  np.full(rows, plate.ambient_C), held=True),
    )  # fmt: skip
    virtual, smooth = VirtualSensor(sensor), np.zeros(2)
    rise = 0.0
    for k in range(rows):
        v = start.inputs.voltage_V[k] + VOLTAGE_SD * rng.standard_normal()
        i = start.current_A[k] + CURRENT_SD * rng.standard_normal()
        speed, rise, _ = virtual.step(v, i, PERIOD_S)
        smooth += (np.array([speed, i]) - smooth) * PERIOD_S / 0.5
    print(
        f"after {seconds:.0f} s at {overload:.1f} x rated torque: {rise:.1f} K by the sensor, "
        f"{start.rise_K[-1]:.1f} K in truth"
    )
    for name, limit in INSULATION_C.items():
        said = time_to_limit(m, limit - plate.ambient_C, rise, float(smooth[0]), float(smooth[1]))
        hot = future.temperature_C >= limit
        true = float(time[np.argmax(hot)]) - seconds if hot.any() else float("inf")
        print(
            f"  class {name} ({limit:.0f} degC): in {said / 60:6.1f} min by the sensor, {true / 60:6.1f} min in truth"
        )


def main() -> int:
    """Run all three and print what came of them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--motor", type=Path, default=ROOT / "models/motors/mellah2016.toml")
    parser.add_argument("--sensor", type=Path, default=ROOT / "models/sensors/mellah2016_observer.onnx")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each run of the loop")
    arguments = parser.parse_args()
    file = read_motor_file(arguments.motor)
    print(f"{'':<8}{'speed from':<14}{'gains':<10}{'speed error, steady':>22}{'current off its lag':>22}")
    for state, rise in (("cold", 0.0), ("hot", file.rated.rise_K)):
        for feedback, adaptive in (
            ("tachometer", False),
            ("back-EMF", False),
            ("sensor", False),
            ("sensor", True),
        ):
            run = drive(file, arguments.sensor, rise, feedback, adaptive, arguments.seconds)
            gains = "adaptive" if adaptive else "fixed"
            print(
                f"{state:<8}{feedback:<14}{gains:<10}{steady_error(run):>16.3f} rad/s{current_error(run):>20.4f} A"
            )
    print()
    protect(file, arguments.sensor, overload=1.5, seconds=30.0)
    return 0


if __name__ == "__main__":
    sys.exit(main())
