"""Recordings again where their motors are likeliest: no bias of what each tells poorly, the same likelihood elsewhere."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from helpers.plain_fleet import TYPICAL, World, write

from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.queue import Done
from motorlens_workbench.fleet.manifest import Entry
from motorlens_workbench.fleet.study import study
from motorlens_workbench.fleet.summary import Parabola
from motorlens_workbench.fleet.work import Again, Job, analysed

H, SPREAD, OWN = 17e3, 0.15, 0.25
MOTORS, EACH = 40, 10


def heated(folder, rng):
    """What recordings show of 1/H: an error of 25 % each, of motors that differ by 15 %."""
    truth = 1 / (H * np.exp(SPREAD * rng.standard_normal(MOTORS)))
    shown = {}
    for m in range(MOTORS):
        for r in range(EACH):
            path = folder / f"m{m:02d}-{r}.csv"
            path.write_text(path.name, encoding="ascii")
            shown[path] = truth[m] + OWN / H * rng.standard_normal()
    return shown, float(np.mean(1 / truth))


def parabola(seen, at):
    """The likelihood of H about a point."""
    sd = OWN / H
    return Parabola(
        ("H",), np.array([at]), np.array([(1 / at - seen) / at**2 / sd**2]), np.array([[1 / at**4 / sd**2]])
    )


def likeliest(seen, prior, sd):
    """Where H is likeliest with a normal prior, by Newton's method on the true likelihood."""
    at = prior
    for _ in range(50):
        told = parabola(seen, at)
        slope = told.gradient[0] - (at - prior) / sd**2
        at = max(at + slope / (told.information[0, 0] + 1 / sd**2), 0.2 * H)
    return at


@dataclass(frozen=True)
class Remembered:
    """A store without a disk, which has tests of its own."""

    kept: dict = field(default_factory=dict)

    def read(self, key):
        return self.kept.get(key)

    def write(self, key, document):
        self.kept[key] = document


@pytest.mark.fit
def test_what_each_recording_tells_poorly_is_not_drawn_to_one_side(tmp_path):
    file = read_motor_file("mellah2016")
    wide = 0.5 * file.motor.H
    off, deviations, alone = [], [], []
    for seed in range(8):
        shown, truth = heated(tmp_path, np.random.default_rng(seed))
        asked = []

        def work(jobs, shown=shown, asked=asked):
            for number, job in enumerate(jobs):
                seen = shown[job.paths[0]]
                at = job.values["H"] if isinstance(job, Again) else likeliest(seen, job.file.motor.H, wide)
                asked.append(type(job))
                yield Done(number, {"parabola": parabola(seen, at).as_json()})

        entries = [Entry(path.name[:3], path, path.name) for path in shown]
        fleet = study(entries, Job(Path(), file), Remembered(), work, grow=False)
        (mean,), (sd,) = fleet.population.mean()
        assert Job in asked and Again in asked
        off.append((mean - truth) / sd)
        deviations.append(sd / H)
        # About the estimates of each by itself those that came out small count most.
        (top, deviation) = pooled(
            [parabola(seen, likeliest(seen, file.motor.H, wide)) for seen in shown.values()]
        )
        alone.append((top - truth) / deviation)
    # Eight fleets: their average is off by chance by what a third of a fleet's deviation is, the true mean of each counted.
    assert abs(np.mean(off)) < 0.6
    assert np.mean(deviations) == pytest.approx(np.hypot(OWN / EACH**0.5, SPREAD) / MOTORS**0.5, rel=0.3)
    assert np.mean(alone) < -4


def pooled(parabolas):
    """The top of a sum of parabolas, and its deviation."""
    information = sum(p.information[0][0] for p in parabolas)
    top = sum(p.information[0][0] * p.at[0] + p.gradient[0] for p in parabolas)
    return top / information, information**-0.5


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("beside") / "a.csv"
    write(World(1, 1, samples=300, dwell=50).recorded(0, 0, 5), path)
    return path


@pytest.mark.fit
def test_a_recording_looked_at_again(recording):
    job = Job(recording, read_motor_file("mellah2016"))
    before = analysed(job)
    first = Parabola.of_json(before["parabola"])
    keys = [first.keys.index(key) for key in TYPICAL]
    faint = np.diag([1e-4 / TYPICAL[key] ** 2 for key in TYPICAL])

    def top(of):
        table = of.information[np.ix_(keys, keys)]
        return (of.at[keys] + np.linalg.solve(table + faint, of.gradient[keys]))[told]

    told = [list(TYPICAL).index(key) for key in ("ke", "J")]
    deviation = np.diagonal(np.linalg.inv(first.information[np.ix_(keys, keys)] + faint))[told] ** 0.5
    # Where it ended: the same likelihood.
    ended = {key: before["end"]["values"][key] for key in TYPICAL}
    same = Parabola.of_json(analysed(Again(job, ended, before))["parabola"])
    assert np.all(np.abs(top(same) - top(first)) < 0.15 * deviation)
    # Two deviations off: the parabola is taken there, and the likelihood is still that of the recording, whose top is where
    # it was.
    away = {**ended, **dict(zip(("ke", "J"), first.at[told] + 2 * deviation, strict=True))}
    there = Parabola.of_json(analysed(Again(job, away, before))["parabola"])
    np.testing.assert_allclose(there.at[keys], [away[key] for key in TYPICAL])
    assert np.all(np.abs(top(there) - top(first)) < 0.15 * deviation)
