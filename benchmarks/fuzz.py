"""Fuzz everything that reads bytes from a line: frames, link and every dialect; a million inputs, in two ways.

1. Guided by coverage (nineteen of twenty): inputs are grown from a few sound messages by mutation; one that reaches a line
   of code no input reached before joins those that are mutated (the principle of AFL).
2. By hypothesis (one of twenty): pieces of sound messages, of what a text line may hold and of anything, in any order.

Checked of each: no exception, time that never runs backwards, a bounded memory.

    python benchmarks/fuzz.py [--quick] [--inputs N] [--seed N] [--only SUBJECT]
"""

import argparse
import copy
import random
import struct
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import numpy as np
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as seeded
from hypothesis import strategies as st

from motorlens_runtime.line import framing
from motorlens_runtime.line.dialects import Dialect, make_dialect
from motorlens_runtime.line.dialects.vesc import packet
from motorlens_runtime.line.link import Link

MOST_HELD = 1 << 16
WATCHED = ("framing.py", "link.py", "dialects/")
WORDS = (
    b"nan", b"1e999", b"-", b"\n", b"{", b'"', b",,", b"\xff" * 8, b"[s]", b"_", b"\0", b"1" * 400,
)  # fmt: skip
LIMITS = tuple(number.to_bytes(4, "little") for number in (0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF))
# hypothesis remembers all examples of a run; a new one each so many keeps that small.
EXAMPLES_A_RUN = 2500

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
    binary = {name: {"file": str(folder / f"{name}.toml")} for name in ("none", "crc16_modbus")}
    return {
        "frames": (Link, [hello()]),
        "text": (fresh("text"), [b"t[s],v[V],i[A]\n0,12,1\n", b'{"t":0,"v":1,"i":2}\n', b"v:1 i:2\n"]),
        "vesc": (fresh("vesc"), [values, packet(bytes.fromhex("3200000144") + bytes(8))]),
        "roboclaw": (fresh("roboclaw", {"poll_Hz": "0"}), [bytes.fromhex("00f0") + bytes(10)]),
        "binary": (fresh("binary", binary["crc16_modbus"]), [rows * 3]),
        "binary, no checksum": (fresh("binary", binary["none"]), [rows * 3]),
    }


def fresh(name: str, options: dict[str, str] | None = None) -> Callable[[], Dialect]:
    """Makes a dialect, in a fraction of the time that reading its options takes."""
    made = make_dialect(name, options)
    return lambda: copy.deepcopy(made)


def mutate(data: bytes, corpus: list[bytes], rng: random.Random) -> bytes:
    """One to four changes: bits, bytes, numbers at their limits, pieces doubled, dropped, or taken from another input."""
    out = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        at = rng.randint(0, len(out))
        kind = rng.randrange(7)
        if kind == 0 and at < len(out):
            out[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            out[at:at] = rng.randbytes(rng.randint(1, 8))
        elif kind == 2:
            del out[at : at + rng.randint(1, 8)]
        elif kind == 3:
            out[at : at + 4] = rng.choice(LIMITS)
        elif kind == 4:
            other = rng.choice(corpus)
            start = rng.randint(0, len(other))
            out[at:at] = other[start : start + rng.randint(1, 64)]
        elif kind == 5:
            out[at:at] = rng.choice(WORDS)
        else:
            out = out + out[at:]
    return bytes(out[:2000])


class Coverage:
    """How many lines of the watched files have been run; code of which all lines have is no longer followed."""

    def __init__(self) -> None:
        self.lines = 0
        # Of each code object, by its id (it lives as long as its module): who follows it, None if nobody need.
        self._followers: dict[int, Callable[..., Any] | None] = {}

    def trace(self, frame: FrameType, event: str, argument: Any) -> Any:
        """For `sys.settrace`."""
        key = id(frame.f_code)
        if key not in self._followers:
            self._followers[key] = self._follower(frame.f_code)
        return self._followers[key]

    def _follower(self, code: CodeType) -> Callable[..., Any] | None:
        name = code.co_filename
        if "motorlens_runtime" not in name or not any(part in name for part in WATCHED):
            return None
        missing = {line for _, _, line in code.co_lines() if line is not None} - {code.co_firstlineno}

        def follow(frame: FrameType, event: str, argument: Any) -> Any:
            if frame.f_lineno in missing:
                missing.discard(frame.f_lineno)
                self.lines += 1
                if not missing:
                    self._followers[id(code)] = None
            return follow

        return follow if missing else None


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


def guided(make: Callable[[], Dialect], messages: list[bytes], inputs: int, seed: int) -> tuple[int, str]:
    """`inputs` inputs grown from the messages; how many failed, and a line on what was reached."""
    rng, coverage, corpus, failures = random.Random(seed), Coverage(), list(messages), 0
    for k in range(inputs):
        data = corpus[k] if k < len(messages) else mutate(rng.choice(corpus), corpus, rng)
        cuts = sorted(rng.randint(0, len(data)) for _ in range(rng.randrange(3)))
        before = coverage.lines
        # Tracing costs a few times as much as running, so most inputs go untraced; what they find, others will.
        sys.settrace(coverage.trace if k < 2000 or k % 8 == 0 else None)
        try:
            feed(make(), data, cuts)
        except Exception as error:
            sys.settrace(None)
            failures += 1
            print(f"{type(error).__name__}: {error}: {data[:200]!r} cut at {cuts}")
        finally:
            sys.settrace(None)
        if coverage.lines > before and len(corpus) < 2000:
            corpus.append(data)
    return failures, f"corpus of {len(corpus)}, {coverage.lines} lines"


def pieces_of(messages: list[bytes]) -> st.SearchStrategy[list[bytes]]:
    """What arrives, piece by piece."""
    sound = st.sampled_from(messages)
    part = st.builds(lambda data, at, n: data[at : at + n], sound, st.integers(0, 300), st.integers(1, 64))
    piece = st.one_of(
        sound, part, st.sampled_from((*WORDS, *LIMITS)), st.binary(max_size=40), st.text(max_size=20)
    )
    return st.lists(piece.map(lambda data: data.encode() if isinstance(data, str) else data), max_size=8)


def imagined(make: Callable[[], Dialect], messages: list[bytes], inputs: int, seed: int) -> tuple[int, str]:
    """`inputs` inputs of hypothesis; how many runs of them failed, and a line on their length."""
    count = total = failures = 0
    pieces = pieces_of(messages)
    while count < inputs:
        before = count

        @seeded(seed + count)
        @settings(
            max_examples=min(EXAMPLES_A_RUN, inputs - count),
            database=None, deadline=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck),
        )  # fmt: skip
        @given(pieces)
        def run(chunks: list[bytes]) -> None:
            nonlocal count, total
            data = b"".join(chunks)
            count, total = count + 1, total + len(data)
            cuts = np.cumsum([len(chunk) for chunk in chunks[:-1]], dtype=np.int64).tolist()
            feed(make(), data, cuts)

        try:
            run()
        except Exception as error:
            failures += 1
            print(f"{type(error).__name__}: {error}")
        if count == before:
            raise RuntimeError("hypothesis has no input to give")
    return failures, f"{total / count:.0f} bytes each"


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="20 000 inputs instead of a million")
    parser.add_argument("--inputs", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", help="one subject, with its share of the inputs")
    arguments = parser.parse_args()
    total = arguments.inputs or (20_000 if arguments.quick else 1_000_000)
    failures = done = 0
    with tempfile.TemporaryDirectory() as folder:
        found = subjects(Path(folder))
        print(f"{'subject':22} {'by':10} {'inputs':>9} {'a processor second':>18}")
        for name, (make, messages) in found.items():
            if arguments.only not in (None, name):
                continue
            share = -(-total // (20 * len(found)))
            for by, fuzz, inputs in (("coverage", guided, 19 * share), ("hypothesis", imagined, share)):
                started = time.process_time()
                failed, said = fuzz(make, messages, inputs, arguments.seed)
                rate = inputs / (time.process_time() - started)
                failures, done = failures + failed, done + inputs
                print(f"{name:22} {by:10} {inputs:9d} {rate:18.0f}  {said}", flush=True)
    print(
        f"{done} inputs, {failures} failures (an exception, a step back in time or a growing memory), "
        f"{time.process_time():.0f} s of processor time"
    )
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
