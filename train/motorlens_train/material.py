"""What a training command works on: cycles to train, calibrate and test on, and the recipe that suits them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from motorlens_physics.make import of_make
from motorlens_physics.motor_file import Knowledge, MotorFile, read_motor_file
from motorlens_physics.parameter import parameters
from motorlens_physics.recording import Recording, read_recording
from motorlens_physics.scenario import parse_noise, time_constants
from motorlens_runtime.errors import DataError
from motorlens_train.alone import OUTPUTS, alone
from motorlens_train.baselines.calibration import calibrated
from motorlens_train.baselines.extended_kalman import noise_of as noise_found
from motorlens_train.build import Recipe
from motorlens_train.data import Cycle, cycle
from motorlens_train.duty_cycles import LEAST, MOST, Noise, duty_cycle, instants
from motorlens_train.evaluation.scores import counted
from motorlens_train.features import motor_bank, recording_bank
from motorlens_train.observer.belief import left_open
from motorlens_train.observer.design import ObserverSettings, with_observer
from motorlens_train.paper import PaperRun, paper_run
from motorlens_train.specification import Array, Bank, Rate
from motorlens_train.trainer import Settings

# Rows kept of each simulated cycle: neighbours tell nothing new.
ROWS = 400
LONGEST_S = 7200.0
# What differs from motor to motor of one make.
VARYING = ("R_a0", "ke", "J", "H", "k0", "k_ir")


@dataclass(frozen=True)
class Material:
    """Cycles by purpose, never shared between purposes.

    `origin` says in words where they come from; `cases` are further cycles, by title, on which errors are measured.
    """

    recipe: Recipe
    training: tuple[Cycle, ...]
    calibration: tuple[Cycle, ...]
    unseen: tuple[Cycle, ...]
    origin: str
    cases: Mapping[str, tuple[Cycle, ...]] = field(default_factory=dict)


def from_motor(
    path: Path,
    name: str,
    cycles: int,
    rate_Hz: float,
    noise: Sequence[str],
    seed: int,
    hidden: tuple[int, ...] | None,
    iterations: int,
    done: Callable[[int], None] = lambda count: None,
    observed: MotorFile | None = None,
    tolerance: float = 0.0,
    make: MotorFile | None = None,
) -> Material:
    """Simulated duty cycles of a motor: three fifths to train on, one fifth each to calibrate and to test.

    With `observed`, a physics observer of that motor runs inside the sensor. With a `tolerance` every cycle is of another
    motor, whose parameters differ by up to that share from those of the file, see `relative`; with a `make`, as motors of it
    do, see `of_the_make`.

    Raises:
        DataError, ModelError: the motor file or an argument is at fault.
    """
    if not 0.0 <= tolerance < 0.5:
        raise DataError(f"--tolerance {100 * tolerance:g}: percent, at least 0 and below 50")
    if cycles < 10:
        raise DataError(f"--cycles {cycles}: at least 10, so that there are some of each kind")
    file = read_motor_file(path)
    if make is not None:
        file = of_make(file, make)
        observed = observed and of_make(observed, make)
    spread = spread_of(file) if make is not None else evenly(tolerance)
    deviations = noise_of(file, noise)
    bank, starts = bank_of(file), "starts from ambient temperature"
    if observed is not None:
        settings = ObserverSettings(voltage_sd=deviations.voltage_V, current_sd=deviations.current_A)
        bank = with_observer(bank, observed, tolerant(settings, spread))
        bank = bank if spread else alone(bank)
        starts = "every second one started warm or switched on late"
    fifth = cycles // 5
    made: dict[int, Cycle] = {}
    # An observer that stands alone learns nothing: only those to test it on are wanted.
    learns = observed is None or bool(spread)
    numbers = range(cycles + fifth) if learns else (*range(fifth, 2 * fifth), *range(cycles, cycles + fifth))
    for number in numbers:
        # An observer reads the temperature off the inrush, so what it stands in may have any history.
        unknown = number >= cycles or (observed is not None and number % 2 == 1)
        rate = rate_Hz / (1.0, 2.0, 5.0)[number % 3]
        # Nor can it know anything before the first inrush: its errors are counted from a second after that.
        settled = observed is not None and (number >= cycles or fifth <= number < 2 * fifth)
        other = np.random.default_rng([seed, number, 1])
        one = relative(file, tolerance, other) if make is None else of_the_make(file, spread, other)
        # Filters alone show neither how large the noise is nor whose motor it is: what a sensor of them states must hold at
        # the largest noise, and for every motor that the file may mean.
        stated = observed is None and number < fifth
        one = meant(file, other) if stated and not spread else one
        noise_here = deviations.of_any_kind(
            np.random.default_rng([seed, number, 2]), MOST if stated else LEAST
        )
        made[number] = simulated(one, bank, noise_here, rate, [seed, number], unknown, settled)
        done(len(made))
    usual = (12, 8) if observed is None else (6,)
    recipe = Recipe(
        name, bank, OUTPUTS, usual if hidden is None else hidden,
        # The filters of a network alone know the rates they were trained at.
        Rate(rate_Hz, rate_Hz / 5, 2 * rate_Hz) if observed is None else observed_rate(rate_Hz),
        5 * time_constants(file.motor).mechanical_s, seed,
        # What an observer leaves over is small, and alike for minutes.
        Settings(iterations=iterations, time_series=observed is not None),
    )  # fmt: skip
    origin = (
        f"{cycles - 2 * fifth if learns else len(made)} simulated duty cycles of {file.name}: random voltage, load and "
        "ambient, hot restarts, "
        f"{starts}, up to {LONGEST_S:g} s, noise of {deviations.voltage_V:.3g} V and "
        f"{deviations.current_A:.3g} A a sample, times 0.05 to 10, white or coloured"
        + (
            f"; every cycle another motor, its parameters up to {100 * tolerance:g} % off"
            if tolerance
            else ""
        )
        + ("; every cycle another motor of the make" if make is not None and spread else "")
        + ("; errors count from one second after the first voltage step" if observed is not None else "")
    )
    parts = range(2 * fifth, cycles), range(fifth), range(fifth, 2 * fifth), range(cycles, cycles + fifth)
    training, calibration, unseen, late = (
        tuple(made[k] for k in part if k in made and len(made[k].x)) for part in parts
    )
    cases = {"started warm or switched on late, unknown to the sensor": late} if late else {}
    return Material(recipe, training, calibration, unseen, origin, cases)


def observed_rate(rate_Hz: float) -> Rate:
    """Rates of an observer, whose equations hold at any: it is judged at a fifth to twenty times the nominal one, and steps
    of a clock that jitters are up to a fifth off."""
    return Rate(rate_Hz, rate_Hz / 6, 24 * rate_Hz)


def relative(file: MotorFile, tolerance: float, rng: np.random.Generator) -> MotorFile:
    """A motor of the same make: `VARYING` parameters off by up to `tolerance`, as a share, evenly spread."""
    if not tolerance:
        return file
    values = file.values()
    return file.with_values({key: values[key] * rng.uniform(1 - tolerance, 1 + tolerance) for key in VARYING})


def meant(file: MotorFile, rng: np.random.Generator) -> MotorFile:
    """A motor that a file may mean: each parameter of the textbook evenly spread by what the file leaves open of it."""
    values, known = file.values(), file.knowledge
    shares = {key: left_open(known.get(key, Knowledge()), values[key]) for key in parameters(file.motor)}
    return file.with_values({
        key: values[key] * rng.uniform(1 - share, 1 + share) for key, share in shares.items()
    })  # fmt: skip


def of_the_make(file: MotorFile, spread: Mapping[str, float], rng: np.random.Generator) -> MotorFile:
    """A motor of a make, its parameters lognormal about the file's, with relative standard deviations by key."""
    values = file.values()
    return file.with_values(
        {key: values[key] * np.exp(sd * rng.standard_normal()) for key, sd in spread.items()}
    )


def spread_of(file: MotorFile) -> dict[str, float]:
    """Relative standard deviations of `VARYING` parameters, as far as the file states any above 0."""
    values = file.values()
    sds = {key: file.knowledge.get(key, Knowledge()).sd for key in VARYING}
    return {key: sd / abs(values[key]) for key, sd in sds.items() if sd and values[key]}


def evenly(tolerance: float) -> dict[str, float]:
    """The same of parameters that are evenly spread up to a tolerance."""
    return {key: float(tolerance / np.sqrt(3)) for key in VARYING} if tolerance else {}


def tolerant(settings: ObserverSettings, spread: Mapping[str, float]) -> ObserverSettings:
    """An observer that takes ke, R_a0 and J for states, as unsure as motors differ; the thermal ones make a walk."""
    if not spread:
        return settings
    thermal = np.sqrt(np.mean([spread.get(key, 0.0) ** 2 for key in VARYING[3:]]))
    states = tuple((key, spread[key]) for key in VARYING[:3] if key in spread)
    return replace(settings, thermal_walk=float(0.1 * np.sqrt(3) * thermal), tolerances=states)


def paper_of(path: Path, recipe: Recipe, noise: Sequence[str]) -> PaperRun:
    """The paper's protocol on this motor, with a network of the recipe's size and the same noise."""
    file = read_motor_file(path)
    return paper_run(file, recipe, noise_of(file, noise), recipe.seed)


def simulated(
    file: MotorFile, bank: Bank, noise: Noise, rate_Hz: float, seed: list[int], unknown_history: bool = False,
    settled: bool = False,
) -> Cycle:  # fmt: skip
    """One simulated cycle with the rows to train on; `settled` leaves out those before a second after the first step."""
    rng = np.random.default_rng(seed)
    recording = duty_cycle(file, noise, rate_Hz, LONGEST_S, rng, unknown_history)
    rows = instants(recording, ROWS, noise, rng)
    if settled:
        rows = rows[counted(recording, file)[rows]]
    made = cycle(recording, bank, OUTPUTS, rows)
    place = bank.distrust
    # The network mends an observer that foretells; of one that does not, nothing is to be learned.
    return made if place is None else made.part(made.x[:, place] <= 0.0)


def bank_of(file: MotorFile) -> Bank:
    """The default features for a motor."""
    pace = time_constants(file.motor)
    return motor_bank(file.motor.R_a0, file.motor.L, pace.electrical_s, pace.mechanical_s, pace.thermal_s)


def noise_of(file: MotorFile, arguments: Sequence[str]) -> Noise:
    """Noise of voltage and current: 0.2 % and 0.7 % of the rating plate, where the arguments do not say otherwise."""
    chosen = parse_noise(["voltage=0.2%", "current=0.7%", *arguments], file.rated)
    return Noise(chosen["voltage"], chosen["current"])


def from_recordings(
    paths: Sequence[str],
    columns: Sequence[str],
    name: str,
    seed: int,
    hidden: tuple[int, ...] | None,
    iterations: int,
    observed: MotorFile | None = None,
) -> Material:
    """Measured runs; the targets that all of them hold are promised. With six or more, every fifth is kept for calibration.

    With `observed`, a physics observer of that motor, its textbook parameters fitted to the runs, works inside the sensor.

    Raises:
        DataError: no target is measured in all of them, or current is missing.
    """
    recordings = [read_recording(path, columns) for path in paths]
    for recording in recordings:
        if not recording.has("current"):
            raise DataError(
                f"{recording.name}: no current column; a sensor needs voltage and current: --column current=NAME"
            )
    outputs = tuple(q for q in OUTPUTS if all(r.has(q) for r in recordings))
    ambient = all(r.has("ambient") for r in recordings)
    if "temperature" in outputs and not ambient:
        raise DataError(
            f"{recordings[0].name}: temperature was measured but not ambient; map it with --column ambient=NAME"
        )
    if not outputs:
        raise DataError(
            f"{recordings[0].name}: no speed, temperature or resistance in all recordings; map one with --column speed=NAME"
        )
    period = float(np.median([r.period_s for r in recordings]))
    resistance, inductance = electrical(recordings)
    # An observer gives the rise above ambient.
    ambient = ambient and observed is None
    bank = recording_bank(resistance, inductance, period, max(r.duration_s for r in recordings), ambient)
    if observed is not None:
        voltage_sd, current_sd = noise_found(recordings, observed.rated)
        settings = ObserverSettings(voltage_sd=voltage_sd, current_sd=current_sd)
        bank = with_observer(bank, calibrated(observed, recordings), settings)
    kept = [cycle(r, bank, outputs) for r in recordings]
    held = tuple(kept[::5]) if len(kept) >= 6 else ()
    training = tuple(c for c in kept if c not in held) if held else tuple(kept)
    rate = Rate(1 / period, 0.5 / period, 2 / period)
    training_settings = Settings(iterations=iterations, time_series=True, single=False, ridge=1.0)
    recipe = Recipe(
        name, bank, outputs, (4,) if hidden is None else hidden, rate, 20 * period, seed, training_settings
    )
    return Material(
        recipe, training, held, (), f"{len(training)} recordings: {', '.join(c.name for c in training)}"
    )


def electrical(recordings: Sequence[Recording]) -> tuple[float, float]:
    """Resistance and inductance by least squares of `v = R i + L di/dt (+ ke w) (+ constant drop sgn i)`.

    They only place the back-EMF signal; the network corrects what is left. Values that come out negative are set to zero.
    """
    rows: list[Array] = []
    voltages: list[Array] = []
    for recording in recordings:
        i = np.nan_to_num(recording.channels["current"])
        columns = [i, np.gradient(i, recording.time_s), np.sign(i)]
        speed = recording.channels.get("speed")
        columns.append(np.zeros_like(i) if speed is None else np.nan_to_num(speed))
        rows.append(np.stack(columns, axis=1))
        voltages.append(np.asarray(recording.channels["voltage"]))
    found = np.linalg.lstsq(np.concatenate(rows), np.concatenate(voltages), rcond=None)[0]
    return float(f"{max(found[0], 0.0):.4g}"), float(f"{max(found[1], 0.0):.4g}")
