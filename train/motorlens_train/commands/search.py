"""Find out how large the network should be: by evidence, and by duty cycles not trained on.

example:
  motorlens search --motor mellah2016 --try 8 12-8 16-12 --restarts 2 -o search

The folder holds results.jsonl (one line a training; a search that was killed goes on from it), search.json and search.png.
--scheduler is the address of a Dask cluster; without it, processes on this machine train.
"""

import argparse
import sys
from pathlib import Path

from motorlens_physics.queue import add_queue_arguments
from motorlens_runtime.cli import add_json_argument, write_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--motor", metavar="MOTOR.toml", help="train on simulated duty cycles of this motor")
    parser.add_argument("--recordings", nargs="+", default=[], metavar="REC", help="train on measured runs")
    parser.add_argument("--column", action="append", default=[], metavar="QUANTITY=NAME",
                        help="which column holds a quantity, e.g. speed=wL_rad_s; repeatable")  # fmt: skip
    parser.add_argument("--try", nargs="+", default=["0", "2", "4", "8", "12", "8-4", "12-8", "16-12"], metavar="N-M",
                        dest="structures", help="widths of the hidden layers (default: 0 to 16-12)")  # fmt: skip
    parser.add_argument("--activation", nargs="+", default=["tanh"], metavar="NAME",
                        help="tanh, logistic, linear, rectifier (default: tanh)")  # fmt: skip
    parser.add_argument(
        "--feed-forward", action="store_true", help="try each structure without skips as well"
    )
    parser.add_argument(
        "--restarts", type=int, default=2, metavar="N", help="starts of each structure (default: 2)"
    )
    parser.add_argument(
        "--cycles", type=int, default=60, metavar="N", help="simulated duty cycles (default: 60)"
    )
    parser.add_argument("--rate", type=float, default=1000.0, metavar="HZ", help="of the simulated sensor")
    parser.add_argument("--iterations", type=int, default=80, metavar="N", help="at most (default: 80)")
    add_queue_arguments(parser)
    parser.add_argument("--seed", type=int, default=1, help="of everything random (default: 1)")
    parser.add_argument("-o", "--output", required=True, metavar="DIR", help="folder of the results")
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    from motorlens_physics.queue import queue
    from motorlens_runtime.errors import DataError
    from motorlens_runtime.progress import Progress
    from motorlens_train.activations import activation
    from motorlens_train.commands.parse import hidden_layers
    from motorlens_train.material import from_motor, from_recordings
    from motorlens_train.search import (
        Candidate,
        Result,
        Task,
        answer,
        best_starts,
        comparable,
        document,
        draw,
        restarts,
        search,
    )

    if bool(arguments.motor) == bool(arguments.recordings):
        raise DataError("say what to train on: --motor MOTOR.toml or --recordings REC...")
    structures = [
        Candidate(hidden_layers(text), activation(name).name, skips, 0)
        for text in arguments.structures
        for name in arguments.activation
        for skips in ((True, False) if arguments.feed_forward else (True,))
    ]
    candidates = restarts(structures, arguments.restarts, arguments.seed)
    folder = Path(arguments.output)
    folder.mkdir(parents=True, exist_ok=True)
    with Progress(1.2 * arguments.cycles, "simulating") as progress:
        if arguments.motor:
            material = from_motor(
                Path(arguments.motor), "search", arguments.cycles, arguments.rate, [], arguments.seed, None,
                arguments.iterations, progress.update,
            )  # fmt: skip
        else:
            material = from_recordings(
                arguments.recordings, arguments.column, "search", arguments.seed, None, arguments.iterations
            )
    print(
        f"{'network':24}{'start':>6}{'weights':>9}{'effective':>11}{'log evidence':>14}{'unseen error':>14}",
        file=sys.stderr,
    )

    def show(result: Result, count: int) -> None:
        print(
            f"{result.candidate.label:24}{result.candidate.seed:6}{result.parameters:9}{result.gamma:11.0f}"
            f"{result.log_evidence:14.1f}{100 * result.score:12.2f} %   {count}/{len(candidates)}",
            file=sys.stderr, flush=True,
        )  # fmt: skip

    task = comparable(Task(material.training, material.unseen, material.recipe.settings), candidates)
    with queue(arguments.scheduler, arguments.workers, arguments.memory) as work:
        results = search(task, candidates, folder / "results.jsonl", work, show)
    found = document(results)
    write_json(found, str(folder / "search.json"))
    draw(results, folder / "search.png")
    print("ranked by log evidence (best start of each):")
    for place, result in enumerate(best_starts(results), start=1):
        print(
            f"{place:3}. {result.candidate.label:24} {result.log_evidence:12.1f}  unseen error {100 * result.score:.2f} %"
        )
    print("ranked by unseen duty cycles:")
    for place, result in enumerate(sorted(best_starts(results), key=lambda r: r.score), start=1):
        print(
            f"{place:3}. {result.candidate.label:24} {result.log_evidence:12.1f}  unseen error {100 * result.score:.2f} %"
        )
    print(answer(results))
    write_json(found, arguments.json)
    return 0
