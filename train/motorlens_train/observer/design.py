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

Three programs: `accumulate` at every sample, `correct` when a window is full, `read` when a value is asked for. The state is
stored as its distance from the start, so that a state of zeros is a fresh observer.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.symbols import named
from motorlens_train.observer.algebra import Branch, bend, congruence, dot, exponential, mixed, probability
from motorlens_train.observer.file import BRANCHES, MEMORY, WINDOW, Observer
from motorlens_train.observer.model import Equations, equations
from motorlens_train.observer.program import Program, Recorder, Value, record
from motorlens_train.specification import Bank, Feature

# No observer is better than this share of the rating plate; below it, its sureness says nothing.
FLOOR = {"speed": 2e-4, "temperature": 2e-3, "resistance": 2e-3}
# Samples further apart than GAP windows are a gap; a current is followed as it bends over up to BENT windows. No round
# numbers: which side of them a step falls on must not hang on the last bit of a clock.
GAP, BENT = 50.37, 3.37
# What heats along with the winding: as a share of its rise, and how far from that, in rated rises.
ALONG, APART = 0.7, 0.04
# Odds of the branches are kept within exp(-+50).
MOST_ODDS = 50.0


@dataclass(frozen=True)
class ObserverSettings:
    """What the observer assumes; None is taken from the motor file.

    Attributes:
        voltage_sd, current_sd: white noise of a sample, V and A; None: 0.2 % and 0.7 % of the rating plate.
        period_s: window; None: a tenth of the mechanical time constant, at most 10 ms.
        load_walk: of the load while it stands still, rated torques per square root of a second.
        load_jump: of the load while it changes, rated torques per square root of a mechanical time constant.
        jump_every, jump_lasts: how long it stands still and how long it changes, mechanical time constants.
        thermal_walk: of the winding beyond its model, K per square root of a second.
        model_sd: what the electrical balance itself is good to, in rated voltages.
        bend_sd: what the corrections for a current that bends within a window are good to, as a share of them.
        rise_K, rise_sd_K: the winding at the start; None: three tenths of the rated rise, 1.5 times that.
        rest: share of the rated speed below which the load is whatever the motor's torque asks for.
        tolerances: parameters that differ from motor to motor: key and standard deviation, relative. Each is a state that
            the observer finds, but for R_a0: from a resistance alone a cold motor of a higher R_a0 is a warm one. It is
            taken to be as the file says, and the temperature to be as unsure as that makes it.
    """

    voltage_sd: float | None = None
    current_sd: float | None = None
    period_s: float | None = None
    load_walk: float = 0.002
    load_jump: float = 0.4
    jump_every: float = 4000.0
    jump_lasts: float = 3.0
    thermal_walk: float = 0.005
    model_sd: float = 2e-4
    bend_sd: float = 1.0
    rise_K: float | None = None
    rise_sd_K: float | None = None
    rest: float = 0.01
    tolerances: tuple[tuple[str, float], ...] = ()


def observer(file: MotorFile, settings: ObserverSettings = ObserverSettings()) -> Observer:
    """The observer of a motor: its textbook part and its effects (those that need the shaft angle left out)."""
    return _Design(file, settings).observer()


def with_observer(bank: Bank, file: MotorFile, settings: ObserverSettings = ObserverSettings()) -> Bank:
    """A feature bank beside which the observer of a motor runs: its outputs are further features."""
    added = observer(file, settings)
    features = tuple(Feature("observer", filters=(k,)) for k in range(len(added.outputs)))
    return replace(bank, observer=added, features=(*bank.features, *features))


class _Design:
    """One observer under construction: numbers from the motor file, symbols from its equations."""

    def __init__(self, file: MotorFile, settings: ObserverSettings) -> None:
        self.settings, self.rated, self.motor = settings, file.rated, file.motor
        m, rated = file.motor, file.rated
        self.period = settings.period_s or min(0.01, 0.1 * m.R_a0 * m.J / m.ke**2)
        self.v_sd = settings.voltage_sd or 0.002 * rated.voltage_V
        self.i_sd = settings.current_sd or 0.007 * rated.current_A
        # The current is an input; a parameter that varies is a constant state.
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
        for k in slow:
            self.start[k] = ALONG * self.start[winding]
            for other in (winding, *slow):
                share = 1.0 if other == winding else ALONG
                self.covariance[k][other] = self.covariance[other][k] = ALONG * share * rise_sd**2
            self.covariance[k][k] += (APART * self.rated.rise_K) ** 2
            self.sd[k] = math.sqrt(self.covariance[k][k])
        n = len(self.states)
        self.size = len(WINDOW) + len(MEMORY) + len(BRANCHES) * (n + len(self.pairs))

    def observer(self) -> Observer:
        outputs, read = self.read()
        return Observer(
            self.period,
            self.size,
            self.accumulate(),
            self.correct(),
            read,
            outputs,
            float(self.rated.ambient_C),
        )

    def accumulate(self) -> Program:
        r = Recorder()
        v, i, _, dt = r.inputs(["voltage", "current", "ambient", "dt"])
        alive, v_old, i_old, drag, i_start, time, sum_v, sum_i, sum_ii, sum_b, sum_hh, sum_c = r.inputs(
            WINDOW
        )
        h = dt * alive
        first = 1.0 - alive
        # Where in the step the voltage changed nobody knows; what is below three deviations is noise.
        change = ((v - v_old) * (v - v_old) - 18 * self.v_sd**2).max(0.0) * (1 / 4)
        mean_square = (i * i + i_old * i_old + i * i_old) * (1 / 3)
        # The current bends within a step that is not short against L/R; for a voltage that runs linearly the mean over the
        # step is known exactly: (i + i_old)/2 + (tau/h - coth(h/(2 tau))/2)/R times how far the step is from steady state.
        m = self.motor
        mean = 0.5 * (i + i_old)
        R = m.resistance(self.start[self.at["theta"]])
        turns = h * (mean * (m.ke / m.J) + drag)
        unsteady = (v - v_old) - R * (i - i_old) - m.ke * turns
        bent = (h <= BENT * self.period).select(bend(r, h, m.L / R) * unsteady * (1 / R) * alive, 0.0)
        return r.program([
            alive + first, v, i, drag, i_start + first * i, time + h, sum_v + h * 0.5 * (v + v_old), sum_i + h * mean,
            sum_ii + h * mean_square, sum_b + h * bent, sum_hh + h * h, sum_c + h * h * change,
        ])  # fmt: skip

    def correct(self) -> Program:
        r = Recorder()
        ambient = r.input("ambient")
        window = dict(zip(WINDOW, r.inputs(WINDOW), strict=True))
        odds, restless = r.inputs(MEMORY)
        branches = self._unpack(r)
        # Over a gap nobody knows what was done to the motor.
        gap = r.apply("le", GAP * self.period, window["time"])
        believed = 1.0 - gap
        share = probability(odds)
        pace, settings = self.motor.R_a0 * self.motor.J / self.motor.ke**2, self.settings
        enter = (window["time"] * (1 / (settings.jump_every * pace))).min(0.5)
        leave = (window["time"] * (1 / (settings.jump_lasts * pace))).min(0.5)
        before = share * (1.0 - leave) + (1.0 - share) * enter
        new, surprises, logs = [], [], []
        for changing, weight in (
            (False, share * leave / (1.0 - before)),
            (True, share * (1.0 - leave) / before),
        ):
            x, P, surprise, log = self._advanced(r, *mixed(weight, branches), window, ambient, gap, changing)
            new.append((x, P))
            surprises.append(surprise)
            logs.append(log)
        odds = (before / (1.0 - before)).log() + (logs[1] - logs[0]) * believed
        odds = odds.max(-MOST_ODDS).min(MOST_ODDS)
        share = probability(odds)
        surprise = (surprises[0] + share * (surprises[1] - surprises[0])) * believed
        restless = restless + (1 - math.exp(-1 / 100)) * (surprise - 1.0 - restless)
        x, _ = mixed(share, new)
        plain = gap.select(window["current"], window["sum_current"] / window["time"])
        mean = plain + window["sum_bends"] / window["time"]
        rates, _ = self._linearised(r, x, mean, window["voltage"], ambient)
        # What brakes the rotor, as an acceleration: the next window's samples need it.
        drag = (rates[self.at["w"]] - mean * (self.motor.ke / self.motor.J)) * believed
        fresh = [window["alive"], window["voltage"], window["current"], drag, window["current"]]
        fresh += [0.0] * (len(WINDOW) - len(fresh))
        return r.program([*fresh, odds, restless, *self._pack(new)])

    def _advanced(
        self, r: Recorder, x: list[Any], P: list[list[Any]], window: Mapping[str, Value], ambient: Any, gap: Any,
        changing: bool,
    ) -> tuple[list[Any], list[list[Any]], Any, Any]:  # fmt: skip
        """One branch over a window: states, covariance, squared normalised innovation, logarithm of its likelihood."""
        n, T, believed = len(self.states), window["time"], 1.0 - gap
        V = gap.select(window["voltage"], window["sum_voltage"] / T)
        plain = gap.select(window["current"], window["sum_current"] / T)
        mean = plain + window["sum_bends"] / T
        square = gap.select(mean * mean, window["sum_square"] / T)
        steps = window["sum_steps"]
        rated, motor, settings = self.rated, self.motor, self.settings

        theta, w, load = self.at["theta"], self.at["w"], self.at["load"]
        R = self._resistance(r, x)
        limit = 1.5 * rated.speed_rad_s
        # Over a gap the motor is taken to have gone on as it is found, a resting one to have rested; slow states follow for
        # the whole time.
        x[w] = gap.select(((V - R * mean) * (1 / motor.ke)).max(-limit).min(limit), x[w])
        rates, A = self._linearised(r, x, mean, V, ambient)
        # The copper heats by the mean square of the current, not by the square of its mean.
        rates[theta] = rates[theta] + R * (square - mean * mean) / motor.H
        short = T.min(GAP * self.period)
        F: list[list[Any]] = [[0.0] * n for _ in range(n)]
        ahead = list(x)
        for j in range(n):
            own, reach = exponential(A[j][j], short if j in (w, load) else T)
            F[j] = [A[j][k] * reach * believed if k != j else own for k in range(n)]
            ahead[j] = x[j] + reach * rates[j]
        pace = motor.R_a0 * motor.J / motor.ke**2
        walk = short * (settings.load_walk * rated.torque_Nm) ** 2
        if changing:
            walk = walk + short * (settings.load_jump * rated.torque_Nm) ** 2 / pace
        walk = walk + gap * rated.torque_Nm**2
        # Near rest the brake takes what the motor's torque asks for: what was known of the load no longer holds.
        near = x[w].abs() <= settings.rest * rated.speed_rad_s
        torque = ((plain.abs() - 3 * self.i_sd).max(0.0) * (2 * motor.ke)).min(self.sd[load])
        P[load][load] = near.select(P[load][load].max(torque * torque), P[load][load])
        # It changes at any time of the window: half of it before, half after.
        P[load][load] = P[load][load] + 0.5 * walk
        P = congruence(F, P)
        warming = motor.k0 * (1 + motor.kT * rated.speed_rad_s) * rated.rise_K / motor.H
        unseen = gap.select((T * T * warming**2).min(self.sd[theta] ** 2), 0.0)
        unsure = (mean - plain) * settings.bend_sd
        shaken = unsure * T * (motor.ke / motor.J)
        P[w][w] = (
            P[w][w]
            + steps * (motor.ke * self.i_sd / motor.J) ** 2
            + shaken * shaken
            + (1e-5 * rated.speed_rad_s) ** 2
        )
        P[theta][theta] = P[theta][theta] + T.min(3600.0) * settings.thermal_walk**2 + unseen
        middle = list(ahead)
        # The mean speed of a window in which the current, and so the acceleration, changes.
        sag = T * (window["current"] - window["current_start"]) * (motor.ke / motor.J / 12)
        middle[w] = 0.5 * (ahead[w] + x[w]) - sag
        balance, _ = self._balance(r, middle, mean, V, ambient)
        # A current that may be noise says nothing about the resistance.
        limit = 3 * self.i_sd
        _, slopes = self._balance(r, middle, plain - plain.min(limit).max(-limit), V, ambient)
        error = balance - (window["current"] - window["current_start"]) * motor.L / T
        H = [-slope for slope in slopes]
        # The mean speed, seen from the speed at the end: what drives it reached it halfway.
        H = [H[j] - (0.5 * H[w] * F[w][j] if j != w else 0.0) for j in range(n)]
        noise = (
            (steps * (self.v_sd**2) + window["sum_changes"]) / (T * T) + R * R * steps * self.i_sd**2 / (T * T)
            + (2 * (motor.L * self.i_sd) ** 2) / (T * T) + (settings.model_sd * rated.voltage_V) ** 2
            + R * unsure * R * unsure
            + (sag * (motor.ke * settings.bend_sd)) * (sag * (motor.ke * settings.bend_sd))
        )  # fmt: skip
        PH = [dot(P[j], H) for j in range(n)]
        S = dot(H, PH) + noise
        # The mean over a gap says nothing about its end.
        K = [PH[j] / S * believed for j in range(n)]
        # The current's noise is in the innovation and in the slope by which it is weighed; their product has a mean, by
        # which a winding would seem to cool without end, unless it is made good (errors in variables; Söderström 2007,
        # doi:10.1016/j.automatica.2006.11.025).
        part = steps / (T * T)
        excess = (limit * limit <= plain * plain).select(
            R * self.i_sd**2 * part * (1.0 - 0.5 * part) / S, 0.0
        )
        per_A = self._per_kelvin(x)
        new = [ahead[j] + K[j] * error + P[j][theta] * per_A * excess * believed for j in range(n)]
        for a, b in self.pairs:
            P[a][b] = P[a][b] - K[a] * PH[b]
        P[load][load] = P[load][load] + 0.5 * walk
        P[w][w] = P[w][w] + gap * rated.speed_rad_s**2
        for j in range(n):
            P[j][j] = P[j][j].max(1e-14 * self.sd[j] ** 2) if self.sd[j] else P[j][j]
        new[theta] = new[theta].max(-rated.rise_K).min(4 * rated.rise_K)
        after = (window["voltage"] - R * window["current"]) * (1 / motor.ke)
        fastest = 4 * rated.speed_rad_s
        new[w] = gap.select(after, new[w]).max(-fastest).min(fastest)
        surprise = error * error / S
        return new, P, surprise, (surprise + S.log()) * -0.5

    def read(self) -> tuple[tuple[str, ...], Program]:
        r = Recorder()
        ambient = r.input("ambient")
        window = dict(zip(WINDOW, r.inputs(WINDOW), strict=True))
        odds, restless = r.inputs(MEMORY)
        changing = probability(odds)
        x, P = mixed(changing, self._unpack(r))
        w, theta = self.at["w"], self.at["theta"]
        mean = 0.5 * (window["current"] + window["current_start"])
        rates, _ = self._linearised(r, x, mean, window["voltage"], ambient)
        outputs: dict[str, Any] = {"speed": x[w] + rates[w] * window["time"], "temperature": x[theta]}
        outputs["resistance"] = self._resistance(r, x)
        variances = {
            "speed": P[w][w], "temperature": P[theta][theta], "resistance": self._resistance_variance(r, x, P)
        }  # fmt: skip
        # R_a0 that is off by a share moves the temperature by that share of 1/alpha + theta.
        unknown = dict(self.settings.tolerances).get("R_a0", 0.0)
        apart = (x[theta] + 1 / self.motor.alpha) * unknown
        variances["temperature"] = variances["temperature"] + apart * apart
        sizes = {
            "speed": self.rated.speed_rad_s, "temperature": self.rated.rise_K,
            "resistance": self.motor.R_a0 * self.motor.alpha * self.rated.rise_K,
        }  # fmt: skip
        outputs["load"] = x[self.at["load"]]
        for name in self.states:
            if name not in ("w", "theta", "load"):
                outputs[name] = x[self.at[name]]
        for name, variance in variances.items():
            outputs[f"log_{name}"] = (variance + (FLOOR[name] * sizes[name]) ** 2).log()
        outputs["correlation"] = P[w][theta] / (P[w][w] * P[theta][theta] + 1e-30).sqrt()
        outputs["changing"] = changing
        # An outlier lifts the average of squares by orders of magnitude; its logarithm stays within reach.
        outputs["restless"] = (restless.max(-0.9) + 1.0).log()
        return tuple(outputs), r.program(list(outputs.values()))

    def _unpack(self, r: Recorder) -> list[Branch]:
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

    def _pack(self, branches: Sequence[Branch]) -> list[Any]:
        packed: list[Any] = []
        for x, P in branches:
            packed += [value - start for value, start in zip(x, self.start, strict=True)]
            packed += [P[a][b] - self.covariance[a][b] for a, b in self.pairs]
        return packed

    def _values(self, x: Sequence[Any], current: Any, voltage: Any, ambient: Any) -> dict[Any, Any]:
        inputs = {named("x_i"): current, named("u_v"): voltage, named("u_ambient"): ambient}
        return dict(zip(self.symbols, x, strict=True)) | inputs

    def _linearised(
        self, r: Recorder, x: Sequence[Any], current: Any, voltage: Any, ambient: Any
    ) -> tuple[list[Any], list[list[Any]]]:
        import sympy as sp

        values = self._values(x, current, voltage, ambient)
        rates = [*self.system.rates[1:], *(sp.Integer(0) for _ in self.parameters)]
        recorded = [record(rate, values, r) for rate in rates]
        jacobian = [[record(sp.diff(rate, symbol), values, r) for symbol in self.symbols] for rate in rates]
        return recorded, jacobian

    def _balance(
        self, r: Recorder, x: Sequence[Any], current: Any, voltage: Any, ambient: Any
    ) -> tuple[Any, list[Any]]:
        import sympy as sp

        values, voltage_balance = self._values(x, current, voltage, ambient), self.system.voltage
        slopes = [record(sp.diff(voltage_balance, symbol), values, r) for symbol in self.symbols]
        return record(voltage_balance, values, r), slopes

    def _resistance(self, r: Recorder, x: Sequence[Any]) -> Any:
        R_a0, alpha = (
            x[self.at[key]] if key in self.at else getattr(self.motor, key) for key in ("R_a0", "alpha")
        )
        return R_a0 * (1 + alpha * x[self.at["theta"]])

    def _per_kelvin(self, x: Sequence[Any]) -> Any:
        """Derivative of the resistance by the winding's temperature."""
        R_a0, alpha = (
            x[self.at[key]] if key in self.at else getattr(self.motor, key) for key in ("R_a0", "alpha")
        )
        return R_a0 * alpha

    def _resistance_variance(self, r: Recorder, x: Sequence[Any], P: Sequence[Sequence[Any]]) -> Any:
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
