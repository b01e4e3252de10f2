"""The blind benchmark of `motorlens diagnose`: recordings with a hidden effect, whose key is opened after the diagnosis.

    python benchmarks/hidden_effects.py seal                                   prints the hashes of the plans
    python benchmarks/hidden_effects.py generate --split dev --n 400 -o DIR    recordings, and the key in DIR/key
    python benchmarks/hidden_effects.py run --split dev --n 400 -o DIR         generates, diagnoses and deletes, resumable
    python benchmarks/hidden_effects.py baselines --split dev --n 400 -o DIR   PySINDy in three ways, AICc, whiteness
    python benchmarks/hidden_effects.py resolve DIR                         diagnoses again with the experiments proposed
    python benchmarks/hidden_effects.py score DIR                              opens the key, prints the rates
    python benchmarks/hidden_effects.py keep DIR                               keeps the answers to cases that are new
    python benchmarks/hidden_effects.py fresh                                  prints the rates of all that are kept

The plan of a split follows from its seed; its SHA-256 was committed in hidden_effects/keys.sha256 before the diagnosing code
was tuned. dev is for tuning; test is run once per release. `--small` draws another plan with short records (20 s at
500 Hz, 1 to 3 h at 1 Hz) for tuning in minutes.
"""

import argparse
import hashlib
import importlib.util
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
# Not this folder itself: its files bear names that libraries look for.
sys.path = [
    str(HERE.parent / "tests"),
    str(HERE / "hidden_effects"),
    *(p for p in sys.path if Path(p).resolve() != HERE),
]

from helpers.hidden import Case, Generated, draw, generate, generate_again, generate_experiment  # noqa: E402
from helpers.hidden.experiments import TESTS  # noqa: E402
from helpers.hidden.score import Rate, Row, failing, strata, strong, summary  # noqa: E402
from helpers.hidden.world import CHANNEL_SETS, HEADINGS  # noqa: E402

from motorlens_physics.queue import queue  # noqa: E402

# Of the sensors' offsets, as motor files have them.
UNITS = {"voltage": "V", "current": "A", "speed": "rad/s", "temperature": "K", "load_torque": "N*m"}
SEALED = (("dev", 400, False), ("dev", 200, True), ("test", 1200, False), ("subset", 60, True))


def plan_text(split: str, n: int, small: bool) -> str:
    """The plan of a split, one case a line."""
    return "".join(json.dumps(case.as_json(), sort_keys=True) + "\n" for case in draw(split, n, small))


def seal() -> str:
    """The lines of keys.sha256: the hash of every plan, and that of the generator's source at the time."""
    lines = []
    for split, n, small in SEALED:
        name = f"plan-{split}-{n}{'-small' if small else ''}"
        lines.append(f"{hashlib.sha256(plan_text(split, n, small).encode()).hexdigest()}  {name}")
    return "\n".join(lines) + "\n"


def source_hash() -> str:
    """SHA-256 over the generator's files, in order of name."""
    digest = hashlib.sha256()
    for path in sorted((HERE.parent / "tests" / "helpers" / "hidden").glob("*.py")):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


def command(paths: Iterable[Path], motor: Path, answer: Path) -> list[str]:
    """The diagnosis as a user calls it."""
    words = [*map(str, paths), "--motor", str(motor), "--json", str(answer)]
    return [str(Path(sys.executable).with_name("motorlens")), "diagnose", *words]


def prepared(case: Case, directory: Path, place: Path) -> Generated:
    """The recordings of a case in `place`; its truth goes to (or comes from) `directory`/key, unread until `score`."""
    key = directory / "key" / f"{case.id}.json"
    if key.exists():
        return generate_again(json.loads(key.read_text(encoding="utf-8")), place)
    made = generate(case, place)
    key.parent.mkdir(exist_ok=True)
    key.write_text(json.dumps(made.truth), encoding="utf-8")
    return made


def one(case: Case, out: str, keep: bool, limit_s: float) -> dict[str, Any]:
    """Generate a case, diagnose it as a user would, and return the answer."""
    directory = Path(out)
    with tempfile.TemporaryDirectory(prefix="hidden-") as scratch:
        place = directory / case.id if keep else Path(scratch)
        made = prepared(case, directory, place)
        answer = place / "diagnosis.json"
        start, spent = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        row: dict[str, Any] = {"id": case.id}
        try:
            done = subprocess.run(
                command(made.recordings, made.motor, answer), capture_output=True, text=True, timeout=limit_s,
                env=environment, check=False,
            )  # fmt: skip
            row |= {"status": done.returncode, "stderr": done.stderr[-2000:] if done.returncode else ""}
            row["answer"] = _slim(json.loads(answer.read_text(encoding="utf-8"))) if answer.exists() else None
        except subprocess.TimeoutExpired:
            row |= {"status": -1, "stderr": f"no answer within {limit_s:.0f} s", "answer": None}
        row["seconds"] = time.monotonic() - start
        row["cpu_seconds"] = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - spent
    return row


def _slim(answer: dict[str, Any]) -> dict[str, Any]:
    """The answer without its curves, which fill the disk."""
    shape = answer.get("unknown_shape")
    if isinstance(shape, dict):
        answer["unknown_shape"] = {key: value for key, value in shape.items() if not isinstance(value, list)}
    return answer


def instead(case: Case, out: str) -> dict[str, Any]:
    """What each of the usual methods says of a case."""
    import aicc
    import sindy
    import whiteness

    directory = Path(out)
    answers: dict[str, Any] = {}
    with tempfile.TemporaryDirectory(prefix="hidden-") as scratch:
        made = prepared(case, directory, Path(scratch))
        for name, method in (
            ("pysindy", lambda: sindy.sindy(made.recordings, made.motor, weak=False)),
            ("pysindy weak", lambda: sindy.sindy(made.recordings, made.motor, weak=True)),
            (
                "pysindy ensemble",
                lambda: sindy.sindy(made.recordings, made.motor, weak=True, keep=sindy.kept_by_most),
            ),
            ("AICc forward", lambda: aicc.forward(made.recordings, made.motor)),
            ("whiteness", lambda: whiteness.whiteness(made.recordings, made.motor)),
        ):
            start = time.monotonic()
            answers[name] = {"answer": method(), "seconds": time.monotonic() - start}
    return {"id": case.id, "answers": answers}


def run_baselines(arguments: argparse.Namespace) -> None:
    """The usual methods on the same recordings; answers are appended as they come."""
    directory = Path(arguments.output)
    file_name = directory / "baselines.jsonl"
    directory.mkdir(parents=True, exist_ok=True)
    done = {row["id"] for row in read_lines(file_name)}
    cases = [case for case in chosen(arguments) if case.id not in done]
    with file_name.open("a", encoding="utf-8") as file:
        for number, row in enumerate(in_parallel(instead, cases, arguments, str(directory)), 1):
            file.write(json.dumps(row) + "\n")
            file.flush()
            print(f"{number}/{len(cases)} {row['id']}", file=sys.stderr)


def run(arguments: argparse.Namespace) -> None:
    """Diagnose the cases that have no answer yet; answers are appended as they come."""
    if arguments.split == "test" and not arguments.open_test:
        raise SystemExit("the test split is run once per release: add --open-test")
    directory = Path(arguments.output)
    directory.mkdir(parents=True, exist_ok=True)
    answers = directory / "answers.jsonl"
    done = {row["id"] for row in read_lines(answers)}
    cases = [case for case in chosen(arguments) if case.id not in done]
    begun, by = time.monotonic(), {"commit": commit()}
    with answers.open("a", encoding="utf-8") as file:
        for number, row in enumerate(
            in_parallel(one, cases, arguments, str(directory), arguments.keep, arguments.limit), 1
        ):
            file.write(json.dumps(row | by) + "\n")
            file.flush()
            left = (time.monotonic() - begun) / number * (len(cases) - number)
            verdict = (row["answer"] or {}).get("verdict", "failed")
            print(
                f"{number}/{len(cases)} {row['id']} {verdict} {row['seconds']:.0f} s, {left / 60:.0f} min left",
                file=sys.stderr,
            )


def commit() -> str:
    """The commit that is checked out here, and whether files differ from it."""
    words = ["git", "describe", "--always", "--dirty", "--exclude=*"]
    return subprocess.run(words, cwd=HERE, capture_output=True, text=True, check=True).stdout.strip()


def print_fresh() -> None:
    """The table of rates of all fresh cases that are kept."""
    import fresh

    found = fresh.read()
    if not found:
        raise SystemExit(f"{fresh.FILE}: no case is kept yet; `run` some that are new, and `keep` them")
    commits = list(dict.fromkeys(one["commit"] for one in found))
    print(f"{len(found)} fresh cases, each answered once, at {', '.join(commits)}\n")
    compare({"diagnose": fresh.rows(found)})
    spent = [one["cpu_seconds"] for one in found if "cpu_seconds" in one]
    print(f"processor seconds a diagnosis: median {statistics.median(spent):.0f}, most {max(spent):.0f}")


def in_parallel(
    work: Callable[..., dict[str, Any]], cases: list[Case], arguments: argparse.Namespace, *rest: Any
) -> Iterator[dict[str, Any]]:
    """Results of work(case, *rest) as they come, on `--jobs` processes or `--scheduler`."""
    # What workers import by name.
    # Before what is there: the code that is measured may be another than the one that is installed.
    there = [os.environ["PYTHONPATH"]] if "PYTHONPATH" in os.environ else []
    os.environ["PYTHONPATH"] = os.pathsep.join(
        [str(HERE.parent / "tests"), str(HERE / "hidden_effects"), *there]
    )
    here = arguments.jobs == 1 and arguments.scheduler is None
    with queue(arguments.scheduler, 0 if here else arguments.jobs) as run_on:
        for done in run_on(work, cases, *rest):
            lost = {
                "id": cases[done.number].id,
                "status": -1,
                "stderr": done.failure,
                "answer": None,
                "seconds": 0.0,
            }
            yield lost | {"answers": {}} if done.value is None else done.value


def read_lines(path: Path) -> list[dict[str, Any]]:
    """The rows of a file of JSON lines; none if it is not there."""
    return (
        [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []
    )


def chosen(arguments: argparse.Namespace) -> list[Case]:
    """The cases that the command line asks for."""
    cases = draw(arguments.split, arguments.n, arguments.small)
    if arguments.only:
        known = {case.id: case for case in cases}
        if strange := [one for one in arguments.only if one not in known]:
            raise SystemExit(f"--only {strange[0]}: no such case; there are {cases[0].id} to {cases[-1].id}")
        cases = [known[one] for one in arguments.only]
    return cases[:: arguments.every]


def resolve_one(name: str, out: str, limit_s: float) -> dict[str, Any]:
    """Do what an answer proposed, a test or a look at reference instruments, and diagnose again with what it brought."""
    directory = Path(out)
    truth = json.loads((directory / "key" / f"{name}.json").read_text(encoding="utf-8"))
    answer = next(row["answer"] for row in read_lines(directory / "answers.jsonl") if row["id"] == name)
    proposed = answer["separating_experiment"]
    row: dict[str, Any] = {"id": name, "proposed": proposed, "answer": None}
    with tempfile.TemporaryDirectory(prefix="hidden-") as scratch:
        place = Path(scratch)
        made = generate_again(truth, place)
        recordings = list(made.recordings)
        if proposed["test"]:
            recordings.append(performed(truth, proposed, place))
        else:
            hold_right(truth, proposed["separates"], made.motor)
        told = place / "diagnosis.json"
        environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        words = command(recordings, made.motor, told)
        try:
            done = subprocess.run(
                words, capture_output=True, text=True, timeout=limit_s, env=environment, check=False
            )
            row["stderr"] = done.stderr[-1000:] if done.returncode else ""
        except subprocess.TimeoutExpired:
            row["stderr"] = f"no answer within {limit_s:.0f} s"
        if told.exists():
            row["answer"] = _slim(json.loads(told.read_text(encoding="utf-8")))
    return row


def performed(truth: dict[str, Any], proposed: dict[str, Any], place: Path) -> Path:
    """The recording of a proposed test: of the sensors that the case has, one more, or without the torque's."""
    kept = {*CHANNEL_SETS[truth["case"]["channels"]], proposed.get("with_sensor", "")}
    kept -= {"load_torque"} if proposed.get("bare") else set()
    fully = {**truth, "case": {**truth["case"], "channels": "all"}}
    path = generate_experiment(fully, proposed["test"], float(proposed.get("seconds") or 60.0), place)
    lines = [line.split(",") for line in path.read_text(encoding="utf-8").splitlines()]
    off = {HEADINGS[channel] for channel in CHANNEL_SETS["all"] if channel not in kept}
    off |= {"ambient_C"} if "temperature" not in kept else set()
    off |= {"angle_rad"} if "speed" not in kept else set()
    if proposed.get("bare"):
        load = lines[0].index(HEADINGS["load_torque"])
        lines[1:] = [[*line[:load], "0", *line[load + 1 :]] for line in lines[1:]]
        off.remove(HEADINGS["load_torque"])
    at = [k for k, name in enumerate(lines[0]) if name not in off]
    path.write_text("".join(",".join(line[k] for k in at) + "\n" for line in lines), encoding="utf-8")
    return path


def hold_right(truth: dict[str, Any], group: Iterable[str], motor: Path) -> None:
    """Write into a motor file what a reference instrument shows: which faults of the group the sensors do not have."""
    wrong = {effect["name"] for effect in truth["hidden"]}
    with motor.open("a", encoding="utf-8") as file:
        for name in group:
            parameter, null, unit = {
                "gain": ("gain", 1.0, "1"),
                "offset": ("offset", 0.0, UNITS.get(name.partition("_sensor_")[0], "1")),
                "lag": ("tau", 0.0, "s"),
            }.get(name.rpartition("_")[2], ("", 0.0, ""))
            if "_sensor_" in name and name not in wrong:
                file.write(
                    f"\n[sensors.{name}]\n{parameter} = {{ value = {null}, "
                    f'unit = "{unit}", sd = 0.0, source = "measured by a reference" }}\n'
                )


def resolve(arguments: argparse.Namespace) -> None:
    """Do what the answers that gave a group proposed."""
    directory = Path(arguments.directory)
    out = directory / "resolved.jsonl"
    done = {row["id"] for row in read_lines(out)}
    wanted = []
    for row in read_lines(directory / "answers.jsonl"):
        answer = row["answer"] or {}
        proposed = answer.get("separating_experiment") or {}
        if (proposed.get("test") in TESTS or proposed.get("check")) and row["id"] not in done:
            wanted.append(row["id"])
    with out.open("a", encoding="utf-8") as file:
        for number, name in enumerate(wanted, 1):
            row = resolve_one(name, str(directory), arguments.limit)
            file.write(json.dumps(row) + "\n")
            file.flush()
            proposed, answer = row["proposed"], row["answer"] or {}
            print(
                f"{number}/{len(wanted)} {name} {proposed['test'] or 'reference'} "
                f"{', '.join(proposed['separates'])} -> {answer.get('verdict')} {answer.get('groups')}",
                file=sys.stderr,
            )


def resolved_rates(directory: Path) -> list[tuple[str, str]]:
    """What became of the groups that hold what was hidden: it must stand alone, and the others be gone."""
    rows = read_lines(directory / "resolved.jsonl")
    hits: dict[bool, list[bool]] = {True: [], False: []}
    silent, empty = 0, 0
    for row in read_lines(directory / "answers.jsonl"):
        proposed = (row["answer"] or {}).get("separating_experiment")
        if proposed is None:
            continue
        truth = json.loads((directory / "key" / f"{row['id']}.json").read_text(encoding="utf-8"))
        group = set(proposed["separates"])
        right = {effect["name"] for effect in truth["hidden"] if not effect["outside"]} & group
        done = next((other["answer"] or {} for other in rows if other["id"] == row["id"]), None)
        if not right:
            empty += 1
        elif done is None:
            silent += 1
        else:
            groups = [set(given) for given in done.get("groups") or []]
            parts = [set(part) for part in proposed.get("parts") or [] if len(proposed["parts"]) > 1]
            # What a run was said to leave together may be.
            left = {name: next((part for part in parts if name in part), {name}) for name in right}
            alone = all(any(name in given <= left[name] for given in groups) for name in right)
            hits[bool(proposed["test"])].append(
                alone and set().union(*groups) & group <= set().union(*left.values())
            )
    return [
        (
            "a run is proposed: it leaves the truth alone, or with what it said",
            str(Rate(sum(hits[True]), len(hits[True]))),
        ),
        (
            "a reference is asked for: it leaves the truth alone",
            str(Rate(sum(hits[False]), len(hits[False]))),
        ),
        ("nothing is proposed, or not done yet", str(silent)),
        ("the truth is in no such group", str(empty)),
    ]


def opened(directory: Path) -> dict[str, list[Row]]:
    """Truth, answer and seconds of every case answered, by method."""

    def truth(name: str) -> dict[str, Any]:
        return dict(json.loads((directory / "key" / f"{name}.json").read_text(encoding="utf-8")))

    methods: dict[str, list[Row]] = {"diagnose": []}
    for row in read_lines(directory / "answers.jsonl"):
        methods["diagnose"].append((truth(row["id"]), row["answer"], row["seconds"]))
    for row in read_lines(directory / "baselines.jsonl"):
        for name, told in row["answers"].items():
            methods.setdefault(name, []).append((truth(row["id"]), told["answer"], told["seconds"]))
    return methods


def print_score(arguments: argparse.Namespace) -> None:
    """The table of rates, the strata, and what failed."""
    directory = Path(arguments.directory)
    methods = opened(directory)
    rows = methods["diagnose"]
    compare(methods)
    if len(methods) > 1:
        import sindy

        # The same recordings for all: those with a speed, and nothing hidden that PySINDy has no term for.
        answered = set.intersection(*({row[0]["case"]["id"] for row in own} for own in methods.values()))
        fair = {
            row[0]["case"]["id"]
            for row in rows
            if row[0]["case"]["channels"] != "voltage_current"
            and not any(effect["name"] in sindy.BEYOND for effect in row[0]["hidden"])
        }
        print(f"{len(answered & fair)} recordings that every method can be asked about:\n")
        compare({
            name: [row for row in own if row[0]["case"]["id"] in answered & fair] for name, own in methods.items()
        })  # fmt: skip
        print(f"whiteness with the threshold that the key would set: {with_the_key(methods['whiteness'])}")
    spent = [row["cpu_seconds"] for row in read_lines(directory / "answers.jsonl") if "cpu_seconds" in row]
    if spent:
        print(f"processor seconds a diagnosis: median {statistics.median(spent):.0f}, most {max(spent):.0f}")
    print()
    table(("groups (goal >= 90 %)", "measured"), resolved_rates(directory))
    if arguments.strata:
        table(("stratum", "wrong name", "false alarm", "detected", "right first", "in group"), strata(rows))
    if arguments.failures:
        Path(arguments.failures).write_text(failures(directory, rows), encoding="utf-8")


def compare(methods: dict[str, list[Row]]) -> None:
    """Print what `summary` says of each method side by side."""
    columns = [summary(own) for own in methods.values()]
    table(
        ("what", "goal", *methods),
        ((*columns[0][k][:2], *(column[k][2] for column in columns)) for k in range(len(columns[0]))),
    )


def with_the_key(rows: list[Row]) -> str:
    """The detection of a statistic whose threshold is the largest value that nothing missing reaches."""
    clean = max((row[1]["statistic"] for row in rows if row[0]["kind"] == "none" and row[1]), default=0.0)
    hits = [(row[1] or {}).get("statistic", 0.0) > clean for row in rows if strong(row)]
    return f"detection {Rate(sum(hits), len(hits))} at {clean:.0f} times what white noise has"


def failures(directory: Path, rows: list[Row]) -> str:
    """The cases that went wrong, as Markdown, each with the words to see it again."""
    lines = ["| case | wrong | hidden | answer | strata |", "| --- | --- | --- | --- | --- |"]
    for truth, answer, seconds in rows:
        said = failing((truth, answer, seconds))
        if not said:
            continue
        case = truth["case"]
        hid = "; ".join(
            f"{e['name']} {e['factor']:g}x = {e['size']:.3g} (energy {e['energy']:.0f}, twins {e['group'][:4]})"
            for e in truth["hidden"]
        )
        told = (
            "none"
            if answer is None
            else f"{answer.get('verdict')} {answer.get('chosen')} groups {answer.get('groups')} in {answer.get('equation')}"
        )
        kept = " ".join(
            str(case[name]) for name in ("motor", "records", "excitation", "channels", "noise", "noise_kind")
        )
        lines.append(f"| {case['id']} | {', '.join(said)} | {hid or 'nothing'} | {told} | {kept} |")
    return (
        "\n".join(lines)
        + f"\n\n{len(lines) - 2} of {len(rows)}; files with --only ID to `generate`; answers in {directory}\n"
    )


def table(head: tuple[str, ...], lines: Iterable[tuple[str, ...]]) -> None:
    """Print a Markdown table."""
    print("| " + " | ".join(head) + " |\n|" + " --- |" * len(head))
    for line in lines:
        print("| " + " | ".join(line) + " |")
    print()


def make(arguments: argparse.Namespace) -> None:
    """Write recordings and the key."""
    directory = Path(arguments.output)
    directory.mkdir(parents=True, exist_ok=True)
    for case in chosen(arguments):
        made = prepared(case, directory, directory / case.id)
        print(case.id, *(path.name for path in made.recordings), file=sys.stderr)


def bench(quick: bool) -> None:
    """What `make bench` shows: the 60 short cases (12 with --quick), and PySINDy on them where it is installed."""
    with tempfile.TemporaryDirectory(prefix="hidden-") as out:
        (Path(out) / "key").mkdir()
        for truth in read_lines(HERE / "hidden_effects" / "subset-key.jsonl"):
            (Path(out) / "key" / f"{truth['case']['id']}.json").write_text(
                json.dumps(truth), encoding="utf-8"
            )
        arguments = argparse.Namespace(
            split="subset", n=60, small=True, only=None, every=5 if quick else 1, output=out, jobs=2, scheduler=None,
            limit=300.0, keep=False, open_test=False, directory=out, strata=not quick, failures=None,
        )  # fmt: skip
        run(arguments)
        if importlib.util.find_spec("pysindy"):
            run_baselines(arguments)
        print_score(arguments)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="without an action: 12 short cases, not 60")
    actions = parser.add_subparsers(dest="action")
    actions.add_parser("seal")
    for name in ("generate", "run", "baselines"):
        action = actions.add_parser(name)
        action.add_argument("--split", choices=("dev", "test", "subset"), default="dev")
        action.add_argument("--n", type=int, default=400)
        action.add_argument("--small", action="store_true", help="short records")
        action.add_argument("--only", nargs="*", help="ids of cases")
        action.add_argument("--every", type=int, default=1, help="every k-th case only")
        action.add_argument("-o", "--output", required=True)
        if name != "generate":
            action.add_argument("--jobs", type=int, default=1, help="processes on this machine")
            action.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="a Dask cluster that is there")
            action.add_argument("--limit", type=float, default=300.0, help="seconds a diagnosis may take")
            action.add_argument("--keep", action="store_true", help="keep the recordings")
            action.add_argument("--open-test", action="store_true")
    action = actions.add_parser("score")
    action.add_argument("directory")
    action.add_argument("--strata", action="store_true", help="a line a stratum as well")
    action.add_argument("--failures", help="write the failing cases to this Markdown file")
    actions.add_parser("keep").add_argument("directory")
    actions.add_parser("fresh")
    action = actions.add_parser("resolve")
    action.add_argument("directory")
    action.add_argument("--limit", type=float, default=300.0, help="seconds a diagnosis may take")
    arguments = parser.parse_args()
    if arguments.action is None:
        bench(arguments.quick)
    if arguments.action == "seal":
        print(seal(), end="")
        print(f"{source_hash()}  generator")
    elif arguments.action == "generate":
        make(arguments)
    elif arguments.action == "run":
        run(arguments)
    elif arguments.action == "baselines":
        run_baselines(arguments)
    elif arguments.action == "resolve":
        resolve(arguments)
    elif arguments.action == "score":
        print_score(arguments)
    elif arguments.action == "keep":
        import fresh

        print(fresh.keep(Path(arguments.directory)))
    elif arguments.action == "fresh":
        print_fresh()


if __name__ == "__main__":
    main()
