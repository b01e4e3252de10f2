"""Training by Bayesian regularisation: Levenberg-Marquardt in stages that grow, with the evidence framework
between steps.

1. Start on a small random sample; when progress slows, quadruple it. The last stage uses all data: held in
   memory if they are few, otherwise read again for each pass, with the curvature taken from a random part
   that changes every iteration.
2. Between steps alpha and beta are re-estimated (`motorlens_train.evidence`).
3. If the data are a time series, the errors' autocorrelation time is estimated at the minimum and the
   likelihood tempered by it.

Stops: when the objective falls by less than `tolerance` (relative) in two iterations with settled
regularisation; when no damping leads downhill; when a validation set has not improved for `patience`
iterations (the best weights are kept); when `iterations` are used up; on Ctrl-C (the best so far is kept).
The result is a function of data, settings and seed alone.
"""

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from motorlens_train.cascade import Architecture, Network, initial
from motorlens_train.evidence import (
    Evidence,
    Hyperparameters,
    evidence,
    log_evidence,
    posterior_precision,
    score_autocorrelation,
    update,
)
from motorlens_train.gauss_newton import Columns, OutputMoments, curvature, output_moments
from motorlens_train.levenberg_marquardt import Batch, Point, locate, settle, step
from motorlens_train.scaling import Scaling, Whitening
from motorlens_train.source import Block, Source
from motorlens_train.state import Record, State, load_checkpoint, save_checkpoint

# Rows per product: large enough for the processor's matrix units, small enough for its cache.
CHUNK = 2048
# Iterations before the evidence may move alpha and beta: at the start neither weights nor errors mean anything.
FREE = 1
# Damping of the first step.
DAMPING = 0.3
# A sample is left when a step lowers the objective by less than this share of the well-determined parameters' number.
LEAVE = 0.3
# Points at which the autocorrelation time is taken.
POINTS = 48


@dataclass(frozen=True)
class Settings:
    """How to train.

    Attributes:
        iterations: at most so many Levenberg-Marquardt iterations, all stages together.
        tolerance: relative fall of the objective below which the last stage is finished.
        first_rows: size of the first random sample.
        block_rows: largest stage held in memory, and the size of the rotating part that gives curvature
        beyond it.
        patience: iterations without improvement of the validation error before training stops.
        time_series: whether consecutive rows are a time series with correlated errors.
        single: whether products run in float32 (sums are float64 always).
        ridge: of the inputs' whitening.
        tau: autocorrelation time of the errors to begin with, in samples; it stays unless `time_series` is set.
    """

    iterations: int = 300
    tolerance: float = 1e-4
    first_rows: int = 2048
    block_rows: int = 32768
    patience: int = 15
    time_series: bool = False
    single: bool = True
    ridge: float = 1e-8
    tau: float = 1.0


@dataclass(frozen=True)
class Trained:
    """A trained network and what its training found.

    Attributes:
        network: weights for scaled inputs and targets.
        inputs: whitening of the inputs.
        targets: scaling of the targets.
        hyper: alpha, beta and tau.
        evidence: Laplace's approximation at the final weights.
        moments: of what the output layer reads, at the final weights, for the last-layer posterior.
        history: one record an iteration.
        stopped: why training ended, in words.
    """

    network: Network
    inputs: Whitening
    targets: Scaling
    hyper: Hyperparameters
    evidence: Evidence
    moments: OutputMoments
    history: tuple[Record, ...]
    stopped: str

    def predict(self, x: Tensor) -> Tensor:
        """Outputs in the targets' units `[N, K]` for inputs in theirs `[N, F]`."""
        return self.targets.restore(self.network(self.inputs.scale(x)))

    def report(self) -> dict[str, object]:
        """The training report as plain data."""
        return {
            "architecture": str(self.network.architecture),
            "parameters": self.network.architecture.parameters,
            "effective_parameters": float(self.evidence.gamma.sum()),
            "log_evidence": self.evidence.log_evidence,
            "stopped": self.stopped,
            "history": [asdict(record) for record in self.history],
        }


def train(
    source: Source,
    architecture: Architecture,
    seed: int,
    settings: Settings = Settings(),
    validation: Source | None = None,
    checkpoint: Path | None = None,
    report: Callable[[Record], None] = lambda record: None,
) -> Trained:
    """Train a network.

    Args:
        source: inputs `[N, F]` and targets `[N, K]`.
        architecture: the structure; its inputs and outputs must be those of the source.
        seed: decides the starting weights and every sample drawn.
        settings: limits and sizes.
        validation: unseen data that stop training early.
        checkpoint: file that is written after every iteration, and gone on from if it is there.
        report: called after every iteration.
    """
    scale_rows = source.sample(65536, np.random.default_rng([seed, 0]))
    inputs, targets = Whitening.of(scale_rows[0], settings.ridge), Scaling.of(scale_rows[1])
    run = _Run(source, architecture, seed, settings, validation, inputs, targets)
    state = run.start()
    if checkpoint is not None and checkpoint.exists():
        state = load_checkpoint(checkpoint)
    here: _Place | None = None
    stopped = "no progress left"
    try:
        while True:
            state, here, finished = run.iterate(state, here)
            report(state.history[-1])
            if checkpoint is not None:
                save_checkpoint(checkpoint, state)
            if finished:
                stopped = finished
                break
    except KeyboardInterrupt:
        stopped = "interrupted: the best so far is kept"
    return run.finish(state, stopped)


@dataclass(frozen=True)
class _Place:
    """A point on the batch of its stage."""

    batch: Batch
    point: Point


@dataclass(frozen=True)
class _Run:
    source: Source
    architecture: Architecture
    seed: int
    settings: Settings
    validation: Source | None
    inputs: Whitening
    targets: Scaling

    def start(self) -> State:
        hidden = initial(self.architecture, np.random.default_rng([self.seed, 1]))
        hyper = Hyperparameters.start(self.architecture, self.settings.tau)
        gamma = torch.zeros(self.architecture.layers + 1, dtype=torch.float64)
        return State(hidden, hyper, gamma, DAMPING, 0, 0, 0, hidden, hyper, float("inf"), 0, ())

    def iterate(self, state: State, here: _Place | None) -> tuple[State, _Place | None, str]:
        """One iteration; returns the reason to stop, or an empty string. A place is None where a stage begins."""
        if here is None:
            batch = self._batch(state.stage)
            here = _Place(batch, locate(self.architecture, state.hidden, state.hyper, batch))
        batch, point = here.batch, here.point
        taken = step(point, state.hyper, state.damping, batch, self._curving(batch, state))
        stuck = not taken.accepted
        quiet = state.quiet + 1 if self._little(point, taken.point, batch, state.gamma) else 0
        hyper, gamma, found = state.hyper, state.gamma, None
        # The inverse of H costs as much as half a small stage's iteration: not after every step.
        if state.iteration % 3 == FREE or quiet or stuck:
            gamma, log_det = taken.reduced.determined(point.network, hyper)
            found = log_evidence(point.network, log_det, point.moments, hyper)
        if state.iteration >= FREE or quiet:
            hyper = update(taken.point.network, gamma, taken.point.moments, hyper)
        if self.settings.time_series and self._last(batch) and quiet:
            hyper = replace(hyper, tau=self._tau(taken.point, hyper, batch))
        if _moved(hyper, state.hyper) > 0.03 * (1 + state.quiet):
            quiet = min(quiet, 1)
        after = settle(self.architecture, taken.point.network.hidden, hyper, taken.point.moments)
        state = self._recorded(state, after, taken.damping, taken.accepted, hyper, gamma, found, batch)
        state = replace(state, quiet=quiet)
        there = _Place(batch, after)
        if self.validation is not None and self._last(batch) and state.since_best >= self.settings.patience:
            return state, there, f"the validation error has not improved for {state.since_best} iterations"
        if state.iteration >= self.settings.iterations:
            return state, there, f"the limit of {state.iteration} iterations is reached"
        if quiet < (2 if self._last(batch) else 1):
            return state, there, ""
        if self._last(batch):
            return state, there, "no damping leads downhill" if stuck else "converged"
        onward = replace(state, stage=state.stage + 1, quiet=0, since_best=0, damping=min(state.damping, 1.0))
        return onward, None, ""

    def finish(self, state: State, stopped: str) -> Trained:
        best = self.validation is not None
        hidden, hyper = (state.best, state.best_hyper) if best else (state.hidden, state.hyper)
        batch = Batch(lambda: self._columns(self.source.blocks(CHUNK), torch.float64), self.source.rows)
        point = locate(self.architecture, hidden, hyper, batch)
        found = self._evidence(point, hyper, self._part(batch, torch.float64))
        return Trained(
            point.network,
            self.inputs,
            self.targets,
            hyper,
            found,
            point.moments,
            state.history,
            stopped,
        )

    def _little(self, before: Point, after: Point, batch: Batch, gamma: Tensor) -> bool:
        """Whether a step's progress is too little to go on.

        The minima of a sample and of all data lie about gamma / 2 apart in the objective, so on a sample a step that
        falls by a small share of that only learns the sample by heart.
        """
        fall = before.objective - after.objective
        if self._last(batch):
            return fall < self.settings.tolerance * abs(before.objective)
        return fall < LEAVE * max(float(gamma.sum()), 1.0)

    def _last(self, batch: Batch) -> bool:
        return batch.rows == self.source.rows

    def _batch(self, stage: int) -> Batch:
        rows = self.settings.first_rows * 4**stage
        if rows <= self.settings.block_rows and 2 * rows < self.source.rows:
            return self._held(rows, self._kind, stage)
        if self.source.rows <= 2 * self.settings.block_rows:
            return self._held(self.source.rows, self._kind)
        return Batch(lambda: self._columns(self.source.blocks(CHUNK), self._kind), self.source.rows)

    def _held(self, rows: int, kind: torch.dtype, *key: int) -> Batch:
        """Rows drawn at random and held as blocks in random order, so that some of the blocks are a random sample too."""
        generator = np.random.default_rng([self.seed, 2, *key])
        x, y = self.source.sample(rows, generator)
        order = torch.from_numpy(generator.permutation(len(x)))
        parts = torch.split(order, CHUNK)
        blocks = list(self._columns(((x[part], y[part]) for part in parts), kind))
        return Batch(lambda: blocks, len(x))

    def _curving(self, batch: Batch, state: State) -> Batch:
        """The rows that give curvature: a changing part of a large batch, about as dear as a pass over all of it."""
        if batch.rows > 2 * self.settings.block_rows:
            return self._held(self.settings.block_rows, self._kind, state.stage, state.iteration)
        blocks = list(batch.blocks())
        # At least eight residuals a weight: fewer, and the curvature of a part says little of that of all.
        needed = 8 * self.architecture.parameters // (self.architecture.outputs * CHUNK) + 1
        count = max(2, needed, len(blocks) // 8)
        if len(blocks) <= count:
            return batch
        first = state.iteration * count
        part = [blocks[(first + place) % len(blocks)] for place in range(count)]
        return Batch(lambda: part, sum(x.shape[1] for x, _ in part))

    def _part(self, batch: Batch, kind: torch.dtype) -> Batch:
        """All of a batch, or so many of its rows that their curvature stands for the rest."""
        if batch.rows <= 2 * self.settings.block_rows:
            return batch
        return self._held(self.settings.block_rows, kind, 1000)

    @property
    def _kind(self) -> torch.dtype:
        return torch.float32 if self.settings.single else torch.float64

    def _columns(self, blocks: Iterable[Block], kind: torch.dtype) -> Iterable[Columns]:
        for x, y in blocks:
            yield self.inputs.scale(x).to(kind).T.contiguous(), self.targets.scale(y).to(kind).T.contiguous()

    def _evidence(self, point: Point, hyper: Hyperparameters, part: Batch) -> Evidence:
        """Evidence of all rows that the point was evaluated on, with the curvature of a part of them."""
        network = point.network
        whole = replace(hyper, beta=point.moments.rows / part.rows * hyper.beta)
        sums = curvature(self.architecture, network.hidden, network.output, whole.precision, part.blocks())
        # From the same rows as the curvature: mixed, the two need not be positive definite.
        moments = output_moments(self.architecture, network.hidden, part.blocks())
        matrix = posterior_precision(self.architecture, sums, moments, whole)
        return evidence(network, matrix, point.moments, hyper)

    def _tau(self, point: Point, hyper: Hyperparameters, batch: Batch) -> Tensor:
        found = self._evidence(point, hyper, self._part(batch, self._kind))
        runs = (
            (self.inputs.scale(x.double()), self.targets.scale(y.double()))
            for x, y in self.source.runs(32768, 8192)
        )
        points, _ = self.source.sample(POINTS, np.random.default_rng([self.seed, 3]))
        return score_autocorrelation(point.network, found, runs, self.inputs.scale(points.double()))

    def _recorded(
        self,
        state: State,
        point: Point,
        damping: float,
        accepted: bool,
        hyper: Hyperparameters,
        gamma: Tensor,
        found: float | None,
        batch: Batch,
    ) -> State:
        error = (point.moments.squared_error(point.network.output) / batch.rows).sqrt()
        unseen = self._validation_error(point.network)
        last = state.history[-1] if state.history else None
        record = Record(
            state.iteration,
            state.stage,
            batch.rows,
            accepted,
            point.objective,
            error.tolist(),
            None if unseen is None else unseen.tolist(),
            float(gamma.sum()),
            found if found is not None else (last.log_evidence if last else None),
            hyper.alpha.tolist(),
            hyper.beta.tolist(),
            hyper.tau.tolist(),
            damping,
        )
        hidden = point.network.hidden
        total = 0.0 if unseen is None else float(unseen.square().mean())
        better = total < state.best_error
        return replace(
            state,
            hidden=hidden,
            hyper=hyper,
            gamma=gamma,
            damping=damping,
            iteration=state.iteration + 1,
            best=hidden if better else state.best,
            best_hyper=hyper if better else state.best_hyper,
            best_error=min(total, state.best_error),
            since_best=0 if better else state.since_best + 1,
            history=(*state.history, record),
        )

    def _validation_error(self, network: Network) -> Tensor | None:
        if self.validation is None:
            return None
        total = torch.zeros(self.architecture.outputs, dtype=torch.float64)
        for x, y in self.validation.blocks(CHUNK):
            errors = network(self.inputs.scale(x.double())) - self.targets.scale(y.double())
            total += errors.square().sum(0)
        return (total / self.validation.rows).sqrt()


def _moved(new: Hyperparameters, old: Hyperparameters) -> float:
    """Largest relative change of a quantity that the evidence sets."""
    pairs = ((new.alpha, old.alpha), (new.beta, old.beta), (new.tau, old.tau))
    return max(float((torch.log(a) - torch.log(b)).abs().max()) for a, b in pairs)
