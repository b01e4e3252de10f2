"""What an observer does when a window is full: predict, compare with the voltage, correct."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from motorlens_train.observer.algebra import congruence, dot, exponential, mixed, probability
from motorlens_train.observer.cold import followed, stored, track_of, walked
from motorlens_train.observer.discrepancies import Window, told
from motorlens_train.observer.file import MEMORY, WINDOW
from motorlens_train.observer.layout import Layout
from motorlens_train.observer.program import Program, Recorder, Value
from motorlens_train.observer.signals import Signals, noise_memory, signals

# Samples further apart than so many windows are a gap. No round number: which side of it a step falls on must not hang
# on the last bit of a clock.
GAP = 50.37
# Odds of the branches are kept within exp(-+50).
MOST_ODDS = 50.0
# What the innovations of about sixteen windows have in common, beyond twice what chance gives: a load's jump before it is
# noticed. It widens the speed.
LAG = 0.125
# Near standstill a load changes by this share of what it does elsewhere, and a brake gives way within this share of what
# the motor's torque asked of it: wider, and a rotor that comes loose slowly is less likely than one that rests in a winding
# that warms.
HOLDS = 0.1
# How often something happens to a motor of which its model knows nothing, per second: once an hour.
UNKNOWN = 1 / 3600


def correct(layout: Layout) -> Program:
    """The program (ambient, state) -> state."""
    r = Recorder()
    ambient = r.input("ambient")
    window = dict(zip(WINDOW, r.inputs(WINDOW), strict=True))
    memory = dict(zip(MEMORY, r.inputs(MEMORY), strict=True))
    known, common = layout.sensitivities(r), layout.common(r)
    track = track_of(layout, r)
    branches = layout.unpack(r)
    # Over a gap nobody knows what was done to the motor.
    gap = r.apply("le", GAP * layout.period, window["time"])
    believed = 1.0 - gap
    found = signals(layout, window, memory, gap)
    share = probability(memory["odds"] + layout.odds)
    pace, settings = layout.motor.R_a0 * layout.motor.J / layout.motor.ke**2, layout.settings
    w, load = layout.at["w"], layout.at["load"]
    (first, P), (second, _) = branches
    speed = first[w] + share * (second[w] - first[w])
    # Whether a rotor rests can be told where its speed is known to within what a rest is, or before anything was measured:
    # elsewhere it may turn, and a load that changes would pass for a winding that warms.
    limit = settings.rest * layout.rated.speed_rad_s
    told_apart = (first[w] * first[w] + P[w][w] <= limit * limit).max(memory["count"] <= 0.0)
    near = (speed.abs() <= limit) * told_apart
    # That a load was changing when the rotor came near standstill is no sign of a rest. (Who comes loose has another load.)
    share = share * (1.0 - near * (0.5 <= memory["calm"]))
    starts = (window["time"] * (1 / (settings.jump_every * pace))).min(0.5)
    leave = (window["time"] * (1 / (settings.jump_lasts * pace))).min(0.5)
    # That a rotor does not rest says nothing of its load: of one that is found turning nobody knows whether that stands
    # still, and after a rest it is as likely to as at any other time.
    unrest = 0.5 - memory["calm"]
    enter = near.select(starts, starts.max(unrest))
    before = share * (1.0 - leave) + (1.0 - share) * enter
    jump = (settings.load_jump * layout.rated.torque_Nm) ** 2 / pace
    still, changing = (
        _advanced(layout, r, *mixed(weight, branches), window, ambient, gap, jumps, starting, rests, found)
        for jumps, starting, rests, weight in (
            (near * (HOLDS**2 * jump), 0.0, 0.0, share * leave / (1.0 - before)),
            (jump, (share <= 0.5) * (1.0 - near), near, share * (1.0 - leave) / before),
        )
    )
    # That a rest foretells more narrowly than a rotor that slides counts at every window, and that it errs by more counts
    # against it. Where rounding or colour is stated larger than what single windows show of it, no window would err, and
    # whoever slides steadily would come to rest: there errors count in terms of what innovations have been. Nothing is
    # stated larger than by rounding, that stays for `lasts` windows (see `signals`). Elsewhere the narrower one is the load
    # that stands still: it is left at that.
    lasts = 2 * pace / layout.period
    as_stated = (memory["restless"] + 1.0).max(1 / lasts).min(1.0)
    errs_less = (still.surprise - changing.surprise) * (near * (0.5 / as_stated - 0.5))
    odds = (before / (1.0 - before)).log() + (changing.log - still.log + errs_less) * believed
    odds = odds.max(-MOST_ODDS).min(MOST_ODDS)
    share = probability(odds)

    def both(a: Any, b: Any) -> Any:
        return a if a is b else a + share * (b - a)

    # What neither branch foretells, by far, has another cause than they know: the states are as unknown as at the start.
    lost = (still.log.max(changing.log) <= changing.fresh + math.log(layout.period * UNKNOWN)) * believed

    one, two = still.window, changing.window
    K, H = ([both(a, b) for a, b in zip(*rows, strict=True)] for rows in ((one.K, two.K), (one.H, two.H)))
    # Of a rotor that rests, speed and load are forgotten.
    F = list(one.F)
    for j in (w, load):
        F[j] = [both(a, b) for a, b in zip(one.F[j], two.F[j], strict=True)]
    filtered = Window(
        both(one.error, two.error), both(one.S, two.S), K, H, F, one.rates, near, one.changes, share
    )  # fmt: skip
    kept, hold, shift = told(layout, known, common, window, memory, found, filtered, believed * (1.0 - lost))
    new = [
        ([x + d for x, d in zip(s.x, shift, strict=True)], _either(lost, layout.covariance, s.P))
        for s in (still, changing)
    ]
    surprise = both(still.surprise, changing.surprise) * believed
    drift = memory["drift"] + believed * LAG * (filtered.error - memory["drift"])
    after = found.memory | noise_memory(
        memory, both(still.own, changing.own), both(still.told, changing.told) * believed, believed
    )
    after |= {
        "odds": odds - layout.odds,
        "calm": near.select(memory["calm"] + unrest * leave - (1.0 - unrest) * starts, 0.5),
        "restless": memory["restless"] + (1 - math.exp(-1 / 100)) * (surprise - 1.0 - memory["restless"]),
        "drift": drift,
        "unseen": (drift * drift - filtered.S * (4 * LAG / (2 - LAG))).max(0.0),
    }
    x, _ = mixed(share, new)
    plain = gap.select(window["current"], window["sum_current"] / window["time"])
    mean = plain + window["sum_bends"] / window["time"]
    rates, A = layout.linearised(r, x, mean, window["voltage"], ambient)
    square = gap.select(mean * mean, window["sum_square"] / window["time"])
    track = followed(
        layout, r, track, x, rates, A, window, mean, square, unseen(layout, window["time"], gap), memory["count"] <= 0.0
    )  # fmt: skip
    # What brakes the rotor, as an acceleration: the next window's samples need it.
    drag = (rates[layout.at["w"]] - mean * (layout.motor.ke / layout.motor.J)) * believed
    begun = {name: window[name] for name in ("alive", "voltage", "current")}
    begun |= {"current_start": window["current"], "drag": drag, "hold": hold}
    fresh = [begun.get(name, 0.0) for name in WINDOW]
    return r.program([*fresh, *(after[name] for name in MEMORY), *kept, *stored(track), *layout.pack(new)])


def _either(first: Any, a: list[list[Any]], b: list[list[Any]]) -> list[list[Any]]:
    """The one covariance or the other."""
    return [[first.select(x, y) for x, y in zip(*rows, strict=True)] for rows in zip(a, b, strict=True)]


def unseen(layout: Layout, T: Any, gap: Any) -> Any:
    """Variance that a gap of T seconds adds to the winding's temperature, K^2."""
    motor, rated = layout.motor, layout.rated
    warming = motor.k0 * (1 + motor.kT * rated.speed_rad_s) * rated.rise_K / motor.H
    return gap.select((T * T * warming**2).min(layout.sd[layout.at["theta"]] ** 2), 0.0)


@dataclass(frozen=True)
class _Step:
    """One branch after a window: states, covariance, squared normalised innovation, logarithm of its likelihood, innovation
    in deviations of white noise, and what `discrepancies` needs."""

    x: list[Any]
    P: list[list[Any]]
    surprise: Any
    log: Any
    own: Any
    told: Any
    fresh: Any
    window: Window


def _advanced(
    layout: Layout, r: Recorder, x: list[Any], P: list[list[Any]], window: Mapping[str, Value], ambient: Any, gap: Any,
    jumps: Any, starting: Any, rests: Any, found: Signals,
) -> _Step:  # fmt: skip
    """One branch over a window: one in which the load walks by a variance of `jumps` a second more, and has been steady
    until now where `starting` is 1; or, where `rests` is 1, one in which the rotor rests."""
    n, T, believed = len(layout.states), window["time"], 1.0 - gap
    V = gap.select(window["voltage"], window["sum_voltage"] / T) - (window["hold"] + 0.5) * found.lean
    plain = gap.select(window["current"], window["sum_current"] / T)
    mean = plain + window["sum_bends"] / T
    square = gap.select(mean * mean, window["sum_square"] / T)
    steps = window["sum_steps"]
    rated, motor, settings = layout.rated, layout.motor, layout.settings

    theta, w, load = layout.at["theta"], layout.at["w"], layout.at["load"]
    R = layout.resistance(r, x)
    limit = 1.5 * rated.speed_rad_s
    # Over a gap the motor is taken to have gone on as it is found, a resting one to have rested; slow states follow for
    # the whole time.
    x[w] = gap.select(((V - R * mean) * (1 / motor.ke)).max(-limit).min(limit), x[w])
    rates, A = layout.linearised(r, x, mean, V, ambient)
    # The copper heats by the mean square of the current, not by the square of its mean.
    rates[theta] = rates[theta] + R * (square - mean * mean) / motor.H
    short = T.min(GAP * layout.period)
    F: list[list[Any]] = [[0.0] * n for _ in range(n)]
    ahead = list(x)
    moves = 1.0 - rests
    # A rotor at rest stays there, its load is whatever the motor's torque asks for, and all that the voltage drives is a
    # current through the resistance. What it creeps by nobody finds: considered and not corrected, so that no length of
    # rest makes the resistance surer than the creep lets it be.
    creep = found.side * found.side * (settings.creep * rated.speed_rad_s) ** 2
    left = (creep / P[w][w]).min(1.0)
    creeping = rests * (creep - left * left * P[w][w])
    for j in range(n):
        own, reach = exponential(A[j][j], short if j in (w, load) else T)
        # What an error of speed or load heats within a window is nothing beside `thermal_walk`.
        cool = j in layout.slow
        F[j] = [
            own if k == j else 0.0 if cool and k in (w, load) else A[j][k] * reach * believed
            for k in range(n)
        ]
        ahead[j] = x[j] + reach * rates[j]
        if j in (w, load):
            F[j], ahead[j] = [entry * moves for entry in F[j]], ahead[j] * moves
    ahead[load] = ahead[load] + rests * (mean * motor.ke)
    ahead[w] = ahead[w] + rests * left * x[w]
    F[w][w] = F[w][w] + rests * left
    # A slope that the load has turned tells nothing of the winding: as the current goes, so does the error of the speed that
    # goes with the winding's (w + R i / ke is what is seen), and where the slope would say otherwise, a jump of the
    # load, late noticed, passes for a warmer or colder winding.
    turned = found.turned * layout.per_kelvin(x) * moves
    before = P[w][theta]
    for j in range(n):
        if j != w:
            P[w][j] = P[j][w] = P[w][j] - turned * P[theta][j]
    P[w][w] = P[w][w] - turned * before - turned * P[w][theta]
    walk = short * ((settings.load_walk * rated.torque_Nm) ** 2 + jumps) + gap * rated.torque_Nm**2
    # It changes at any time of the window: half of it before, half after.
    P[load][load] = P[load][load] + 0.5 * walk
    P = congruence(F, P)
    unsure = (mean - plain) * settings.bend_sd
    shaken = unsure * T * (motor.ke / motor.J)
    P[w][w] = (
        P[w][w]
        + (steps * (motor.ke * layout.i_sd / motor.J) ** 2 + shaken * shaken) * moves
        + creeping
        + (1e-5 * rated.speed_rad_s) ** 2
    )
    P[theta][theta] = P[theta][theta] + walked(layout, T) + unseen(layout, T, gap)
    middle = list(ahead)
    # The mean speed of a window in which the current, and so the acceleration, changes.
    sag = T * (window["current"] - window["current_start"]) * (motor.ke / motor.J / 12) * moves
    middle[w] = 0.5 * (ahead[w] + x[w] * (moves + rests * left)) - sag
    balance, _ = layout.balance(r, middle, mean, V, ambient)
    _, slopes = layout.balance(r, middle, found.weighing, V, ambient)
    error = balance - (window["current"] - window["current_start"]) * motor.L / T
    H = [-slope for slope in slopes]
    # The mean speed, seen from the speed at the end: what drives it reached it halfway.
    H = [H[j] - (0.5 * H[w] * F[w][j] if j != w else 0.0) for j in range(n)]
    changes = window["sum_changes"] / (T * T)
    off = R * unsure
    noise = (
        found.colour * found.white + found.coarse + changes + (settings.model_sd * rated.voltage_V) ** 2
        + off * off
        + (sag * (motor.ke * settings.bend_sd)) * (sag * (motor.ke * settings.bend_sd))
    )  # fmt: skip
    PH = [dot(P[j], H) for j in range(n)]
    S = dot(H, PH) + noise
    # Had it been known no better than at the start.
    S_fresh = dot(H, [dot(row, H) for row in layout.covariance]) + noise
    fresh = _log(error, S_fresh)
    f = [row[load] for row in F]
    g = dot(H, f)
    more = _more(layout, g, error, S, fresh) * starting * believed
    S = S + more * g * g
    PH = [entry + more * g * each for entry, each in zip(PH, f, strict=True)]
    for a, b in layout.pairs:
        P[a][b] = P[a][b] + more * f[a] * f[b]
    # Of an unknown load and an unknown resistance a steady voltage shows only what both do to the speed. A current that the
    # voltage drives tells them apart, or a rotor at rest; without either, slow states are considered and not corrected
    # (Schmidt-Kalman; Jazwinski 1970, ch. 8.4), or each load that jumps, noticed late, would cool the winding.
    # The mean over a gap says nothing about its end.
    gain = believed / S
    best = [PH[j] * gain for j in range(n)]
    fast, own = (w, load), found.free.max(rests)
    K = [best[j] if j in fast else best[j] * own for j in range(n)]
    K[w] = K[w] * moves
    new = [ahead[j] + K[j] * error for j in range(n)]
    for a, b in layout.pairs:
        taken = moves if a == b == w else 1.0 if a in fast or b in fast else own * (2.0 - own)
        P[a][b] = P[a][b] - best[a] * PH[b] * taken
    # A brake gives way at about the torque that it held.
    held = mean * (HOLDS * motor.ke)
    P[load][load] = P[load][load] + 0.5 * walk + rests * (held * held)
    P[w][w] = P[w][w] + gap * rated.speed_rad_s**2
    for j in range(n):
        P[j][j] = P[j][j].max(1e-14 * layout.sd[j] ** 2) if layout.sd[j] else P[j][j]
    new[theta] = new[theta].max(-rated.rise_K).min(4 * rated.rise_K)
    after = (window["voltage"] - R * window["current"]) * (1 / motor.ke)
    fastest = 4 * rated.speed_rad_s
    new[w] = gap.select(after, new[w]).max(-fastest).min(fastest)
    surprise = error * error / S
    expected = S - (found.colour - 1.0) * found.white
    return _Step(
        new,
        P,
        surprise,
        _log(error, S),
        error / expected.sqrt(),
        found.white / expected,
        fresh,
        Window(error, S, K, H, F, rates, 0.0, changes, 0.0),
    )


def _more(layout: Layout, g: Any, error: Any, S: Any, fresh: Any) -> Any:
    """The variance by which a load changes more than it walks, where one that is as unknown as at the start foretells an
    innovation and neither one that walks nor `fresh` states do; `g` is what a N m does to the innovation.

    Loads jump, by any amount, and far more often than what no model knows: then it is that, and nothing else is forgotten.
    """
    settings, motor, most = layout.settings, layout.motor, layout.rated.torque_Nm**2
    rarer = UNKNOWN * settings.jump_every * motor.R_a0 * motor.J / motor.ke**2
    unlikely = _log(error, S) <= fresh + math.log(layout.period * UNKNOWN)
    return unlikely * (fresh + math.log(rarer) <= _log(error, S + g * g * most)) * most


def _log(error: Any, S: Any) -> Any:
    """Logarithm of the likelihood of an innovation of variance S, but for a constant."""
    return (error * error / S + S.log()) * -0.5
