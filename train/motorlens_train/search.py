"""Which network: candidates trained side by side, ranked by evidence and by duty cycles that none of them has
seen.

The paper's "program to optimise the number of layers, neurons, epochs and activations" with the evidence as
its first judge: it needs no data of its own. The second judge is the error on unseen cycles; where the two
disagree, both are shown. Each finished training is one line of a file, so a search that was killed goes on
where it stood.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from motorlens_physics.queue import Work
from motorlens_runtime.errors import ModelError
from motorlens_train.cascade import Architecture
from motorlens_train.data import Cycle, arrays
from motorlens_train.specification import Array
from motorlens_train.trainer import Settings, train


@dataclass(frozen=True)
class Candidate:
    """One training: a structure and the seed of its start."""

    hidden: tuple[int, ...]
    activation: str
    skips: bool
    seed: int

    def architecture(self, inputs: int, outputs: int) -> Architecture:
        """The network for given numbers of inputs and outputs."""
        return Architecture(inputs, self.hidden, outputs, self.activation, self.skips)

    @property
    def label(self) -> str:
        """The structure in short, without the seed."""
        widths = "-".join(map(str, self.hidden)) or "linear"
        return f"{widths} {self.activation}{'' if self.skips else ' feed-forward'}" if self.hidden else widths


@dataclass(frozen=True)
class Result:
    """What one training gave; `unseen` is the root mean square error of each output as a share of its deviation."""

    candidate: Candidate
    parameters: int
    gamma: float
    log_evidence: float
    unseen: tuple[float, ...]
    iterations: int

    @property
    def score(self) -> float:
        """Mean of the unseen errors over the outputs."""
        return float(np.mean(self.unseen))


@dataclass(frozen=True)
class Task:
    """What all candidates are trained and tested on. Without unseen cycles each training cycle is left out in turn."""

    training: tuple[Cycle, ...]
    unseen: tuple[Cycle, ...]
    settings: Settings


def evaluate(candidate: Candidate, task: Task) -> Result:
    """Train one candidate and test it."""
    torch.set_num_threads(1)
    first = task.training[0]
    architecture = candidate.architecture(first.x.shape[1], first.y.shape[1])
    trained = train(arrays(task.training), architecture, candidate.seed, task.settings)

    def squares(found: Callable[[torch.Tensor], torch.Tensor], cycles: Sequence[Cycle]) -> Array:
        return np.concatenate([(found(torch.from_numpy(c.x)).numpy() - c.y) ** 2 for c in cycles])

    if task.unseen:
        off = squares(trained.predict, task.unseen)
    else:
        parts = []
        for left_out in task.training:
            others = [c for c in task.training if c is not left_out] or [left_out]
            parts.append(
                squares(
                    train(arrays(others), architecture, candidate.seed, task.settings).predict, [left_out]
                )
            )
        off = np.concatenate(parts)
    unseen = np.sqrt(off.mean(0)) / trained.targets.deviation.numpy()
    return Result(
        candidate,
        architecture.parameters,
        float(trained.evidence.gamma.sum()),
        trained.evidence.log_evidence,
        tuple(float(share) for share in unseen),
        len(trained.history),
    )


def comparable(task: Task, candidates: Sequence[Candidate]) -> Task:
    """The task with one autocorrelation time for all candidates, found by the largest: evidences compare only then."""
    if not task.settings.time_series:
        return task
    first = task.training[0]
    structures = [c.architecture(first.x.shape[1], first.y.shape[1]) for c in candidates]
    largest = max(structures, key=lambda a: a.parameters)
    pilot = train(arrays(task.training), largest, candidates[0].seed, task.settings)
    return replace(task, settings=replace(task.settings, time_series=False, tau=float(pilot.hyper.tau.max())))


def search(
    task: Task, candidates: Sequence[Candidate], log: Path, work: Work, done: Callable[[Result, int], None]
) -> list[Result]:
    """Train all candidates that the log does not hold yet.

    Args:
        task: the data.
        candidates: what to try.
        log: file of finished trainings, one JSON line each; read first, appended to.
        work: trains them, see `queue`.
        done: told each result, and how many of all there are.

    Raises:
        ModelError: candidates that could not be trained, after all others.
    """
    finished = {result.candidate: result for result in read_log(log)}
    if log.exists() and not log.read_text(encoding="utf-8").endswith("\n"):
        with log.open("a", encoding="utf-8") as file:
            file.write("\n")
    results = [finished[c] for c in candidates if c in finished]
    waiting = [c for c in candidates if c not in finished]
    for count, result in enumerate(results, start=1):
        done(result, count)
    failed = []
    for outcome in work(evaluate, waiting, task):
        if outcome.value is None:
            failed.append(f"{waiting[outcome.number].label}: {outcome.failure}")
            continue
        results.append(outcome.value)
        with log.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(outcome.value)) + "\n")
        done(outcome.value, len(results))
    if failed:
        raise ModelError("; ".join(failed))
    return results


def read_log(log: Path) -> list[Result]:
    """Finished trainings; a last line torn by a kill is left out."""
    results: list[Result] = []
    for line in log.read_text(encoding="utf-8").splitlines() if log.exists() else []:
        try:
            entry = json.loads(line)
        except json.JSONDecodeError:
            continue
        own = entry.pop("candidate")
        candidate = Candidate(tuple(own["hidden"]), own["activation"], own["skips"], own["seed"])
        results.append(Result(candidate=candidate, **(entry | {"unseen": tuple(entry["unseen"])})))
    return results


def best_starts(results: Sequence[Result]) -> list[Result]:
    """The start with the highest evidence of each structure, highest evidence first."""
    best: dict[str, Result] = {}
    for result in results:
        held = best.get(result.candidate.label)
        if held is None or result.log_evidence > held.log_evidence:
            best[result.candidate.label] = result
    return sorted(best.values(), key=lambda r: -r.log_evidence)


def answer(results: Sequence[Result]) -> str:
    """How large the network should be, in one sentence with its margin."""
    ranked = best_starts(results)
    first = ranked[0]
    unseen = min(ranked, key=lambda r: r.score)
    smallest = min((r for r in ranked if r.score <= 1.05 * unseen.score), key=lambda r: r.parameters)
    sentence = f"The evidence prefers {first.candidate.label} ({first.parameters} weights, {first.gamma:.0f} effective)"
    if len(ranked) > 1:
        margin = first.log_evidence - ranked[1].log_evidence
        sentence += f" by {margin:.1f} nats over {ranked[1].candidate.label}"
    share = f"{100 * unseen.score:.2f} % of the targets' deviation"
    if unseen is first:
        sentence += f", and so do the unseen duty cycles (error {share})"
    else:
        sentence += f"; unseen duty cycles prefer {unseen.candidate.label} ({share}, against {100 * first.score:.2f} %)"
    return sentence + f"; the smallest within 5 % of the best is {smallest.candidate.label}."


def document(results: Sequence[Result]) -> dict[str, Any]:
    """All results as plain data."""
    rows = [asdict(result) | {"label": result.candidate.label, "score": result.score} for result in results]
    return {"schema": "motorlens.search/1", "answer": answer(results), "candidates": rows}


def draw(results: Sequence[Result], path: Path) -> None:
    """Evidence and unseen error against the number of weights: every start a point, the best start of each named."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    ranked = best_starts(results)

    def evidence(result: Result) -> float:
        return result.log_evidence

    def error(result: Result) -> float:
        return 100 * result.score

    for axes, value in ((upper, evidence), (lower, error)):
        axes.plot([r.parameters for r in results], [value(r) for r in results], "o", color="0.75")
        for result in ranked:
            point = (result.parameters, value(result))
            axes.plot(*point, "o", color="tab:blue" if result.candidate.skips else "tab:orange")
            axes.annotate(
                result.candidate.label, point, fontsize=7, xytext=(3, 3), textcoords="offset points"
            )
        axes.grid(alpha=0.3)
    upper.set_ylabel("log evidence")
    lower.set_ylabel("error on unseen duty cycles\n% of the targets' deviation")
    lower.set_yscale("log")
    lower.set_xlabel("weights")
    upper.set_title(answer(results), fontsize=8, wrap=True)
    figure.savefig(path, dpi=120)


def restarts(candidates: Sequence[Candidate], count: int, seed: int) -> list[Candidate]:
    """Every structure with `count` starts."""
    return [replace(candidate, seed=seed + start) for start in range(count) for candidate in candidates]
