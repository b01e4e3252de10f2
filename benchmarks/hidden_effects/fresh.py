"""Fresh blind cases that were answered, each once: kept, so that rates are of more of them than one day holds.

A line a case: what was hidden, and of the answer what `score` asks for, with the commit that gave it. The first answer to a
case is the one that counts: whoever has seen it may have learnt from it.
"""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from helpers.hidden.score import Row, Truth, named_first

FILE = Path(__file__).with_name("fresh.jsonl")
# What `score` asks of an answer, and of each candidate.
TOLD, OF_CANDIDATE = (
    ("verdict", "chosen", "groups", "equation", "error"),
    ("name", "probability", "parameters"),
)


def short(truth: Truth, answered: dict[str, Any]) -> dict[str, Any]:
    """One case in as few words as give the same score.

    Args:
        truth: what was hidden.
        answered: a row of `answers.jsonl`.
    """
    answer = answered["answer"]
    if answer is not None:
        wanted = {named_first(answer), *(effect["name"] for effect in truth["hidden"])}
        candidates = answer.get("candidates") or []
        answer = {key: answer.get(key) for key in TOLD} | {
            "candidates": [
                {key: one.get(key) for key in OF_CANDIDATE}
                for k, one in enumerate(candidates)
                if k == 0 or one["name"] in wanted or "decoy" in one["name"]
            ]
        }
    hidden = [{key: value for key, value in effect.items() if key != "rivals"} for effect in truth["hidden"]]
    told = {key: answered[key] for key in ("commit", "seconds", "cpu_seconds") if key in answered}
    return {
        "truth": {"case": truth["case"], "kind": truth["kind"], "hidden": hidden},
        "answer": answer,
    } | told


def together(there: Sequence[dict[str, Any]], more: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """What is there, and of more the cases that are not: the same seed is the same case."""
    seeds = {one["truth"]["case"]["seed"] for one in there}
    return [*there, *(one for one in more if one["truth"]["case"]["seed"] not in seeds)]


def rows(cases: Iterable[dict[str, Any]]) -> list[Row]:
    """As `score` takes them."""
    return [(one["truth"], one["answer"], one["seconds"]) for one in cases]


def read() -> list[dict[str, Any]]:
    """What is kept; nothing if nothing is."""
    return [json.loads(line) for line in FILE.read_text("utf-8").splitlines()] if FILE.exists() else []


def write(cases: Iterable[dict[str, Any]]) -> None:
    """Keep these, and no others."""
    FILE.write_text("".join(json.dumps(one) + "\n" for one in cases), "utf-8")


def keep(directory: Path) -> str:
    """Add the answers in a directory of `run`; what was done, in words.

    Raises:
        SystemExit: there are none, they are not of fresh cases, or it is not known what code answered.
    """
    answers = directory / "answers.jsonl"
    if not answers.exists():
        raise SystemExit(f"{answers}: not there; `run ... -o {directory}` writes it")
    answered = [json.loads(line) for line in answers.read_text("utf-8").splitlines()]
    for row in answered:
        if row["id"].startswith("subset"):
            raise SystemExit(
                f"{row['id']}: the subset is known to whoever works here; only fresh cases are kept"
            )
        if "commit" not in row or row["commit"].endswith("-dirty"):
            raise SystemExit(f"{row['id']}: no commit holds the code that answered; commit first, then `run`")
    truths = (json.loads((directory / "key" / f"{row['id']}.json").read_text("utf-8")) for row in answered)
    there = read()
    both = together(there, map(short, truths, answered))
    write(both)
    return f"{len(both) - len(there)} of {len(answered)} cases are new; {len(both)} are kept in {FILE}"
