"""The time loop: adaptive steps inside each sample, a rotor that rests, turns, stops and breaks away.

This is ordinary Python that `compile` copies, below the line, into the module it compiles; the step of a motor is handed
in as a function, so the loop is compiled once for all motors. Arrays are copied element by element: numba takes seconds to
compile the checks and messages of a slice assignment.

At rest the load and the friction are sets: the load is a brake that holds with up to its torque either way, and stiction
with up to its own. The rotor rests while they can balance the motor's torque, so a load never drives a resting rotor and
a resting rotor does not drift. A step in which the speed passes through zero is cut there, and a resting rotor breaks away
at the instant at which the balance becomes impossible.
"""

import math
from typing import Any

import numpy as np

Vector = Any
# Length of an accepted step may shrink and grow by no more than this.
SHRINK, GROW, SAFETY = 0.2, 6.0, 0.9
# The first step tried in a sample may be this many times the first that was accepted in the one before.
OPENING = 2.0
# Instants at which the rotor stops or breaks away are located to this share of a step.
LOCATED = 1e-9
# Where L stands among the parameters, and w among the states.
INDUCTANCE, SPEED = 1, 1


# ---- compiled from here on ----
def breaks_away(rest: Any, x: Vector, p: Vector, t: float, u: Vector, ahead: float) -> tuple[float, float]:
    """By how much the torque on a resting rotor exceeds what can hold it (N m), and which way it would turn."""
    with_load, load, stiction = rest(x, p, t, u, ahead)
    torque = with_load + load
    return abs(torque) - abs(load) - stiction, 1.0 if torque > 0.0 else -1.0


def error_of(x: Vector, y: Vector, e: Vector, atol: Vector, rtol: float) -> float:
    """Largest error in units of the tolerance; infinite if anything is not finite."""
    worst = 0.0
    for j in range(x.size):
        share = abs(e[j]) / (atol[j] + rtol * max(abs(x[j]), abs(y[j])))
        if not share < math.inf:
            return math.inf
        worst = max(worst, share)
    return worst


def copy(this: Vector, there: Vector) -> None:
    """Copy a matrix element by element."""
    for r in range(this.shape[0]):
        for c in range(this.shape[1]):
            there[r, c] = this[r, c]


def begin(total: Vector) -> None:
    """Set the matrices of a sample (see `variational`) to those of no time."""
    if total.size > 0:
        for r in range(total.shape[1]):
            for c in range(total.shape[2]):
                total[0, r, c] = 1.0 if r == c else 0.0


def turn(ratio: float, S: Vector, total: Vector) -> None:
    """The speed passes through zero: its acceleration jumps by this ratio, and so does the sensitivity of the speed.

    Saltation, Leine and Nijmeijer (2004), Dynamics and Bifurcations of Non-Smooth Mechanical Systems, section 7.3.
    """
    for j in range(S.shape[1]):
        S[SPEED, j] *= ratio
    if total.size > 0:
        for c in range(total.shape[2]):
            total[0, SPEED, c] *= ratio


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


def integrate(
    step: Any, rest: Any, torque: Any, linear: Any, propagate: Any, time: Vector, inputs: Vector, held: int, smooth: bool,
    p: Vector, x: Vector, carry: Vector, atol: Vector, rtol: float, out: Vector,
    S: Vector, work: Any, kept: Vector, matrices: Vector,
) -> int:  # fmt: skip
    """Fill out[1:] from the state x at time[0]; return -1, or the sample where no step was small enough or none is left.

    `step`, `rest`, `torque` and `linear` are functions of `compile.source`, `propagate` is that of `variational`.
    `inputs` is (N, 3); bit j of `held` says that input j holds between samples, else it runs linearly.
    Sensitivities S are carried along if there is a workspace (see `sensitivity`), and kept, with the
    matrices of each sample, where there is room. `carry` keeps the length of the next step between calls, counts accepted
    and rejected steps, and holds how many may yet be tried.
    """
    y, e, z, u = x.copy(), x.copy(), x.copy(), np.zeros(6)
    trial, opening, sensitive = carry[0], math.inf, work[7].size > 0
    for k in range(time.size - 1):
        span = time[k + 1] - time[k]
        for j in range(3):
            u[3 + j] = 0.0 if held >> j & 1 else (inputs[k + 1, j] - inputs[k, j]) / span
        for j in range(3):
            u[j] = inputs[k, j]
        if p[INDUCTANCE] == 0.0:
            # Without inductance the current jumps with the voltage: a step of no length finds it.
            for _ in range(3):
                step(x, p, time[k], u, 1e-9 * span, 1.0, 0.0, y, e, z)
                x[0] = y[0]
        if sensitive:
            begin(work[6])
        past, released = 0.0, 0.0
        # What the inputs do anew at each sample asks for about the same first step each time.
        trial = min(trial, OPENING * opening)
        while past < span:
            carry[3] -= 1.0
            if carry[3] < 0.0:
                return k
            t = time[k] + past
            for j in range(3):
                u[j] = inputs[k, j] + u[3 + j] * past
            side, go, excess = 0.0, 1.0, 0.0
            if not smooth:
                side = 1.0 if x[SPEED] > 0.0 else -1.0
                if x[SPEED] == 0.0:
                    excess, way = breaks_away(rest, x, p, t, u, 0.0)
                    side = way if excess > 0.0 else released
                    go = abs(side)
            left = span - past
            h = min(trial, left)
            # Two equal steps rather than a long one and a crumb.
            if h < left < 2.0 * h:
                h = 0.5 * left
            step(x, p, t, u, h, side, go, y, e, z)
            error = error_of(x, y, e, atol, rtol)
            if not error <= 1.0:
                carry[2] += 1.0
                trial = h * (max(SHRINK, SAFETY * error**-0.25) if error < math.inf else 0.1)
                if trial < 1e-14 * span or t + trial == t:
                    return k
                continue
            then = side
            if side != 0.0 and y[SPEED] * side < 0.0:
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
                propagate(linear, x, p, t, u, h, side, go, y, z, past / span, end, S, work)
                if then != side:
                    after = torque(y, p, t, u, h, then) if then != 0.0 else 0.0
                    turn(after / torque(y, p, t, u, h, side), S, work[6])
            for j in range(x.size):
                x[j] = y[j]
            if abs(x[SPEED]) < 1e-200:
                # A free rotor coasts for ever; among denormal numbers no instant of zero speed can be located.
                x[SPEED] = 0.0
            released = 0.0
            carry[SPEED] += 1.0
            opening = h if past == 0.0 else opening
            # The last step of a sample ends exactly there.
            past = span if h == left else past + h
            grown = h * min(GROW, SAFETY * max(error, 1e-8) ** -0.25)
            # A step cut short by the end of a sample says nothing against the longer one that was planned.
            trial = max(grown, trial) if h < trial else grown
        for j in range(x.size):
            out[k + 1, j] = x[j]
        if kept.size > 0:
            copy(S, kept[k + 1])
        if matrices.size > 0:
            copy(work[6][0], matrices[k])
    carry[0] = trial
    return -1
