"""The C core against Python, and its single precision against its double, on long streams.

    python benchmarks/core.py [--quick] [--only parity|frames|single]

1. Six duty cycles with gaps, NaN, rubbish, an hour without power: quality words, bits of the states, estimates in shares of
   scale.
2. Ten million frames on bad lines: the same samples accepted, the same counters.
3. 24 h at 100 Hz of one duty cycle, exported in single and in double precision and compiled here: how far apart, in shares
   of scale and of the stated deviation.

Exit status 1 if a gate fails.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from hil_faults import damages

from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.scenario import chosen_scenario, measure, perform
from motorlens_runtime.cli import main as motorlens
from motorlens_runtime.estimate.core_estimator import open_estimator
from motorlens_runtime.estimate.estimator import Estimator
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.line.core_link import open_link
from motorlens_runtime.line.framing import Channel, Hello, hello_frames, samples_frame
from motorlens_runtime.line.link import Link
from motorlens_runtime.sensor.core_library import STRICT_FLAGS, compilers
from motorlens_runtime.sensor.sensor import load_sensor, scales

ROOT = Path(__file__).resolve().parents[1]
SENSORS = ("mellah2016", "mellah2016_observer")
NOISE = {"voltage": 0.5, "current": 0.05}
BLOCK = 4096


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="a tenth of the samples, 10^5 frames, half an hour"
    )
    parser.add_argument("--only", choices=("parity", "frames", "single"), help="one part of it")
    arguments = parser.parse_args()
    passed = True
    for name in SENSORS:
        if arguments.only in (None, "parity"):
            passed &= parity(name, 100_000 if arguments.quick else 1_000_000)
        if arguments.only in (None, "single"):
            passed &= single(name, 0.5 if arguments.quick else 24.0)
    if arguments.only in (None, "frames"):
        passed &= frames(10**5 if arguments.quick else 10**7)
    return 0 if passed else 1


def duty(seed: int, n: int, rate_Hz: float) -> Samples:
    """A duty cycle of the shipped motor as a drive measures it."""
    file, rng = read_motor_file(ROOT / "models/motors/mellah2016.toml"), np.random.default_rng(seed)
    truth = perform(file, chosen_scenario("duty", n / rate_Hz, rate_Hz), rng)
    shown = measure(truth, (), NOISE, rng)
    voltage, current = (shown.channels[key][:n].copy() for key in ("voltage", "current"))
    return Samples(np.round(shown.time_s[:n] * 1e9).astype(np.int64), voltage, current)


def damaged(samples: Samples, seed: int) -> Samples:
    """With gaps, an hour without power, NaN, infinities and rubbish."""
    rng, n = np.random.default_rng(seed), len(samples)
    step_ns = np.diff(samples.time_ns, prepend=samples.time_ns[0])
    step_ns[rng.integers(0, n, n // 5000)] += rng.integers(0, 2_000_000_000, n // 5000)
    step_ns[rng.integers(0, n, 2)] += 3_600_000_000_000
    voltage, current = samples.voltage_V.copy(), samples.current_A.copy()
    for channel in (voltage, current):
        channel[rng.integers(0, n, n // 500)] = rng.choice([np.nan, np.inf, -np.inf, 1e30], n // 500)
    return Samples(np.cumsum(step_ns), voltage, current)


def parity(name: str, total: int) -> bool:
    """Python and core on six damaged duty cycles."""
    python, core = (load_sensor(ROOT / f"models/sensors/{name}.onnx", way) for way in ("numpy", "core"))
    scale, worst, deviation, words, states = scales(python.specification), 0.0, 0.0, True, True
    for seed in range(6):
        samples = damaged(duty(seed, total // 6, 200.0), seed)
        first, second = Estimator(python, 5e-3), open_estimator(core, 5e-3)
        for start in range(0, len(samples), BLOCK):
            rows = slice(start, start + BLOCK)
            block = Samples(samples.time_ns[rows], samples.voltage_V[rows], samples.current_A[rows])
            one, two = first.push(block), second.push(block)
            words &= np.array_equal(one.quality, two.quality)
            worst = max(worst, float(np.max(np.abs(one.values - two.values) / scale)))
            deviation = max(deviation, float(np.max(np.abs(one.sigma - two.sigma) / scale)))
        a, b = first.state, second.state
        states &= a.gate == b.gate and a.observer == b.observer
        states &= np.array_equal(a.bank.before, b.bank.before) and np.array_equal(
            a.bank.within, b.bank.within
        )
    print(
        f"{name}: {total // 6 * 6} samples of six duty cycles; quality words {'equal' if words else 'DIFFER'}, "
        f"bits of the states {'equal' if states else 'DIFFER'}; estimates within {worst:.1e} of scale, "
        f"deviations {deviation:.1e}"
    )
    return words and states and worst < 1e-12 and deviation < 1e-12


def frames(total: int) -> bool:
    """Python's decoder and the core's on the same damaged bytes, in portions as a line gives them."""
    rng, chunk = np.random.default_rng(1), min(total // 10, 20_000)
    hello = Hello(
        "bad line",
        1,
        (1000, 1),
        tuple(
            Channel(q, u, "i2", 0.1, 0.0, -2048, 2047) for q, u in ("voltage V".split(), "current A".split())
        ),
    )
    kinds, seen, differ, accepted, bad = damages(rng, chunk), 0, 0, 0, 0
    for damage in kinds.values():
        first, second = Link(), open_link()
        if type(second) is Link:
            print("no C core here")
            return True
        for start in range(0, total // len(kinds), chunk):
            codes = rng.integers(-2048, 2048, (chunk, 5, 2)).astype(np.int16)
            wire = hello_frames(hello, sequence=0, t0_us=0)
            wire += [samples_frame(rows, schema=1, sequence=(start + k) & 0xFFFF, t0_us=(start + k) * 5000 & 0xFFFFFFFF)
                     for k, rows in enumerate(codes)]  # fmt: skip
            data, at = damage(b"".join(wire)), 0
            while at < len(data):
                portion = data[at : at + int(rng.integers(1, 1 << 16))]
                at += len(portion)
                one, two = (link.feed(portion, at * 1000) for link in (first, second))
                accepted += len(one)
                differ += not all(
                    np.array_equal(getattr(one, f), getattr(two, f))
                    for f in ("time_ns", "voltage_V", "current_A")
                )
                differ += one.flags is not None and not np.array_equal(one.flags, two.flags)
            seen += chunk
        differ += first.counters != second.counters or first.bad_frames != second.bad_frames
        bad += first.bad_frames
    print(
        f"{seen} frames on bad lines: {accepted} samples accepted by both, {bad} damaged pieces, {differ} differences"
    )
    return differ == 0 and bad > total // 100


def single(name: str, hours: float) -> bool:
    """The exported sensor in single and double precision on one long duty cycle."""
    if not compilers():
        print("no C compiler here")
        return True
    n = round(hours * 3600 * 100)
    samples = duty(9, n, 100.0)
    sensor = load_sensor(ROOT / f"models/sensors/{name}.onnx", "numpy")
    results = []
    with tempfile.TemporaryDirectory() as scratch:
        table = np.column_stack([samples.time_ns.astype(np.float64), samples.voltage_V, samples.current_A])
        table.tofile(f"{scratch}/in")
        for precision in ([], ["--double"]):
            folder = Path(scratch) / "-".join(["c", *precision])
            if motorlens(
                ["export", str(ROOT / f"models/sensors/{name}.onnx"), "--c", str(folder), *precision]
            ):
                return False
            (folder / "long.c").write_text(LONG, encoding="ascii")
            sources = [p for p in sorted(folder.glob("*.c")) if p.name not in ("main.c", "golden_test.c")]
            command = [
                compilers()[0],
                *STRICT_FLAGS,
                "-O2",
                "-o",
                f"{scratch}/long",
                *map(str, sources),
                "-lm",
            ]
            subprocess.run(command, check=True)
            with open(f"{scratch}/in", "rb") as source:
                done = subprocess.run([f"{scratch}/long"], stdin=source, capture_output=True, check=True)
            results.append(np.frombuffer(done.stdout).reshape(-1, 2, len(sensor.specification.outputs)))
    apart = np.abs(results[0] - results[1])
    estimate = float(np.max(apart[:, 0] / scales(sensor.specification)))
    share = float(np.max(apart[:, 0] / results[1][:, 1]))
    deviation = float(np.max(apart[:, 1] / results[1][:, 1]))
    print(
        f"{name}: {hours:g} h at 100 Hz in single precision: estimates within {estimate:.1e} of scale and "
        f"{100 * share:.2g} % of the stated deviation, deviations within {100 * deviation:.2g} % of themselves"
    )
    return estimate < 1e-4 and share < 0.05


# Reads time, voltage and current as float64, writes estimates and deviations of every tenth sample.
LONG = """
#include <math.h>
#include <stdio.h>
#include "sensor.h"

int main(void)
{
    static motorlens_state state;
    double row[3], out[2][MOTORLENS_OUTPUTS];
    motorlens_real found[2][MOTORLENS_OUTPUTS];
    motorlens_start(&motor_sensor, &state, 10000000);
    for (long k = 0; fread(row, sizeof row, 1, stdin) == 1; k++) {
        motorlens_sample sample = {(int64_t)row[0], (motorlens_real)row[1], (motorlens_real)row[2], (motorlens_real)NAN, 0};
        const uint32_t word = motorlens_update(&motor_sensor, &state, &sample);
        if (k % 10 == 0) {
            motorlens_evaluate(&motor_sensor, &state, &sample, word, found[0], found[1]);
            for (int k = 0; k < MOTORLENS_OUTPUTS; k++) {
                out[0][k] = (double)found[0][k];
                out[1][k] = (double)found[1][k];
            }
            fwrite(out, sizeof out, 1, stdout);
        }
    }
    return 0;
}
"""


if __name__ == "__main__":
    sys.exit(main())
