"""`mcap:FILE`: a log that PlotJuggler and Foxglove open, each row a JSON message with its schema. Needs the extra `mcap`.

Messages are written one by one, without chunks and index: what was flushed before a kill can be read, and no index grows in
memory for months. Source: the MCAP specification 0 (mcap.dev).
"""

import json
from pathlib import Path
from typing import IO, Any
from urllib.parse import SplitResult

from mcap.writer import CompressionType, IndexType, Writer

from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.publish import Header, file_of, options_of
from motorlens_runtime.publish.jsonl import documents


def open_url(url: SplitResult, header: Header) -> "McapPublisher":
    """See `publish`. An existing file is replaced."""
    options_of(url)
    return McapPublisher(Path(file_of(url)).open("wb"), header)


class McapPublisher:
    """Writes to an open binary file."""

    def __init__(self, file: IO[bytes], header: Header) -> None:
        self._file = file
        self._header = header
        self._last_ns = 0
        self._writer = Writer(
            file,
            compression=CompressionType.NONE,
            index_types=IndexType.NONE,
            use_chunking=False,
            use_summary_offsets=False,
        )
        self._writer.start(profile="", library="motorlens")
        about = {
            "sensor": header.sensor,
            "version": header.version,
            "sha256": header.digest,
            "device": header.device,
        }
        self._writer.add_metadata("motorlens", about)
        self._rows = self._channel("estimates", _row_schema(header))
        self._events = self._channel("events", {"type": "object"})

    def publish(self, estimates: Estimates) -> None:
        """One message per row, at the time of its sample."""
        for time_ns, row in zip(estimates.time_ns.tolist(), documents(estimates, self._header), strict=True):
            self._last_ns = max(time_ns, 0)
            self._write(self._rows, row)

    def event(self, event: dict[str, Any]) -> None:
        """One message."""
        self._write(self._events, event)

    def flush(self) -> None:
        """Hand what was written to the operating system."""
        self._file.flush()

    def close(self) -> None:
        """Write the end and close the file."""
        try:
            self._writer.finish()
        finally:
            self._file.close()

    def _channel(self, topic: str, schema: dict[str, Any]) -> int:
        number = self._writer.register_schema(f"motorlens.{topic}", "jsonschema", json.dumps(schema).encode())
        return int(self._writer.register_channel(topic, "json", number))

    def _write(self, channel: int, document: dict[str, Any]) -> None:
        self._writer.add_message(channel, self._last_ns, json.dumps(document).encode(), self._last_ns)


def _row_schema(header: Header) -> dict[str, Any]:
    number = {"type": ["number", "null"]}
    headings = [name for output in header.outputs for name in (output.heading, output.sd_heading)]
    properties = {
        "timestamp": {"type": "number"},
        **dict.fromkeys(headings, number),
        "quality": {"type": "integer"},
    }
    return {
        "type": "object",
        "properties": {**properties, "reasons": {"type": "array", "items": {"type": "string"}}},
    }
