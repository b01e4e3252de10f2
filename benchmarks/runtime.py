"""What the runtime costs: size, start, memory, the hot call, batches, the decoder, and a recorded file against its readers.

    python benchmarks/runtime.py [--quick] [--sensor S.onnx] [--only size|start|network|decoder|line|file]

Figures of this process are in processor time, the best of several runs; those of other processes in wall-clock time, which
depends on what else the machine does: its load is printed with them.
"""

import argparse
import importlib.metadata
import importlib.util
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from motorlens_runtime.estimate.core_estimator import open_estimator
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.line.core_link import open_link
from motorlens_runtime.line.follower import Estimated
from motorlens_runtime.line.framing import Channel, Decoder, Hello, hello_frames, samples_frame
from motorlens_runtime.sensor.backend import TILE
from motorlens_runtime.sensor.sensor import load_sensor
from motorlens_runtime.service.service import Service, Settings

ROOT = Path(__file__).resolve().parents[1]
FRAMES = 2000
# Libraries that read a CSV, and how one asks them.
READERS = {
    "pandas": ("pandas", "pandas.read_csv(path)"),
    "polars": ("polars", "polars.read_csv(path)"),
    "pyarrow": ("pyarrow.csv", "pyarrow.csv.read_csv(path)"),
    "numpy.loadtxt": ("numpy", "numpy.loadtxt(path, delimiter=',', skiprows=1)"),
}
PARQUET_READERS = {
    "polars": ("polars", "polars.read_parquet(path)"),
    "pyarrow": ("pyarrow.parquet", "pyarrow.parquet.read_table(path)"),
}
# Reads a file and says what it took; importing the library is not counted.
READING = """
import sys, time, {module}
path = sys.argv[1]
started, cpu = time.perf_counter(), time.process_time()
table = {call}
seconds, cpu = time.perf_counter() - started, time.process_time() - cpu
memory = {{line.split()[0]: line.split()[1] for line in open("/proc/self/status") if line.startswith("Vm")}}
print(seconds, cpu, memory["VmHWM:"])
"""
CONVERTING = """
import sys, pyarrow.csv, pyarrow.parquet
pyarrow.parquet.write_table(pyarrow.csv.read_csv(sys.argv[1]), sys.argv[2])
"""
# Runs a command of `motorlens` and says what it took; VmHWM is the peak of this program alone.
MEASURED = """
import sys, time
started = time.perf_counter()
from motorlens_runtime.cli import main
status = main(sys.argv[1:])
seconds = time.perf_counter() - started
memory = {line.split()[0]: line.split()[1] for line in open("/proc/self/status") if line.startswith("Vm")}
print(status, seconds, time.process_time(), memory["VmHWM:"], memory["VmRSS:"])
"""


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a file of 1e6 rows instead of 1e7")
    parser.add_argument("--sensor", default=str(ROOT / "models" / "sensors" / "mellah2016.onnx"))
    parser.add_argument(
        "--only", choices=("size", "start", "network", "decoder", "line", "file"), help="one part of it"
    )
    arguments = parser.parse_args()
    print(f"load of the machine {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    parts = {
        "size": installed,
        "start": lambda: start_up(arguments.sensor),
        "network": lambda: evaluations(arguments.sensor),
        "decoder": decoder,
        "line": lambda: live_line(arguments.sensor),
        "file": lambda: recorded(arguments.sensor, 1_000_000 if arguments.quick else 10_000_000),
    }
    for part in [arguments.only] if arguments.only else parts:
        parts[part]()
    return 0


def best(action: Callable[[], object], repeats: int = 5) -> float:
    """Processor seconds of the fastest of several runs in this process."""
    times = []
    for _ in range(repeats):
        started = time.process_time()
        action()
        times.append(time.process_time() - started)
    return min(times)


def installed() -> None:
    """Size on disk of what `pip install motorlens` brings, without compiled caches and the packages it does not use."""
    wanted, seen, sizes = ["motorlens"], set(), {}
    while wanted:
        name = wanted.pop()
        if name in seen:
            continue
        seen.add(name)
        try:
            distribution = importlib.metadata.distribution(name)
        except importlib.metadata.PackageNotFoundError:
            continue
        files = [] if name == "motorlens" else distribution.files or []
        paths = [
            Path(str(distribution.locate_file(file))) for file in files if not str(file).endswith(".pyc")
        ]
        sizes[name] = sum(path.stat().st_size for path in paths if path.exists())
        for requirement in distribution.requires or []:
            if "extra ==" not in requirement:
                wanted.append(re.split(r"[^A-Za-z0-9_.-]", requirement)[0])
    package = ROOT / "runtime" / "motorlens_runtime"
    sizes["motorlens"] = sum(
        p.stat().st_size for p in package.rglob("*") if p.is_file() and p.suffix != ".pyc"
    )
    parts = ", ".join(
        f"{name} {size / 1e6:.1f}" for name, size in sorted(sizes.items(), key=lambda item: -item[1])
    )
    print(f"installed: {sum(sizes.values()) / 1e6:.0f} MB ({parts})")


def measured(*command: str) -> tuple[float, float, int, int]:
    """Seconds, processor seconds, peak and final memory in kB of one `motorlens` command in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", MEASURED, *command], capture_output=True, text=True, check=True
    )
    status, seconds, cpu, peak, resident = done.stdout.split()[-5:]
    if status != "0":
        raise RuntimeError(done.stderr)
    return float(seconds), float(cpu), int(peak), int(resident)


def write_csv(path: Path, rows: int) -> None:
    rng = np.random.default_rng(0)
    with path.open("w") as file:
        file.write("time_s,voltage_V,current_A\n")
        for first in range(0, rows, 100_000):
            n = min(100_000, rows - first)
            table = np.column_stack(
                [np.arange(first, first + n) / 1000, 100 + rng.normal(size=n), 8 + rng.normal(size=n)]
            )
            file.write("".join(f"{t:.3f},{v:.4f},{i:.4f}\n" for t, v, i in table.tolist()))


def start_up(sensor: str) -> None:
    """A fresh process from nothing to the first estimates of a short file, and its memory."""
    with tempfile.TemporaryDirectory() as folder:
        write_csv(Path(folder) / "short.csv", 100)
        command = ["infer", f"{folder}/short.csv", "--sensor", sensor, "-o", f"{folder}/out.csv"]
        runs = [measured(*command) for _ in range(5)]
        whole, cpu, peak, resident = (min(column) for column in zip(*runs, strict=True))
        numpy_peak = measured(*command, "--backend", "numpy")[2]
    print(f"cold start to the estimates of a short file: {whole:.2f} s, {cpu:.2f} s of processor time")
    print(
        f"resident: {resident / 1000:.0f} MB, peak {peak / 1000:.0f} MB; with the numpy backend {numpy_peak / 1000:.0f} MB"
    )


def evaluations(path: str) -> None:
    """The network on one tile, in batches, and the whole estimator."""
    import onnxruntime as ort

    sensor = load_sensor(path)
    features = len(sensor.specification.features)
    tile = np.random.default_rng(0).normal(size=(1, features, TILE))
    batch = np.random.default_rng(0).normal(size=(4096 // TILE, features, TILE))
    for backend in (sensor.backend, sensor.checker):
        if backend is not None:
            # Short runs, and many: on a machine that others use, some of them go undisturbed.
            call = best(lambda evaluate=backend.evaluate: [evaluate(tile) for _ in range(50)], 400) / 50
            many = best(lambda evaluate=backend.evaluate: evaluate(batch), 200)
            print(
                f"network, {backend.name}: {1e6 * call:.1f} us a hot call of {TILE} rows, "
                f"{4.096e-3 / many:.1f} million rows/s in tiles of {TILE}"
            )
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    session = ort.InferenceSession(path, options)
    kind = {"tensor(float)": np.float32, "tensor(double)": np.float64}[session.get_inputs()[0].type]
    rows = np.random.default_rng(0).normal(size=(4096, features)).astype(kind)
    seconds = best(lambda: [session.run(None, {"features": rows}) for _ in range(50)]) / 50
    print(f"network, onnxruntime as it comes: {4.096e-3 / seconds:.1f} million rows/s in batches of 4096")
    n = 8192
    values = 100 + np.random.default_rng(1).normal(size=n), 8 + np.random.default_rng(2).normal(size=n)

    def offline() -> None:
        estimator = open_estimator(sensor, 1e-3)
        for k in range(20):
            estimator.push(Samples(np.arange(k * n, (k + 1) * n) * 1_000_000, *values))

    print(
        f"estimator, every row: {20 * n / best(offline, 3) / 1e6:.2f} million rows/s ({len(sensor.bank.signals)} filters)"
    )
    for rows in (1, 10, 20):
        parts = [
            Samples(np.arange(k * rows, (k + 1) * rows) * 1_000_000, *(v[:rows] for v in values))
            for k in range(2000)
        ]
        last = np.array([rows - 1])

        def live(parts: list[Samples] = parts, last: np.ndarray = last) -> None:
            estimator = open_estimator(sensor, 1e-3)
            for part in parts:
                estimator.push(part, last)

        print(f"estimator, live block of {rows}: {1e6 * best(live, 3) / 2000:.0f} us with one evaluation")


def decoder() -> None:
    """Frames from bytes, by how many arrive together."""
    codes = np.random.default_rng(0).integers(-2048, 2048, (20_000, 10, 2)).astype(np.int16)
    data = b"".join(
        samples_frame(rows, schema=1, sequence=k & 0xFFFF, t0_us=k) for k, rows in enumerate(codes)
    )
    for together in (1, 50, 5000):
        size = together * 56

        def feed(size: int = size) -> None:
            decode = Decoder()
            for at in range(0, len(data), size):
                decode.feed(data[at : at + size])

        print(
            f"decoder, {together} frames of 10 samples at a time: {0.02 / best(feed, 3):.2f} million frames/s"
        )


class Frames:
    """A feed of frames that are there already, one at a read; with `cold`, what the processor remembers is gone by then.

    `taken_ns` is the processor time of each, from the bytes to when the estimate was handed out.
    """

    live = True

    def __init__(self, rate_Hz: int, n: int, cold: bool) -> None:
        channels = tuple(
            Channel(name, unit, scale=0.1) for name, unit in (("voltage", "V"), ("current", "A"))
        )
        codes = np.random.default_rng(0).normal((1000, 80), 2, (FRAMES, n, 2)).round().astype(np.int16)
        frames = hello_frames(Hello("bench", 1, (rate_Hz, 1), channels), sequence=0, t0_us=0)
        frames += [
            samples_frame(rows, schema=1, sequence=len(frames) + k, t0_us=k * n * 1_000_000 // rate_Hz)
            for k, rows in enumerate(codes)
        ]
        self._frames, self.decoder, self.ambient_C = iter(frames), open_link(), None
        # More than the caches of one processor hold, but for the one that all share.
        self._other_data = np.zeros(1 << 20) if cold else None
        self._started_ns = 0
        self.taken_ns: list[int] = []
        self.period_s: float | None = 1 / rate_Hz
        self.device, self.arrival_ns, self.dead = "bench", 0, False

    def read(self, timeout_s: float) -> Samples | Estimated | None:
        frame = next(self._frames, None)
        if frame is None:
            return None
        if self._other_data is not None:
            self._other_data.sum()
        self._started_ns = time.thread_time_ns()
        # A line that is never late: one period after another.
        self.arrival_ns += 1_000_000
        return self.decoder.followed(frame, self.arrival_ns)

    def put(self, estimates: Estimates, inputs: object = None) -> None:
        self.taken_ns.append(time.thread_time_ns() - self._started_ns)

    def put_counts(self, counts: dict[str, object]) -> None:
        pass

    def report(self) -> dict[str, object]:
        return {}

    def close(self) -> None:
        pass


def live_line(path: str) -> None:
    """From the bytes of a frame to its estimate: again and again, and with other data in the caches before each."""
    sensor = load_sensor(path)
    for rate_Hz, n in ((1000, 1), (10_000, 10), (20_000, 20)):
        taken_ns: dict[bool, list[int]] = {False: [], True: []}
        for cold in (False, True) * 4:  # in turn, for the machine has its moods
            frames = Frames(rate_Hz, n, cold)
            service = Service(frames, sensor, [frames], None, Settings(1000.0), lambda: 0)  # type: ignore[list-item]
            service.run(lambda: False)
            taken_ns[cold] += frames.taken_ns[FRAMES // 2 :]
        (hot, hot_50), (cold_10, cold_50) = (
            np.percentile(taken, (10, 50)) / 1000 for taken in taken_ns.values()
        )
        print(
            f"live line, {rate_Hz / 1000:g} kHz x {n} a frame: {hot_50:.0f} us of processor time from bytes to estimate "
            f"({hot:.0f} in the best tenth), {cold_50:.0f} ({cold_10:.0f}) after 8 MB of other data"
        )


def recorded(sensor: str, rows: int) -> None:
    """`motorlens infer` against libraries that merely read the same file, one after another in one run."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.csv"
        write_csv(path, rows)
        print(f"recorded file of {rows / 1e6:g} million rows, {path.stat().st_size / 1e6:.0f} MB:")
        pairs = [(path, "out.csv", READERS)]
        if present("pyarrow"):
            parquet = Path(folder) / "recording.parquet"
            subprocess.run([sys.executable, "-c", CONVERTING, str(path), str(parquet)], check=True)
            pairs += [(path, "out.parquet", {}), (parquet, "out.parquet", PARQUET_READERS)]
        for source, target, readers in pairs:
            what = f"infer {source.suffix[1:]} to {Path(target).suffix[1:]}"
            command = ("infer", str(source), "--sensor", sensor, "-o", f"{folder}/{target}")
            seconds, cpu, peak, _ = measured(*command)
            say_rate(what, rows, seconds, cpu, peak)
            for name, (module, call) in readers.items():
                if not present(module.partition(".")[0]):
                    continue
                script = READING.format(module=module, call=call)
                done = subprocess.run(
                    [sys.executable, "-c", script, str(source)], capture_output=True, text=True, check=True
                )
                seconds, cpu, peak = map(float, done.stdout.split())
                say_rate(f"{name}, only reading {source.suffix[1:]}", rows, seconds, cpu, peak)


def present(module: str) -> bool:
    """Whether a peer is installed; says so where it is not."""
    found = importlib.util.find_spec(module) is not None
    if not found:
        print(f"  {module}: not installed, not compared; pip install 'motorlens[publish,bench]' brings it")
    return found


def say_rate(what: str, rows: int, seconds: float, cpu: float, peak_kB: float) -> None:
    print(
        f"  {what}: {rows / seconds / 1e6:.2f} million rows/s, {rows / cpu / 1e6:.2f} a processor second, "
        f"peak memory {peak_kB / 1000:.0f} MB; load {os.getloadavg()[0]:.1f}",
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(main())
