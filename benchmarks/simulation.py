"""The simulation against its peers: processor time and error on the same task at the same tolerance.

    python benchmarks/simulation.py            both tasks, every peer that is installed (minutes)
    python benchmarks/simulation.py --quick    shorter stretches, under a minute

Task (a) is the paper's run: 140 min at 240 V and 6.455 N m, one sample a second. Task (b) is a drive: a new voltage every
millisecond, held in between. A peer that is too slow for all 600 000 samples of (b) does as many as it can in a few
seconds; times are per sample. All are asked for a relative tolerance of 1e-6; errors are the largest of current and speed,
relative to the largest value, against scipy's Radau at 1e-10 (the first 300 samples of (b)).

Peers, each with the right-hand side it likes best: scipy's LSODA and Radau and SUNDIALS' CVODE call one compiled by numba;
CasADi differentiates and integrates its own symbols with CVODES; gym-electric-motor simulates its own permanently excited
motor with these figures, which has no heat, by scipy's LSODA. motulator (0.5) is left out: it has no DC machine.
Peers: pip install scikit-sundae casadi gym-electric-motor.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

from motorlens_physics.effect import catalogue
from motorlens_physics.motor import Motor
from motorlens_physics.parameter import Rated, parameters
from motorlens_physics.sensitivity import sensitivities
from motorlens_physics.simulation import Inputs, simulate, simulate_batch
from motorlens_physics.threads import cores

PLATE = Rated(voltage_V=240.0, current_A=7.27, speed_rad_s=221.0, torque_Nm=6.455, rise_K=80.0)
RTOL, ATOL = 1e-6, 1e-7
# A run of the states (N, 3) over the first `samples` samples of a task.
Peer = Callable[[Inputs, int], np.ndarray]


@njit(cache=True)
def rates(t, x, v, load):
    i, w, theta = x[0], x[1], x[2]
    R = 3.5 * (1 + 0.004 * theta)
    cooling = 4.33 * (1 + 0.0028 * (np.sqrt(w * w + 1e-6) - 1e-3)) * theta
    didt = (v - R * i - 0.9346 * w) / 0.034
    dwdt = (0.9346 * i - 0.00154 * w - load) / 0.0328
    return np.array([didt, dwdt, (R * i * i + 0.00667 * w * w - cooling) / 18e3])


def start(inputs: Inputs) -> np.ndarray:
    """At rest for the paper's run, at speed for the drive."""
    return (
        np.array([0.0, 0.0, 0.0])
        if inputs.time_s[1] - inputs.time_s[0] > 0.1
        else np.array([5.0, 120.0, 0.0])
    )


def ours(inputs: Inputs, samples: int) -> np.ndarray:
    part = cut(inputs, samples)
    i, w, theta = start(inputs)
    run = simulate(Motor(), part, {"i": i, "w": w, "theta": theta}, tolerance=RTOL)
    return np.column_stack([run.current_A, run.speed_rad_s, run.rise_K])


def by_scipy(method: str, rtol: float = RTOL, atol: float = ATOL) -> Peer:
    def run(inputs: Inputs, samples: int) -> np.ndarray:
        time_s, x = inputs.time_s[:samples], start(inputs)
        options: dict[str, Any] = {"method": method, "rtol": rtol, "atol": atol}
        if not np.ptp(inputs.voltage_V):
            arguments = (inputs.voltage_V[0], inputs.load_torque_Nm[0])
            return solve_ivp(rates, (time_s[0], time_s[-1]), x, args=arguments, t_eval=time_s, **options).y.T
        out = [x]
        for k in range(samples - 1):
            arguments = (inputs.voltage_V[k], inputs.load_torque_Nm[k])
            out.append(
                solve_ivp(rates, (time_s[k], time_s[k + 1]), out[-1], args=arguments, **options).y[:, -1]
            )
        return np.array(out)

    return run


def by_sundials(inputs: Inputs, samples: int) -> np.ndarray:
    from sksundae.cvode import CVODE

    now = {"v": 0.0, "load": 0.0}

    def right(t: float, x: np.ndarray, dx: np.ndarray) -> None:
        dx[:] = rates(t, x, now["v"], now["load"])

    solver = CVODE(right, rtol=RTOL, atol=ATOL, method="BDF", max_num_steps=100000)
    time_s, x = inputs.time_s[:samples], start(inputs)
    if not np.ptp(inputs.voltage_V):
        now |= {"v": inputs.voltage_V[0], "load": inputs.load_torque_Nm[0]}
        return np.asarray(solver.solve(time_s, x).y)
    out = [x]
    for k in range(samples - 1):
        now |= {"v": inputs.voltage_V[k], "load": inputs.load_torque_Nm[k]}
        out.append(np.asarray(solver.solve(time_s[k : k + 2], out[-1]).y)[-1])
    return np.array(out)


def by_casadi(inputs: Inputs, samples: int) -> np.ndarray:
    import casadi as ca

    x, u = ca.MX.sym("x", 3), ca.MX.sym("u", 2)
    i, w, theta = x[0], x[1], x[2]
    R = 3.5 * (1 + 0.004 * theta)
    cooling = 4.33 * (1 + 0.0028 * (ca.sqrt(w * w + 1e-6) - 1e-3)) * theta
    right = ca.vertcat(
        (u[0] - R * i - 0.9346 * w) / 0.034,
        (0.9346 * i - 0.00154 * w - u[1]) / 0.0328,
        (R * i * i + 0.00667 * w * w - cooling) / 18e3,
    )
    options = {"reltol": RTOL, "abstol": ATOL}
    step = ca.integrator(
        "step",
        "cvodes",
        {"x": x, "p": u, "ode": right},
        0,
        float(inputs.time_s[1] - inputs.time_s[0]),
        options,
    )
    drive = np.vstack([inputs.voltage_V, inputs.load_torque_Nm])[:, : samples - 1]
    out = step.mapaccum(samples - 1)(x0=start(inputs), p=drive)["xf"]
    return np.vstack([start(inputs), np.array(out).T])


def by_gym(inputs: Inputs, samples: int) -> np.ndarray:
    import gym_electric_motor as gem
    from gym_electric_motor.physical_systems.mechanical_loads import PolynomialStaticLoad
    from gym_electric_motor.physical_systems.solvers import ScipySolveIvpSolver

    limits = {"omega": 400.0, "torque": 80.0, "i": 90.0, "u": 240.0}
    environment = gem.make(
        "Cont-CC-PermExDc-v0",
        motor={
            "motor_parameter": {"r_a": 3.5, "l_a": 0.034, "psi_e": 0.9346, "j_rotor": 0.0318},
            "limit_values": limits,
            "nominal_values": limits,
        },
        load=PolynomialStaticLoad(load_parameter={"a": 2.0, "b": 0.00154, "c": 0.0, "j_load": 0.001}),
        ode_solver=ScipySolveIvpSolver(method="LSODA", rtol=RTOL, atol=ATOL),
        supply={"u_nominal": 240.0},
        tau=float(inputs.time_s[1] - inputs.time_s[0]),
        constraints=(),
    )
    system = environment.unwrapped.physical_system
    environment.reset()
    system.reset()
    for k in range(samples - 1):
        system.simulate(np.array([inputs.voltage_V[k] / 240.0]))
    return np.full((samples, 3), np.nan)


PEERS: dict[str, Peer] = {
    "motorlens": ours,
    "scipy LSODA": by_scipy("LSODA"),
    "scipy Radau": by_scipy("Radau"),
    "SUNDIALS CVODE": by_sundials,
    "CasADi CVODES": by_casadi,
    "gym-electric-motor": by_gym,
}


def cut(inputs: Inputs, samples: int) -> Inputs:
    names = ("time_s", "voltage_V", "load_torque_Nm", "ambient_C")
    return replace(inputs, **{name: getattr(inputs, name)[:samples] for name in names})


def paper() -> Inputs:
    ones = np.ones(8401)
    return Inputs(np.arange(8401.0), 240 * ones, 6.455 * ones, 20 * ones, held=True)


def drive(samples: int, seed: int = 0) -> Inputs:
    rng = np.random.default_rng(seed)
    ones = np.ones(samples)
    return Inputs(np.arange(samples) * 1e-3, rng.uniform(0, 240, samples), 2 * ones, 20 * ones, held=True)


def timed(run: Callable[[], Any]) -> tuple[float, Any]:
    begun = time.process_time()
    result = run()
    return time.process_time() - begun, result


def compare(title: str, inputs: Inputs, reference: np.ndarray, budget_s: float) -> None:
    print(f"\n{title}\n{'':20} {'samples':>8} {'us/sample':>10} {'x motorlens':>12} {'error':>9}")
    base = None
    for name, peer in PEERS.items():
        try:
            peer(inputs, min(50, inputs.time_s.size))
            whole = not np.ptp(inputs.voltage_V)
            samples = inputs.time_s.size if whole or peer is ours else 300
            seconds, states = timed(lambda peer=peer, samples=samples: peer(inputs, samples))
            more = int(min(samples * budget_s / max(seconds, 1e-3), inputs.time_s.size))
            if more > 2 * samples:
                samples = more
                seconds, states = timed(lambda peer=peer, samples=samples: peer(inputs, samples))
        except ImportError as error:
            print(f"{name:20} not installed ({error.name})")
            continue
        except Exception as error:
            print(f"{name:20} failed: {type(error).__name__}: {str(error).splitlines()[0][:90]}")
            continue
        if len(states) < samples:
            print(f"{name:20} gave up after {len(states)} samples")
            continue
        each = seconds / (samples - 1) * 1e6
        base = base or each
        common = min(len(reference), samples)
        errors = np.abs(states[:common, :2] - reference[:common, :2]).max(axis=0)
        error = float((errors / np.abs(reference[:, :2]).max(axis=0)).max())
        shown = f"{error:9.1e}" if np.isfinite(error) else "  no heat"
        print(f"{name:20} {samples:8d} {each:10.3f} {each / base:12.1f} {shown}")


def throughput(cycles: int, samples: int) -> None:
    inputs = [drive(samples, seed) for seed in range(cycles)]
    simulate_batch([Motor()], inputs[:2], tolerance=1e-5)
    begun, busy = time.perf_counter(), time.process_time()
    simulate_batch([Motor()], inputs, tolerance=1e-5)
    seconds, busy = time.perf_counter() - begun, time.process_time() - busy
    million = cycles * samples / 1e6
    print(
        f"\nBatch of {cycles} duty cycles of {samples} samples on {cores()} cores: {million / seconds:.1f} million steps/s "
        f"by the clock, {million / busy:.1f} for each core and second of its time"
    )


def sensitivity_cost(samples: int) -> None:
    inputs = drive(samples)
    candidates = [effect.at_null(PLATE) for effect in catalogue().values()]
    keys = tuple(parameters(Motor))

    def plain() -> Any:
        return simulate(Motor(), inputs)

    def whole() -> Any:
        return sensitivities(Motor(), inputs, None, keys, candidates)

    plain(), whole()
    base = min(timed(plain)[0] for _ in range(3))
    seconds = min(timed(whole)[0] for _ in range(3))
    print(
        f"Sensitivities of {len(keys)} parameters and {len(candidates)} candidates over {samples} samples: "
        f"{seconds / base:.1f} times the plain simulation"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="shorter stretches")
    quick = parser.parse_args().quick
    accurate = by_scipy("Radau", 1e-10, 1e-11)
    long = paper()
    compare("(a) 140 min, one sample a second", long, accurate(long, 8401), 0.5 if quick else 5.0)
    fast = drive(60_001 if quick else 600_001)
    compare("(b) a new voltage every millisecond", fast, accurate(fast, 300), 0.5 if quick else 5.0)
    throughput(16 if quick else 64, 100_000)
    sensitivity_cost(10_000 if quick else 50_000)


if __name__ == "__main__":
    main()
