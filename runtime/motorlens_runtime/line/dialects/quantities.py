"""From the numbers of a message to samples: units, duty cycle times supply, and where the stamps come from."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.files.columns import understand
from motorlens_runtime.line.dialects.stamps import ArrivalStamps, DeviceStamps, RateStamps, Times
from motorlens_runtime.options import nearest

Array = NDArray[np.float64]

# What a message may carry. A drive that does not measure its terminals says duty cycle and supply voltage instead.
QUANTITIES = ("time", "voltage", "current", "ambient", "duty", "supply_voltage")
_DUTY_UNITS = {"": 1.0, "1": 1.0, "%": 0.01, "percent": 0.01}


def conversion(quantity: str, unit: str, where: str) -> tuple[float, float]:
    """Factor and offset from `unit` to volts, amperes, seconds, degrees Celsius, or a duty cycle in -1..1.

    Raises:
        DataError: the quantity or the unit is unknown.
    """
    if quantity not in QUANTITIES:
        raise DataError(f"{where}: unknown quantity {quantity!r}{nearest(quantity, QUANTITIES)}")
    if quantity == "duty":
        if unit not in _DUTY_UNITS:
            raise DataError(f"{where}: unknown unit {unit!r} for duty; known: 1, %")
        return _DUTY_UNITS[unit], 0.0
    base = "voltage" if quantity == "supply_voltage" else quantity
    column = understand([f"{base} [{unit}]"], {}, where)[base]
    return column.factor, column.offset


def require_channels(present: Sequence[str], where: str) -> None:
    """Refuse a message description from which voltage and current cannot be had."""
    names = set(present)
    if "current" not in names:
        raise DataError(f"{where}: no current among {', '.join(sorted(names)) or 'its fields'}")
    if "voltage" not in names and not {"duty", "supply_voltage"} <= names:
        raise DataError(f"{where}: no voltage; it needs voltage, or duty and supply_voltage")


class Assembler:
    """Columns of one message kind in, samples out.

    Args:
        modulus_ns: where the device's time wraps, None if it does not.
        rate_Hz: the rate of messages that carry no time; None takes their arrival for it.
    """

    def __init__(self, modulus_ns: int | None = None, rate_Hz: float | None = None) -> None:
        self._device = DeviceStamps(modulus_ns)
        self._counted = RateStamps(rate_Hz) if rate_Hz else ArrivalStamps()
        self._last_ns = int(np.iinfo(np.int64).min)

    def samples(self, columns: Mapping[str, Array], now_ns: int) -> Samples:
        """Samples from columns (n,) in SI named as in `QUANTITIES`; rows whose time is not finite are left out."""
        current = columns["current"]
        voltage = columns["voltage"] if "voltage" in columns else columns["duty"] * columns["supply_voltage"]
        ambient = columns.get("ambient")
        if "time" not in columns:
            return Samples(
                self._forward(self._counted.host_times(len(current), now_ns)), voltage, current, ambient
            )
        # 2^62 ns are 146 years; beyond, it is no time.
        usable = np.abs(columns["time"]) < 4.6e9
        if not usable.all():
            voltage, current = voltage[usable], current[usable]
            ambient = None if ambient is None else ambient[usable]
        device_ns = np.round(columns["time"][usable] * 1e9).astype(np.int64)
        return Samples(self._forward(self._device.host_times(device_ns, now_ns)), voltage, current, ambient)

    def _forward(self, times: Times) -> Times:
        """The same, never before the last: messages with a time and such without may follow one another."""
        if len(times):
            times = np.maximum(times, self._last_ns)
            self._last_ns = int(times[-1])
        return times


def concatenate(blocks: Sequence[Samples]) -> Samples:
    """The samples of several blocks as one; an ambient that only some of them know is left out."""
    if len(blocks) == 1:
        return blocks[0]
    if not blocks:
        return empty_samples()
    ambients = [block.ambient_C for block in blocks if block.ambient_C is not None]
    return Samples(
        np.concatenate([block.time_ns for block in blocks]),
        np.concatenate([block.voltage_V for block in blocks]),
        np.concatenate([block.current_A for block in blocks]),
        np.concatenate(ambients) if len(ambients) == len(blocks) else None,
    )


def empty_samples() -> Samples:
    """No samples."""
    return Samples(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))
