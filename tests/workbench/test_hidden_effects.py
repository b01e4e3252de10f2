"""The blind benchmark in small: short cases that `motorlens diagnose` was not tuned on, and the seal of the plans.

The plan of the subset has its own seed; the truth of its 60 cases (sizes are costly to find) is kept beside the benchmark.
"""

import hashlib
import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from helpers.hidden import draw, generate, generate_again, truth_of
from helpers.hidden import score as scoring

from motorlens_runtime.cli import main

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
KEY = BENCHMARKS / "hidden_effects" / "subset-key.jsonl"

# Of the sixty run three short ones and, marked long, a pair and others: of every fifth those whose effect is strong enough
# to be asked for, and one with nothing missing. All of them:
# `python benchmarks/hidden_effects.py run --split subset --n 60 --small`. The project's goals are in the benchmark's table.
SHORT = ("subset-0004", "subset-0006", "subset-0052")
LONGER = ("subset-0003", "subset-0032")
SHARE = 5
# What is amiss with the answers to these, by case, as last measured. A case that gets worse fails, and so does one that gets
# better: then its line goes.
AMISS = {"subset-0055": ["missed", "another name first"]}


def _truths() -> list[dict[str, Any]]:
    return [json.loads(line) for line in KEY.read_text(encoding="utf-8").splitlines()]


def _short() -> list[dict[str, Any]]:
    return [truth for truth in _truths() if _name(truth) in SHORT]


def _few() -> list[dict[str, Any]]:
    few = _truths()[::SHARE]
    nothing = next(truth for truth in few if truth["kind"] == "none")
    return [truth for truth in few if truth is nothing or scoring.strong((truth, None, 0.0))]


def _diagnosed(truth: dict[str, Any], directory: Path) -> scoring.Row:
    """One case as a user would have it: files in, JSON out."""
    made = generate_again(truth, directory)
    answer = directory / "diagnosis.json"
    status = main(["diagnose", *map(str, made.recordings), "--motor", str(made.motor), "--json", str(answer)])
    return truth, json.loads(answer.read_text(encoding="utf-8")) if status == 0 else None, 0.0


def _amiss(row: scoring.Row) -> list[str]:
    """What is wrong with an answer, in words; empty if nothing is."""
    truth, answer, _ = row
    strong, kind = scoring.strong(row), truth["kind"]
    first = scoring.named_first(answer)
    faults = {
        "no answer": answer is None,
        "false alarm": kind == "none" and scoring.detected(answer),
        "wrong name with confidence": scoring.wrong_name(row),
        "missed": strong and not scoring.detected(answer),
        "another name first": kind == "single" and strong and scoring.separable(row) and first != truth["hidden"][0]["name"],
        "a name though in no catalogue": kind == "outside" and strong and (answer or {}).get("verdict") != "unknown",
        "a decoy named": scoring.mentions_decoy(row),
    }  # fmt: skip
    return [words for words, true in faults.items() if true]


def _benchmark() -> ModuleType:
    return _module("hidden_effects_benchmark", BENCHMARKS / "hidden_effects.py")


def _module(name: str, path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def _fresh() -> ModuleType:
    return _module("fresh_cases", BENCHMARKS / "hidden_effects" / "fresh.py")


def test_the_plans_are_those_that_were_sealed() -> None:
    sealed = dict(
        line.split()[::-1]
        for line in (BENCHMARKS / "hidden_effects" / "keys.sha256").read_text().splitlines()
    )
    benchmark = _benchmark()
    assert {split for split, _, _ in benchmark.SEALED} == {"dev", "test", "subset"}
    for split, n, small in benchmark.SEALED:
        name = f"plan-{split}-{n}{'-small' if small else ''}"
        assert hashlib.sha256(benchmark.plan_text(split, n, small).encode()).hexdigest() == sealed[name], name


@pytest.mark.fit
def test_the_key_is_that_of_the_subset(tmp_path: Path) -> None:
    truths = _truths()
    cases = draw("subset", 60, small=True)
    assert [truth["case"]["seed"] for truth in truths] == [case.seed for case in cases]
    number = next(k for k, case in enumerate(cases) if case.kind == "single" and case.records == "fast")
    made = generate(cases[number], tmp_path)
    assert made.truth["hidden"][0]["size"] == pytest.approx(truths[number]["hidden"][0]["size"], rel=1e-3)


@pytest.mark.parametrize(
    ("count", "names"),
    [
        (800, ("dev-0061", "dev-0420", "dev-0633")),
        (2400, ("dev-1794",)),
        (
            3600,
            (
                "dev-0171",
                "dev-0189",
                "dev-0238",
                "dev-3206",
                "dev-3246",
                "dev-3305",
                "dev-3306",
                "dev-3416",
                "dev-3438",
                "dev-3486",
                "dev-3492",
                "dev-3531",
                "dev-3554",
            ),
        ),
        (4200, ("dev-0084",)),
    ],
)
def test_the_cases_of_other_tests_are_those_of_the_plan(count: int, names: tuple[str, ...]) -> None:
    """Sized up as the one above was."""
    plan = {case.id: case for case in draw("dev", count, small=True)}
    for name in names:
        truth = truth_of(name)
        assert truth["case"]["seed"] == plan[name].seed
        assert tuple(map(tuple, truth["case"]["hidden"])) == plan[name].hidden


def _name(truth: dict[str, Any]) -> str:
    return str(truth["case"]["id"])


@pytest.mark.blind
@pytest.mark.parametrize(
    "truth",
    [
        *(pytest.param(truth, id=_name(truth)) for truth in _short()),
        *(
            pytest.param(truth, id=_name(truth), marks=pytest.mark.long)
            for truth in _truths()
            if _name(truth) in LONGER or truth in _few()
        ),
    ],
)
def test_a_case_never_tuned_on_is_answered_no_worse_and_no_better_than_is_written_here(
    truth: dict[str, Any], tmp_path: Path
) -> None:
    row = _diagnosed(truth, tmp_path)
    verdict = {key: (row[1] or {}).get(key) for key in ("verdict", "chosen")}
    assert _amiss(row) == AMISS.get(_name(truth), []), f"{verdict}"
    # What is kept of an answer scores as all of it does.
    answered = {"id": _name(truth), "answer": row[1], "seconds": row[2], "commit": "0" * 7}
    again = _fresh().rows([json.loads(json.dumps(_fresh().short(truth, answered)))])
    assert scoring.summary(again) == scoring.summary([row]) and scoring.strata(again) == scoring.strata([row])
    assert scoring.failing(again[0]) == scoring.failing(row)


def test_of_a_case_that_was_answered_twice_the_first_answer_is_kept() -> None:
    fresh, truths = _fresh(), _truths()[:3]
    first, second = (
        [
            fresh.short(truth, {"id": "", "answer": None, "seconds": seconds, "commit": "a"})
            for truth in truths
        ]
        for seconds in (1.0, 2.0)
    )
    assert fresh.together(first[:2], second) == [*first[:2], second[2]]


@pytest.mark.parametrize(
    ("row", "said"),
    [
        (None, "answers.jsonl: not there"),
        ({"id": "subset-0003", "commit": "a"}, "subset-0003: the subset is known"),
        ({"id": "dev-0001"}, "dev-0001: no commit holds the code"),
        ({"id": "dev-0001", "commit": "a-dirty"}, "dev-0001: no commit holds the code"),
    ],
)
def test_what_is_not_fresh_or_of_unknown_code_is_not_kept(
    tmp_path: Path, row: dict[str, str] | None, said: str
) -> None:
    fresh = _fresh()
    before = fresh.FILE.read_bytes()
    if row:
        (tmp_path / "answers.jsonl").write_text(json.dumps(row) + "\n")
    with pytest.raises(SystemExit, match=said):
        fresh.keep(tmp_path)
    assert fresh.FILE.read_bytes() == before


def test_no_case_is_kept_twice_nor_one_that_the_code_was_tuned_on() -> None:
    kept = _fresh().read()
    seeds = [one["truth"]["case"]["seed"] for one in kept]
    assert len(set(seeds)) == len(seeds) and not set(seeds) & {truth["case"]["seed"] for truth in _truths()}
    assert all(one["commit"] and not one["commit"].endswith("dirty") for one in kept)


def test_the_short_ones_are_one_of_each_kind_and_a_pair_is_a_longer_one() -> None:
    rows = [(truth, None, 0.0) for truth in _short()]
    strong = [row[0]["kind"] for row in rows if scoring.strong(row)]
    assert sorted(strong) == ["outside", "single"]
    assert [row[0]["kind"] for row in rows if row[0]["kind"] not in strong] == ["none"]
    longer = [(truth, None, 0.0) for truth in _truths() if _name(truth) in LONGER]
    assert "pair" in [row[0]["kind"] for row in longer if scoring.strong(row)]


def test_the_few_hold_every_kind_of_case() -> None:
    rows = [(truth, None, 0.0) for truth in _few()]
    strong = [row for row in rows if scoring.strong(row)]
    fair = [row for row in strong if row[0]["kind"] == "single" and scoring.separable(row)]
    assert len(strong) >= 6 and len(fair) >= 3
    assert any(row[0]["kind"] == "outside" for row in strong) and any(
        row[0]["kind"] == "none" for row in rows
    )
    assert set(AMISS) <= {_name(row[0]) for row in rows}


def test_wilson_interval_of_published_example() -> None:
    """Newcombe (1998), Statistics in Medicine 17, 857-872, table I: 81 of 263 gives 0.2553 to 0.3662."""
    low, high = scoring.Rate(81, 263).interval()
    assert (round(low, 4), round(high, 4)) == (0.2553, 0.3662)


def test_scoring_knows_right_from_wrong() -> None:
    """A clairvoyant scores full marks; one that always says the same scores none."""
    truths = _truths()

    def clairvoyant(truth: dict[str, Any]) -> dict[str, Any]:
        hidden = truth["hidden"]
        if truth["kind"] == "outside":
            return {"verdict": "unknown", "chosen": [], "equation": hidden[0]["equation"]}
        names = [effect["name"] for effect in hidden]
        return {
            "verdict": "named" if names else "adequate",
            "chosen": names,
            "candidates": [
                {
                    "name": e["name"],
                    "probability": 1.0,
                    "parameters": {e["parameter"]: {"value": e["size"], "sd": 1e-9}},
                }
                for e in hidden
            ],
        }

    perfect = scoring.summary([(truth, clairvoyant(truth), 1.0) for truth in truths])
    for what, goal, measured in perfect:
        if goal.startswith(">="):
            assert measured.startswith("100.0 %"), what
        if goal.startswith("<=") and "%" in goal:
            assert measured.lstrip().startswith("0.0 %"), what
    stubborn = {"verdict": "named", "chosen": ["quadratic_drag"], "equation": "mechanical"}
    table = {
        what: measured for what, _, measured in scoring.summary([(truth, stubborn, 1.0) for truth in truths])
    }
    assert table["nothing missing: false alarm"].startswith("100.0 %")
    assert table["outside the catalogue: unknown"].lstrip().startswith("0.0 %")
    wrong = table["wrong name with confidence, all cases"]
    assert float(wrong.split("%")[0]) > 90


def test_the_calibration_error_that_chance_makes_is_that_of_drawn_answers() -> None:
    rng = np.random.default_rng(3)
    stated = np.concatenate([rng.uniform(0.2, 1.0, 25), np.full(15, 0.99)])
    right = rng.random((4000, len(stated))) < stated
    measured = [scoring.calibration_error(stated, one.astype(float)) for one in right]
    drawn, foretold = np.mean([error for error, _ in measured]), measured[0][1]
    assert drawn == pytest.approx(foretold, rel=0.02)
    assert scoring.calibration_error(stated, np.zeros(len(stated)))[0] == pytest.approx(np.mean(stated))
