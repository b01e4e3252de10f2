"""Recordings of motors with something hidden in them, by code that shares nothing with the code under test.

    from helpers.hidden import draw, generate
    case = draw("dev", 400)[7]              # or draw("subset", 60, small=True): short records for quick runs
    made = generate(case, Path("/tmp/case"))
    made.recordings                         # CSV paths, one or two: 90 s at 1 kHz, 3 h at 10 Hz
    made.motor                              # the datasheet, a motor file: nominal values, the specimen is off by +-20 %
    made.truth                              # what was hidden: dict, see below; never to be shown to the diagnosis

The same as commands, from the root of the repository (see benchmarks/hidden_effects.py):

    python benchmarks/hidden_effects.py generate --split dev --n 400 -o DIR [--only dev-0007] [--small]
    motorlens diagnose DIR/dev-0007/fast.csv DIR/dev-0007/slow.csv --motor DIR/dev-0007/motor.toml --json out.json

`truth`: `case` (the plan's line, after the records were made good enough to show the effect at all), `kind` none, single,
pair or outside, `textbook` (the specimen's parameters), `floor` (rms that the true model leaves in each channel) and
`hidden`, a list of {name, equation, sensor, outside, parameter, size, detectable, factor, energy, group, rivals,
testable}. `size` is the catalogue parameter's value (a gain as such: 1.03). `group` are the rivals that these channels
cannot tell from it, by the generator's own Fisher information (see information.py).

Inputs are linear between samples. Time stamps jitter by 1 % of the step, written down or not. Voltage and load torque
are measured with noise as well, and a slow torque that nobody measures (0.2 % of rated, 1 s) acts on every shaft.
Where the winding's temperature is measured, the ambient is as well. Columns named `decoy_N` belong to no quantity.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from helpers.hidden import effects as hidden_effects
from helpers.hidden import plant
from helpers.hidden.experiments import experiment
from helpers.hidden.information import POWER, Information, Judgement
from helpers.hidden.plan import best, draw
from helpers.hidden.world import (
    CHANNEL_SETS,
    HEADINGS,
    OUTPUTS,
    Case,
    Record,
    Sized,
    build,
    decoys,
    measured,
    records_of,
    run_truth,
    shaped,
    specimen,
    substeps,
    true_channels,
    write_csv,
)

# What `generate` said of the cases of the plans of 800 and 2400 small ones that tests use: sizing up a case costs seconds.
_KEY = Path(__file__).with_name("dev-key.jsonl")
# A record, and its true channels.
Written = tuple[Record, dict[str, plant.Array]]
# Rounds in which sizes are made consistent with what they are worth.
_TRIALS = 5

__all__ = [
    "Case",
    "Generated",
    "draw",
    "generate",
    "generate_again",
    "generate_experiment",
    "known",
    "size_up",
    "truth_of",
]


@dataclass(frozen=True)
class Generated:
    """The files of a case and its truth."""

    recordings: list[Path]
    motor: Path
    truth: dict[str, object]


def size_up(case: Case) -> tuple[Case, list[Sized], list[Judgement], list[bool]]:
    """Turn multiples of the detectable size into sizes.

    Where the wanted multiple is more than physics allows, the case is measured as well as can be instead; what is still
    too large is hidden at the largest size and marked as not testable.
    """
    if not case.hidden:
        return case, [], [], []
    for attempt in (case, best(case)):
        sized, judged, testable = _sizes(attempt)
        if all(testable):
            return attempt, sized, judged, testable
    return attempt, sized, judged, testable


def _sizes(case: Case) -> tuple[list[Sized], list[Judgement], list[bool]]:
    motor = case.of_motor()
    information = Information(case)
    signs = case.rng(90).choice((-1.0, 1.0), len(case.hidden))
    entries = [hidden_effects.lookup(name, motor) for name, _ in case.hidden]
    signs = np.where([entry.either for entry in entries], signs, 1.0)
    wanted = [0.3 * entry.typical * entry.unit(motor) for entry in entries]
    judged: list[Judgement] = []
    testable = [True] * len(entries)
    for trial in range(_TRIALS):
        sized = [
            Sized(entry.name, entry.null + float(sign) * want, shaped(case, entry.name))
            for entry, sign, want in zip(entries, signs, wanted, strict=True)
        ]
        judged = [information.judge([effect], sized)[0] for effect in sized]
        if trial == _TRIALS - 1:
            break
        for k, (entry, judgement) in enumerate(zip(entries, judged, strict=True)):
            want = case.hidden[k][1] * judgement.detectable
            largest = entry.largest * entry.unit(motor)
            testable[k] = bool(want <= largest)
            wanted[k] = min(want, largest) if np.isfinite(want) else largest
    # An effect that is anything but linear may still be worth much less than its multiple says.
    for k, judgement in enumerate(judged):
        testable[k] &= judgement.energy >= (0.6 * case.hidden[k][1] * POWER) ** 2
    return sized, judged, testable


def generate(case: Case, directory: Path) -> Generated:
    """Write the recordings and the datasheet of a case into `directory`; the truth is returned, not written."""
    case, sized, judged, testable = size_up(case)
    paths, motor, written = _write(case, sized, directory)
    truth: dict[str, object] = {
        "case": case.as_json(),
        "kind": case.kind,
        "textbook": specimen(case),
        "floor": _floor(case, sized, written),
        "hidden": [
            _told(case, effect, judgement, factor, able)
            for effect, judgement, (_, factor), able in zip(sized, judged, case.hidden, testable, strict=True)
        ],
    }
    return Generated(paths, motor, truth)


def generate_again(truth: dict[str, Any], directory: Path) -> Generated:
    """The files of a case whose truth is known: the same as `generate` wrote, without sizing anything up."""
    paths, motor, _ = _write(*_known(truth), directory)
    return Generated(paths, motor, truth)


def known(name: str, directory: Path) -> Generated:
    """A small case of the split `dev` whose truth is kept here: the files that `generate` would write."""
    return generate_again(truth_of(name), directory)


def truth_of(name: str) -> dict[str, Any]:
    """The truth of such a case."""
    truths: Iterator[dict[str, Any]] = map(json.loads, _KEY.read_text(encoding="utf-8").splitlines())
    return next(truth for truth in truths if truth["case"]["id"] == name)


def generate_experiment(truth: dict[str, Any], test: str, seconds: float, directory: Path) -> Path:
    """A recording of the test that a diagnosis proposed (experiments.TESTS), of the same specimen."""
    case, sized = _known(truth)
    path = directory / f"{test}.csv"
    _write_record(case, sized, experiment(case, test, seconds), path)
    return path


def _known(truth: dict[str, Any]) -> tuple[Case, list[Sized]]:
    hidden = tuple((name, factor) for name, factor in truth["case"]["hidden"])
    sized = [
        Sized(told["name"], told["size"] - (1.0 if told["name"].endswith("_gain") else 0.0), told["shape"])
        for told in truth["hidden"]
    ]
    return Case(**(truth["case"] | {"hidden": hidden})), sized


def _write(case: Case, sized: list[Sized], directory: Path) -> tuple[list[Path], Path, list[Written]]:
    directory.mkdir(parents=True, exist_ok=True)
    paths, written = [], []
    for record in records_of(case):
        paths.append(directory / ("slow.csv" if record.slow else "fast.csv"))
        written.append((record, _write_record(case, sized, record, paths[-1])))
    return paths, case.of_motor().write_datasheet(directory / "motor.toml"), written


def _write_record(case: Case, sized: list[Sized], record: Record, path: Path) -> dict[str, plant.Array]:
    states, inputs = run_truth(case, record, specimen(case), sized)
    channels = true_channels(case, record, states, inputs)
    time, shown = measured(case, record, channels, sized)
    columns = {"time_s": time} | {HEADINGS[name]: shown[name] for name in CHANNEL_SETS[case.channels]}
    if "temperature" in shown:
        columns["ambient_C"] = case.of_motor().ambient_C + 0.05 * case.rng(
            91, int(record.slow)
        ).standard_normal(len(time))
    if not record.slow and "speed" in shown:
        angle = states[:: (len(states) - 1) // (len(time) - 1), plant.PHI]
        # An encoder of 4096 counts.
        columns["angle_rad"] = np.floor(angle * 4096 / (2 * np.pi)) * 2 * np.pi / 4096
    columns |= decoys(case, record, time, shown["current"])
    write_csv(path, columns)
    return channels


def _floor(case: Case, sized: list[Sized], written: list[Written]) -> dict[str, float]:
    """The rms that the true model leaves in each output when it is driven by the measured inputs."""
    physics = [effect for effect in sized if "_sensor_" not in effect.name]
    square: dict[str, list[float]] = {}
    for record, channels in written:
        _, shown = measured(case, record, channels, [])
        seen = replace(
            record.drive,
            voltage=shown["voltage"],
            load=shown.get("load_torque", record.drive.load),
            reference=None,
        )
        p, driven = build(case, replace(record, drive=seen), specimen(case), physics)
        states = plant.simulate(seen.dt, driven, record.start, p, substeps(case, record, sized))
        ideal = true_channels(case, record, states, driven)
        for name in OUTPUTS:
            if name in shown:
                square.setdefault(name, []).append(float(np.mean((shown[name] - ideal[name]) ** 2)))
    return {name: float(np.sqrt(np.mean(values))) for name, values in square.items()}


def _told(case: Case, effect: Sized, judgement: Judgement, factor: float, able: bool) -> dict[str, object]:
    entry = hidden_effects.lookup(effect.name, case.of_motor())
    sensor = "_sensor_" in effect.name
    return {
        "name": effect.name,
        "equation": "sensor" if sensor else entry.equation,
        "sensor": sensor,
        "outside": effect.name in hidden_effects.OUTSIDE,
        "parameter": entry.parameter,
        "size": 1 + effect.size if effect.name.endswith("_gain") else effect.size,
        "null": 1.0 if effect.name.endswith("_gain") else entry.null,
        "shape": dict(effect.shape),
        "detectable": judgement.detectable,
        "factor": factor,
        "energy": judgement.energy,
        "group": judgement.group(),
        "rivals": {name: left for name, left in judgement.rivals.items() if left < 400},
        "testable": able,
    }


def as_line(truth: dict[str, object]) -> str:
    """One line of JSON."""
    return json.dumps(truth, sort_keys=True)
