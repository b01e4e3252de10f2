"""Arrays of long recordings, which are to be given back to the system when they are dropped."""

import ctypes
import sys

# M_MMAP_THRESHOLD and M_TRIM_THRESHOLD of <malloc.h>; from which size on an array stands alone, and how much the heap keeps
# of what smaller ones leave: a page that comes anew from the system costs as much as computing what is written into it, and
# a fit of a minute at 1 kHz drops a hundred arrays of a few megabytes in every step.
_MMAP_THRESHOLD, _TRIM_THRESHOLD, _LARGE_OCTETS, _KEPT_OCTETS = -3, -1, 8 << 20, 64 << 20
# M_ARENA_MAX: a thread takes its memory from the heap of all; in one of its own what it leaves would stay when it ends.
_ARENA_MAX, _ARENAS = -8, 1


def give_back() -> None:
    """Have large arrays return to the system when they are dropped, from now on.

    Once one has been dropped, glibc keeps all of its size in one heap (mallopt(3): the threshold grows), where the holes
    between arrays that live on stay: a tenth of the memory of a long recording. Elsewhere nothing is done.
    """
    library = _glibc()
    if library is not None:
        library.mallopt(_MMAP_THRESHOLD, _LARGE_OCTETS)
        library.mallopt(_TRIM_THRESHOLD, _KEPT_OCTETS)
        library.mallopt(_ARENA_MAX, _ARENAS)


def sweep() -> None:
    """Give back what many smaller arrays have left, holes in the midst of the heap too (malloc_trim(3)): once, now."""
    library = _glibc()
    if library is not None:
        library.malloc_trim(0)


def _glibc() -> ctypes.CDLL | None:
    library = ctypes.CDLL(None) if sys.platform == "linux" else None
    return library if library is not None and hasattr(library, "mallopt") else None
