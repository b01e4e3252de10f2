"""What a sensor model is: one frozen dataclass in one file of `sensors/`, standing between a quantity and its column.

A fault in a sensor competes with missing physics on equal terms, so sensor models have the shape of effects: parameters
with unit, bounds, prior and a switch with a `null`. `read` is pointwise and smooth, for gradients; `record` makes a whole
column, where order and randomness matter. For an input of the motor (voltage, load torque) `unrecord` is the
inverse.

A model without a switch (noise, quantisation, clipping, a dead channel) is for simulation only: it says how good a column
is, not what is missing from a model.
"""

import importlib
import pkgutil
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.parameter import Parameter, Rated, parameters

Array = NDArray[np.float64]

CHANNELS = ("voltage", "current", "speed", "temperature", "load_torque")
# The rated quantity that each channel measures, for the sizes of faults (see `Rated.scale`).
RATED_OF_CHANNEL = {
    "voltage": "voltage",
    "current": "current",
    "speed": "speed",
    "temperature": "rise",
    "load_torque": "torque",
}
# The unit of each channel; a temperature is in degC, a difference of temperatures in K.
UNIT_OF_CHANNEL = {"voltage": "V", "current": "A", "speed": "rad/s", "temperature": "K", "load_torque": "N*m"}
# How a quantity comes to its column: the sensing element, its amplifier, what disturbs the line, the converter, the logger.
CHAIN = ("lag", "gain", "offset", "noise", "clipping", "quantisation", "dead")


@dataclass(frozen=True)
class SensorModel:
    """Base of all sensor models; an ideal sensor on `channel`, one of `CHANNELS`.

    A parameter declared in the unit "channel" is in that of the channel, and one whose prior is a multiple of "channel"
    is a share of the channel's rated quantity.
    """

    channel: str = "current"
    # The last word of the name, such as "gain".
    kind: ClassVar[str] = ""
    # Names of the scenarios of `motorlens simulate` that make the fault visible, the best first.
    excited_by: ClassVar[tuple[str, ...]] = ()

    def name(self) -> str:
        """The name in the catalogue, such as `current_sensor_gain`."""
        return f"{self.channel}_sensor_{self.kind}"

    def parameters(self) -> dict[str, Parameter]:
        """The parameters by name, in the unit of the channel."""
        return {name: self._on_channel(parameter) for name, parameter in parameters(self).items()}

    def switch(self) -> Parameter | None:
        """The parameter that switches the fault on: the one with a `null`; None for a model that only simulates."""
        return next((p for p in self.parameters().values() if p.null is not None), None)

    def at_null(self, rated: Rated) -> Self:
        """The model switched off, an ideal sensor; one that only simulates stays at its typical size."""
        off: dict[str, Any] = {p.name: p.null for p in self.parameters().values() if p.null is not None}
        return replace(self.typical(rated), **off)

    def typical(self, rated: Rated) -> Self:
        """The model at its typical size for a motor of this rating plate."""
        values: dict[str, Any] = {name: p.typical(rated) for name, p in self.parameters().items()}
        return replace(self, **values)

    def read(self, y: Any, rate: Any) -> Any:
        """What the sensor shows for the true value y, whose time derivative is `rate`."""
        return y

    def record(self, time_s: Array, y: Array, rng: np.random.Generator) -> Array:
        """What the sensor shows of the true samples y[N] taken at time_s[N]; randomness comes from `rng`."""
        return np.asarray(self.read(y, np.zeros_like(y)), dtype=np.float64)

    def unrecord(self, time_s: Array, shown: Array) -> Array:
        """The true samples y[N] for what the sensor shows at time_s[N], its noise apart."""
        return shown

    def _on_channel(self, parameter: Parameter) -> Parameter:
        unit, of = UNIT_OF_CHANNEL[self.channel], RATED_OF_CHANNEL[self.channel]
        return replace(
            parameter,
            unit=unit if parameter.unit == "channel" else parameter.unit,
            of=of if parameter.of == "channel" else parameter.of,
        )


def in_chain(sensors: Iterable[SensorModel]) -> tuple[SensorModel, ...]:
    """Sensor models in the order in which they act, whatever the order in which they were found, see `CHAIN`.

    A sensor of a gain and an offset shows gain y + offset. What the chain does not name comes last.
    """
    return tuple(sorted(sensors, key=lambda sensor: (*CHAIN, sensor.kind).index(sensor.kind)))


def sensor_models() -> dict[str, SensorModel]:
    """Every sensor model of the folder `sensors/` on every channel, by name, those that only simulate included."""
    from motorlens_physics import sensors

    found: dict[str, SensorModel] = {}
    for info in pkgutil.iter_modules(sensors.__path__):
        module = importlib.import_module(f"{sensors.__name__}.{info.name}")
        for thing in vars(module).values():
            if (
                isinstance(thing, type)
                and issubclass(thing, SensorModel)
                and thing.__module__ == module.__name__
            ):
                found |= {model.name(): model for model in (thing(channel=channel) for channel in CHANNELS)}
    return dict(sorted(found.items()))


def sensor_catalogue() -> dict[str, SensorModel]:
    """The sensor faults that a diagnosis considers, by name: every model with a switch, ideal, on every channel."""
    return {name: model for name, model in sensor_models().items() if model.switch() is not None}
