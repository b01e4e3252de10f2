"""`csv:FILE`: time, each estimate with its standard deviation, and the quality word; a heading line, SI units."""

import sys
from pathlib import Path
from typing import IO
from urllib.parse import SplitResult

import numpy as np

from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.files.decimal_text import seconds_text, table
from motorlens_runtime.publish import Header, file_of, options_of

# From this many rows on, writing them together is faster; the text is the same.
_MANY = 64


def open_url(url: SplitResult, header: Header) -> "CsvPublisher":
    """See `publish`. An existing file is replaced."""
    options_of(url)
    return CsvPublisher(Path(file_of(url)).open("w", encoding="ascii", newline=""), header)


class CsvPublisher:
    """Writes to an open text file. Nine significant digits hold a float32 exactly."""

    gather_s = 0.02

    def __init__(self, file: IO[str], header: Header) -> None:
        self._file = file
        columns = [name for output in header.outputs for name in (output.heading, output.sd_heading)]
        self._file.write(",".join(["time_s", *columns, "quality"]) + "\n")
        self._line = "%s" + ",%.9g" * len(columns) + ",%d\n"

    def publish(self, estimates: Estimates) -> None:
        """One line per row."""
        rows = np.stack((estimates.values, estimates.sigma), axis=2).reshape(len(estimates), -1)
        if len(estimates) >= _MANY and estimates.time_ns[0] >= 0:
            self._file.write(table(estimates.time_ns, rows, estimates.quality).decode("ascii"))
            return
        lines = zip(
            map(seconds_text, estimates.time_ns.tolist()),
            rows.tolist(),
            estimates.quality.tolist(),
            strict=True,
        )
        self._file.write("".join([self._line % (time, *row, word) for time, row, word in lines]))

    def flush(self) -> None:
        """Hand what was written to the operating system."""
        self._file.flush()

    def close(self) -> None:
        """Close the file, unless it is standard output."""
        if self._file is sys.stdout:
            self._file.flush()
        else:
            self._file.close()
