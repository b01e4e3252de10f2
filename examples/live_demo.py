"""A virtual sensor at work, without hardware: `make demo`.

A simulated drive runs a 3 kW motor through a random duty cycle and sends terminal voltage and current, digitised with
12 bits, over a pseudo-terminal, as over a serial line. `motorlens run` reads that port and estimates speed, winding
temperature and resistance. The estimates are shown beside the truth as they come; at the end stand an error table and
a picture.

Device time runs twenty times faster than the clock, so that a minute shows twenty minutes of a motor
that warms and cools.
"""

import csv
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

import matplotlib
import numpy as np

from motorlens_physics.recording import Recording, read_recording
from motorlens_runtime.estimate.quality import names

matplotlib.use("Agg")

ROOT = Path(__file__).resolve().parents[1]
MOTOR = ROOT / "models/motors/mellah2016.toml"
SENSOR = ROOT / "models/sensors/mellah2016.onnx"
MOTORLENS = Path(sys.executable).with_name("motorlens")
DEVICE_S, SPEEDUP, RATE_HZ, SEED = 1200, 20, 500, 11
# Quantity, unit, and the headings of the estimate and its standard deviation in what `motorlens run` publishes.
QUANTITIES = (
    ("speed", "rad/s", "speed_rad_s", "speed_sd_rad_s"),
    ("temperature", "K", "temperature_rise_K", "temperature_rise_sd_K"),
    ("resistance", "ohm", "resistance_ohm", "resistance_sd_ohm"),
)
Row = dict[str, float]


def main() -> int:
    """Run drive and sensor, show, compare, draw."""
    out = ROOT / "out"
    out.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        truth_file = Path(folder) / "truth.csv"
        with subprocess.Popen(
            [
                MOTORLENS, "drive", "--motor", MOTOR, "--scenario", "duty", "--duration", str(DEVICE_S),
                "--rate", str(RATE_HZ), "--speedup", str(SPEEDUP), "--rows-per-frame", "20", "--seed", str(SEED),
                "--truth", truth_file,
            ],
            stdout=subprocess.PIPE, text=True,
        ) as drive:  # fmt: skip
            assert drive.stdout is not None
            port = drive.stdout.readline().strip()
            if not port:
                return drive.wait()
            print(
                f"simulated drive on {port}: {DEVICE_S} s of duty at {RATE_HZ} Hz, {SPEEDUP} times faster than real time\n"
            )
            truth = read_recording(truth_file)
            # It ends before the drive does, which at its end is gone as one that was unplugged.
            with subprocess.Popen(
                [MOTORLENS, "run", "--source", f"pty://{port}", "--sensor", SENSOR, "--publish", "stdout:", "--rate", "2",
                 "--duration", str(DEVICE_S - 1), "--record", out / "demo_samples.csv"],
                stdout=subprocess.PIPE, text=True,
            ) as sensor:  # fmt: skip
                assert sensor.stdout is not None
                rows = follow(sensor.stdout, truth)
        status = sensor.returncode or drive.returncode
    if not rows:
        print("no estimate came; see the messages above", file=sys.stderr)
        return status or 1
    table(rows, truth)
    picture(rows, truth, out / "demo.png")
    print(f"\npicture: {(out / 'demo.png').relative_to(ROOT)}")
    return 0


def true_values(truth: Recording) -> dict[str, np.ndarray]:
    """The three quantities in the units of the sensor: temperature as rise above ambient."""
    channels = truth.channels
    rise = channels["temperature"] - channels["ambient"]
    return {"speed": channels["speed"], "temperature": rise, "resistance": channels["resistance"]}


def follow(lines: Iterable[str], truth: Recording) -> list[Row]:
    """Show each estimate beside the truth as it comes; returns them all."""
    true = true_values(truth)
    print(f"{'time':>8}  {'speed, rad/s':^26}  {'winding rise, K':^26}  {'resistance, ohm':^26}")
    print(f"{'s':>8}  " + 3 * f"{'estimate':>10} {'sd':>6} {'truth':>8}  " + "quality")
    rows = []
    for number, cells in enumerate(csv.DictReader(lines)):
        row = {heading: float(cell) for heading, cell in cells.items()}
        rows.append(row)
        if number % 4:
            continue
        at = min(int(np.searchsorted(truth.time_s, row["time_s"])), len(truth) - 1)
        shown = [f"{row[y]:10.2f} {row[sd]:6.2f} {true[name][at]:8.2f}" for name, _, y, sd in QUANTITIES]
        words = ", ".join(names(int(row["quality"]))) or "good"
        print(f"{row['time_s']:8.1f}  " + "  ".join(shown) + f"  {words}", flush=True)
    return rows


def table(rows: list[Row], truth: Recording) -> None:
    """Root mean square and largest error, and how often the truth was inside two standard deviations."""
    time = np.array([row["time_s"] for row in rows])
    true = true_values(truth)
    print(
        f"\n{'over ' + str(len(rows)) + ' estimates':24}{'rms error':>12}{'largest':>12}{'within 2 sd':>14}"
    )
    for name, unit, column, deviation in QUANTITIES:
        estimate, sd = (np.array([row[heading] for row in rows]) for heading in (column, deviation))
        error = estimate - np.interp(time, truth.time_s, true[name])
        inside = np.mean(np.abs(error) <= 2 * sd)
        print(
            f"{name + ', ' + unit:24}{np.sqrt(np.mean(error**2)):12.2g}{np.abs(error).max():12.2g}{100 * inside:13.1f}%"
        )


def picture(rows: list[Row], truth: Recording, path: Path) -> None:
    """Estimate over truth on the left, the error and its two-sigma band on the right; one row a quantity."""
    from matplotlib import pyplot

    time = np.array([row["time_s"] for row in rows])
    true = true_values(truth)
    figure, panels = pyplot.subplots(
        3, 2, figsize=(12, 7), sharex=True, layout="constrained", width_ratios=(3, 2)
    )
    titles = ("speed, rad/s", "winding rise, K", "resistance, ohm")
    for (left, right), title, (name, _, column, deviation) in zip(panels, titles, QUANTITIES, strict=True):
        estimate, sd = (np.array([row[heading] for row in rows]) for heading in (column, deviation))
        error = estimate - np.interp(time, truth.time_s, true[name])
        left.plot(truth.time_s, true[name], color="#9aa3af", linewidth=2.6, label="truth (no sensor sees it)")
        left.plot(time, estimate, color="#1f5fa8", linewidth=1.0, label="estimate from voltage and current")
        right.fill_between(
            time, -2 * sd, 2 * sd, color="#1f5fa8", alpha=0.2, linewidth=0, label="stated: two sd"
        )
        right.plot(time, error, color="#c2410c", linewidth=0.8, label="error")
        # A step of the load shows for a moment as a large error of the speed; the panel is for the rest of the time.
        limit = 1.5 * max(float(np.quantile(np.abs(error), 0.98)), 2 * float(np.median(sd)))
        right.set(ylim=(-limit, limit), ylabel=f"error, {title.rpartition(' ')[2]}")
        left.set_ylabel(title)
        for axes in (left, right):
            axes.grid(alpha=0.25)
    panels[0, 0].legend(loc="lower right", fontsize="small")
    panels[0, 1].legend(loc="lower right", fontsize="small")
    for axes in panels[-1]:
        axes.set_xlabel("device time, s")
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


if __name__ == "__main__":
    sys.exit(main())
