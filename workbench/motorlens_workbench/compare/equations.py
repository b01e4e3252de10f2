"""Which equation is to blame: how much of the error of the free run a free force in it, and in no other, takes away."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.conditions import Shaft, Terminal
from motorlens_physics.estimate.model import Model
from motorlens_physics.estimate.prepare import prepare
from motorlens_physics.recording import Recording
from motorlens_workbench.balances import EQUATIONS
from motorlens_workbench.compare.long_recordings import block, is_long, means
from motorlens_workbench.compare.overlay import Overlay
from motorlens_workbench.hypotheses.curves import free_curves
from motorlens_workbench.hypotheses.line import Line

_BALANCE = {"electrical": "voltage", "mechanical": "torque", "thermal": "heat"}


@dataclass(frozen=True)
class Equation:
    """One balance driven by the measured others: what it lacks (rms, in `unit`), and its share of the error
    that free forces would remove."""

    unit: str
    rms: float
    share: float
    testable: bool
    why: str = ""


def equations_of(
    model: Model, recordings: Sequence[Recording], overlays: Sequence[Overlay]
) -> dict[str, Equation]:
    """What each equation lacks along the measured others, and its share of the error that free forces would remove."""
    reasons = {name: _untestable(name, overlays) for name in EQUATIONS}
    tested = [name for name in EQUATIONS if not reasons[name]]
    removable = _removable(model, recordings, overlays, tested)
    whole = sum(removable.values())
    found = {}
    for name, unit in EQUATIONS.items():
        lacking = np.concatenate([o.missing[name] for o in overlays])
        rms = float(np.sqrt(np.mean(lacking**2, dtype=np.float64)))
        share = removable.get(name, 0.0) / whole if whole > 0 else 0.0
        found[name] = Equation(unit, rms, share, not reasons[name], reasons[name])
    return found


def _line(model: Model, r: int, recording: Recording, overlay: Overlay) -> Line:
    """The linear problem of a recording, along the means of its blocks if it is long."""
    if not is_long(recording):
        return Line.of(model, overlay.run, r, ())
    return Line.of(model, replace(prepare(means(recording), model.file), turns=overlay.run.turns), r, ())


def _removable(
    model: Model, recordings: Sequence[Recording], overlays: Sequence[Overlay], names: Sequence[str]
) -> dict[str, float]:
    """How much of the squared error, in units of the noise, only a free force in each of these equations takes away.

    The force is a sum of free curves against speed, current, temperature and time; it costs something beyond a tenth of
    what the equation carries at rated load.
    """
    rated, motor = model.file.rated, model.file.motor
    carried = {
        "electrical": rated.voltage_V,
        "mechanical": rated.torque_Nm,
        "thermal": motor.k0 * rated.rise_K,
    }
    lines = [
        _line(model, r, recording, o)
        for r, (recording, o) in enumerate(zip(recordings, overlays, strict=True))
    ]
    free = free_curves([line.trajectory for line in lines], [_BALANCE[name] for name in names])
    if not free:
        return {}
    owner = np.array(
        [name for curve in free for name in names if _BALANCE[name] == curve.balance for _ in curve.knots]
    )
    gram, gradient = np.zeros((len(owner), len(owner))), np.zeros(len(owner))
    for recording, line, overlay in zip(recordings, lines, overlays, strict=True):
        rows = line.run
        size = block(recording) * rows.every
        sigma = overlay.noise / np.sqrt(size)
        kept = rows.fresh()
        columns, at = np.empty((int(kept.sum()), len(sigma), len(owner))), 0
        for curve in free:
            columns[:, :, at : at + curve.width] = (
                rows.average(curve.columns(line))[kept] / sigma[None, :, None]
            )
            at += curve.width
        blocks = replace(overlay.run, every=size)
        errors = [blocks.average(overlay.error_of(channel)) for channel in blocks.channels]
        error = np.stack(errors, axis=1)[kept] / sigma
        flat = columns.reshape(-1, len(owner))
        gram += flat.T @ flat
        gradient += flat.T @ error.ravel()
    cost = np.diag([(0.1 * carried[name]) ** -2 for name in owner])

    def fall(of: NDArray[np.bool_]) -> float:
        if not of.any():
            return 0.0
        inside = np.ix_(of, of)
        return float(
            gradient[of] @ np.linalg.lstsq(gram[inside] + cost[inside], gradient[of], rcond=1e-14)[0]
        )

    everything = fall(np.ones(len(owner), dtype=bool))
    return {name: max(everything - fall(owner != name), 0.0) for name in names}


def _untestable(name: str, overlays: Sequence[Overlay]) -> str:
    """Why an equation cannot be tested on its own; empty if it can."""
    channels = {channel for o in overlays for channel in o.run.channels}
    imposed = {
        "current": all(_throughout(o.run.inputs.terminal, Terminal.CURRENT) for o in overlays),
        "speed": all(_throughout(o.run.inputs.shaft, Shaft.TURNED) for o in overlays),
    }
    if name == "electrical" and imposed["current"]:
        return "the current is imposed, and the voltage is what that takes"
    if name == "mechanical" and imposed["speed"]:
        return "the speed is imposed, and the torque is what that takes"
    needed = {
        "electrical": ("current", "speed"),
        "mechanical": ("current", "speed"),
        "thermal": ("temperature",),
    }[name]
    absent = [channel for channel in needed if channel not in channels]
    if absent:
        return f"{' and '.join(absent)} {'is' if len(absent) == 1 else 'are'} not measured"
    if name == "thermal" and "current" not in channels and not imposed["current"]:
        return "current is not measured"
    return ""


def _throughout(tied: NDArray[np.int64] | None, to: int) -> bool:
    return tied is not None and bool(np.all(tied == to))


def remark(name: str, overlays: Sequence[Overlay]) -> str:
    """What a tested equation takes for granted, in words; empty if nothing."""
    if name == "mechanical" and not all(o.run.load_known for o in overlays):
        return "the load torque was not measured and is taken as none"
    if name == "thermal" and any("ambient" not in o.run.known for o in overlays):
        return "the ambient was not measured and is taken from the rating plate"
    return ""
