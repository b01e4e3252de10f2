"""`stdout:`: the lines of `csv` on standard output; `stdout:jsonl` those of `jsonl`."""

import sys
from urllib.parse import SplitResult

from motorlens_runtime.errors import DataError
from motorlens_runtime.publish import Header, Publisher, options_of
from motorlens_runtime.publish.csv import CsvPublisher
from motorlens_runtime.publish.jsonl import JsonLinesPublisher


def open_url(url: SplitResult, header: Header) -> Publisher:
    """See `publish`."""
    options_of(url)
    form = url.netloc + url.path
    if form in ("", "csv"):
        return CsvPublisher(sys.stdout, header)
    if form == "jsonl":
        return JsonLinesPublisher(sys.stdout, header)
    raise DataError(f"{url.geturl()}: write stdout:csv or stdout:jsonl")
