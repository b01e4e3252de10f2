"""The trainer against its peers: processor time to the same held-out error on the same data, and peak memory.

    python benchmarks/trainer.py            every size, every peer that is installed (an hour or two)
    python benchmarks/trainer.py --quick    ten thousand samples, the nearest rivals, under a minute

Task: 16 inputs, 3 outputs, a smooth function plus white noise of variance 0.01, cascade 16-12-8-3 with tanh units
(scikit-learn and pyrenn, which have no cascades, train a plain network of the same widths). The level to reach is 1 % above
the held-out error at which this project's trainer ends. Each peer runs alone in its own process on one thread, with its
defaults where it has any. Peers: pip install torch-levenberg-marquardt pytorch-lightning scikit-learn pyrenn.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np

INPUTS, OUTPUTS, HIDDEN = 16, 3, (12, 8)
Report = Callable[[Callable[[np.ndarray], np.ndarray]], None]


def data(rows: int, seed: int, correlation: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Inputs of unit variance and noisy targets, float32; `correlation` is that of neighbouring inputs."""
    teacher = np.random.default_rng(99)
    a, b, c = (
        teacher.standard_normal(shape) / size for shape, size in (((16, 10), 4), ((10, 3), 3), ((16, 3), 6))
    )
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((rows, INPUTS)).astype(np.float32)
    f = np.tanh(x @ a) @ b + 0.5 * np.sin(x @ c)
    place = np.arange(INPUTS)
    mixed = x @ np.linalg.cholesky(correlation ** np.abs(place[:, None] - place)).T
    return mixed.astype(np.float32), (f + 0.1 * rng.standard_normal(f.shape)).astype(np.float32)


def motorlens(x: np.ndarray, y: np.ndarray, report: Report, correlation: float) -> None:
    from motorlens_train.cascade import Architecture
    from motorlens_train.source import Arrays
    from motorlens_train.trainer import Settings, train

    unseen = data(10_000, 2, correlation)
    deviation: list[float] = []

    def tell(record) -> None:  # type: ignore[no-untyped-def]
        if not deviation:
            # The trainer scales targets by a sample's deviation; to undo it the same sample is drawn.
            deviation.extend(
                Arrays(x, y).sample(65536, np.random.default_rng([1, 0]))[1].double().numpy().std(0)
            )
        mse = float(np.mean(np.square(np.array(record.validation) * deviation)))
        report(lambda _: np.array(mse))

    settings = Settings(patience=1000)
    train(
        Arrays(x, y),
        Architecture(INPUTS, HIDDEN, OUTPUTS),
        1,
        settings,
        validation=Arrays(*unseen),
        report=tell,
    )


def module():  # type: ignore[no-untyped-def]
    """The cascade as a torch module."""
    import torch

    class Cascade(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            reads = INPUTS
            self.layers = torch.nn.ModuleList()
            for width in HIDDEN:
                self.layers.append(torch.nn.Linear(reads, width))
                reads += width
            self.out = torch.nn.Linear(reads, OUTPUTS)

        def forward(self, z):  # type: ignore[no-untyped-def]
            for layer in self.layers:
                z = torch.cat([z, torch.tanh(layer(z))], dim=-1)
            return self.out(z)

    torch.manual_seed(1)
    return Cascade()


def _torch(model, report: Report) -> None:  # type: ignore[no-untyped-def]
    import torch

    with torch.no_grad():
        report(lambda x: model(torch.from_numpy(x)).numpy())


def torch_lbfgs(x: np.ndarray, y: np.ndarray, report: Report) -> None:
    import torch

    model, tx, ty = module(), torch.from_numpy(x), torch.from_numpy(y)
    optimiser = torch.optim.LBFGS(
        model.parameters(), max_iter=20, history_size=50, line_search_fn="strong_wolfe"
    )

    def closure():  # type: ignore[no-untyped-def]
        optimiser.zero_grad()
        loss = sum(
            ((model(a) - b) ** 2).sum() for a, b in zip(tx.split(65536), ty.split(65536), strict=True)
        ) / len(tx)
        loss.backward()
        return loss

    while True:
        optimiser.step(closure)
        _torch(model, report)


def torch_adam(x: np.ndarray, y: np.ndarray, report: Report) -> None:
    import torch

    model, tx, ty = module(), torch.from_numpy(x), torch.from_numpy(y)
    optimiser = torch.optim.Adam(model.parameters(), lr=3e-3)
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimiser, 0.98)
    while True:
        for part in torch.randperm(len(tx)).split(256)[: 20_000 // 256 + 1]:
            optimiser.zero_grad()
            ((model(tx[part]) - ty[part]) ** 2).mean().backward()
            optimiser.step()
        schedule.step()
        _torch(model, report)


def torch_lm(x: np.ndarray, y: np.ndarray, report: Report, batch: int | None = None) -> None:
    import torch
    from torch_levenberg_marquardt.training import LevenbergMarquardtModule

    model, tx, ty = module(), torch.from_numpy(x), torch.from_numpy(y)
    trainer = LevenbergMarquardtModule(model, solve_method="cholesky", max_batch_size=2048)
    while True:
        for part in torch.randperm(len(tx)).split(batch)[:8] if batch else [slice(None)]:
            trainer.training_step(tx[part], ty[part])
        _torch(model, report)


def torch_lm_minibatch(x: np.ndarray, y: np.ndarray, report: Report) -> None:
    torch_lm(x, y, report, batch=4096)


class Solved(Exception):
    """Raised to leave a peer that has no callback of its own."""


def scipy_least_squares(x: np.ndarray, y: np.ndarray, report: Report) -> None:
    import torch
    from scipy.optimize import least_squares

    from motorlens_train.cascade import Architecture, Network, initial, jacobian

    architecture = Architecture(INPUTS, HIDDEN, OUTPUTS)
    hidden = architecture.hidden_parameters
    tx, ty = torch.from_numpy(x).double(), torch.from_numpy(y).double()

    def network(w: np.ndarray) -> Network:
        p = torch.from_numpy(w)
        return Network(architecture, p[:hidden], p[hidden:].reshape(OUTPUTS, -1))

    def slopes(w: np.ndarray) -> np.ndarray:
        report(lambda z: network(w)(torch.from_numpy(z).double()).numpy())
        return jacobian(network(w), tx).flatten(0, 1).numpy()

    start = np.concatenate(
        [initial(architecture, np.random.default_rng(1)).numpy(), np.zeros(architecture.output_parameters)]
    )
    least_squares(lambda w: (network(w)(tx) - ty).numpy().ravel(), start, slopes, method="trf", x_scale="jac")


def trainbr(x: np.ndarray, y: np.ndarray, report: Report) -> None:
    """An emulation of MATLAB's trainbr with its defaults: one alpha, one beta, mu 0.005, x0.1, x10, at most 1e10."""
    import torch

    from motorlens_train.cascade import Architecture, Network, initial, jacobian

    architecture = Architecture(INPUTS, HIDDEN, OUTPUTS)
    hidden = architecture.hidden_parameters
    tx, ty = torch.from_numpy(x).double(), torch.from_numpy(y).double()
    w = torch.cat(
        [
            initial(architecture, np.random.default_rng(1)),
            torch.zeros(architecture.output_parameters).double(),
        ]
    )
    mu, size, count = 0.005, len(w), ty.numel()

    def network(w: torch.Tensor) -> Network:
        return Network(architecture, w[:hidden], w[hidden:].reshape(OUTPUTS, -1))

    def error(w: torch.Tensor) -> torch.Tensor:
        return (network(w)(tx) - ty).reshape(-1)

    gamma = float(size)
    e = error(w)
    beta, alpha = max((count - gamma) / (2 * float(e @ e)), 1.0), gamma / (2 * float(w @ w))
    while True:
        j = jacobian(network(w), tx).flatten(0, 1)
        jj, je = j.T @ j, j.T @ e
        while True:
            step = torch.linalg.solve(
                beta * jj + (mu + alpha) * torch.eye(size).double(), beta * je + alpha * w
            )
            new = w - step
            e_new = error(new)
            if float(beta * e_new @ e_new + alpha * new @ new) < float(beta * e @ e + alpha * w @ w):
                w, e, mu = new, e_new, max(mu * 0.1, 1e-20)
                break
            mu *= 10
            if mu > 1e10:
                return
        gamma = size - alpha * float(
            torch.trace(torch.linalg.inv(beta * jj + alpha * torch.eye(size).double()))
        )
        alpha, beta = gamma / (2 * float(w @ w)), (count - gamma) / (2 * float(e @ e))
        report(lambda z, w=w: network(w)(torch.from_numpy(z).double()).numpy())


def scikit_learn(x: np.ndarray, y: np.ndarray, report: Report) -> None:
    import warnings

    from sklearn.neural_network import MLPRegressor

    warnings.simplefilter("ignore")
    # Continued by warm starts of fifty iterations; each continuation costs a new history, but there is no callback.
    model = MLPRegressor(
        hidden_layer_sizes=HIDDEN,
        activation="tanh",
        solver="lbfgs",
        max_iter=50,
        warm_start=True,
        random_state=1,
    )
    while True:
        model.fit(x, y)
        report(model.predict)


def pyrenn(x: np.ndarray, y: np.ndarray, report: Report) -> None:
    import contextlib
    import io

    import pyrenn as prn

    for name, kind in (("int", int), ("float", float), ("bool", bool)):
        setattr(np, name, kind)  # it was written for numpy 1
    net = prn.CreateNN([INPUTS, *HIDDEN, OUTPUTS])
    while True:
        with contextlib.redirect_stdout(io.StringIO()):
            net = prn.train_LM(x.T.astype(float), y.T.astype(float), net, k_max=2, verbose=False)
        report(lambda z, net=net: prn.NNOut(z.T.astype(float), net).T)


PEERS: dict[str, Callable[[np.ndarray, np.ndarray, Report], None]] = {
    "torch L-BFGS": torch_lbfgs, "torch Adam": torch_adam, "torch-levenberg-marquardt": torch_lm,
    "torch-levenberg-marquardt, mini-batch": torch_lm_minibatch, "scipy least_squares": scipy_least_squares,
    "trainbr (emulated)": trainbr, "scikit-learn L-BFGS": scikit_learn, "pyrenn": pyrenn,
}  # fmt: skip
# Peers that hold the Jacobian of all samples at once.
WHOLE_JACOBIAN = ("scipy least_squares", "trainbr (emulated)", "pyrenn")
RIVALS = ("torch L-BFGS", "torch-levenberg-marquardt", "trainbr (emulated)")


def child(peer: str, folder: str, correlation: float) -> None:
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

    def report(predict: Callable[[np.ndarray], np.ndarray]) -> None:
        nonlocal spent
        before = time.process_time()
        value = predict(unseen)
        mse = float(value) if value.ndim == 0 else float(np.mean((value - truth) ** 2))
        print(json.dumps([before - started - spent, mse, peak[0]]), flush=True)
        spent += time.process_time() - before

    if peer == "motorlens":
        motorlens(x, y, report, correlation)
    else:
        PEERS[peer](x, y, report)


def watch(peak: list[float]) -> None:
    """Keep the largest size of this process in GB, without the pages of mapped files, which the system may drop at will."""
    while True:
        status = Path("/proc/self/status").read_text(encoding="ascii")
        peak[0] = max(peak[0], int(status.partition("RssAnon:")[2].split()[0]) / 1e6)
        time.sleep(0.02)


def race(
    peer: str, folder: str, budget_s: float, level: float, correlation: float
) -> tuple[list[list[float]], str]:
    """Its reports until it reaches the level or its processor time is used up, and why there are none."""
    process = subprocess.Popen(
        [sys.executable, "-W", "ignore", __file__, "--child", peer, folder, str(correlation)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    reports: list[list[float]] = []
    limit = threading.Timer(4 * budget_s, process.kill)
    limit.start()
    assert process.stdout is not None and process.stderr is not None
    for line in process.stdout:
        if line.startswith("["):
            reports.append(json.loads(line))
            if reports[-1][0] > budget_s or reports[-1][1] <= level:
                break
    process.kill()
    limit.cancel()
    complaint = process.stderr.read().strip().splitlines()
    process.wait()
    return reports, complaint[-1][:90] if complaint and not reports else ""


def compare(rows: int, peers: tuple[str, ...], budget_s: float, correlation: float) -> float:
    """Print one table; returns how many times longer the best peer takes."""
    with tempfile.TemporaryDirectory() as folder:
        write(rows, Path(folder), correlation)
        inputs = f"inputs correlated {correlation:g}" if correlation else "independent inputs"
        print(
            f"\n{f'{rows} samples, {inputs}':40}{'s to the level':>14}{'best error':>12}{'in s':>8}{'memory GB':>11}"
        )
        own, complaint = race("motorlens", folder, 20 * budget_s, 0.0, correlation)
        if not own:
            raise SystemExit(complaint)
        level = 1.01 * min(mse for _, mse, _ in own)
        mine = next(seconds for seconds, mse, _ in own if mse <= level)
        row("motorlens", own, level)
        best = float("inf")
        for peer in peers:
            needed = 8e-9 * rows * OUTPUTS * 547
            if peer in WHOLE_JACOBIAN and needed > 2:
                print(f"{peer:40}  skipped: its Jacobian alone takes {needed:.0f} GB")
                continue
            reports, complaint = race(peer, folder, budget_s, level, correlation)
            if not reports:
                print(f"{peer:40}  skipped: {complaint or f'no iteration within {4 * budget_s:g} s'}")
                continue
            row(peer, reports, level)
            best = min(
                best,
                next((seconds for seconds, mse, _ in reports if mse <= level), max(budget_s, reports[-1][0])),
            )
        if peers:
            over = "over " if best >= budget_s else ""
            print(f"level {level:.5f}; the best peer takes {over}{best / mine:.1f} times as long")
    return best / mine


def row(peer: str, reports: list[list[float]], level: float) -> None:
    """Print one line of the table."""
    at = next((seconds for seconds, mse, _ in reports if mse <= level), None)
    seconds, mse, _ = min(reports, key=lambda r: r[1])
    shown = f"{at:.2f}" if at is not None else f"not in {max(r[0] for r in reports):.0f}"
    print(f"{peer:40}{shown:>14}{mse:12.5f}{seconds:8.1f}{max(r[2] for r in reports):11.2f}", flush=True)


def write(rows: int, folder: Path, correlation: float) -> None:
    """The data on disk, made in pieces so that their size does not depend on this machine's memory."""
    x = np.lib.format.open_memmap(folder / "x.npy", "w+", np.float32, (rows, INPUTS))
    y = np.lib.format.open_memmap(folder / "y.npy", "w+", np.float32, (rows, OUTPUTS))
    for piece, first in enumerate(range(0, rows, 100_000)):
        part = slice(first, min(first + 100_000, rows))
        x[part], y[part] = data(part.stop - first, 1000 + piece, correlation)


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
    parser.add_argument("--child", nargs=3, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        child(arguments.child[0], arguments.child[1], float(arguments.child[2]))
        return
    sizes, peers, budget = [int(size) for size in arguments.sizes], tuple(PEERS), arguments.budget
    correlations = arguments.correlation
    if arguments.quick:
        sizes, peers, budget, correlations = [10_000], RIVALS[:2], 5.0, [0.0, 0.9]
    ratios = []
    for rows in sizes:
        for correlation in correlations:
            # Beyond a million samples only this trainer runs: no peer reads data that do not fit into memory.
            chosen = peers if rows <= 1_000_000 else ()
            ratio = compare(rows, chosen, budget * max(1.0, np.log10(rows) - 3), correlation)
            if chosen:
                ratios.append(f"{ratio:.1f} at {rows}{f' correlated {correlation:g}' if correlation else ''}")
    if ratios:
        print(f"time of the best peer over motorlens' time: {', '.join(ratios)}")


if __name__ == "__main__":
    main()
