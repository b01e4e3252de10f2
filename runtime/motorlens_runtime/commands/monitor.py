"""Live page of a running sensor: speed, temperature and resistance with their bands, quality in words, alarms, counts.

With --source, the sensor runs here, as with `motorlens run`, and the page shows it. With --attach, the page shows a runtime
that runs already: shm:NAME (every row), http://127.0.0.1:9464 (what prometheus: serves) or udp://127.0.0.1:9870 (which may
come from another machine), after what it was given with --publish; several --attach, as NAME=URL, share the page. The page
is for this machine only and opens by itself.

example: motorlens monitor --source serial:///dev/ttyUSB0?baud=921600 --sensor mellah2016 \\
             --alarm 'temperature>90,within_s=120'
"""

import argparse
import time
from contextlib import closing

from motorlens_runtime.cli import write_json
from motorlens_runtime.commands.run import add_options

# Rows a second that the page is given of a sensor that runs here: what an eye can follow.
_PAGE_RATE_HZ = 20


def add_arguments(parser: argparse.ArgumentParser) -> None:
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--source", metavar="URL", help="where the samples come from, as for motorlens run")
    where.add_argument(
        "--attach",
        action="append",
        metavar="[NAME=]URL",
        help="a runtime that runs already: shm:NAME, http://..., udp://...; may be repeated",
    )
    parser.add_argument(
        "--sensor", metavar="S.onnx", help="the virtual sensor; with --attach only --alarm needs it"
    )
    parser.add_argument(
        "--port", type=int, default=0, metavar="PORT", help="of the page (default: a free one)"
    )
    parser.add_argument("--no-browser", action="store_true", help="print the address, open no browser")
    add_options(parser)


def run(arguments: argparse.Namespace) -> int:
    from motorlens_runtime.errors import DataError

    if arguments.attach is not None:
        return _attached(arguments)
    from motorlens_runtime.service.live import run_live

    if arguments.sensor is None:
        raise DataError("--source needs a sensor: give --sensor S.onnx")
    page = f"web://127.0.0.1:{arguments.port}?rate={_PAGE_RATE_HZ}&open={int(not arguments.no_browser)}"
    arguments.publish = [*arguments.publish, page]
    return run_live(arguments)


def _attached(arguments: argparse.Namespace) -> int:
    from contextlib import ExitStack

    from motorlens_runtime.errors import DataError
    from motorlens_runtime.monitor.attach import attach, named
    from motorlens_runtime.monitor.follow import Follower
    from motorlens_runtime.monitor.page import MonitorPage
    from motorlens_runtime.sensor.sensor import load_sensor
    from motorlens_runtime.service.alarms import parse_alarm
    from motorlens_runtime.service.live import stopping
    from motorlens_runtime.web.browser import announce

    for name in ("publish", "swap", "memory", "record", "column", "ambient", "realtime"):
        if getattr(arguments, name):
            raise DataError(f"--{name} is for a sensor that runs here, with --source; --attach only looks")
    if arguments.alarm and arguments.sensor is None:
        raise DataError("--alarm needs --sensor S.onnx, whose quantities and time constant it uses")
    alarms = []
    if arguments.alarm:
        specification = load_sensor(arguments.sensor, arguments.backend).specification
        alarms = [parse_alarm(text, specification) for text in arguments.alarm]
    with ExitStack() as stack:
        there = []
        for text in arguments.attach:
            name, url = named(text)
            there.append((name, url, stack.enter_context(closing(attach(url)))))
        (name, url, first), *others = there
        page = MonitorPage(first.header, arguments.port, name=name)
        stack.callback(page.close)
        motors = [page.motor, *(page.add(other.header, name) for name, _, other in others)]
        followers = [
            Follower(attachment, motor, alarms, time.monotonic)
            for (_, _, attachment), motor in zip(there, motors, strict=True)
        ]
        announce("monitor", page.url, None if arguments.no_browser else page.url_for_once())
        end = time.monotonic() + arguments.duration
        with stopping() as stop:
            while not stop() and time.monotonic() < end:
                for follower in followers:
                    follower.look(0.25 / len(followers))
    reports = [
        {"attached": url, **follower.report()} for (_, url, _), follower in zip(there, followers, strict=True)
    ]
    write_json({"schema": "motorlens.monitor/1", **reports[0], "motors": reports}, arguments.json)
    return 0
