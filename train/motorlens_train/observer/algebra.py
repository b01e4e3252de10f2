"""Small matrices of recorded values, and functions of them, of which zeros are not recorded."""

from collections.abc import Sequence
from typing import Any

from motorlens_train.observer.program import Recorder, Value

# States and covariance of one branch.
Branch = tuple[list[Any], list[list[Any]]]


def bend(r: Recorder, h: Value, tau: float) -> Any:
    """tau / h - coth(h / (2 tau)) / 2, which is -h / (12 tau) for short steps; 0 without inductance."""
    if tau <= 0.0:
        return 0.0
    decay = (h * (-1 / tau)).exp()
    short = h <= 1e-3 * tau
    safe = short.select(tau, h)
    away = short.select(0.5, decay)
    return short.select(h * (-1 / (12 * tau)), tau / safe - 0.5 * (1.0 + away) / (1.0 - away))


def dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    """Inner product."""
    total: Any = 0.0
    for left, right in zip(a, b, strict=True):
        if not (isinstance(left, float) and left == 0.0) and not (isinstance(right, float) and right == 0.0):
            total = total + left * right
    return total


def congruence(F: Sequence[Sequence[Any]], P: Sequence[Sequence[Any]]) -> list[list[Any]]:
    """F P F^T, of which the upper half is computed."""
    n = len(F)
    FP = [[dot(F[a], [P[k][b] for k in range(n)]) for b in range(n)] for a in range(n)]
    out: list[list[Any]] = [[0.0] * n for _ in range(n)]
    for a in range(n):
        for b in range(a, n):
            out[a][b] = out[b][a] = dot(FP[a], F[b])
    return out


def exponential(rate: Any, T: Any) -> tuple[Any, Any]:
    """exp(rate T), and its integral over the window."""
    if isinstance(rate, float) or rate.number is not None:
        number = rate if isinstance(rate, float) else rate.number
        if number == 0.0:
            return 1.0, T
    decay = (rate * T).exp()
    small = (rate * T).abs() <= 1e-7
    return decay, small.select(T, (decay - 1.0) / small.select(1.0, rate))


def probability(odds: Any) -> Any:
    """Probability from the logarithm of the odds."""
    return 1.0 / ((-odds).exp() + 1.0)


def mixed(share: Any, branches: Sequence[Branch]) -> Branch:
    """Mean and covariance of the two branches' mixture, the second with weight `share`."""
    (x0, P0), (x1, P1) = branches
    n, spread = len(x0), share * (1.0 - share)
    apart = [b - a for a, b in zip(x0, x1, strict=True)]
    x = [a + share * d for a, d in zip(x0, apart, strict=True)]
    P: list[list[Any]] = [[0.0] * n for _ in range(n)]
    for a in range(n):
        for b in range(a, n):
            P[a][b] = P[b][a] = P0[a][b] + share * (P1[a][b] - P0[a][b]) + spread * apart[a] * apart[b]
    return x, P
