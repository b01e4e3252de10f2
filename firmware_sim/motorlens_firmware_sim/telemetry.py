"""What the drive sends, as pure bytes: HELLO at boot and every few seconds, SAMPLES in between, STATUS once a second."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from motorlens_firmware_sim.adc import Adc, Codes
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_runtime.line.framing import (
    Flag,
    Hello,
    Status,
    hello_frames,
    samples_frame,
    samples_per_frame,
    status_frame,
)

HELLO_EVERY_S = 2.0
STATUS_EVERY_S = 1.0
SCHEMA = 1


@dataclass(frozen=True)
class Drive:
    """A drive that digitises terminal voltage and current at a fixed rate.

    Attributes:
        voltage, current: the converters.
        rate_Hz: samples per second of device time, a whole number.
        device: what it calls itself.
        boot: a number that is another one after each restart.
        rows_per_frame: instants in one SAMPLES frame.
    """

    voltage: Adc
    current: Adc
    rate_Hz: int
    device: str = "motorlens-drive"
    boot: int = 1
    rows_per_frame: int = 10

    @property
    def hello(self) -> Hello:
        """What the drive says about itself."""
        channels = (self.voltage.channel("voltage", "V"), self.current.channel("current", "A"))
        return Hello(
            self.device, self.boot, (self.rate_Hz, 1), channels, SCHEMA, "firmware_sim", simulated=True
        )

    def digitise(self, recording: Recording) -> Codes:
        """Codes (N, 2) of the voltage and current of a recording sampled at `rate_Hz`."""
        voltage = self.voltage.convert(recording.channels["voltage"])
        return np.column_stack([voltage, self.current.convert(recording.channels["current"])])


@dataclass(frozen=True)
class Sending:
    """Bytes that leave the drive together, when they do (seconds of device time), and how many samples they hold."""

    at_s: float
    data: bytes
    samples: int


def sendings(drive: Drive, codes: Codes) -> Iterator[Sending]:
    """All that a drive sends for the samples `codes` (N, 2), in order.

    A frame leaves when its last sample has been taken. The last frame may hold fewer rows.
    """
    rows = min(drive.rows_per_frame, samples_per_frame(codes.shape[1]))
    saturated = drive.voltage.saturated(codes[:, 0]) | drive.current.saturated(codes[:, 1])
    sequence, clipped = 0, 0
    next_hello = next_status = 0.0
    for start in range(0, len(codes), rows):
        block = codes[start : start + rows]
        taken_s = start / drive.rate_Hz
        t0_us = round(1e6 * taken_s)
        restart = Flag.RESTART if taken_s < 1.0 else Flag(0)
        pieces = []
        if taken_s >= next_hello:
            pieces += hello_frames(drive.hello, sequence=sequence, t0_us=t0_us, flags=restart)
            sequence += len(pieces)
            next_hello += HELLO_EVERY_S
        at_rail = saturated[start : start + rows]
        clipped += int(at_rail.sum())
        flags = restart | (Flag.SATURATED if at_rail.any() else Flag(0))
        pieces.append(samples_frame(block, schema=SCHEMA, sequence=sequence, t0_us=t0_us, flags=flags))
        sequence += 1
        if taken_s >= next_status:
            status = Status(t0_us, start + len(block), 0, clipped)
            pieces.append(status_frame(status, sequence=sequence, t0_us=t0_us, flags=restart))
            sequence += 1
            next_status += STATUS_EVERY_S
        yield Sending((start + len(block) - 1) / drive.rate_Hz, b"".join(pieces), len(block))


def drive_for(
    file: MotorFile, rate_Hz: int, bits: int = 12, rows_per_frame: int = 10, boot: int = 1
) -> Drive:
    """A drive made for a motor: converters with a quarter of headroom over rated voltage and over the stall current."""
    plate, motor = file.rated, file.motor
    stall_A = plate.voltage_V / motor.R_a0
    voltage, current = Adc(bits, 1.25 * plate.voltage_V), Adc(bits, 1.25 * stall_A)
    return Drive(voltage, current, rate_Hz, f"{file.name}-drive", boot, rows_per_frame)
