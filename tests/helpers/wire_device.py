"""A device on a pseudo-terminal for tests of the runtime: sends frames in a thread, keeps what it sent."""

import fcntl
import os
import pty
import select
import struct
import tempfile
import termios
import threading
import time
import tty

import numpy as np
from helpers.processes import LIMIT_S

from motorlens_runtime.line.framing import Channel, Hello, hello_frames, samples_frame


class WireDevice:
    """Voltage and current in 12 bits at `rate_Hz`, `n` rows a frame, `count` frames, sent as fast as it is read or paced."""

    def __init__(self, rate_Hz=1000, n=10, count=100, paced=False, boot=1, seed=0):
        self.master, slave = pty.openpty()
        os.set_blocking(self.master, False)
        tty.setraw(slave)
        # From here on, what happens at the other end is told (tty_ioctl(4), packet mode).
        fcntl.ioctl(self.master, termios.TIOCPKT, struct.pack("i", 1))
        # By a name of its own: the number of a line that was unplugged is soon given to another test's, which whoever waits
        # for this one would then open.
        self.folder = tempfile.TemporaryDirectory()
        self.path = os.path.join(self.folder.name, "tty")
        os.symlink(os.ttyname(slave), self.path)
        os.close(slave)
        self.n, self.count, self.rate_Hz, self.paced = n, count, rate_Hz, paced
        ranges = {"voltage": ("V", 0.13), "current": ("A", 0.037)}
        channels = tuple(
            Channel(name, unit, "i2", scale, 0.0, -2048, 2047) for name, (unit, scale) in ranges.items()
        )
        self.hello = Hello("bench", boot, (rate_Hz, 1), channels, simulated=True)
        rng = np.random.default_rng(seed)
        k = np.arange(n * count)
        codes = np.column_stack([1500 * np.sign(np.sin(k / 300)), 400 + 300 * np.sin(k / 170)]) + rng.normal(
            size=(n * count, 2)
        )
        self.codes = np.round(codes).astype(np.int16)
        self.sent = 0
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self.work, daemon=True)

    def frames(self):
        """All frames in order, HELLO first and in between."""
        sequence = 0
        for k in range(self.count):
            t0_us = round(k * self.n * 1e6 / self.rate_Hz)
            if k % 50 == 0:
                for frame in hello_frames(self.hello, sequence=sequence, t0_us=t0_us):
                    yield k, frame
                    sequence += 1
            yield (
                k,
                samples_frame(
                    self.codes[k * self.n : (k + 1) * self.n],
                    schema=1,
                    sequence=sequence & 0xFFFF,
                    t0_us=t0_us,
                ),
            )
            sequence += 1

    def work(self):
        started = time.monotonic()
        for k, frame in self.frames():
            if self.paced:
                time.sleep(max(0.0, started + (k + 1) * self.n / self.rate_Hz - time.monotonic()))
            while frame and not self.stop.is_set():
                try:
                    # Never blocked in the kernel: a thread that is would keep the line open after `unplug`.
                    if select.select([], [self.master], [], 0.1)[1]:
                        frame = frame[os.write(self.master, frame) :]
                except BlockingIOError:
                    continue
                except (OSError, ValueError):
                    return
            if self.stop.is_set():
                return
            self.sent = k + 1

    def start_when_open(self):
        """Start sending once somebody has opened the port and flushed it: what was sent before would be lost."""

        def flushed():
            try:
                return os.read(self.master, 1)[0] & termios.TIOCPKT_FLUSHREAD
            except OSError:  # nobody has it open, or nothing has happened
                return False

        def wait():
            while not self.stop.is_set():
                if flushed():
                    return self.work()
                self.stop.wait(0.01)

        self.thread = threading.Thread(target=wait, daemon=True)
        self.thread.start()

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.unplug()

    def unplug(self):
        """Pull the plug."""
        self.stop.set()
        self.folder.cleanup()
        if self.thread.is_alive() and self.thread is not threading.current_thread():
            # Its number must not be given to another line while the thread may still write to it.
            self.thread.join(LIMIT_S)
        if self.master >= 0:
            os.close(self.master)
            self.master = -1
