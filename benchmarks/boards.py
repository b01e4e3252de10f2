"""What an exported sensor costs on four emulated microcontrollers, flash, memory, instructions; and whether the bits agree.

    python benchmarks/boards.py [--sensor S.onnx ...] [--double]

Flash is code and tables without the board's start-up; memory is the state and the deepest the stack went; instructions are
QEMU's, of `update` at a sample (on average and at most) and of `evaluate`. Exit status 1 if a core gives other bits than
this PC.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

from motorlens_firmware_sim import boards
from motorlens_runtime.cli import main as motorlens
from motorlens_runtime.sensor.core_library import STRICT_FLAGS, compilers

ROOT = Path(__file__).resolve().parents[1]
SHIPPED = [str(ROOT / f"models/sensors/{name}.onnx") for name in ("mellah2016", "mellah2016_observer")]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sensor", nargs="+", default=SHIPPED, help="sensor files (default: the shipped)")
    parser.add_argument("--double", action="store_true", help="the network in double precision")
    arguments = parser.parse_args()
    lacking = boards.missing_tools() or (None if compilers() else "no C compiler here (cc, gcc or clang)")
    if lacking:
        print(lacking)
        return 0
    differ = 0
    for sensor in arguments.sensor:
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch) / "c"
            if motorlens(["export", sensor, "--c", str(folder), *(["--double"] if arguments.double else [])]):
                return 1
            differ += compared(Path(sensor).stem, folder, Path(scratch))
    return int(differ > 0)


def compared(name: str, exported: Path, scratch: Path) -> int:
    """Print a line for each core; how many give other bits than this PC."""
    sources = [path for path in sorted(exported.glob("*.c")) if path.name not in ("main.c", "golden_test.c")]
    sources.append(boards.FOLDER / "proof.c")
    program = scratch / "pc"
    subprocess.run(
        [compilers()[0], *STRICT_FLAGS, "-O2", f"-I{exported}", "-o", program, *sources, "-lm"], check=True
    )
    here = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    differ = 0
    for board in boards.BOARDS:
        (scratch / board.name).mkdir()
        built = boards.compile_for(board, sources, scratch / board.name / "proof.elf", (f"-I{exported}",))
        said = boards.run_on(board, built)
        same, cost = said.startswith(here), boards.cost_of(said, built)
        differ += not same
        print(
            f"{name} on {board.name}: {'the bits of this PC' if same else 'OTHER BITS'}; flash {cost.flash} B, "
            f"memory {cost.memory} + {cost.stack} B of stack; {cost.update} instructions a sample (at most "
            f"{cost.update_most}), {cost.evaluate} an evaluation"
        )
    return differ


if __name__ == "__main__":
    sys.exit(main())
