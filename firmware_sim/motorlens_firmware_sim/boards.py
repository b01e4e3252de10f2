"""Microcontrollers under QEMU's system emulator: a program compiled for each core, what it says and what it costs there.

The boards are Arm's MPS2 images; a Cortex-M0 has none with enough memory, so what is compiled for it runs on a Cortex-M3,
which executes all of its instructions. QEMU counts instructions, not cycles.
"""

import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from motorlens_runtime.errors import DataError
from motorlens_runtime.sensor.core_library import CALL_S, why_not

FOLDER = Path(__file__).resolve().parents[1] / "boards"
COMPILER, EMULATOR = "arm-none-eabi-gcc", "qemu-system-arm"


@dataclass(frozen=True)
class Board:
    """One core: QEMU's machine, and what the compiler must know."""

    name: str
    machine: str
    flags: tuple[str, ...]


BOARDS = (
    Board("cortex-m0", "mps2-an385", ("-mcpu=cortex-m0",)),
    Board("cortex-m3", "mps2-an385", ("-mcpu=cortex-m3",)),
    Board("cortex-m4f", "mps2-an386", ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard")),
    Board("cortex-m7f", "mps2-an500", ("-mcpu=cortex-m7", "-mfpu=fpv5-sp-d16", "-mfloat-abi=hard")),
)
# Bits must not depend on the compiler: no contraction of products and sums, nothing reordered.
FLAGS = ("-std=c99", "-Os", "-ffp-contract=off", "-fno-math-errno", "-Wall", "-Wextra", "-Werror")


@dataclass(frozen=True)
class Cost:
    """Bytes of the program's flash and of its memory without the stack, and of the stack; instructions as counted.

    Attributes:
        flash: code and tables of everything but the board's start-up and the proof's own code.
        memory: the state.
        stack: the deepest that the program went.
        update: instructions a sample, on average; `update_most` of the longest.
        evaluate: instructions of an evaluation.
    """

    flash: int
    memory: int
    stack: int
    update: int
    update_most: int
    evaluate: int


def missing_tools() -> str | None:
    """What is not here of compiler, its C library and emulator, and how to get it; None if all is."""
    needed = {COMPILER: "gcc-arm-none-eabi libnewlib-arm-none-eabi", EMULATOR: "qemu-system-arm"}
    absent = [tool for tool in needed if shutil.which(tool) is None]
    if absent:
        return (
            f"no {' and no '.join(absent)} here (apt-get install {' '.join(needed[tool] for tool in absent)})"
        )
    found = subprocess.run([COMPILER, "-print-file-name=libm.a"], capture_output=True, text=True)
    if found.stdout.strip() == "libm.a":
        return "no C library for Arm here (apt-get install libnewlib-arm-none-eabi)"
    return None


def compile_for(board: Board, sources: list[Path], target: Path, defines: tuple[str, ...] = ()) -> Path:
    """Compile `sources` with the start-up code into `target`; a map file beside it says what takes which room.

    Raises:
        DataError: it does not compile, and then the message is the compiler's first error; or the compiler does not end.
    """
    sources = [FOLDER / "board.c", *sources]
    machine = (COMPILER, *board.flags, "-mthumb")
    compiling = [
        *machine, *FLAGS, "-ffunction-sections", "-fdata-sections", "-DBOARD", *defines, f"-I{FOLDER}", "-c",
        *map(str, sources),
    ]  # fmt: skip
    linking = [
        *machine, "-nostartfiles", "--specs=nano.specs", f"-T{FOLDER / 'link.ld'}", "-Wl,--gc-sections",
        "-Wl,--no-warn-rwx-segments", f"-Wl,-Map={target.with_suffix('.map')}", "-o", str(target),
        *(f"{source.stem}.o" for source in sources), "-lm",
    ]  # fmt: skip
    for command in (compiling, linking):
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=CALL_S, cwd=target.parent)
        except subprocess.TimeoutExpired as error:
            raise DataError(f"{board.name}: {why_not(error)}") from None
        if done.returncode:
            raise DataError(f"{board.name}: {' '.join(done.stderr.split())[:400]}")
    return target


def emulator_command(board: Board, program: Path, *serial: str) -> list[str]:
    """The command that runs a program; `serial` is where its serial lines go, by default the first to standard output."""
    lines = [word for line in serial or ("stdio",) for word in ("-serial", line)]
    return [
        EMULATOR, "-machine", board.machine, "-icount", "shift=0", "-display", "none", "-monitor", "none",
        *lines, "-semihosting-config", "enable=on,target=native", "-kernel", str(program),
    ]  # fmt: skip


def run_on(board: Board, program: Path) -> str:
    """What a program prints. Raises DataError if it faults or does not end."""
    try:
        done = subprocess.run(
            emulator_command(board, program), capture_output=True, text=True, timeout=CALL_S, stdin=subprocess.DEVNULL
        )  # fmt: skip
    except subprocess.TimeoutExpired as error:
        raise DataError(f"{board.name}: {why_not(error)}") from None
    if done.returncode or "fault" in done.stdout:
        raise DataError(f"{board.name}: ended with {done.returncode}: {(done.stdout + done.stderr)[-200:]}")
    return done.stdout


def cost_of(said: str, program: Path) -> Cost:
    """What the proof said of its cost, with the flash of its linker map."""
    numbers = {key: int(value) for key, value in re.findall(r"^(\w+) (\d+)$", said, re.MULTILINE)}
    return Cost(
        flash=flash_of(program), memory=numbers["state"], stack=numbers["stack"], update=numbers["update"],
        update_most=numbers["update_most"], evaluate=numbers["evaluate"],
    )  # fmt: skip


def flash_of(program: Path) -> int:
    """Bytes of code and constant tables that a program links, the board's start-up and the proof itself left out.

    Taken from the linker's map: each section that was kept, with the file that it comes from.
    """
    text = program.with_suffix(".map").read_text(encoding="utf-8")
    kept = text[text.index("Linker script and memory map") :]
    total = 0
    for size, path in re.findall(
        r"^ \.(?:text|rodata|vectors)\S*\s+0x[0-9a-f]+\s+0x([0-9a-f]+) (\S.*)$", kept, re.MULTILINE
    ):
        total += 0 if path in ("board.o", "proof.o") else int(size, 16)
    return total
