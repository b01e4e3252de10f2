"""A fleet from its recordings to its population: what the make lacks is found on some motors, then all are fitted."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.queue import Done
from motorlens_runtime.errors import DataError
from motorlens_workbench.fleet.directions import Observation
from motorlens_workbench.fleet.history import Series, histories
from motorlens_workbench.fleet.manifest import Entry
from motorlens_workbench.fleet.odd import MakeEffect
from motorlens_workbench.fleet.population import Population, needed, population, varies
from motorlens_workbench.fleet.store import Store
from motorlens_workbench.fleet.summary import Parabola, with_candidates
from motorlens_workbench.fleet.work import Again, Job, Task

# How many motors are asked what the make's model lacks, and how often.
ASKED, ADDED = 12, 6
# A parabola is off by about the square of the share by which it is looked at elsewhere than it is used: all recordings are
# looked at again until that is less than this share of a mean's deviation, so often at most.
NEGLIGIBLE, AGAIN = 0.25, 4

Work = Callable[[Sequence[Task]], Iterator[Done[dict[str, Any]]]]


@dataclass(frozen=True)
class Outcome:
    """A recording and its result: the document, or in one line why there is none."""

    entry: Entry
    key: str
    document: dict[str, Any] | None
    failure: str


@dataclass(frozen=True, eq=False)
class Brief:
    """What recordings are worth that are no longer than this.

    Attributes:
        seconds: of the beginnings of all recordings that were fitted alone.
        away: (k,) by how much they lead away from their motors: standard deviations, on the population's scale.
    """

    seconds: float
    away: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Fleet:
    """All that was found.

    Attributes:
        population: of the recordings that could be used.
        outcomes: of all recordings, in the order of the entries.
        effects: that the motor file lacked and most motors have; they are in `population.file`.
        faults: of the sensors with which all were recorded; likewise; part of the make where its motors differ in it.
        histories: of all motors with enough dated recordings.
        diagnoses: motor -> what is missing from the make in it, of those that were diagnosed, see `diagnosis`.
        brief: what brief recordings are worth, if that was asked.
    """

    population: Population
    outcomes: tuple[Outcome, ...]
    effects: tuple[MakeEffect, ...]
    faults: tuple[MakeEffect, ...]
    histories: tuple[Series, ...]
    diagnoses: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    brief: Brief | None = None

    @property
    def make(self) -> MotorFile:
        """The motor file of the make: what may be expected of a motor that was not recorded yet.

        A sensor's fault that all recordings share is the recorder's; one in which motors differ comes with each motor.
        Another recorder may be off as far, either way: of one there is, that is the likeliest spread of all.
        """
        file = self.population.new_motor()
        known, nulls = dict(file.knowledge), {}
        for fault in self.faults:
            if not varies(self.population, fault) and fault.key in known:
                null = file.meaning(fault.key).null or 0.0
                off = file.values()[fault.key] - null
                nulls[fault.key] = null
                known[fault.key] = replace(
                    known[fault.key], sd=float(np.hypot(off, known[fault.key].sd or 0.0))
                )
        file = file.with_values(nulls)
        if self.brief is not None:
            sizes = zip(self.population.keys, self.brief.away * self.population.scale.size, strict=True)
            known |= {key: replace(known[key], brief_sd=float(sd)) for key, sd in sizes if key in known}
            file = replace(file, brief_s=self.brief.seconds)
        return replace(file, knowledge=known)

    @property
    def by_oddness(self) -> tuple[int, ...]:
        """Numbers of all motors, the oddest first."""
        return tuple(np.argsort(-self.population.oddness, kind="stable").tolist())

    @property
    def odd(self) -> tuple[int, ...]:
        """Numbers of the motors that differ from the others, the oddest first."""
        return tuple(m for m in self.by_oddness if self.population.differences[m])

    @property
    def failed(self) -> tuple[Outcome, ...]:
        """Recordings that could not be used."""
        return tuple(outcome for outcome in self.outcomes if outcome.failure)


def results(
    jobs: Sequence[tuple[Entry, Task]], store: Store, work: Work, progress: Callable[[int, int], None]
) -> tuple[Outcome, ...]:
    """The result of every job, from the store where it is there; what is computed is kept at once.

    The longest recordings are worked on first, so that at the end no worker is alone with one (Graham 1969,
    doi:10.1137/0117039); jobs of about one size in the order in which they are given.
    """
    keys: list[str] = []
    failures: dict[int, str] = {}
    for number, (entry, job) in enumerate(jobs):
        if entry.lacks:
            keys.append("")
            failures[number] = entry.lacks
            continue
        try:
            keys.append(job.key())
        except OSError as error:
            keys.append("")
            failures[number] = f"cannot be read: {error.strerror or error}"
    there = {key: found for key in set(keys) if key and (found := store.read(key)) is not None}
    todo = {key: job for key, (_, job) in zip(keys, jobs, strict=True) if key and key not in there}
    said: dict[str, str] = {}
    names = sorted(todo, key=lambda key: -size(todo[key]).bit_length())
    whole = len(there) + len(todo)
    if whole:
        progress(len(there), whole)
    for done in work([todo[key] for key in names]) if todo else ():
        key = names[done.number]
        if done.value is None:
            said[key] = done.failure
        else:
            store.write(key, done.value)
            there[key] = done.value
        progress(len(there) + len(said), whole)
    out = []
    for number, ((entry, _), key) in enumerate(zip(jobs, keys, strict=True)):
        # Read back, so that a fresh result and a kept one are the same to the last digit.
        document = store.read(key) if key in there else None
        failure = failures.get(number, "") or said.get(key, "") or (document or {}).get("failed", "")
        out.append(Outcome(entry, key, None if failure else document, failure))
    return tuple(out)


def size(job: Task) -> int:
    """Bytes of its recordings; 0 of what is not there any more."""
    return sum(path.stat().st_size for path in job.paths if path.exists())


def study(
    entries: Sequence[Entry], template: Job, store: Store, work: Work, *, grow: bool = True,
    brief_s: float | None = None,
    say: Callable[[str], None] = lambda text: None, progress: Callable[[int, int], None] = lambda done, of: None,
) -> Fleet:  # fmt: skip
    """Fit all recordings and make a population of them.

    Args:
        entries: the recordings.
        template: how each is fitted; its path is replaced.
        store: where results are kept.
        work: does the jobs, see `queue`.
        grow: whether effects that most motors have are added to the motor file.
        brief_s: how long the recordings of new motors will be, if it is to be known what those are worth.
        say, progress: told what goes on.

    Raises:
        DataError: no recording can be used.
    """
    added: list[MakeEffect] = []
    dropped: set[str] = set()

    def fitted(some: Sequence[Entry], what: str) -> tuple[tuple[Outcome, ...], Population]:
        say(what)
        file = with_candidates(template.file, [one.name for one in added])
        outcomes = results(
            [(e, replace(template, path=e.path, file=file)) for e in some], store, work, progress
        )
        return outcomes, population(file, observations(outcomes), dropped)

    recorded = [entry for entry in entries if not entry.lacks]
    motors = sorted({entry.motor for entry in recorded})
    some = {motors[int(k)] for k in np.linspace(0, len(motors) - 1, min(ASKED, len(motors)))}
    asked = [entry for entry in recorded if entry.motor in some]
    for _ in range(ADDED if grow else 0):
        _, found = fitted(asked, f"what {len(some)} motors have in common")
        # A name may have stood for another one that was not there yet, and is at its null beside it.
        if needless := [one for one in added if not needed(found, one)]:
            dropped |= {one.key for one in needless}
            added = [one for one in added if one not in needless]
        elif found.lacks is None:
            break
        else:
            added.append(found.lacks)
    outcomes, found = fitted(entries, f"fitting {len(recorded)} recordings of {len(motors)} motors")
    for _ in range(AGAIN):
        say("looking at them again, where their motors are likeliest")
        before, found = found, where_likeliest(found, outcomes, template, store, work, progress)
        if near(before, found):
            break
    brief = None
    if brief_s is not None:
        say(f"fitting their first {brief_s:g} s alone")
        beginnings = [
            (o.entry, replace(template, path=o.entry.path, file=found.file, seconds=brief_s))
            for o in outcomes
            if o.document is not None
        ]
        brief = Brief(brief_s, found.led_away(observations(results(beginnings, store, work, progress))))
    return Fleet(
        found, outcomes, tuple(one for one in added if not one.of_sensor),
        tuple(one for one in added if one.of_sensor), histories(found), brief=brief,
    )  # fmt: skip


def where_likeliest(
    found: Population, outcomes: Sequence[Outcome], template: Job, store: Store, work: Work,
    progress: Callable[[int, int], None],
) -> Population:  # fmt: skip
    """The population from parabolas about where each motor is likeliest given all recordings: its conditional mode.

    Where a recording's own estimate ended, error and information go together: 1/H is what a heating tells, and where H came
    out small it seems well known. Averages of such parabolas are drawn to one side. So are those of estimates that each know
    what the make is: a parameter that only all recordings together tell is anywhere in each of them. About the conditional
    modes, error and information are independent to first order (FOCEI; Wang 2007, doi:10.1007/s10928-007-9060-6).
    """
    used = [outcome for outcome in outcomes if outcome.document is not None]
    likeliest = found.of_recordings()
    jobs = [
        (
            o.entry,
            Again(
                replace(template, path=o.entry.path, file=found.file),
                dict(zip(found.keys, values, strict=True)),
                o.document or {},
            ),
        )
        for o, values in zip(used, likeliest.tolist(), strict=True)
    ]
    return population(found.file, observations(results(jobs, store, work, progress)))


def near(before: Population, found: Population) -> bool:
    """Whether the make as recordings were last looked at is as near to what they say that they need not be again."""
    relative = found.scale.relative
    sd = np.sqrt(np.diagonal(found.solved.covariance))
    return bool(np.all(((found.solved.mean - before.solved.mean) ** 2 <= NEGLIGIBLE * sd)[relative]))


def observations(outcomes: Sequence[Outcome]) -> tuple[Observation, ...]:
    """What the recordings say that could be used. Raises DataError: none of them."""
    used = tuple(
        Observation(o.entry.motor, o.entry.name, o.entry.date, Parabola.of_json(o.document["parabola"]))
        for o in outcomes
        if o.document is not None
    )
    if not used:
        first = outcomes[0]
        raise DataError(
            f"none of {len(outcomes)} recordings can be used; {first.entry.name}: {first.failure}"
        )
    return used
