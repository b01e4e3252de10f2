"""The filter bank for training: signals, filters and features of docs/sensor-file.md, over whole recordings.

The runtime computes the same from the same specification by other code; tests hold the two together.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError
from motorlens_train.specification import Array, Bank, Feature, Filter


def signal(
    name: str, voltage_V: Array, current_A: Array, resistance_ohm: float, ambient_C: Array | None
) -> Array:
    """One signal `[N]` of docs/sensor-file.md.

    Raises:
        DataError: the ambient temperature is asked for and not there.
    """
    emf = voltage_V - resistance_ohm * current_A
    match name:
        case "one":
            return np.ones_like(voltage_V)
        case "voltage":
            return voltage_V
        case "current":
            return current_A
        case "current_squared":
            return current_A * current_A
        case "voltage_squared":
            return voltage_V * voltage_V
        case "power":
            return voltage_V * current_A
        case "emf":
            return emf
        case "emf_squared":
            return emf * emf
        case "emf_power":
            return emf * current_A
        case "ambient" if ambient_C is not None:
            return ambient_C
        case "ambient":
            raise DataError("this sensor needs the ambient temperature, which was not measured")
        case _:
            raise ValueError(f"unknown signal {name!r}")


def feature_rows(
    bank: Bank,
    time_s: Array,
    voltage_V: Array,
    current_A: Array,
    rows: NDArray[np.int64] | None = None,
    ambient_C: Array | None = None,
    first_dt_s: float | None = None,
    start: Array | None = None,
) -> Array:
    """Features of a recording.

    Args:
        bank: filters and features.
        time_s: `[N]` seconds, increasing, any spacing.
        voltage_V: `[N]`.
        current_A: `[N]`.
        rows: which samples to return, ascending; None means all. Every sample updates the filters.
        ambient_C: `[N]`, where it is an input.
        first_dt_s: step of the very first sample; None takes the median step.
        start: state of the filters before the first sample; None means a fresh sensor.

    Returns:
        `[len(rows), F]` in SI units.
    """
    names = bank.signals
    signals = np.empty((len(names), len(time_s)))
    for k, name in enumerate(names):
        signals[k] = signal(name, voltage_V, current_A, bank.resistance_ohm, ambient_C)
    step = float(np.median(np.diff(time_s))) if first_dt_s is None else first_dt_s
    dt = np.diff(time_s, prepend=time_s[0] - step)
    chosen = np.arange(len(time_s)) if rows is None else rows
    plus, minus = wiring(bank)
    driving = np.array([names.index(f.signal) for f in bank.filters], dtype=np.int64)
    tau = np.array([f.tau_s for f in bank.filters])
    state = np.zeros(len(tau)) if start is None else start.astype(np.float64)
    observed = np.zeros((len(time_s), 0))
    if bank.observer is not None:
        surroundings = np.full(len(time_s), bank.observer.ambient_C) if ambient_C is None else ambient_C
        observed, _ = bank.observer.run(dt, voltage_V, current_A, surroundings)
    result: Array = _run(signals, driving, dt, tau, state, chosen.astype(np.int64), plus, minus, observed)
    return result


def wiring(bank: Bank) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Each feature as the difference of two entries of `[signals | filters | 0 | observer]`: their indices, `[F]` each."""
    names = bank.signals
    first, nothing = len(names), len(names) + len(bank.filters)

    def ends(feature: Feature) -> tuple[int, int]:
        match feature.kind:
            case "raw":
                return names.index(feature.signal), nothing
            case "lowpass":
                return first + feature.filters[0], nothing
            case "difference":
                return names.index(feature.signal), first + feature.filters[0]
            case "between":
                return first + feature.filters[0], first + feature.filters[1]
            case "observer":
                return nothing + 1 + feature.filters[0], nothing
            case _:
                raise ValueError(f"unknown feature {feature.kind!r}")

    pairs = np.array([ends(feature) for feature in bank.features], dtype=np.int64)
    return pairs[:, 0].copy(), pairs[:, 1].copy()


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _run(
    signals: Array,
    driving: Array,
    dt: Array,
    tau: Array,
    state: Array,
    rows: Array,
    plus: Array,
    minus: Array,
    observed: Array,
) -> Array:
    count, filters = signals.shape[0], len(tau)
    result = np.empty((len(rows), len(plus)))
    values = np.zeros(count + filters + 1 + observed.shape[1])
    decay = np.exp(-dt[0] / tau)
    last, taken = dt[0], 0
    for n in range(len(dt)):
        # Steps of an even grid differ by rounding only; the exponential is worth not repeating for that.
        if abs(dt[n] - last) > 1e-10 * last:
            last = dt[n]
            for s in range(filters):
                decay[s] = np.exp(-last / tau[s])
        for s in range(filters):
            u = signals[driving[s], n]
            state[s] = u + (state[s] - u) * decay[s]
        if taken < len(rows) and rows[taken] == n:
            # One by one: the compiler takes a second and a half over parts of arrays, for a message of theirs.
            for s in range(count):
                values[s] = signals[s, n]
            for s in range(filters):
                values[count + s] = state[s]
            for s in range(observed.shape[1]):
                values[count + filters + 1 + s] = observed[n, s]
            for f in range(len(plus)):
                result[taken, f] = values[plus[f]] - values[minus[f]]
            taken += 1
    return result


def motor_bank(
    resistance_ohm: float, inductance_H: float, electrical_s: float, mechanical_s: float, thermal_s: float
) -> Bank:
    """The default bank for a motor whose time constants are known.

    Fast filters of voltage and current give speed and `L di/dt`; copper, iron and shaft power at several fractions of the
    thermal time constant give the winding's temperature; filters of 1 tell how much of the past the state has seen.
    """
    filters: list[Filter] = []
    features: list[Feature] = []

    def add(name: str, tau_s: float) -> int:
        filters.append(Filter(name, float(f"{tau_s:.4g}")))
        return len(filters) - 1

    fast, run_up = 0.5 * electrical_s, mechanical_s
    smooth = add("voltage", fast), add("current", fast)
    slower = add("voltage", 4 * fast), add("current", 4 * fast)
    features += [Feature("lowpass", filters=(index,)) for index in smooth]
    features += [Feature("between", filters=(a, b)) for a, b in zip(smooth, slower, strict=True)]
    for tau in (run_up / 4, run_up, 8 * run_up):
        features += [Feature("lowpass", filters=(add(name, tau),)) for name in ("emf", "current")]
    for share in (1 / 60, 1 / 12, 0.4, 1.0):
        features += [
            Feature("lowpass", filters=(add(name, share * thermal_s),))
            for name in ("current_squared", "emf_squared")
        ]
    for share in (1 / 12, 1.0):
        features.append(Feature("lowpass", filters=(add("emf", share * thermal_s),)))
    features += [
        Feature("lowpass", filters=(add("one", tau),)) for tau in (run_up, thermal_s / 12, thermal_s)
    ]
    return Bank(resistance_ohm, inductance_H, tuple(filters), tuple(features))


def recording_bank(
    resistance_ohm: float, inductance_H: float, period_s: float, duration_s: float, ambient: bool = False
) -> Bank:
    """The default bank for recordings: time constants spread from four samples to half of the longest recording.

    Args:
        resistance_ohm: fitted to the recordings.
        inductance_H: fitted to the recordings, 0 if unknown.
        period_s: sampling period.
        duration_s: length of the longest recording.
        ambient: whether the ambient temperature was measured.
    """
    filters: list[Filter] = []
    features: list[Feature] = []
    longest = max(duration_s / 2, 16 * period_s)
    taus = np.geomspace(
        4 * period_s, longest, min(8, 2 + int(np.log(longest / (4 * period_s)) / np.log(3.0)))
    )
    for tau in taus:
        for name in ("voltage", "current"):
            filters.append(Filter(name, float(f"{tau:.4g}")))
            features.append(Feature("lowpass", filters=(len(filters) - 1,)))
    features += [Feature("raw", "voltage"), Feature("raw", "current")]
    if ambient:
        features.append(Feature("raw", "ambient"))
    return Bank(resistance_ohm, inductance_H, tuple(filters), tuple(features), ambient)
