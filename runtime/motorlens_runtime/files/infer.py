"""Estimates of a recorded file: the estimator of the live runtime, fed from a file instead of a drive."""

import os
import sys
from collections import Counter
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.core_estimator import open_estimator
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.files.columns import parse_mapping
from motorlens_runtime.files.pipeline import Behind, ahead
from motorlens_runtime.files.recorded import open_recorded, period_of
from motorlens_runtime.progress import Progress
from motorlens_runtime.publish import Header, Publisher
from motorlens_runtime.publish.csv import CsvPublisher
from motorlens_runtime.sensor.sensor import Sensor, load_sensor

# A smaller file is done before threads would have helped.
_SMALL_BYTES = 1 << 21


def infer(
    recording: str,
    sensor_path: str,
    output: Path | None,
    column_arguments: Sequence[str] = (),
    ambient_C: float | None = None,
    backend: str = "auto",
    parquet: bool = False,
) -> dict[str, Any]:
    """Run a sensor over a recorded file and write an estimate for each of its rows.

    Args:
        recording: CSV or Parquet file, see `recorded`.
        sensor_path: sensor file.
        output: where the estimates go; None is standard output as CSV.
        column_arguments: `QUANTITY=NAME` choices of the user.
        ambient_C: ambient temperature where the file has no such column.
        backend: see `sensor.load_sensor`.
        parquet: write Parquet instead of CSV.

    Returns:
        the document of `--json`: rows, period, how many rows carry each quality reason, the first row (of the file, from 1)
        whose voltage or current is no number, notes in words.

    Raises:
        DataError, ModelError: the recording or the sensor is not usable.
    """
    sensor = load_sensor(sensor_path, backend)
    stream = open_recorded(recording, parse_mapping(column_arguments), ambient_C)
    try:
        large = Path(recording).stat().st_size > _SMALL_BYTES
        blocks = ahead(stream) if large else iter(stream)
        first = next(blocks, None)
        if first is None:
            raise DataError(f"{recording}: has a heading but no rows")
        period_s = period_of(first.samples, 1 / sensor.specification.rate_Hz)
        estimator = open_estimator(sensor, period_s)
        publisher = _publisher(sensor, output, parquet)
        if large:
            publisher = Behind(publisher)
        rows, reasons = 0, Counter[str]()
        first_missing: int | None = None
        try:
            with Progress(stream.size, f"infer {Path(recording).name}") as progress:
                for block in chain((first,), blocks):
                    estimates = estimator.push(block.samples)
                    publisher.publish(estimates)
                    any_of_them = int(np.bitwise_or.reduce(estimates.quality))
                    if first_missing is None and any_of_them & Quality.NOT_FINITE:
                        first_missing = rows + int(np.argmax(estimates.quality & Quality.NOT_FINITE > 0))
                    rows += len(estimates)
                    for bit in Quality:
                        if bit & any_of_them and bit.name:
                            reasons[bit.name.lower()] += int(np.count_nonzero(estimates.quality & bit))
                    progress.update(block.position)
        finally:
            publisher.close()
    finally:
        stream.close()
    notes = list(stream.notes)
    if stream.duplicates:
        notes.append(
            f"{stream.duplicates} rows repeat the time of the row before; they count as no step of time"
        )
    return {
        "schema": "motorlens.infer/1",
        "recording": recording,
        "sensor": {
            "name": sensor.name,
            "version": sensor.version,
            "sha256": sensor.digest,
            "backend": sensor.backend.name,
        },
        "outputs": [output.heading for output in sensor.specification.outputs],
        "rows": rows,
        "period_s": period_s,
        "quality": dict(sorted(reasons.items())),
        "first_missing_row": None if first_missing is None else stream.first_row + first_missing,
        "notes": notes,
    }


def _publisher(sensor: Sensor, output: Path | None, parquet: bool) -> Publisher:
    header = header_of(sensor)
    if output is None:
        return CsvPublisher(sys.stdout, header)
    try:
        if parquet:
            from motorlens_runtime.publish.parquet import ParquetPublisher

            return ParquetPublisher(str(output), header)
        return CsvPublisher(output.open("w", encoding="ascii", newline=""), header)
    except OSError as error:
        where = output if output.is_dir() else output.parent
        raise DataError(f"{where}: cannot write there: {_reason(error)}") from None


def _reason(error: OSError) -> str:
    return os.strerror(error.errno) if error.errno else str(error)


def header_of(sensor: Sensor, device: str = "") -> Header:
    """What publishers say of a sensor."""
    return Header(sensor.name, sensor.version, sensor.digest, sensor.specification.outputs, device)
