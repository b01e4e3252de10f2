"""What an evaluation looks like: estimate and truth, errors over time since excitation and over region, coverage, ladder."""

import base64
import html
import io
from pathlib import Path
from typing import Any

import numpy as np

from motorlens_train.baselines.method import OUTPUTS, UNITS
from motorlens_train.evaluation.scores import COVERAGE_SD, Evaluation, Trace, text_table

# At most so many points of a line are drawn; more than a screen has columns is waste.
_POINTS = 4000


def draw(evaluation: Evaluation, best: str) -> Any:
    """A matplotlib figure: one column an output; `best` is the method whose intervals and regions are shown."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    outputs = [k for k, output in enumerate(OUTPUTS) if np.isfinite(evaluation.scores[best][output].rms)]
    figure, axes = pyplot.subplots(
        5, len(outputs), figsize=(5.2 * len(outputs), 17), squeeze=False, layout="constrained"
    )
    for column, k in enumerate(outputs):
        output, unit = OUTPUTS[k], UNITS[OUTPUTS[k]]
        _overlay(axes[0, column], evaluation.traces[0], best, k)
        _since_excitation(axes[1, column], evaluation, best, k)
        _regions(axes[2, column], evaluation, best, k, figure)
        _coverage(axes[3, column], evaluation, best, k)
        _ladder(axes[4, column], evaluation, k)
        axes[0, column].set_title(f"{output} ({unit})")
    return figure


def save_png(evaluation: Evaluation, best: str, path: Path | str) -> None:
    """Write the figure as PNG."""
    Path(path).write_bytes(_png(evaluation, best))


def save_html(evaluation: Evaluation, best: str, path: Path | str) -> None:
    """Write table and figure as one page that opens without a network."""
    picture = base64.b64encode(_png(evaluation, best)).decode()
    names = ", ".join(html.escape(trace.recording.name) for trace in evaluation.traces)
    notes = "".join(f"<p>{html.escape(note)}</p>" for note in evaluation.notes)
    Path(path).write_text(
        "<!doctype html><html lang='en'><meta charset='utf-8'><title>motorlens evaluate</title>"
        "<style>body{font:15px/1.4 system-ui;margin:2em auto;max-width:1100px}img{width:100%}</style>"
        f"<h1>Evaluation of {html.escape(best)}</h1><p>{names}</p><pre>{html.escape(text_table(evaluation))}</pre>{notes}"
        f"<img alt='estimates, errors, coverage and ladder' src='data:image/png;base64,{picture}'></html>",
        encoding="utf-8",
    )


def _png(evaluation: Evaluation, best: str) -> bytes:
    from matplotlib import pyplot

    figure = draw(evaluation, best)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    pyplot.close(figure)
    return buffer.getvalue()


def _overlay(axis: Any, trace: Trace, best: str, k: int) -> None:
    """Estimate, its interval and the truth over time."""
    time, estimate = trace.recording.time_s, trace.estimates[best]
    some = slice(None, None, max(1, len(time) // _POINTS))
    value, sd = estimate.values[some, k], estimate.sds[some, k]
    axis.fill_between(
        time[some], value - COVERAGE_SD * sd, value + COVERAGE_SD * sd, alpha=0.25, lw=0, label="95 %"
    )
    axis.plot(time[some], value, lw=1, label=best)
    axis.plot(time[some], trace.truth[some, k], "k--", lw=0.8, label="truth")
    span = trace.truth[trace.counted, k]
    low, high = np.nanmin(span), np.nanmax(span)
    margin = 0.15 * (high - low) + 1e-9
    axis.set(xlabel="time (s)", ylim=(low - margin, high + margin))
    axis.legend(fontsize=8)


def _since_excitation(axis: Any, evaluation: Evaluation, best: str, k: int) -> None:
    """Root mean square error and mean standard deviation over the time since the last excitation."""
    idle = np.concatenate([t.idle_s[t.counted] for t in evaluation.traces])
    error = np.concatenate([(t.estimates[best].values - t.truth)[t.counted, k] for t in evaluation.traces])
    sd = np.concatenate([t.estimates[best].sds[t.counted, k] for t in evaluation.traces])
    edges = np.unique(np.quantile(idle, np.linspace(0, 1, 13)))
    place = np.clip(np.searchsorted(edges, idle, side="right") - 1, 0, max(len(edges) - 2, 0))
    bins = [place == j for j in range(max(len(edges) - 1, 1))]
    middle = [float(np.median(idle[b])) for b in bins if b.any()]
    axis.plot(
        middle,
        [float(np.sqrt(np.nanmean(error[b] ** 2))) for b in bins if b.any()],
        "o-",
        ms=3,
        label="rms error",
    )
    axis.plot(
        middle,
        [float(np.sqrt(np.nanmean(sd[b] ** 2))) for b in bins if b.any()],
        "s--",
        ms=3,
        label="published sd",
    )
    axis.set(xlabel="time since last excitation (s)", ylabel=UNITS[OUTPUTS[k]], ylim=(0, None))
    axis.legend(fontsize=8)


def _regions(axis: Any, evaluation: Evaluation, best: str, k: int, figure: Any) -> None:
    """Root mean square error over voltage and current."""
    rows = [
        (t.recording.channels["voltage"][t.counted], t.recording.channels["current"][t.counted],
         (t.estimates[best].values - t.truth)[t.counted, k] ** 2)
        for t in evaluation.traces
    ]  # fmt: skip
    v, i, square = (np.concatenate([row[j] for row in rows]) for j in range(3))
    known = np.isfinite(square) & np.isfinite(i)
    v, i, square = v[known], i[known], square[known]
    ranges = [np.quantile(y, [0.001, 0.999]) + np.array([-1e-6, 1e-6]) for y in (v, i)]
    count, x, y = np.histogram2d(v, i, bins=18, range=ranges)
    total, _, _ = np.histogram2d(v, i, bins=18, range=ranges, weights=square)
    with np.errstate(invalid="ignore"):
        mean = np.sqrt(total / np.where(count > 0, count, np.nan))
    image = axis.pcolormesh(x, y, mean.T, cmap="viridis")
    figure.colorbar(image, ax=axis, label=f"rms error ({UNITS[OUTPUTS[k]]})")
    axis.set(xlabel="voltage (V)", ylabel="current (A)")


def _coverage(axis: Any, evaluation: Evaluation, best: str, k: int) -> None:
    """How often intervals of each nominal coverage hold the truth."""
    from scipy.stats import norm

    z = np.concatenate(
        [
            np.abs((t.estimates[best].values - t.truth) / t.estimates[best].sds)[t.counted, k]
            for t in evaluation.traces
        ]
    )
    nominal = np.linspace(0.02, 0.995, 60)
    axis.plot(
        nominal, [float(np.mean(z[np.isfinite(z)] <= norm.ppf(0.5 + p / 2))) for p in nominal], label=best
    )
    axis.plot([0, 1], [0, 1], "k--", lw=0.8)
    axis.set(xlabel="nominal coverage", ylabel="coverage found", xlim=(0, 1), ylim=(0, 1))


def _ladder(axis: Any, evaluation: Evaluation, k: int) -> None:
    """Root mean square error of every method, and of the bound."""
    scores = {
        name: row[OUTPUTS[k]].rms
        for name, row in evaluation.scores.items()
        if np.isfinite(row[OUTPUTS[k]].rms)
    }
    bounds = [t.bound[t.counted, k] for t in evaluation.traces if t.bound is not None]
    if bounds:
        scores["bound"] = float(np.sqrt(np.mean(np.concatenate(bounds) ** 2)))
    ranked = sorted(scores.items(), key=lambda item: -item[1])
    axis.barh([name for name, _ in ranked], [value for _, value in ranked])
    axis.set(xscale="log", xlabel=f"rms error ({UNITS[OUTPUTS[k]]})")
