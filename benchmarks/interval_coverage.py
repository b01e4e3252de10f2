"""Coverage of the trainer's 95 % intervals for the function, with white errors and with serially correlated ones.

    python benchmarks/interval_coverage.py            errors white and correlated over 10, 100 and 1000 samples
    python benchmarks/interval_coverage.py --quick    white and 30 samples, few repetitions, under a minute

Inputs and errors are both first-order processes with the same correlation time, the hard case: errors that last look like
function. Each repetition draws a new function, trains on one sequence, and asks how often the true function on held-out
inputs lies within 1.96 standard deviations of the full Laplace posterior, with and without tempering by the score's
autocorrelation time. Half the table has functions of unit variance, half functions as they fall, some no larger than the
noise. Goal: 92 to 98 %.
"""

import argparse
import itertools
import os

os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np
import torch

from motorlens_train.cascade import Architecture
from motorlens_train.posterior import LastLayer, full_variance
from motorlens_train.source import Arrays
from motorlens_train.trainer import Settings, Trained, train

INPUTS = 4


def process(rows: int, columns: int, time: float, rng: np.random.Generator) -> np.ndarray:
    """Independent stationary first-order processes of unit variance; `time` = (1 + rho) / (1 - rho) samples, 1 is white."""
    rho = (time - 1) / (time + 1)
    drive = rng.standard_normal((rows, columns))
    result = np.empty_like(drive)
    result[0] = drive[0]
    for n in range(1, rows):
        result[n] = rho * result[n - 1] + np.sqrt(1 - rho**2) * drive[n]
    return result


def truth(x: np.ndarray, seed: int, unit: bool) -> np.ndarray:
    """A random smooth function of the inputs, one output, of unit variance or of whatever variance it has."""
    rng = np.random.default_rng([seed, 5])
    a, b, c = (
        rng.standard_normal((INPUTS, 4)) / 2,
        rng.standard_normal((4, 1)) / 1.5,
        rng.standard_normal(4) / 2,
    )
    size = np.std(np.tanh(rng.standard_normal((2000, INPUTS)) @ a + c) @ b) if unit else 1.0
    return np.tanh(x @ a + c) @ b / size


def repetition(rows: int, time: float, seed: int, unit: bool) -> list[float]:
    """Coverage in percent: tempered full, tempered last layer, untempered full; tau; error over the noise's deviation."""
    rng = np.random.default_rng([seed, 6])
    x = process(rows, INPUTS, time, rng)
    y = truth(x, seed, unit) + 0.3 * process(rows, 1, time, rng)
    data = Arrays(x, y)
    unseen = rng.standard_normal((2000, INPUTS))
    function = truth(unseen, seed, unit)

    def fitted(series: bool) -> Trained:
        settings = Settings(iterations=150, single=False, time_series=series, tolerance=1e-5)
        starts = (train(data, Architecture(INPUTS, (6,), 1), seed + start, settings) for start in (0, 1000))
        return max(starts, key=lambda trained: trained.evidence.log_evidence)

    def covered(trained: Trained, last: bool) -> float:
        scaled = trained.inputs.scale(torch.from_numpy(unseen))
        if last:
            read = torch.cat([torch.ones(len(scaled), 1), scaled, _hidden(trained, scaled)], dim=1)
            variance = LastLayer.of(trained).variance(read)
        else:
            variance = full_variance(trained.network, trained.evidence.factor, scaled)
        band = 1.96 * variance.sqrt() * trained.targets.deviation
        off = (trained.predict(torch.from_numpy(unseen)).numpy() - function)[:, 0]
        return float(100 * np.mean(np.abs(off) <= band[:, 0].numpy()))

    tempered, plain = fitted(True), fitted(False)
    off = [t.predict(torch.from_numpy(unseen)).numpy() - function for t in (tempered, plain)]
    return [
        covered(tempered, False), covered(tempered, True), covered(plain, False), float(tempered.hyper.tau[0]),
        float(np.sqrt((off[0] ** 2).mean())), float(np.sqrt((off[1] ** 2).mean())),
    ]  # fmt: skip


def _hidden(trained: Trained, scaled: torch.Tensor) -> torch.Tensor:
    from motorlens_train.cascade import dense, forward

    architecture = trained.network.architecture
    z = forward(architecture, dense(architecture, trained.network.hidden), scaled.T)
    return z[architecture.writes(0)].T


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="white and 30 samples, few repetitions, under a minute"
    )
    parser.add_argument("--repetitions", type=int, default=24)
    parser.add_argument("--rows", type=int, default=20_000)
    parser.add_argument(
        "--times", type=float, nargs="+", default=[1, 10, 100, 1000], help="default %(default)s"
    )
    parser.add_argument("--first-seed", type=int, default=100, help="default %(default)s")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    times = [1.0, 30.0] if arguments.quick else arguments.times
    repetitions, rows = (4, 4000) if arguments.quick else (arguments.repetitions, arguments.rows)
    print(f"{rows} samples, {repetitions} repetitions")
    print(
        f"{'functions':>12}{'correlation':>12}{'covers':>13}{'last layer':>12}{'untempered':>12}{'tau':>8}"
        f"{'rms error':>11}{'without':>12}"
    )
    seeds = range(arguments.first_seed, arguments.first_seed + repetitions)
    for unit, time in itertools.product((True, False), times):
        found = np.array([repetition(rows, time, seed, unit) for seed in seeds])
        mean = found.mean(0)
        spread = found[:, 0].std() / np.sqrt(repetitions)
        print(
            f"{'scaled' if unit else 'as they fall':>12}{time:12g}{mean[0]:8.1f}±{spread:3.1f}{mean[1]:12.1f}"
            f"{mean[2]:12.1f}{np.median(found[:, 3]):8.1f}{mean[4]:11.4f}{mean[5]:12.4f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
