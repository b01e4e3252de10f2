"""List the physical effects and sensor faults of the catalogue, or show one of them in full.

example:
  motorlens effects
  motorlens effects stribeck_friction --motor mellah2016 -o stribeck.png

The list gives what each effect adds to its balance, the typical size of the parameter that switches it on, for the rating
plate of --motor (default: the 3 kW motor of the paper), and the scenarios of `motorlens simulate` that make it visible.
"""

import argparse
from typing import TYPE_CHECKING, Any

from motorlens_runtime.cli import add_json_argument, write_json

if TYPE_CHECKING:
    from motorlens_physics.describe import Curve
    from motorlens_physics.effect import Effect
    from motorlens_physics.parameter import Parameter, Rated
    from motorlens_physics.sensor_model import SensorModel


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name", nargs="?", metavar="NAME", help="show this one in full")
    parser.add_argument("--motor", metavar="MOTOR.toml", help="whose rating plate sets typical sizes")
    parser.add_argument("--effects-from", metavar="FILE.py", help="a file of your own with further effects")
    parser.add_argument(
        "-o", "--output", metavar="IMAGE", help="with NAME: draw the term into a .png, .svg or .pdf"
    )
    parser.add_argument("--markdown", metavar="FILE.md", help="write the whole catalogue as a document")
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    from pathlib import Path

    from motorlens_physics import describe
    from motorlens_physics.effect import catalogue, load_effects
    from motorlens_physics.motor_file import read_motor_file
    from motorlens_physics.sensor_model import sensor_models
    from motorlens_runtime.errors import DataError

    own = load_effects(arguments.effects_from) if arguments.effects_from else {}
    effects = catalogue() | own
    sensors = sensor_models()
    rated = read_motor_file(arguments.motor, own.values()).rated if arguments.motor else describe.PLATE
    if arguments.output and not arguments.name:
        raise DataError("-o draws one effect: give its NAME")
    if arguments.name and arguments.name not in {**effects, **sensors}:
        raise DataError(
            f"{arguments.name}: not in the catalogue; {_near(arguments.name, [*effects, *sensors])}"
        )
    if arguments.markdown:
        Path(arguments.markdown).write_text(markdown(effects, sensors), encoding="utf-8")
    chosen_effects = {n: e for n, e in effects.items() if arguments.name in (None, n)}
    chosen_sensors = {n: s for n, s in sensors.items() if arguments.name in (None, n)}
    if arguments.json != "-":
        if not arguments.name:
            _print_list(chosen_effects, chosen_sensors, rated)
        for effect in chosen_effects.values() if arguments.name else ():
            _print_effect(effect, rated, draw=not arguments.output)
        for sensor in chosen_sensors.values() if arguments.name else ():
            _print_sensor(sensor, rated)
    if arguments.output:
        if arguments.name in sensors:
            raise DataError(f"{arguments.name} is a sensor model; only effects are drawn")
        _draw(effects[arguments.name].typical(rated), rated, arguments.output)
    write_json(
        {
            "schema": "motorlens.effects/1",
            "effects": [_effect_json(effect, rated) for effect in chosen_effects.values()],
            "sensors": [_sensor_json(sensor, rated) for sensor in chosen_sensors.values()],
        },
        arguments.json,
    )
    return 0


def markdown(effects: "dict[str, type[Effect]]", sensors: "dict[str, SensorModel]") -> str:
    """The whole catalogue as a document; typical sizes are those for the paper's motor."""
    from motorlens_physics import describe

    lines = [
        "# The catalogue of effects",
        "",
        "Written by `motorlens effects --markdown docs/effects.md`; do not edit. Equations are printed from the code.",
        "Typical sizes are for the 3 kW, 240 V motor of the paper; `motorlens effects --motor MOTOR.toml` gives others.",
        "The parameter in bold switches the effect on; at its null the effect is exactly absent.",
    ]
    for equation in describe.EQUATIONS:
        lines += ["", f"## {equation.capitalize()}"]
        for name, effect in effects.items():
            if describe.equation_of(effect) == equation:
                lines += ["", f"### {name}", "", describe.description(effect), "", "```"]
                lines += [*describe.equations(effect), "```", ""]
                lines += _parameter_table(effect.parameters(), describe.PLATE)
                lines += [
                    f"State `{s}` ({state.unit}): {state.description}." for s, state in effect.states.items()
                ]
                lines += ["", f"Seen in: {', '.join(effect.excited_by)}."]
    lines += [
        "",
        "## Sensors",
        "",
        "Each on every channel: `voltage_sensor_gain`, `speed_sensor_lag`, and so on.",
    ]
    for kind, model in {
        model.kind: model for model in sensors.values() if model.channel == "current"
    }.items():
        lines += ["", f"### CHANNEL_sensor_{kind}", "", describe.description(type(model)), ""]
        lines += _parameter_table(model.parameters(), describe.PLATE)
        lines += [f"Seen in: {', '.join(model.excited_by)}." if model.excited_by else "For simulation only."]
    return "\n".join(lines) + "\n"


def _parameter_table(declared: "dict[str, Parameter]", rated: "Rated") -> list[str]:
    from motorlens_physics import describe

    lines = ["| parameter | unit | meaning | typical | bounds |", "| --- | --- | --- | --- | --- |"]
    for p in declared.values():
        name = p.name if p.null is None else f"**{p.name}**"
        meaning = p.description.replace("|", "\\|") + (" (stated, never fitted)" if p.fixed else "")
        lines.append(
            f"| {name} | {p.unit} | {meaning} | {describe.size(p, rated)} | {p.bounds[0]:g} to {p.bounds[1]:g} |"
        )
    return [*lines, ""]


def _print_list(
    effects: "dict[str, type[Effect]]", sensors: "dict[str, SensorModel]", rated: "Rated"
) -> None:
    from motorlens_physics import describe

    plate = (
        f"{rated.voltage_V:g} V, {rated.current_A:g} A, {rated.speed_rad_s:g} rad/s, {rated.torque_Nm:g} N m"
    )
    print(f"typical sizes are for a motor of {plate}")
    for equation in describe.EQUATIONS:
        print(equation)
        for name, effect in effects.items():
            if describe.equation_of(effect) == equation:
                switch = effect.switch()
                sized = f"{switch.name} ~ {describe.size(switch, rated)}"
                print(f"  {name:32}{sized:32}{', '.join(effect.excited_by)}")
                for line in describe.equations(effect):
                    print(f"      {line}")
    print("sensors (on voltage, current, speed, temperature, load_torque)")
    for model in (model for model in sensors.values() if model.channel == "current"):
        switch_of = model.switch()
        sized = ", ".join(f"{p.name} ~ {describe.size(p, rated)}" for p in model.parameters().values())
        note = ", ".join(model.excited_by) if switch_of else "for simulation only"
        print(f"  {model.name():32}{sized:40}{note}")
        if switch_of:
            print(f"      {describe.sensor_equation(model)}")


def _print_effect(effect: "type[Effect]", rated: "Rated", draw: bool) -> None:
    from motorlens_physics import describe

    print(f"{effect.name()} ({describe.equation_of(effect)})\n")
    print(describe.description(effect), "\n")
    for line in describe.equations(effect):
        print(f"    {line}")
    print()
    _print_parameters(effect.parameters(), rated)
    for name, state in effect.states.items():
        print(f"  state {name:10} {state.unit:18} {state.description}")
    print(f"\n  seen in: {', '.join(effect.excited_by)}")
    for curve in describe.curves(effect.typical(rated), rated) if draw else ():
        print(f"\n{text_plot(curve)}")


def _print_sensor(sensor: "SensorModel", rated: "Rated") -> None:
    from motorlens_physics import describe

    print(f"{sensor.name()} (sensor)\n")
    print(describe.description(type(sensor)), "\n")
    if describe.sensor_equation(sensor):
        print(f"    {describe.sensor_equation(sensor)}\n")
    _print_parameters(sensor.parameters(), rated)
    print(f"\n  seen in: {', '.join(sensor.excited_by)}" if sensor.excited_by else "\n  for simulation only")


def _print_parameters(declared: "dict[str, Parameter]", rated: "Rated") -> None:
    from motorlens_physics import describe

    for p in declared.values():
        null = "" if p.null is None else f", null {p.null:g}"
        fixed = ", stated, never fitted" if p.fixed else ""
        bounds = f"{p.bounds[0]:g} to {p.bounds[1]:g}"
        print(
            f"  {p.name:10} {p.unit:14} {p.description}; typically {describe.size(p, rated)}, {bounds}{null}{fixed}"
        )


def text_plot(curve: "Curve", width: int = 64, height: int = 13) -> str:
    """A curve in characters, `width` by `height`, axes with their ranges."""
    import numpy as np

    low, high = float(np.min(curve.y)), float(np.max(curve.y))
    span = high - low or max(abs(high), 1.0)
    columns = np.linspace(curve.x[0], curve.x[-1], width)
    rows = np.rint((height - 1) * (high - np.interp(columns, curve.x, curve.y)) / span).astype(int)
    canvas = [[" "] * width for _ in range(height)]
    if low < 0 < high:
        canvas[round((height - 1) * high / span)] = ["-"] * width
    for column, row in enumerate(rows):
        canvas[min(max(row, 0), height - 1)][column] = "*"
    lines = [f"  {curve.term} ({curve.y_unit}){' at ' if curve.at else ''}{curve.at}"]
    for k, cells in enumerate(canvas):
        label = f"{high + 0.0:.3g}" if k == 0 else f"{low + 0.0:.3g}" if k == height - 1 else ""
        lines.append(f"{label:>10} |{''.join(cells).rstrip()}")
    left, middle, right = f"{curve.x[0]:.3g}", f"{curve.x_name} ({curve.x_unit})", f"{curve.x[-1]:.3g}"
    return "\n".join([*lines, f"{'':11}{left}{middle:^{width - len(left) - len(right)}}{right}"])


def _draw(effect: "Effect", rated: "Rated", path: str) -> None:
    from matplotlib.figure import Figure

    from motorlens_physics import describe
    from motorlens_runtime.errors import DataError

    if path.rpartition(".")[2] not in ("png", "svg", "pdf"):
        raise DataError(f"{path}: drawn as .png, .svg or .pdf")
    drawn = describe.curves(effect, rated)
    figure = Figure(figsize=(5.0 * len(drawn), 3.6), layout="constrained")
    figure.suptitle(effect.name())
    for axes, curve in zip(figure.subplots(1, len(drawn), squeeze=False)[0], drawn, strict=True):
        axes.plot(curve.x, curve.y)
        axes.set(xlabel=f"{curve.x_name} ({curve.x_unit})", ylabel=f"{curve.term} ({curve.y_unit})")
        axes.set_title(curve.at, fontsize="small")
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=150)


def _effect_json(effect: "type[Effect]", rated: "Rated") -> dict[str, Any]:
    import sympy

    from motorlens_physics import describe

    return {
        "name": effect.name(),
        "equation": describe.equation_of(effect),
        "summary": describe.summary(effect),
        "description": describe.description(effect),
        "equations": describe.equations(effect),
        "latex": {left: sympy.latex(term) for left, term in describe.expressions(effect).items()},
        "references": describe.references(effect),
        "parameters": [_parameter_json(p, rated) for p in effect.parameters().values()],
        "states": {n: {"unit": s.unit, "description": s.description} for n, s in effect.states.items()},
        "excited_by": list(effect.excited_by),
    }


def _sensor_json(sensor: "SensorModel", rated: "Rated") -> dict[str, Any]:
    from motorlens_physics import describe

    return {
        "name": sensor.name(),
        "channel": sensor.channel,
        "summary": describe.summary(type(sensor)),
        "equations": [line for line in [describe.sensor_equation(sensor)] if line],
        "references": describe.references(type(sensor)),
        "parameters": [_parameter_json(p, rated) for p in sensor.parameters().values()],
        "excited_by": list(sensor.excited_by),
        "simulation_only": sensor.switch() is None,
    }


def _parameter_json(p: "Parameter", rated: "Rated") -> dict[str, Any]:
    return {
        "name": p.name, "unit": p.unit, "description": p.description, "bounds": list(p.bounds), "null": p.null,
        "typical": p.typical(rated), "fixed": p.fixed,
    }  # fmt: skip


def _near(word: str, known: list[str]) -> str:
    import difflib

    near = difflib.get_close_matches(word, known, n=1)
    return f"did you mean {near[0]!r}?" if near else "`motorlens effects` lists what is"
