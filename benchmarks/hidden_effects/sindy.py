"""What a user would try instead of `motorlens diagnose`: PySINDy, plain, in weak form, and that in an ensemble.

PySINDy gets all that a user who knows motors would give it. The three balances stand as they are written on paper (the
voltage over L di/dt, R i, ke w; the current over J dw/dt, b w and the load; the rate of the temperature over heat and
cooling), not as di/dt alone, which drowns in noise where the electrical time constant is a few samples. The textbook's
terms are always in; every term of the catalogue and every sensor fault that makes a term of its own is a column beside
them, with the shapes at their typical values, the datasheet's alpha, ke, R and H/k0, and the right number of teeth. All
columns are smoothed alike, so that the balance holds between them. The optimiser, its threshold and the width are chosen
on blocks of time held out, the sparsest within two standard errors of the best (after Breiman et al. 1984, Classification
and regression trees, 3.4.3; with one, as they have it, false alarms are more). What is left beyond the textbook is the
answer; columns that are copies of each other are a group.

Beyond it: gains of sensors and heat of friction (any coefficient absorbs them), and recordings without a speed.

The ensemble takes, from each of many draws of blocks of time, the model that is best on those not drawn, and keeps what most
of these models have (Fasel et al. 2022, doi:10.1098/rspa.2021.0904); PySINDy's own bags would draw samples, which are no
independent ones.
"""

import tomllib
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# In units of the column's and the target's standard deviation.
THRESHOLDS = (3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3)
RIDGE = 1e-3
FORWARD = 6
# Of the smoothing or the weak form's domains, in s, by whether the recording is slow; a little more where one is very fine.
WIDTHS_S = {False: (0.02, 0.08, 0.3), True: (10.0, 40.0, 150.0)}
FOLDS, BLOCKS = 8, 16
DOMAINS = 400
# Standard errors within which a sparser model is as good.
SURE = 2.0
# Draws of an ensemble, and the share of them in which a term that is kept is chosen at least.
BAGS, INCLUDED = 20, 0.6
# What has no term of its own, so that PySINDy cannot name it: any coefficient absorbs it, or no column shows it.
BEYOND = (
    "friction_heat", "iron_loss_torque", "temperature_sensor_gain", "temperature_sensor_lag",
    *(f"{channel}_sensor_gain" for channel in ("voltage", "current", "speed", "load_torque")),
)  # fmt: skip
# Correlation from which on two columns are one.
SAME = 0.9995
HEADINGS = {
    "v": "voltage_V", "i": "current_A", "w": "speed_rad_s", "T": "temperature_C", "load": "load_torque_Nm",
    "phi": "angle_rad",
}  # fmt: skip


@dataclass(frozen=True)
class Column:
    """A term of a balance: (n,) samples, or their rate of change; `names` are what it would stand for, () the textbook."""

    names: tuple[str, ...]
    samples: Array
    rate: bool = False


@dataclass(frozen=True)
class Terms:
    """One balance of one record: its columns, the target first, and (rows, columns) at every width."""

    columns: list[Column]
    tables: tuple[Array, ...]


@dataclass(frozen=True)
class Record:
    """One file on an even grid: t in s, what was measured by the letters of `HEADINGS`."""

    t: Array
    d: dict[str, Array]

    @property
    def slow(self) -> bool:
        """Whether it is one for heat, sampled too seldom for the shaft angle."""
        return bool(self.t[1] - self.t[0] > 0.05)


def read(path: Path) -> Record:
    """The columns of a recording on an even grid."""
    with path.open(encoding="utf-8") as file:
        names = file.readline().strip().split(",")
        table = np.loadtxt(file, delimiter=",")
    columns = dict(zip(names, table.T, strict=True))
    t = columns["time_s"]
    grid = np.linspace(t[0], t[-1], len(t))
    return Record(grid, {key: np.interp(grid, t, columns[h]) for key, h in HEADINGS.items() if h in columns})


def balances(record: Record, motor: dict[str, Any]) -> dict[str, list[Column]]:
    """The target of each balance that the record shows, and then its terms: equation -> columns, the target first."""
    rated = motor["rated"]
    known = {name: entry["value"] for name, entry in motor["parameters"].items()}
    d, dt = record.d, record.t[1] - record.t[0]
    v, i, w = d["v"], d["i"], d["w"]
    one = np.ones_like(i)
    # Arguments of what is not linear are smoothed a little first.
    near = {
        key: smoothed(y, dt, WIDTHS_S[record.slow][0]) for key, y in d.items() if key in ("v", "i", "w", "T")
    }
    turn = np.tanh(near["w"] / (0.005 * rated["speed_rad_s"]))
    speed = np.abs(near["w"])

    def saturated(share: float) -> Array:
        return near["i"] / np.hypot(near["i"], share * rated["current_A"])

    electrical = [
        Column((), v),
        Column((), i, rate=True), Column((), w),
        Column(("brush_voltage_drop",), saturated(0.02)), Column(("dead_time",), saturated(0.05)),
        Column(("inductance_saturation",), near["i"] ** 3, rate=True), Column(("contact_resistance",), speed * i),
        Column(("armature_reaction",), near["i"] ** 2 * w),
        Column(("coasting_bridge",), (1 - np.abs(near["v"]) / rated["voltage_V"]) * w),
        Column(("voltage_sensor_offset", "current_sensor_offset", "speed_sensor_offset"), one),
        Column(("voltage_sensor_lag",), v, rate=True), Column(("speed_sensor_lag",), w, rate=True),
    ]  # fmt: skip
    # What is the current times something slow would be fitted to the target's own noise: flux is left to the voltage.
    mechanical = [
        Column((), i),
        Column((), w, rate=True), Column((), w),
        Column(("coulomb_friction", "hysteresis_iron_loss"), turn),
        Column(("stribeck_friction",), np.exp(-((near["w"] / (0.03 * rated["speed_rad_s"])) ** 2)) * turn),
        Column(("quadratic_drag",), w * speed), Column(("directional_friction",), np.maximum(turn, 0.0)),
        Column(("stray_load_loss",), near["i"] ** 2 * w),
        Column(("constant_torque", "load_torque_sensor_offset", "current_sensor_offset"), one),
        Column(("current_sensor_lag",), i, rate=True),
    ]  # fmt: skip
    load = d.get("load")
    if load is not None:
        pressed = np.abs(smoothed(load, dt, WIDTHS_S[record.slow][0]))
        mechanical += [
            Column((), load), Column(("load_torque_sensor_lag",), load, rate=True),
            Column(("load_dependent_friction",), pressed * turn),
        ]  # fmt: skip
    if "phi" in d and not record.slow:
        for wave in (np.sin, np.cos):
            electrical.append(Column(("commutation_ripple",), wave(6 * d["phi"]) * w))
            mechanical += [
                Column(("cogging_torque",), wave(12 * d["phi"])),
                Column(("unbalance_torque",), wave(d["phi"])),
            ]
    if "T" not in d:
        return {"electrical": [*electrical, Column((), i)], "mechanical": mechanical}
    theta, warm = d["T"] - rated["ambient_C"], near["T"] - rated["ambient_C"]
    hot = 1 + known["alpha"] * warm
    pace = known["H"] / known["k0"]
    magnet = lagging(warm, dt, pace)
    electrical += [
        Column((), hot * i), Column(("supply_resistance",), i), Column(("magnet_temperature",), magnet * w)
    ]  # fmt: skip
    mechanical.append(Column(("temperature_dependent_viscosity",), warm * w))
    kelvin = rated["ambient_C"] + 273.15
    thermal = [
        Column((), theta, rate=True),
        Column((), hot * near["i"] ** 2), Column((), near["w"] ** 2), Column((), theta), Column((), speed * theta),
        Column(("radiation",), (kelvin + warm) ** 4), Column(("hysteresis_iron_loss",), speed),
        Column(("brush_voltage_drop",), np.abs(near["i"])), Column(("stray_load_loss",), (near["i"] * near["w"]) ** 2),
        Column(("fan_cooling_exponent",), speed**0.7 * theta), Column(("two_node_thermal",), lagging(warm, dt, 2.5 * pace)),
        Column(("iron_heat_delay",), lagging(near["w"] ** 2, dt, 150.0)),
        Column(("ambient_drift",), 1 - np.exp(-record.t / 1800)), Column(("temperature_sensor_offset",), one),
    ]  # fmt: skip
    return {"electrical": electrical, "mechanical": mechanical, "thermal": thermal}


def smoothed(y: Array, dt: float, width_s: float) -> Array:
    """A parabola through a window of `width_s` (Savitzky and Golay 1964, doi:10.1021/ac60214a047)."""
    from scipy.signal import savgol_filter

    return np.asarray(savgol_filter(y, window(width_s, dt), 2, axis=0))


def window(width_s: float, dt: float) -> int:
    """An odd number of samples, five at least."""
    return 2 * max(round(width_s / dt / 2), 2) + 1


def lagging(y: Array, dt: float, tau_s: float) -> Array:
    """A first-order lag, in equilibrium before."""
    from scipy.signal import lfilter, lfiltic

    keep = np.exp(-dt / tau_s)
    return np.asarray(lfilter([1 - keep], [1.0, -keep], y, zi=lfiltic([1 - keep], [1.0, -keep], y[:1]))[0])


def rows(columns: list[Column], record: Record, width_s: float, weak: bool) -> Array:
    """(n, k) samples or (DOMAINS, k) integrals of the columns of a balance, in order of time, by PySINDy."""
    import pysindy
    from pysindy import AxesArray

    table = np.column_stack([column.samples for column in columns])
    rate = np.array([column.rate for column in columns])
    dt = record.t[1] - record.t[0]
    if not weak:
        method = pysindy.SmoothedFiniteDifference(
            smoother_kws={"window_length": window(width_s, dt), "polyorder": 2}
        )
        slopes = np.asarray(method(table, t=record.t))
        # A central difference is the mean of (1, 2, 1) / 4 of the rates: so are the columns that it is compared with.
        means = np.asarray(method.smoothed_x_)
        means[1:-1] = (means[:-2] + 2 * means[1:-1] + means[2:]) / 4
        return np.where(rate, slopes, means)
    np.random.seed(0)  # noqa: NPY002 - PySINDy places its domains with the global generator
    library = pysindy.WeakPDELibrary(
        function_library=pysindy.PolynomialLibrary(degree=1, include_bias=False),
        spatiotemporal_grid=record.t,
        K=DOMAINS,
        H_xt=max(width_s / 2, 4 * dt),  # half a domain
    )
    fields = AxesArray(table, {"ax_time": 0, "ax_coord": 1})
    found = np.where(rate, library.convert_u_dot_integral(fields), np.asarray(library.fit_transform(fields)))
    return np.asarray(found[np.argsort([indices[0][0] for indices in library.inds_k])])


def terms(record: Record, motor: dict[str, Any], weak: bool) -> dict[str, Terms]:
    """The balances of a record at every width."""
    own = balances(record, motor)
    ends = np.cumsum([len(columns) for columns in own.values()])[:-1]
    every = [column for columns in own.values() for column in columns]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tables = [np.split(rows(every, record, width, weak), ends, axis=1) for width in WIDTHS_S[record.slow]]
    return {
        equation: Terms(columns, tuple(table[k] for table in tables))
        for k, (equation, columns) in enumerate(own.items())
    }


# Size, in deviations of the target, and names of each term that is kept.
Kept = list[tuple[float, tuple[str, ...]]]


@dataclass(frozen=True)
class Problem:
    """One balance in blocks of time: triangular factors (target first) at every width, in units of the target's deviation;
    which terms are beyond the textbook, and the names of all."""

    blocks: tuple[list[Array], ...]
    extra: NDArray[np.bool_]
    names: list[tuple[str, ...]]

    @classmethod
    def of(cls, used: list[Terms]) -> "Problem":
        """Of the same balance of each record."""
        # What only the first record shows (the angle) is nothing in the other.
        layout = used[0].columns
        stacks: list[list[Array]] = []
        for level in range(3):
            stacks.append([])
            for one in used:
                part = np.zeros((len(one.tables[level]), len(layout)))
                part[:, [_place(layout, one.columns, k) for k in range(len(one.columns))]] = one.tables[level]
                stacks[-1].append(part)
        # Judged, at every width, where noise counts least.
        scale = np.sqrt(
            np.mean(np.concatenate([part - part.mean(axis=0) for part in stacks[-1]]) ** 2, axis=0)
        )
        most = np.abs(np.concatenate(stacks[-1])).max(axis=0)
        scale = np.where(scale > 1e-6 * most, scale, most)
        live = [k for k in range(len(layout)) if most[k] > 0]
        live, names = _merged(live, layout, np.concatenate(stacks[-1]) / np.where(scale > 0, scale, 1.0))
        blocks = [
            _compressed([part[:, [0, *live]] / scale[[0, *live]] for part in parts]) for parts in stacks
        ]
        return cls(tuple(blocks), np.array([bool(name) for name in names]), names)

    def fits(self, used: Sequence[int]) -> list[Array]:
        """Of some blocks, at every width."""
        return [fit for own in self.blocks for fit in _fits([own[k] for k in used], self.extra)]

    def errors(self, held: Sequence[int], fits: list[Array]) -> Array:
        """Squared error (M,) of each fit on other blocks."""
        rest = np.concatenate([self.blocks[-1][k] for k in held])
        return np.array([float(np.sum((rest[:, 0] - rest[:, 1:] @ fit) ** 2)) for fit in fits])

    def told(self, fit: Array) -> Kept:
        """Size (in deviations of the target) and names of the terms beyond the textbook."""
        return [
            (float(abs(size)), name) for size, name in zip(fit, self.names, strict=True) if name and size != 0
        ]


def kept(problem: Problem) -> Kept:
    """What one balance keeps beyond the textbook: the sparsest model that is as good as the best on folds held out."""
    every = range(BLOCKS)
    folds = [[k for k in every if k % FOLDS == fold] for fold in range(FOLDS)]
    # (folds, widths x models)
    errors = np.array(
        [problem.errors(fold, problem.fits([k for k in every if k not in fold])) for fold in folds]
    )
    fits = problem.fits(every)
    mean = errors.mean(axis=0)
    worse = errors - errors[:, [int(np.argmin(mean))]]
    as_good = worse.mean(axis=0) <= SURE * worse.std(axis=0, ddof=1) / np.sqrt(FOLDS)
    chosen = min(np.flatnonzero(as_good), key=lambda k: (np.count_nonzero(fits[k][problem.extra]), mean[k]))
    return problem.told(fits[chosen])


def kept_by_most(problem: Problem) -> Kept:
    """What one balance keeps beyond the textbook in most draws of its blocks, each judged on the blocks not drawn."""
    rng = np.random.default_rng(0)
    chosen = []
    for _ in range(BAGS):
        drawn = rng.integers(0, BLOCKS, BLOCKS).tolist()
        fits = problem.fits(drawn)
        left = sorted(set(range(BLOCKS)) - set(drawn))
        chosen.append(fits[int(np.argmin(problem.errors(left, fits)))])
    share = np.mean(np.array(chosen) != 0, axis=0)
    middle = np.median(chosen, axis=0)
    return problem.told(np.where(share >= INCLUDED, middle, 0.0))


def sindy(
    paths: list[Path], motor: Path, weak: bool, keep: Callable[[Problem], Kept] = kept
) -> dict[str, Any] | None:
    """PySINDy's answer: the terms it keeps beyond the textbook, the strongest first; None where the speed is missing."""
    records = [read(path) for path in sorted(paths)]
    if any("w" not in record.d for record in records):
        return None
    plate = tomllib.loads(motor.read_text(encoding="utf-8"))
    shown = [terms(record, plate, weak) for record in records]
    found: list[tuple[float, tuple[str, ...], str]] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for equation in ("electrical", "mechanical", "thermal"):
            # A fast record is too short to warm.
            used = [
                own[equation]
                for record, own in zip(records, shown, strict=True)
                if equation in own and (equation != "thermal" or record.slow)
            ]
            if used:
                found += [(size, names, equation) for size, names in keep(Problem.of(used))]
    found.sort(reverse=True)
    groups: list[list[str]] = []
    for _, names, _ in found:
        groups += [list(names)] if not any(set(names) & set(group) for group in groups) else []
    verdict = "adequate" if not groups else "named" if all(len(group) == 1 for group in groups) else "group"
    return {
        "verdict": verdict,
        "chosen": [groups[0][0]] if groups else [],
        "groups": groups,
        "equation": found[0][2] if found else None,
        "candidates": [{"name": name} for group in groups for name in group],
    }


def _place(layout: list[Column], columns: list[Column], k: int) -> int:
    """Where a column of a record stands among those of the first."""
    if columns is layout:
        return k
    same = [
        [
            j
            for j, other in enumerate(group)
            if (other.names, other.rate) == (columns[k].names, columns[k].rate)
        ]
        for group in (columns, layout)
    ]
    return same[1][same[0].index(k)]


def _merged(live: list[int], layout: list[Column], table: Array) -> tuple[list[int], list[tuple[str, ...]]]:
    """Columns without copies, the target left out, and the names that each stands for; () for the textbook's."""
    order = sorted((k for k in live if k > 0), key=lambda k: bool(layout[k].names))
    alike = table.T @ table
    taken: list[int] = []
    names: dict[int, tuple[str, ...]] = {}
    for k in order:
        twin = next((j for j in taken if alike[j, k] ** 2 > SAME**2 * alike[j, j] * alike[k, k]), None)
        if twin is None:
            taken.append(k)
            names[k] = layout[k].names
        elif names[twin]:
            names[twin] = tuple(dict.fromkeys((*names[twin], *layout[k].names)))
    return taken, [names[k] for k in taken]


def _compressed(parts: list[Array]) -> list[Array]:
    """The triangular factors of blocks of time, target first: least squares on them is least squares on the rows."""
    blocks: list[list[Array]] = [[] for _ in range(BLOCKS)]
    for part in parts:
        for k, piece in enumerate(np.array_split(part, BLOCKS)):
            blocks[k].append(piece)
    return [np.linalg.qr(np.concatenate(pieces), mode="r") for pieces in blocks]


def _fits(blocks: list[Array], extra: NDArray[np.bool_]) -> list[Array]:
    """Coefficients of the textbook alone and with the terms that PySINDy's optimisers choose beside it.

    Sequentially thresholded least squares, and forward regression for one to FORWARD terms: the first is misled by columns
    that are nearly alike, the second by those that only help together. The textbook's terms are projected out before.
    """
    import pysindy

    table = np.concatenate(blocks)
    y, x = table[:, :1], table[:, 1:]
    first = int((~extra).sum())
    left = np.linalg.qr(np.column_stack([x[:, ~extra], x[:, extra], y]), mode="r")[first:, first:]
    candidates, target = left[:, :-1], left[:, -1:]
    # A term that these blocks never visit has nothing to be scaled by.
    visited = np.linalg.norm(candidates, axis=0) > 0
    supports = [np.zeros(int(extra.sum()), bool)]
    if visited.any():
        optimizers = [
            pysindy.STLSQ(threshold=threshold, alpha=RIDGE, unbias=False) for threshold in THRESHOLDS
        ]
        steps = [np.asarray(one.fit(candidates[:, visited], target).coef_[0]) for one in optimizers]
        forward = pysindy.FROLS(
            alpha=RIDGE, max_iter=min(FORWARD, int(visited.sum())), normalize_columns=True
        )
        forward.fit(candidates[:, visited], target)
        for coefficients in (*steps, *(np.asarray(step[0]) for step in forward.history_)):
            support = visited.copy()
            support[visited] = coefficients != 0
            supports.append(support)
    # As many models from every fold.
    supports += supports[:1] * (1 + len(THRESHOLDS) + FORWARD - len(supports))
    fits = []
    for support in supports:
        free = ~extra
        free[extra] = support
        fits.append(np.zeros(len(extra)))
        fits[-1][free] = np.linalg.lstsq(x[:, free], y[:, 0], rcond=1e-10)[0]
    return fits
