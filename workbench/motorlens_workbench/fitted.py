"""A model fitted to recordings, a hypothesis that would be added to it, and one that has been."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.fit import Fit
from motorlens_physics.estimate.model import Model
from motorlens_physics.estimate.noise import Noise
from motorlens_physics.estimate.prior import Prior
from motorlens_physics.estimate.run import Run
from motorlens_workbench.evidence.ledger import FREEDOM
from motorlens_workbench.evidence.score import Score
from motorlens_workbench.hypotheses.hypothesis import Hypothesis

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Fitted:
    """A model fitted to runs under their noise.

    Attributes:
        model: with its parameters.
        prior: of the free ones.
        runs: with their noise and corrected inputs.
        cost: squares of its innovations and of what moved against the priors.
        covariance: (p, p) of `prior.keys`, as the noise alone makes it.
    """

    model: Model
    prior: Prior
    runs: tuple[Run, ...]
    cost: float
    covariance: Array

    @property
    def fit(self) -> Fit:
        """As the estimate has it, but without what it leaves."""
        return Fit(self.model, self.prior, self.covariance, ())

    @property
    def pulled(self) -> float:
        """Squares of what moved against the priors, a part of the cost."""
        return self.prior.penalty(self.model.values())

    @property
    def unlikely_beforehand(self) -> float:
        """Twice the negative logarithm of how likely its parameters are beforehand, where a file may be wrong about a motor.

        Of the motor's own that is Student's t; all else that is known counts in full. But for a constant.
        """
        penalties = self.prior.penalties(self.model.values())
        motor = np.array([not {".", "@"} & set(key) for key in self.prior.keys], dtype=np.bool_)
        return float(np.sum(np.where(motor, (FREEDOM + 1) * np.log1p(penalties / FREEDOM), penalties)))

    def multiple(self, hypothesis: Hypothesis) -> float:
        """How large a hypothesis in the model is, in multiples of its typical size."""
        null = self.model.file.meaning(hypothesis.key).null or 0.0
        return (self.model.values()[hypothesis.key] - null) / hypothesis.typical

    def allows(self, hypothesis: Hypothesis) -> bool:
        """Whether a hypothesis in the model is no larger than such an effect or fault can be."""
        return abs(self.multiple(hypothesis)) <= hypothesis.most


@dataclass(frozen=True)
class Challenger:
    """A hypothesis, weighed with as much of an unmeasured torque as it would leave.

    Attributes:
        score: of its best shape.
        noises: of each run.
        colour: that is left in the noise, see `Ledger`.
        won: twice the rise of the logarithmic likelihood of what is left, as noise, each with a noise of its own.
    """

    score: Score
    noises: tuple[Noise, ...]
    colour: float
    won: float

    @property
    def name(self) -> str:
        """Of the hypothesis."""
        return self.score.name

    @property
    def gain(self) -> float:
        """Twice the fall of the negative log likelihood."""
        return self.score.gain

    @property
    def weight(self) -> float:
        """Minus the logarithm of the probability of as much by chance."""
        return self.score.weight

    @property
    def named(self) -> bool:
        """Whether a model can be built with it."""
        return self.score.entry.hypothesis.named


@dataclass(frozen=True)
class Accepted:
    """A hypothesis in the model.

    Attributes:
        hypothesis: which.
        gain: twice the fall of the negative log likelihood as it entered, over the scatter.
        scatter: of its size between blocks of time, as seen from the model that has it.
        weight: minus the logarithm of the probability of as much by chance.
        agreed: squared ratio to which blocks of time agree on it, where that told more than Wald's test; else 0.
        beside: other names with which the motor was fitted or estimated as well, and the logarithm of how much likelier each
            is; where it was estimated from the beginning, as far as blocks of time agree on that.
        instead: names that were fitted in its place in the end, and the logarithm of how much likelier each is.
        made_up_for: parameters that are far from the motor file without it, where nothing else speaks for it, and a sentence
            on each.
        than_file: the logarithm of how much likelier it is than that the motor file is wrong about these.
    """

    hypothesis: Hypothesis
    gain: float
    scatter: float
    weight: float
    agreed: float = 0.0
    beside: Mapping[str, float] = field(default_factory=dict)
    instead: Mapping[str, float] = field(default_factory=dict)
    made_up_for: Mapping[str, str] = field(default_factory=dict)
    than_file: float = float("inf")
