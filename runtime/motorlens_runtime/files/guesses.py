"""Numbers without a unit that may be counts or milliseconds: taking them for SI would be a guess."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError
from motorlens_runtime.files.columns import Column
from motorlens_runtime.files.headings import QUANTITIES

Array = NDArray[np.float64]

# So many different whole numbers are a converter's; a command that is given in whole volts has fewer.
_WHOLE = 32


def refuse_counts(columns: Mapping[str, Column], values: Callable[[str], Array], where: str) -> None:
    """Refuse whole numbers without a unit as time, voltage or current.

    Args:
        columns: quantity to column.
        values: from a quantity to its numbers (N,).
        where: the file's name, for messages.

    Raises:
        DataError: which column, and how to say what it is.
    """
    time = columns["time"]
    stamps = values("time")
    if time.assumed and len(stamps) > 1 and np.all(stamps == np.round(stamps)):
        raise DataError(
            f"{where}: column {time.heading!r} holds whole numbers without a unit: seconds, milliseconds or a count of "
            f"rows? Say which: --column time_s={time.heading}, --column time_ms={time.heading}, or "
            f"--column 'time={time.heading}*0.001[s]' for rows at 1 kHz"
        )
    for quantity in ("voltage", "current"):
        column = columns.get(quantity)
        if column is not None and column.assumed and not column.formula and _counts(values(quantity)):
            unit = QUANTITIES[quantity][0]
            raise DataError(
                f"{where}: column {column.heading!r} holds whole numbers without a unit: counts of a converter? Scale them, "
                f"--column '{quantity}={column.heading}*0.01[{unit}]', or say the unit: "
                f"--column {quantity}_{unit}={column.heading}"
            )


def _counts(y: Array) -> bool:
    finite = y[np.isfinite(y)]
    return bool(np.all(finite == np.round(finite))) and len(np.unique(finite)) >= _WHOLE
