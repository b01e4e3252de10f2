"""Other trainers of the same network: each trains for ever, and reports after every few of its iterations."""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from training.task import HIDDEN, INPUTS, OUTPUTS, Report, data


def module(start: int):  # type: ignore[no-untyped-def]
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

    torch.manual_seed(start)
    return Cascade()


def _torch(model, report: Report) -> None:  # type: ignore[no-untyped-def]
    import torch

    with torch.no_grad():
        report(lambda x: model(torch.from_numpy(x)).numpy())


def torch_lbfgs(x: np.ndarray, y: np.ndarray, report: Report, start: int) -> None:
    """With the setting that was found to be its fastest: inputs made uncorrelated, fifty pairs kept."""
    import torch

    whiten = np.linalg.inv(np.linalg.cholesky(np.cov(x.T))).T.astype(np.float32)
    model, tx, ty = module(start), torch.from_numpy(x @ whiten), torch.from_numpy(y)
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
        with torch.no_grad():
            report(lambda z: model(torch.from_numpy(z @ whiten)).numpy())


def torch_adam(x: np.ndarray, y: np.ndarray, report: Report, start: int) -> None:
    import torch

    model, tx, ty = module(start), torch.from_numpy(x), torch.from_numpy(y)
    optimiser = torch.optim.Adam(model.parameters(), lr=3e-3)
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimiser, 0.98)
    while True:
        for part in torch.randperm(len(tx)).split(256)[: 20_000 // 256 + 1]:
            optimiser.zero_grad()
            ((model(tx[part]) - ty[part]) ** 2).mean().backward()
            optimiser.step()
        schedule.step()
        _torch(model, report)


def torch_lm(x: np.ndarray, y: np.ndarray, report: Report, start: int, batch: int | None = None) -> None:
    import torch
    from torch_levenberg_marquardt.training import LevenbergMarquardtModule

    model, tx, ty = module(start), torch.from_numpy(x), torch.from_numpy(y)
    trainer = LevenbergMarquardtModule(model, solve_method="cholesky", max_batch_size=2048)
    while True:
        for part in torch.randperm(len(tx)).split(batch)[:8] if batch else [slice(None)]:
            trainer.training_step(tx[part], ty[part])
        _torch(model, report)


def torch_lm_minibatch(x: np.ndarray, y: np.ndarray, report: Report, start: int) -> None:
    torch_lm(x, y, report, start, batch=4096)


class Solved(Exception):
    """Raised to leave a peer that has no callback of its own."""


def scipy_least_squares(x: np.ndarray, y: np.ndarray, report: Report, start: int) -> None:
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

    first = np.concatenate(
        [
            initial(architecture, np.random.default_rng(start)).numpy(),
            np.zeros(architecture.output_parameters),
        ]
    )
    least_squares(lambda w: (network(w)(tx) - ty).numpy().ravel(), first, slopes, method="trf", x_scale="jac")


def trainbr(x: np.ndarray, y: np.ndarray, report: Report, start: int) -> None:
    """An emulation of MATLAB's trainbr with its defaults: one alpha, one beta, mu 0.005, x0.1, x10, at most 1e10."""
    import torch

    from motorlens_train.cascade import Architecture, Network, initial, jacobian

    architecture = Architecture(INPUTS, HIDDEN, OUTPUTS)
    hidden = architecture.hidden_parameters
    tx, ty = torch.from_numpy(x).double(), torch.from_numpy(y).double()
    w = torch.cat(
        [
            initial(architecture, np.random.default_rng(start)),
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


def scikit_learn(x: np.ndarray, y: np.ndarray, report: Report, start: int) -> None:
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
        random_state=start,
    )
    while True:
        model.fit(x, y)
        report(model.predict)


def pyrenn(x: np.ndarray, y: np.ndarray, report: Report, start: int) -> None:
    import contextlib
    import io

    import pyrenn as prn

    for name, kind in (("int", int), ("float", float), ("bool", bool)):
        setattr(np, name, kind)  # it was written for numpy 1
    np.random.seed(start)  # noqa: NPY002
    net = prn.CreateNN([INPUTS, *HIDDEN, OUTPUTS])
    while True:
        with contextlib.redirect_stdout(io.StringIO()):
            net = prn.train_LM(x.T.astype(float), y.T.astype(float), net, k_max=2, verbose=False)
        report(lambda z, net=net: prn.NNOut(z.T.astype(float), net).T)


def optimistix_lm(x: np.ndarray, y: np.ndarray, report: Report, start: int) -> None:
    os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    import equinox
    import jax
    import jax.numpy as jnp
    import optimistix

    weights = [jnp.asarray(p.detach().numpy()) for p in module(start).parameters()]

    def predict(weights, z):  # type: ignore[no-untyped-def]
        for w, b in zip(weights[:-2:2], weights[1:-2:2], strict=True):
            z = jnp.concatenate([z, jnp.tanh(z @ w.T + b)], axis=1)
        return z @ weights[-2].T + weights[-1]

    def residuals(weights, rows):  # type: ignore[no-untyped-def]
        return (predict(weights, rows[0]) - rows[1]).ravel(), None

    # Its own loop has no callback, so it is stepped from outside, as its manual shows.
    solver = optimistix.LevenbergMarquardt(rtol=1e-9, atol=1e-9)
    rows = (jnp.asarray(x), jnp.asarray(y))
    shapes = jax.eval_shape(residuals, weights, rows)
    state = solver.init(residuals, weights, rows, {}, *shapes, frozenset())
    moving, fixed = equinox.partition(state, equinox.is_array)

    @equinox.filter_jit
    def step(weights, moving):  # type: ignore[no-untyped-def]
        state = equinox.combine(moving, fixed)
        weights, state, _ = solver.step(residuals, weights, rows, {}, state, frozenset())
        return weights, equinox.filter(state, equinox.is_array)

    while True:
        weights, moving = step(weights, moving)
        report(lambda z, weights=weights: np.asarray(predict(weights, jnp.asarray(z))))


# One network an output, of like size (it has neither cascades nor several outputs), stopped after growing numbers of epochs.
BRNN = """
library(brnn)
read <- function(name, columns) matrix(readBin(name, "double", 1e9, size = 4), ncol = columns, byrow = TRUE)
x <- read("x", 16); y <- read("y", 3); unseen <- read("unseen", 16)
start <- as.integer(commandArgs(TRUE))
for (epochs in 25 * 2^(0:5)) {
  set.seed(start)
  began <- proc.time()
  networks <- lapply(1:3, function(k) {
    capture.output(network <- brnn(x, y[, k], neurons = 10, epochs = epochs)); network })
  seconds <- sum((proc.time() - began)[1:2])
  writeBin(as.vector(t(sapply(networks, predict, unseen))), "guess")
  cat(seconds, fill = TRUE)
}
"""


def brnn(x: np.ndarray, y: np.ndarray, report: Report, start: int, correlation: float) -> None:
    if shutil.which("Rscript") is None:
        raise SystemExit("R is not installed")
    with tempfile.TemporaryDirectory() as folder:
        for name, array in (("x", x), ("y", y), ("unseen", data(10_000, 2, correlation)[0])):
            np.asarray(array, np.float32).tofile(Path(folder) / name)
        (Path(folder) / "run.R").write_text(BRNN, encoding="ascii")
        command = ["Rscript", "run.R", str(start)]
        process = subprocess.Popen(
            command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert process.stdout is not None and process.stderr is not None
        for line in process.stdout:
            guess = np.fromfile(Path(folder) / "guess").reshape(-1, OUTPUTS)
            report(lambda _, guess=guess: guess, float(line))
        raise SystemExit(" ".join(process.stderr.read().split()))


PEERS: dict[str, Callable[..., None]] = {
    "torch L-BFGS": torch_lbfgs, "torch Adam": torch_adam, "torch-levenberg-marquardt": torch_lm,
    "torch-levenberg-marquardt, mini-batch": torch_lm_minibatch, "scipy least_squares": scipy_least_squares,
    "trainbr (emulated)": trainbr, "scikit-learn L-BFGS": scikit_learn, "pyrenn": pyrenn, "optimistix": optimistix_lm,
    "R brnn": brnn,
}  # fmt: skip
