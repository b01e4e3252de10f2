"""`jsonl:FILE`: one JSON object per line. Flat, with `timestamp` in seconds, as PlotJuggler and log shippers read it."""

import json
import sys
from pathlib import Path
from typing import IO, Any
from urllib.parse import SplitResult

from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.estimate.quality import names
from motorlens_runtime.publish import Header, file_of, options_of


def open_url(url: SplitResult, header: Header) -> "JsonLinesPublisher":
    """See `publish`. An existing file is replaced."""
    options_of(url)
    return JsonLinesPublisher(Path(file_of(url)).open("w", encoding="ascii"), header)


def documents(estimates: Estimates, header: Header) -> list[dict[str, Any]]:
    """One dictionary per row; a value that is not finite is None, for JSON has no word for it."""
    headings = [name for output in header.outputs for name in (output.heading, output.sd_heading)]
    rows = []
    for k, time_ns in enumerate(estimates.time_ns.tolist()):
        pairs = zip(estimates.values[k].tolist(), estimates.sigma[k].tolist(), strict=True)
        numbers = [number if abs(number) < float("inf") else None for pair in pairs for number in pair]
        word = int(estimates.quality[k])
        row = {"timestamp": time_ns / 1e9, **dict(zip(headings, numbers, strict=True)), "quality": word}
        rows.append({**row, "reasons": names(word)} if word else row)
    return rows


class JsonLinesPublisher:
    """Writes to an open text file."""

    gather_s = 0.02

    def __init__(self, file: IO[str], header: Header) -> None:
        self._file = file
        self._header = header

    def publish(self, estimates: Estimates) -> None:
        """One line per row."""
        self._file.write("".join(json.dumps(row) + "\n" for row in documents(estimates, self._header)))

    def event(self, event: dict[str, Any]) -> None:
        """One line, told from a row by its `event`."""
        self._file.write(json.dumps(event) + "\n")

    def flush(self) -> None:
        """Hand what was written to the operating system."""
        self._file.flush()

    def close(self) -> None:
        """Close the file, unless it is standard output."""
        if self._file is sys.stdout:
            self._file.flush()
        else:
            self._file.close()
