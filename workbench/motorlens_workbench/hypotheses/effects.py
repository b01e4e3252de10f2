"""Effects of the catalogue, and the user's own, that the motor file has not.

An effect enters the linearised problem as what it would add to the three balances at its typical size, evaluated on the
trajectory by its own methods (a secant from null to typical, so that effects whose first order vanishes, such as a housing
node, are seen). Effects with a state of their own have it integrated along. Shapes that are not known are tried on a grid.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.effect import Effect, catalogue
from motorlens_physics.estimate.forcing import Forcing, forcing
from motorlens_physics.estimate.shaft import swinging, turning
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_workbench.hypotheses.hypothesis import Hypothesis
from motorlens_workbench.hypotheses.line import Line

Array = NDArray[np.float64]

EQUATIONS = {"voltage": "electrical", "torque": "mechanical", "heat": "thermal"}
# Samples of states at which two effects are compared.
PROBES = 64
# Numbers of periods a revolution that machines have: products and least common multiples of slots and poles.
COUNTS = (4, 5, 6, 7, 8, 9, 10, 12, 14, 15, 16, 18, 20, 24)


@dataclass(frozen=True)
class EffectShape:
    """One shape of an effect at its typical size.

    Attributes:
        parts: one effect; of one that goes with a phase of the shaft's angle, its sine and its cosine.
        bounds: smallest and largest multiple of the typical size that is possible.
    """

    parts: tuple[Effect, ...]
    bounds: tuple[float, float]

    @property
    def width(self) -> int:
        """How many columns it has."""
        return len(self.parts)

    def columns(self, line: Line) -> Array:
        """(N, C, k) what the effect would change; nothing in a run whose angle is needed and not known.

        What goes with the angle is looked at while the shaft turns whole periods. At stops it is hardly more than a
        constant, and friction passes for it. A shaft that seldom turns as far is looked at while it swings, if its angle was
        measured: gravity on an arm, say.
        """
        angle = angle_of(type(self.parts[0]))
        if angle and (not line.run.turns or angle not in line.trajectory.states):
            return np.zeros((*line.error.shape, self.width))
        added = [forcing(part, line.trajectory) for part in self.parts]
        voltage, torque, heat = (
            np.column_stack([getattr(one, name) for one in added]) for name in ("voltage", "torque", "heat")
        )
        if angle:
            count = count_of(type(self.parts[0]))
            period = 2 * np.pi / (getattr(self.parts[0], count) if count else 1.0)
            shaft = line.trajectory.states[angle]
            moving = turning(shaft, line.trajectory.speed_rad_s, period)
            if line.run.angle is not None:
                moving = moving | swinging(shaft, moving, period)
            voltage, torque, heat = (part * moving[:, None] for part in (voltage, torque, heat))
        return line.of_forcing(Forcing(voltage, torque, heat))

    def limits(self) -> tuple[float, float]:
        """Of the coefficient."""
        return self.bounds


def effects(file: MotorFile, own: Sequence[type[Effect]] = ()) -> list[Hypothesis]:
    """All effects that the motor lacks."""
    present = {effect.name() for effect in file.motor.effects}
    return [
        of_effect(effect, file) for effect in (*catalogue().values(), *own) if effect.name() not in present
    ]


def of_effect(effect: type[Effect], file: MotorFile) -> Hypothesis:
    """One effect with all its shapes."""
    switch = effect.switch()
    assert switch.null is not None
    typical = switch.typical(file.rated) - switch.null
    ends = sorted((end - switch.null) / typical for end in switch.bounds)
    made = tuple(EffectShape(parts, (ends[0], ends[1])) for parts in shapes(effect, file))
    key = f"{effect.name()}.{switch.name}"
    largest = None if switch.largest is None else switch.largest / switch.prior
    return Hypothesis(
        effect.name(), "effect", equation_of(effect), made, key, typical, effect.holds(), largest
    )


def shapes(effect: type[Effect], file: MotorFile) -> Iterator[tuple[Effect, ...]]:
    """The typical effect with its unknown shapes on a grid."""
    typical = effect.typical(file.rated)
    phase, count = phase_of(effect), count_of(effect)
    if phase:
        for number in COUNTS if count else (None,):
            counted = typical if number is None else replace(typical, **{count: float(number)})
            yield tuple(replace(counted, **{phase: angle}) for angle in (0.0, np.pi / 2))
        return
    free = [p for p in effect.parameters().values() if p.null is None and not p.fixed and p.role != "share"]
    grids = {p.name: p.typical(file.rated) for p in free}
    within = {p.name: p.bounds for p in free}

    def scaled(factors: dict[str, float]) -> tuple[Effect, ...]:
        values = {
            name: min(max(factor * grids[name], within[name][0]), within[name][1])
            for name, factor in factors.items()
        }
        return (replace(typical, **values),)

    if not free:
        yield (typical,)
    elif len(free) == 1:
        yield from (scaled({free[0].name: factor}) for factor in (0.3, 1.0, 3.0))
        # What one friction of the motor has built up at is that of another in its place.
        for other in file.motor.effects:
            width = other.parameters().get(free[0].name)
            if free[0].role == "width" and width is not None and width.role == "width":
                yield (replace(typical, **{width.name: getattr(other, width.name)}),)
    else:
        last = free[-1].name
        for scale in (0.2, 1.0, 5.0):
            for factor in (0.3, 1.0, 3.0):
                yield scaled({p.name: scale for p in free} | {last: factor})
        # Built up where another effect has, and as sharply; of a share that the other has not, nothing.
        for other in file.motor.effects:
            if other.with_role("onset") and effect.with_role("onset"):
                alike = {
                    p.name: getattr(other, name) if (name := other.with_role(p.role)) else 0.0
                    for p in effect.parameters().values()
                    if p.role in ("onset", "knee", "share")
                }
                yield (replace(typical, **alike),)


def times_as_much(effect: Effect, other: Effect, motor: Motor) -> float | None:
    """How many times as much an effect adds to every balance as another does; None if it adds anything else.

    >>> from motorlens_physics.effects.brush_voltage_drop import BrushVoltageDrop
    >>> from motorlens_physics.effects.dead_time import DeadTime
    >>> dead, cold = DeadTime(V_dt=0.5, i_r=0.1), BrushVoltageDrop(V_b=1.0, i_s=0.1, h=0.0)
    >>> times_as_much(cold, dead, Motor()), times_as_much(replace(cold, h=1.0), dead, Motor())
    (2.0, None)
    """
    if effect.states or other.states:
        return None
    rng = np.random.default_rng(0)
    # States and inputs of any motor: equal functions are equal anywhere.
    x, u = (
        SimpleNamespace(**dict(zip(names, rng.standard_normal((len(names), PROBES)), strict=True)))
        for names in (("i", "w", "theta"), ("v", "load", "ambient", "t"))
    )
    balances = ("voltage", "torque", "heat", "inductance")
    one, two = (
        np.concatenate([np.broadcast_to(getattr(part, name)(motor, x, u), PROBES) for name in balances])
        for part in (effect, other)
    )
    times = float(one @ two / (two @ two)) if two.any() else 0.0
    return (
        times if times and np.allclose(one, times * two, rtol=1e-9, atol=1e-9 * np.max(np.abs(one))) else None
    )


def angle_of(effect: type[Effect]) -> str:
    """The state that is the shaft's angle; "" for an effect that has none."""
    return next((name for name, state in effect.states.items() if state.kind == "angle"), "")


def phase_of(effect: type[Effect]) -> str:
    """The parameter that is a phase of the angle; "" for none."""
    return next((p.name for p in effect.parameters().values() if p.role == "phase"), "")


def count_of(effect: type[Effect]) -> str:
    """The parameter that is a number of periods a revolution; "" for none."""
    return next((p.name for p in effect.parameters().values() if p.role == "count"), "")


def equation_of(effect: type[Effect]) -> str:
    """Which equation an effect enters: electrical, mechanical, thermal, or coupling for both of the first."""
    defines = [
        name
        for name in ("voltage", "torque", "heat", "inductance")
        if getattr(effect, name) is not getattr(Effect, name)
    ]
    if "voltage" in defines and "torque" in defines:
        return "coupling"
    first = defines[0] if defines else "torque"
    return EQUATIONS["voltage" if first == "inductance" else first]
