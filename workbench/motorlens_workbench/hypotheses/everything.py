"""All hypotheses about a model, in one list."""

from collections.abc import Sequence

from motorlens_physics.effect import Effect
from motorlens_workbench.hypotheses.bumps import fine_curves
from motorlens_workbench.hypotheses.contact import contacts
from motorlens_workbench.hypotheses.courses import courses
from motorlens_workbench.hypotheses.curves import curves
from motorlens_workbench.hypotheses.effects import effects
from motorlens_workbench.hypotheses.hypothesis import Hypothesis
from motorlens_workbench.hypotheses.line import Line
from motorlens_workbench.hypotheses.memory import memories
from motorlens_workbench.hypotheses.sensors import sensors


def everything(lines: Sequence[Line], own: Sequence[type[Effect]] = ()) -> list[Hypothesis]:
    """All that a model may lack on these runs; what changed at once is read from the ledger, see `changes`.

    Args:
        lines: the runs about the model.
        own: the user's effects.
    """
    file, runs = lines[0].model.file, [line.run for line in lines]
    trajectories = [line.trajectory for line in lines]
    channels = sorted({channel for run in runs for channel in run.channels})
    loaded = any(run.load_known for run in runs)
    return [
        *effects(file, own),
        *sensors(file, runs),
        *curves(trajectories, file.rated),
        *fine_curves(trajectories, file.rated),
        *memories(trajectories),
        *courses(file, trajectories, channels, loaded=loaded),
        *contacts(lines),
    ]
