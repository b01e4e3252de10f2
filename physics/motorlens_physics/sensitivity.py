"""Sensitivities of a trajectory to parameters, initial states and effects it lacks, in one forward pass.

Internal differentiation along the accepted steps of the simulation (Bock 1981, doi:10.1007/978-3-642-68220-9_8), here of
the variational equations, see `compile.variational`. Where the rotor stops or turns, the jump of the sensitivities is
taken into account; what rests does not respond.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from motorlens_physics.compile.types import Variations
from motorlens_physics.effect import Effect
from motorlens_physics.motor import Motor
from motorlens_physics.simulation import TOLERANCE, Array, Inputs, Trajectory, initial_states, run, structure
from motorlens_physics.symbols import INPUT_KEYS, forcing_keys, parameter_keys, states_of, switch_key
from motorlens_runtime.errors import ModelError

INITIAL = "initial."
# Constants added to a current and to a speed that are imposed.
IMPOSED_KEYS = ("input.current", "input.speed")


@dataclass(frozen=True)
class Linearisation:
    """The motor along a trajectory as a linear system: how small forcings of its balances move its states.

    Attributes:
        states: names of the n states.
        matrices: (N - 1, n, n + 6): from sample k to k + 1, Phi and the Gammas of forcings of the three balances at
            the one and at the other.
    """

    states: tuple[str, ...]
    matrices: Array

    def respond(
        self,
        voltage_V: Array | None = None,
        torque_Nm: Array | None = None,
        heat_W: Array | None = None,
        *,
        held: bool | tuple[bool, bool, bool] = False,
    ) -> dict[str, Array]:
        """Response of each state, (N, m), to forcings (N, m) that enter the balances, from rest of the perturbation.

        Args:
            voltage_V: added to L di/dt.
            torque_Nm: added to J dw/dt; positive drives forward.
            heat_W: added to H dtheta/dt.
            held: whether forcings hold from sample to sample (all, or each of the three); otherwise they run linearly.
        """
        given = {
            row: values for row, values in enumerate((voltage_V, torque_Nm, heat_W)) if values is not None
        }
        shapes = {np.shape(forcing) for forcing in given.values()}
        samples = len(self.matrices) + 1
        if len(shapes) != 1 or len(shape := shapes.pop()) != 2 or shape[0] != samples:
            raise ModelError(f"respond: forcings must all be ({samples}, m), one for each sample")
        # Most of what is asked enters one balance.
        acting = [row for row, values in given.items() if np.any(values)]
        forcing = np.empty((samples, len(acting), shape[1]))
        for k, row in enumerate(acting):
            forcing[:, k] = given[row]
        hold = np.array((held,) * 3 if isinstance(held, bool) else held)[acting]
        n = self.matrices.shape[1]
        response = np.zeros((samples, n, shape[1]))
        _respond(np.array(acting, dtype=np.int64), self.matrices, forcing, hold, response)
        return {name: response[:, j] for j, name in enumerate(self.states)}

    def released(self, state: str, samples: Sequence[int]) -> dict[str, Array]:
        """Free response of each state, (N, m), to a unit of one of them at each of m samples; before it there is none."""
        response = np.zeros((len(self.matrices) + 1, len(self.states), len(samples)))
        response[samples, self.states.index(state), np.arange(len(samples))] = 1.0
        nothing = np.empty((len(response), 0, len(samples)))
        _respond(np.empty(0, dtype=np.int64), self.matrices, nothing, np.empty(0, dtype=np.bool_), response)
        return {name: response[:, j] for j, name in enumerate(self.states)}


def linearise(
    motor: Motor,
    inputs: Inputs,
    initial: Mapping[str, float] | None = None,
    *,
    tolerance: float = TOLERANCE,
    smooth: bool = False,
    most_steps: int | None = None,
) -> tuple[Trajectory, Linearisation]:
    """Simulate, and linearise along the way.

    Raises:
        ModelError: as `simulate`.
    """
    trajectory, _, linear = linearise_and_differentiate(
        motor, inputs, initial, (), tolerance=tolerance, smooth=smooth, most_steps=most_steps
    )
    return trajectory, linear


def linearise_and_differentiate(
    motor: Motor,
    inputs: Inputs,
    initial: Mapping[str, float] | None,
    keys: Sequence[str],
    *,
    tolerance: float = TOLERANCE,
    smooth: bool = False,
    most_steps: int | None = None,
) -> tuple[Trajectory, dict[str, dict[str, Array]], Linearisation]:
    """What `sensitivities` and `linearise` give, from one pass.

    Raises:
        ModelError: as `sensitivities`.
    """
    trajectory, kept, linear = differentiate(
        motor, inputs, initial, keys, tolerance=tolerance, smooth=smooth, most_steps=most_steps
    )
    return trajectory, _by_key(keys, linear.states, trajectory, kept), linear


def differentiate(
    motor: Motor,
    inputs: Inputs,
    initial: Mapping[str, float] | None,
    keys: Sequence[str],
    *,
    tolerance: float = TOLERANCE,
    smooth: bool = False,
    most_steps: int | None = None,
) -> tuple[Trajectory, Array, Linearisation]:
    """As `linearise_and_differentiate`, with the derivatives of the states in their order, and of what is shown, (N, n, k).

    Raises:
        ModelError: as `sensitivities`.
    """
    states, steps = _states(motor, inputs), inputs.time_s.size - 1
    matrices = np.empty((max(steps, 1), len(states), len(states) + 6))[:steps]
    trajectory, kept = _forward(motor, inputs, initial, keys, (), tolerance, smooth, matrices, most_steps)
    return trajectory, kept, Linearisation(states, matrices)


def sensitivities(
    motor: Motor,
    inputs: Inputs,
    initial: Mapping[str, float] | None,
    keys: Sequence[str],
    candidates: Sequence[Effect] = (),
    *,
    tolerance: float = TOLERANCE,
    smooth: bool = False,
    most_steps: int | None = None,
) -> tuple[Trajectory, dict[str, dict[str, Array]]]:
    """Simulate, and differentiate all states with respect to parameters, initial states and effects at their null.

    Args:
        motor: the motor.
        inputs: what acts on it.
        initial: initial states, as of `simulate`.
        keys: parameters of the motor ("R_a0", "coulomb_friction.tau_c"), initial states ("initial.theta") and constants
            added to the inputs ("input.voltage", "input.load_torque", "input.ambient", and where they are imposed
            "input.current" and "input.speed").
        candidates: effects that the motor lacks, with their shapes chosen; their switches are taken at null.
        tolerance: of the simulation's steps.
        smooth: whether friction is smooth, see `simulate`.
        most_steps: how many steps may be tried, see `simulate`.

    Returns:
        The trajectory, and for each key and each candidate's "name.switch" a mapping of state to (N,); also of "v", the
        voltage at the terminals, where anything is imposed (see `Inputs.terminal`).

    Raises:
        ModelError: an unknown or fixed parameter, a candidate that the motor has already, or as `simulate`.
    """
    taken = [effect.name() for effect in candidates if motor.effect(effect.name()) is not None]
    if taken:
        raise ModelError(f"candidate {taken[0]!r} is in the motor already")
    columns = (*keys, *(switch_key(effect) for effect in candidates))
    trajectory, kept = _forward(
        motor, inputs, initial, keys, candidates, tolerance, smooth, np.empty((0, 0, 0)), most_steps
    )
    return trajectory, _by_key(columns, _states(motor, inputs), trajectory, kept)


def _states(motor: Motor, inputs: Inputs) -> tuple[str, ...]:
    return states_of(motor, turned=inputs.angle_rad is not None)


def _by_key(
    keys: Sequence[str], states: Sequence[str], trajectory: Trajectory, kept: Array
) -> dict[str, dict[str, Array]]:
    rows = [*states, *(() if trajectory.shown_V is None else ("v",))]
    return {key: {name: kept[:, r, j] for r, name in enumerate(rows)} for j, key in enumerate(keys)}


def _forward(
    motor: Motor,
    inputs: Inputs,
    initial: Mapping[str, float] | None,
    keys: Sequence[str],
    candidates: Sequence[Effect],
    tolerance: float,
    smooth: bool,
    matrices: Array,
    most_steps: int | None,
) -> tuple[Trajectory, Array]:
    system, code = structure(motor, candidates, forced=True, turned=inputs.angle_rad is not None)
    x = initial_states(replace(motor, effects=(*motor.effects, *candidates)), system, initial)
    n, samples = system.of_motor, inputs.time_s.size
    own = list(system.states[:n])
    starts = [key for key in keys if key.startswith(INITIAL) or key in IMPOSED_KEYS]
    parameters = [key for key in keys if key not in starts]
    _check(
        motor,
        candidates,
        parameters,
        [key.removeprefix(INITIAL) for key in starts if key not in IMPOSED_KEYS],
    )
    forced = [*parameters, *(switch_key(effect) for effect in candidates)]
    order = [*forced, *starts]
    available = forcing_keys(motor, candidates)
    # Forcings nobody asked for go to a column behind the others.
    place = {key: k for k, key in enumerate(forced)}
    slots = np.array([place.get(key, len(forced)) for key in available], dtype=np.int64)

    columns, extra = len(order), n + 6 if matrices.size else 0
    S = np.zeros((n, columns + extra))
    for k, key in enumerate(starts, start=len(forced)):
        if key.startswith(INITIAL):
            S[own.index(key.removeprefix(INITIAL)), k] = 1.0
    imposed = any(how is not None and how.any() for how in (inputs.terminal, inputs.shaft))
    kept = np.empty((samples, n + imposed, columns)) if order else np.empty((0, 0, 0))
    beside = [order.index(key) if key in order else -1 for key in (INPUT_KEYS[0], *IMPOSED_KEYS)]
    variations = Variations(
        S=S, kept=kept, matrices=matrices, slots=slots, beside=np.array(beside, dtype=np.int64),
        a=np.zeros((3, n, n + 1)), g=np.zeros((3, n, len(forced) + 1)), over=np.zeros((n, 4 * n)), T=np.zeros(S.shape),
    )  # fmt: skip
    trajectory = run(
        system, code, motor, inputs, x, tolerance=tolerance, smooth=smooth, candidates=candidates,
        variations=variations, most_steps=most_steps,
    )  # fmt: skip
    asked = [*keys, *(switch_key(effect) for effect in candidates)]
    if asked == order:
        return trajectory, kept
    picked: NDArray[np.float64] = kept[:, :, [order.index(key) for key in asked]]
    return trajectory, picked


def _check(motor: Motor, candidates: Sequence[Effect], parameters: list[str], starts: list[str]) -> None:
    available = forcing_keys(motor, candidates)
    for key in parameters:
        if key not in available:
            why = "is fixed" if key in parameter_keys(motor, candidates) else "is not there"
            raise ModelError(f"sensitivity to {key!r}: the parameter {why}; there are {', '.join(available)}")
    for name in starts:
        if name not in motor.states():
            raise ModelError(
                f"sensitivity to {INITIAL + name!r}: the motor's states are {', '.join(motor.states())}"
            )


@njit(cache=True, nogil=True)
def _respond(acting, matrices, forcing, hold, response):  # type: ignore[no-untyped-def]
    n = matrices.shape[1]
    for k in range(len(matrices)):
        for r in range(n):
            for c in range(n):
                phi = matrices[k, r, c]
                for j in range(response.shape[2]):
                    response[k + 1, r, j] += phi * response[k, c, j]
            for b in range(len(acting)):
                first, last = matrices[k, r, n + acting[b]], matrices[k, r, n + 3 + acting[b]]
                later = k if hold[b] else k + 1
                for j in range(response.shape[2]):
                    response[k + 1, r, j] += first * forcing[k, b, j] + last * forcing[later, b, j]
