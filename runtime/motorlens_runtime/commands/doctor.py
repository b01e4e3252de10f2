"""Measure what this PC can hold: wake-up jitter, line latency, cost of an estimate, serial ports.

Takes about six seconds. With a sensor, also the highest sample rate that leaves half a core free.

example: motorlens doctor --sensor mellah2016
"""

import argparse
from typing import Any

from motorlens_runtime.cli import add_json_argument, write_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--sensor", metavar="S.onnx", help="the virtual sensor whose cost to measure")
    parser.add_argument(
        "--seconds", type=float, default=2.0, metavar="S", help="for each measurement (default 2)"
    )
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    from dataclasses import asdict

    from motorlens_runtime import doctor
    from motorlens_runtime.errors import DataError
    from motorlens_runtime.progress import Progress
    from motorlens_runtime.sensor.core_library import core
    from motorlens_runtime.sensor.sensor import load_sensor

    if not 0.01 <= arguments.seconds <= 3600:
        raise DataError(f"--seconds {arguments.seconds:g}: from 0.01 to 3600")
    sensor = load_sensor(arguments.sensor) if arguments.sensor else None
    with Progress(3, "measuring") as progress:
        found: dict[str, Any] = {"schema": "motorlens.doctor/1", "machine": doctor.machine()}
        found["sleep_us"] = asdict(doctor.sleep_lateness(arguments.seconds))
        progress.update(1)
        found["line_us"] = asdict(doctor.line_latency(arguments.seconds))
        progress.update(2)
        cost = None if sensor is None else doctor.estimate_cost(sensor, arguments.seconds)
    found["sensor"] = None
    if sensor is not None and cost is not None:
        found["sensor"] = {
            "name": sensor.name, "backend": sensor.backend.name, **asdict(cost), "highest_rate_Hz": cost.highest_rate_Hz
        }  # fmt: skip
    loaded = core()
    found["core"] = {"available": loaded.library is not None, "path": loaded.path, "reason": loaded.reason}
    found["serial_ports"] = doctor.serial_ports()
    found["advice"] = doctor.advice(found)
    if arguments.json != "-":
        _say(found)
    write_json(found, arguments.json)
    return 0


def _say(found: dict[str, Any]) -> None:
    pc = found["machine"]
    load = "unknown" if pc["load"] is None else f"{pc['load']:.1f}"
    print(f"{pc['machine']}, {pc['cores']} cores, load {load}, {pc['system']}, Python {pc['python']}")
    for title, key in (("wakes late by", "sleep_us"), ("line to program", "line_us")):
        spread = found[key]
        print(
            f"{title:17} {spread['p50']:7.0f} us (median) {spread['p99']:8.0f} us (99 %) {spread['worst']:8.0f} us (worst)"
        )
    sensor = found["sensor"]
    if sensor is None:
        print("cost of an estimate: name a sensor with --sensor to measure it")
    else:
        hot, cold = sensor["hot_us"], sensor["cold_us"]
        print(
            f"{'bytes to estimate':17} {hot:7.0f} us in a row {cold:10.0f} us after a pause ({sensor['backend']})"
        )
        shares = ", ".join(f"{rate} Hz {100 * share:.0f} %" for rate, share in sensor["core_share"].items())
        print(f"{'share of a core':17} {shares}")
        rate = sensor["highest_rate_Hz"]
        print(f"{'holds':17} {'no rate measured' if rate is None else f'{rate} samples a second'}")
    loaded = found["core"]
    print(
        f"{'C core':17} {loaded['path'] if loaded['available'] else 'none, Python computes: ' + loaded['reason']}"
    )
    ports = found["serial_ports"]
    print("serial ports:" if ports else "serial ports: none")
    for port in ports:
        identity = " ".join(filter(None, (port["usb"], port["manufacturer"], port["product"])))
        number = f", serial number {port['serial_number']}" if port["serial_number"] else ""
        print(f"  {port['device']} {identity}{number}{'' if port['readable'] else ', no permission'}")
    for line in found["advice"]:
        print(f"advice: {line}")
