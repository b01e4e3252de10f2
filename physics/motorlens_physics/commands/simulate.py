"""Simulate a motor through a standard test and write the recording.

example:
  motorlens simulate mellah2016 --scenario load_steps \\
      --effect coulomb_friction.tau_c=0.3 --noise 0.5% --seed 1 -o recording.csv

Scenarios: direct_on_line (the paper's run), duty (random voltage, load, ambient, start temperature), locked_rotor,
coast_down, no_load_steps, load_steps, overhauling_load, slow_ramp, heat_soak.
The recording holds time_s, voltage_V, current_A, speed_rad_s, temperature_C (of the winding), resistance_ohm,
load_torque_Nm and ambient_C, and terminal and shaft where they are tied to something else than a voltage and nothing
(terminal: 1 open, 2 shorted, 3 current-controlled; shaft: 1 locked, 2 turned by another machine).
"""

import argparse
from dataclasses import replace

from motorlens_physics.command_inputs import add_condition_arguments
from motorlens_runtime.cli import add_json_argument, write_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("motor", metavar="MOTOR.toml", help="motor file")
    parser.add_argument("--scenario", default="duty", metavar="NAME", help="which test (default: duty)")
    parser.add_argument("-o", "--output", required=True, metavar="REC.csv", help="where the recording goes")
    parser.add_argument(
        "--duration", type=float, default=0.0, metavar="S", help="length in seconds (default: the scenario's)"
    )
    parser.add_argument(
        "--rate", type=float, default=0.0, metavar="HZ", help="samples per second (default: the scenario's)"
    )
    parser.add_argument("--effect", action="append", default=[], metavar="NAME.PARAMETER=VALUE",
                        help="add an effect or change one of its parameters; repeatable")  # fmt: skip
    parser.add_argument("--set", action="append", default=[], metavar="PARAMETER=VALUE", dest="settings",
                        help="change a parameter of the motor, such as R_a0=3.6; repeatable")  # fmt: skip
    parser.add_argument("--noise", action="append", default=[], metavar="SD",
                        help="CHANNEL=SD in its unit, or 0.5%% of the rating plate for all; repeatable")  # fmt: skip
    add_condition_arguments(parser)
    parser.add_argument("--effects-from", metavar="FILE.py", help="a file of your own with further effects")
    parser.add_argument("--seed", type=int, default=0, help="of everything random (default: 0)")
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    import numpy as np

    from motorlens_physics.conditions import Shaft, Terminal, code
    from motorlens_physics.effect import load_effects
    from motorlens_physics.motor_file import parse_override, read_motor_file, with_overrides
    from motorlens_physics.recording import write_recording
    from motorlens_physics.scenario import chosen_scenario, measure, parse_noise, perform
    from motorlens_runtime.progress import patience

    scenario = chosen_scenario(arguments.scenario, arguments.duration, arguments.rate)
    own = load_effects(arguments.effects_from) if arguments.effects_from else {}
    file = read_motor_file(arguments.motor, own.values())
    overrides = dict(parse_override(text) for text in (*arguments.settings, *arguments.effect))
    file = with_overrides(file, overrides, own)
    rng = np.random.default_rng(arguments.seed)
    terminal = (
        None if arguments.terminal is None else Terminal(code(Terminal, arguments.terminal, "--terminal"))
    )
    shaft = None if arguments.shaft is None else Shaft(code(Shaft, arguments.shaft, "--shaft"))
    with patience("simulate"):
        truth = perform(file, scenario, rng, terminal=terminal, shaft=shaft)
    noise = parse_noise(arguments.noise, file.rated)
    recording = measure(truth, file.sensors, noise, rng)
    write_recording(replace(recording, name=arguments.output), arguments.output)
    print(
        f"{arguments.output}: {len(recording)} rows, {recording.duration_s:g} s of {scenario.name()}; "
        f"speed {np.min(truth.channels['speed']):.4g} to {np.max(truth.channels['speed']):.4g} rad/s, "
        f"current {np.min(truth.channels['current']):.4g} to {np.max(truth.channels['current']):.4g} A, "
        f"winding {truth.channels['temperature'][0]:.1f} to {truth.channels['temperature'][-1]:.1f} degC"
    )
    write_json(
        {
            "schema": "motorlens.simulate/1", "recording": arguments.output, "motor": file.name,
            "scenario": scenario.name(), "seed": arguments.seed, "rows": len(recording), "noise": noise,
            "final": {q: float(y[-1]) for q, y in truth.channels.items()},
            "maximum": {q: float(np.max(y)) for q, y in truth.channels.items()},
        },
        arguments.json,
    )  # fmt: skip
    return 0
