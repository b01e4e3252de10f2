"""Follow a drive live and publish its speed, temperature and resistance at a fixed rate.

SOURCE is serial:///dev/ttyUSB0?baud=921600, pty:///dev/pts/3, tcp://HOST:PORT, udp://:PORT, stdin:, sim:// or
file:REC.csv?speed=1; ?dialect=vesc reads a drive that speaks its own protocol. Each --publish is stdout:, csv:FILE,
jsonl:FILE, parquet:FILE, udp://HOST:PORT, ... with ?rate=10&decimate=mean if wanted. Ctrl-C ends it with a summary.

example: motorlens run --source pty:///dev/pts/3 --sensor mellah2016 --publish stdout: --rate 10
"""

import argparse

from motorlens_runtime.cli import add_json_argument


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--source", required=True, metavar="URL", help="where the samples come from")
    parser.add_argument("--sensor", required=True, metavar="S.onnx", help="the virtual sensor")
    add_options(parser)


def add_options(parser: argparse.ArgumentParser) -> None:
    """What can be said besides source and sensor; `motorlens monitor` has the same."""
    parser.add_argument(
        "--publish", action="append", default=[], metavar="URL", help="where estimates go; may be repeated"
    )
    parser.add_argument(
        "--rate",
        type=float,
        default=100.0,
        metavar="HZ",
        help="estimates a second (default 100; 0: one a sample)",
    )
    parser.add_argument(
        "--duration", type=float, default=float("inf"), metavar="S", help="end after so many seconds"
    )
    parser.add_argument(
        "--alarm",
        action="append",
        default=[],
        metavar="QUANTITY>LIMIT",
        help="publish an event when it is passed: temperature>90,hysteresis=5 or temperature>90,within_s=120",
    )
    parser.add_argument(
        "--swap",
        type=float,
        metavar="S",
        help="when the sensor file changes, run the new one beside for so many seconds, then take it into service",
    )
    parser.add_argument(
        "--memory", metavar="FILE", help="remember the motor's heat here, over restarts of this program"
    )
    parser.add_argument(
        "--record",
        metavar="REC.csv",
        help="also write the samples; infer on that file gives the same estimates",
    )
    parser.add_argument(
        "--reconnect",
        type=float,
        default=1e9,
        metavar="S",
        help="how long to try a broken line again (default: always)",
    )
    parser.add_argument(
        "--column", action="append", default=[], metavar="QUANTITY=NAME", help="columns of a replayed file"
    )
    parser.add_argument(
        "--ambient",
        type=float,
        metavar="DEGREES_C",
        help="for a sensor that needs it and a drive that does not say it",
    )
    parser.add_argument(
        "--realtime",
        action="store_true",
        help="real-time priority, one processor that stays awake, locked memory; says what the system refused",
    )
    parser.add_argument(
        "--backend", choices=("auto", "core", "numpy", "onnxruntime"), default="auto", help="default: auto"
    )
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    from motorlens_runtime.service.live import run_live

    return run_live(arguments)
