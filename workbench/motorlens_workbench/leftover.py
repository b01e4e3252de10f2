"""What a model leaves unexplained that is no noise: free curves, terms with a memory, parameters that are no constants, a
loose contact.

They have no name. Where one of them explains much of what is left, something is missing that the catalogue has not.
"""

from collections.abc import Sequence

import numpy as np

from motorlens_physics.estimate.fit import Fit
from motorlens_physics.estimate.model import predict
from motorlens_physics.estimate.run import Run
from motorlens_physics.parameter import Rated
from motorlens_workbench.bend import Bend, Free
from motorlens_workbench.changes import Change, changes
from motorlens_workbench.contacts import loose_contact
from motorlens_workbench.curves import BALANCES, Curve, curves
from motorlens_workbench.evidence import Evidence, curve_gain, statistics
from motorlens_workbench.lasting import Lasting, lasting
from motorlens_workbench.look import Look
from motorlens_workbench.screen import all_columns, evidence_of, with_priors
from motorlens_workbench.selection import REAL
from motorlens_workbench.turning import CurveWhileTurning
from motorlens_workbench.variation import Variation, parameters_of, variations

# Knots around a revolution of the shaft.
ROUND = 25
# A free curve counts if it is this many standard deviations beyond chance, explains this many times what counts as real for
# a single column, and has one knot that is this many times real by itself: a small curve must be sharp, one that bends
# everywhere a little must explain much.
SHARP, PLAIN, AT_LARGE = (8.0, 3.0, 1.8), (16.0, 8.0, 1.0), (16.0, 6.0, 0.5)
# How many times real a change at once must be: it is the best of many moments.
AT_ONCE = 3.0


def leftover(found: Fit, runs: Sequence[Run], decoy: float) -> list[Bend]:
    """The free curves that explain more than chance of what a fitted model leaves, the strongest first.

    Args:
        found: the fit, with its noise.
        runs: prepared recordings.
        decoy: the best statistic that a decoy reaches from there.
    """
    predictions = [predict(found.model, run, r) for r, run in enumerate(runs)]
    if (contact := loose_contact(found.model, runs, predictions)) is not None:
        # Whatever else a curve would explain, a contact that comes and goes has put there.
        return [contact]
    trajectories = [trajectory for trajectory, _ in predictions]
    outputs = sorted({channel for run in runs for channel in run.channels})
    free: list[Free] = [c for c in curves(trajectories, BALANCES) if not _disturbance(c)]
    free += lasting(trajectories)
    if any(run.shaft for run in runs):
        around = np.linspace(0, 2 * np.pi, ROUND)
        free += [Curve("torque", "angle", around), CurveWhileTurning("torque", "angle", around)]
    loaded = any("load_torque" in run.known for run in runs)
    free += [v for v in variations(found.model.file, trajectories, outputs) if loaded or not _may_be_load(v)]
    columns = all_columns(found, runs, (), free, with_decoys=False)
    evidence = evidence_of(columns, runs, found.whiteners)
    # Without the priors: a curve must not count because it is a parameter of the model that the motor file holds back.
    left = evidence.given(found.prior.keys)
    held = with_priors(evidence, found).given(found.prior.keys)
    bends = [
        bend
        for bend in [*bends_of(left, held, free), *changes(evidence, found, runs, _constants(found, runs))]
        if _believable(bend, found.model.file.rated) and _beyond_chance(bend, decoy)
    ]
    turned = any(isinstance(bend.curve, CurveWhileTurning) for bend in bends)
    # Witnesses only: what goes with the angle must be seen while the shaft turns as well.
    return [
        bend
        for bend in sorted(bends, key=lambda bend: -bend.gain)
        if not isinstance(bend.curve, CurveWhileTurning) and (turned or not _of_angle(bend))
    ]


def at_once(first: Look, runs: Sequence[Run]) -> list[Bend]:
    """Changes at once that are beyond chance as seen from a screen, the strongest first."""
    found = [
        bend
        for bend in changes(first.evidence, first.found, runs, _constants(first.found, runs))
        if _beyond_chance(bend, first.decoy)
    ]
    return sorted(found, key=lambda bend: -bend.gain)


def _constants(found: Fit, runs: Sequence[Run]) -> dict[str, str]:
    """Parameters that cannot have changed unless something is missing, and the equation of each."""
    outputs = {channel for run in runs for channel in run.channels}
    loaded = any("load_torque" in run.known for run in runs)
    parameters = parameters_of(found.model.file, sorted(outputs))
    return {key: what for key, (what, _) in parameters.items() if loaded or what != "mechanical"}


def _of_angle(bend: Bend) -> bool:
    return isinstance(bend.curve, Curve) and bend.curve.against == "angle"


def bends_of(left: Evidence, held: Evidence, free: Sequence[Free]) -> list[Bend]:
    """Every free curve against what is left, the strongest first.

    Args:
        left: what the model's parameters leave at any value: how much a curve explains.
        held: what they leave near what was known of them: what the curve then looks like.
        free: the curves.
    """
    found = []
    single = dict(zip(left.names, statistics(left).tolist(), strict=False))
    for curve in free:
        gain, deviations, tested = curve_gain(left, curve.columns())
        shape = curve_gain(held, curve.columns())[2]
        if tested is None or shape is None:
            continue
        at = [int(name.rpartition(".")[2]) for name in shape.names]
        best = max(single[name] for name in tested.names)
        if isinstance(curve, Lasting):
            knots = curve.frequencies_Hz
            value, spread = curve.amplitude(at, shape.coefficient, shape.covariance)
        else:
            knots, value = curve.knots[at], shape.coefficient
            spread = np.sqrt(np.maximum(np.diagonal(shape.covariance), 0))
        found.append(Bend(curve, gain, deviations, best, knots, value, spread))
    return sorted(found, key=lambda bend: -bend.gain)


def _beyond_chance(bend: Bend, decoy: float) -> bool:
    if isinstance(bend.curve, Change):
        return bend.best > AT_ONCE * max(REAL, decoy)
    return any(
        bend.deviations > bent
        and bend.gain > explains * max(REAL, decoy)
        and bend.best > best * max(REAL, 3 * decoy)
        for bent, explains, best in (SHARP, PLAIN, AT_LARGE)
    )


def _disturbance(curve: Curve) -> bool:
    """A voltage or a torque that goes with time, or the temperature that rises with it, need not be the motor's."""
    return curve.against == "time" or (curve.against == "temperature" and curve.balance != "heat")


def _may_be_load(curve: Variation) -> bool:
    """Where no load was measured, friction or inertia that goes with time, or with the warming, may be a load that does."""
    return curve.equation == "mechanical" and curve.against in ("time", "temperature")


def _believable(bend: Bend, rated: Rated) -> bool:
    """Whether a curve stays within what such a term can be: rated voltage and torque, a few times the rated power."""
    limit = {
        "voltage": rated.voltage_V,
        "torque": rated.torque_Nm,
        "heat": 3 * rated.voltage_V * rated.current_A,
    }
    if not isinstance(bend.curve, Curve):
        return True
    sure = np.abs(bend.value) > 3 * bend.sd
    return bool(np.median(np.abs(bend.value[sure])) < limit[bend.curve.balance]) if sure.any() else True
