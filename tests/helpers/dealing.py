"""Which worker of pytest-xdist runs which tests first."""

import pytest

# Marks of what takes long, see `conftest.py`; and about how long a test does, in seconds.
TIERS = {"fit": 1, "blind": 20, "long": 40}


def dealt(items: list[pytest.Item], workers: int) -> list[list[pytest.Item]]:
    """One share of the tests for each worker, the long ones early: of `blind` cases each may go to another worker, of `fit`
    tests a file stays together, for its fixtures. The first worker begins with them, and compiles what all of them need;
    the others begin with what is quick, where they would only wait for it.

    Pytest-xdist (worksteal) gives each worker as many tests, one after the other as they were collected; and who has nothing
    left takes the last half of what another has to do, never what comes next.
    """
    sizes = [(len(items) + k) // workers for k in range(workers)]
    groups: dict[object, list[pytest.Item]] = {}
    for item in items:
        groups.setdefault(item if item.get_closest_marker("blind") else item.path, []).append(item)
    shares: list[list[pytest.Item]] = [[] for _ in range(workers)]
    costs, quick = [0] * workers, []
    for group in sorted(groups.values(), key=_length, reverse=True):
        cost = _cost(group)
        roomy = [k for k in range(workers) if len(shares[k]) + len(group) <= sizes[k]]
        if not cost or not roomy:
            quick += group
            continue
        to = min(roomy, key=costs.__getitem__)
        shares[to] += group
        costs[to] += cost
    for k, size in enumerate(sizes):
        missing = size - len(shares[k])
        shares[k] = shares[k] + quick[:missing] if k == 0 else quick[:missing] + shares[k]
        del quick[:missing]
    return shares


def _length(group: list[pytest.Item]) -> tuple[int, int]:
    """Of the longest test of a group, and of the group."""
    return max(_cost([item]) for item in group), _cost(group)


def _cost(group: list[pytest.Item]) -> int:
    """How long tests take, about, in seconds."""
    return sum(
        max((s for mark, s in TIERS.items() if item.get_closest_marker(mark)), default=0) for item in group
    )
