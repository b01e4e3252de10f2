"""Text for Arrow's CSV reader, in memory that Arrow owns and in blocks that it reads in the calling thread.

Arrow's threads give back what they read with, in their own time. Where that is memory of Python, or a file or function of
Python, they need the interpreter for it, and a process whose interpreter is just ending is aborted ("terminate called
without an active exception", apache/arrow issue 34314): about one short run in two hundred.
"""

from collections.abc import Iterator
from typing import Any, BinaryIO

BLOCK_BYTES = 1 << 24


def arrow_buffer(octets: bytes) -> Any:
    """A copy of the octets as a `pyarrow.Buffer` of Arrow's own.

    Raises:
        ModuleNotFoundError: pyarrow is not installed.
    """
    import pyarrow as pa

    with pa.BufferOutputStream() as copy:
        copy.write(octets)
        return copy.getvalue()


def blocks_of_lines(file: BinaryIO, size: int = BLOCK_BYTES) -> Iterator[bytes]:
    r"""The rest of a file in blocks of about `size` octets that end with a line.

    >>> import io
    >>> list(blocks_of_lines(io.BytesIO(b"1,2\n3,4\n5"), size=5))
    [b'1,2\n3,4\n', b'5']
    """
    while block := file.read(size):
        yield block + file.readline()
