"""What an observer is made of: the motor's numbers and equations, its states, and their places in the stored state."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.symbols import named
from motorlens_train.observer.algebra import Branch, dot
from motorlens_train.observer.file import BRANCHES, MEMORY, WINDOW
from motorlens_train.observer.model import Equations, equations
from motorlens_train.observer.program import Recorder, record

# What heats along with the winding: as a share of its rise, and how far from that, in rated rises.
ALONG, APART = 0.7, 0.04
# What is kept of a winding that began cold (see `cold`), beside its temperatures.
TRACK = 3
# What the sensors and the motor may have that the file does not know, each one number with its sensitivities (see
# `discrepancies`): how the voltage runs between samples, an inertia, an inductance and a voltage drop other than the file's.
DISCREPANCIES = ("hold", "inertia", "inductance", "drop")
# Which of them may look alike: at one frequency a little of one cancels a little of another. By the name under which what
# they have in common is kept.
PAIRS = {
    "hold": ("hold", "hold"), "inertia": ("hold", "inertia"), "inductance": ("hold", "inductance"),
    "motor": ("inertia", "inductance"),
}  # fmt: skip


@dataclass(frozen=True)
class ObserverSettings:
    """What the observer assumes; None is taken from the motor file.

    Attributes:
        voltage_sd, current_sd: white noise of a sample, V and A; None: 0.2 % and 0.7 % of the rating plate.
        period_s: window; None: a tenth of the mechanical time constant, at most 10 ms.
        load_walk: of the load while it stands still, rated torques per square root of a second.
        load_jump: of the load while it changes, rated torques per square root of a mechanical time constant.
        jump_every, jump_lasts: how long it stands still and how long it changes, mechanical time constants. The first is
            a minute of a motor that settles in 150 ms: where noise hides a jump that was not expected, it passes for a
            temperature.
        thermal_walk: of the winding beyond its model, K per square root of a second.
        model_sd: what the electrical balance itself is good to, in rated voltages.
        bend_sd: what the corrections for a current that bends within a window are good to, as a share of them.
        rise_K, rise_sd_K: the winding at the start; None: three tenths of the rated rise, 1.5 times that.
        rest: share of the rated speed below which a rotor may rest.
        creep: what a brake lets a rotor at rest turn by, rated speeds: one deviation.
        others: probability, before anything has shown, that the motor is another of its make, and as much that a voltage
            drop of its own is there; above 0 and below a half.
        tolerances: parameters that differ from motor to motor: key and standard deviation, relative. Each is a state that
            the observer finds, but for R_a0: from a resistance alone a cold motor of a higher R_a0 is a warm one. It is
            taken to be as the file says, and the temperature to be as unsure as that makes it.
    """

    voltage_sd: float | None = None
    current_sd: float | None = None
    period_s: float | None = None
    load_walk: float = 0.002
    load_jump: float = 0.4
    jump_every: float = 400.0
    jump_lasts: float = 3.0
    thermal_walk: float = 0.005
    model_sd: float = 2e-4
    bend_sd: float = 1.0
    rise_K: float | None = None
    rise_sd_K: float | None = None
    rest: float = 0.01
    creep: float = 0.002
    others: float = 0.125
    tolerances: tuple[tuple[str, float], ...] = ()


class Layout:
    """One observer under construction: numbers from the motor file, symbols from its equations, the places of its state.

    Attributes:
        settings, rated, motor, knowledge: what it is built for, and what the file knows of the motor's parameters.
        period: of a window, s.
        v_sd, i_sd: noise of a sample that it starts from, V and A.
        states, at: names of the states, and the place of each.
        start, sd, covariance: what is believed of them before the first sample.
        slow: places of the temperatures, the winding's first.
        pairs: the upper half of a covariance.
        odds: logarithm of the odds that a motor is found at rest, before anything has shown.
        size: of the observer's state.
    """

    def __init__(self, file: MotorFile, settings: ObserverSettings) -> None:
        self.settings, self.rated, self.motor = settings, file.rated, file.motor
        m, rated = file.motor, file.rated
        self.period = settings.period_s or min(0.01, 0.1 * m.R_a0 * m.J / m.ke**2)
        self.v_sd = settings.voltage_sd or 0.002 * rated.voltage_V
        self.i_sd = settings.current_sd or 0.007 * rated.current_A
        # The current is an input; a parameter that varies is a constant state.
        self.knowledge = file.knowledge
        self.parameters = tuple(key for key, _ in settings.tolerances if key != "R_a0")
        self.system: Equations = equations(m, self.parameters)
        self.states = (*self.system.states[1:], *self.parameters)
        self.symbols = [*self.system.x[1:], *(self.system.free[key] for key in self.parameters)]
        self.at = {name: k for k, name in enumerate(self.states)}
        values = file.values()
        rise = 0.3 * rated.rise_K if settings.rise_K is None else settings.rise_K
        rise_sd = 0.45 * rated.rise_K if settings.rise_sd_K is None else settings.rise_sd_K
        start = {"theta": rise} | {key: values[key] for key in self.parameters}
        sd = {"w": rated.speed_rad_s / 4, "theta": rise_sd, "load": rated.torque_Nm}
        sd |= {key: share * abs(values[key]) for key, share in settings.tolerances if key != "R_a0"}
        self.start = [start.get(name, 0.0) for name in self.states]
        self.sd = [sd.get(name, 0.0) for name in self.states]
        self.pairs = [(a, b) for a in range(len(self.states)) for b in range(a, len(self.states))]
        self.covariance = [
            [s * t if a == b else 0.0 for b, t in enumerate(self.sd)] for a, s in enumerate(self.sd)
        ]
        # What the winding heats along (housing, magnets) starts about as warm as the winding, for all anyone knows: a motor
        # that starts cold is cold throughout.
        slow = [k for k, name in enumerate(self.states) if name.startswith("theta_")]
        winding = self.at["theta"]
        self.slow = (winding, *slow)
        for k in slow:
            self.start[k] = ALONG * self.start[winding]
            for other in (winding, *slow):
                share = 1.0 if other == winding else ALONG
                self.covariance[k][other] = self.covariance[other][k] = ALONG * share * rise_sd**2
            self.covariance[k][k] += (APART * self.rated.rise_K) ** 2
            self.sd[k] = math.sqrt(self.covariance[k][k])
        # Of a motor that is found near standstill nobody knows whether it rests or creeps: a rest is as likely as all the
        # speeds below `rest` together, of all that it may be found at.
        below = 2 * settings.rest * rated.speed_rad_s
        self.odds = math.log(below / (math.sqrt(2 * math.pi) * self.sd[self.at["w"]]))
        n = len(self.states)
        self.size = (
            len(WINDOW)
            + len(MEMORY)
            + len(DISCREPANCIES) * (n + 2)
            + len(PAIRS)
            + len(self.slow)
            + TRACK
            + len(BRANCHES) * (n + len(self.pairs))
        )

    def sensitivities(self, r: Recorder) -> dict[str, tuple[list[Any], Any, Any]]:
        """Of each discrepancy, from the stored state: sensitivities of the states to it, information, score."""
        found = {}
        for name in DISCREPANCIES:
            values = r.inputs([f"{name}_{k}" for k in range(len(self.states) + 2)])
            found[name] = (values[:-2], values[-2], values[-1])
        return found

    def common(self, r: Recorder) -> dict[str, Any]:
        """Information that each of `PAIRS` shares, from the stored state."""
        return {name: r.input(f"common_{name}") for name in PAIRS}

    def unpack(self, r: Recorder) -> list[Branch]:
        """States and covariance of each branch, from the stored state."""
        n, branches = len(self.states), []
        for branch in BRANCHES:
            names = [f"{name}_{branch}" for name in self.states]
            x = [value + start for value, start in zip(r.inputs(names), self.start, strict=True)]
            P: list[list[Any]] = [[0.0] * n for _ in range(n)]
            for a, b in self.pairs:
                entry = r.input(f"P_{names[a]}_{names[b]}") + self.covariance[a][b]
                P[a][b] = P[b][a] = entry
            branches.append((x, P))
        return branches

    def pack(self, branches: Sequence[Branch]) -> list[Any]:
        """The inverse of `unpack`."""
        packed: list[Any] = []
        for x, P in branches:
            packed += [value - start for value, start in zip(x, self.start, strict=True)]
            packed += [P[a][b] - self.covariance[a][b] for a, b in self.pairs]
        return packed

    def _values(self, x: Sequence[Any], current: Any, voltage: Any, ambient: Any) -> dict[Any, Any]:
        inputs = {named("x_i"): current, named("u_v"): voltage, named("u_ambient"): ambient}
        return dict(zip(self.symbols, x, strict=True)) | inputs

    def linearised(
        self, r: Recorder, x: Sequence[Any], current: Any, voltage: Any, ambient: Any
    ) -> tuple[list[Any], list[list[Any]]]:
        """Rates of the states, and their Jacobian."""
        import sympy as sp

        values = self._values(x, current, voltage, ambient)
        rates = [*self.system.rates[1:], *(sp.Integer(0) for _ in self.parameters)]
        recorded = [record(rate, values, r) for rate in rates]
        jacobian = [[record(sp.diff(rate, symbol), values, r) for symbol in self.symbols] for rate in rates]
        return recorded, jacobian

    def balance(
        self, r: Recorder, x: Sequence[Any], current: Any, voltage: Any, ambient: Any
    ) -> tuple[Any, list[Any]]:
        """v - R i - ke w and what effects add, and its slopes over the states."""
        import sympy as sp

        values, voltage_balance = self._values(x, current, voltage, ambient), self.system.voltage
        slopes = [record(sp.diff(voltage_balance, symbol), values, r) for symbol in self.symbols]
        return record(voltage_balance, values, r), slopes

    def resistance(self, r: Recorder, x: Sequence[Any]) -> Any:
        """R_a0 (1 + alpha theta)."""
        R_a0, alpha = (
            x[self.at[key]] if key in self.at else getattr(self.motor, key) for key in ("R_a0", "alpha")
        )
        return R_a0 * (1 + alpha * x[self.at["theta"]])

    def per_kelvin(self, x: Sequence[Any]) -> Any:
        """Derivative of the resistance by the winding's temperature."""
        R_a0, alpha = (
            x[self.at[key]] if key in self.at else getattr(self.motor, key) for key in ("R_a0", "alpha")
        )
        return R_a0 * alpha

    def resistance_variance(self, r: Recorder, x: Sequence[Any], P: Sequence[Sequence[Any]]) -> Any:
        """Variance of the resistance, ohm^2."""
        gradient: list[Any] = [0.0] * len(self.states)
        theta = x[self.at["theta"]]
        R_a0, alpha = (
            x[self.at[key]] if key in self.at else getattr(self.motor, key) for key in ("R_a0", "alpha")
        )
        gradient[self.at["theta"]] = R_a0 * alpha
        if "R_a0" in self.at:
            gradient[self.at["R_a0"]] = 1 + alpha * theta
        if "alpha" in self.at:
            gradient[self.at["alpha"]] = R_a0 * theta
        return dot(gradient, [dot(row, gradient) for row in P])
