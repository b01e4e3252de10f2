"""The simulated drive: prints the port it serves, then sends what a real drive would.

example:
  motorlens drive --motor mellah2016 --scenario duty --rate 1000 --duration 60
  motorlens run --source serial:///dev/pts/3 --sensor mellah2016     (in another terminal)

A motor runs through a scenario; a 12-bit converter digitises its voltage and current; frames
(docs/wire-protocol.md) go over a pseudo-terminal as over a serial line. It starts when somebody opens the port.
--truth writes what no sensor sees.
"""

import argparse
import signal
import sys
import time
from pathlib import Path
from types import FrameType

from motorlens_runtime.cli import add_json_argument, write_json
from motorlens_runtime.errors import DataError

LINGER_S = 1.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--motor",
        default="mellah2016",
        metavar="MOTOR.toml",
        help="motor file (default: mellah2016, shipped)",
    )
    parser.add_argument(
        "--scenario", default="duty", metavar="NAME", help="what the motor does (default: duty)"
    )
    parser.add_argument(
        "--duration", type=float, default=60.0, metavar="S", help="seconds of device time (default: 60)"
    )
    parser.add_argument(
        "--rate", type=int, default=1000, metavar="HZ", help="samples per second (default: 1000)"
    )
    parser.add_argument(
        "--speedup", type=float, default=1.0, metavar="X", help="device seconds per second (default: 1)"
    )
    parser.add_argument(
        "--rows-per-frame", type=int, default=10, metavar="N", help="samples in a frame (default: 10)"
    )
    parser.add_argument("--bits", type=int, default=12, help="resolution of the converter (default: 12)")
    parser.add_argument(
        "--noise", action="append", metavar="SD", help="as in `motorlens simulate` (default: 0.1%%)"
    )
    parser.add_argument("--link", metavar="PATH", help="also make a symbolic link to the port")
    parser.add_argument(
        "--truth", metavar="REC.csv", help="write the true quantities, row by row with the samples"
    )
    parser.add_argument("--seed", type=int, default=0, help="of everything random (default: 0)")
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    from motorlens_firmware_sim.bench import Setup, prepare
    from motorlens_firmware_sim.port import PtyPort
    from motorlens_firmware_sim.telemetry import sendings
    from motorlens_physics.recording import write_recording

    if arguments.speedup <= 0:
        raise DataError("--speedup is above 0")
    bench = prepare(
        Setup(
            arguments.motor, arguments.scenario, arguments.duration, arguments.rate, arguments.rows_per_frame,
            arguments.bits, arguments.noise or Setup.noise, arguments.seed,
        )
    )  # fmt: skip
    if arguments.truth:
        write_recording(bench.truth, Path(arguments.truth))
    stop = _Stop()
    sent = dropped = 0
    with PtyPort(arguments.link) as port:
        print(port.name, flush=True)
        port.wait_for_reader(lambda: stop.asked)
        port.write(b"\0", patience_s=1.0)
        began = time.monotonic()
        for sending in sendings(bench.drive, bench.codes):
            stop.sleep(began + sending.at_s / arguments.speedup - time.monotonic())
            if stop.asked:
                break
            # A drive does not wait for its listener for long; what the line does not take is lost, and counted.
            taken = port.write(sending.data, patience_s=2.0)
            sent, dropped = sent + sending.samples, dropped + sending.samples * (taken < len(sending.data))
            if not port.has_reader():
                break
        # Closing the port throws away what the listener has not read yet.
        stop.sleep(LINGER_S if port.has_reader() else 0.0)
    print(f"motorlens drive: {sent - dropped} samples sent, {dropped} lost on the line", file=sys.stderr)
    write_json(
        {"schema": "motorlens.drive/1", "sent": sent - dropped, "lost": dropped, "rate_Hz": arguments.rate},
        arguments.json,
    )
    return 0


class _Stop:
    """Remembers that SIGINT or SIGTERM asked for an end, so that the port is closed in order."""

    def __init__(self) -> None:
        self.asked = False
        for name in (signal.SIGINT, signal.SIGTERM):
            signal.signal(name, self._ask)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        if self.asked:
            sys.exit(130)
        self.asked = True

    def sleep(self, seconds: float) -> None:
        """Sleep, unless an end has been asked for."""
        if seconds > 0 and not self.asked:
            time.sleep(min(seconds, 3600.0))
