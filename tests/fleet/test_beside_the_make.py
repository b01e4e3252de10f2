"""Recordings again beside their make: no bias of what each tells poorly, the same where nothing new is known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.plain_fleet import TYPICAL, World, write

from motorlens_physics.motor_file import Knowledge, read_motor_file
from motorlens_physics.queue import Done
from motorlens_workbench.fleet.manifest import Entry
from motorlens_workbench.fleet.store import Store
from motorlens_workbench.fleet.study import study
from motorlens_workbench.fleet.summary import Parabola
from motorlens_workbench.fleet.work import Beside, Job, analysed

H, SPREAD, OWN = 17e3, 0.05, 0.25
MOTORS, EACH = 40, 3


def heated(folder, rng):
    """What recordings show of 1/H: an error of 25 % each, of motors that differ by 5 %."""
    shown = {}
    for m in range(MOTORS):
        truth = 1 / (H * np.exp(SPREAD * rng.standard_normal()))
        for r in range(EACH):
            path = folder / f"m{m:02d}-{r}.csv"
            path.write_text(path.name, encoding="ascii")
            shown[path] = truth + OWN / H * rng.standard_normal()
    return shown


def parabola(seen, prior, sd):
    """The likelihood of H about where it is likeliest with a normal prior, by Newton's method on the true likelihood."""
    at = prior
    for _ in range(50):
        slope = (1 / at - seen) / at**2 / (OWN / H) ** 2 - (at - prior) / sd**2
        at = max(at + slope / (1 / at**4 / (OWN / H) ** 2 + 1 / sd**2), 0.2 * H)
    information = 1 / at**4 / (OWN / H) ** 2
    return Parabola(
        ("H",), np.array([at]), np.array([(1 / at - seen) / at**2 / (OWN / H) ** 2]), [[information]]
    )


@pytest.mark.fit
def test_what_each_recording_tells_poorly_is_not_drawn_to_one_side(tmp_path):
    file = read_motor_file("mellah2016")
    shown = heated(tmp_path, np.random.default_rng(7))
    asked = []

    def work(jobs):
        for number, job in enumerate(jobs):
            known = job.make if isinstance(job, Beside) else job.file
            sd = known.knowledge["H"].sd or 0.5 * known.motor.H
            asked.append(type(job))
            told = parabola(shown[job.paths[0]], known.motor.H, sd)
            yield Done(number, {"parabola": replace(told, information=np.array(told.information)).as_json()})

    entries = [Entry(path.name[:3], path, path.name) for path in shown]
    fleet = study(entries, Job(Path(), file), Store(tmp_path / "results"), work, grow=False)
    assert Job in asked and Beside in asked
    (mean,), (sd,) = fleet.population.mean()
    assert sd / H == pytest.approx(np.hypot(OWN, 0.0) / np.sqrt(MOTORS * EACH), rel=0.3)
    assert abs(mean - H) < 2 * sd
    # About the estimates of each by itself those that came out small count most.
    (alone, deviation) = pooled([parabola(seen, file.motor.H, 0.5 * file.motor.H) for seen in shown.values()])
    assert alone < H - 4 * deviation


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
def test_a_recording_beside_its_make(recording):
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
    # Nothing new is known: it stays where it ended.
    same = Parabola.of_json(analysed(Beside(job, job.file, before))["parabola"])
    assert np.all(np.abs(same.at[told] - first.at[told]) < 0.1 * deviation)
    # A make that is two deviations off, and as sure of it as the recording, draws the point half way towards itself; the
    # likelihood there is still that of the recording, whose top is where it was.
    wrong = dict(zip(("ke", "J"), first.at[told] + 2 * deviation, strict=True))
    known = {key: Knowledge(float(d), "elsewhere") for key, d in zip(wrong, deviation, strict=True)}
    drawn = Parabola.of_json(analysed(Beside(job, job.file.with_values(wrong, known), before))["parabola"])
    moved = (drawn.at[told] - first.at[told]) / deviation
    assert np.all((0.6 < moved) & (moved < 1.4)), moved
    assert np.all(np.abs(top(drawn) - top(first)) < 0.15 * deviation)
