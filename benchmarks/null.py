"""How large the largest hypothesis gets where nothing is missing, and what a model leaves: see `criteria.py`.

    python benchmarks/null.py --count 200 --seed 1

Worlds of the hidden-effect simulator (another plant, other code), small recordings, nothing hidden; motor, noise,
converter, excitation and channels drawn as in the blind benchmark. Printed are the quantiles of the weight of the heaviest
hypothesis with a name, as it was fitted in full (also at a size that it cannot have), and without one, over the weight that
is needed, and the largest by factor; and of the error over the noise, and of the likelihood that colour left in the noise
wins.
The file is appended to, and a world that is in it is not computed again. Some 6 s of processor time a world.
"""

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path = [str(HERE.parent / "tests"), *(p for p in sys.path if Path(p).resolve() != HERE)]

from helpers.hidden import Case, draw, generate  # noqa: E402
from helpers.hidden.score import Rate  # noqa: E402

from motorlens_physics.motor_file import read_motor_file  # noqa: E402
from motorlens_physics.recording import read_recording  # noqa: E402
from motorlens_workbench.contest.needed import needed_without_a_name  # noqa: E402
from motorlens_workbench.diagnose import diagnose  # noqa: E402
from motorlens_workbench.verdict import settle  # noqa: E402

LEVELS = (0.5, 0.9, 0.95, 0.99, 1.0)


def worlds(count: int, seed: int) -> Iterator[Case]:
    """Cases of the blind benchmark with nothing hidden, each with a seed of its own; the plan depends on the count."""
    rng = np.random.default_rng(seed)
    for number, case in enumerate(draw("dev", max(count, 1), small=True)):
        yield replace(
            case,
            id=f"null-{count}-{seed}-{number:04d}",
            kind="none",
            hidden=(),
            seed=int(rng.integers(1 << 62)),
        )


def largest(case: Case) -> dict[str, Any]:
    """The excess of the heaviest hypothesis with a name and without one."""
    began = time.process_time()
    with tempfile.TemporaryDirectory() as place:
        made = generate(case, Path(place))
        file = read_motor_file(made.motor)
        found = diagnose(file, [read_recording(path) for path in made.recordings])
    here = found.outcome.first
    row: dict[str, Any] = {
        "id": case.id, "noise": case.noise_kind, "excitation": case.excitation, "channels": case.channels,
        "records": case.records, "late": sorted({c for run in found.runs for c in run.late}),
    }  # fmt: skip
    row["verdict"] = settle(found).kind
    row["times_noise"] = round(here.times_noise, 3)
    row["colour"] = round(here.book.colour, 2)
    row["named"] = [{"name": name, "needed": round(times, 4)} for name, times in found.outcome.judged.items()]
    row["unnamed"] = [
        {
            "name": one.name,
            "excess": round(float(here.null.excess(one.weight)), 2),
            "share": round(float(2 * one.weight / one.colour), 5) if one.colour > 0 else None,
            "needed": round(float(one.weight / needed_without_a_name(here, (), one.colour)), 4),
        }
        for one in here.challengers
        if here.null is not None and not one.named
    ]
    return row | {"seconds": round(time.process_time() - began, 2)}


def table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Quantiles, and the largest by factor."""
    yield f"{len(rows)} worlds with nothing missing, {np.median([row['seconds'] for row in rows]):.1f} s each"
    yield "weight of the heaviest, with a name as fitted in full, as a multiple of what is needed"
    yield f"{'quantile':>20s} " + " ".join(f"{level:8.0%}" for level in LEVELS)
    for word in ("named", "unnamed"):
        largest = np.array([max((one["needed"] for one in row[word]), default=0.0) for row in rows])
        told = " ".join(f"{q:8.2f}" for q in np.quantile(largest, LEVELS))
        yield f"{word:>20s} {told}   above 1: {np.sum(largest > 1)}"
    for word, left in (("error over noise", "times_noise"), ("colour left", "colour")):
        told = " ".join(f"{q:8.2f}" for q in np.quantile([row[left] for row in rows], LEVELS))
        yield f"{word:>20s} {told}"
    verdicts = Counter(row["verdict"] for row in rows)
    yield "verdicts: " + ", ".join(f"{word} {count}" for word, count in verdicts.most_common())
    yield f"something said to be missing: {Rate(len(rows) - verdicts['adequate'], len(rows))}"
    for factor in ("noise", "excitation", "channels", "records"):
        for value in sorted({row[factor] for row in rows}):
            mine = [row for row in rows if row[factor] == value]
            tops = [_heaviest(mine, word) for word in ("named", "unnamed")]
            told = "   ".join(f"{top['needed']:6.2f} {top['name'].replace('_', ' '):30s}" for top in tops)
            yield f"{factor:>12s} {value:16s} {len(mine):4d} {told}"


def _heaviest(rows: list[dict[str, Any]], word: str) -> dict[str, Any]:
    nothing = {"name": "", "needed": 0.0}
    return max((one for row in rows for one in row[word]), key=lambda one: one["needed"], default=nothing)


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/null.jsonl"))
    args = parser.parse_args()
    rows = [json.loads(line) for line in args.output.read_text().splitlines()] if args.output.exists() else []
    done = {row["id"] for row in rows}
    args.output.parent.mkdir(parents=True, exist_ok=True)
    for case in worlds(args.count, args.seed):
        if case.id in done:
            continue
        row = largest(case)
        rows.append(row)
        with args.output.open("a") as file:
            file.write(json.dumps(row) + "\n")
        print(f"{len(rows)}/{args.count} {case.id}", end="\r", file=sys.stderr, flush=True)
    print("\n".join(table([row for row in rows if row["id"].startswith(f"null-{args.count}-{args.seed}-")])))
    return 0


if __name__ == "__main__":
    sys.exit(main())
