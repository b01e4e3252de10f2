"""Fit a motor's parameters to recordings, or make a starting motor file from a datasheet.

example:
  motorlens calibrate --datasheet voltage_V=24 current_A=2 speed_rpm=3000 resistance_ohm=1.2 \\
      no_load_current_A=0.15 -o start.toml
  motorlens calibrate bench.csv soak.csv --motor start.toml --fit R_a0,ke,J,b -o motor.toml

Recordings need voltage and at least one of current, speed and temperature; fast and slow ones are fitted together. What
the motor file states as a deviation is a prior; what it states with sd = 0 is never fitted. What the recordings do not
tell stays as it was, and is said so.
"""

import argparse
from typing import TYPE_CHECKING

from motorlens_physics.command_inputs import add_input_arguments
from motorlens_runtime.cli import add_json_argument, write_json

if TYPE_CHECKING:
    from motorlens_physics.estimate.calibrate import Calibration

# Of a torque that nobody measured less than this share of the rated one is not worth a line.
SHOWN = 0.01


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recordings", nargs="*", metavar="REC", help="recordings: CSV, Parquet, MAT, MDF")
    add_input_arguments(parser, motor_required=False)
    parser.add_argument("--datasheet", nargs="+", metavar="NAME=NUMBER",
                        help="make a motor file from the numbers in the example")  # fmt: skip
    parser.add_argument("-o", "--output", required=True, metavar="NEW.toml", help="where the motor file goes")
    parser.add_argument(
        "--fit", metavar="KEYS", help="parameters to fit, by commas (default: all that are not known exactly)"
    )
    parser.add_argument("--between-rows", choices=("hold", "linear"),
                        help="what voltage and load do between rows (default: what is likelier)")  # fmt: skip
    parser.add_argument(
        "--fit-load", action="store_true", help="each recording has an unknown constant load torque"
    )
    parser.add_argument("--accept-unconverged", action="store_true",
                        help="write the motor file also where the fit did not come to its end")  # fmt: skip
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    from motorlens_physics.command_inputs import inputs_from, print_notes
    from motorlens_physics.datasheet import from_datasheet, parse_datasheet
    from motorlens_physics.estimate.calibrate import calibrate
    from motorlens_physics.motor_file import write_motor_file
    from motorlens_runtime.errors import DataError, ModelError
    from motorlens_runtime.progress import Progress

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
        keys = arguments.fit.split(",") if arguments.fit else None
        held = None if arguments.between_rows is None else arguments.between_rows == "hold"
        with Progress(0, "calibrating: step") as progress:
            steps = iter(range(1, 1_000_000))
            found = calibrate(
                file, recordings, keys, held=held, fit_load=arguments.fit_load,
                progress=lambda text: progress.update(next(steps), text),
            )  # fmt: skip
        if not found.converged and not arguments.accept_unconverged:
            raise ModelError(
                "not converged, nothing written: start closer, fit fewer parameters (--fit), or take it as it is with "
                "--accept-unconverged"
            )
        for line in _lines(found):
            print(line)
        report |= found.as_json(recordings)
        file = found.file
        print_notes(recordings)
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


def _lines(found: "Calibration") -> list[str]:
    from motorlens_physics.estimate.notes import notes_of
    from motorlens_physics.estimate.run import UNIT_OF

    file, said = found.file, found.findings
    lines = [
        f"{key:32} {found.value[key]:12.6g} +- {found.sd[key]:.2g} {file.meaning(key).unit}"
        for key in said.told
    ]
    lines += said.sentences
    lines += notes_of(found.runs)
    lines += [delay.sentence for delay in found.delays]
    lines += found.not_told
    each = zip(found.runs, found.residual_rms, found.noise_sd, found.unmeasured_torques, strict=True)
    for run, left, noise, torque in each:
        sizes = ", ".join(f"{c} {left[c]:.3g} {UNIT_OF[c]} (noise {noise[c]:.3g})" for c in run.channels)
        lines.append(f"{run.name}: left over, rms: {sizes}")
        share = torque.sd_Nm / file.rated.torque_Nm
        if share >= SHOWN:
            lines.append(
                f"{run.name}: beside a torque that nobody measured, {torque.sd_Nm:.3g} N*m ({share:.0%} of the rated one) "
                f"for {torque.lasts_s:.3g} s at a time: a load, or what is missing from the model"
            )
    if found.outliers:
        lines.append(f"{found.outliers} samples were left out: no noise explains them")
    if not found.converged:
        lines.append("not converged: values and deviations are those of the last step")
    return lines
