"""The trainer as a program: known optimum, seeds, checkpoints, validation stop, interruption, data larger than a stage."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from motorlens_runtime.errors import DataError
from motorlens_train.cascade import Architecture
from motorlens_train.source import Arrays, Stream
from motorlens_train.state import Record
from motorlens_train.trainer import Settings, Trained, train

SMALL = Settings(iterations=40, first_rows=256, block_rows=512)
CASCADE = Architecture(4, (6, 4), 2)


def task(rows: int, seed: int = 1, noise: float = 0.1) -> Arrays:
    """A smooth function of four inputs, with white noise."""
    generator = np.random.default_rng(seed)
    x = generator.standard_normal((rows, 4))
    f = np.column_stack([np.tanh(x[:, 0] + x[:, 1] * 0.5) + 0.3 * x[:, 2], np.sin(x[:, 1]) - 0.5 * x[:, 3]])
    return Arrays(x, f + noise * generator.standard_normal(f.shape))


def same(a: Trained, b: Trained) -> bool:
    return torch.equal(a.network.parameters(), b.network.parameters()) and a.history == b.history


def test_noise_floor_is_reached_from_rotating_parts_of_data_beyond_memory(tmp_path: Path) -> None:
    """Twenty times more rows than a stage holds, read from a mapped file: error of the noise, little above it."""
    data, unseen = task(10_000), task(4000, seed=2)
    np.save(tmp_path / "x.npy", data.x)
    mapped = Arrays(np.load(tmp_path / "x.npy", mmap_mode="r"), data.y)
    trained = train(mapped, CASCADE, 1, SMALL)
    error = trained.predict(torch.from_numpy(unseen.x)).numpy() - unseen.y
    assert 0.0095 < (error**2).mean() < 0.0106
    assert trained.history[-1].rows == 10_000 and trained.history[0].rows == 256
    assert (trained.targets.deviation**2 / trained.hyper.beta).numpy() == pytest.approx([0.01, 0.01], rel=0.1)


@pytest.mark.fit
def test_a_seed_decides_everything() -> None:
    data = task(600)
    assert same(train(data, CASCADE, 5, SMALL), train(data, CASCADE, 5, SMALL))
    assert not same(train(data, CASCADE, 5, SMALL), train(data, CASCADE, 6, SMALL))


def test_a_generator_trains_the_same_network_as_an_array() -> None:
    data = task(3000)
    stream = Stream(lambda: iter([(data.x[:700], data.y[:700]), (data.x[700:], data.y[700:])]), 3000, 4, 2)
    settings = replace(SMALL, iterations=12)
    assert same(train(data, CASCADE, 3, settings), train(stream, CASCADE, 3, settings))


def test_killed_and_resumed_is_as_never_killed(tmp_path: Path) -> None:
    data, checkpoint = task(2000), tmp_path / "state.npz"
    settings = replace(SMALL, iterations=14)
    whole = train(data, CASCADE, 2, settings)

    class Killed(Exception):
        pass

    def kill(record: Record) -> None:
        if record.iteration == 6:
            raise Killed

    with pytest.raises(Killed):
        train(data, CASCADE, 2, settings, checkpoint=checkpoint, report=kill)
    assert checkpoint.exists()
    assert same(whole, train(data, CASCADE, 2, settings, checkpoint=checkpoint))


def test_a_file_that_is_no_checkpoint_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(DataError, match=r"bad.npz: not a checkpoint"):
        train(task(300), CASCADE, 2, SMALL, checkpoint=tmp_path / "bad.npz")


def test_interruption_keeps_what_was_reached() -> None:
    def interrupt(record: Record) -> None:
        if record.iteration == 4:
            raise KeyboardInterrupt

    trained = train(task(600), CASCADE, 2, SMALL, report=interrupt)
    assert trained.stopped.startswith("interrupted") and len(trained.history) == 5
    assert trained.history[-1].error[0] < trained.history[0].error[0]


def test_validation_stops_and_the_best_weights_are_kept() -> None:
    """Sixty noisy samples and a large network: from most starts the validation error has a minimum before the end."""
    data, unseen = task(60, noise=0.6), task(500, seed=8, noise=0.6)
    settings = replace(SMALL, patience=5)
    turned = 0
    for seed in (1, 2, 3):
        trained = train(data, Architecture(4, (12, 8), 2), seed, settings, validation=unseen)
        means = [np.mean(np.square(record.validation or [np.inf])) for record in trained.history]
        predicted = trained.targets.scale(trained.predict(torch.from_numpy(unseen.x)))
        reached = (predicted - trained.targets.scale(torch.from_numpy(unseen.y))).square().mean()
        assert float(reached) == pytest.approx(min(means), rel=1e-3)
        turned += min(means) < means[-1]
    assert turned >= 2


def test_objective_never_rises_while_regularisation_stands() -> None:
    trained = train(task(800), CASCADE, 4, SMALL)
    for before, after in zip(trained.history[:-1], trained.history[1:], strict=True):
        if before.alpha == after.alpha and before.beta == after.beta and before.rows == after.rows:
            assert after.objective <= before.objective * (1 + 1e-9)


def test_exact_data_do_not_let_beta_run_away() -> None:
    """A target the network can represent exactly: the guards keep everything finite."""
    generator = np.random.default_rng(0)
    x = generator.standard_normal((300, 3))
    trained = train(Arrays(x, x @ np.array([[1.0], [2.0], [-1.0]])), Architecture(3, (3,), 1), 0, SMALL)
    assert bool(torch.isfinite(trained.network.parameters()).all()) and np.isfinite(
        trained.evidence.log_evidence
    )
    assert float(trained.hyper.beta[0]) <= 1e14


def test_useless_data_give_a_constant() -> None:
    """Pure noise: gamma falls to a few and the prediction to the mean."""
    generator = np.random.default_rng(0)
    x, y = generator.standard_normal((500, 3)), generator.standard_normal((500, 1))
    trained = train(Arrays(x, y), Architecture(3, (6,), 1), 0, SMALL)
    assert float(trained.predict(torch.from_numpy(x)).std()) < 0.35
    assert float(trained.evidence.gamma.sum()) < 0.5 * trained.network.architecture.parameters


@pytest.mark.parametrize(
    ("x", "y", "says"),
    [(np.zeros((0, 2)), np.zeros((0, 1)), "zero rows"), (np.zeros((3, 2)), np.zeros((2, 1)), r"\[N, F\]")],
)
def test_unusable_data_are_refused(x: np.ndarray, y: np.ndarray, says: str) -> None:
    with pytest.raises(DataError, match=says):
        Arrays(x, y)
