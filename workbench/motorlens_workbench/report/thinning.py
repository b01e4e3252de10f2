"""Long recordings in a page that can be sent: the samples at which any line is at its smallest or largest.

All lines of a plot keep the same samples, so what lies over each other in the page does so in the recording, and no peak is
lost; what is between two of them is not in the page.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from motorlens_workbench.report.pictures import Plot

Array = NDArray[np.float64]

# What the samples of a page may take; all else of it takes a tenth of a megabyte.
BUDGET_OCTETS = 1_300_000
# Octets of base64 that a sample of a line takes (float32), and its stamp.
_OCTETS, _STAMP = 4 * 4 / 3, 8 * 4 / 3
# However many plots a page has, each shows so many samples.
_FEWEST = 500


def within(plots: Sequence[Plot], budget_octets: float = BUDGET_OCTETS) -> list[Plot]:
    """The plots as they are if their samples fit, and otherwise with as many as fit, shared out by their lengths."""
    whole = sum(_OCTETS * len(values) for plot in plots for values in plot.data.values())
    if whole <= budget_octets:
        return [
            _said(plot, "Every sample is here.") if plot.spec["kind"] == "time" else plot for plot in plots
        ]
    share = budget_octets / (whole + _STAMP * sum(map(_length, plots)))
    return [thinned(plot, max(int(share * _length(plot)), _FEWEST)) for plot in plots]


def thinned(plot: Plot, samples: int) -> Plot:
    """A plot against time with about so many samples; any other, or a shorter one, as it is."""
    count = _length(plot)
    if plot.spec["kind"] != "time" or count <= samples:
        return plot
    lines = {(line["data"], line["less"]) for axes in plot.spec["plots"] for line in axes["lines"]}
    # Of a stretch, which keeps two samples a line, and its first.
    size = -(-count * (2 * len(lines) + 1) // samples)
    begins = np.arange(0, count - size + 1, size)
    kept = [begins, np.array([count - 1])]
    for data, less in lines:
        values = plot.data[data] - plot.data[less] if less else plot.data[data]
        stretches = values[: len(begins) * size].reshape(-1, size)
        missing = np.isnan(stretches)
        kept.append(begins + np.argmin(np.where(missing, np.inf, stretches), axis=1))
        kept.append(begins + np.argmax(np.where(missing, -np.inf, stretches), axis=1))
    at: NDArray[np.intp] = np.unique(np.concatenate(kept))
    time = plot.spec["time"]
    stamps = plot.data["time_s"][at] if "data" in time else time["start"] + time["step"] * at
    fewer = {name: values[at] for name, values in plot.data.items() if name != "time_s"}
    return _said(
        replace(plot, spec={**plot.spec, "time": {"data": "time_s"}}, data={**fewer, "time_s": stamps}),
        f"Of {count} samples {len(at)} are here: in each stretch of {size} the smallest and the largest of every line. "
        "--every-sample puts all into the page, and --range FROM:TO looks at a part.",
    )


def _said(plot: Plot, sentence: str) -> Plot:
    return replace(plot, caption=f"{plot.caption} {sentence}")


def _length(plot: Plot) -> int:
    return max((len(values) for values in plot.data.values()), default=0)
