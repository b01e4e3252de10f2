"""The physics observer inside a sensor: an extended Kalman filter in integral form, recorded as straight-line programs.

Both voltage and current are measured, so the current is an input here, and the electrical balance, integrated over a window
of `period_s`, is the measurement:

    mean v - L (i_end - i_start) / T = R(theta) mean i + ke w - effects

It holds whatever happens between the samples, it needs no current state, and L may be zero. The states are w, theta, those
that effects bring, the load torque, and parameters that differ from motor to motor. Rates and Jacobians are those of
the motor's own equations; every state is stepped exactly in its own derivative.

A load is constant until it jumps. Two branches run side by side, one in which it stands still and one in which it changes,
each weighed by how well it foretold the voltage (interacting multiple models; Blom and Bar-Shalom 1988,
doi:10.1109/9.1299): a jump is believed as far as it is borne out, and between jumps the filter may be sure of the load.
Near standstill the second is a rotor that rests, held by whatever load its torque asks for: what it takes is then its
resistance's alone, and shows how warm it is (the locked-rotor test).

Three programs: `accumulate` at every sample, `correct` when a window is full, `read` when a value is asked for. The state is
stored as its distance from the start, so that a state of zeros is a fresh observer.
"""

from dataclasses import replace

from motorlens_physics.motor_file import MotorFile
from motorlens_train.observer.correction import correct
from motorlens_train.observer.file import Observer
from motorlens_train.observer.layout import Layout, ObserverSettings
from motorlens_train.observer.reading import read
from motorlens_train.observer.samples import accumulate
from motorlens_train.specification import Bank, Feature

__all__ = ["ObserverSettings", "observer", "with_observer"]


def observer(file: MotorFile, settings: ObserverSettings = ObserverSettings()) -> Observer:  # noqa: B008 -- frozen
    """The observer of a motor: its textbook part and its effects (those that need the shaft angle left out)."""
    layout = Layout(file, settings)
    outputs, program = read(layout)
    return Observer(
        layout.period,
        layout.size,
        accumulate(layout),
        correct(layout),
        program,
        outputs,
        float(layout.rated.ambient_C),
    )


def with_observer(
    bank: Bank,
    file: MotorFile,
    settings: ObserverSettings = ObserverSettings(),  # noqa: B008 -- frozen
) -> Bank:
    """A feature bank beside which the observer of a motor runs: its outputs are further features."""
    added = observer(file, settings)
    features = tuple(Feature("observer", filters=(k,)) for k in range(len(added.outputs)))
    return replace(bank, observer=added, features=(*bank.features, *features))
