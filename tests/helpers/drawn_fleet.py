"""A fleet whose recordings' parabolas are drawn, not fitted: every true value is known, and no recording is simulated."""

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from motorlens_workbench.fleet.directions import Observation
from motorlens_workbench.fleet.history import histories
from motorlens_workbench.fleet.manifest import Entry
from motorlens_workbench.fleet.population import population
from motorlens_workbench.fleet.study import Fleet, Outcome
from motorlens_workbench.fleet.summary import Parabola

KEYS = ("R_a0", "ke", "b", "k0", "coulomb_friction.tau_c", "quadratic_drag.c")
MAKE = np.array([3.8, 0.9, 0.0017, 4.33])
SPREAD = np.array([0.06, 0.03, 0.15, 0.0])
# Of one recording, relative; the last is not told at all. Then of the candidates, in their units.
OWN = np.array([0.01, 0.002, 0.50, 50.0])
CANDIDATES = np.array([0.02, 2e-7])
BROKEN, DRAGS = 7, 11
MOTORS, EACH = 60, 5
SINCE = 3


def drawn(rng, friction_of_all, slight=()):
    """Recordings and true values of the motors; those that are `slight` drag a little, from the first day on."""
    out, truth = [], np.empty((MOTORS, 4))
    width = np.concatenate([MAKE * OWN, CANDIDATES])
    # Viscous and Coulomb friction are alike in a recording.
    correlation = np.eye(6)
    correlation[2, 4] = correlation[4, 2] = -0.8
    covariance = correlation * np.outer(width, width)
    information, root = np.linalg.inv(covariance), np.linalg.cholesky(covariance)
    for m in range(MOTORS):
        truth[m] = MAKE * np.exp(SPREAD * rng.standard_normal(4))
        if m == BROKEN:
            truth[m, 0] *= 1.5
        for r in range(EACH):
            friction = friction_of_all + (0.3 if m == DRAGS and r >= SINCE else 0.04 if m in slight else 0.0)
            x = np.concatenate([truth[m], [friction, 0.0]])
            top = x + root @ rng.standard_normal(6)
            # Found where b is far from its top, as a prior would leave it; candidates at their null.
            at = np.concatenate([np.maximum(top[:4], 0.2 * MAKE), [0.0, 0.0]])
            at[3] = MAKE[3]
            day = datetime(2026, 1, 1) + timedelta(days=30 * r)
            parabola = Parabola(KEYS, at, information @ (top - at), information)
            out.append(Observation(f"m{m:02d}", f"m{m:02d}/{r}.csv", day, parabola))
    return out, truth


def fleet_of(file, observations):
    """What `motorlens fleet` would have of these recordings, and of one that it could not read."""
    found = population(file, observations)
    outcomes = [Outcome(Entry(o.motor, Path(o.name), o.name, o.date), "0" * 64, {}, "") for o in observations]
    spoilt = Outcome(
        Entry("m00", Path("m00/spoilt.csv"), "m00/spoilt.csv"), "", None, "no column holds a voltage"
    )
    return Fleet(found, (*outcomes, spoilt), (), (), histories(found))
