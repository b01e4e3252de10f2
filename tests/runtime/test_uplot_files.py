"""The plotting library that pages bring along is the published one, unchanged, and its licence is beside it."""

import hashlib

from motorlens_runtime.web import asset


def test_the_vendored_files_are_the_published_ones():
    sums = [line.split() for line in asset("motorlens_runtime.web.uplot", "SHA256SUMS").decode().splitlines()]
    assert [name for _, name in sums] == ["LICENSE", "uPlot.iife.min.js", "uPlot.min.css"]
    for checksum, name in sums:
        assert hashlib.sha256(asset("motorlens_runtime.web.uplot", name)).hexdigest() == checksum, name
    assert b"MIT License" in asset("motorlens_runtime.web.uplot", "LICENSE")
