"""The picture of docs/diagnosis.md: how the diagnosis tells what is missing from what chance does.

    python examples/how_it_decides.py docs/pictures/diagnosis.png

The recording is that of the first task of the README: 0.3 N*m of Coulomb friction that the motor file has not.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import gumbel_r

from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import read_recording
from motorlens_runtime.cli import main as motorlens
from motorlens_workbench.contest.needed import needed_weight
from motorlens_workbench.diagnose import fitted_of
from motorlens_workbench.evidence.ledger import Ledger
from motorlens_workbench.evidence.look import best_of
from motorlens_workbench.evidence.null import Null
from motorlens_workbench.evidence.score import Score
from motorlens_workbench.standing import stand

SIMULATE = "simulate mellah2016 --scenario load_steps --effect coulomb_friction.tau_c=0.3 --noise 0.2% -o"
TRUE = "coulomb_friction"
# As many hypotheses as fit into a panel.
SHOWN = 12
# Blocks that hold less than this share of the information of the one that holds most are not drawn.
TOLD = 0.01


def main(picture: str) -> int:
    """Simulate, estimate, weigh all hypotheses, draw."""
    with tempfile.TemporaryDirectory() as folder:
        recording = str(Path(folder) / "bench.csv")
        if motorlens([*SIMULATE.split(), recording]):
            return 1
        file = read_motor_file("mellah2016")
        here = stand(fitted_of(estimate(file, prepare_all([read_recording(recording)], file))))
    best = {name: score for name, score in best_of(here.scores).items() if score.entry.hypothesis.named}
    assert here.null is not None
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    blocks, null, weights = figure.subplots(1, 3, width_ratios=(1.1, 1, 1.2))
    _blocks(blocks, here.book, best[TRUE])
    _null(null, here.null, needed_weight(here), best[TRUE])
    _weights(weights, best, needed_weight(here))
    figure.savefig(picture, dpi=110)
    print(f"{picture}: {TRUE} has {best[TRUE].weight:.0f}, {needed_weight(here):.1f} is beyond chance")
    return 0


def _blocks(axes: Axes, book: Ledger, true: Score) -> None:
    """How large each block of time has it, once the motor's own parameters have explained what they can."""
    score, information = book.beside().projected([true.entry])
    told = information[0, :-1, 0, 0] > TOLD * information[0, :, 0, 0].max()
    unit = true.entry.hypothesis.typical
    size = unit * score[0, :-1, 0][told] / information[0, :-1, 0, 0][told]
    sd = unit * np.sqrt(true.scatter / information[0, :-1, 0, 0][told])
    axes.errorbar(np.flatnonzero(told), size, sd, fmt=".", elinewidth=0.8)
    axes.axhline(0.0, color="0.6", linewidth=0.8)
    axes.set(
        xlabel="block of time", ylabel=f"{true.name.replace('_', ' ')}, N*m", title="Do blocks of time agree?"
    )


def _null(axes: Axes, null: Null, needed: float, true: Score) -> None:
    """How much the best of all shapes explains by chance, and how much is needed."""
    weight = np.linspace(0.0, 1.15 * needed, 400)
    axes.fill_between(weight, gumbel_r(null.mode, null.scale).pdf(weight), color="0.8")
    axes.axvline(needed, color="C3")
    axes.text(needed, axes.get_ylim()[1] * 0.9, "beyond chance ", color="C3", ha="right")
    axes.set(
        xlabel=f"largest weight; {true.name.replace('_', ' ')} has {true.weight:.0f}",
        ylabel="probability density",
        title="The best of all, by chance",
        yticks=[],
    )


def _weights(axes: Axes, best: dict[str, Score], needed: float) -> None:
    """The heaviest hypotheses with a name."""
    heaviest = sorted(best.values(), key=lambda score: -score.weight)[:SHOWN][::-1]
    names = [score.name.replace("_", " ") for score in heaviest]
    axes.barh(names, [score.weight for score in heaviest], color="C0")
    axes.axvline(needed, color="C3")
    axes.set(
        xlabel="weight: -log of the probability by chance",
        title="What is beyond chance is fitted",
    )
    axes.tick_params(axis="y", labelsize=8)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1] if sys.argv[1:] else "diagnosis.png"))
