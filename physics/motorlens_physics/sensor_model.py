"""What a sensor model is: one frozen dataclass in one file of `sensors/`, standing between a quantity and its column.

A fault in a sensor competes with missing physics on equal terms, so sensor models have the shape of effects: parameters
with unit, bounds, prior and `null`. `read` gives what the sensor shows; the sensor's rate of change is handed in because a
lag needs it. For an input of the motor (voltage, load torque) the simulation applies `unread`, the inverse.
"""

import importlib
import pkgutil
import re
from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.parameter import Parameter, parameters

CHANNELS = ("voltage", "current", "speed", "temperature", "load_torque")
# The rated quantity that each channel measures, for the sizes of faults (see `Rated.scale`).
RATED_OF_CHANNEL = {
    "voltage": "voltage",
    "current": "current",
    "speed": "speed",
    "temperature": "rise",
    "load_torque": "torque",
}


@dataclass(frozen=True)
class SensorModel:
    """Base of all sensor models; an ideal sensor on `channel`, one of `CHANNELS`."""

    channel: str = "current"
    # Of what the parameters' `prior` is a multiple: "1" or "channel" (the channel's rated quantity).
    kind: ClassVar[str] = ""

    def name(self) -> str:
        """The name in the catalogue, such as `current_sensor_gain`."""
        return f"{self.channel}_sensor_{self.kind}"

    @classmethod
    def parameters(cls) -> dict[str, Parameter]:
        """The parameters by name."""
        return parameters(cls)

    def read(self, y: Any, rate: Any) -> Any:
        """What the sensor shows for the true value y, whose time derivative is `rate`."""
        return y

    def unread(self, shown: Any, rate: Any) -> Any:
        """The true value for what the sensor shows, whose time derivative is `rate`."""
        return shown


def kind_of(cls: type[SensorModel]) -> str:
    """`gain` for SensorGain: the class without its first word, in lower case with underscores."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__.removeprefix("Sensor")).lower()


def sensor_catalogue() -> dict[str, SensorModel]:
    """Every sensor model of the folder `sensors/` on every channel, at its defaults, by name."""
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
