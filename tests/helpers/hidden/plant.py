"""The motor behind the hidden-effect recordings: its own equations, its own integrator, nothing of the packages.

Alexander's three-stage SDIRK (1977, doi:10.1137/0714068: order 3, L-stable) with Newton on current and speed and
fixed-point iteration on the slow states. Friction is set-valued: between reversals its direction is a constant of the
step, a reversal and a breakaway are located inside the step, and at rest the rotor sticks while the driving torque is
within the holding torque. Inputs are linear between samples.
"""

from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# States: current A, speed rad/s, winding rise K, angle rad, housing rise K, magnet rise K, bristle rad, load-side speed
# rad/s, twist rad, iron heat under way J.
I, W, THETA, PHI, HOUSING, MAGNET, BRISTLE, W_LOAD, TWIST, UNDER_WAY = range(10)  # noqa: E741
STATES = 10
# Inputs, linear between samples: terminal voltage V, load torque N m, ambient minus nominal K, extra series resistance ohm,
# flux factor.
VOLTAGE, LOAD, AMBIENT, SERIES, FLUX = range(5)
INPUTS = 5

# name -> null. The first ten are the textbook's; the rest are the hidden physics (see effects.py for what each is).
DEFAULTS: dict[str, float] = {
    "R": 1.0, "L": 1e-3, "ke": 0.1, "J": 1e-4, "b": 0.0, "alpha": 0.004, "k0": 1.0, "kT": 0.0, "k_ir": 0.0, "H": 100.0,
    "brush_V": 0.0, "brush_i": 0.05, "dead_V": 0.0, "dead_i": 0.05, "L_sat": 0.0, "L_speed": 0.0, "K_B": 0.0,
    "reaction": 0.0, "magnet_k": 0.0, "magnet_f": 0.7, "magnet_tau": 1000.0, "tau_c": 0.0, "tau_s": 0.0, "w_k": 5.0,
    "drag": 0.0, "mu": 0.0, "tau_d": 0.0, "kappa": 0.0, "cog": 0.0, "cog_N": 12.0, "cog_p": 0.0, "unbalance": 0.0,
    "unbalance_p": 0.0, "iron_brake": 0.0, "tau_0": 0.0, "stray": 0.0, "node_G": 0.0, "node_k": 1.0, "node_H": 1.0,
    "radiation": 0.0, "ambient_K": 293.15, "friction_heat": 0.0, "hysteresis": 0.0, "fan_n": 1.0, "fan_w": 1.0, "bump": 0.0,
    "bump_w": 100.0,
    "bump_width": 10.0, "bounce_R": 0.0, "bounce_w": 1e9, "thermostat": 0.0, "thermostat_on": 1e9, "thermostat_off": 1e9,
    "shaft_k": 0.0, "shaft_c": 0.0, "shaft_gap": 0.0, "shaft_share": 0.0, "bristle_k": 0.0, "bristle_tau": 0.0,
    "run_in": 0.0, "run_in_tau": 1e9,
    "supply_R": 0.0, "coasting": 0.0, "bus_V": 1.0, "ripple": 0.0, "ripple_N": 6.0, "ripple_p": 0.0, "delay": 0.0,
    "delay_tau": 100.0,
}  # fmt: skip
INDEX = {name: index for index, name in enumerate(DEFAULTS)}
(
    _R, _L, _KE, _J, _B, _ALPHA, _K0, _KT, _KIR, _H, _BRUSH, _BRUSH_I, _DEAD, _DEAD_I, _LSAT, _LSPEED, _KB, _REACT,
    _MAGNET, _MAGNET_F, _MAGNET_TAU, _TC, _TS, _WK, _DRAG, _MU, _TD, _KAPPA, _COG, _COG_N, _COG_P, _UNB, _UNB_P, _BRAKE, _T0,
    _STRAY, _NODE_G, _NODE_K, _NODE_H, _RAD, _TA, _FHEAT, _HYST, _FAN_N, _FAN_W, _BUMP, _BUMP_W, _BUMP_D, _BOUNCE, _BOUNCE_W,
    _THERMO, _THERMO_ON, _THERMO_OFF, _SK, _SC, _SGAP, _SSHARE, _BRK, _BRT, _RUNIN, _RUNIN_TAU,
    _SUPPLY, _COAST, _BUS, _RIPPLE, _RIPPLE_N, _RIPPLE_P, _DELAY, _DELAY_TAU,
) = range(len(DEFAULTS))  # fmt: skip

_GAMMA = 0.43586652150845899942
_A21 = (1 - _GAMMA) / 2
_B1 = -(6 * _GAMMA**2 - 16 * _GAMMA + 1) / 4
_B2 = (6 * _GAMMA**2 - 20 * _GAMMA + 5) / 4


def vector(**values: float) -> Array:
    """A parameter vector: the defaults, with some values changed by name."""
    p = np.array(list(DEFAULTS.values()))
    for name, value in values.items():
        p[INDEX[name]] = value
    return p


@nb.njit(cache=True)
def _flux(x, u, p):
    flux = p[_KE] * u[FLUX] * (1 - p[_MAGNET] * x[MAGNET]) / (1 + p[_REACT] * x[I] ** 2)
    if p[_RIPPLE] != 0:
        flux *= 1 + p[_RIPPLE] * np.cos(p[_RIPPLE_N] * x[PHI] + p[_RIPPLE_P])
    return flux


@nb.njit(cache=True)
def holding(x, u, t, p):
    """Coulomb-like torques at this speed, N m, without their direction: (forwards, backwards)."""
    w = abs(x[W])
    torque = p[_TC] + p[_HYST] + p[_RUNIN] * np.exp(-t / p[_RUNIN_TAU])
    if p[_TS] != 0:
        torque += p[_TS] * np.exp(-((w / p[_WK]) ** 2))
    if p[_BUMP] != 0:
        torque += p[_BUMP] * np.exp(-(((w - p[_BUMP_W]) / p[_BUMP_D]) ** 2))
    if p[_MU] != 0:
        torque += p[_MU] * abs(_flux(x, u, p) * x[I] + u[LOAD]) / 2
    return torque + p[_TD], torque


@nb.njit(cache=True)
def driving(x, u, p):
    """Torque on the rotor apart from the Coulomb-like ones, N m."""
    i, w = x[I], x[W]
    viscous = p[_B] * np.exp(-p[_KAPPA] * x[THETA]) if p[_KAPPA] != 0 else p[_B]
    torque = (
        _flux(x, u, p) * i
        - (viscous + p[_BRAKE] * p[_KIR] + p[_STRAY] * i * i) * w
        - p[_DRAG] * w * abs(w)
        - p[_T0]
    )
    if p[_COG] != 0:
        torque -= p[_COG] * np.sin(p[_COG_N] * x[PHI] + p[_COG_P])
    if p[_UNB] != 0:
        torque -= p[_UNB] * np.sin(x[PHI] + p[_UNB_P])
    if p[_BRK] != 0:
        torque -= p[_BRK] * x[BRISTLE]
    return torque - (_shaft(x, p) if p[_SSHARE] > 0 else u[LOAD])


@nb.njit(cache=True)
def _shaft(x, p):
    gap = p[_SGAP] / 2
    stretch = max(abs(x[TWIST]) - gap, 0.0) * np.sign(x[TWIST])
    return p[_SK] * stretch + p[_SC] * abs(stretch) * (
        x[W] - x[W_LOAD]
    )  # after Hunt and Crossley: no jump on contact


@nb.njit(cache=True)
def rates(x, u, t, mode, fan_on, p, out):
    """Time derivatives of the ten states. `mode` is the direction of motion: 1, -1, or 0 for a rotor that sticks."""
    i, w, theta = x[I], x[W], x[THETA]
    speed = abs(w)
    resistance = p[_R] * (1 + p[_ALPHA] * theta) + u[SERIES]
    if p[_KB] != 0:
        resistance += p[_KB] * speed
    if p[_BOUNCE] != 0 and speed > p[_BOUNCE_W]:
        resistance += p[_BOUNCE] * (speed / p[_BOUNCE_W] - 1)
    drop = 0.0
    if p[_BRUSH] != 0:
        drop = p[_BRUSH] * i / np.sqrt(i * i + p[_BRUSH_I] ** 2)
    lost = drop + p[_SUPPLY] * i
    if p[_COAST] != 0:
        lost -= p[_COAST] * (1 - abs(u[VOLTAGE]) / p[_BUS]) * _flux(x, u, p) * w
    if p[_DEAD] != 0:
        lost += p[_DEAD] * i / np.sqrt(i * i + p[_DEAD_I] ** 2)
    inductance = p[_L]
    if p[_LSAT] != 0:
        inductance /= 1 + p[_LSAT] * i * i
    if p[_LSPEED] != 0:
        inductance *= 1 - p[_LSPEED] * speed
    out[I] = (u[VOLTAGE] - resistance * i - _flux(x, u, p) * w - lost) / inductance

    forwards, backwards = holding(x, u, t, p)
    friction = forwards if mode > 0 else -backwards
    inertia = p[_J] * (1 - p[_SSHARE])
    out[W] = 0.0 if mode == 0 else (driving(x, u, p) - friction) / inertia
    out[PHI] = w
    if p[_BRK] != 0:
        out[BRISTLE] = w - speed * x[BRISTLE] * p[_BRK] / p[_BRT]
    if p[_SSHARE] > 0:
        out[W_LOAD] = (_shaft(x, p) - u[LOAD]) / (p[_J] * p[_SSHARE])
        out[TWIST] = w - x[W_LOAD]

    heat = resistance * i * i + p[_KIR] * w * w + drop * i + p[_HYST] * speed + p[_STRAY] * (i * w) ** 2
    if p[_FHEAT] != 0:
        heat += p[_FHEAT] * (p[_B] * w * w + (friction - mode * p[_HYST]) * w)
    # The air is `AMBIENT` warmer than nominal; the winding's rise is counted from the nominal.
    over = theta - u[AMBIENT]
    fan = p[_KT] * speed
    if p[_FAN_N] != 1:
        fan = p[_KT] * p[_FAN_W] * (speed / p[_FAN_W]) ** p[_FAN_N]
    blown = 1 + fan + (p[_THERMO] if fan_on else 0.0)
    cooling = p[_K0] * blown * over
    if p[_RAD] != 0:
        air = p[_TA] + u[AMBIENT]
        cooling += p[_RAD] * ((air + over) ** 4 - air**4) / (4 * p[_TA] ** 3)
    if p[_NODE_G] > 0:
        passed = p[_NODE_G] * (theta - x[HOUSING])
        out[HOUSING] = (passed - p[_NODE_K] * blown * (x[HOUSING] - u[AMBIENT])) / p[_NODE_H]
        heat -= passed
    if p[_DELAY] != 0:
        out[UNDER_WAY] = p[_DELAY] * p[_KIR] * w * w - x[UNDER_WAY] / p[_DELAY_TAU]
        heat -= out[UNDER_WAY]
    out[THETA] = (heat - cooling) / p[_H]
    out[MAGNET] = (p[_MAGNET_F] * theta - x[MAGNET]) / p[_MAGNET_TAU]


@nb.njit(cache=True)
def _stage(base, h, u, t, mode, fan_on, p, x, k):
    """Solve x = base + h gamma f(x) for the stage value x; k is f(x)."""
    g = h * _GAMMA
    for _ in range(40):
        rates(x, u, t, mode, fan_on, p, k)
        flux = _flux(x, u, p)
        inductance = p[_L] / (1 + p[_LSAT] * x[I] ** 2) * (1 - p[_LSPEED] * abs(x[W]))
        resistance = p[_R] * (1 + p[_ALPHA] * x[THETA]) + u[SERIES] + p[_SUPPLY] + p[_KB] * abs(x[W])
        if p[_BRUSH] != 0:
            resistance += p[_BRUSH] * p[_BRUSH_I] ** 2 / (x[I] ** 2 + p[_BRUSH_I] ** 2) ** 1.5
        if p[_DEAD] != 0:
            resistance += p[_DEAD] * p[_DEAD_I] ** 2 / (x[I] ** 2 + p[_DEAD_I] ** 2) ** 1.5
        inertia = p[_J] * (1 - p[_SSHARE])
        moving = 1.0 if mode != 0 else 0.0
        slope = p[_KB]
        if p[_BOUNCE] != 0 and abs(x[W]) > p[_BOUNCE_W]:
            slope += p[_BOUNCE] / p[_BOUNCE_W]
            resistance += p[_BOUNCE] * (abs(x[W]) / p[_BOUNCE_W] - 1)
        bb = g * (flux + slope * x[I] * np.sign(x[W])) / inductance
        a = 1 + g * resistance / inductance
        c = -g * flux / inertia * moving
        d = 1 + g * (p[_B] + 2 * p[_DRAG] * abs(x[W])) / inertia * moving
        ri = base[I] + g * k[I] - x[I]
        rw = base[W] + g * k[W] - x[W]
        det = a * d - bb * c
        di = (d * ri - bb * rw) / det
        dw = (a * rw - c * ri) / det
        x[I] += di
        x[W] += dw
        worst = max(abs(di) / (1e-3 + abs(x[I])), abs(dw) / (1e-3 + abs(x[W])))
        for j in range(THETA, x.size):
            r = base[j] + g * k[j] - x[j]
            x[j] += r
            worst = max(worst, abs(r) / (1e-3 + abs(x[j])))
        if worst < 1e-8:  # Newton converges quadratically: the next correction is nothing
            break
    if g > 0:
        for j in range(x.size):
            k[j] = (x[j] - base[j]) / g


@nb.njit(cache=True)
def _sdirk(x, h, u0, u1, t, mode, fan_on, p, work, out):
    """One step of length h from x; inputs run linearly from u0 to u1."""
    base, u, k1, k2, k3 = work[0], work[1, :INPUTS], work[2], work[3], work[4]
    for j in range(INPUTS):
        u[j] = u0[j] + _GAMMA * (u1[j] - u0[j])
    for j in range(x.size):
        base[j] = x[j]
        out[j] = x[j]
    _stage(base, h, u, t + _GAMMA * h, mode, fan_on, p, out, k1)
    for j in range(INPUTS):
        u[j] = u0[j] + (1 + _GAMMA) / 2 * (u1[j] - u0[j])
    for j in range(x.size):
        base[j] = x[j] + h * _A21 * k1[j]
    _stage(base, h, u, t + (1 + _GAMMA) / 2 * h, mode, fan_on, p, out, k2)
    for j in range(x.size):
        base[j] = x[j] + h * (_B1 * k1[j] + _B2 * k2[j])
    _stage(base, h, u1, t + h, mode, fan_on, p, out, k3)


@nb.njit(cache=True)
def _between(u0, u1, s, out):
    for j in range(INPUTS):
        out[j] = u0[j] + s * (u1[j] - u0[j])


@nb.njit(cache=True)
def _put(x, out):
    # One by one: numba takes two seconds to compile what a slice assignment would say if lengths differed.
    for j in range(x.size):
        x[j] = out[j]


@nb.njit(cache=True)
def _mode_at_rest(x, u, t, p):
    torque = driving(x, u, p)
    forwards, backwards = holding(x, u, t, p)
    return 1 if torque > forwards else (-1 if torque < -backwards else 0)


@nb.njit(cache=True)
def _advance(x, h, u0, u1, t, mode, frictional, fan_on, p, work, ua, ub, out):
    """A step with its reversals and breakaways; x is overwritten; returns the direction of motion at the end."""
    done = 0.0
    for _ in range(12):
        _between(u0, u1, done, ua)
        if not frictional:
            # A direction known when it is compiled would be compiled once more.
            _sdirk(x, h, u0, u1, t, np.int64(1), fan_on, p, work, out)
            _put(x, out)
            return mode
        if mode == 0:
            x[W] = 0.0
            mode = _mode_at_rest(x, ua, t + done * h, p)
        rest = 1.0 - done
        _sdirk(x, rest * h, ua, u1, t + done * h, mode, fan_on, p, work, out)
        leaves = mode == 0 and _mode_at_rest(out, u1, t + h, p) != 0
        if not leaves and not (mode != 0 and out[W] * mode < 0):
            _put(x, out)
            return mode
        low, high = 0.0, 1.0  # the event lies between these shares of what is left of the step
        w_low, w_high = x[W] * mode, out[W] * mode
        for trial in range(60):
            middle = (low + high) / 2
            if mode != 0 and trial % 3 != 2 and w_low > w_high:
                middle = low + (high - low) * w_low / (w_low - w_high)
            _between(u0, u1, done + rest * middle, ub)
            _sdirk(x, rest * middle * h, ua, ub, t + done * h, mode, fan_on, p, work, out)
            if mode != 0:
                past = out[W] * mode < 0
            else:
                past = _mode_at_rest(out, ub, t + (done + rest * middle) * h, p) != 0
            if past:
                high, w_high = middle, out[W] * mode
            else:
                low, w_low = middle, out[W] * mode
            if high - low < 1e-10 or (mode != 0 and abs(out[W]) < 1e-11):
                break
        _put(x, out)
        done += rest * middle
        _between(u0, u1, done, ub)
        if mode != 0:
            x[W] = 0.0
            mode = _mode_at_rest(x, ub, t + done * h, p)
        if 1.0 - done < 1e-9:
            return mode
    _between(u0, u1, done, ua)
    _sdirk(x, (1.0 - done) * h, ua, u1, t + done * h, np.int64(0), fan_on, p, work, out)
    _put(x, out)
    return 0


@nb.njit(cache=True)
def _run(dt, inputs, x0, p, substeps, reference, gains, states):
    """Fill states[(n - 1) substeps + 1, 10]; with a reference (rad/s, one a sample) a PI controller sets the voltage."""
    n = inputs.shape[0]
    x = x0.copy()
    work = np.zeros((5, STATES))
    out, ua, ub, u0, u1 = (
        np.zeros(STATES),
        np.zeros(INPUTS),
        np.zeros(INPUTS),
        np.zeros(INPUTS),
        np.zeros(INPUTS),
    )
    frictional = (
        p[_TC] != 0
        or p[_TS] != 0
        or p[_MU] != 0
        or p[_TD] != 0
        or p[_BUMP] != 0
        or p[_RUNIN] != 0
        or p[_HYST] != 0
    )
    mode = int(np.sign(x[W]))
    fan_on = False
    integral = 0.0
    _put(states[0], x)
    h = dt / substeps
    for row in range(n - 1):
        if reference.size > 0:
            error = reference[row] - x[W]
            wanted = gains[0] * error + gains[1] * integral + gains[3] * reference[row]
            voltage = min(max(wanted, -gains[2]), gains[2])
            if voltage == wanted:
                integral += error * dt
            inputs[row + 1, VOLTAGE] = voltage
        if p[_THERMO] != 0:
            if x[THETA] > p[_THERMO_ON]:
                fan_on = True
            elif x[THETA] < p[_THERMO_OFF]:
                fan_on = False
        for s in range(substeps):
            _between(inputs[row], inputs[row + 1], s / substeps, u0)
            _between(inputs[row], inputs[row + 1], (s + 1) / substeps, u1)
            mode = _advance(x, h, u0, u1, row * dt + s * h, mode, frictional, fan_on, p, work, ua, ub, out)
            _put(states[row * substeps + s + 1], x)


class Controller(NamedTuple):
    """A PI speed controller with feed-forward: V s/rad, V/rad, limit V, V s/rad."""

    proportional: float
    integral: float
    limit: float
    feed_forward: float


_OPEN_LOOP = Controller(0.0, 0.0, 0.0, 0.0)


def simulate(
    dt: float, inputs: Array, x0: Array, p: Array, substeps: int = 2,
    reference: Array | None = None, controller: Controller = _OPEN_LOOP, between: bool = False,
) -> Array:  # fmt: skip
    """States [n, 10] at the samples of `inputs` [n, 5], which lie dt seconds apart; `between`: at the substeps as well.

    With a `reference` (rad/s) the voltage column of `inputs` is overwritten by the controller's.
    """
    states = np.empty(((len(inputs) - 1) * substeps + 1, STATES))
    _run(dt, inputs, np.asarray(x0, float), p, substeps, np.zeros(0) if reference is None else reference,
         np.array(controller), states)  # fmt: skip
    return states if between else states[::substeps].copy()


def rest(theta: float = 0.0, housing: float | None = None, magnet: float = 0.0) -> Array:
    """The state at rest with rises of winding, housing and magnets in K."""
    x = np.zeros(STATES)
    x[[THETA, HOUSING, MAGNET]] = theta, theta if housing is None else housing, magnet
    return x
