"""The methods a virtual sensor must beat, one in each file: known estimators, done as well as they can be."""

from motorlens_train.baselines.extended_kalman import ExtendedKalman
from motorlens_train.baselines.method import Estimate, Method
from motorlens_train.baselines.perceptron import Perceptron
from motorlens_train.baselines.resistance_thermometer import ResistanceThermometer
from motorlens_train.baselines.steady_state_voltage import SteadyStateVoltage
from motorlens_train.baselines.thermal_observer import ThermalObserver
from motorlens_train.baselines.two_step_kalman import TwoStepKalman

__all__ = [
    "Estimate", "ExtendedKalman", "Method", "Perceptron", "ResistanceThermometer", "SteadyStateVoltage", "ThermalObserver",
    "TwoStepKalman", "methods",
]  # fmt: skip


def methods() -> dict[str, Method]:
    """All baselines by name, not yet fitted, from the simplest to the strongest."""
    return {
        "steady-state voltage": SteadyStateVoltage(),
        "resistance thermometer": ResistanceThermometer(),
        "thermal observer": ThermalObserver(),
        "two-step Kalman": TwoStepKalman(),
        "perceptron": Perceptron(),
        "extended Kalman": ExtendedKalman(),
    }
