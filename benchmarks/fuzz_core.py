"""The C core under sanitizers and a coverage-guided fuzzer, and what a free checker of MISRA-like rules says of it.

    python benchmarks/fuzz_core.py [--quick] [--runs N] [--sensor S.onnx]

Needs clang with libFuzzer; cppcheck is reported where it is. Exit status 1 if anything was found.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from motorlens_runtime.cli import main as motorlens

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="10^5 inputs instead of 10^7")
    parser.add_argument("--runs", type=int, help="how many inputs")
    parser.add_argument("--sensor", default=str(ROOT / "models" / "sensors" / "mellah2016_observer.onnx"))
    arguments = parser.parse_args()
    checked()
    if shutil.which("clang") is None:
        print("no clang here: not fuzzed")
        return 0
    runs = arguments.runs or (100_000 if arguments.quick else 10_000_000)
    failed = [fuzzed(arguments.sensor, precision, runs // 2) for precision in ("single", "double")]
    return int(any(failed))


def fuzzed(sensor: str, precision: str, runs: int) -> bool:
    """Feed an exported sensor that many inputs; whether something was found. In double, the PC's one call is fed as well."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "c"
        if motorlens(
            ["export", sensor, "--c", str(folder), *(["--double"] if precision == "double" else [])]
        ):
            return True
        sources = [
            path for path in sorted(folder.glob("*.c")) if path.name not in ("main.c", "golden_test.c")
        ]
        if precision == "double":
            for name in ("stream.c", "stream.h"):
                shutil.copy(ROOT / "runtime" / "core" / name, folder)
            sources.append(folder / "stream.c")
        subprocess.run(
            ["clang", "-std=c99", "-O1", "-g", "-ffp-contract=off", "-fsanitize=fuzzer,address,undefined",
             "-fno-sanitize-recover=all", f"-I{folder}", "-o", f"{scratch}/fuzz", *sources, HERE / "fuzz_core.c", "-lm"],
            check=True,
        )  # fmt: skip
        command = [f"{scratch}/fuzz", f"-runs={runs}", "-max_len=1024", "-seed=1", "-print_final_stats=1"]
        done = subprocess.run(command, cwd=scratch, capture_output=True, text=True)
    done_runs = re.search(r"number_of_executed_units: (\d+)", done.stderr)
    covered = re.findall(r"cov: (\d+)", done.stderr)
    executed = done_runs.group(1) if done_runs else "?"
    print(
        f"{precision} precision: {executed} inputs, {covered[-1] if covered else '?'} edges covered, "
        f"exit status {done.returncode}",
        flush=True,
    )
    if done.returncode:
        print(done.stderr[-2000:])
    return done.returncode != 0


def checked() -> None:
    """Report what cppcheck says of the core."""
    if shutil.which("cppcheck") is None:
        print("no cppcheck here")
        return
    folder = str(ROOT / "runtime" / "core")
    for title, options in (
        ("cppcheck", ["--enable=warning,style,performance,portability"]),
        ("cppcheck with its MISRA rules", ["--addon=misra"]),
    ):
        done = subprocess.run(
            ["cppcheck", "--std=c99", "--quiet", "--inline-suppr", *options, folder], capture_output=True, text=True
        )  # fmt: skip
        kinds: dict[str, int] = {}
        for name in re.findall(r"\[([\w.-]+)\]$", done.stderr, re.MULTILINE):
            kinds[name] = kinds.get(name, 0) + 1
        listed = ", ".join(
            f"{name} {count}" for name, count in sorted(kinds.items(), key=lambda pair: -pair[1])
        )
        print(f"{title}: {sum(kinds.values())} remarks{': ' + listed if listed else ''}")


if __name__ == "__main__":
    sys.exit(main())
