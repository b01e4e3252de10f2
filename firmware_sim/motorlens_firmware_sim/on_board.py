"""The simulated drive on an emulated microcontroller, with the sensor on board: hardware in the loop without hardware.

The bench feeds converter codes over one serial line of the board; what the board sends over the other, frames with what it
measured and what its sensor makes of it, is passed on to a pseudo-terminal, on which `motorlens run` listens.
"""

import re
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

from motorlens_firmware_sim.bench import Bench
from motorlens_firmware_sim.boards import FOLDER, Board, compile_for, emulator_command
from motorlens_runtime.errors import DataError
from motorlens_runtime.line.framing import Channel, Hello

ROWS = 8  # samples in a frame, as in drive.c
# Ends the wait for an emulator that hangs.
_START_S = 300.0


class OnBoard:
    """A board that runs.

    Args:
        board: which core.
        exported: the folder of `motorlens export SENSOR --c DIR`, with the default name.
        bench: what drives it.
        pass_on: takes what the board sends, as it comes.

    Raises:
        DataError: the firmware does not compile, or the emulator does not start.
    """

    def __init__(
        self, board: Board, exported: Path, bench: Bench, pass_on: Callable[[bytes], object]
    ) -> None:
        self._bench, self._pass_on = bench, pass_on
        self._scratch = tempfile.TemporaryDirectory(prefix="motorlens-board-")
        folder = Path(self._scratch.name)
        (folder / "drive.h").write_text(drive_header(bench, _outputs_of(exported)), encoding="ascii")
        sources = [p for p in sorted(exported.glob("*.c")) if p.name not in ("main.c", "golden_test.c")]
        flags = tuple(f"-I{path}" for path in (folder, exported, FOLDER.parent / "include"))
        program = compile_for(board, [*sources, FOLDER / "drive.c"], folder / "drive.elf", flags)
        paths = [str(folder / name) for name in ("out", "in")]
        self._emulator = subprocess.Popen(
            emulator_command(board, program, *(f"unix:{path},server=on,wait=on" for path in paths)),
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            self._out, self._in = (self._connected(path) for path in paths)
        except DataError:
            self.close()
            raise
        self._reader = threading.Thread(target=self._listen, name="board", daemon=True)
        self._reader.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def run(self, rate_Hz: float, give_up: Callable[[], bool] = lambda: False) -> int:
        """Feed all codes of the bench, at `rate_Hz` of them a second at most; returns how many samples the board sends.

        Raises:
            DataError: the emulator has ended.
        """
        codes = self._bench.codes[: len(self._bench.codes) // ROWS * ROWS]
        began = time.monotonic()
        for start in range(0, len(codes), ROWS):
            if give_up():
                return start
            try:
                self._in.sendall(codes[start : start + ROWS].astype("<i2").tobytes())
            except OSError as error:
                raise DataError(f"the emulated board is gone: {error.strerror}") from None
            time.sleep(max(began + start / rate_Hz - time.monotonic(), 0.0))
        return len(codes)

    def close(self) -> None:
        """Switch off."""
        self._emulator.kill()
        self._emulator.wait()
        for line in (getattr(self, name, None) for name in ("_out", "_in")):
            if line is not None:
                line.close()
        self._scratch.cleanup()

    def _connected(self, path: str) -> socket.socket:
        end = time.monotonic() + _START_S
        while True:
            line = socket.socket(socket.AF_UNIX)
            try:
                line.connect(path)
                return line
            except OSError:
                line.close()
                if (status := self._emulator.poll()) is not None:
                    raise DataError(f"the emulator of the board ended with {status} as it started") from None
                if time.monotonic() > end:
                    raise DataError(
                        f"the emulator of the board did not start within {_START_S:g} s"
                    ) from None
                time.sleep(0.02)

    def _listen(self) -> None:
        try:
            while data := self._out.recv(65536):
                self._pass_on(data)
        except OSError:
            return  # closed


def _outputs_of(exported: Path) -> int:
    """How many estimates an exported sensor gives."""
    config = (exported / "motorlens_config.h").read_text(encoding="utf-8")
    found = re.search(r"#define MOTORLENS_OUTPUTS (\d+)", config)
    if found is None:
        raise DataError(f"{exported}: not the folder of an exported sensor")
    return int(found.group(1))


def drive_header(bench: Bench, outputs: int) -> str:
    """drive.h for a bench and a sensor of so many outputs."""
    drive = bench.drive
    if 1_000_000 % drive.rate_Hz:
        raise DataError(f"--rate {drive.rate_Hz}: the board counts whole microseconds a sample")
    names = [("voltage", "V"), ("current", "A"), *((f"estimate_{k}", "1") for k in range(outputs))]
    hello = Hello(
        f"{drive.device}-on-board", drive.boot, (drive.rate_Hz, 1), tuple(Channel(name, unit, "f4") for name, unit in names),
        1, "firmware_sim/boards/drive.c", simulated=True,
    )  # fmt: skip
    text = hello.to_json().decode("ascii").replace("\\", "\\\\").replace('"', '\\"')
    return f"""#define DRIVE_HELLO "{text}"
#define DRIVE_PERIOD_US {1_000_000 // drive.rate_Hz}u
#define DRIVE_VOLTAGE_STEP {drive.voltage.step!r}
#define DRIVE_CURRENT_STEP {drive.current.step!r}
"""
