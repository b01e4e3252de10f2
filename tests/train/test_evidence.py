"""Evidence, gamma and posterior: the closed form of a linear model, and a second implementation for a network."""

import numpy as np
import pytest
import torch

from motorlens_train.cascade import Architecture, jacobian
from motorlens_train.evidence import score_autocorrelation
from motorlens_train.posterior import LastLayer, full_variance
from motorlens_train.source import Arrays
from motorlens_train.trainer import Settings, Trained, train

PRECISE = Settings(iterations=200, tolerance=1e-10, single=False)


def wave(rows: int, noise: float, seed: int = 3) -> Arrays:
    generator = np.random.default_rng(seed)
    x = generator.uniform(-1, 1, (rows, 2))
    f = np.column_stack([np.sin(3 * x[:, 0]) + x[:, 1], x[:, 0] * x[:, 1]])
    return Arrays(x, f + noise * generator.standard_normal(f.shape))


def reference_evidence(trained: Trained, x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Log evidence and gamma with dense numpy algebra, from the Jacobian alone."""
    alpha, beta = trained.hyper.alpha.numpy(), (trained.hyper.beta / trained.hyper.tau).numpy()
    network = trained.network
    j = jacobian(network, torch.from_numpy(x)).numpy()
    error = network(torch.from_numpy(x)).numpy() - y
    architecture = network.architecture
    a = np.concatenate(
        [alpha[architecture.layer_of.numpy()], np.full(architecture.output_parameters, alpha[-1])]
    )
    data = np.einsum("nkp,k,nkq->pq", j, beta, j)
    w = network.parameters().numpy()
    log_evidence = (
        -0.5 * (beta * (error**2).sum(0)).sum()
        - 0.5 * (a * w**2).sum()
        + 0.5 * len(x) * np.log(beta / (2 * np.pi)).sum()
        + 0.5 * np.log(a).sum()
        - 0.5 * np.linalg.slogdet(data + np.diag(a))[1]
    )
    return float(log_evidence), float(np.trace(np.linalg.solve(data + np.diag(a), data)))


def test_linear_model_has_the_evidence_of_its_marginal_gaussian() -> None:
    """For a model linear in its weights, y ~ N(0, I / beta + Z A^-1 Z^T) exactly: no Laplace approximation is left."""
    generator = np.random.default_rng(0)
    x = generator.standard_normal((60, 3))
    y = x @ np.array([[1.0], [-2.0], [0.3]]) + 0.4 * generator.standard_normal((60, 1))
    trained = train(Arrays(x, y), Architecture(3, (), 1), 0, PRECISE)
    z = np.column_stack([np.ones(60), trained.inputs.scale(torch.from_numpy(x)).numpy()])
    t = trained.targets.scale(torch.from_numpy(y)).numpy()[:, 0]
    alpha, beta = float(trained.hyper.alpha[0]), float(trained.hyper.beta[0])
    covariance = np.eye(60) / beta + z @ z.T / alpha
    closed = -0.5 * (
        t @ np.linalg.solve(covariance, t) + np.linalg.slogdet(covariance)[1] + 60 * np.log(2 * np.pi)
    )
    assert trained.evidence.log_evidence == pytest.approx(closed, rel=1e-9)
    # At the maximum of the evidence both derivatives vanish; by finite differences of the closed form.
    for name, value in (("alpha", alpha), ("beta", beta)):
        sides = []
        for factor in (1.01, 0.99):
            a, b = (alpha * factor, beta) if name == "alpha" else (alpha, beta * factor)
            c = np.eye(60) / b + z @ z.T / a
            sides.append(-0.5 * (t @ np.linalg.solve(c, t) + np.linalg.slogdet(c)[1]))
        assert abs(sides[0] - sides[1]) < 2e-3, f"{name} = {value} does not maximise the evidence"
    posterior = np.linalg.inv(beta * z.T @ z + alpha * np.eye(4))
    assert trained.network.output[0].numpy() == pytest.approx(beta * posterior @ z.T @ t, rel=1e-9)
    variance = LastLayer.of(trained).variance(torch.from_numpy(z))[:, 0].numpy()
    assert variance == pytest.approx(np.einsum("ni,ij,nj->n", z, posterior, z), rel=1e-9)
    full = full_variance(trained.network, trained.evidence.factor, torch.from_numpy(z[:, 1:]))[:, 0].numpy()
    assert full == pytest.approx(variance, rel=1e-9)


@pytest.mark.fit
@pytest.mark.parametrize("skips", [True, False])
def test_network_evidence_and_gamma_are_those_of_a_second_implementation(skips: bool) -> None:
    data = wave(300, 0.1)
    trained = train(data, Architecture(2, (5, 3), 2, skips=skips), 1, PRECISE)
    x, y = (
        trained.inputs.scale(torch.from_numpy(data.x)).numpy(),
        trained.targets.scale(torch.from_numpy(data.y)).numpy(),
    )
    log_evidence, gamma = reference_evidence(trained, x, y)
    assert trained.evidence.log_evidence == pytest.approx(log_evidence, rel=1e-9)
    assert float(trained.evidence.gamma.sum()) == pytest.approx(gamma, rel=1e-8)
    assert 5 < gamma < trained.network.architecture.parameters


def test_noise_is_found_and_the_function_recovered() -> None:
    trained = train(wave(2000, 0.1), Architecture(2, (8,), 2), 1, Settings(single=False))
    noise = trained.targets.deviation.numpy() / np.sqrt(trained.hyper.beta.numpy())
    assert noise == pytest.approx([0.1, 0.1], rel=0.06)
    clean = wave(3000, 0.0, seed=9)
    error = trained.predict(torch.from_numpy(clean.x)).numpy() - clean.y
    assert 0.001 < np.sqrt((error**2).mean()) < 0.02


@pytest.mark.fit
def test_evidence_prefers_the_network_that_suffices() -> None:
    """Occam's razor (MacKay 1992, section 4): beyond a sufficient size gamma grows less than the weights, evidence falls."""
    data = wave(400, 0.2)
    runs = {
        width: [train(data, Architecture(2, (width,), 2), seed) for seed in range(3)] for width in (1, 6, 24)
    }
    best = {width: max(found, key=lambda t: t.evidence.log_evidence) for width, found in runs.items()}
    assert best[6].evidence.log_evidence > best[24].evidence.log_evidence + 10
    assert best[6].evidence.log_evidence > best[1].evidence.log_evidence + 10
    share = {
        width: float(t.evidence.gamma.sum()) / t.network.architecture.parameters for width, t in best.items()
    }
    assert 0.2 < share[24] < 0.75 * share[6] < 0.75


def test_score_autocorrelation_of_a_constant_model_is_that_of_its_errors() -> None:
    """With only a bias the score is the error, so tau is (1 + rho) / (1 - rho) of a first-order process."""
    generator = np.random.default_rng(2)
    rho, rows = 0.9, 200_000
    error = np.zeros(rows)
    drive = generator.standard_normal(rows)
    for n in range(1, rows):
        error[n] = rho * error[n - 1] + drive[n]
    data = Arrays(np.zeros((rows, 1)), error[:, None])
    trained = train(data, Architecture(1, (), 1), 0, PRECISE)
    runs = list((trained.inputs.scale(x), trained.targets.scale(y)) for x, y in data.runs(rows, 20_000))
    tau = score_autocorrelation(trained.network, trained.evidence, runs, torch.zeros(1, 1))
    assert float(tau[0]) == pytest.approx((1 + rho) / (1 - rho), rel=0.1)
    white = Arrays(data.x, generator.permutation(data.y))
    runs = list((trained.inputs.scale(x), trained.targets.scale(y)) for x, y in white.runs(rows, 20_000))
    tau = score_autocorrelation(trained.network, trained.evidence, runs, torch.zeros(1, 1))
    assert float(tau[0]) == pytest.approx(1.0, abs=0.05)
