"""Does every simulation end? Motors with parameters anywhere within their bounds, on ten recordings.

    python benchmarks/bounded.py              1000 draws (minutes)
    python benchmarks/bounded.py --quick      100 draws

Cost is counted in steps tried, rejected ones included, and compared with the nominal motor on the same recording. A draw
is the textbook motor, two in three with an effect of the catalogue, every parameter drawn within its bounds: of the first
half uniformly, of the second uniformly in its logarithm, which finds the corners. Each may take twenty times the steps of
the nominal, as a fit would allow it: it ends, or an error says where and why. Friction is real and smooth in turn.
"""

import argparse
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np

from motorlens_physics.effect import catalogue
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile, read_motor_file
from motorlens_physics.parameter import Parameter, parameters
from motorlens_physics.scenario import chosen_scenario, perform
from motorlens_physics.simulation import Inputs, simulate
from motorlens_runtime.errors import ModelError

TIMES = 20
ROWS = 2000
# Scenario and samples a second, cut after ROWS samples; at more than 100 a second no sample is long enough to settle in.
RECORDED = (
    ("load_steps", 1000.0), ("direct_on_line", 1000.0), ("slow_ramp", 1000.0), ("slow_ramp", 100.0),
    ("overhauling_load", 100.0), ("no_load_steps", 100.0), ("duty", 10.0), ("duty", 1.0), ("heat_soak", 1.0),
)  # fmt: skip


def recorded(file: MotorFile) -> dict[str, Inputs]:
    """Inputs by name, all with the noise of measured ones."""
    rng = np.random.default_rng(0)
    ambient = np.full(ROWS, file.rated.ambient_C)
    time = np.arange(float(ROWS))
    volts = 10 * np.sin(time / 50) + 2 * rng.standard_normal(ROWS)
    inputs = {
        "standstill 1 Hz": Inputs(time, volts, 0.3 * rng.standard_normal(ROWS), ambient),
    }
    for name, rate in RECORDED:
        recording = perform(file, chosen_scenario(name, (ROWS - 1) / rate, rate), rng)
        noisy = {
            q: recording.channels[q][:ROWS] + sd * rng.standard_normal(len(recording))[:ROWS]
            for q, sd in (("voltage", 0.5), ("load_torque", 0.03), ("ambient", 0.01))
        }
        inputs[f"{name} {rate:g} Hz"] = Inputs(recording.time_s[:ROWS], *noisy.values())
    return inputs


def draw(parameter: Parameter, log: bool, rng: np.random.Generator) -> float:
    """A value within the bounds of a parameter, uniform in itself or in its logarithm over twelve decades."""
    low, high = parameter.bounds
    if not log or high <= 0:
        return float(rng.uniform(low, high))
    sign = rng.choice([-1.0, 1.0]) if low < 0 else 1.0
    least = max(low, 1e-12 * high)
    return float(sign * np.exp(rng.uniform(np.log(least), np.log(high))))


def motor(k: int, log: bool, rng: np.random.Generator) -> Motor:
    """A motor anywhere within its bounds."""
    effects = list(catalogue().values())

    def drawn(owner: Any) -> dict[str, float]:
        return {name: draw(p, log, rng) for name, p in parameters(owner).items() if not p.fixed}

    chosen = [effects[int(rng.integers(len(effects)))]] if k % 3 else []
    return replace(Motor(), **drawn(Motor), effects=tuple(effect(**drawn(effect)) for effect in chosen))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="100 draws")
    draws = 100 if parser.parse_args().quick else 1000
    file = read_motor_file("models/motors/mellah2016.toml")
    inputs = recorded(file)
    nominal = {
        (name, smooth): simulate(file.motor, given, smooth=smooth).steps
        for name, given in inputs.items()
        for smooth in (False, True)
    }
    for name, given in inputs.items():
        print(f"nominal, {name}: {nominal[name, False] / given.time_s.size:.1f} steps a sample")
    rng = np.random.default_rng(1)
    for log in (False, True):
        ratios, ends = [], Counter[str]()
        for k in range(draws // 2):
            drawn = motor(k, log, rng)
            for j, (name, given) in enumerate(inputs.items()):
                smooth = bool((k + j) % 2)
                allowed = TIMES * nominal[name, smooth]
                try:
                    steps = simulate(drawn, given, smooth=smooth, most_steps=allowed).steps
                    ends["simulated"] += 1
                except ModelError as error:
                    why = str(error).partition(";")[0].partition(": ")[2] or str(error)
                    words = [word for word in why.replace(",", "").split() if not word[0].isdigit()]
                    ends["error: " + " ".join(words)[:60]] += 1
                    steps = allowed if "too many" in str(error) else 0
                ratios.append(steps / nominal[name, smooth])
        print(
            f"\n{draws // 2} draws uniform in {'the logarithm' if log else 'the value'} x {len(inputs)} recordings:"
        )
        low, high, most = np.quantile(ratios, [0.5, 0.99, 1.0])
        print(f"steps over the nominal: median {low:.1f}, 99 of 100 {high:.1f}, most {most:.1f}")
        for end, count in ends.most_common(8):
            print(f"{count:6d}  {end}")


if __name__ == "__main__":
    main()
