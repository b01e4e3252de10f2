"""What `compare` found: as JSON, as a table for the terminal, and as a page."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from motorlens_physics.scenario import time_constants
from motorlens_workbench.balances import EQUATIONS
from motorlens_workbench.comparison import Comparison, Overlay, remark, spectrum
from motorlens_workbench.report import (
    LACKING,
    MEASURED,
    NOISE,
    PREDICTED,
    Picture,
    Section,
    Table,
    bars,
    figure,
    line,
    page,
    significant,
)


def verdict(found: Comparison) -> str:
    """One sentence: how good the model is, and where it fails."""
    worst = max(
        found.channels, key=lambda c: found.channels[c].rmse / max(found.channels[c].noise_floor, 1e-300)
    )
    channel = found.channels[worst]
    times = channel.rmse / max(channel.noise_floor, 1e-300)
    size = f"{significant(channel.rmse)} {channel.unit} rms in {worst}, {times:.2g} times its noise"
    if times < 1.2:
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
        "time_scales": {channel: dict(bands) for channel, bands in found.bands.items()},
        "orders": [{"order": order, "amplitude_rad_s": amplitude} for order, amplitude in found.orders],
    }  # fmt: skip


def to_text(found: Comparison) -> str:
    """The table for the terminal."""
    rows = [verdict(found), ""]
    rows.append(
        f"{'channel':14}{'rmse':>11}{'x noise':>9}{'fit %':>8}{'bias':>11}{'largest':>11}{'noise':>11}"
    )
    for name, c in found.channels.items():
        times = c.rmse / max(c.noise_floor, 1e-300)
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
    rows += [f"{name:18}{r.rms_in_sigma:16.2f}{r.samples:10d}" for name, r in found.regions.items()]
    rows += [
        "",
        f"{'time scale':14}" + "".join(f"{band:>12}" for band in ("thermal", "mechanical", "electrical")),
    ]
    for name, bands in found.bands.items():
        rows.append(f"{name:14}" + "".join(f"{100 * share:10.0f} %" for share in bands.values()))
    if found.orders:
        orders = ", ".join(f"{order:.0f} ({amplitude:.3g} rad/s)" for order, amplitude in found.orders)
        rows += ["", f"strongest shaft orders in the speed error: {orders}"]
    return "\n".join(rows)


def to_html(found: Comparison, recordings: Sequence[str], motor: str, command: str) -> str:
    """The page of `--html`."""
    sections = [
        Section(
            "Measured and predicted", [picture for o in found.overlays for picture in _overlay_pictures(o)]
        ),
        Section("Which equation fails", _equation_content(found)),
        Section("Where it fails", _region_content(found)),
        Section("At which time scale", _band_content(found)),
        Section("Numbers", [_channel_table(found)]),
    ]
    summary = [
        f"Motor file {motor}, run freely from the first samples of {', '.join(recordings)}, driven by the measured inputs; "
        "nothing was fitted. What is missing is the question of motorlens diagnose."
    ]
    return page(f"motorlens compare: {found.file.name}", verdict(found), summary, sections, [command])


def _overlay_pictures(overlay: Overlay) -> list[Picture]:
    run, pictures = overlay.run, []
    time = run.inputs.time_s
    for k, channel in enumerate(run.channels):
        measured = np.where(run.valid, run.measured[:, k], np.nan)
        floor = float(overlay.noise[k])
        unit = {"current": "A", "speed": "rad/s", "temperature": "degC"}[channel]
        traces = [
            line(time, measured, "measured", MEASURED),
            line(time, overlay.predicted[:, k], "predicted", PREDICTED),
            line(time, overlay.error[:, k], "error", LACKING, 1.0, yaxis="y2"),
        ]
        axes = {"gridcolor": "#eaeef2", "zerolinecolor": "#9aa3af"}
        layout = {
            "xaxis": {**axes, "title": {"text": "time, s"}, "anchor": "y2"},
            "yaxis": {**axes, "title": {"text": f"{channel}, {unit}"}, "domain": [0.36, 1]},
            "yaxis2": {**axes, "title": {"text": f"error, {unit}"}, "domain": [0, 0.28]},
            "shapes": [
                {"type": "rect", "xref": "paper", "x0": 0, "x1": 1, "yref": "y2", "y0": -2 * floor, "y1": 2 * floor,
                 "fillcolor": NOISE, "opacity": 0.35, "line": {"width": 0}},
            ],
        }  # fmt: skip
        drawn = figure(traces, "time, s", "", 430, **layout)
        pictures.append(
            Picture(drawn, f"{run.name}: {channel}. The grey band is two standard deviations of the noise.")
        )
    return pictures


def _equation_content(found: Comparison) -> list[str | Picture | Table]:
    testable = [name for name in EQUATIONS if found.equations[name].testable]
    content: list[str | Picture | Table] = []
    for name in EQUATIONS:
        if not found.equations[name].testable:
            content.append(f"The {name} equation cannot be tested: {found.equations[name].why}.")
        elif note := remark(name, found.overlays):
            content.append(f"For the {name} equation, {note}.")
    if testable:
        shares = [100 * found.equations[name].share for name in testable]
        content.append(
            Picture(figure([bars(testable, shares, LACKING)], "share of what is lacking, %", "", 180))
        )
    for name in testable:
        unit = EQUATIONS[name]
        traces = []
        for o in found.overlays:
            w = (
                o.run.measured[:, o.run.channels.index("speed")]
                if "speed" in o.run.channels
                else o.trajectory.speed_rad_s
            )
            step = max(1, len(w) // 3000)
            traces.append(
                {"type": "scattergl", "mode": "markers", "x": [float(f"{v:.5g}") for v in w[::step]],
                 "y": [float(f"{v:.5g}") for v in o.missing[name][::step]], "name": o.run.name,
                 "marker": {"size": 3, "opacity": 0.5}}
            )  # fmt: skip
        caption = f"What the {name} equation lacks when it is driven by the measured others."
        content.append(Picture(figure(traces, "speed, rad/s", f"lacking, {unit}", 320), caption))
    return content


def _region_content(found: Comparison) -> list[str | Picture | Table]:
    rows = [[name, r.rms_in_sigma, r.samples] for name, r in found.regions.items()]
    content: list[str | Picture | Table] = [Table(["region", "error, times the noise", "samples"], rows)]
    if found.map:
        cells = {
            "type": "scatter", "mode": "markers+text",
            "x": [float(np.mean(r.within["speed"])) for r in found.map],
            "y": [float(np.mean(r.within["current"])) for r in found.map],
            "text": [f"{r.rms_in_sigma:.1f}" for r in found.map], "textfont": {"size": 11},
            "marker": {
                "symbol": "square", "size": 44, "color": [float(np.log10(max(r.rms_in_sigma, 0.1))) for r in found.map],
                "colorscale": "YlOrRd", "cmin": 0, "showscale": False,
            },
            "hovertext": [f"{r.samples} samples" for r in found.map],
        }  # fmt: skip
        caption = (
            "Error in each cell of the operating range, in multiples of the noise; cells with few samples."
        )
        content.append(Picture(figure([cells], "speed, rad/s", "current, A", 420), caption))
    return content


def _band_content(found: Comparison) -> list[str | Picture | Table]:
    pace = time_constants(found.file.motor)
    marks = {"thermal": pace.thermal_s, "mechanical": pace.mechanical_s, "electrical": pace.electrical_s}
    traces = []
    for o in found.overlays:
        for channel in o.run.channels:
            frequency, power = spectrum(o, channel)
            share = np.cumsum(power[1:]) / max(float(np.sum(power[1:])), 1e-300)
            traces.append(line(frequency[1:], share, f"{o.run.name}: {channel}", "", 1.4))
    for trace in traces:
        del trace["line"]["color"]
    shapes = [
        {"type": "line", "yref": "paper", "y0": 0, "y1": 1, "x0": 1 / (2 * np.pi * tau), "x1": 1 / (2 * np.pi * tau),
         "line": {"color": NOISE, "dash": "dot", "width": 1.2}}
        for tau in marks.values()
    ]  # fmt: skip
    above = {"y": 1, "yref": "paper", "yanchor": "bottom", "showarrow": False}
    notes = [
        {**above, "x": float(np.log10(1 / (2 * np.pi * tau))), "text": name} for name, tau in marks.items()
    ]
    drawn = figure(
        traces, "frequency, Hz", "share of the error's power below", 340, shapes=shapes, annotations=notes
    )
    drawn["layout"]["xaxis"]["type"] = "log"
    drawn["layout"]["legend"] = {"orientation": "v"}
    content: list[str | Picture | Table] = [
        Picture(
            drawn,
            "Cumulative periodogram of the error. The dotted lines are the motor's own corner frequencies.",
        )
    ]
    if found.orders:
        content.append(
            Table(["order of the shaft", "amplitude, rad/s"], found.orders, "Strongest in the speed error.")
        )
    return content


def _channel_table(found: Comparison) -> Table:
    rows = [
        [
            name,
            c.unit,
            c.rmse,
            c.rmse / max(c.noise_floor, 1e-300),
            c.fit_percent,
            c.bias,
            c.largest,
            c.noise_floor,
        ]
        for name, c in found.channels.items()
    ]
    return Table(["channel", "unit", "rmse", "times the noise", "fit, %", "bias", "largest", "noise"], rows)
