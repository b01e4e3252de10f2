"""Repeat the run of the paper and draw its figures 2, 3 and 4.

example:
  motorlens paper -o out/

Mellah, Hemsas and Taleb (2016), doi:10.14569/IJACSA.2016.070731, section III: the motor is started direct on line under
load and runs for 140 minutes. Prints each figure of the paper beside the simulated one.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from motorlens_runtime.cli import add_json_argument, write_json

if TYPE_CHECKING:
    from motorlens_physics.recording import Recording

RUN_S = 140 * 60.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--motor",
        default="mellah2016",
        metavar="MOTOR.toml",
        help="motor file (default: mellah2016, shipped)",
    )
    parser.add_argument(
        "-o", "--output", default=".", metavar="DIR", help="where the figures go (default: here)"
    )
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    import numpy as np

    from motorlens_physics.motor_file import read_motor_file
    from motorlens_physics.scenario import perform
    from motorlens_physics.scenarios.direct_on_line import DirectOnLine

    file = read_motor_file(arguments.motor)
    run_of_paper = perform(file, DirectOnLine(RUN_S), np.random.default_rng(0))
    found = figures_of_merit(run_of_paper)
    printed = {
        "inrush_A": 60.0, "steady_current_A": 7.27, "rise_K": 77.5, "resistance_growth_percent": 31.0, "speed_rad_s": 221.0,
    }  # fmt: skip
    print(f"{'':28}{'paper':>10}{'here':>10}")
    for name, value in printed.items():
        print(f"{name:28}{value:10.2f}{found[name]:10.2f}")
    directory = Path(arguments.output)
    directory.mkdir(parents=True, exist_ok=True)
    pictures = _draw(run_of_paper, directory)
    print("\n".join(str(picture) for picture in pictures))
    document = {"schema": "motorlens.paper/1", "motor": file.name, "paper": printed, "here": found}
    write_json(document | {"figures": [str(picture) for picture in pictures]}, arguments.json)
    return 0


def figures_of_merit(recording: "Recording") -> dict[str, float]:
    """The numbers that the paper gives in words, from a direct-on-line run; the last sample is the steady state."""
    channels = recording.channels
    return {
        "inrush_A": float(channels["current"].max()),
        "steady_current_A": float(channels["current"][-1]),
        "rise_K": float(channels["temperature"][-1] - channels["ambient"][-1]),
        "resistance_growth_percent": float(
            100 * (channels["resistance"][-1] / channels["resistance"][0] - 1)
        ),
        "speed_rad_s": float(channels["speed"][-1]),
    }


def _draw(recording: "Recording", directory: Path) -> list[Path]:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    time, channels = recording.time_s, recording.channels
    rise = channels["temperature"] - channels["ambient"]
    panels = [
        ("figure2_current", "armature current", "A", channels["current"], 1.0),
        ("figure3_speed", "rotor speed", "rad/s", channels["speed"], 1.0),
        ("figure4_temperature", "average temperature above ambient", "K", rise, None),
    ]
    pictures = []
    for name, title, unit, values, start_s in panels:
        figure, axes = pyplot.subplots(figsize=(7, 3.6), layout="constrained")
        axes.plot(time / 60, values, color="#1f5fa8", linewidth=1.2)
        axes.set(xlabel="time, min", ylabel=f"{title}, {unit}", xlim=(0, time[-1] / 60))
        axes.grid(alpha=0.25)
        if start_s is not None:
            # The start takes a second of 140 minutes: it gets a window of its own.
            inset = axes.inset_axes((0.42, 0.3 if name.endswith("speed") else 0.42, 0.52, 0.48))
            early = time <= start_s
            inset.plot(time[early], values[early], color="#1f5fa8", linewidth=1.2)
            inset.set(xlabel="time, s", ylabel=unit)
            inset.grid(alpha=0.25)
        path = directory / f"{name}.png"
        figure.savefig(path, dpi=150)
        pyplot.close(figure)
        pictures.append(path)
    return pictures
