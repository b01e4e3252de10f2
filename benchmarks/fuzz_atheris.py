"""The subjects of `fuzz.py` under atheris, the coverage-guided fuzzer of libFuzzer for Python.

    python benchmarks/fuzz_atheris.py [--quick] [--inputs N] [--seed N]

Each subject runs in a process of its own, for libFuzzer does not return. Exit status 1 if any input fails.
"""

import argparse
import importlib.util
import re
import subprocess
import sys
import tempfile
from pathlib import Path

SUBJECTS = ("frames", "text", "vesc", "roboclaw", "binary", "binary, no checksum")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="20 000 inputs instead of a million")
    parser.add_argument("--inputs", type=int)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--subject", choices=SUBJECTS, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    total = arguments.inputs or (20_000 if arguments.quick else 1_000_000)
    if importlib.util.find_spec("atheris") is None:
        print("atheris is not here (pip install atheris); skipped")
        return 0
    if arguments.subject:
        with tempfile.TemporaryDirectory() as folder:
            fuzz_one(arguments.subject, total, arguments.seed, Path(folder))
    failures = 0
    for subject in SUBJECTS:
        each = total // len(SUBJECTS)
        command = [
            sys.executable,
            __file__,
            "--subject",
            subject,
            "--inputs",
            str(each),
            "--seed",
            str(arguments.seed),
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        ran = re.search(r"Done (\d+) runs in (\d+) second", done.stderr)
        covered = re.findall(r"ft: (\d+) corp: (\d+)", done.stderr)
        if done.returncode or ran is None:
            failures += 1
            print(f"{subject}: FAILED\n{done.stderr[-3000:]}")
            continue
        features, corpus = covered[-1] if covered else ("?", "?")
        print(
            f"{subject:22} {ran[1]:>9} inputs in {ran[2]:>4} s, {features} features, corpus of {corpus}",
            flush=True,
        )
    print(f"{failures} of {len(SUBJECTS)} subjects failed")
    return 1 if failures else 0


def fuzz_one(subject: str, inputs: int, seed: int, folder: Path) -> None:
    """Run libFuzzer on one subject; it ends the process."""
    import atheris

    sys.path.insert(0, str(Path(__file__).parent))
    with atheris.instrument_imports(include=["motorlens_runtime"]):
        import fuzz

        # Dialects are imported when one is made, and must be while imports are instrumented.
        make, corpus = fuzz.subjects(folder)[subject]
    seeds = folder / "corpus"
    seeds.mkdir()
    for number, data in enumerate(corpus):
        (seeds / str(number)).write_bytes(b"\x00\x00" + data)

    def one_input(data: bytes) -> None:
        """The first two bytes say where the rest is cut."""
        cuts = sorted(min(cut * 4, max(len(data) - 2, 0)) for cut in data[:2])
        fuzz.feed(make(), data[2:], cuts)

    options = [f"-runs={inputs}", f"-seed={seed}", "-max_len=2000", f"-artifact_prefix={folder}/", str(seeds)]
    atheris.Setup([sys.argv[0], *options], one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    sys.exit(main())
