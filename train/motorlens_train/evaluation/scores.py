"""How good a virtual sensor is: its errors beside those of other methods and of the bound, and where they come from.

Errors count from one second after the first voltage step of a recording: before anything has excited the motor, no method
can know how warm it is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_train.baselines.method import OUTPUTS, UNITS, Array, Estimate, Method, inputs, low_pass, truth
from motorlens_train.bound import Noise, Prior, bound_of_recording

# The first step is where the voltage exceeds this share of the rated one; errors count from SETTLED_S later.
FIRST_STEP, SETTLED_S = 0.2, 1.0
# Steady: this many mechanical time constants after the last excitation.
STEADY = 8.0
COVERAGE_SD = 1.959964


@dataclass(frozen=True)
class Score:
    """One method, one output: errors in the output's unit, shares in 0 ... 1; NaN where there is nothing to say.

    `ratio` is the root mean square error over that of the bound.
    """

    rms: float
    max: float
    steady: float
    coverage: float
    ratio: float


@dataclass(frozen=True)
class Trace:
    """One recording: truth (N, 3), estimates by method, the bound (N, 3) or None, and which rows count.

    `idle_s` (N,) is the time since the last excitation.
    """

    recording: Recording
    truth: Array
    estimates: Mapping[str, Estimate]
    bound: Array | None
    counted: np.ndarray
    idle_s: Array


@dataclass(frozen=True)
class Evaluation:
    """Scores by method and output, and the traces they come from."""

    scores: Mapping[str, Mapping[str, Score]]
    traces: tuple[Trace, ...]
    notes: tuple[str, ...] = field(default=())

    def document(self) -> dict[str, object]:
        """As JSON; what is not known is null."""

        def number(value: float) -> float | None:
            return float(f"{value:.5g}") if np.isfinite(value) else None

        return {
            "schema": "motorlens.evaluate/1",
            "recordings": [trace.recording.name for trace in self.traces],
            "rows": int(sum(trace.counted.sum() for trace in self.traces)),
            "units": UNITS,
            "methods": {
                name: {
                    output: {key: number(value) for key, value in vars(score).items()}
                    for output, score in row.items()
                }
                for name, row in self.scores.items()
            },
            "coverage_by_excitation": {
                name: {output: [number(share) for share in shares] for output, shares in table.items()}
                for name, table in self.coverage_by_excitation().items()
            },
            "notes": list(self.notes),
        }

    def coverage_by_excitation(self) -> dict[str, dict[str, list[float]]]:
        """Coverage of the 95 % interval in each third of the time since the last excitation, by method and output."""
        idle = np.concatenate([t.idle_s[t.counted] for t in self.traces])
        edges = np.quantile(idle, [1 / 3, 2 / 3])
        third = np.searchsorted(edges, idle, side="right")
        table: dict[str, dict[str, list[float]]] = {}
        for name in self.scores:
            inside = np.concatenate([_inside(t, name)[t.counted] for t in self.traces])
            table[name] = {
                output: [_mean(inside[third == j, k]) for j in range(3)] for k, output in enumerate(OUTPUTS)
            }
        return table


def evaluate(
    methods: Mapping[str, Method],
    recordings: Sequence[Recording],
    motor_file: MotorFile,
    noise: Noise | None = None,
    prior: Prior | None = None,
) -> Evaluation:
    """Score fitted methods on recordings with their true channels.

    Args:
        methods: by name, fitted.
        recordings: with at least one of speed, temperature and resistance.
        motor_file: the true motor as far as it is known; the bound's motor.
        noise: what the bound assumes; None leaves the bound out.
        prior: what the bound knows before the first sample; None: nothing but the rating plate.
    """
    traces, notes = [], []
    for recording in recordings:
        limits = None
        if noise is not None:
            if all(recording.has(quantity) for quantity in ("load_torque", "ambient", "temperature")):
                limits = bound_of_recording(
                    motor_file.motor, recording, noise, prior or plate_prior(motor_file)
                ).outputs
            else:
                notes.append(f"{recording.name}: no bound, which needs load torque, ambient and temperature")
        found = {name: method.estimate(recording) for name, method in methods.items()}
        traces.append(
            Trace(
                recording,
                truth(recording, motor_file),
                found,
                limits,
                counted(recording, motor_file),
                idle(recording, motor_file),
            )
        )
    scores = {
        name: {output: _score(traces, name, k, motor_file) for k, output in enumerate(OUTPUTS)}
        for name in methods
    }
    return Evaluation(scores, tuple(traces), tuple(notes))


def plate_prior(motor_file: MotorFile) -> Prior:
    """An unknown start: anything the rating plate allows."""
    rated = motor_file.rated
    sd = {
        "i": rated.current_A,
        "w": rated.speed_rad_s / 4,
        "theta": 0.45 * rated.rise_K,
        "load": rated.torque_Nm,
    }
    slow = {"theta_m": 0.3 * rated.rise_K, "theta_h": 0.3 * rated.rise_K}
    return Prior(sd | slow)


def counted(recording: Recording, motor_file: MotorFile) -> np.ndarray:
    """Which rows count (N,): from one second after the first voltage step on."""
    _, v, _ = inputs(recording)
    stepped = np.abs(v) > FIRST_STEP * motor_file.rated.voltage_V
    if not stepped.any():
        return np.ones(len(v), dtype=bool)
    start = recording.time_s[int(np.argmax(stepped))] + min(SETTLED_S, 0.1 * recording.duration_s)
    return np.asarray(recording.time_s >= start)


def idle(recording: Recording, motor_file: MotorFile) -> Array:
    """Seconds (N,) since voltage or current last changed by more than two percent of the rating plate."""
    time, v, i = inputs(recording)
    m, rated = motor_file.motor, motor_file.rated
    pace = m.R_a0 * m.J / m.ke**2
    excited = np.zeros(len(time), dtype=bool)
    for y, size in ((v, rated.voltage_V), (i, rated.current_A)):
        fast, slow = low_pass(time, y, pace / 2), low_pass(time, y, 2 * pace)
        excited |= np.abs(fast - slow) > (0.02 * size if y is v else 0.1 * size)
    excited[0] = True
    last = np.maximum.accumulate(np.where(excited, time, -np.inf))
    return np.asarray(time - last)


def text_table(evaluation: Evaluation) -> str:
    """The scores as lines of text: one line a method, for each output rms, max, steady, coverage and ratio to the bound."""
    lines = []
    for output in OUTPUTS:
        rows = [
            (name, row[output]) for name, row in evaluation.scores.items() if np.isfinite(row[output].rms)
        ]
        if not rows:
            continue
        lines.append(
            f"{output + ' (' + UNITS[output] + ')':<26}{'rms':>10}{'max':>10}{'steady':>10}{'in 95 %':>10}{'x bound':>10}"
        )
        for name, score in rows:
            share = f"{100 * score.coverage:.1f} %" if np.isfinite(score.coverage) else "-"
            ratio = f"{score.ratio:.2f}" if np.isfinite(score.ratio) else "-"
            cells = "".join(f"{value:>10.4g}" for value in (score.rms, score.max, score.steady))
            lines.append(f"  {name:<24}{cells}{share:>10}{ratio:>10}")
    return "\n".join(lines)


def _score(traces: Sequence[Trace], name: str, k: int, motor_file: MotorFile) -> Score:
    m = motor_file.motor
    pace = m.R_a0 * m.J / m.ke**2
    errors, steady, limits = [], [], []
    for trace in traces:
        error = trace.estimates[name].values[:, k] - trace.truth[:, k]
        rows = trace.counted & np.isfinite(error)
        errors.append(error[rows])
        steady.append(error[rows & (trace.idle_s > STEADY * pace)])
        if trace.bound is not None:
            limits.append(trace.bound[rows, k])
    joined, still = np.concatenate(errors), np.concatenate(steady)
    if not len(joined):
        return Score(*[float("nan")] * 5)
    rms = float(np.sqrt(np.mean(joined**2)))
    inside = np.concatenate([_inside(trace, name)[trace.counted, k] for trace in traces])
    whole = len(limits) == len(traces)
    ratio = rms / float(np.sqrt(np.mean(np.concatenate(limits) ** 2))) if whole else float("nan")
    return Score(
        rms, float(np.abs(joined).max()), float(np.sqrt(np.mean(still**2))) if len(still) else float("nan"),
        _mean(inside), ratio,
    )  # fmt: skip


def _inside(trace: Trace, name: str) -> Array:
    """1 where the 95 % interval holds the truth, 0 where not, NaN where one of them is not known; (N, 3)."""
    estimate = trace.estimates[name]
    error = np.abs(estimate.values - trace.truth)
    known = np.isfinite(error) & np.isfinite(estimate.sds)
    return np.where(known, error <= COVERAGE_SD * estimate.sds, np.nan)


def _mean(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else float("nan")
