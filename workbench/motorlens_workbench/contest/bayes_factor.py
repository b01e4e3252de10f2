"""Bayes factors of hypotheses against nothing there, by which they are ranked under one scatter."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from motorlens_workbench.criteria import CRITERIA
from motorlens_workbench.evidence.score import Score, inverse
from motorlens_workbench.fitted import Challenger, Fitted
from motorlens_workbench.hypotheses.hypothesis import Hypothesis

Array = NDArray[np.float64]

# Orders of magnitude over which the prior of a free curve's size is spread (Zellner's g).
SPREAD = 10.0 ** np.arange(7)


def log_bayes_factor(score: Score, scatter: float, gain: float | None = None) -> float:
    """Against nothing there, over a prior of sizes.

    Args:
        score: of a shape.
        scatter: by which evidence is divided.
        gain: instead of the linearised problem's.
    """
    gain = (score.gain if gain is None else gain) / scatter
    if score.entry.hypothesis.named:
        return 0.5 * gain + log_occam(score.coefficient, score.information / scatter)
    g = SPREAD
    return float(logsumexp(-score.width / 2 * np.log1p(g) + 0.5 * gain * g / (1 + g)) - np.log(len(g)))


def log_occam(size: Array, information: Array) -> float:
    """What a hypothesis loses by having had to say its size, in a logarithm, without what all names share.

    Sizes are spread as Cauchy's distribution about nought, as wide as the typical size: a factor more is as likely as the
    same factor less, and of two that explain as much the one nearer its typical size is likelier. By Laplace's
    approximation.

    Args:
        size: (k,) in typical sizes.
        information: (m, m) inverse of the covariance of all that is fitted along with it, in typical sizes and deviations.
    """
    known = np.linalg.slogdet(information + np.eye(len(information)))[1]
    return float(-0.5 * known - 0.5 * (1 + len(size)) * np.log1p(size @ size))


def log_occam_of(hypothesis: Hypothesis, fitted: Fitted) -> float:
    """See `log_occam`, of a name in a model that has it."""
    keys = [key for key in fitted.prior.keys if key.startswith(f"{hypothesis.name}.")]
    return _log_occam_of(keys, hypothesis, fitted) + log_shape(hypothesis, fitted)


def log_occam_of_shape(hypothesis: Hypothesis, fitted: Fitted) -> float:
    """What a name loses by having had to say more than its size, and by the search over its shapes, in a logarithm."""
    alone = _log_occam_of([hypothesis.key], hypothesis, fitted)
    return log_occam_of(hypothesis, fitted) - alone - float(np.log(len(hypothesis.shapes)))


def _log_occam_of(keys: Sequence[str], hypothesis: Hypothesis, fitted: Fitted) -> float:
    """Of some parameters of a name, its size among them."""
    values, prior = fitted.model.values(), fitted.prior
    at = [prior.keys.index(key) for key in keys]
    unit = np.array([abs(hypothesis.typical) if key == hypothesis.key else prior.sd[key] for key in keys])
    null = fitted.model.file.meaning(hypothesis.key).null or 0.0
    size = (values[hypothesis.key] - null) / hypothesis.typical
    information = inverse(fitted.covariance[np.ix_(at, at)] / np.outer(unit, unit)) / CRITERIA.tempered
    return log_occam(np.array([size]), information)


def log_shape(hypothesis: Hypothesis, fitted: Fitted) -> float:
    """How likely the shape of a name is beforehand, in a model that has it: a logarithm, nought for the likeliest shape."""
    values, prior = fitted.model.values(), fitted.prior
    shape = [key for key in prior.keys if key.startswith(f"{hypothesis.name}.") and key != hypothesis.key]
    return -0.5 * sum(((values[key] - prior.centre[key]) / prior.sd[key]) ** 2 for key in shape)


def likeliest(challengers: Sequence[Challenger]) -> Challenger:
    """The one with the largest Bayes factor under one scatter."""
    scatter = scatter_of(challengers)
    return max(challengers, key=lambda one: posterior(one, one.gain, scatter))


def simplest(challengers: Sequence[Challenger]) -> Challenger:
    """Of the terms that leave what is nearly as likely, as noise, as the best of them does, the one with fewest columns.

    Sizes are those of the linearised problem, and what they leave is known no better.
    """
    most = max(one.won for one in challengers)
    able = [one for one in challengers if one.won >= (1 - CRITERIA.instead) * most]
    return min(able, key=lambda one: (one.score.width, -one.won))


def posterior(one: Challenger, gain: float, scatter: float) -> float:
    """Logarithm of the Bayes factor of a challenger against nothing there, the search over its shapes paid for."""
    return log_bayes_factor(one.score, scatter, gain) - float(np.log(len(one.score.entry.hypothesis.shapes)))


def scatter_of(challengers: Sequence[Challenger]) -> float:
    """By which the evidence of rivals is divided: that of the one that leaves least."""
    return max(challengers, key=lambda one: one.gain).score.scatter * CRITERIA.tempered
