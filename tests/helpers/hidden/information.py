"""What a record can tell: the generator's own Fisher information, by finite differences of its own simulator.

Every candidate's effect on every measured channel is a column; columns are whitened with the noise this record really
has (sensor noise, noise of the measured inputs, unmeasured torque, jitter), and what the textbook parameters and the
initial temperature can absorb is projected out (with the datasheet's tolerance as their prior).

- Detectable size: the size found with 95 % power by a two-sided test at 1 % over the whole list of candidates,
  sqrt(chi2) / |column|, and no less than a twentieth of the typical size: less is not worth a name.
- Separable: no single rival, whatever its size and shape, explains the effect as well; what it leaves unexplained must
  be worth 2 dlogL >= 25, at which the better of the two wins in 99.4 % of all draws.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from helpers.hidden import effects as hidden_effects
from helpers.hidden import plant
from helpers.hidden.motors import TEXTBOOK
from helpers.hidden.plant import Array
from helpers.hidden.world import (
    CHANNEL_SETS,
    OUTPUTS,
    Case,
    Record,
    Sized,
    build,
    lagged,
    measured,
    records_of,
    run_truth,
    shaped,
    specimen,
    substeps,
    true_channels,
)
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter
from scipy.stats import norm

CANDIDATES = len(hidden_effects.CATALOGUE) + len(hidden_effects.SENSOR_NAMES)
# 1 % over the list, two-sided, plus 95 % power.
POWER = float(norm.ppf(1 - 0.01 / CANDIDATES / 2) + norm.ppf(0.95))
SEPARATES = 25.0
FLOOR = 0.05
_ORDER = 20


@dataclass(frozen=True)
class Judgement:
    """What the record can tell of one hidden effect.

    Attributes:
        detectable: smallest size that is found, in the unit of the size.
        energy: 2 dlogL that the effect is worth at its size, refitted textbook included.
        rivals: rival -> what 2 dlogL the rival leaves unexplained.
    """

    detectable: float
    energy: float
    rivals: dict[str, float]

    def group(self) -> list[str]:
        """Rivals that the record cannot tell from the effect."""
        return sorted(name for name, left in self.rivals.items() if left < SEPARATES)


class Information:
    """The information of all records of a case; `judge` asks it about what is hidden."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.motor = case.of_motor()
        self.textbook = specimen(case)
        self.records = [_Half(case, record, self.textbook) for record in records_of(case)]
        self.base = self._gather(self._base())

    @cached_property
    def rivals(self) -> dict[str, Array]:
        """Columns (rows, k) of what may be taken for what is hidden, by name."""
        rivals = {
            name: np.column_stack(
                [self.column(Sized(name, size, form)) for size, form in self._variants(name)]
            )
            for name in hidden_effects.CATALOGUE
        }
        for name, fault in hidden_effects.sensor_faults(self.motor).items():
            if fault.equation in CHANNEL_SETS[self.case.channels]:
                rivals[name] = self.column(Sized(name, 0.1 * fault.typical))[:, None]
        return rivals

    @cached_property
    def _known(self) -> tuple[Array, Array]:
        """The columns of base and rivals, which no size changes, and their products."""
        columns = np.column_stack([self.base, *self.rivals.values()])
        return columns, columns.T @ columns

    def judge(self, hidden: list[Sized], among: list[Sized]) -> list[Judgement]:
        """Judge each of `hidden` beside all of `among` (usually the same list), whose columns are free as well."""
        names = list(self.rivals)
        bounds = np.cumsum([0] + [self.rivals[name].shape[1] for name in names])
        columns, products = self._known
        truths = np.column_stack([self.column(effect) for effect in among])
        cross = columns.T @ truths
        gram = np.block([[products, cross], [cross.T, truths.T @ truths]])
        m, stack = self.base.shape[1], bounds[-1]
        prior = self.prior()
        found = []
        for effect in hidden:
            own = m + stack + among.index(effect)
            fixed = list(range(m)) + [m + stack + k for k in range(len(among)) if among[k] is not effect]
            block = gram[np.ix_(fixed, fixed)] + np.diag(np.r_[prior, np.zeros(len(fixed) - m)])
            rest = [*range(m, m + stack), own]
            cross = gram[np.ix_(fixed, rest)]
            left = gram[np.ix_(rest, rest)] - cross.T @ np.linalg.solve(block, cross)
            mine = left[-1, -1]
            rivals = {}
            for k, name in enumerate(names):
                if name == effect.name:
                    continue
                span = slice(bounds[k], bounds[k + 1])
                inner, towards = left[span, span], left[span, -1]
                scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
                inverse = np.linalg.pinv(inner / np.outer(scale, scale), rcond=1e-9)
                explained = (towards / scale) @ inverse @ (towards / scale)
                rivals[name] = float(max(mine - explained, 0.0))
            entry = hidden_effects.lookup(effect.name, self.motor)
            size = effect.size - entry.null
            telling = min([mine, *rivals.values()]) if effect.name in hidden_effects.OUTSIDE else mine
            least = abs(size) * POWER / np.sqrt(max(telling, 1e-30))
            least = max(least, FLOOR * entry.typical * entry.unit(self.motor))
            found.append(Judgement(float(least), float(mine), rivals))
        return found

    def column(self, effect: Sized) -> Array:
        """The effect's whole contribution at its size, all records and channels stacked and whitened."""
        return np.concatenate([half.column(effect) for half in self.records])

    def _gather(self, columns: list[list[Array]]) -> Array:
        return np.column_stack([np.concatenate(parts) for parts in columns])

    def _base(self) -> list[list[Array]]:
        columns = [[half.base(name) for half in self.records] for name in TEXTBOOK]
        for own in self.records:
            columns.append([half.start() if half is own else np.zeros(half.rows) for half in self.records])
        return columns

    def prior(self) -> Array:
        """Precisions: of the relative textbook parameters, and of the initial temperatures (5 K, if not measured)."""
        tolerances = [tolerance / np.sqrt(3) for _, tolerance in TEXTBOOK.values()]
        return 1 / np.r_[tolerances, [5.0] * len(self.records)] ** 2

    def _variants(self, name: str) -> list[tuple[float, dict[str, float]]]:
        """Small sizes and shapes that span what a fit of the rival could reach."""
        entry = hidden_effects.CATALOGUE[name]
        size = entry.null + 0.1 * entry.typical * entry.unit(self.motor)
        form = shaped(self.case, name)
        vary: dict[str, list[dict[str, float]]] = {
            "stribeck_friction": [{"w_k": form.get("w_k", 1.0) * f} for f in (0.5, 1.0, 2.0)],
            "cogging_torque": [{"cog_p": form.get("cog_p", 0.0) + turn} for turn in (0.0, np.pi / 2)],
            "unbalance_torque": [{"unbalance_p": form.get("unbalance_p", 0.0) + turn} for turn in (0.0, np.pi / 2)],
            "commutation_ripple": [{"ripple_p": form.get("ripple_p", 0.0) + turn} for turn in (0.0, np.pi / 2)],
            "magnet_temperature": [{"magnet_tau": form.get("magnet_tau", 1.0) * f} for f in (0.5, 2.0)],
            "two_node_thermal": [{"node_H": form.get("node_H", 1.0) * f} for f in (0.4, 1.0, 2.5)],
            "ambient_drift": [{"drift_tau": form.get("drift_tau", 1.0) * f} for f in (0.5, 2.0)],
            "iron_heat_delay": [{"delay_tau": form.get("delay_tau", 1.0) * f} for f in (0.5, 2.0)],
        }  # fmt: skip
        return [(size, form | change) for change in vary.get(name, [{}])]


class _Half:
    """One record: its columns, at a coarse grid where it is slow, over its first half where it is fast."""

    def __init__(self, case: Case, record: Record, textbook: dict[str, float]) -> None:
        self.case, self.textbook = case, textbook
        self.channels = [name for name in OUTPUTS if name in CHANNEL_SETS[case.channels]]
        n = len(record.drive.load)
        states, truth = run_truth(case, record, textbook, [])
        whole = replace(record, drive=replace(record.drive, voltage=truth[:, plant.VOLTAGE], reference=None))
        self.whole = whole
        self.noise = self._residuals(whole, states, truth)
        self.weight = 1.0
        self.stride = max(1, round(0.5 / record.drive.dt)) if record.slow else 1
        self.keep = n
        if not record.slow and not case.small:
            self.keep, self.weight = n // 2, np.sqrt(2.0)
        cut = slice(0, self.keep, self.stride)
        drive = whole.drive
        self.record = replace(
            whole,
            drive=replace(drive, dt=drive.dt * self.stride, voltage=drive.voltage[cut], load=drive.load[cut]),
            disturbance=whole.disturbance[cut],
        )
        self.fine = np.arange(0, self.keep - self.stride + 1) / self.stride
        self.plain = self._outputs([], textbook, self.record.start)
        self.rows = len(self.fine) * len(self.channels)
        self.filters = {name: autoregression(self.noise[name]) for name in self.channels}

    def _residuals(self, record: Record, states: Array, truth: Array) -> dict[str, Array]:
        """What the true model leaves of a faultless recording when it is driven by the measured inputs."""
        channels = true_channels(self.case, record, states, truth)
        return self._left(record, measured(self.case, record, channels, [])[1])

    def _left(self, record: Record, shown: dict[str, Array]) -> dict[str, Array]:
        """What the specimen's textbook model, driven by measured inputs, leaves of measured outputs."""
        drive = record.drive
        seen = replace(drive, voltage=shown["voltage"], load=shown.get("load_torque", drive.load))
        p, inputs = build(self.case, replace(record, drive=seen), self.textbook, [])
        free = plant.simulate(drive.dt, inputs, record.start, p, substeps(self.case, record))
        ideal = true_channels(self.case, record, free, inputs)
        return {name: shown[name] - ideal[name] for name in self.channels}

    def left_by_textbook(self, shown: dict[str, Array]) -> Array:
        """The same of a recording, whitened and cut as the columns are."""
        left = self._left(self.whole, shown)
        parts = []
        for name in self.channels:
            coefficients, sd = self.filters[name]
            parts.append(lfilter(coefficients, [1.0], left[name][: len(self.fine)]) / sd * self.weight)
        return np.concatenate(parts)

    def _outputs(self, hidden: list[Sized], textbook: dict[str, float], start: Array) -> dict[str, Array]:
        p, inputs = build(self.case, self._driven(hidden), textbook, hidden)
        states = plant.simulate(self.record.drive.dt, inputs, start, p, 1)
        channels = true_channels(self.case, self.record, states, inputs)
        for effect in hidden:
            channel, _, kind = effect.name.partition("_sensor_")
            if kind and channel in channels:
                y = channels[channel]
                lag = lagged(y, self.record.drive.dt, max(effect.size, 1e-9)) if kind == "lag" else y
                channels[channel] = {"gain": y * (1 + effect.size), "offset": y + effect.size, "lag": lag}[
                    kind
                ]
        return channels

    def _driven(self, hidden: list[Sized]) -> Record:
        """The record as a reader drives the model: inputs as recorded, corrected for the fault he supposes."""
        drive = self.record.drive
        for effect in hidden:
            channel, _, kind = effect.name.partition("_sensor_")
            if kind and channel in ("voltage", "load_torque"):
                name = {"voltage": "voltage", "load_torque": "load"}[channel]
                y = getattr(drive, name)
                change = {
                    "gain": y * effect.size,
                    "offset": np.full_like(y, effect.size),
                    "lag": -effect.size * np.gradient(y, drive.dt),
                }[kind]
                # The sign of a column is of no consequence; the truth shown minus the fault drives the model.
                drive = replace(drive, **{name: y - change})
        return replace(self.record, drive=drive)

    def _whiten(self, change: dict[str, Array]) -> Array:
        parts = []
        coarse = np.arange(len(next(iter(change.values()))))
        for name in self.channels:
            y = change[name] if self.stride == 1 else np.interp(self.fine, coarse, change[name])
            coefficients, sd = self.filters[name]
            parts.append(lfilter(coefficients, [1.0], y[: len(self.fine)]) / sd * self.weight)
        return np.concatenate(parts)

    def column(self, effect: Sized) -> Array:
        """The effect's whole contribution at its size, whitened."""
        changed = self._outputs([effect], self.textbook, self.record.start)
        return self._whiten({name: changed[name] - self.plain[name] for name in self.channels})

    def base(self, parameter: str, step: float = 1e-3) -> Array:
        """Sensitivity to the logarithm of a textbook parameter, whitened."""
        up, down = (
            self._outputs(
                [], self.textbook | {parameter: self.textbook[parameter] * (1 + s)}, self.record.start
            )
            for s in (step, -step)
        )
        return self._whiten({name: (up[name] - down[name]) / (2 * step) for name in self.channels})

    def start(self, step: float = 0.1) -> Array:
        """Sensitivity to the initial temperature (K), whitened."""
        warmer = self.record.start.copy()
        warmer[plant.THETA] += step
        changed = self._outputs([], self.textbook, warmer)
        return self._whiten({name: (changed[name] - self.plain[name]) / step for name in self.channels})


def autoregression(noise: Array, order: int = _ORDER) -> tuple[Array, float]:
    """Whitening filter [order + 1] and innovation's standard deviation of a noise, by the Yule-Walker equations."""
    noise = noise - noise.mean()
    n = len(noise)
    covariance = np.array([noise[: n - lag] @ noise[lag:] for lag in range(order + 1)]) / n
    covariance[0] *= 1 + 1e-9
    weights = solve_toeplitz(covariance[:-1], covariance[1:])
    sd = np.sqrt(max(covariance[0] - weights @ covariance[1:], 1e-12 * covariance[0]))
    return np.r_[1.0, -weights], float(sd)
