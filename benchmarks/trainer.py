"""The trainer against its peers: processor time to the same held-out error on the same data, and peak memory.

    python benchmarks/trainer.py            every size, every peer that is installed (an hour or two)
    python benchmarks/trainer.py --quick    ten thousand samples, the nearest rivals, under a minute

Task: 16 inputs, 3 outputs, a smooth function plus white noise of variance 0.01, cascade 16-12-8-3 with tanh units
(scikit-learn and pyrenn, which have no cascades, train a plain network of the same widths; R's brnn one network of ten units
an output). The level to reach is 1 % above the held-out error at which this project's trainer ends; times are medians over
the starts. Each peer runs alone in its own process on one thread, with its defaults where it has any; measuring the held-out
error is not counted. Peers: make .venv/bench; and R with the package brnn.
"""

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from training.peers import PEERS, brnn
from training.task import HIDDEN, INPUTS, OUTPUTS, Report, data


def motorlens(x: np.ndarray, y: np.ndarray, report: Report, start: int, correlation: float) -> None:
    from motorlens_train.cascade import Architecture
    from motorlens_train.source import Arrays
    from motorlens_train.trainer import Settings, train

    judging = 0.0

    class Unseen(Arrays):
        """Held-out rows that measure how long the trainer works on them: the judge's time, not the trainer's."""

        def blocks(self, rows: int):  # type: ignore[no-untyped-def]
            nonlocal judging
            before = time.process_time()
            yield from super().blocks(rows)
            judging += time.process_time() - before

    started = time.process_time()
    deviation: list[float] = []

    def tell(record) -> None:  # type: ignore[no-untyped-def]
        spent = time.process_time() - started - judging
        if not deviation:
            # The trainer scales targets by a sample's deviation; to undo it the same sample is drawn.
            sample = Arrays(x, y).sample(65536, np.random.default_rng([start, 0]))[1]
            deviation.extend(sample.double().numpy().std(0))
        mse = float(np.mean(np.square(np.array(record.validation) * deviation)))
        report(lambda _: np.array(mse), spent)

    unseen = Unseen(*data(10_000, 2, correlation))
    architecture, settings = Architecture(INPUTS, HIDDEN, OUTPUTS), Settings(patience=1000)
    train(Arrays(x, y), architecture, start, settings, validation=unseen, report=tell)


# Peers that hold the Jacobian of all samples at once.
WHOLE_JACOBIAN = ("scipy least_squares", "trainbr (emulated)", "pyrenn", "optimistix", "R brnn")
RIVALS = ("torch L-BFGS", "torch-levenberg-marquardt")


def child(peer: str, folder: str, correlation: float, start: int) -> None:
    """Run one peer and print a line of JSON after each of its iterations: processor time, held-out error, memory."""
    import torch

    torch.set_num_threads(1)
    x, y = (
        np.load(Path(folder) / f"{name}.npy", mmap_mode="r" if peer == "motorlens" else "c") for name in "xy"
    )
    unseen, truth = data(10_000, 2, correlation)
    peak = [0.0]
    threading.Thread(target=watch, args=(peak,), daemon=True).start()
    spent = 0.0
    started = time.process_time()

    def report(predict: Callable[[np.ndarray], np.ndarray], seconds: float | None = None) -> None:
        nonlocal spent
        before = time.process_time()
        value = predict(unseen)
        mse = float(value) if value.ndim == 0 else float(np.mean((value - truth) ** 2))
        print(
            json.dumps([before - started - spent if seconds is None else seconds, mse, peak[0]]), flush=True
        )
        spent += time.process_time() - before

    if peer == "motorlens":
        motorlens(x, y, report, start, correlation)
    elif peer == "R brnn":
        brnn(x, y, report, start, correlation)
    else:
        PEERS[peer](x, y, report, start)


def watch(peak: list[float]) -> None:
    """Keep the largest size in GB of this process and its children, without the pages of mapped files, which the system may
    drop at will.
    """
    own = os.getpid()
    while True:
        children = Path(f"/proc/{own}/task/{own}/children").read_text(encoding="ascii").split()
        size = 0
        for process in (own, *children):
            with contextlib.suppress(OSError):
                status = Path(f"/proc/{process}/status").read_text(encoding="ascii")
                size += int((status.partition("RssAnon:")[2].split() or ["0"])[0])
        peak[0] = max(peak[0], size / 1e6)
        time.sleep(0.02)


def race(
    peer: str, folder: str, budget_s: float, level: float, correlation: float, start: int
) -> tuple[list[list[float]], str]:
    """Its reports until it reaches the level or its processor time is used up, and why there are none."""
    process = subprocess.Popen(
        [sys.executable, "-W", "ignore", __file__, "--child", peer, folder, str(correlation), str(start)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    reports: list[list[float]] = []

    def stop() -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)

    limit = threading.Timer(10 * budget_s + 20, stop)
    limit.start()
    assert process.stdout is not None and process.stderr is not None
    for line in process.stdout:
        if line.startswith("["):
            reports.append(json.loads(line))
            if reports[-1][0] > budget_s or reports[-1][1] <= level:
                break
    stop()
    limit.cancel()
    complaint = process.stderr.read().strip().splitlines()
    process.wait()
    return reports, complaint[-1][:90] if complaint and not reports else ""


def compare(rows: int, peers: tuple[str, ...], budget_s: float, correlation: float, starts: int) -> str:
    """Print one table; returns how many times longer the best peer takes, in words."""
    with tempfile.TemporaryDirectory() as folder:
        write(rows, Path(folder), correlation)
        inputs = f"inputs correlated {correlation:g}" if correlation else "independent inputs"
        print(
            f"\n{f'{rows} samples, {inputs}':40}{'s to the level':>14}{'best error':>12}{'in s':>8}{'memory GB':>11}"
        )
        seeds = range(1, starts + 1)
        own = [race("motorlens", folder, 20 * budget_s, 0.0, correlation, seed) for seed in seeds]
        if not all(reports for reports, _ in own):
            raise SystemExit(own[0][1])
        level = 1.01 * float(np.median([min(mse for _, mse, _ in reports) for reports, _ in own]))
        mine = row("motorlens", [reports for reports, _ in own], level)
        best = float("inf")
        for peer in peers:
            needed = 8e-9 * rows * OUTPUTS * 547
            if peer in WHOLE_JACOBIAN and needed > 2:
                print(f"{peer:40}  skipped: its Jacobian alone takes {needed:.0f} GB")
                continue
            found = [race(peer, folder, budget_s, level, correlation, seed) for seed in seeds]
            if not all(reports for reports, _ in found):
                print(
                    f"{peer:40}  skipped: {found[0][1] or f'no iteration within {10 * budget_s + 20:g} s of time'}"
                )
                continue
            best = min(best, row(peer, [reports for reports, _ in found], level))
        if peers:
            shown = f"{best / mine:.1f} times as long" if best < float("inf") else f"over {budget_s:g} s"
            print(f"level {level:.5f}; the best peer takes {shown}")
    return f"{best / mine:.1f}" if best < float("inf") else f"over {budget_s / mine:.1f}"


def row(peer: str, runs: list[list[list[float]]], level: float) -> float:
    """Print one line of the table: medians over the starts; returns the seconds to the level."""
    never = float("inf")
    at = float(np.median([next((s for s, mse, _ in reports if mse <= level), never) for reports in runs]))
    lowest = [min(reports, key=lambda r: r[1]) for reports in runs]
    seconds, mse = (float(np.median([one[place] for one in lowest])) for place in (0, 1))
    longest = max(one[0] for reports in runs for one in reports)
    memory = max(one[2] for reports in runs for one in reports)
    shown = f"{at:.2f}" if at < never else f"not in {longest:.0f}"
    print(f"{peer:40}{shown:>14}{mse:12.5f}{seconds:8.1f}{memory:11.2f}", flush=True)
    return at


def write(rows: int, folder: Path, correlation: float) -> None:
    """The data on disk, made in pieces so that their size does not depend on this machine's memory."""
    x = np.lib.format.open_memmap(folder / "x.npy", "w+", np.float32, (rows, INPUTS))
    y = np.lib.format.open_memmap(folder / "y.npy", "w+", np.float32, (rows, OUTPUTS))
    for piece, first in enumerate(range(0, rows, 100_000)):
        part = slice(first, min(first + 100_000, rows))
        x[part], y[part] = data(part.stop - first, 1000 + piece, correlation)


def paper() -> None:
    """The paper's own protocol: iterations and seconds to its training error, on a network of the shipped sensor's size."""
    from motorlens_physics.motor_file import read_motor_file
    from motorlens_train.build import Recipe
    from motorlens_train.material import OUTPUTS as promised
    from motorlens_train.material import bank_of, noise_of
    from motorlens_train.paper import PAPER_ERROR, paper_run
    from motorlens_train.specification import Rate

    file = read_motor_file(Path(__file__).parents[1] / "models" / "motors" / "mellah2016.toml")
    recipe = Recipe("paper", bank_of(file), promised, HIDDEN, Rate(100.0, 20.0, 200.0), 0.0, 1)
    started = time.process_time()
    found = paper_run(file, recipe, noise_of(file, ()), 1)
    spent = time.process_time() - started
    print(
        f"\nthe paper's run and split: its training error of {PAPER_ERROR:g} (2000 epochs there) after {found.iterations} "
        f"iterations, {found.training_error:.2g} in the end; {spent:.1f} s with simulation, features and the test"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="ten thousand samples, the nearest rivals, under a minute"
    )
    parser.add_argument(
        "--sizes", type=float, nargs="+", default=[1e4, 1e5, 1e6, 1e7], help="numbers of samples"
    )
    parser.add_argument(
        "--budget", type=float, default=60.0, help="processor seconds for each peer at 10^4 (default: 60)"
    )
    parser.add_argument(
        "--correlation", type=float, nargs="+", default=[0.0, 0.9], help="of neighbouring inputs"
    )
    parser.add_argument(
        "--starts", type=int, default=3, help="starts at 10^4 and 10^5; one beyond (default: 3)"
    )
    parser.add_argument("--peers", nargs="*", choices=tuple(PEERS), help="only these peers (default: all)")
    parser.add_argument("--child", nargs=4, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        peer, folder, correlation, start = arguments.child
        child(peer, folder, float(correlation), int(start))
        return
    sizes, budget = [int(size) for size in arguments.sizes], arguments.budget
    peers = tuple(PEERS) if arguments.peers is None else tuple(arguments.peers)
    correlations, starts = arguments.correlation, arguments.starts
    if arguments.quick:
        sizes, peers, budget, starts = [10_000], RIVALS, 5.0, 1
    paper()
    ratios = []
    for rows in sizes:
        for correlation in correlations:
            # Beyond a million samples only this trainer runs: no peer reads data that do not fit into memory.
            chosen = peers if rows <= 1_000_000 else ()
            allowed = budget * max(1.0, np.log10(rows) - 3)
            ratio = compare(rows, chosen, allowed, correlation, starts if rows <= 100_000 else 1)
            if chosen:
                ratios.append(f"{ratio} at {rows}{f' correlated {correlation:g}' if correlation else ''}")
    if ratios:
        print(f"time of the best peer over motorlens' time: {', '.join(ratios)}")


if __name__ == "__main__":
    main()
