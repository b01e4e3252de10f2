"""The pages' servers in a crowd: 1000 requests of 200 clients beside 300 half-open connections, and who can read the key.

    python benchmarks/crowd.py
    python benchmarks/crowd.py --only workbench

Both servers as a user starts them, each in a process of its own that may open 1024 files: the page of `motorlens run
--publish web:` with the simulated drive behind it, and `motorlens workbench`. A third of the half-open connections says
nothing, a third half a head, a third a byte a second; whichever is closed is opened again at once. The 200 clients first
hold back the body of a POST, all at once, until no more of them are taken up: each that is takes a thread of the server, and
no such thread ends, so the threads that the kernel counts tell how many were ever served at once. Then all clients ask for
four more things, five seconds apart (the server closes half-open connections after 15), half of them over one connection,
half over a new one each. Last, 1500 programs without the key send whole requests at once.

Exit status 1 if an answer is not the right one, other than 64 are served at once, 300 are not held, a sample of the
drive is lost, the server runs out of files, whoever has no key is let in, or a command line on this machine shows the key.
"""

import argparse
import asyncio
import json
import os
import resource
import selectors
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from http.client import HTTPConnection
from pathlib import Path
from statistics import median

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "tests"))

from helpers.processes import LIMIT_S, MOTORLENS, Program, eventually  # noqa: E402

CLIENTS, EACH, HALF_OPEN, AT_ONCE, FLOOD = 200, 5, 300, 64, 1500
APART_S = 5.0
# What a user may open by default; the flood has to fit into it beside what the server holds.
FILES = 1024
HEAD = b"GET / HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n"
# Title; command; the POST whose body is held back, which changes nothing; what else is asked for.
SERVERS = {
    "run": ("the page of motorlens run",
            ("run", "--source", "sim:mellah2016", "--sensor", "mellah2016", "--publish", "web://127.0.0.1?rate=20&open=1"),
            ("/limit", b'{"remove": "none"}'), ("/", "/live?window=60", "/uPlot.js", "/motors")),
    "workbench": ("the page of motorlens workbench", ("workbench",),
                  ("/cancel", b"{}"), ("/", "/state", "/uplot.js", "/choice")),
}  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=SERVERS, default=list(SERVERS), help="one of the two")
    arguments = parser.parse_args()
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))  # all clients are in this process
    good = True
    for name in arguments.only:
        with tempfile.TemporaryDirectory(prefix="crowd-") as folder:
            good &= crowd(Path(folder), *SERVERS[name])
    return int(not good)


def crowd(
    place: Path, title: str, words: Sequence[str], post: tuple[str, bytes], paths: Sequence[str]
) -> bool:
    """One server; whether all was as it should be."""
    browser = place / "browser"
    script = (
        f"exec > {place}/part 2>&1; printf %s $1; mv {place}/part {place}/opened; while sleep 1; do :; done"
    )
    browser.write_text(f"#!/bin/sh\n{script}\n")
    browser.chmod(0o755)
    environment = {**os.environ, "BROWSER": f"{browser} %s"}
    with ExitStack() as stack:
        program = stack.enter_context(Program([*MOTORLENS, *words], cwd=place, env=environment))
        said = eventually(
            lambda: [w for w in program.error.split() if "?token=" in w], "the address", program
        )
        resource.prlimit(program.pid, resource.RLIMIT_NOFILE, (FILES, FILES))
        address, _, key = said[0].partition("/?token=")
        port = int(address.rpartition(":")[2])
        eventually((place / "opened").exists, "the browser", program)
        ask(port, "/effects", key)  # the workbench has read its catalogue then, whose thread ends soon
        without = settled(program.pid) - 1  # one thread has answered
        before_s = spent_s(program.pid)
        again = stack.enter_context(half_open(port))
        files = stack.enter_context(open_files(program.pid))
        lost, taken = requests(port, key, post, paths, lambda: threads(program.pid) - without)
        at_once, most, usual = settled(program.pid) - without, max(files), median(files)
        seen, lines, once = shown(key), shown(""), shown((place / "opened").read_text())
        after_s = spent_s(program.pid)
        print(f"{title}: {CLIENTS * EACH} requests of {CLIENTS} clients, {len(lost)} lost; of {CLIENTS} at once {taken} "
              f"were taken up, never more than {at_once}")  # fmt: skip
        print(f"  {HALF_OPEN} half-open connections beside, {again[0]} closed and opened again; files open: {usual:.0f} "
              f"as a rule, {most} at most; {after_s - before_s:.1f} s of a processor")  # fmt: skip
        print(f"  the key is in {seen} of {lines} command lines, the address that is good once in {once}")
        for found in lost[:3]:
            print(f"  lost: {found}")
        good = not lost and taken == at_once == AT_ONCE and usual > HALF_OPEN and not seen and once
        refused, let_in, answered = asyncio.run(flood(port, key))
        flood_s, most = spent_s(program.pid) - after_s, max(files)
        hung_up = FLOOD - refused - let_in
        print(f"  {FLOOD} more at once without the key: {refused} refused, {hung_up} hung up on, {let_in} let in; "
              f"{answered} of 20 with the key answered meanwhile; {flood_s:.1f} s of a processor, {most} files")  # fmt: skip
        good = good and most < FILES and let_in == 0 and answered == 20
        if words[0] == "run":
            counts = json.loads(ask(port, "/live", key)[1])["counts"]
            print(f"  the drive sent {counts['samples']} samples, {counts['lost']} lost")
            good = good and counts["samples"] > 0 and counts["lost"] == 0
        stack.pop_all().close()
    return bool(good)


def ask(port: int, path: str, key: str, connection: HTTPConnection | None = None) -> tuple[int, bytes]:
    """One request; over a connection that stays open, or a new one."""
    line = connection or HTTPConnection("127.0.0.1", port, timeout=LIMIT_S)
    line.request("GET", path, headers={"Authorization": f"Bearer {key}"})
    answer = line.getresponse()
    found = answer.status, answer.read()
    if connection is None:
        line.close()
    return found


def requests(
    port: int, key: str, post: tuple[str, bytes], paths: Sequence[str], served: Callable[[], int]
) -> tuple[list[object], int]:
    """All requests of all clients: those that were lost, and how many POSTs without their body were served at once."""
    path, body = post
    right = {path: len(ask(port, path, key)[1]) for path in paths if path.endswith(".js")}
    lost: list[object] = []
    sent, started, go = [0], [0.0], threading.Event()

    def client(number: int) -> None:
        try:
            line = HTTPConnection("127.0.0.1", port, timeout=LIMIT_S)
            line.putrequest("POST", path)
            for name, text in (("Authorization", f"Bearer {key}"), ("Content-Type", "application/json"),
                               ("Content-Length", str(len(body)))):  # fmt: skip
                line.putheader(name, text)
            line.endheaders()
            sent[0] += 1
            assert go.wait(LIMIT_S)
            line.send(body)
            answer = line.getresponse()
            if (answer.status, answer.read()) != (200, b"{}"):
                lost.append((number, path, answer.status))
        except (OSError, AssertionError) as error:
            lost.append((number, path, repr(error)))
        for k, asked in enumerate(paths):
            time.sleep(max(0.0, started[0] + APART_S * k - time.monotonic()))
            try:
                status, octets = ask(port, asked, key, line if number % 2 else None)
                if status != 200 or not octets or len(octets) != right.get(asked, len(octets)):
                    lost.append((number, asked, status, len(octets)))
            except OSError as error:
                lost.append((number, asked, repr(error)))
        line.close()

    clients = [threading.Thread(target=client, args=(number,), daemon=True) for number in range(CLIENTS)]
    for thread in clients:
        thread.start()
    eventually(lambda: sent[0] == CLIENTS, "all clients have sent the head of a request")
    # Those beyond stay in the queue however long one waits; the server waits half a minute for a body.
    end, at_once = time.monotonic() + 10.0, 0
    while time.monotonic() < end and at_once < AT_ONCE:
        time.sleep(0.1)
        at_once = served()
    time.sleep(1.0)
    at_once = served()
    started[0] = time.monotonic()
    go.set()
    for thread in clients:
        thread.join(LIMIT_S)
    lost += ["a client that has not ended"] * sum(thread.is_alive() for thread in clients)
    return lost, at_once


@contextmanager
def half_open(port: int) -> Iterator[list[int]]:
    """Connections that never finish a request; how many were closed and opened again."""
    stop, again = threading.Event(), [0]

    def opened(number: int) -> socket.socket:
        line = socket.create_connection(("127.0.0.1", port), timeout=LIMIT_S)
        line.sendall(HEAD % port if number % 3 == 1 else b"")
        line.setblocking(False)
        return line

    lines = {opened(k): k for k in range(HALF_OPEN)}

    def hold() -> None:
        with selectors.DefaultSelector() as selector:
            for line in lines:
                selector.register(line, selectors.EVENT_READ)
            dripped_s = time.monotonic()
            while not stop.is_set():
                closed = [key.fileobj for key, _ in selector.select(0.1)]
                for line in closed:  # whatever has come: nothing is owed to half a request
                    selector.unregister(line)
                    line.close()
                    number = lines.pop(line)
                    new = opened(number)
                    lines[new] = number
                    selector.register(new, selectors.EVENT_READ)
                again[0] += len(closed)
                if time.monotonic() - dripped_s >= 1.0:
                    dripped_s = time.monotonic()
                    for line in [line for line, k in lines.items() if k % 3 == 2]:
                        with suppress(OSError):
                            line.send(b"G")

    thread = threading.Thread(target=hold, daemon=True)
    thread.start()
    try:
        yield again
    finally:
        stop.set()
        thread.join(LIMIT_S)
        for line in lines:
            line.close()


async def flood(port: int, key: str) -> tuple[int, int, int]:
    """Whole requests without the key: how many are refused and let in, and of 20 with it answered."""

    async def said(head: bytes) -> bytes:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(head + b"\r\n")
        line = await reader.readline()
        writer.close()
        return line.split()[1] if line else b""

    with_key = HEAD % port + b"Authorization: Bearer " + key.encode() + b"\r\n"
    strangers = [asyncio.create_task(said(HEAD % port)) for _ in range(FLOOD)]
    answered = [await asyncio.wait_for(said(with_key), LIMIT_S) for _ in range(20)]
    refused = await asyncio.wait_for(asyncio.gather(*strangers, return_exceptions=True), LIMIT_S)
    return refused.count(b"403"), refused.count(b"200"), answered.count(b"200")


@contextmanager
def open_files(pid: int) -> Iterator[list[int]]:
    """How many files the process has open, a hundred times a second."""
    stop, found = threading.Event(), [0]

    def watch() -> None:
        while not stop.wait(0.01):
            found.append(len(os.listdir(f"/proc/{pid}/fd")))

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield found
    finally:
        stop.set()
        thread.join(LIMIT_S)


def threads(pid: int) -> int:
    """How many threads a process has."""
    return len(os.listdir(f"/proc/{pid}/task"))


def settled(pid: int) -> int:
    """How many threads a process has, once that stays."""
    found = -1
    while found != (found := threads(pid)):
        time.sleep(1.0)
    return found


def spent_s(pid: int) -> float:
    """Processor time that a process has used until now."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def shown(text: str) -> int:
    """In how many command lines on this machine a text stands."""
    found = 0
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):  # it has ended
            found += text.encode() in path.read_bytes().replace(b"\0", b" ")
    return found


if __name__ == "__main__":
    sys.exit(main())
