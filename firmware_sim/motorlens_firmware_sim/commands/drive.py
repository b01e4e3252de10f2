"""The simulated drive: prints the port it serves, then sends what a real drive would.

example:
  motorlens drive --motor mellah2016 --scenario duty --rate 1000 --duration 60
  motorlens run --source serial:///dev/pts/3 --sensor mellah2016     (in another terminal)
  motorlens drive --board cortex-m4f --sensor mellah2016             (the sensor on board of an emulated microcontroller)

A motor runs through a scenario; a 12-bit converter digitises its voltage and current; frames
(docs/wire-protocol.md) go over a pseudo-terminal as over a serial line. It starts when somebody opens the port.
--truth writes what no sensor sees. With --board the drive's firmware runs on that core under QEMU with the sensor
compiled into it: what comes over the port are its frames, with estimates among the measurements.
"""

import argparse
import signal
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from motorlens_runtime.cli import add_json_argument, write_json
from motorlens_runtime.errors import DataError

if TYPE_CHECKING:
    from motorlens_firmware_sim.bench import Bench
    from motorlens_firmware_sim.boards import Board
    from motorlens_firmware_sim.port import PtyPort

LINGER_S = 1.0
_PATIENCE_S = 2.0


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
    parser.add_argument(
        "--board",
        metavar="CORE",
        help="run on an emulated core: cortex-m0, cortex-m3, cortex-m4f or cortex-m7f",
    )
    parser.add_argument(
        "--sensor",
        default="mellah2016",
        metavar="S.onnx",
        help="with --board: the sensor (default: mellah2016)",
    )
    parser.add_argument("--seed", type=int, default=0, help="of everything random (default: 0)")
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    from motorlens_firmware_sim.bench import Setup, prepare
    from motorlens_firmware_sim.port import PtyPort
    from motorlens_physics.recording import write_recording

    if arguments.speedup <= 0:
        raise DataError("--speedup is above 0")
    emulated = _emulated(arguments.board) if arguments.board else None
    bench = prepare(
        Setup(
            arguments.motor, arguments.scenario, arguments.duration, arguments.rate, arguments.rows_per_frame,
            arguments.bits, arguments.noise or Setup.noise, arguments.seed,
        )
    )  # fmt: skip
    if arguments.truth:
        write_recording(bench.truth, Path(arguments.truth))
    with ExitStack() as opened:
        send = _send
        if emulated:
            scratch = opened.enter_context(tempfile.TemporaryDirectory(prefix="motorlens-drive-"))
            send = _OnBoard(emulated, arguments.sensor, Path(scratch)).send
        stop = _Stop()
        port = opened.enter_context(PtyPort(arguments.link))
        print(port.name, flush=True)
        port.wait_for_reader(lambda: stop.asked)
        sent, dropped = send(bench, port, stop, arguments.speedup)
        # Closing the port throws away what the listener has not read yet.
        stop.sleep(LINGER_S if port.has_reader() else 0.0)
    print(f"motorlens drive: {sent - dropped} samples sent, {dropped} lost on the line", file=sys.stderr)
    write_json(
        {"schema": "motorlens.drive/1", "sent": sent - dropped, "lost": dropped, "rate_Hz": arguments.rate},
        arguments.json,
    )
    return 0


def _send(bench: "Bench", port: "PtyPort", stop: "_Stop", speedup: float) -> tuple[int, int]:
    """Send the frames when they are due; how many samples were sent, and how many of them the line did not take."""
    from motorlens_firmware_sim.telemetry import sendings

    sent = dropped = 0
    port.write(b"\0", patience_s=1.0)
    began = time.monotonic()
    for sending in sendings(bench.drive, bench.codes):
        stop.sleep(began + sending.at_s / speedup - time.monotonic())
        if stop.asked:
            break
        # A drive does not wait for its listener for long; what the line does not take is lost, and counted.
        taken = port.write(sending.data, patience_s=_PATIENCE_S)
        sent, dropped = sent + sending.samples, dropped + sending.samples * (taken < len(sending.data))
        if not port.has_reader():
            break
    return sent, dropped


def _emulated(core: str) -> "Board":
    """The board with a core. Raises DataError: an unknown core, or compiler or emulator are not here."""
    from motorlens_firmware_sim import boards

    known = {board.name: board for board in boards.BOARDS}
    if core not in known:
        raise DataError(f"--board {core}: choose {', '.join(known)}")
    if missing := boards.missing_tools():
        raise DataError(f"--board {core}: {missing}")
    return known[core]


class _OnBoard:
    """The firmware and the exported sensor for an emulated core, compiled in a folder that goes with it.

    Raises:
        ModelError: the sensor.
    """

    def __init__(self, board: "Board", sensor: str, scratch: Path) -> None:
        from motorlens_runtime.files.shipped import sensor_path
        from motorlens_runtime.sensor.export import export_c

        self._board, self._exported = board, scratch / "c"
        export_c(sensor_path(sensor), self._exported, True, "motor")

    def send(self, bench: "Bench", port: "PtyPort", stop: "_Stop", speedup: float) -> tuple[int, int]:
        """Feed the board; how many samples it measured, and about how many of them the line did not take."""
        from motorlens_firmware_sim.on_board import OnBoard

        made = taken = 0

        def pass_on(data: bytes) -> None:
            nonlocal made, taken
            made += len(data)
            taken += port.write(data, patience_s=_PATIENCE_S)

        with OnBoard(self._board, self._exported, bench, pass_on) as board:
            fed = board.run(bench.drive.rate_Hz * speedup, lambda: stop.asked or not port.has_reader())
            stop.sleep(LINGER_S)  # what the board still computes
        return fed, -(-(made - taken) * fed // max(made, 1))


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
