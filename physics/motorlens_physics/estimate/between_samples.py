"""How the inputs of a recording ran between its samples: held by a drive, or linearly, each of its own.

Also whether all channels come a sample earlier or later, which looks much alike. The way is chosen that makes the recording
likeliest.
"""

from dataclasses import replace
from itertools import product

import numpy as np

from motorlens_physics.estimate.model import sensitivities_of
from motorlens_physics.estimate.noise import likelier
from motorlens_physics.estimate.prior import Prior
from motorlens_physics.estimate.run import Run
from motorlens_physics.estimate.weighed import Errors, Weighed

# Twice the logarithm of the likelihood by which another way the inputs ran must be better: that of one parameter more at
# the 1 % level.
BETTER = 6.6
# Updates of the noise for each way.
UPDATES = 3


def as_they_ran(point: Weighed, prior: Prior) -> list[Run]:
    """The runs with their inputs held between samples, or not, and all channels a sample earlier or later: as is likeliest.

    Each way is judged at its own best parameters, one step away, and with its own noise. A run that stays as it was is the
    same object.
    """
    chosen = []
    for r, part in enumerate(point.parts):
        here = part.run.inputs.hold
        loads = (False, True) if "load_torque" in part.run.known else (here[1],)
        scores: dict[tuple[tuple[bool, bool, bool], int], float] = {}
        for voltage, load in product((False, True), loads):
            hold = (voltage, load, here[2])
            scores |= {(hold, moved): score for moved, score in _likelihoods(point, prior, r, hold).items()}
        likeliest = min(scores, key=lambda way: scores[way])
        better = scores[likeliest] < scores[here, 0] - BETTER
        chosen.append(_moved(part.run.holding(likeliest[0]), likeliest[1]) if better else part.run)
    return chosen


def _moved(run: Run, samples: int) -> Run:
    for channel in run.channels:
        run = run if channel == "temperature" else run.delayed(channel, samples)
    return run


def _likelihoods(point: Weighed, prior: Prior, r: int, hold: tuple[bool, bool, bool]) -> dict[int, float]:
    """Twice the negative logarithmic likelihood of a run whose inputs ran this way, by how many samples it was late."""
    part = point.parts[r]
    # Without skews, which make up for inputs that ran otherwise.
    mine = tuple(k for k in part.mine if not prior.keys[k].startswith("skew."))
    keys = [prior.keys[k] for k in mine]
    straight = {f"{name}@{r}": 0.0 for name in point.model.own[r] if name.startswith("skew.")}
    held = tuple(hold if k == r else h for k, h in enumerate(point.model.held))
    model = replace(point.model, held=held).with_values(straight)
    plain = replace(part.run.holding(hold), corrections=None)
    _, shown, columns, linear = sensitivities_of(model, plain, r, keys)
    width = np.array([prior.sd[key] for key in keys])
    scores = {}
    for samples in (-1, 0, 1):
        run = _moved(plain, samples)
        # What one way cannot explain are no outliers of the other; the same samples count in all.
        used = run.there.copy()
        used[[0, -1]] = False
        error = run.measured - shown
        noise = likelier(part.noise, run, linear, error, used, 1)[0]
        of = Errors(run, error, columns, mine, linear, noise, used).sums(1)
        step = np.linalg.lstsq(of.gram + np.diag(width**-2.0), of.scores.sum(axis=0), rcond=1e-12)[0]
        _, total = likelier(noise, run, linear, error - columns @ step, used, UPDATES)
        scores[samples] = total + float(np.sum((step / width) ** 2))
    return scores
