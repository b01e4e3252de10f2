"""Everything that may be missing, as forcings of the balances along the trajectory of the present model.

An effect enters the linearised problem as what it would add to the three balances, per typical size, evaluated on the
trajectory by the effect's own methods (a secant from null to typical, so that effects whose first order vanishes, such as a
housing node, are seen). Effects with a state of their own have it integrated along. Shapes that are not known are tried on
a small grid. Sensor faults and decoys stand in the same list.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.effect import Effect, catalogue
from motorlens_physics.estimate.forcing import Forcing
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.sensor_model import SensorModel, sensor_catalogue
from motorlens_physics.simulation import Trajectory

Array = NDArray[np.float64]

EQUATIONS = {"voltage": "electrical", "torque": "mechanical", "heat": "thermal"}


@dataclass(frozen=True)
class Candidate:
    """One thing that may be missing.

    Attributes:
        name: in the catalogue.
        kind: "effect" or "sensor".
        equation: "electrical", "mechanical", "thermal", "coupling", or the channel of a sensor.
        variants: the shapes tried; each is one or several columns fitted together (a sine and a cosine).
        most: the largest size, away from null, that the recordings leave possible.
    """

    name: str
    kind: str
    equation: str
    variants: tuple[tuple[Effect | SensorModel, ...], ...]
    most: float = float("inf")

    def columns(self) -> list[list[str]]:
        """Names of the columns, per variant."""
        return [[f"{self.name}#{v}.{k}" for k in range(len(parts))] for v, parts in enumerate(self.variants)]

    @property
    def switch(self) -> str:
        """The parameter that is its size."""
        what = self.variants[0][0].switch()
        assert what is not None
        return what.name

    @property
    def key(self) -> str:
        """The switch among a model's parameters."""
        return f"{self.name}.{self.switch}"

    @property
    def warms(self) -> bool:
        """Whether it shows in the temperature alone."""
        return self.equation in ("thermal", "temperature")

    @property
    def claims(self) -> int:
        """How much it claims: the balances it enters, and the parameters that are free."""
        what = self.variants[0][0]
        free = sum(not parameter.fixed for parameter in what.parameters().values())
        if not isinstance(what, Effect):
            return 1 + free
        own = ("voltage", "torque", "heat", "inductance", "rates")
        return free + sum(getattr(type(what), balance) is not getattr(Effect, balance) for balance in own)

    def typical(self, file: MotorFile) -> float:
        """Typical size of the switch, away from its null."""
        what = self.variants[0][0].switch()
        assert what is not None and what.null is not None
        return what.typical(file.rated) - what.null


def candidates(
    file: MotorFile,
    channels: Sequence[str],
    inputs: Sequence[str],
    own: Sequence[type[Effect]] = (),
    offset_below: Mapping[str, float] = MappingProxyType({}),
) -> list[Candidate]:
    """All effects the motor lacks, and all faults of the sensors that were recorded, one list.

    Args:
        file: the motor.
        channels: outputs measured in at least one run.
        inputs: inputs measured, "voltage" among them.
        own: effects from outside the catalogue.
        offset_below: channel -> the largest offset that its sensor can have, where that is known.
    """
    present = {part.name() for part in file.motor.effects} | {part.name() for part in file.sensors}
    found = []
    for effect in (*catalogue().values(), *own):
        if effect.name() in present:
            continue
        variants = tuple(shapes(effect, file))
        found.append(Candidate(effect.name(), "effect", equation_of(effect), variants))
    for name, sensor in sensor_catalogue().items():
        if name not in present and sensor.channel in (*channels, *inputs):
            most = offset_below.get(sensor.channel, float("inf")) if sensor.kind == "offset" else float("inf")
            found.append(Candidate(name, "sensor", sensor.channel, ((sensor.typical(file.rated),),), most))
    return found


def shapes(effect: type[Effect], file: MotorFile) -> Iterator[tuple[Effect, ...]]:
    """The typical effect with its unknown shapes on a grid."""
    typical = effect.typical(file.rated)
    free = [p for p in effect.parameters().values() if p.null is None and not p.fixed]
    if not free:
        yield (typical,)
        return
    phase, count = effect.with_role("phase"), effect.with_role("count")
    if phase:
        # A phase is a sine and a cosine; the number of detents a revolution is tried.
        counts = (4, 5, 6, 7, 8, 9, 10, 12, 14, 15, 16, 18, 20, 24) if count else (None,)
        for number in counts:
            counted = typical if number is None else shaped(typical, **{count: float(number)})
            yield tuple(shaped(counted, **{phase: angle}) for angle in (0.0, np.pi / 2))
        return
    grids = {p.name: [f * p.typical(file.rated) for f in (0.3, 1.0, 3.0)] for p in free}
    if len(free) == 1:
        for value in grids[free[0].name]:
            yield (replace(typical, **{free[0].name: _within(free[0].bounds, value)}),)
        return
    for scale in (0.2, 1.0, 5.0):
        for last in (0.3, 1.0, 3.0):
            values = {p.name: p.typical(file.rated) * (last if p is free[-1] else scale) for p in free}
            yield (replace(typical, **{p.name: _within(p.bounds, values[p.name]) for p in free}),)


def shaped(part: Any, **values: float) -> Any:
    """An effect or a sensor model with some of its parameters set, by name."""
    return replace(part, **values)


def _within(bounds: tuple[float, float], value: float) -> float:
    return min(max(value, bounds[0]), bounds[1])


def equation_of(effect: type[Effect]) -> str:
    """Which equation an effect enters: electrical, mechanical, thermal, or coupling for both of the first."""
    defines = [
        b for b in ("voltage", "torque", "heat", "inductance") if getattr(effect, b) is not getattr(Effect, b)
    ]
    if "voltage" in defines and "torque" in defines:
        return "coupling"
    return EQUATIONS["voltage" if defines[0] == "inductance" else defines[0]]


def decoys(trajectory: Trajectory) -> Mapping[str, Forcing]:
    """Forcings of no physical meaning with the colour of real ones: mirrored in time. None of them may ever be accepted."""
    still = np.zeros(len(trajectory.inputs.time_s))
    w, i = trajectory.speed_rad_s, trajectory.current_A
    wide = max(float(np.max(np.abs(w))), 1e-9)
    mirrored = {
        "sign": np.tanh(w / (0.01 * wide))[::-1], "square": (w * np.abs(w) / wide)[::-1], "current": np.abs(i)[::-1],
    }  # fmt: skip
    found = {}
    for name, shape in mirrored.items():
        found[f"decoy.voltage.{name}"] = Forcing(shape, still, still)
        found[f"decoy.torque.{name}"] = Forcing(still, shape, still)
        found[f"decoy.heat.{name}"] = Forcing(still, still, shape**2)
    return found
