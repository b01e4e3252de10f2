"""What a user would try instead of `motorlens diagnose`: forward choice by AICc.

As PEtab Select does (https://github.com/PEtab-dev/petab_select): of all names the one with which the fitted model's
criterion is least enters, and so on, until none makes it less.

Criterion: twice the negative logarithmic likelihood of what the model leaves under the likeliest noise, and what Hurvich
and Tsai (1989, doi:10.1093/biomet/76.2.297) add for its parameters. Engine, effects and noise are those of `motorlens`; what
differs from `motorlens diagnose` is how it decides.
"""

from pathlib import Path
from typing import Any

from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import read_recording
from motorlens_physics.threads import on_all_cores
from motorlens_runtime.errors import ModelError
from motorlens_workbench.diagnose import fitted_of
from motorlens_workbench.evidence.score import Score
from motorlens_workbench.fitted import Fitted
from motorlens_workbench.refit import settled, with_hypothesis
from motorlens_workbench.standing import Standing, residual_of, stand, under

# As many as a diagnosis looks for.
MOST = 3


def criterion(unlikely: float, parameters: int, samples: int) -> float:
    """The criterion.

    >>> criterion(100.0, 2, 6)
    108.0
    """
    return unlikely + 2 * parameters + 2 * parameters * (parameters + 1) / (samples - parameters - 1)


def forward(paths: list[Path], motor: Path) -> dict[str, Any]:
    """The names chosen, in order."""
    file = read_motor_file(str(motor))
    runs = prepare_all([read_recording(str(path)) for path in sorted(paths)], file)
    samples = sum(int(run.there.sum()) for run in runs)
    here = stand(fitted_of(estimate(file, runs)))
    entered: list[Score] = []
    while len(entered) < MOST:
        left: list[tuple[float, Score | None, Fitted]] = [(here.unlikely, None, here.fitted)]
        left += [
            (_unlikely(here, fit), score, fit) for score, fit in _fits(here, [one.name for one in entered])
        ]
        _, score, fitted = min(left, key=lambda one: criterion(one[0], len(one[2].prior.keys), samples))
        if score is None:
            break
        entered.append(score)
        here = stand(settled(fitted))
    names = [score.name for score in entered]
    return {
        "verdict": "named" if names else "adequate",
        "chosen": names[:1],
        "groups": [[name] for name in names],
        "equation": entered[0].entry.hypothesis.equation if entered else None,
        "candidates": [{"name": name} for name in names],
    }


def _unlikely(here: Standing, fitted: Fitted) -> float:
    try:
        return residual_of(here, fitted).unlikely
    except ModelError:
        return float("inf")


def _fits(here: Standing, entered: list[str]) -> list[tuple[Score, Fitted]]:
    """The model with each name, in its shape that explains most; not with names that cannot pay for a parameter."""
    named: dict[str, Score] = {}
    for score in sorted(here.scores, key=lambda score: score.gain):
        if score.possible and score.entry.hypothesis.named and score.name not in entered and score.gain > 2.0:
            named[score.name] = score
    fitted, beside = under(here, here.noises)
    fits = on_all_cores(lambda one: with_hypothesis(fitted, beside, one), list(named.values()))
    return [(score, fit) for score, fit in zip(named.values(), fits, strict=True) if fit is not None]
