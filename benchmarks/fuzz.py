"""Fuzz everything that reads bytes from a line: frames, link and every dialect; guided by coverage.

Inputs are grown from a few sound messages by mutation; one that reaches a line of code no input reached before joins those
that are mutated (the principle of AFL). Checked of each: no exception, time that never runs backwards, a bounded memory.

    python benchmarks/fuzz.py [--quick] [--inputs N] [--seed N] [--only SUBJECT]
"""

import argparse
import struct
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from motorlens_runtime import framing
from motorlens_runtime.dialects import Dialect, make_dialect
from motorlens_runtime.dialects.vesc import packet
from motorlens_runtime.link import Link

MOST_HELD = 1 << 16
WATCHED = ("framing.py", "link.py", "dialects/")

RECORD = """
[record]
sync = "AA 55"
checksum = "{checksum}"
[[field]]
type = "u32"
quantity = "time"
unit = "us"
[[field]]
type = "f32"
quantity = "voltage"
unit = "V"
[[field]]
type = "i16"
quantity = "current"
unit = "mA"
"""


def hello() -> bytes:
    channels = (
        framing.Channel("voltage", "V", scale=0.1),
        framing.Channel("current", "mA", minimum=-2048, maximum=2047),
    )
    frames = framing.hello_frames(framing.Hello("d", 7, (1000, 1), channels), sequence=0, t0_us=0)
    codes = np.arange(20, dtype=np.int16).reshape(10, 2)
    frames += [framing.samples_frame(codes, schema=1, sequence=9 + k, t0_us=10_000 * k) for k in range(4)]
    return b"".join(frames) + framing.status_frame(framing.Status(1, 2, 3, 4), sequence=13, t0_us=0)


def subjects(folder: Path) -> dict[str, tuple[Callable[[], Dialect], list[bytes]]]:
    """What is fuzzed: how to make a fresh one, and sound messages to begin with."""
    for checksum in ("none", "crc16_modbus"):
        (folder / f"{checksum}.toml").write_text(RECORD.format(checksum=checksum))
    values = packet(struct.pack(">Bhhiiiihih", 4, 300, 400, 1200, 5, 0, 0, -500, 3000, 240))
    rows = struct.pack("<2sIfh", b"\xaa\x55", 1000, 12.0, 800)
    return {
        "frames": (Link, [hello()]),
        "text": (lambda: make_dialect("text"), [b"t[s],v[V],i[A]\n0,12,1\n", b'{"t":0,"v":1,"i":2}\n', b"v:1 i:2\n"]),
        "vesc": (lambda: make_dialect("vesc"), [values, packet(bytes.fromhex("3200000144") + bytes(8))]),
        "roboclaw": (lambda: make_dialect("roboclaw", {"poll_Hz": "0"}), [bytes.fromhex("00f0") + bytes(10)]),
        "binary": (lambda: make_dialect("binary", {"file": str(folder / "crc16_modbus.toml")}), [rows * 3]),
        "binary, no checksum": (lambda: make_dialect("binary", {"file": str(folder / "none.toml")}), [rows * 3]),
    }  # fmt: skip


def mutate(data: bytes, corpus: list[bytes], rng: np.random.Generator) -> bytes:
    """One to four changes: bits, bytes, numbers at their limits, pieces doubled, dropped, or taken from another input."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        at = int(rng.integers(len(out) + 1))
        kind = int(rng.integers(7))
        if kind == 0 and at < len(out):
            out[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            out[at:at] = rng.bytes(int(rng.integers(1, 9)))
        elif kind == 2:
            del out[at : at + int(rng.integers(1, 9))]
        elif kind == 3:
            out[at : at + 4] = int(rng.choice([0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF])).to_bytes(
                4, "little"
            )
        elif kind == 4:
            other = corpus[int(rng.integers(len(corpus)))]
            start = int(rng.integers(len(other) + 1))
            out[at:at] = other[start : start + int(rng.integers(1, 65))]
        elif kind == 5:
            words = (
                b"nan",
                b"1e999",
                b"-",
                b"\n",
                b"{",
                b'"',
                b",,",
                b"\xff" * 8,
                b"[s]",
                b"_",
                b"\0",
                b"1" * 400,
            )
            out[at:at] = words[int(rng.integers(len(words)))]
        else:
            out = out + out[at:]
    return bytes(out[:2000])


class Coverage:
    """Lines of the watched files that have been run."""

    def __init__(self) -> None:
        self.lines: set[tuple[str, int]] = set()
        self._watched: dict[str, bool] = {}

    def trace(self, frame: FrameType, event: str, argument: Any) -> Any:
        name = frame.f_code.co_filename
        watched = self._watched.get(name)
        if watched is None:
            watched = self._watched[name] = "motorlens_runtime" in name and any(
                part in name for part in WATCHED
            )
        if not watched:
            return None
        if event == "line":
            self.lines.add((name, frame.f_lineno))
        return self.trace


def held(subject: Dialect) -> int:
    """Bytes that a subject keeps of what it was fed."""
    decoder = getattr(subject, "_decoder", subject)
    return len(getattr(decoder, "_rest", b""))


def feed(subject: Dialect, data: bytes, cuts: list[int]) -> None:
    """One input in some pieces; raises AssertionError, or whatever the subject raises."""
    last, now = -(2**63), 0
    for start, end in zip([0, *cuts], [*cuts, len(data)], strict=True):
        now += 5_000_000
        samples = subject.feed(data[start:end], now)
        subject.request(now)
        if len(samples):
            assert last <= samples.time_ns[0] and (np.diff(samples.time_ns) >= 0).all(), "time runs backwards"
            assert len(samples.voltage_V) == len(samples.current_A) == len(samples.time_ns), "columns differ"
            last = int(samples.time_ns[-1])
        assert held(subject) < MOST_HELD, "memory grows"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="20 000 inputs instead of a million")
    parser.add_argument("--inputs", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", help="one subject, with its share of the inputs")
    arguments = parser.parse_args()
    total = arguments.inputs or (20_000 if arguments.quick else 1_000_000)
    rng = np.random.default_rng(arguments.seed)
    failures = done = 0
    with tempfile.TemporaryDirectory() as folder:
        found = subjects(Path(folder))
        print(f"{'subject':22} {'inputs':>9} {'a second':>9} {'corpus':>7} {'lines':>6}")
        for name, (make, corpus) in found.items():
            if arguments.only not in (None, name):
                continue
            inputs = total // len(found)
            coverage, started = Coverage(), time.perf_counter()
            corpus = list(corpus)
            for k in range(inputs):
                data = (
                    corpus[k]
                    if k < len(corpus)
                    else mutate(corpus[int(rng.integers(len(corpus)))], corpus, rng)
                )
                cuts = sorted(rng.integers(0, len(data) + 1, int(rng.integers(3))).tolist())
                before = len(coverage.lines)
                # Tracing costs ten times as much as running, so most inputs go untraced; what they find, others will.
                traced = k < 2000 or k % 8 == 0
                sys.settrace(coverage.trace if traced else None)
                try:
                    feed(make(), data, cuts)
                except Exception as error:
                    failures += 1
                    sys.settrace(None)
                    print(f"{name}: {type(error).__name__}: {error}: {data[:200]!r} cut at {cuts}")
                finally:
                    sys.settrace(None)
                if len(coverage.lines) > before and len(corpus) < 2000:
                    corpus.append(data)
            rate = inputs / (time.perf_counter() - started)
            done += inputs
            print(f"{name:22} {inputs:9d} {rate:9.0f} {len(corpus):7d} {len(coverage.lines):6d}", flush=True)
    print(f"{failures} of {done} inputs led to an exception, a step back in time or a growing memory")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
