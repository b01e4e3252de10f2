"""How the inputs of a recording ran between its samples: held by a drive, or linearly, each of its own.

Also whether all channels come a sample earlier or later, which looks much alike. The way is chosen that makes the recording
likeliest.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from motorlens_physics.estimate.model import sensitivities_of
from motorlens_physics.estimate.prior import Prior
from motorlens_physics.estimate.run import Run
from motorlens_physics.estimate.weighed import Weighed, moved_on, needed


def as_they_ran(point: Weighed, prior: Prior) -> tuple[Run, ...]:
    """The runs with their inputs held between samples, or not, and all channels a sample earlier or later: as is likeliest.

    Each way is judged at its own best parameters, one step away, see `weighed.Frame`. A run that stays as it was is the same
    object.
    """
    chosen, inflation = [], point.tempered().inflation
    for r, part in enumerate(point.parts):
        measured, ambient = "load_torque" in part.run.known, part.run.inputs.hold[2]
        ways = {
            (held, moved): cost
            for held in (False, True)
            for moved, cost in _costs(
                point, prior, r, (held, held, ambient), (-1, 0, 1), straight=True
            ).items()
        }
        held, moved = min(ways, key=lambda way: ways[way])
        here = min(ways[way, 0] for way in (False, True))
        # That all is late is one thing more than how inputs ran, and that they did not run alike is another.
        if (here - ways[held, moved]) / inflation <= needed(len(ways)):
            held, moved = min(ways, key=lambda way: (way[1] != 0, ways[way]))
        load = held
        if measured and not moved:
            alike, other = (
                _costs(point, prior, r, (held, one, ambient), (0,), straight=False)[0]
                for one in (held, not held)
            )
            load = not held if (alike - other) / inflation > needed(1) else held
        chosen.append(_moved(part.run.holding((held, load, ambient)), moved))
    return tuple(chosen)


def _moved(run: Run, samples: int) -> Run:
    for channel in run.channels:
        run = run if channel == "temperature" else run.delayed(channel, samples)
    return run


def _costs(
    point: Weighed,
    prior: Prior,
    r: int,
    hold: tuple[bool, bool, bool],
    late: Sequence[int],
    *,
    straight: bool,
) -> dict[int, float]:
    """Twice the negative logarithmic likelihood of a run whose inputs ran this way, by how many samples it was late.

    Without skews (`straight`), which would make up for a voltage that ran otherwise.
    """
    part = point.parts[r]
    mine = tuple(k for k in part.mine if not (straight and prior.keys[k].startswith("skew.")))
    keys = [prior.keys[k] for k in mine]
    none = {f"{name}@{r}": 0.0 for name in point.model.own[r] if name.startswith("skew.")}
    held = tuple(hold if k == r else h for k, h in enumerate(point.model.held))
    model = replace(point.model, held=held).with_values(none)
    values = model.values()
    run, frame = part.run.holding(hold), point.frames[r]
    _, shown, columns, _ = sensitivities_of(model, run, r, keys)
    width = np.array([prior.sd[key] for key in keys])
    off = np.array([values[key] - prior.centre[key] for key in keys]) / width
    costs = {}
    for samples in late:
        moves = tuple(0 if channel == "temperature" else samples for channel in run.channels)
        # The same samples count in all.
        used = run.there.copy()
        used[[0, -1]] = False
        later = moved_on(shown, moves)
        error = frame.error(run.measured - later)
        of = replace(
            part, columns=moved_on(columns, moves), mine=mine, frame=frame, used=used, error=error
        ).sums(1)
        score = of.scores.sum(axis=0) - off / width
        step = np.linalg.lstsq(of.gram + np.diag(width**-2.0), score, rcond=1e-12)[0]
        costs[samples] = of.squares + float(off @ off) - float(score @ step)
    return costs
