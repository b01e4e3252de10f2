"""Records that are made anew at every block of samples.

To the type checker a `record` is a frozen dataclass, and changing one is an error. At run time it is a plain one with slots:
a frozen one, which checks every field it sets, takes five times as long to make.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

__all__ = ["record"]

if TYPE_CHECKING:
    from dataclasses import dataclass as record
else:

    def record(*, frozen: bool) -> Callable[[type], type]:
        """`@record(frozen=True)`, as `dataclass`."""
        return dataclass(slots=True)
