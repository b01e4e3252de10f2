"""The architecture search: resumed after a kill, ranked by both judges, and answered in one sentence."""

import json
from pathlib import Path

import numpy as np
import pytest

from motorlens_physics.queue import here, queue
from motorlens_runtime.errors import DataError
from motorlens_train.commands.parse import hidden_layers
from motorlens_train.data import Cycle
from motorlens_train.search import (
    Candidate,
    Result,
    Task,
    answer,
    best_starts,
    draw,
    read_log,
    restarts,
    search,
)
from motorlens_train.trainer import Settings


def made_cycle(seed: int) -> Cycle:
    """A target that three tanh units represent and a linear model does not."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((250, 2))
    y = np.tanh(2 * x[:, :1]) + np.tanh(x[:, 1:] - x[:, :1]) + 0.05 * rng.standard_normal((250, 1))
    return Cycle("made", np.arange(250.0), x, y, (0.0, 1.0), (0.0, 1.0), 250)


TASK = Task(tuple(map(made_cycle, (1, 2))), (made_cycle(3),), Settings(iterations=40, single=False))
CANDIDATES = restarts([Candidate(hidden, "tanh", True, 0) for hidden in ((), (3,))], 2, 1)


@pytest.mark.fit
def test_killed_search_goes_on_and_finds_the_network_that_is_needed(tmp_path: Path) -> None:
    log, seen = tmp_path / "results.jsonl", []

    def killed_after_two(result: Result, count: int) -> None:
        seen.append(result)
        if count == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), queue(workers=2) as work:
        search(TASK, CANDIDATES, log, work, killed_after_two)
    with log.open("a", encoding="utf-8") as file:
        file.write('{"candidate": {"hid')  # torn by the kill
    held = read_log(log)
    assert [r.candidate for r in held] == [r.candidate for r in seen] and len(held) == 2
    counts: list[int] = []
    # This process goes on where two others were.
    results = search(TASK, CANDIDATES, log, here, lambda result, count: counts.append(count))
    assert counts == [1, 2, 3, 4] and {r.candidate for r in results} == set(CANDIDATES)
    assert {r.candidate for r in read_log(log)} == set(CANDIDATES), (
        "the torn line must not swallow the next one"
    )
    ranked = best_starts(results)
    assert [r.candidate.label for r in ranked] == ["3 tanh", "linear"]
    assert ranked[0].log_evidence > ranked[1].log_evidence + 100 and ranked[0].score < 0.2 * ranked[1].score
    sentence = answer(results)
    assert sentence.startswith("The evidence prefers 3 tanh") and "nats over linear" in sentence
    draw(results, tmp_path / "search.png")
    assert (tmp_path / "search.png").stat().st_size > 10_000


@pytest.mark.fit
def test_without_unseen_cycles_each_is_left_out_in_turn(tmp_path: Path) -> None:
    task = Task(TASK.training, (), TASK.settings)
    (result,) = search(
        task, [Candidate((), "tanh", True, 1)], tmp_path / "log.jsonl", here, lambda r, c: None
    )
    by_hand = []
    for train_on, test_on in ((0, 1), (1, 0)):
        a, b = TASK.training[train_on], TASK.training[test_on]
        design = np.column_stack([np.ones(len(a.x)), a.x])
        w = np.linalg.lstsq(design, a.y, rcond=None)[0]
        by_hand.append((np.column_stack([np.ones(len(b.x)), b.x]) @ w - b.y) ** 2)
    everything = np.concatenate([c.y for c in TASK.training])
    assert result.unseen[0] == pytest.approx(np.sqrt(np.mean(by_hand)) / everything.std(), rel=0.01)
    assert json.loads((tmp_path / "log.jsonl").read_text(encoding="utf-8"))["parameters"] == 3


@pytest.mark.parametrize(("text", "widths"), [("12-8", (12, 8)), ("0", ()), ("5", (5,))])
def test_widths(text: str, widths: tuple[int, ...]) -> None:
    assert hidden_layers(text) == widths


@pytest.mark.parametrize("text", ["12-x", "", "4-0", "400-400"])
def test_wrong_widths_are_refused(text: str) -> None:
    with pytest.raises(DataError, match="--hidden"):
        hidden_layers(text)
