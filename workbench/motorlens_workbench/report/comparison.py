"""What `compare` found: as JSON, as a table for the terminal, and as a page."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.run import UNIT_OF
from motorlens_physics.scenario import time_constants
from motorlens_workbench.balances import EQUATIONS
from motorlens_workbench.compare.comparison import Comparison
from motorlens_workbench.compare.equations import remark
from motorlens_workbench.compare.where import Region
from motorlens_workbench.report.overlay import overlay
from motorlens_workbench.report.page import Page, Section, significant, unit_text
from motorlens_workbench.report.pictures import (
    Bar,
    Bars,
    Cell,
    Fact,
    Grid,
    Plot,
    Samples,
    Table,
    cloud,
    curves,
)

# Error in multiples of the noise at which the next colour of the map begins: 1 is as good as can be, and from 100 on the
# model is of no use there. Fixed, so that maps can be compared.
BORDERS = (1.5, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0, 100.0)
# Points of a cumulative periodogram.
POINTS = 600


def verdict(found: Comparison) -> str:
    """One sentence: how good the model is, and where it fails."""
    worst = found.worst
    channel = found.channels[worst]
    size = f"{significant(channel.rmse)} {unit_text(channel.unit)} rms in {worst}, {_times(channel.times_noise)} its noise"
    if found.follows:
        return f"The model follows these recordings to their noise ({size})."
    named = [name for name, equation in found.equations.items() if equation.testable and equation.share > 0]
    if not named:
        return f"The model misses these recordings by {size}; no equation can be tested on its own."
    equation = max(named, key=lambda name: found.equations[name].share)
    share = 100 * found.equations[equation].share
    return f"The model misses these recordings by {size}; {share:.0f} % of what is lacking is in the {equation} equation."


def to_json(found: Comparison, recordings: Sequence[str], motor: str) -> dict[str, Any]:
    """The document of `--json`, schema motorlens.compare/1."""
    equations: dict[str, Any] = {}
    for name, equation in found.equations.items():
        equations[name] = {
            "share": equation.share,
            "testable": equation.testable,
            "rms": equation.rms,
            "unit": equation.unit,
        }
        why = equation.why or remark(name, found.overlays)
        if why:
            equations[name]["why"] = why
    return {
        "schema": "motorlens.compare/1",
        "motor": motor,
        "recordings": list(recordings),
        "channels": {
            name: {
                "unit": c.unit, "rmse": c.rmse, "nrmse_percent": c.fit_percent, "bias": c.bias, "max": c.largest,
                "noise_floor": c.noise_floor,
            }
            for name, c in found.channels.items()
        },
        "equations": equations,
        "regions": [
            {**{q: list(span) for q, span in r.within.items()}, "rms_in_sigma": r.rms_in_sigma, "samples": r.samples}
            for r in found.map
        ],
        "named_regions": {
            name: {
                **{q: list(span) for q, span in r.within.items()}, "rms_in_sigma": r.rms_in_sigma, "samples": r.samples,
            }
            for name, r in found.regions.items()
        },
        "half_of_the_error": vars(found.half),
        "time_scales": {channel: dict(bands) for channel, bands in found.bands.items()},
        "notes": list(found.notes),
        "orders": [{"order": order, "amplitude_rad_s": amplitude} for order, amplitude in found.orders],
    }  # fmt: skip


def to_text(found: Comparison) -> str:
    """The table for the terminal."""
    rows = [verdict(found), ""]
    rows.append(
        f"{'channel':14}{'rmse':>11}{'x noise':>9}{'fit %':>8}{'bias':>11}{'largest':>11}{'noise':>11}"
    )
    for name, c in found.channels.items():
        times = c.times_noise
        rows.append(
            f"{name + ', ' + c.unit:14}{c.rmse:11.4g}{times:9.3g}{c.fit_percent:8.1f}{c.bias:11.3g}{c.largest:11.4g}"
            f"{c.noise_floor:11.3g}"
        )
    rows += ["", f"{'equation':14}{'share':>8}{'lacks, rms':>16}"]
    for name, e in found.equations.items():
        share = f"{100 * e.share:.0f} %" if e.testable else "-"
        note = f"not testable: {e.why}" if e.why else remark(name, found.overlays)
        rows.append(f"{name:14}{share:>8}{e.rms:12.4g} {e.unit:4} {note}".rstrip())
    rows += ["", f"{'where':18}{'error, x noise':>16}{'samples':>10}"]
    rows += [
        f"{name:18}{significant(r.rms_in_sigma, 3):>16}{r.samples:10d}" for name, r in found.regions.items()
    ]
    if not found.follows:
        rows.append(_when(found) + ".")
    rows += [
        "",
        f"{'at the pace of':14}" + "".join(f"{band:>12}" for band in ("thermal", "mechanical", "electrical")),
    ]
    for name, bands in found.bands.items():
        rows.append(f"{name:14}" + "".join(f"{100 * share:10.0f} %" for share in bands.values()))
    if found.orders:
        orders = ", ".join(f"{order:.0f} ({amplitude:.3g} rad/s)" for order, amplitude in found.orders)
        rows += ["", f"strongest shaft orders in the speed error: {orders}"]
    return "\n".join([*rows, *([""] if found.notes else []), *found.notes])


def to_html(
    found: Comparison, recordings: Sequence[str], motor: str, command: str, remarks: Sequence[str] = ()
) -> Page:
    """The page of `--html`; `remarks` are what was noticed in reading."""
    summary = [
        f"Motor file {motor}, run freely on {', '.join(recordings)}, driven by the measured inputs; nothing of the motor "
        "was fitted. What is missing is the question of motorlens diagnose.",
        *(f"{remark}." for remark in remarks),
        "The noise floor is what a perfect model would miss by: the noise of the sensor itself, and what the noise of the "
        "measured inputs stirs up in the simulation and did not stir up in the motor.",
        *(f"{note}." for note in found.notes),
    ]
    sections = [
        Section("Measured and predicted", _overlays(found)),
        Section("Which equation fails", _equation_content(found)),
        Section("Where it fails", _region_content(found)),
        Section("At which time scale", _band_content(found)),
        Section("Numbers", [_channel_table(found)]),
    ]
    title = f"motorlens compare: {found.file.name}"
    return Page(title, verdict(found), summary, sections, [command], facts=_facts(found))


def _facts(found: Comparison) -> list[Fact]:
    """What an engineer asks first: how far off, in which equation, where, when, and at which pace."""
    sizes = [
        f"{name} {significant(c.rmse)} {unit_text(c.unit)} ({_times(c.times_noise)} the noise)"
        for name, c in sorted(found.channels.items(), key=lambda pair: -pair[1].times_noise)
    ]
    facts = [Fact("Error, rms", ", ".join(sizes))]
    if found.follows:
        return facts
    tested = {name: e.share for name, e in found.equations.items() if e.testable}
    if any(tested.values()):
        shares = ", ".join(f"{name} {100 * share:.0f} %" for name, share in _falling(tested))
        facts.append(Fact("Equation", f"{shares} of what is lacking"))
    moving = {name: r.rms_in_sigma for name, r in found.regions.items() if "speed" in r.within}
    if moving:
        (worst, times), *others = _falling(moving)
        beside = "; ".join(f"{name} {_times(value)}" for name, value in others)
        text = f"{worst}, {_times(times)} the noise" + (f" ({beside})" if beside else "")
        facts.append(Fact("Where", text, Samples(worst, found.regions[worst].within)))
    half = found.half
    within = {"time": (half.start_s, half.stop_s)}
    samples = Samples(f"half of the error of {half.channel}", within, recording=half.recording)
    facts.append(Fact("When", _when(found), samples))
    (scale, share), *_ = _falling(found.bands[found.worst])
    seconds = significant(getattr(time_constants(found.file.motor), f"{scale}_s"), 2)
    text = f"{100 * share:.0f} % of it is at the pace of the {scale} time constant, {seconds} s"
    facts.append(Fact("Time scale", text))
    return facts


def _falling(values: Mapping[str, float]) -> list[tuple[str, float]]:
    return sorted(values.items(), key=lambda pair: -pair[1])


def _times(value: float) -> str:
    return f"{significant(float(f'{value:.2g}'))} times"


def _when(found: Comparison) -> str:
    half = found.half
    of = f" of {half.recording}" if len(found.overlays) > 1 else ""
    if half.start_s == half.stop_s:
        return f"half of the squared error of {half.channel} is that of one sample{of}, at {significant(half.start_s)} s"
    return (
        f"half of the squared error of {half.channel} lies in {significant(100 * half.share, 2)} % of the time{of}: "
        f"{significant(half.start_s)} to {significant(half.stop_s)} s"
    )


def _overlays(found: Comparison) -> list[str | Table | Bars | Grid | Plot]:
    return [
        overlay(
            o.run,
            o.trajectory,
            {"predicted": ("predicted", o.predicted)},
            dict(zip(o.run.channels, o.noise.tolist(), strict=True)),
            {name: o.missing[name] for name in EQUATIONS if found.equations[name].testable},
        )
        for o in found.overlays
    ]


def _equation_content(found: Comparison) -> list[str | Table | Bars | Grid | Plot]:
    testable = [name for name in EQUATIONS if found.equations[name].testable]
    content: list[str | Table | Bars | Grid | Plot] = []
    for name in EQUATIONS:
        if not found.equations[name].testable:
            content.append(f"The {name} equation cannot be tested: {found.equations[name].why}.")
        elif note := remark(name, found.overlays):
            content.append(f"For the {name} equation, {note}.")
    if testable:
        shares = [
            Bar(name, 100 * found.equations[name].share, "lacking", Samples(f"{name} equation", lacks=name))
            for name in testable
        ]
        caption = "A click on an equation marks, in the plots above, the tenth of the samples at which it lacks most."
        content.append(Bars("Share of what is lacking", "%", shares, caption))
    for name in testable:
        caption = f"What the {name} equation lacks when it is driven by the measured others, against speed."
        content.append(cloud("speed, rad/s", f"lacking, {EQUATIONS[name]}", "speed", name, caption))
    return content


def _region_content(found: Comparison) -> list[str | Table | Bars | Grid | Plot]:
    bars = [
        Bar(
            f"{_region(name, r)} ({r.samples} samples)",
            r.rms_in_sigma,
            "predicted",
            Samples(name, r.within),
        )
        for name, r in found.regions.items()
    ]
    content: list[str | Table | Bars | Grid | Plot] = [
        Bars("Error, in multiples of the noise floor", "", bars, "A click on a region marks its samples in the plots above.")
    ]  # fmt: skip
    if found.map:
        content.append(_map(found))
    return content


def _region(name: str, region: Region) -> str:
    """A third by temperature says how warm that is."""
    if "temperature" not in region.within:
        return name
    low, high = region.within["temperature"]
    return f"{name}, {significant(low, 3)} to {significant(high, 3)} °C"


def _map(found: Comparison) -> Grid:
    # The cells are of one size; a row or a column that is empty stands all the same.
    spans = {q: _spans([r.within[q] for r in found.map]) for q in ("speed", "current")}
    cells = []
    for r in found.map:
        where = " and ".join(f"{q} {_range(r.within[q])} {UNIT_OF[q]}" for q in ("speed", "current"))
        at = [
            int(np.argmin([abs(span[0] - r.within[q][0]) for span in spans[q]])) for q in ("speed", "current")
        ]
        cells.append(
            Cell(at[0], at[1], r.rms_in_sigma, f"{where}: {r.samples} samples", Samples(where, r.within))
        )
    return Grid(
        "speed, rad/s (to the right)", "current, A (upwards)", [_range(span) for span in spans["speed"]],
        [_range(span) for span in spans["current"]], cells, BORDERS,
        "Error in each cell of the operating range, in multiples of the noise floor:",
        "A cell with few samples is left empty. A click on a cell marks its samples in the plots above.",
    )  # fmt: skip


def _spans(there: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    low, high = min(span[0] for span in there), max(span[1] for span in there)
    number = max(1, round((high - low) / (there[0][1] - there[0][0])))
    edges = np.linspace(low, high, number + 1).tolist()
    return list(pairwise(edges))


def _range(span: tuple[float, float]) -> str:
    return f"{span[0]:.3g} to {span[1]:.3g}"


def _band_content(found: Comparison) -> list[str | Table | Bars | Grid | Plot]:
    pace = time_constants(found.file.motor)
    corners = {"thermal": pace.thermal_s, "mechanical": pace.mechanical_s, "electrical": pace.electrical_s}
    bands = [o.band_Hz for o in found.overlays]
    at = np.geomspace(min(low for low, _ in bands), max(high for _, high in bands), POINTS)
    roles = {"current": "predicted", "speed": "lacking", "temperature": "measured"}
    several = len(found.overlays) > 1
    lines = {
        (f"{o.run.name}: {channel}" if several else channel): (
            roles[channel],
            _cumulative(at, *o.spectrum(channel)),
        )
        for o in found.overlays
        for channel in o.run.channels
    }
    caption = "Cumulative periodogram of the error. The dotted lines are the motor's own corner frequencies."
    content: list[str | Table | Bars | Grid | Plot] = [
        curves(
            "frequency, Hz", "share of the error's power below", at, lines, logarithmic=True,
            marks={name: 1 / (2 * np.pi * tau) for name, tau in corners.items()}, caption=caption,
        )
    ]  # fmt: skip
    if found.orders:
        content.append(
            Table(["order of the shaft", "amplitude, rad/s"], found.orders, "Strongest in the speed error.")
        )
    return content


def _cumulative(
    at: NDArray[np.float64], frequency: NDArray[np.float64], power: NDArray[np.float64]
) -> NDArray[np.float64]:
    share = np.cumsum(power[1:]) / max(float(np.sum(power[1:])), 1e-300)
    # The step curve at these frequencies: no point of it is made up.
    index = np.searchsorted(frequency[1:], at * (1 + 1e-9), side="right") - 1
    found = np.where(index >= 0, share[np.maximum(index, 0)], np.nan)
    return np.where(at > frequency[-1] * (1 + 1e-9), np.nan, found)


def _channel_table(found: Comparison) -> Table:
    rows = [
        [
            name, unit_text(c.unit), c.rmse, c.times_noise, c.fit_percent, c.bias, c.largest, c.noise_floor,
        ]
        for name, c in found.channels.items()
    ]  # fmt: skip
    return Table(
        ["channel", "unit", "rmse", "times the noise", "fit, %", "bias", "largest", "noise floor"], rows
    )
