"""The time loop: adaptive steps inside each sample, a rotor that rests, turns, stops and breaks away.

This is ordinary Python that `compile` copies, below the line, into the module it compiles; the step of a motor is handed
in as a function, so the loop is compiled once for all motors. Arrays are copied element by element: numba takes seconds to
compile the checks and messages of a slice assignment.

A current or a speed may be imposed instead (a current-controlled drive, an open terminal; a locked shaft): its state is set
at the sample and follows its slope, its equation is left out, and nothing breaks away.

At rest the load and the friction are sets: the load is a brake that holds with up to its torque either way, and stiction
with up to its own, which may differ with the side. The rotor rests while they can balance the motor's torque, so a load
never drives a resting rotor and a resting rotor does not drift. A step in which the speed passes through zero is cut there,
and a resting rotor breaks away at the instant at which the balance becomes impossible.
"""

import math
from typing import Any

import numpy as np

from motorlens_physics.compile.types import (
    ACCEPTED,
    ACTING,
    ALLOWED,
    CURRENT,
    IMPOSED,
    IMPOSED_SLOPES,
    IMPOSED_VALUES,
    IMPOSES_CURRENT,
    IMPOSES_SPEED,
    LOCKS,
    OPENS,
    REJECTED,
    SHORTED,
    SHORTS,
    SLOPES,
    SLOPES_OF_IMPOSED,
    SPEED,
    TRIAL,
)  # fmt: skip

Vector = Any
# Length of an accepted step may shrink and grow by no more than this.
SHRINK, GROW, SAFETY = 0.2, 6.0, 0.9
# The first step tried in a sample may be this many times the first that was accepted in the one before.
OPENING = 2.0
# Instants at which the rotor stops or breaks away are located to this share of a step.
LOCATED = 1e-9
# Where L stands among the parameters.
INDUCTANCE = 1


# ---- compiled from here on ----
def breaks_away(rest: Any, x: Vector, p: Vector, t: float, u: Vector, ahead: float) -> tuple[float, float]:
    """By how much the torque on a resting rotor exceeds what can hold it (N m), and which way it would turn."""
    with_load, load, forwards, backwards = rest(x, p, t, u, ahead)
    torque = with_load + load
    # Where a friction to one side is less than none, nothing holds the rotor there.
    if torque > 0.0:
        return torque - abs(load) - max(forwards, 0.0), 1.0
    return -torque - abs(load) - max(backwards, 0.0), -1.0


def error_of(x: Vector, y: Vector, e: Vector, atol: Vector, rtol: float) -> float:
    """Largest error in units of the tolerance; infinite if anything is not finite."""
    worst = 0.0
    for j in range(x.size):
        share = abs(e[j]) / (atol[j] + rtol * max(abs(x[j]), abs(y[j])))
        if not share < math.inf:
            return math.inf
        worst = max(worst, share)
    return worst


def act(acting: Vector, k: int, u: Vector) -> None:
    """Put into u the inputs from sample k on, at its begin."""
    for j in range(IMPOSED_SLOPES):
        u[j] = acting[k, j]


def tie(acting: Vector, how: int, k: int, u: Vector) -> None:
    """Put into u what is imposed from sample k on; the values are those of the state."""
    for state in range(2):
        u[IMPOSED_SLOPES + state] = acting[k, SLOPES_OF_IMPOSED + state]
    u[IMPOSED + CURRENT] = 1.0 if how & IMPOSES_CURRENT else 0.0
    u[IMPOSED + SPEED] = 1.0 if how & IMPOSES_SPEED else 0.0
    u[SHORTED] = 1.0 if how & SHORTS else 0.0


def impose(acting: Vector, how: int, k: int, u: Vector, x: Vector, S: Vector, beside: Vector) -> None:
    """Set the states that are imposed from sample k on; they answer to nothing but a constant added to what is given."""
    for state in range(2):
        if u[IMPOSED + state] != 0.0:
            x[state] = acting[k, IMPOSED_VALUES + state]
            if S.size > 0:
                for j in range(S.shape[1]):
                    S[state, j] = 0.0
                none = how & (LOCKS if state == SPEED else OPENS)
                if beside[1 + state] >= 0 and none == 0:
                    S[state, beside[1 + state]] = 1.0


def terminal(
    balance: Any, linear: Any, x: Vector, p: Vector, t: float, u: Vector, to: Any, slopes: Vector
) -> float:
    """The voltage at the terminals, and its sensitivities into `slopes` if there are any."""
    if u[IMPOSED + CURRENT] == 0.0:
        for j in range(slopes.size):
            slopes[j] = 1.0 if j == to.beside[0] and u[SHORTED] == 0.0 else 0.0
        return float(u[0])
    side = 0.0
    if x[SPEED] != 0.0:
        side = 1.0 if x[SPEED] > 0.0 else -1.0
    # The electrical balance, solved for the voltage by Newton's method; all but a bridge's effects are linear in it.
    induced, volts, per_volt = p[INDUCTANCE] * u[IMPOSED_SLOPES], u[0], 1.0
    u[0] = 0.0
    for _ in range(20):
        missing, _ = balance(x, p, t, u, 0.0, side)
        before, away = u[0], 1e-3 * max(abs(u[0]), 1.0)
        u[0] = before + away
        further, _ = balance(x, p, t, u, 0.0, side)
        per_volt = (further - missing) / away
        u[0] = before - (missing - induced) / per_volt
        if abs(u[0] - before) <= 1e-12 * max(abs(u[0]), 1e-3):
            break
    found = float(u[0])
    if slopes.size > 0:
        forced = to.g.shape[2] - 1
        linear(x, p, t, u, 0.0, side, to.slots, to.a[0], to.g[0])
        for j in range(slopes.size):
            change = to.g[0, CURRENT, j] if j < forced and j != to.beside[0] else 0.0
            for c in range(to.S.shape[0]):
                change += to.a[0, CURRENT, c] * to.S[c, j]
            slopes[j] = -change / per_volt
    u[0] = volts
    return found


def begin(S: Vector) -> None:
    """Set the unit perturbations of a sample (see `Variations`) to those of no time."""
    n = S.shape[0]
    first = S.shape[1] - n - 6
    for r in range(n):
        for c in range(n + 6):
            S[r, first + c] = 1.0 if r == c else 0.0


def turn(ratio: float, S: Vector) -> None:
    """The speed passes through zero: its acceleration jumps by this ratio, and so does the sensitivity of the speed.

    Saltation, Leine and Nijmeijer (2004), Dynamics and Bifurcations of Non-Smooth Mechanical Systems, section 7.3.
    """
    for j in range(S.shape[1]):
        S[SPEED, j] *= ratio


def stop(
    step: Any,
    x: Vector,
    p: Vector,
    t: float,
    u: Vector,
    h: float,
    side: float,
    y: Vector,
    e: Vector,
    z: Vector,
) -> float:
    """Shorten a step in which the speed changes its sign so that it ends where the speed is zero; the new length."""
    # Regula falsi in the Illinois form, Dowell and Jarratt (1971), doi:10.1007/BF01934364.
    before, after, w_before, w_after = 0.0, h, x[SPEED], y[SPEED]
    last = 0
    for _ in range(100):
        h = (before * w_after - after * w_before) / (w_after - w_before)
        step(x, p, t, u, h, side, 1.0, y, e, z)
        if abs(y[SPEED]) <= LOCATED * abs(x[SPEED]) or after - before <= LOCATED * after:
            break
        if y[SPEED] * side > 0.0:
            before, w_before = h, y[SPEED]
            w_after *= 0.5 if last == 1 else 1.0
            last = 1
        else:
            after, w_after = h, y[SPEED]
            w_before *= 0.5 if last == -1 else 1.0
            last = -1
    y[SPEED] = 0.0
    return h


def hold(
    step: Any,
    rest: Any,
    x: Vector,
    p: Vector,
    t: float,
    u: Vector,
    h: float,
    excess: float,
    ends: float,
    y: Vector,
    e: Vector,
    z: Vector,
) -> float:
    """Shorten a step of a resting rotor so that it ends where the rotor breaks away; the new length."""
    before, after = 0.0, h
    last = 0
    for _ in range(200):
        if after - before <= LOCATED * after:
            break
        h = (before * ends - after * excess) / (ends - excess)
        # Keep off the ends, so that the bracket shrinks from both sides.
        h = min(max(h, before + 0.1 * LOCATED * after), after - 0.1 * LOCATED * after)
        step(x, p, t, u, h, 0.0, 0.0, y, e, z)
        now, _ = breaks_away(rest, y, p, t, u, h)
        if now <= 0.0:
            before, excess = h, now
            ends *= 0.5 if last == 1 else 1.0
            last = 1
        else:
            after, ends = h, now
            excess *= 0.5 if last == -1 else 1.0
            last = -1
    # At the end it must have broken away, or the next step would find it at rest and cut itself again.
    step(x, p, t, u, after, 0.0, 0.0, y, e, z)
    return after


def keep(S: Vector, kept: Vector, k: int) -> None:
    """Write down the sensitivities of sample k."""
    for r in range(S.shape[0]):
        for j in range(kept.shape[2]):
            kept[k, r, j] = S[r, j]


def integrate(
    step: Any, rest: Any, balance: Any, linear: Any, stiffness: Any, transfer: Any, propagate: Any, given: Any, course: Any,
    out: Vector, to: Any,
) -> int:  # fmt: skip
    """Fill `out`, (N, n) or (N, n + 1) with the terminal voltage, from the state `course.x` at the first sample.

    Returns -1, or the sample where no step was small enough or none is left. The functions are those of
    `compile.source` and `variational`. Sensitivities are carried along into `to` if there are any.
    """
    time, acting, imposed, p, smooth = given.time, given.acting, given.imposed, given.p, given.smooth
    x, carry, atol, rtol = course.x, course.carry, course.atol, course.rtol
    S, kept, matrices = to.S, to.kept, to.matrices
    y, e, z, u = x.copy(), x.copy(), x.copy(), np.zeros(ACTING)
    trial, opening, sensitive, tied = carry[TRIAL], math.inf, S.size > 0, imposed.size > 0
    slopes, n = np.zeros(kept.shape[2]), x.size
    for k in range(time.size):
        act(acting, k, u)
        if tied:
            tie(acting, imposed[k], k, u)
            impose(acting, imposed[k], k, u, x, S, to.beside)
            out[k, n] = terminal(balance, linear, x, p, time[k], u, to, slopes)
        for j in range(n):
            out[k, j] = x[j]
        if kept.size > 0:
            keep(S, kept, k)
            for j in range(slopes.size if tied else 0):
                kept[k, S.shape[0], j] = slopes[j]
        if matrices.size > 0:
            if k > 0:
                first = S.shape[1] - matrices.shape[2]
                for r in range(S.shape[0]):
                    for c in range(matrices.shape[2]):
                        matrices[k - 1, r, c] = S[r, first + c]
            begin(S)
            if tied:
                impose(acting, imposed[k], k, u, x, S, to.beside)
        if k == time.size - 1:
            break
        span = time[k + 1] - time[k]
        turned = u[IMPOSED + SPEED] != 0.0
        if p[INDUCTANCE] == 0.0 and u[IMPOSED + CURRENT] == 0.0:
            # Without inductance the current jumps with the voltage: a step of no length finds it.
            for _ in range(3):
                step(x, p, time[k], u, 1e-9 * span, 1.0, 0.0, y, e, z)
                x[CURRENT] = y[CURRENT]
        past, released = 0.0, 0.0
        # What the inputs do anew at each sample asks for about the same first step each time.
        trial = min(trial, OPENING * opening)
        while past < span:
            carry[ALLOWED] -= 1.0
            if carry[ALLOWED] < 0.0:
                return k
            t = time[k] + past
            for j in range(SLOPES):
                u[j] = acting[k, j] + u[SLOPES + j] * past
            side, go, excess = 0.0, 1.0, 0.0
            if not smooth:
                side = 1.0 if x[SPEED] > 0.0 else -1.0
                if x[SPEED] == 0.0 and not turned:
                    excess, way = breaks_away(rest, x, p, t, u, 0.0)
                    side = way if excess > 0.0 else released
                    go = abs(side)
            if turned:
                go = 0.0
                if x[SPEED] == 0.0:
                    side = 0.0
            left = span - past
            h = min(trial, left)
            # Two equal steps rather than a long one and a crumb.
            if h < left < 2.0 * h:
                h = 0.5 * left
            step(x, p, t, u, h, side, go, y, e, z)
            error = error_of(x, y, e, atol, rtol)
            if not error <= 1.0:
                carry[REJECTED] += 1.0
                trial = h * (max(SHRINK, SAFETY * error**-0.25) if error < math.inf else 0.1)
                if trial < 1e-14 * span or t + trial == t:
                    return k
                continue
            then = side
            if turned:
                pass
            elif side != 0.0 and y[SPEED] * side < 0.0:
                if x[SPEED] == 0.0 and h > LOCATED * span:
                    # The torque changes its direction within the step.
                    trial = 0.1 * h
                    continue
                if x[SPEED] == 0.0:
                    # It would turn against the torque that broke it away: rounding; it rests for this step.
                    go = 0.0
                    step(x, p, t, u, h, side, go, y, e, z)
                else:
                    h = stop(step, x, p, t, u, h, side, y, e, z)
                    excess, way = breaks_away(rest, y, p, t, u, h)
                    then = way if excess > 0.0 else 0.0
            elif go == 0.0:
                ends, way = breaks_away(rest, y, p, t, u, h)
                if ends > 0.0 and excess == 0.0 and released == 0.0:
                    # Nothing holds it: it goes at once.
                    released = way
                    continue
                if ends > 0.0:
                    h = hold(step, rest, x, p, t, u, h, excess, ends, y, e, z)
            end = 1.0 if h == left else (past + h) / span
            if sensitive:
                propagate(linear, stiffness, transfer, x, p, t, u, h, side, go, y, z, past / span, end, to)
                if then != side:
                    _, before = balance(y, p, t, u, h, side)
                    after = 0.0
                    if then != 0.0:
                        _, after = balance(y, p, t, u, h, then)
                    turn(after / before, S)
            for j in range(x.size):
                x[j] = y[j]
            if abs(x[SPEED]) < 1e-200:
                # A free rotor coasts for ever; among denormal numbers no instant of zero speed can be located.
                x[SPEED] = 0.0
            released = 0.0
            carry[ACCEPTED] += 1.0
            opening = h if past == 0.0 else opening
            # The last step of a sample ends exactly there.
            past = span if h == left else past + h
            grown = h * min(GROW, SAFETY * max(error, 1e-8) ** -0.25)
            # A step cut short by the end of a sample says nothing against the longer one that was planned.
            trial = max(grown, trial) if h < trial else grown
    carry[TRIAL] = trial
    return -1
