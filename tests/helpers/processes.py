"""Programs that a test starts, and waiting for them: every wait has an end, and what was said is shown where it fails."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Self, TypeVar

T = TypeVar("T")

MOTORLENS = (sys.executable, "-m", "motorlens_runtime")
# A machine that is busy with other things needs many times what an idle one does: a limit is there to end a test that would
# never end, not to judge a speed. (The first fit of a program compiles for 25 s of a processor.)
LIMIT_S = 300.0


def eventually(condition: Callable[[], T], what: str, *programs: "Program", seconds: float = LIMIT_S) -> T:
    """What `condition` returns once that is true.

    Raises:
        AssertionError: it was not true within `seconds`, or one of `programs` ended before; with what the programs said.
    """
    end = time.monotonic() + seconds
    while True:
        ended = [program for program in programs if program.returncode is not None]
        late = time.monotonic() > end
        if found := condition():
            return found
        told = "\n".join(program.told() for program in programs)
        assert not ended, f"{what}: the program ended before\n{told}"
        assert not late, f"{what}: did not come about within {seconds:g} s\n{told}"
        time.sleep(0.02)


def ran(
    command: Sequence[object],
    cwd: Path | str | None = None,
    env: Mapping[str, str] | None = None,
    seconds: float = LIMIT_S,
) -> subprocess.CompletedProcess[str]:
    """Run a program to its end, whatever its status; what it says is text.

    Raises:
        AssertionError: it did not end within `seconds`; with what it said until then.
    """
    with Program(command, cwd, env) as program:
        status = program.ended(seconds)
    return subprocess.CompletedProcess(program.command, status, program.out, program.error)


class Program:
    """A process of its own group whose words are read as they come. Leaving the `with` block ends the whole group."""

    def __init__(
        self,
        command: Sequence[object],
        cwd: Path | str | None = None,
        env: Mapping[str, str] | None = None,
        stdin: int = subprocess.DEVNULL,
    ) -> None:
        self.command = [str(word) for word in command]
        self._process = subprocess.Popen(
            self.command, cwd=cwd, env=env, stdin=stdin, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True, start_new_session=True,
        )  # fmt: skip
        self._out: list[str] = []
        self._error: list[str] = []
        self._readers = [
            threading.Thread(target=self._read, args=pair, daemon=True)
            for pair in ((self._process.stdout, self._out), (self._process.stderr, self._error))
        ]
        for reader in self._readers:
            reader.start()

    @staticmethod
    def _read(stream: IO[str], into: list[str]) -> None:
        with stream:
            into.extend(stream)

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def stdin(self) -> IO[str]:
        assert self._process.stdin is not None
        return self._process.stdin

    @property
    def returncode(self) -> int | None:
        """Exit status, None while it runs."""
        return self._process.poll()

    @property
    def out(self) -> str:
        """What it has said on standard output so far."""
        return "".join(self._out)

    @property
    def error(self) -> str:
        """What it has said on standard error so far."""
        return "".join(self._error)

    def told(self) -> str:
        """Everything there is to know about it, for a message."""
        state = "runs" if self.returncode is None else f"ended with {self.returncode}"
        return (
            f"{' '.join(self.command)}: {state}\nstandard output:\n{self.out}\nstandard error:\n{self.error}"
        )

    def line(self, number: int = 0, of_error: bool = False, seconds: float = LIMIT_S) -> str:
        """A line it says, by number from 0, without its end."""
        lines = self._error if of_error else self._out
        eventually(lambda: len(lines) > number, f"line {number}", self, seconds=seconds)
        return lines[number].rstrip("\n")

    def send(self, number: int) -> None:
        """Send a signal."""
        self._process.send_signal(number)

    def ended(self, seconds: float = LIMIT_S) -> int:
        """Wait for its end; returns the exit status. Afterwards `out` and `error` are complete."""
        if self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.close()
        try:
            status = self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"did not end within {seconds:g} s\n{self.told()}") from None
        for reader in self._readers:
            reader.join(60.0)
        return status

    def kill(self) -> None:
        """End it and all it has started, at once."""
        with suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        self.ended()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.kill()
