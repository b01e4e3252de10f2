"""Arrays of long recordings, which are to be given back to the system when they are dropped."""

import ctypes
import sys

# M_MMAP_THRESHOLD of <malloc.h>, and from which size on an array stands alone.
_MMAP_THRESHOLD, _LARGE_OCTETS = -3, 1 << 20


def give_back() -> None:
    """Have large arrays return to the system when they are dropped, from now on.

    Once one has been dropped, glibc keeps all of its size in one heap (mallopt(3): the threshold grows), where the holes
    between arrays that live on stay: a tenth of the memory of a long recording. Elsewhere nothing is done.
    """
    library = ctypes.CDLL(None) if sys.platform == "linux" else None
    if library is not None and hasattr(library, "mallopt"):
        library.mallopt(_MMAP_THRESHOLD, _LARGE_OCTETS)
