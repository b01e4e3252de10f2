"""Arrow owns what it reads: only then do its threads never need an interpreter that may be ending."""

import io

import pytest

from motorlens_runtime.files.arrow_memory import arrow_buffer, blocks_of_lines

pa = pytest.importorskip("pyarrow", reason="pyarrow is not installed")


def test_the_octets_stand_in_memory_of_arrow():
    pool = pa.default_memory_pool()
    before = pool.bytes_allocated()
    octets = bytes(range(256)) * 400
    buffer = arrow_buffer(octets)
    assert pool.bytes_allocated() - before >= len(octets)
    assert buffer.to_pybytes() == octets


@pytest.mark.parametrize("size", [1, 7, 64, 1 << 20])
def test_blocks_are_the_file_cut_behind_lines(size: int):
    text = b"".join(b"%d,%d\n" % (k, k * k) for k in range(300)) + b"300,90"
    blocks = list(blocks_of_lines(io.BytesIO(text), size))
    assert b"".join(blocks) == text
    assert all(block.endswith(b"\n") for block in blocks[:-1])
    assert len(blocks) == 1 or max(map(len, blocks)) <= size + len(b"299,89401\n")
