"""Make a virtual sensor from a motor's physics, from recordings, or from both.

examples:
  motorlens train --motor mellah2016 --seed 1 -o sensor.onnx
  motorlens train --recordings run1.csv run2.csv --column speed=wL_rad_s -o mine.onnx

From a motor file it is the physics observer of that motor, alone: nothing is trained, and --cycles says on how many
simulated duty cycles it is judged. With --tolerance 10 it is for every motor of the make, not for the one of the file: the
observer finds R, ke and J of the motor it is put on, and a network mends what it gets wrong. With --hidden 12-8 it is a
network on filters, without an observer: lighter on a microcontroller, and only for a motor that starts at ambient
temperature, as its quality says. It cannot tell whose motor it is on: its intervals hold every motor that the file may mean
by the deviations it states, 10 % at most; motorlens calibrate makes them smaller. With --make in the place of --tolerance,
motors differ as motorlens fleet has found.

From recordings it is the observer of the motor that they show, fitted as motorlens calibrate fits it, where that comes
nearer to recordings left out in turn than a network does; OUT.toml is that motor. Else, or with --hidden, it is a network.
The targets that were measured (speed, temperature, resistance) decide what it promises.

Beside OUT.onnx stand OUT.step.onnx (one stateful step, for other hosts) and OUT.md, the card: errors on duty cycles not
trained on and, of an observer, in --worlds worlds that it was not made in (see `motorlens evaluate --help`).
"""

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import Any

from motorlens_runtime.cli import add_json_argument, write_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--motor", metavar="MOTOR.toml", help="train on simulated duty cycles of this motor")
    parser.add_argument("--recordings", nargs="+", default=[], metavar="REC", help="train on measured runs")
    parser.add_argument(
        "--observer",
        metavar="MOTOR.toml",
        help="run a physics observer of this motor inside the sensor (default: with --motor that one, unless --hidden)",
    )
    parser.add_argument("-o", "--output", required=True, metavar="SENSOR.onnx", help="where the sensor goes")
    parser.add_argument("--column", action="append", default=[], metavar="QUANTITY=NAME",
                        help="which column holds a quantity, e.g. speed=wL_rad_s; repeatable")  # fmt: skip
    parser.add_argument(
        "--hidden",
        metavar="N-M",
        help="widths of the hidden layers of a network, e.g. 12-8 (default: by data)",
    )
    parser.add_argument(
        "--cycles", type=int, default=120, metavar="N", help="simulated duty cycles (default: 120)"
    )
    parser.add_argument("--rate", type=float, default=1000.0, metavar="HZ", help="of the simulated sensor")
    parser.add_argument("--noise", action="append", default=[], metavar="SD",
                        help="CHANNEL=SD, in its unit or %% of rated (default: voltage 0.2%%, current 0.7%%)")  # fmt: skip
    parser.add_argument(
        "--tolerance", type=float, default=0.0, metavar="PERCENT",
        help="every simulated cycle is of another motor, its R, ke, J and thermal parameters up to so much off",
    )  # fmt: skip
    parser.add_argument("--worlds", type=int, default=60, metavar="N",
                        help="an observer is judged in so many drawn worlds (default: 60)")  # fmt: skip
    parser.add_argument(
        "--make", metavar="POPULATION.toml",
        help="what motorlens fleet says of motors of this make: the motor file knows less, and motors differ as it says",
    )  # fmt: skip
    parser.add_argument("--iterations", type=int, default=120, metavar="N", help="at most (default: 120)")
    parser.add_argument("--seed", type=int, default=1, help="of everything random (default: 1)")
    parser.add_argument("--checkpoint", metavar="FILE", help="write training's state here, and go on from it")
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    from motorlens_physics.make import of_make
    from motorlens_physics.motor_file import read_motor_file, write_motor_file
    from motorlens_physics.recording import read_recording
    from motorlens_runtime.errors import DataError
    from motorlens_runtime.progress import Progress
    from motorlens_train.alone import card_of, observer_alone
    from motorlens_train.build import build, golden, measured
    from motorlens_train.card import write_card
    from motorlens_train.commands.parse import hidden_layers
    from motorlens_train.evaluation.worlds.table import cells_in_worlds
    from motorlens_train.export import write_sensor
    from motorlens_train.material import from_motor, from_recordings, paper_of
    from motorlens_train.own_motor import FITTED, alone_on, nearer_observer

    if bool(arguments.motor) == bool(arguments.recordings):
        raise DataError("say what to train on: --motor MOTOR.toml or --recordings REC...")
    output = Path(arguments.output)
    if arguments.tolerance and not arguments.motor:
        raise DataError("--tolerance is for simulated motors: it needs --motor MOTOR.toml")
    if output.suffix != ".onnx":
        raise DataError(f"-o {output}: a sensor file ends in .onnx")
    if arguments.make and not (arguments.motor or arguments.observer):
        raise DataError("--make says more of a motor file: it needs --motor or --observer MOTOR.toml")
    if arguments.make and arguments.tolerance:
        raise DataError("--make says how much motors differ: leave out --tolerance")
    make = read_motor_file(arguments.make) if arguments.make else None
    observer = arguments.observer or (arguments.motor if not arguments.hidden else None)
    observed = read_motor_file(observer) if observer else None
    hidden = hidden_layers(arguments.hidden) if arguments.hidden else None
    stands_alone = observed is not None and not arguments.tolerance and make is None
    count = 2 * (arguments.cycles // 5) if stands_alone else 1.2 * arguments.cycles
    with Progress(count, "simulating") as progress:
        if arguments.motor:
            material = from_motor(
                Path(arguments.motor), output.stem, arguments.cycles, arguments.rate, arguments.noise, arguments.seed,
                hidden, arguments.iterations, progress.update, observed, arguments.tolerance / 100, make,
            )  # fmt: skip
        else:
            material = from_recordings(
                arguments.recordings,
                arguments.column,
                output.stem,
                arguments.seed,
                hidden,
                arguments.iterations,
                observed if observed is None or make is None else of_make(observed, make),
            )
    own = None
    if arguments.recordings and observed is None and hidden is None:
        recordings = [read_recording(path, arguments.column) for path in arguments.recordings]
        with Progress(0, "fitting the motor"):
            own = nearer_observer(output.stem, recordings, material)
        if own is not None:
            material, observed = alone_on(own, recordings, material), own
    report: dict[str, Any] = {}
    if material.training:
        with Progress(arguments.iterations, "training") as progress:
            built = build(
                material.recipe, material.training, material.calibration, material.unseen,
                lambda record: progress.update(record.iteration + 1, f"error {max(record.error):.3g}"),
                Path(arguments.checkpoint) if arguments.checkpoint else None,
            )  # fmt: skip
        sensor, card, report = built.sensor, built.card, built.trained.report()
    else:
        assert observed is not None
        sensor = observer_alone(material.recipe, observed)
        card = card_of(sensor, material.unseen, material.cases, arguments.seed)
    cases = {title: measured(sensor, cycles) for title, cycles in material.cases.items()}
    card |= {"trained_on": material.origin, "cases": cases}
    judged = read_motor_file(arguments.motor) if arguments.motor and observed is not None else own
    if judged is not None and judged.motor.L > 0 and arguments.worlds > 0:
        file = judged if make is None else of_make(judged, make)
        with Progress(arguments.worlds, "judging in worlds") as progress:
            cells = cells_in_worlds(sensor, file, arguments.worlds, arguments.seed, progress.update)
        card["worlds"] = {"seed": arguments.seed, "cells": [cell.document() for cell in cells]}
    if arguments.motor and material.training:
        card["paper"] = asdict(paper_of(Path(arguments.motor), material.recipe, arguments.noise))
    write_sensor(sensor, card, golden(sensor), output)
    write_card(sensor, card, output.with_suffix(".md"))
    if own is not None:
        write_motor_file(own, output.with_suffix(".toml"))
    print(
        f"{output}: {card['network']}, {card['parameters']} parameters, {output.stat().st_size / 1000:.1f} kB"
    )
    where, table = "unseen duty cycles", card["unseen"]
    if not table:
        where, table = (FITTED, cases[FITTED]) if own else ("the training recordings", card["training"])
    for name, figures in table.items():
        unit = next(o.unit for o in sensor.specification.outputs if o.name == name)
        covered = f"95 % interval covers {100 * figures['coverage_95']:.1f} %"
        print(f"  {name}: rmse {figures['rmse']:.4g} {unit} on {where}, {covered}")
    if "worlds" in card:
        every = card["worlds"]["cells"][0]
        print(
            f"  in {every['worlds']} worlds it was not made in: confidently wrong in {every['wrong']}, good "
            f"{100 * every['good']:.1f} % of the time"
        )
    write_json({"schema": "motorlens.train/1", "sensor": str(output), "card": card, "report": report},
               arguments.json)  # fmt: skip
    return 0
