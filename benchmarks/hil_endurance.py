"""What a service meets in months, in minutes: kills at any moment, and a new sensor every second. Gates on counts.

    python benchmarks/hil_endurance.py [--quick] [--kills N] [--swap-minutes M]

1. `motorlens run` is killed with SIGKILL N times (default 200) at random while it writes CSV, a Parquet folder, a recording
   and the snapshot of the heat. After each: every row published up to a second before the kill is in CSV and Parquet, bit
   for bit; the recording is readable; the snapshot is whole, the old one or the new one. The Parquet folder goes on.
2. For M minutes of real time (default 20) a device at 1 kHz on a pseudo-terminal, and a verified sensor offered every
   second: no sample lost, none invented, memory flat within 1 MB.

Exit status 1 if a gate fails.
"""

import argparse
import gc
import hashlib
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

sys.path.insert(0, str(Path(__file__).parent))
import hil

from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.files.parquet_folder import ParquetFolder
from motorlens_runtime.line.feed import open_feed
from motorlens_runtime.sensor.sensor import load_sensor
from motorlens_runtime.service import snapshot
from motorlens_runtime.service.outlet import OutletReport
from motorlens_runtime.service.service import Service, Settings
from motorlens_runtime.service.swap import Swap

SENSOR = hil.ROOT / "models" / "sensors" / "mellah2016.onnx"
# What was published so long before the kill must be on disk.
UNFLUSHED_S = 1.0
PUBLISH_HZ = 200
SWAP_EVERY_S, SHADOW_S = 1.0, 0.3


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="5 kills, half a minute of swaps")
    parser.add_argument("--kills", type=int)
    parser.add_argument("--swap-minutes", type=float)
    arguments = parser.parse_args()
    kills = (5 if arguments.quick else 200) if arguments.kills is None else arguments.kills
    minutes = (0.5 if arguments.quick else 20.0) if arguments.swap_minutes is None else arguments.swap_minutes
    gates = []
    if kills:
        gates += killed(kills)
    if minutes:
        gates += swapped(60 * minutes)
    failed = [name for name, passed in gates if not passed]
    print(
        f"{len(gates) - len(failed)} of {len(gates)} gates passed"
        + "".join(f"; FAILED: {name}" for name in failed)
    )
    return 1 if failed else 0


def killed(times: int) -> list[tuple[str, bool]]:
    """Kill the service again and again, and look at what it left."""
    rng = np.random.default_rng(0)
    rows_seen = missing = wrong = unreadable = torn = snapshots = late = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        hil_recording(folder / "drive.csv", 30)
        for round_ in range(times):
            csv, record = folder / f"{round_}.csv", folder / f"{round_}.rec.csv"
            command = [
                sys.executable, "-m", "motorlens_runtime", "run", "--source", f"file:{folder}/drive.csv?speed=1",
                "--sensor", str(SENSOR), "--publish", "stdout:", "--publish", f"csv:{csv}",
                "--publish", f"parquet:{folder}/log/?rows=300", "--record", str(record),
                "--memory", str(folder / "heat.json"), "--rate", str(PUBLISH_HZ),
            ]  # fmt: skip
            before = {path.name for path in (folder / "log").glob("*.parquet")}
            # One in eight is killed about when it keeps its heat for the first time.
            seconds = rng.uniform(9.8, 10.4) if round_ % 8 == 7 else rng.uniform(0.02, 3.5)
            seen, at = seen_before_kill(command, float(seconds))
            due = [line for line, arrived in seen if arrived < at - UNFLUSHED_S]
            late += bool(seen)
            rows_seen += len(due)
            text = csv.read_text() if csv.exists() else ""
            lines = set(text[: text.rfind("\n") + 1].splitlines())
            missing += sum(line not in lines for line in due)
            try:
                rows = rows_of_folder(folder / "log", before)
            except Exception as error:  # whatever the reader finds wrong is what is being looked for
                print(f"round {round_}: {error}")
                unreadable += 1
                rows = {}
            for line in due:
                cells = [float(cell) for cell in line.split(",")]
                found = rows.get(cells[0])
                if found is None:
                    missing += 1
                elif [f"{value:.9g}" for value in found] != [f"{value:.9g}" for value in cells[1:]]:
                    wrong += 1
            if record.exists() and not readable(record):
                unreadable += 1
            heat = snapshot.load(folder / "heat.json")
            torn += isinstance(heat, str)
            snapshots += isinstance(heat, snapshot.Snapshot)
            for path in (csv, record):
                path.unlink(missing_ok=True)
            if (round_ + 1) % 20 == 0:
                print(
                    f"{round_ + 1} kills: {rows_seen} rows looked for, {missing} missing, {torn} snapshots torn",
                    flush=True,
                )
    print(
        f"{times} kills, {late} of them after the first estimate: {rows_seen} rows published a second or more before; "
        f"{missing} missing, {wrong} different, {unreadable} files unreadable, {torn} snapshots torn, {snapshots} whole"
    )
    return [
        ("kills: nothing published is missing", missing == 0),
        ("kills: what is there is right", wrong == 0),
        ("kills: every file readable", unreadable == 0),
        ("kills: no snapshot torn", torn == 0),
        ("kills: there was something to lose", rows_seen > 20 * times),
    ]


def hil_recording(path: Path, seconds: int) -> None:
    codes = hil.codes_of(seconds * 1000)
    with path.open("w") as file:
        file.write("time_s,voltage_V,current_A\n")
        for k, (voltage, current) in enumerate(codes.tolist()):
            file.write(f"{k / 1000:.3f},{abs(voltage) * 0.13:.3f},{current * 0.037:.3f}\n")


def seen_before_kill(command: list[str], seconds: float) -> tuple[list[tuple[str, float]], float]:
    """What the service said before it was killed `seconds` after its first line, with when; and when that was."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert process.stdout is not None
    lines: list[tuple[str, float]] = []
    stream = process.stdout

    def listen() -> None:
        lines.extend((line.rstrip("\n"), time.monotonic()) for line in stream if line.endswith("\n"))

    listener = threading.Thread(target=listen)
    listener.start()
    deadline = time.monotonic() + 30
    while not lines and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.005)
    time.sleep(seconds)
    at = time.monotonic()
    process.send_signal(signal.SIGKILL)
    process.wait()
    listener.join()
    stream.close()
    return [(line, arrived) for line, arrived in lines if line[:1].isdigit()], at


def rows_of_folder(folder: Path, before: set[str]) -> dict[float, list[float]]:
    """The rows that the last run left: its journal is finished as the next writer would."""
    if not folder.exists():
        return {}
    headings = [name for o in load_sensor(SENSOR).specification.outputs for name in (o.heading, o.sd_heading)]
    ParquetFolder(folder, headings, {}).close()
    rows: dict[float, list[float]] = {}
    for path in sorted(folder.glob("*.parquet")):
        table = pq.read_table(path)
        if path.name not in before:
            columns = [table[name].to_pylist() for name in table.column_names]
            rows.update({time_s: list(cells) for time_s, *cells in zip(*columns, strict=True)})
    return rows


def readable(path: Path) -> bool:
    """Whether a recording reads as far as its last whole row."""
    from motorlens_runtime.errors import DataError
    from motorlens_runtime.files.csv_stream import CsvStream

    if not path.stat().st_size:
        return True  # killed before its heading was on disk
    try:
        stream = CsvStream(path, {})
        for _ in stream:
            pass
        stream.close()
    except DataError as error:
        print(error)
        return False
    return True


class Last:
    """An outlet that counts, estimates and sensors taken into service, and remembers only the last."""

    dead = False

    def __init__(self) -> None:
        self.rows, self.repeats, self.time_ns, self.taken = 0, 0, -1, 0

    def report(self) -> OutletReport:
        return OutletReport("last", self.rows, 0, 0, None)

    def put(self, estimates: Estimates, inputs: object = None) -> None:
        # While nothing comes, the last estimate is published on, marked stale.
        stale = int((estimates.quality & Quality.STALE != 0).sum())
        self.repeats += stale
        self.rows += len(estimates.quality) - stale
        self.time_ns = int(estimates.time_ns[-1])

    def put_event(self, event: dict[str, object]) -> None:
        self.taken += ": taken into service" in str(event["message"])

    def put_counts(self, counts: dict[str, object]) -> None:
        pass


def versions(folder: Path) -> list[str]:
    """Two files of the same sensor that differ in their version alone."""
    data = SENSOR.read_bytes()
    mark, version = b"motorlens.sha256\x12\x40", load_sensor(SENSOR).version.encode()
    entry = b"motorlens.version\x12" + bytes((len(version),))
    paths = []
    for last in b"89":
        at = data.index(entry) + len(entry)
        other = data[: at + len(version) - 1] + bytes((last,)) + data[at + len(version) :]
        seal = other.index(mark) + len(mark)
        blank = other[:seal] + b"0" * 64 + other[seal + 64 :]
        path = folder / f"{last}.onnx"
        path.write_bytes(blank[:seal] + hashlib.sha256(blank).hexdigest().encode() + blank[seal + 64 :])
        paths.append(str(path))
    return paths


def swapped(seconds: float) -> list[tuple[str, bool]]:
    """A live line at 1 kHz with another sensor offered every second."""
    with tempfile.TemporaryDirectory() as name:
        files = versions(Path(name))
        stamps = str(Path(name) / "stamps.npy")
        command = [sys.executable, hil.__file__, "--device", "1000", "1", str(seconds), stamps]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None and process.stdin is not None
        port = process.stdout.readline().strip()
        outlet, stop = Last(), threading.Event()
        swap = Swap(files[0], shadow_s=SHADOW_S)
        offers = [0]

        def offer() -> None:
            while not stop.wait(SWAP_EVERY_S):
                if not outlet.rows:
                    continue  # the line is not up yet
                offers[0] += 1
                swap.offer(load_sensor(files[offers[0] % 2]))

        feed = open_feed(f"pty://{port}?dialect=frames", {}, None, 0.0, time.monotonic_ns)
        service = Service(
            feed,
            load_sensor(files[0]),
            [outlet],
            None,
            Settings(1000.0),
            time.monotonic_ns,
            swap=swap,  # type: ignore[list-item]
        )
        threading.Thread(target=offer, daemon=True).start()
        memory: list[int] = []
        deadline, next_look = time.monotonic() + seconds + 60, time.monotonic()
        last_ns = (int(seconds * 1000) - 1) * 10**6

        def done() -> bool:
            nonlocal next_look
            if time.monotonic() >= next_look:
                next_look += 5.0
                gc.collect()
                memory.append(hil.resident_kB())
            return outlet.time_ns >= last_ns or time.monotonic() > deadline

        service.run(done)
        stop.set()
        report = service.report()
        feed.close()
        process.stdin.close()
        process.wait()
        process.stdout.close()
    # The first fifth is for caches and the allocator to fill.
    settled = memory[len(memory) // 5 :]
    half = len(settled) // 2
    grown = float(np.median(settled[half:]) - np.median(settled[:half]))
    count = int(seconds * 1000)
    print(
        f"{seconds:g} s at 1 kHz: {offers[0]} sensors offered, {outlet.taken} taken into service; "
        f"{report['samples']} samples, {report['lost']} lost, {outlet.rows} estimates and "
        f"{outlet.repeats} stale repeats; memory of the second half {grown:+.0f} kB "
        f"against the first; load of the machine {os.getloadavg()[0]:.1f}"
    )
    return [
        ("swaps: no sample lost, none invented", report["samples"] == count and report["lost"] == 0),
        ("swaps: an estimate each", outlet.rows == count),
        # The last one offered may still be in its shadow run when the line ends.
        ("swaps: nine of ten were taken", outlet.taken >= 0.9 * (offers[0] - 1)),
        ("swaps: memory flat within 1 MB", abs(grown) <= 1024),
    ]


if __name__ == "__main__":
    sys.exit(main())
