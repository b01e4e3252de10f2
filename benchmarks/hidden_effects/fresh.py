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

    Raises:
        ValueError: the row does not say which commit answered.
    """
    if "commit" not in answered:
        raise ValueError(f"{answered['id']}: which commit answered is not known")
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
