"""The linear mixed model of two levels, in closed form: recordings of a motor, motors of a make.

phi_r = mu + b_m + rho_r with b_m ~ N(0, Omega), rho_r ~ N(0, Psi), both diagonal, and mu ~ N(0, S); of each recording r of
motor m the log-likelihood of phi_r is h' phi - phi' Lambda phi / 2. All of it is Gaussian, so that levels are integrated out
one after the other. With mu integrated out as well, spreads are estimated by restricted maximum likelihood (Patterson and
Thompson 1971, doi:10.1093/biomet/58.3.545); the gradient to their logarithms is that of Fisher's identity.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

Array = NDArray[np.float64]

# Spreads are looked for between these, in units of a parameter.
LEAST, MOST = 1e-4, 3.0
# Where the search begins.
BEGIN = 0.03
# Twice the logarithm of the likelihood by which a spread must be better than none: the half-half mixture of 0 and
# chi-squared exceeds it in 1 % (Self and Liang 1987, doi:10.1080/01621459.1987.10478472).
HELPS = 5.41


@dataclass(frozen=True, eq=False)
class Data:
    """Parabolas of recordings, centred at what was known beforehand.

    Attributes:
        information: (R, k, k) Lambda.
        vector: (R, k) h.
        motor: (R,) number of the motor of each recording.
        motors: how many.
        known: (k,) standard deviations of mu beforehand; 0 is a parameter whose mean is known to be 0.
        belongs: (M,) whether a motor tells of mu and of the spreads; one that does not is only compared.
    """

    information: Array
    vector: Array
    motor: NDArray[np.intp]
    motors: int
    known: Array
    belongs: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Solved:
    """The model at given spreads.

    Attributes:
        evidence: logarithm of the restricted likelihood.
        mean, covariance: of mu, (k,) and (k, k).
        motor: (M, k) expected b.
        motor_covariance: (M, k, k) of mu + b.
        motor_information: (M, k, k) and `motor_vector` (M, k): what the recordings of each motor say of its mean.
        recording: (R, k) expected phi.
        slopes: (2, k) derivative of the evidence to the logarithms of the spreads; to those of omega where it is (k,).
    """

    evidence: float
    mean: Array
    covariance: Array
    motor: Array
    motor_covariance: Array
    motor_information: Array
    motor_vector: Array
    recording: Array
    slopes: Array


# What `solve` says at spreads between motors and between recordings.
Model = Callable[[Array, Array], Solved]


def solve(data: Data, omega: Array, psi: Array) -> Solved:
    """The model at spreads omega between motors, (k,) or (M, k), and psi between recordings, (k,): standard deviations."""
    count = len(psi)
    identity, belongs = np.eye(count), data.belongs
    counted = belongs[data.motor]
    # Recordings: rho is integrated out.
    scaled = identity + psi[:, None] * data.information * psi
    hidden = psi[:, None] * np.linalg.inv(scaled) * psi
    half = np.einsum("rij,rj->ri", hidden, data.vector)
    each = np.einsum("ri,ri->r", data.vector, half) - np.linalg.slogdet(scaled)[1]
    evidence = 0.5 * float(np.sum(each[counted]))
    through = data.information @ hidden
    information = _summed(data.information - through @ data.information, data)
    vector = _summed(data.vector - np.einsum("rij,rj->ri", through, data.vector), data)
    # Motors: b is integrated out.
    scaled = identity + omega[..., :, None] * information * omega[..., None, :]
    own = omega[..., :, None] * np.linalg.inv(scaled) * omega[..., None, :]
    each = np.einsum("mi,mij,mj->m", vector, own, vector) - np.linalg.slogdet(scaled)[1]
    evidence += 0.5 * float(np.sum(each[belongs]))
    reach = information @ own
    total = np.sum((information - reach @ information)[belongs], axis=0)
    right = np.sum((vector - np.einsum("mij,mj->mi", reach, vector))[belongs], axis=0)
    # The make: mu is integrated out.
    free = data.known > 0
    covariance, mean = np.zeros((count, count)), np.zeros(count)
    width = data.known[free]
    inner = np.eye(len(width)) + width[:, None] * total[np.ix_(free, free)] * width
    covariance[np.ix_(free, free)] = width[:, None] * np.linalg.inv(inner) * width
    mean[free] = covariance[np.ix_(free, free)] @ right[free]
    evidence += 0.5 * float(right @ mean) - 0.5 * float(np.linalg.slogdet(inner)[1])
    # What is expected, with how far mu may be off.
    left = identity - own @ information
    motor = np.einsum("mij,mj->mi", own, vector - information @ mean)
    spread = own + own @ information @ covariance @ information @ own
    together = own + left @ covariance @ np.swapaxes(left, 1, 2)
    beta = (mean + motor)[data.motor]
    rho = np.einsum("rij,rj->ri", hidden, data.vector - np.einsum("rij,rj->ri", data.information, beta))
    moved = hidden @ data.information
    scatter = hidden + moved @ together[data.motor] @ np.swapaxes(moved, 1, 2)
    slopes = np.zeros((2, count))
    of_all = np.zeros(count) if omega.ndim > 1 else omega
    for row, sd, off, about, mine in ((0, of_all, motor, spread, belongs), (1, psi, rho, scatter, counted)):
        on = sd > 0
        squares = np.sum((off**2 + np.diagonal(about, axis1=1, axis2=2))[mine], axis=0)
        slopes[row, on] = squares[on] / sd[on] ** 2 - np.count_nonzero(mine)
    return Solved(float(evidence), mean, covariance, motor, together, information, vector, beta + rho, slopes)


def _summed(values: Array, data: Data) -> Array:
    total = np.zeros((data.motors, *values.shape[1:]))
    np.add.at(total, data.motor, values)
    return total


@dataclass(frozen=True, eq=False)
class Misfit:
    """By how much each motor is off the mean of the make, in every direction.

    Attributes:
        score: (M, k) derivative of the likelihood of each motor to a shift of its own parameter.
        information: (M, k, k) of the shift, spreads and the uncertainty of the mean taken into account.
        limits: (2, k) least and greatest shift that is possible, at most and at least 0.
    """

    score: Array
    information: Array
    limits: Array

    def shifts(self) -> Array:
        """(M, k) the likeliest shift of one parameter alone."""
        information = np.diagonal(self.information, axis1=1, axis2=2)
        told = information > 0
        return np.asarray(
            np.clip(np.where(told, self.score / np.where(told, information, 1.0), 0.0), *self.limits)
        )

    def gains(self) -> Array:
        """(M, k) twice the logarithm of the likelihood gained by that shift."""
        shift, information = self.shifts(), np.diagonal(self.information, axis1=1, axis2=2)
        return np.asarray(shift * (2 * self.score - information * shift))

    def where(self, allowed: NDArray[np.bool_]) -> "Misfit":
        """Without shifts that are not allowed, (M, k)."""
        table = self.information * allowed[:, :, None] * allowed[:, None, :]
        return Misfit(self.score * allowed, table, self.limits)

    def given(self, m: int, k: int) -> "Misfit":
        """With the likeliest shift of parameter k of motor m."""
        score, information = self.score.copy(), self.information.copy()
        column = information[m, :, k] / information[m, k, k]
        score[m] -= information[m, :, k] * self.shifts()[m, k]
        information[m] -= np.outer(column, information[m, k])
        # What is left of a direction that is nearly the same is rounding.
        gone = np.diagonal(information[m]) < 1e-9 * np.diagonal(self.information[m])
        score[m, gone] = 0.0
        information[m][gone, :], information[m][:, gone] = 0.0, 0.0
        return Misfit(score, information, self.limits)


def misfit(data: Data, omega: Array, psi: Array, bounds: Array | None = None) -> Misfit:
    """How each motor differs from the mean.

    Args:
        data: of the recordings.
        omega, psi: (k,) spreads between motors, and between recordings.
        bounds: (2, k) between which the parameters of a motor are; None is anywhere.
    """
    solved, identity = solve(data, omega, psi), np.eye(len(psi))
    scaled = identity + omega[:, None] * solved.motor_information * omega
    reach = solved.motor_information @ (omega[:, None] * np.linalg.inv(scaled) * omega)
    table = solved.motor_information - reach @ solved.motor_information
    vector = solved.motor_vector - np.einsum("mij,mj->mi", reach, solved.motor_vector)
    score = vector - np.einsum("mij,j->mi", table, solved.mean)
    # A motor that belongs has drawn the mean to itself, and varies less about it; for a stranger, the mean is off besides.
    drawn = table - table @ solved.covariance @ table
    apart = np.linalg.inv(identity + table @ solved.covariance)
    belongs = data.belongs
    information = np.where(belongs[:, None, None], drawn, apart @ table)
    score = np.where(belongs[:, None], score, np.einsum("mij,mj->mi", apart, score))
    within = np.array([[-np.inf], [np.inf]]) if bounds is None else bounds - solved.mean
    limits = np.stack([np.minimum(within[0], 0.0), np.maximum(within[1], 0.0)])
    return Misfit(score, information, np.broadcast_to(limits, (2, len(psi))))


@dataclass(frozen=True, eq=False)
class Spreads:
    """Spreads by restricted maximum likelihood.

    Attributes:
        omega: (k,) between motors; 0 where it is not told.
        psi: (k,) between recordings of one motor; 0 where it does not help.
        told: (2, k) whether each is told: nothing else that may differ does for it, see `_told`.
        sd: (2, k) standard deviations of those that are told; NaN of the others.
        likely: (2, k) root mean square, of those that are not told too, see `_reckoned`: what is to be reckoned with. One
            that is not told is within what was known of its parameter beforehand.
    """

    omega: Array
    psi: Array
    told: NDArray[np.bool_]
    sd: Array
    likely: Array


def spreads(data: Data) -> Spreads:
    """Estimate the spreads that help; say which of them are told."""
    allowed = np.ones((2, len(data.known)), dtype=bool)
    if np.count_nonzero(data.belongs) < 2:
        allowed[0] = False
    if np.all(np.bincount(data.motor) < 2):
        allowed[1] = False
    model = partial(solve, data)
    on, at = _helpful(data, model, allowed)
    told = _told(model, allowed, on, at)
    sd = _deviations(data, on, at)
    likely = np.where(
        told,
        np.hypot(at, np.nan_to_num(sd)),
        _reckoned(model, allowed & ~told, at, possible(data.known)),
    )
    return Spreads(np.where(told[0], at[0], 0.0), at[1], told, np.where(told, sd, np.nan), likely)


def _helpful(data: Data, model: Model, allowed: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], Array]:
    """(2, k) which spreads help, and where they are likeliest: what does not is left out, the least helpful first.

    Two that do for one another may both be left out at once, or the better one for the worse. So each that was left out is
    tried again beside those that stay, once; if it helps, another one may be of no use any more.
    """
    on, left = allowed, allowed.copy()
    at = _likeliest(model, on, np.where(on, BEGIN, 0.0))
    while True:
        on, at = _without_useless(data, model, on, at)
        best, again = model(*at).evidence + 0.5 * HELPS, None
        # Of the two of a parameter of which neither stays, that between motors is tried.
        tried = left & ~on & np.array([np.ones_like(on[0]), on[0] | ~allowed[0]])
        for row, k in np.argwhere(tried):
            more = on.copy()
            more[row, k] = True
            there = _likeliest(model, more, np.where(more & ~on, BEGIN, at))
            if (evidence := model(*there).evidence) >= best:
                best, again = evidence, (row, k, more, there)
        if again is None:
            return on, at
        row, k, on, at = again
        left[row, k] = False


def _without_useless(
    data: Data, model: Model, on: NDArray[np.bool_], at: Array
) -> tuple[NDArray[np.bool_], Array]:
    while on.any():
        gains = _gains(data, on, at)
        useless = on & (gains < HELPS)
        # Of two spreads that do for one another, that between motors stays.
        useless[0] &= ~useless[1]
        if not useless.any():
            break
        # Several at once where they are of no use at all: removing them does not change the others.
        weakest = useless & ((gains < 0.1) | (gains == gains[useless].min()))
        on, at = on & ~weakest, np.where(weakest, 0.0, at)
        at = _likeliest(model, on, at)
    return on, at


def possible(known: Array) -> Array:
    """(k,) by how much motors may differ where that is not told: by all that was known, at most by a parameter's size."""
    return np.minimum(known, 1.0)


def led_away(data: Data, motor: Array, sd: Array) -> Array:
    """(k,) by how much recordings lead away from their motors, which are known: root mean squares, see `_reckoned`.

    Of a parameter that they do not tell they may lead anywhere.

    Args:
        data: of the recordings; what is known of the mean counts for nothing.
        motor, sd: (M, k) what is known of each motor.
    """
    moved = np.einsum("rij,rj->ri", data.information, motor[data.motor])
    about = replace(data, vector=data.vector - moved, known=np.zeros(len(data.known)))
    on = np.array([[False], [True]]) & np.ones(len(data.known), dtype=bool)

    def model(omega: Array, psi: Array) -> Solved:
        return solve(about, sd, psi)

    at = _likeliest(model, on, np.where(on, 0.1, 0.0))
    return np.asarray(_reckoned(model, on, at, np.full(len(data.known), MOST))[1])


def _gains(data: Data, on: NDArray[np.bool_], at: Array) -> Array:
    """(2, k) by how much twice the evidence falls without each spread, the other one of its parameter made up for it.

    Where a motor has one recording that tells a parameter, its two spreads are told as one.
    """
    whole, gains = solve(data, *at).evidence, np.full(on.shape, np.inf)
    for row, k in np.argwhere(on):
        without = at.copy()
        without[row, k] = 0.0
        best = solve(data, *without).evidence
        if on[1 - row, k]:
            without[1 - row, k] = np.hypot(*at[:, k])
            best = max(best, solve(data, *without).evidence)
        gains[row, k] = 2 * (whole - best)
    return gains


def _told(model: Model, allowed: NDArray[np.bool_], on: NDArray[np.bool_], at: Array) -> NDArray[np.bool_]:
    """(2, k) which spreads are told: with every other one that is allowed at its likeliest, they are better than none.

    That is what the distribution of `HELPS` is of. Of two parameters that recordings tell together each spread would seem to
    be needed with the other held where it is, and either does alone; which of them was left out first says nothing.
    """
    told = on.copy()
    for row, k in np.argwhere(on):
        # Where the two spreads of one parameter are told as one, it is that between motors.
        free = allowed.copy()
        free[1 - row, k] = on[1 - row, k]
        begin = np.where(free & ~on, BEGIN, at)
        whole = _likeliest(model, free, begin)
        free[row, k] = False
        without = np.where(free, whole, 0.0)
        without[1 - row, k] = np.hypot(*whole[:, k]) * free[1 - row, k]
        begin[row, k] = 0.0
        least = max(model(*_likeliest(model, free, start)).evidence for start in (without, begin))
        told[row, k] = 2 * (model(*whole).evidence - least) >= HELPS
    return told


def _likeliest(model: Model, on: NDArray[np.bool_], at: Array) -> Array:
    """(2, k) spreads at which the evidence is greatest: those that are on are sought, the others stay."""
    if not on.any():
        return at

    def spread(logarithms: Array) -> Array:
        sd = at.copy()
        sd[on] = np.exp(logarithms)
        return sd

    def solved(logarithms: Array) -> Solved:
        return model(*spread(logarithms))

    begin = np.log(np.clip(at[on], 2 * LEAST, MOST / 2))
    # The search ends where a step wins a small share of the cost, which must not hold what no spread changes: the squares of
    # what recordings say, in units of their noise, are millions.
    least = solved(begin).evidence

    def cost(logarithms: Array) -> tuple[float, Array]:
        here = solved(logarithms)
        return least - here.evidence, -here.slopes[on]

    limits = [(np.log(LEAST), np.log(MOST))] * int(on.sum())
    end = minimize(cost, begin, jac=True, method="L-BFGS-B", bounds=limits, options={"maxiter": 200})
    return spread(end.x)


def _deviations(data: Data, on: NDArray[np.bool_], at: Array) -> Array:
    """From the curvature of the evidence at its top; NaN where it is none."""
    out, places, step = np.full(at.shape, np.nan), np.argwhere(on), 0.02
    if not len(places):
        return out
    curvature = np.empty((len(places), len(places)))
    for j, (row, k) in enumerate(places):
        sides = []
        for sign in (1, -1):
            moved = at.copy()
            moved[row, k] *= np.exp(sign * step)
            sides.append(solve(data, *moved).slopes[on])
        curvature[j] = (sides[1] - sides[0]) / (2 * step)
    values, vectors = np.linalg.eigh(0.5 * (curvature + curvature.T))
    variance = np.diagonal((vectors / np.maximum(values, 1e-6)) @ vectors.T)
    out[on] = np.sqrt(variance) * at[on]
    return out


def _reckoned(model: Model, asked: NDArray[np.bool_], at: Array, most: Array) -> Array:
    """Root mean square of each spread that is asked for, over its profile likelihood and an even prior of its square.

    Up to `most`, (k,): of one that is not told, what was known of the parameter itself beforehand. Were larger ones taken
    for possible and only the result held to that, motors of one make would be said to differ by all of it.

    The others are the likeliest beside each size of it. As they were without it, they stand for what motors truly differ by
    in it wherever recordings tell two parameters together, and the more motors there are, the surer it seems to be small.
    With a prior that is even in the spread itself, small spreads are likelier beforehand, and motors are drawn too far to
    the mean; with this one, intervals hold (Morris and Lysy 2012, doi:10.1214/11-STS363).
    """
    out = at.copy()
    for row, k in np.argwhere(asked):
        logs, beside, on = [], at.copy(), at > 0
        on[row, k] = False
        grid = np.geomspace(min(1e-3, 0.1 * most[k]), most[k], 13)
        for size in grid:
            beside[row, k] = size
            beside = _likeliest(model, on, beside)
            logs.append(model(*beside).evidence)
        weight = np.exp(np.array(logs) - max(logs)) * grid**2  # the grid is even in the logarithm
        weight[[0, -1]] *= 0.5
        out[row, k] = np.sqrt(np.sum(weight * grid**2) / np.sum(weight))
    return out
