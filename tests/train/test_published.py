"""Bayesian regularisation against another implementation of it: how many parameters a noisy sine takes, and its noise.

The R package brnn 0.9.4 follows MacKay (1992) and Foresee and Hagan (1997) and "implements the functionality of the function
trainbr in Matlab 2010b" (https://rdrr.io/pkg/brnn/man/brnn.html). What it prints for the data of these tests stands in
`BRNN`; where R has the package, a test runs `PROGRAM` again. It has one alpha for all weights and no output bias, so its
number of effective parameters need not be ours to the digit. From half its starts it ends at a straight line (effective
parameters below 2); `BRNN` holds the start that does not.
"""

import shutil
import subprocess
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from motorlens_train.cascade import Architecture
from motorlens_train.source import Arrays
from motorlens_train.trainer import Settings, train

# Of each draw of the noise: effective parameters out of 60, and the deviation of the noise, `sqrt(SSE / (N - gamma))`.
BRNN = {0: (12.61, 0.0776), 1: (13.33, 0.0995), 2: (11.84, 0.1015)}
PROGRAM = """
suppressMessages(library(brnn))
for (name in commandArgs(TRUE)) {
  d <- as.matrix(read.table(name))
  set.seed(1)
  capture.output(network <- brnn(d[, 1, drop = FALSE], d[, 2], neurons = 20))
  left <- sum((predict(network, d[, 1, drop = FALSE]) - d[, 2])^2)
  cat(network$gamma, sqrt(left / (nrow(d) - network$gamma)), "\\n")
}
"""


def noisy_sine(draw: int) -> tuple[np.ndarray, np.ndarray]:
    """A period of a sine on either side of zero at 41 points, with noise of deviation 0.1."""
    x = np.linspace(-1, 1, 41)[:, None]
    return x, np.sin(2 * np.pi * x) + 0.1 * np.random.default_rng(draw).standard_normal(x.shape)


@cache
def effective(width: int, draw: int) -> tuple[float, float]:
    """Effective parameters of the better of two starts, and the noise it finds."""
    architecture = Architecture(1, (width,), 1, skips=False)
    data = Arrays(*noisy_sine(draw))
    starts = [train(data, architecture, seed, Settings(single=False)) for seed in (1, 2)]
    best = max(starts, key=lambda trained: trained.evidence.log_evidence)
    return float(best.evidence.gamma.sum()), float(best.targets.deviation / best.hyper.beta.sqrt())


@pytest.mark.parametrize("draw", BRNN)
def test_parameters_and_noise_of_a_sine_are_those_that_brnn_finds(draw: int) -> None:
    (gamma, noise), (theirs, their_noise) = effective(20, draw), BRNN[draw]
    assert 0.65 * theirs < gamma < 1.35 * theirs
    assert noise == pytest.approx(their_noise, rel=0.03)


@pytest.mark.fit
def test_their_number_does_not_grow_with_the_network() -> None:
    pairs = [(effective(20, draw)[0], effective(40, draw)[0]) for draw in range(2)]
    for narrow, wide in pairs:
        assert abs(wide - narrow) < 2.5, "twice the units, and as many parameters in effect"


def test_what_brnn_finds_is_what_it_prints_today(tmp_path: Path) -> None:
    if shutil.which("Rscript") is None:
        pytest.skip("R is not installed")
    (tmp_path / "run.R").write_text(PROGRAM, encoding="ascii")
    names = [f"draw{draw}" for draw in BRNN]
    for name, draw in zip(names, BRNN, strict=True):
        np.savetxt(tmp_path / name, np.hstack(noisy_sine(draw)))
    done = subprocess.run(
        ["Rscript", "run.R", *names], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    if "there is no package" in done.stderr:
        pytest.skip("R has no package brnn")
    found = [tuple(map(float, line.split())) for line in done.stdout.splitlines()]
    assert found == [pytest.approx(pair, rel=0.01) for pair in BRNN.values()], done.stderr
