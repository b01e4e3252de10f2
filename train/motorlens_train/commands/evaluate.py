"""Errors of a virtual sensor on recordings with known truth, beside other methods and the bound; or in worlds.

The other methods are fitted to --fit recordings, or else to simulated duty cycles of the motor file. Errors count from one
second after the first voltage step. With load torque, ambient and temperature recorded, the posterior Cramer-Rao bound
is computed for noise of --voltage-noise and --current-noise and an unknown start.

Without recordings, or with --worlds, the sensor is judged on its motor in worlds it was not made in: drives, noise, rates,
converters, loads, starts, motors of the make and what the motor file lacks are drawn from --seed, the plant shares no code
with the simulation, and the table shows every cell of every factor. That is for sensors with an observer inside: a network
alone takes the motor to have started cold, and says so.

examples:
  motorlens evaluate mellah2016 duty.csv --motor mellah2016 --png errors.png
  motorlens evaluate mellah2016_observer --motor mellah2016 --worlds 60
"""

import argparse

from motorlens_runtime.cli import add_json_argument, write_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("sensor", metavar="SENSOR.onnx", help="the virtual sensor")
    parser.add_argument("recordings", nargs="*", metavar="REC", help="recordings with true channels")
    parser.add_argument(
        "--motor", metavar="MOTOR.toml", help="motor file; without it the sensor stands alone"
    )
    parser.add_argument(
        "--fit", nargs="+", default=[], metavar="REC", help="recordings to which the other methods are fitted"
    )
    parser.add_argument(
        "--column", action="append", default=[], metavar="QUANTITY=NAME", help="which column holds a quantity"
    )
    parser.add_argument(
        "--voltage-noise",
        type=float,
        metavar="V",
        help="standard deviation the bound assumes (default: found)",
    )
    parser.add_argument(
        "--current-noise",
        type=float,
        metavar="A",
        help="standard deviation the bound assumes (default: found)",
    )
    parser.add_argument("--load-walk", type=float, default=0.02, metavar="NM",
                        help="of the load in the bound, N m per root second (default: 0.02)")  # fmt: skip
    parser.add_argument("--worlds", type=int, metavar="N",
                        help="judge it in so many drawn worlds as well (default without recordings: 60)")  # fmt: skip
    parser.add_argument("--seed", type=int, default=1, help="of the worlds (default: 1)")
    parser.add_argument("--png", metavar="FILE", help="write the drawings")
    parser.add_argument("--html", metavar="FILE", help="write table and drawings as one page")
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    import numpy as np

    from motorlens_physics.motor import Motor
    from motorlens_physics.motor_file import MotorFile, read_motor_file
    from motorlens_physics.recording import read_recording
    from motorlens_runtime.errors import DataError
    from motorlens_runtime.progress import Progress
    from motorlens_train.baselines import methods
    from motorlens_train.baselines.extended_kalman import noise_of
    from motorlens_train.baselines.method import Method
    from motorlens_train.bound import Noise
    from motorlens_train.evaluation.scores import evaluate, text_table
    from motorlens_train.evaluation.sensor_file import read_sensor
    from motorlens_train.evaluation.simulated import plate_of, simulated_duty
    from motorlens_train.evaluation.worlds.table import WORLDS, cells_in_worlds, text

    sensor = read_sensor(arguments.sensor)
    worlds = WORLDS if arguments.worlds is None and not arguments.recordings else arguments.worlds or 0
    if worlds < 0:
        raise DataError(f"--worlds {worlds}: at least 0")
    if worlds:
        if not arguments.motor:
            raise DataError("worlds are drawn for a motor: --motor MOTOR.toml")
        with Progress(worlds, "judging in worlds") as progress:
            found = cells_in_worlds(
                sensor, read_motor_file(arguments.motor), worlds, arguments.seed, progress.update
            )
        print(f"{sensor.name} in {worlds} worlds of seed {arguments.seed}\n{text(found)}")
    document = {"worlds": [cell.document() for cell in found]} if worlds else {}
    if not arguments.recordings:
        write_json({"schema": "motorlens.evaluate/1", "sensor": arguments.sensor, **document}, arguments.json)
        return 0
    recordings = [read_recording(path, arguments.column) for path in arguments.recordings]
    for recording in recordings:
        if not any(recording.has(quantity) for quantity in ("speed", "temperature", "resistance")):
            raise DataError(f"{recording.name}: no speed, temperature or resistance column to compare with")
    file = (
        read_motor_file(arguments.motor)
        if arguments.motor
        else MotorFile("unknown", Motor(), plate_of(recordings))
    )
    compared: dict[str, Method] = {sensor.name: sensor}
    noise = None
    if arguments.motor:
        training = [read_recording(path, arguments.column) for path in arguments.fit] or simulated_duty(
            file, np.random.default_rng(0)
        )
        known = methods()
        with Progress(len(known), "fitting") as progress:
            for done, (name, method) in enumerate(known.items()):
                compared[name] = method.fit(training, file)
                progress.update(done + 1, name)
        seen = noise_of(recordings, file.rated)
        noise = Noise(
            seen[0] if arguments.voltage_noise is None else arguments.voltage_noise,
            seen[1] if arguments.current_noise is None else arguments.current_noise,
            arguments.load_walk,
        )
    evaluation = evaluate(compared, recordings, file, noise)
    print(text_table(evaluation))
    for note in evaluation.notes:
        print(note)
    if arguments.png or arguments.html:
        from motorlens_train.evaluation.drawing import save_html, save_png

        if arguments.png:
            save_png(evaluation, sensor.name, arguments.png)
        if arguments.html:
            save_html(evaluation, sensor.name, arguments.html)
    write_json(
        {**evaluation.document(), **document, "sensor": arguments.sensor, "motor": file.name}, arguments.json
    )
    return 0
