"""Memory of heat: the estimator's state on disk, so that a restart does not take a hot motor for a cold one.

IEC 60947-4-1 asks it of thermal overload relays with thermal memory. Written atomically (write, fsync, rename, fsync of the
directory): after a crash the file is the old one or the new one. Restored only for the same sensor and device, aged for the
time it was off by the filters' own law `s' = u + (s - u) exp(-dt/tau)`, with u the signals of a motor at rest; an observer
ages by its own model.

The time off is read from the wall clock. A clock that stands before the snapshot (no battery, not yet set) tells nothing;
the motor is then taken to be as hot as it was, the safe side.
"""

import hashlib
import json
import math
import os
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.estimate.bank import FilterBank
from motorlens_runtime.estimate.estimator import EstimatorState
from motorlens_runtime.estimate.gate import GateState, Samples
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.sensor.sensor import Sensor

Array = NDArray[np.float64]

SCHEMA = "motorlens.snapshot/1"


@dataclass(frozen=True)
class Snapshot:
    """What is kept: whose it is, when it was taken (wall clock), the filters' values, the ambient temperature if known, and
    the state of the observer if there is one."""

    sensor: str
    device: str
    wall_time_ns: int
    values: tuple[float, ...]
    ambient_C: float | None
    observer: tuple[float, ...] = ()


@dataclass(frozen=True)
class Restored:
    """A state to go on from, how long the motor is taken to have been off, and a line that says so."""

    state: EstimatorState
    off_s: float
    message: str


def take(sensor: Sensor, device: str, state: EstimatorState, wall_time_ns: int) -> Snapshot:
    """The snapshot of a running estimator."""
    values = tuple(float(value) for value in sensor.bank.values(state.bank))
    ambient = state.gate.ambient_C if sensor.specification.needs_ambient else None
    return Snapshot(sensor.digest, device, wall_time_ns, values, ambient, state.observer)


def save(path: str | Path, snapshot: Snapshot) -> None:
    """Write atomically. Raises OSError, and then the old file is as it was."""
    path = Path(path)
    content = json.dumps({"schema": SCHEMA, **asdict(snapshot)}, allow_nan=False)
    text = json.dumps({"content": content, "sha256": hashlib.sha256(content.encode()).hexdigest()}) + "\n"
    draft = path.with_name(f".{path.name}.draft")
    try:
        with draft.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.replace(draft, path)
    except OSError:
        draft.unlink(missing_ok=True)
        raise
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def load(path: str | Path) -> Snapshot | str | None:
    """The snapshot in a file; None if there is no file; a line that says what is wrong if it cannot be used."""
    try:
        outer = json.loads(Path(path).read_text(encoding="utf-8"))
        content = outer["content"]
        if hashlib.sha256(content.encode()).hexdigest() != outer["sha256"]:
            return f"{path}: damaged; the motor is taken to be cold"
        document = json.loads(content)
        if document["schema"] != SCHEMA:
            return f"{path}: schema {document['schema']!r}; this runtime knows {SCHEMA}"
        values = tuple(float(value) for value in document["values"])
        ambient = document["ambient_C"]
        snapshot = Snapshot(
            str(document["sensor"]), str(document["device"]), int(document["wall_time_ns"]), values,
            None if ambient is None else float(ambient), tuple(float(value) for value in document["observer"]),
        )  # fmt: skip
    except FileNotFoundError:
        return None
    except OSError as error:
        return f"{path}: {error.strerror}; the motor is taken to be cold"
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return f"{path}: damaged; the motor is taken to be cold"
    if not all(map(math.isfinite, (*snapshot.values, snapshot.ambient_C or 0.0, *snapshot.observer))):
        return f"{path}: damaged; the motor is taken to be cold"
    return snapshot


def restore(snapshot: Snapshot, sensor: Sensor, device: str, wall_time_ns: int) -> Restored | str:
    """The state now, or a line that says why the snapshot is not this motor's.

    Args:
        snapshot: what was kept.
        sensor, device: who asks; `device` "" is a line that does not say.
        wall_time_ns: now.
    """
    if snapshot.sensor != sensor.digest:
        return "the snapshot is another sensor's; the motor is taken to be cold"
    if snapshot.device != device:
        return (
            f"the snapshot is of device {snapshot.device!r}, not of {device!r}; the motor is taken to be cold"
        )
    bank, observer = sensor.bank, sensor.extractor.observer
    if len(snapshot.values) != len(bank.signals) or len(snapshot.observer) != len(
        sensor.extractor.start()[1]
    ):
        return "the snapshot does not fit the sensor; the motor is taken to be cold"
    off_s = max(wall_time_ns - snapshot.wall_time_ns, 0) * 1e-9
    values = aged(bank, np.array(snapshot.values), off_s, snapshot.ambient_C)
    message = f"heat remembered from {off_s:.0f} s ago"
    if wall_time_ns < snapshot.wall_time_ns:
        message = "heat remembered; the clock stands before the snapshot, so no cooling is counted"
    memory = snapshot.observer
    if observer is not None and off_s > 0:
        memory = observer.rest(memory, off_s, snapshot.ambient_C)
    state = EstimatorState(bank.start(values), GateState(remembered=True), observer=memory)
    return Restored(state, off_s, message)


def aged(bank: FilterBank, values: Array, off_s: float, ambient_C: float | None) -> Array:
    """Filter values (S,) after `off_s` seconds without voltage and current at the same ambient temperature.

    At rest every signal is zero but the constant one and the ambient temperature.
    """
    rest = {"one": 1.0, "ambient": ambient_C or 0.0}
    u = np.array([rest.get(signal, 0.0) for signal in bank.signals])
    result: Array = u + (values - u) * np.exp(-off_s / bank.tau_s)
    return result


def flagged(samples: Samples, restored_until_ns: int) -> Samples:
    """The samples with `RESTORED` up to the time given: until the history is longer than the sensor's warm-up."""
    recent = samples.time_ns < restored_until_ns
    if not recent.any():
        return samples
    flags = np.zeros(len(samples), dtype=np.uint32) if samples.flags is None else samples.flags.copy()
    flags[recent] |= np.uint32(Quality.RESTORED)
    return Samples(samples.time_ns, samples.voltage_V, samples.current_A, samples.ambient_C, flags)
