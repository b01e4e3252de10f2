"""What a publisher costs: microseconds a row where it is called, time to open, memory, and reading shared memory.

Each in a process of its own. Times are medians on whatever else the machine does; its load is printed beside them.

    python benchmarks/publishers.py [--quick]
"""

import argparse
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.files.shared_memory import Reader
from motorlens_runtime.publish import Header, open_publisher
from motorlens_runtime.sensor.specification import Output

HEADER = Header(
    "bench",
    "1",
    "ab" * 32,
    (Output("speed", "rad/s", 100.0), Output("temperature", "K", 40.0), Output("resistance", "ohm", 0.5)),
)


def resident_MB() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def measure(url: str, rows: int) -> dict[str, float]:
    """Publish single rows at 1 kHz, as a live run would at its highest."""
    before = resident_MB()
    started = time.perf_counter()
    publisher = open_publisher(url, HEADER)
    opened = time.perf_counter() - started
    taken, read = [], []
    reader = Reader(url.partition(":")[2]) if url.startswith("shm:") else None
    for k in range(rows):
        values = np.array([[float(k), 20.0, 3.5]])
        row = Estimates(np.array([k * 1_000_000]), values, values / 100, np.zeros(1, dtype=np.uint32))
        started = time.perf_counter()
        publisher.publish(row)
        taken.append(time.perf_counter() - started)
        if reader is not None:
            started = time.perf_counter()
            reader.latest()
            read.append(time.perf_counter() - started)
        time.sleep(0.001)
    memory = resident_MB() - before
    publisher.close()
    result = {"open_ms": 1e3 * opened, "row_us": 1e6 * float(np.median(taken)), "memory_MB": memory}
    if read:
        result["read_us"] = 1e6 * float(np.median(read))
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    rows = 300 if arguments.quick else 3000
    if arguments.one:
        print(json.dumps(measure(arguments.one, rows)))
        return
    with tempfile.TemporaryDirectory() as folder, socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        free = probe.getsockname()[1]
        probe.close()
        urls = [
            f"csv:{folder}/x.csv", f"jsonl:{folder}/x.jsonl", f"parquet:{folder}/x.parquet", f"parquet:{folder}/x/",
            f"mcap:{folder}/x.mcap", "udp://127.0.0.1:9870", f"prometheus://127.0.0.1:{free}", f"shm:{folder}/ring",
            f"mqtt://127.0.0.1:{free}", f"opcua://127.0.0.1:{free}",
        ]  # fmt: skip
        print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores; {rows} single rows at 1 kHz")
        print(f"{'publisher':12} {'open ms':>9} {'us a row':>9} {'MB':>7}")
        for url in urls:
            command = [sys.executable, __file__, "--one", url, *(["--quick"] if arguments.quick else [])]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            name = url.partition(":")[0] + ("/" if url.endswith("/") else "")
            if done.returncode:
                print(f"{name:12} not here: {done.stderr.strip().splitlines()[-1]}")
                continue
            found = json.loads(done.stdout)
            read = f"   read by another: {found['read_us']:.0f} us" if "read_us" in found else ""
            note = "   (no broker)" if name == "mqtt" else ""
            print(
                f"{name:12} {found['open_ms']:9.0f} {found['row_us']:9.0f} {found['memory_MB']:7.1f}{read}{note}"
            )


if __name__ == "__main__":
    main()
