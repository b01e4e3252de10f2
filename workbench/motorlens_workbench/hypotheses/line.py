"""A run linearised about a model, and how what the model lacks would show in its measured channels."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.forcing import Forcing
from motorlens_physics.estimate.model import (
    Model,
    changed_outputs,
    error_of,
    inputs_of,
    sensitivities_of,
    shown,
    through_sensors,
    true_outputs,
    with_sensor,
)
from motorlens_physics.estimate.run import Run
from motorlens_physics.sensitivity import Linearisation
from motorlens_physics.sensor_model import SensorModel
from motorlens_physics.simulation import Trajectory

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Line:
    """One run about a model, N samples of C channels.

    Attributes:
        model: linearised about.
        run: the recording, with its noise and its corrected inputs.
        r: its position among the runs.
        trajectory: simulated along the corrected inputs; its shaft angle is the known one, which does not drift.
        predicted: (N, C) what the sensors would show.
        error: (N, C) measured less predicted, beside the inputs as recorded.
        own: (N, C, p) sensitivities to `keys`.
        keys: the fitted parameters that concern this run.
        linear: the linearised motor.
    """

    model: Model
    run: Run
    r: int
    trajectory: Trajectory
    predicted: Array
    error: Array
    own: Array
    keys: tuple[str, ...]
    linear: Linearisation

    @classmethod
    def of(cls, model: Model, run: Run, r: int, keys: Sequence[str]) -> "Line":
        """Linearise a model along a run.

        Raises:
            ModelError: the simulation cannot go on.
        """
        mine = tuple(key for key in keys if "@" not in key or key.endswith(f"@{r}"))
        trajectory, predicted, own, linear = sensitivities_of(model, run, r, mine)
        error = error_of(model, run, r, run.measured - predicted, linear)
        if run.shaft is not None:
            trajectory = replace(trajectory, states={**trajectory.states, "phi": run.shaft})
        return cls(model, run, r, trajectory, predicted, error, own, mine, linear)

    def of_forcing(self, forcing: Forcing, *, held: bool | tuple[bool, bool, bool] = False) -> Array:
        """(N, C, k) what forcings of the balances, (N, k) each, would change in the channels."""
        voltage, torque, heat = (
            np.asarray(part, dtype=np.float64).reshape(len(self.error), -1)
            for part in (forcing.voltage, forcing.torque, forcing.heat)
        )
        return self.of_states(
            self.linear.respond(voltage_V=voltage, torque_Nm=torque, heat_W=heat, held=held)
        )

    def of_states(self, states: Mapping[str, Array]) -> Array:
        """(N, C, k) what states that are moved, (N, k) each, change in the channels."""
        moved = changed_outputs(self.model, self.run, self.linear, states)
        return through_sensors(self.model, self.run, self.r, moved)

    def of_sensor(self, sensor: SensorModel) -> Array:
        """(N, C, 1) what a sensor's fault of this size would change; zero where its channel was not recorded."""
        run, model = self.run, self.model
        if sensor.channel in run.channels:
            y = true_outputs(model, run, self.trajectory, self.linear)
            before = shown(model, run, self.r, y)
            return np.asarray(shown(with_sensor(model, sensor), run, self.r, y) - before)[:, :, None]
        if sensor.channel not in ("voltage", *run.known):
            return np.zeros((*self.error.shape, 1))
        there, here = inputs_of(with_sensor(model, sensor), run, self.r), self.trajectory.inputs
        moved = Forcing(
            there.voltage_V - here.voltage_V,
            here.load_torque_Nm - there.load_torque_Nm,
            np.zeros(len(self.error)),
        )
        return self.of_forcing(moved, held=here.hold)
