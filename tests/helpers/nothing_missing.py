"""Of worlds in which nothing is missing: what `diagnose` says of each, how right the motor is, and both of all."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from helpers.hidden.score import Rate

from motorlens_workbench.diagnose import Finding
from motorlens_workbench.verdict import settle


@dataclass(frozen=True)
class Told:
    """What was said of one.

    Attributes:
        kind: of the verdict.
        off: by how many stated deviations each parameter is off the truth.
    """

    kind: str
    off: Mapping[str, float]

    @property
    def row(self) -> str:
        """For a table."""
        return f"{self.kind:12s} " + " ".join(f"{off:6.1f}" for off in self.off.values())


def told(found: Finding, truth: Mapping[str, float], keys: Sequence[str]) -> Told:
    """What a diagnosis says, beside the truth."""
    values, sd = found.base.fit.model.values(), found.base.fit.sd()
    return Told(settle(found).kind, {key: (values[key] - truth[key]) / sd[key] for key in keys})


def verdicts(every: Sequence[Told]) -> str:
    """How often what was said, and how often that something is missing."""
    kinds = Counter(one.kind for one in every)
    missing = Rate(len(every) - kinds["adequate"], len(every))
    return (
        "verdicts: " + ", ".join(f"{word} {count}" for word, count in kinds.most_common())
        + f"\nsomething said to be missing: {missing}"
    )  # fmt: skip


def coverage(every: Sequence[Told]) -> str:
    """How often each parameter is within two stated deviations."""
    lines = []
    for key in every[0].off:
        within = Rate(sum(abs(one.off[key]) <= 2 for one in every), len(every))
        lines.append(f"{key:5s} within 2 sd of the truth: {within}")
    return "\n".join(lines)
