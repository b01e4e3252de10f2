"""The C core as a shared object: one that came with the package, or compiled when it is first needed and kept in the cache.

A compiler is asked for the instructions of this machine, so the cache is by machine; the bits do not depend on them, because
sums are not reordered and products not contracted. Without a compiler, or with `MOTORLENS_CORE=off`, there is none, and
Python computes the same.
"""

import ctypes
import hashlib
import os
import platform
import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

# None of these reorders a sum or contracts a product: they only say that nobody looks at errno and floating-point traps.
FLAGS = (
    "-std=c99", "-O2", "-ftree-vectorize", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=off", "-fPIC", "-shared",
)  # fmt: skip
# For what is exported: nothing but the language, and the same bits everywhere.
STRICT_FLAGS = ("-std=c99", "-ffp-contract=off")
# Ends a call of a compiler, or of what it made, that hangs; a second's work may take minutes on a busy machine.
CALL_S = 600.0

real, u8, u16, u32, i32, i64, f64 = (
    ctypes.c_double, ctypes.c_uint8, ctypes.c_uint16, ctypes.c_uint32, ctypes.c_int32, ctypes.c_int64, ctypes.c_double,
)  # fmt: skip
pointer = ctypes.c_void_p


def source_folder() -> Path:
    """Where the C sources are: in the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "core"
    return inside if inside.is_dir() else package.parent / "core"


def sources() -> list[Path]:
    """The C files, in order."""
    return sorted(source_folder().glob("*.c"))


def compilers() -> list[str]:
    """The C compilers that are here."""
    return [path for path in map(shutil.which, ("cc", "gcc", "clang")) if path]


@lru_cache(maxsize=1)
def limits() -> Mapping[str, int]:
    """The room that the shared object has, from its motorlens_config.h: FILTERS, FEATURES and so on."""
    text = (source_folder() / "motorlens_config.h").read_text(encoding="utf-8")
    return {name: int(value) for name, value in re.findall(r"#define MOTORLENS_(\w+) (\d+)", text)}


@dataclass(frozen=True)
class Core:
    """A loaded core, or why there is none: `library` None, and then `reason`."""

    library: ctypes.CDLL | None
    path: str = ""
    reason: str = ""


def core() -> Core:
    """The core of this machine. The first call on a machine compiles it, which takes a second or two."""
    return _core(os.environ.get("MOTORLENS_CORE", ""))


@lru_cache(maxsize=4)
def _core(choice: str) -> Core:
    if choice == "off":
        return Core(None, reason="switched off by MOTORLENS_CORE=off")
    if choice:
        return _loaded(Path(choice))
    shipped = source_folder() / f"motorlens-{platform.machine()}.so"
    if shipped.is_file() and (loaded := _loaded(shipped)).library is not None:
        return loaded
    compiler = next(iter(compilers()), None)
    if not sources():
        return Core(None, reason="its sources are not here")
    if compiler is None:
        return Core(None, reason="no C compiler here (cc, gcc or clang)")
    try:
        return _loaded(_compiled(compiler))
    except (OSError, subprocess.SubprocessError) as error:
        return Core(None, reason=f"it does not compile here: {why_not(error)[:200]}")


def why_not(error: OSError | subprocess.SubprocessError) -> str:
    """One line that says why a compiler, or what it made, did not do its work."""
    if isinstance(error, subprocess.TimeoutExpired):
        return f"{Path(error.cmd[0]).name} did not end within {error.timeout:g} s; is this PC busy with something else?"
    return " ".join(str(getattr(error, "stderr", None) or error).split())


def compile_core(compiler: str, target: Path, *flags: str) -> None:
    """Compile the shared object into `target`, which appears whole or not at all.

    Raises:
        OSError, subprocess.SubprocessError: it does not compile, or cannot be written there.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, draft = tempfile.mkstemp(dir=target.parent, suffix=".so")
    os.close(handle)
    try:
        subprocess.run(
            [compiler, *FLAGS, *flags, "-o", draft, *map(str, sources()), "-lm"],
            check=True, capture_output=True, text=True, timeout=CALL_S, stdin=subprocess.DEVNULL,
        )  # fmt: skip
        os.chmod(draft, 0o755)
        os.replace(draft, target)
    finally:
        Path(draft).unlink(missing_ok=True)


def _compiled(compiler: str) -> Path:
    digest = hashlib.sha256()
    for path in sorted(source_folder().glob("*.[ch]")):
        digest.update(path.read_bytes())
    digest.update(repr((compiler, os.stat(compiler).st_mtime_ns, FLAGS, _instructions())).encode())
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "motorlens"
    target = cache / f"core-{digest.hexdigest()[:16]}.so"
    if not target.is_file():
        try:
            compile_core(compiler, target, "-march=native")
        except subprocess.CalledProcessError:
            compile_core(compiler, target)  # a machine that its compiler does not know
    return target


def _instructions() -> str:
    """What this processor can do, so that a cache that several machines share gives each its own."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace")
    except OSError:
        return platform.machine()
    line = next((line for line in text.splitlines() if line.lower().startswith(("flags", "features"))), "")
    return f"{platform.machine()} {line}"


def _loaded(path: Path) -> Core:
    try:
        library = ctypes.CDLL(str(path))
        library.motorlens_size.restype = ctypes.c_size_t
        library.motorlens_size.argtypes = [ctypes.c_int]
        sizes = [library.motorlens_size(k) for k in range(len(STRUCTURES))]
        if sizes != [ctypes.sizeof(structure) for structure in STRUCTURES]:
            return Core(None, reason=f"{path} is of another version of motorlens")
        library.motorlens_start.argtypes = [pointer, pointer, i64]
        library.motorlens_start.restype = None
        library.motorlens_push.argtypes = [pointer, pointer, pointer]
        library.motorlens_push.restype = i64
        library.motorlens_link_feed.argtypes = [pointer, ctypes.c_char_p, i64, i64, pointer, pointer]
        library.motorlens_link_feed.restype = i64
        library.motorlens_stream_take.argtypes = [pointer, ctypes.c_char_p, i64, i64]
        library.motorlens_stream_take.restype = i64
        library.motorlens_decimal_table.argtypes = [
            ctypes.c_char_p,
            i64,
            i32,
            ctypes.c_char,
            pointer,
            i64,
            pointer,
        ]
        library.motorlens_decimal_table.restype = i64
        library.motorlens_evaluate_features.argtypes = [pointer, i64, *[pointer] * 3]
        library.motorlens_evaluate_features.restype = None
    except (OSError, AttributeError) as error:
        return Core(None, reason=f"{path} does not load: {error}")
    return Core(library, str(path))


def _structure(name: str, **fields: Any) -> type[ctypes.Structure]:
    return type(name, (ctypes.Structure,), {"_fields_": list(fields.items())})


_room = limits()
GateTable = _structure(
    "GateTable", warm_up_ns=i64, cold_ns=i64, first_dt_ns=i64, slowest_ns=i64, fastest_ns=i64, least_V=f64, most_V=f64,
    least_A=f64, most_A=f64, absurd_V=f64, absurd_A=f64, move_V=f64, flowing_A=f64, noise_A=f64, slew_A_ns=f64, repeats=i32,
    needs_ambient=i32,
)  # fmt: skip
FeatureTable = _structure(
    "FeatureTable", signals=u16, filters=u16, features=u16, first=pointer, second=pointer, filter_signal=pointer,
    tau_s=pointer, plus=pointer, minus=pointer, resistance_ohm=f64,
)  # fmt: skip
EnvelopeTable = _structure("EnvelopeTable", mean=pointer, whitening=pointer, limit=f64, distrust=i32)
ArgumentTable = _structure("ArgumentTable", weights=pointer, start=u16, columns=u16)
StepTable = _structure(
    "StepTable", function=u8, arguments=u8, width=u16, argument=ArgumentTable * 2, low=real, high=real
)
NetworkTable = _structure(
    "NetworkTable",
    steps=pointer,
    count=u16,
    outputs=u16,
    estimate=ArgumentTable,
    sigma=ArgumentTable,
    offset=pointer,
)
OperationTable = _structure("OperationTable", operation=u8, result=u16, argument=u16 * 3)
ProgramTable = _structure(
    "ProgramTable",
    steps=pointer,
    constants=pointer,
    outputs=pointer,
    count=u16,
    registers=u16,
    inputs=u16,
    results=u16,
)
ObserverTable = _structure(
    "ObserverTable", accumulate=ProgramTable, correct=ProgramTable, read=ProgramTable, size=u16, window=u16, time=u16,
    outputs=u16, full_s=f64, ambient_C=f64,
)  # fmt: skip
SensorTable = _structure(
    "SensorTable",
    gate=GateTable,
    features=FeatureTable,
    envelope=EnvelopeTable,
    network=NetworkTable,
    observer=ObserverTable,
)
GateMemory = _structure(
    "GateMemory", first_ns=i64, last_ns=i64, bridged_until_ns=i64, count=i64, current_since=i64, first_move=i64,
    dead_since=i64, voltage_V=f64, current_A=f64, ambient_C=f64, begun=i32, remembered=i32,
)  # fmt: skip
BankMemory = _structure(
    "BankMemory", count=i64, before=f64 * _room["FILTERS"], inside=f64 * _room["FILTERS"], reach=f64 * _room["FILTERS"],
    dt_s=f64, decay=f64 * _room["FILTERS"], gain=f64 * _room["FILTERS"],
)  # fmt: skip
StateMemory = _structure(
    "StateMemory",
    gate=GateMemory,
    bank=BankMemory,
    observer=f64 * _room["OBSERVER"],
    period_ns=i64,
    failed=i32,
)
BlockTable = _structure(
    "BlockTable", n=i64, m=i64, look_every=i64, look_length=i64, looked=i64, **{
        name: pointer for name in ("time_ns", "voltage_V", "current_A", "ambient_C", "flags", "rows", "estimate", "sigma",
                                   "quality", "features")
    }
)  # fmt: skip
_COUNTS = (
    "samples", "lost_samples", "lost_frames", "late_frames", "unknown_frames", "gaps", "restarts", "device_overruns",
)  # fmt: skip
_MAX_BODY = 253
FrameTable = _structure("FrameTable", payload=pointer, length=i32, t0_us=u32, sequence=u16, kind=u8, flags=u8)
DecoderMemory = _structure("DecoderMemory", body=u8 * _MAX_BODY, length=i32, overlong=i32, bad_frames=u32)
ChannelTable = _structure(
    "ChannelTable", scale=f64, offset=f64, factor=f64, shift=f64, least=f64, most=f64, index=i32, used=i32
)
ScalingTable = _structure(
    "ScalingTable", channel=ChannelTable * 3, channels=i32, schema=i32, floats=i32, rails_known=i32, flags=u32
)
ClockMemory = _structure(
    "ClockMemory", anchor_ns=i64, count=i64, numerator=i64, step_ns=i64, offset_ns=i64, last_arrival_ns=i64, started=i32,
    restarted=i32, sequence=i32, **dict.fromkeys(_COUNTS, i64),
)  # fmt: skip
LinkMemory = _structure("LinkMemory", decoder=DecoderMemory, clock=ClockMemory, scaling=ScalingTable)
SamplesTable = _structure(
    "SamplesTable", time_ns=pointer, voltage_V=pointer, current_A=pointer, ambient_C=pointer, flags=pointer, room=i64,
    count=i64,
)  # fmt: skip
StreamTable = _structure(
    "StreamTable", link=pointer, sensor=pointer, state=pointer, samples=SamplesTable, block=BlockTable, other=FrameTable,
    rows=pointer, values=pointer, sigma=pointer, inputs=pointer, time_ns=pointer, instant_ns=i64, instant=i64, first_ns=i64,
    newest_ns=i64, late_ns=i64, backwards=i64, ambient_C=f64,
)  # fmt: skip
STRUCTURES = (
    SensorTable,
    StateMemory,
    StepTable,
    OperationTable,
    ProgramTable,
    BlockTable,
    LinkMemory,
    FrameTable,
    SamplesTable,
    StreamTable,
)
