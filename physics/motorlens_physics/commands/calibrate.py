"""Fit a motor's parameters to recordings, or make a starting motor file from a datasheet.

example:
  motorlens calibrate --datasheet voltage_V=24 current_A=2 speed_rpm=3000 resistance_ohm=1.2 \\
      no_load_current_A=0.15 -o start.toml
  motorlens calibrate bench.csv soak.csv --motor start.toml --fit R_a0,ke,J,b -o motor.toml

Recordings need voltage and at least one of current, speed and temperature; fast and slow ones are fitted together. What
the motor file states as a deviation is a prior. What the recordings do not tell stays as it was, and is said so.
"""

import argparse

from motorlens_physics.command_inputs import add_input_arguments
from motorlens_runtime.cli import add_json_argument, write_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recordings", nargs="*", metavar="REC", help="recordings: CSV, Parquet, MAT, MDF")
    add_input_arguments(parser, motor_required=False)
    parser.add_argument("--datasheet", nargs="+", metavar="NAME=NUMBER",
                        help="make a motor file from the numbers in the example")  # fmt: skip
    parser.add_argument("-o", "--output", required=True, metavar="NEW.toml", help="where the motor file goes")
    parser.add_argument(
        "--fit", metavar="KEYS", help="parameters to fit, by commas (default: all that can show)"
    )
    parser.add_argument("--between-rows", choices=("hold", "linear"),
                        help="what voltage and load do between rows (default: what fits better)")  # fmt: skip
    parser.add_argument(
        "--fit-load", action="store_true", help="each recording has an unknown constant load torque"
    )
    parser.add_argument("--window", type=float, metavar="S",
                        help="simulate in windows of this length, tied together: for runs that drift")  # fmt: skip
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    import sys

    from motorlens_physics.calibration import calibrate, default_keys
    from motorlens_physics.command_inputs import inputs_from, print_notes
    from motorlens_physics.datasheet import from_datasheet, parse_datasheet
    from motorlens_physics.motor_file import write_motor_file
    from motorlens_runtime.errors import DataError

    if (arguments.motor is None) == (arguments.datasheet is None):
        raise DataError("give either --motor MOTOR.toml or --datasheet NAME=NUMBER ...")
    if arguments.datasheet:
        stem = arguments.output.rpartition("/")[2].removesuffix(".toml")
        given = inputs_from(arguments, from_datasheet(stem, **parse_datasheet(arguments.datasheet)))
    else:
        given = inputs_from(arguments)
        if not arguments.recordings:
            raise DataError("no recordings to fit to")
    file = given.file
    report: dict[str, object] = {
        "schema": "motorlens.calibrate/1",
        "motor": file.name,
        "output": arguments.output,
    }
    if arguments.recordings:
        recordings = given.recordings(arguments.recordings)
        keys = arguments.fit.split(",") if arguments.fit else default_keys(file, recordings)
        held = None if arguments.between_rows is None else arguments.between_rows == "hold"
        found = calibrate(
            file, recordings, keys, held=held, fit_load=arguments.fit_load, window_s=arguments.window,
            progress=lambda text: print(text, file=sys.stderr),
        )  # fmt: skip
        file = found.file
        print_notes(recordings)
        units = {key: file.meaning(key).unit for key in found.keys}
        for key in found.keys:
            if key not in found.unidentified:
                print(f"{key:32} {found.value[key]:12.6g} +- {found.sd[key]:.2g} {units[key]}")
        for sentence in (*found.unidentified.values(), *found.confounded):
            print(sentence)
        for recording, sizes in zip(recordings, found.noise_sd, strict=True):
            print(f"{recording.name}: left over " + ", ".join(f"{c} {sd:.3g}" for c, sd in sizes.items()))
        if not found.converged:
            print("not converged: start closer, fit fewer parameters, or try --window")
        report |= {
            "recordings": [recording.name for recording in recordings],
            "parameters": {
                key: {"value": found.value[key], "sd": found.sd[key], "unit": units[key],
                      "identified": key not in found.unidentified}
                for key in found.keys
            },
            "correlation": {"keys": list(found.keys), "matrix": found.correlation.tolist()},
            "unidentified": list(found.unidentified.values()),
            "confounded": list(found.confounded),
            "residual_sd": list(found.noise_sd),
            "initial": [dict(start) for start in found.initial],
            "load_torque_Nm": list(found.load_torque_Nm),
            "between_rows": "hold" if found.held else "linear",
            "converged": found.converged,
        }  # fmt: skip
    else:
        for key, value in file.values().items():
            print(f"{key:32} {value:12.6g} +- {file.knowledge[key].sd:.2g} {file.meaning(key).unit}")
        report["parameters"] = {
            key: {"value": value, "sd": file.knowledge[key].sd, "unit": file.meaning(key).unit}
            for key, value in file.values().items()
        }
    write_motor_file(file, arguments.output)
    write_json(report, arguments.json)
    return 0
