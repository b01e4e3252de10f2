"""Our own frames, docs/wire-protocol.md: decoded in the C core where there is one, else in Python; see `line.link`."""

from motorlens_runtime.line.core_link import open_link
from motorlens_runtime.line.link import Link
from motorlens_runtime.options import Options


def make(options: Options) -> Link:
    """See `dialects.make_dialect`; there are no options: HELLO says all."""
    return open_link()
