"""`motorlens run`: opens what the user named, lets the service run, ends it cleanly and says how it went."""

import argparse
import gc
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from motorlens_runtime.cli import write_json
from motorlens_runtime.errors import DataError
from motorlens_runtime.files.columns import parse_mapping
from motorlens_runtime.files.infer import header_of
from motorlens_runtime.line.feed import open_feed
from motorlens_runtime.sensor.sensor import load_sensor
from motorlens_runtime.service.alarms import Watch, parse_alarm
from motorlens_runtime.service.memory import Memory
from motorlens_runtime.service.notify import Notifier
from motorlens_runtime.service.outlet import Outlet
from motorlens_runtime.service.realtime import Granted, collecting, realtime
from motorlens_runtime.service.recorder import Recorder
from motorlens_runtime.service.service import Service, Settings
from motorlens_runtime.service.swap import Swap


def run_live(arguments: argparse.Namespace) -> int:
    """See `commands.run`. Raises what opening or the line raises."""
    if not arguments.rate >= 0:
        raise DataError(f"--rate {arguments.rate}: give estimates per second, or 0 for one a sample")
    sensor = load_sensor(arguments.sensor, arguments.backend)
    if (
        sensor.specification.needs_ambient
        and arguments.ambient is None
        and not arguments.source.startswith("file:")
    ):
        print(
            f"motorlens {arguments.command}: the sensor needs the ambient temperature from the drive; "
            "--ambient DEGREES_C sets it",
            file=sys.stderr,
        )
    watch = Watch([parse_alarm(text, sensor.specification) for text in arguments.alarm])
    clock = time.monotonic_ns
    with ExitStack() as stack:
        feed = open_feed(
            arguments.source, parse_mapping(arguments.column), arguments.ambient, arguments.reconnect, clock
        )
        stack.callback(feed.close)
        outlets = []
        for url in arguments.publish or ["stdout:"]:
            outlet = Outlet(url, header_of(sensor))
            outlets.append(outlet)
            stack.callback(outlet.close)
        recorder = Recorder(arguments.record) if arguments.record else None
        if recorder is not None:
            stack.callback(recorder.close)
        swap = None
        if arguments.swap is not None:
            swap = Swap(sensor.path, arguments.backend, arguments.swap)
            swap.start()
            stack.callback(swap.close)
        memory = Memory(arguments.memory, sensor) if arguments.memory else None
        service = Service(
            feed,
            sensor,
            outlets,
            recorder,
            Settings(arguments.rate, arguments.duration),
            clock,
            watch=watch,
            memory=memory,
            swap=swap,
        )
        # What is alive now stays alive: the collector need not look at it again.
        gc.collect()
        gc.freeze()
        cpu_s, started_ns = time.process_time(), clock()
        profile: Granted | None = None
        try:
            with stopping() as stop:
                stop = Notifier().while_running(stop, clock)
                if arguments.realtime:
                    with realtime() as profile:
                        service.run(collecting(stop, clock))
                else:
                    service.run(stop)
        finally:
            seconds = (clock() - started_ns) * 1e-9
            cpu_s = time.process_time() - cpu_s
            if memory is not None:
                memory.close(service.estimator.state if service.estimator else None, feed.device)
            stack.close()
            gc.unfreeze()
            report = {**service.report(), "seconds": seconds, "cpu_share": cpu_s / max(seconds, 1e-9)}
            if profile is not None:
                report["realtime"] = {"granted": profile.granted, "refused": profile.refused}
            if recorder is not None:
                report["record"] = {"lost": recorder.lost, "error": recorder.error}
            _say(report, arguments.command)
            write_json(report, arguments.json)
    return 0


@contextmanager
def stopping() -> Iterator[Any]:
    """A function that tells whether SIGINT or SIGTERM has come; a second one ends at once."""
    caught: list[int] = []

    def note(number: int, frame: object) -> None:
        if caught:
            raise KeyboardInterrupt
        caught.append(number)

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(caught)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _event_line(event: dict[str, Any]) -> str:
    if event["event"] != "alarm":
        return str(event["message"])
    return f"alarm {'on' if event['active'] else 'off'}: {event['alarm']}: {event['message']}"


def _say(report: dict[str, Any], command: str) -> None:
    """The summary on standard error: a few lines for a person."""
    feed = report["feed"]
    from_whom = f" from {report['device']}" if report["device"] else ""
    lines = [
        f"{report['samples']} samples{from_whom} in {report['seconds']:.1f} s, {report['lost']} lost, "
        f"{feed.get('bad_frames', 0)} damaged frames, {feed.get('reconnects', 0)} reconnections"
    ]
    latency = report["latency_us"]
    if latency is not None:
        lines.append(
            f"{report['published']} estimates, {report['bridged']} bridged; from arrival to estimate "
            f"{latency['p50']:.0f} us (median), {latency['p99']:.0f} us (99 %); "
            f"{100 * report['cpu_share']:.1f} % of a processor core"
        )
    profile = report.get("realtime", {})
    lines += [", ".join(profile[key]) for key in ("granted", "refused") if profile.get(key)]
    if "complaint" in feed:
        lines.append(feed["complaint"])
    for outlet in report["outlets"]:
        if outlet["dropped"] or outlet["errors"]:
            why = f" ({outlet['last_error']})" if outlet["last_error"] else ""
            lines.append(
                f"{outlet['url']}: {outlet['published']} rows published, {outlet['dropped']} dropped{why}"
            )
    record = report.get("record")
    if record and (record["lost"] or record["error"]):
        lines.append(
            f"recording: {record['lost']} samples lost{': ' + record['error'] if record['error'] else ''}"
        )
    memory = report["memory"]
    if memory and memory["message"]:
        lines.append(memory["message"])
    lines += [_event_line(event) for event in report["events"][-5:]]
    for line in lines:
        print(f"motorlens {command}: {line}", file=sys.stderr)
