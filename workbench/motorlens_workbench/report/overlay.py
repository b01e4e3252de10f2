"""Measured and predicted over each other, and the error below, for every channel of a recording."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.conditions import Shaft, Terminal
from motorlens_physics.estimate.run import STATE_OF, UNIT_OF, Run
from motorlens_physics.simulation import Trajectory
from motorlens_workbench.report.pictures import Axes, Line, Plot, Series, time_plots

Array = NDArray[np.float64]


def overlay(
    run: Run,
    trajectory: Trajectory,
    predicted: Mapping[str, tuple[str, Array]],
    noise: Mapping[str, float],
    lacks: Mapping[str, Series] | None = None,
    remark: str = "",
) -> Plot:
    """The plots of one recording.

    Args:
        run: what was measured.
        trajectory: a simulation of it, for the states that were not measured.
        predicted: name of a model -> its colour and (N, C) what it predicts.
        noise: channel -> standard deviation of the noise floor; the band is twice that.
        lacks: equation -> (N,) what it lacks.
        remark: what the caption ends with.
    """
    axes: list[Axes] = []
    data: dict[str, Series] = {}
    for k, channel in enumerate(run.channels):
        measured = f"{channel}, measured"
        # As it stands in the page: of a long recording each array counts.
        data[measured] = np.where(run.valid, run.measured[:, k].astype(np.float32), np.float32(np.nan))
        lines, errors = [Line("measured", "measured", measured)], []
        for name, (role, values) in predicted.items():
            series = f"{channel}, {name}"
            data[series] = values[:, k]
            lines.append(Line(name, role, series))
            errors.append(
                Line(f"measured - {name}", "lacking" if len(predicted) == 1 else role, measured, series)
            )
        unit = UNIT_OF[channel]
        axes.append(Axes(channel, unit, lines))
        axes.append(Axes(f"{channel} error", unit, errors, 2 * noise.get(channel, 0.0), 130))
    inputs = run.inputs
    acting = {"voltage": ("V", inputs.voltage_V)}
    # What was imposed is no output, and what drives all the rest.
    if inputs.terminal is not None and inputs.current_A is not None:
        imposed = np.where(inputs.terminal == Terminal.CURRENT, inputs.current_A, np.nan)
        acting["imposed current"] = ("A", imposed)
    if inputs.shaft is not None and inputs.speed_rad_s is not None:
        acting["imposed speed"] = (
            "rad/s",
            np.where(inputs.shaft == Shaft.TURNED, inputs.speed_rad_s, np.nan),
        )
    if "load_torque" in run.known:
        acting["load torque"] = ("N*m", inputs.load_torque_Nm)
    for name, (unit, values) in acting.items():
        data[name] = values
        axes.append(Axes(name, unit, [Line(name, "measured", name)], height=110))
    states = {}
    for channel, state in STATE_OF.items():
        states[channel] = f"{channel}, measured"
        if channel not in run.channels:
            simulated = trajectory.temperature_C if channel == "temperature" else trajectory.states[state]
            states[channel] = f"{channel}, simulated"
            data[states[channel]] = simulated
    named = {equation: f"what the {equation} equation lacks" for equation in lacks or {}}
    for equation, lacking in (lacks or {}).items():
        data[named[equation]] = lacking
    caption = (
        f"{run.name}. Drag to zoom, double-click for all of it. The grey band is two standard "
        "deviations of the noise floor."
    )
    caption += f" {remark}" if remark else ""
    return time_plots(run.name, inputs.time_s, axes, data, states, named, caption)
