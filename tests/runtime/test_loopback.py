"""The server of the pages: who is answered and who is not."""

import contextlib
import http.client
import os
import socket
import struct
import subprocess
import textwrap
import threading
import time
from collections import deque
from pathlib import Path

import pytest
from helpers.processes import LIMIT_S, MOTORLENS, Program, eventually

from motorlens_runtime.errors import DeviceError
from motorlens_runtime.web import connections, style
from motorlens_runtime.web.connections import MOST_SERVED
from motorlens_runtime.web.loopback import MOST_OCTETS, Answer, LoopbackServer
from motorlens_runtime.web.peer import user_of


@pytest.fixture
def server():
    server = LoopbackServer(lambda request: Answer(f"{request.method} {request.path}".encode(), "text/plain"))
    yield server
    server.close()


def ask(server, path="/", method="GET", body=None, seconds=LIMIT_S, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=seconds)
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(method, path, body, named)
    reply = connection.getresponse()
    found = reply.status, reply.read().decode(), dict(reply.getheaders())
    connection.close()
    return found


def bearer(server):
    return {"Authorization": f"Bearer {server.token}"}


def test_the_address_that_is_printed_opens_and_its_cookie_opens_the_rest(server):
    path = server.url.removeprefix(f"http://127.0.0.1:{server.port}")
    status, text, headers = ask(server, path)
    assert (status, text) == (200, "GET /")
    cookie = headers["Set-Cookie"]
    assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    shown = {"Cookie": cookie.partition(";")[0]}
    for site in ("same-origin", "none"):
        assert ask(server, "/anything", **shown, Sec_Fetch_Site=site)[:2] == (200, "GET /anything")
    # A server on another port of this machine is shown the cookie too, and a page of it is of the same site.
    for said in ({"Sec_Fetch_Site": "same-site"}, {"Sec_Fetch_Site": "cross-site"}, {}):
        assert ask(server, "/anything", **shown, **said)[0] == 403
    assert server.token not in cookie
    assert (
        ask(server, "/anything", Authorization=f"Bearer {cookie.partition(';')[0].partition('=')[2]}")[0]
        == 403
    )


def test_no_other_page_shows_it_in_a_frame(server):
    for path in ("/", "/report.html"):
        headers = ask(server, path, **bearer(server))[2]
        assert "frame-ancestors 'self'" in headers["Content-Security-Policy"]
        assert headers["X-Frame-Options"] == "SAMEORIGIN"


def test_what_a_command_line_shows_opens_once(server):
    address = server.url_for_once()
    assert server.token not in address and address != server.url_for_once()
    path = address.removeprefix(f"http://127.0.0.1:{server.port}")
    assert ask(server, "/other" + path[1:])[0] == 403
    status, _, headers = ask(server, path)
    assert status == 200
    shown = {"Cookie": headers["Set-Cookie"].partition(";")[0], "Sec_Fetch_Site": "none"}
    assert ask(server, path, **shown)[0] == 200  # the browser loads it again
    assert ask(server, path)[0] == 403


@pytest.mark.fit
@pytest.mark.parametrize(
    "page", ["workbench", "monitor --source sim:mellah2016 --sensor mellah2016_observer"]
)
def test_the_key_is_in_no_process_list(page, tmp_path):
    """Of the programs themselves, with the browser that they open: what any user of the machine can read of them."""
    browser = tmp_path / "browser"
    browser.write_text(
        f'#!/bin/sh\nprintf %s "$1" > {tmp_path}/part; mv {tmp_path}/part {tmp_path}/opened\nwhile sleep 1; do :; done'
    )
    browser.chmod(0o755)
    environment = {**os.environ, "BROWSER": f"{browser} %s"}
    with Program([*MOTORLENS, *page.split()], cwd=tmp_path, env=environment) as program:
        key = program.line(of_error=True).partition("token=")[2]
        eventually((tmp_path / "opened").exists, "the browser", program)
        shown = (tmp_path / "opened").read_text()
        lines = {path.parent.name: _words(path) for path in Path("/proc").glob("[0-9]*/cmdline")}
        assert len(key) > 20 and str(program.pid) in lines
        assert any(shown in line for line in lines.values()), "the browser is no more"
        assert not any(key in line for line in lines.values())
        port, path = shown.removeprefix("http://127.0.0.1:").split("/", 1)
        answers = []
        for _ in range(2):
            connection = http.client.HTTPConnection("127.0.0.1", int(port), timeout=LIMIT_S)
            with contextlib.closing(connection):
                connection.request("GET", f"/{path}")
                reply = connection.getresponse()
                reply.read()
                answers.append(reply.status)
        assert answers == [200, 403]


def _words(path):
    try:
        return path.read_bytes().decode(errors="replace").replace("\0", " ")
    except OSError:  # it has ended
        return ""


def test_the_kernel_tells_whose_program_has_connected():
    with socket.create_server(("127.0.0.1", 0)) as listening:
        with socket.create_connection(listening.getsockname()) as there:
            here, _ = listening.accept()
            assert user_of(here) in (None, os.getuid())
            # Gone at once: what is closed in order stands in the kernel's tables for another minute.
            there.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            there.close()
            eventually(lambda: user_of(here) is None, "the other end to be gone")
            here.close()


@pytest.mark.skipif(os.getuid() != 0, reason="only root can start a program of another user")
def test_another_users_program_is_refused_whatever_it_knows(server):
    assert ask(server, **bearer(server))[0] == 200
    asks = f"""
        import http.client
        line = http.client.HTTPConnection("127.0.0.1", {server.port}, timeout={LIMIT_S})
        line.request("GET", "/", headers={bearer(server)!r})
        print(line.getresponse().status)
    """
    command = ["python3", "-I", "-c", textwrap.dedent(asks)]
    nobody = 65534
    done = subprocess.run(
        command, user=nobody, cwd="/", capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    assert done.stdout == "403\n", done.stderr


@pytest.mark.fit
def test_a_thousand_requests_beside_half_open_connections_are_all_answered():
    """200 clients, 300 connections that never finish their request: nobody is lost, and at most 64 are served at once."""
    now, most, lock = [0], [0], threading.Lock()

    def answer(request):
        with lock:
            now[0] += 1
            most[0] = max(most[0], now[0])
        time.sleep(0.005)
        with lock:
            now[0] -= 1
        return Answer(request.path.encode(), "text/plain")

    server = LoopbackServer(answer)
    half_open = [socket.create_connection(("127.0.0.1", server.port), timeout=LIMIT_S) for _ in range(300)]
    for k, line in enumerate(half_open):
        line.sendall(b"GET / HTTP/1.1\r\nHost: x\r\n"[: k % 26])
    lost = []

    def client(number):
        for k in range(5):
            try:
                found = ask(server, f"/{number}/{k}", seconds=LIMIT_S, **bearer(server))[:2]
            except OSError as error:
                found = error
            if found != (200, f"/{number}/{k}"):
                lost.append(found)

    clients = [threading.Thread(target=client, args=(number,)) for number in range(200)]
    for thread in clients:
        thread.start()
    for thread in clients:
        thread.join(LIMIT_S)
    threads = sum(thread.name.startswith("pages") for thread in threading.enumerate())
    server.close()
    for line in half_open:
        line.close()
    assert lost == [] and not any(thread.is_alive() for thread in clients)
    assert 8 < most[0] <= MOST_SERVED == 64
    assert threads <= MOST_SERVED + 1


def test_a_head_that_comes_byte_by_byte_ends_at_one_deadline(monkeypatch):
    monkeypatch.setattr(connections, "HEAD_S", 0.3)
    server = LoopbackServer(lambda request: Answer(b""))
    with socket.create_connection(("127.0.0.1", server.port), timeout=LIMIT_S) as line:
        line.settimeout(0.05)

        def closed():
            try:
                line.send(b"x")
                return line.recv(1) == b""
            except TimeoutError:
                return False
            except OSError:
                return True

        eventually(closed, "the end of the connection")
    server.close()


def test_whoever_has_waited_longest_makes_room(monkeypatch):
    monkeypatch.setattr(connections, "MOST_WAITING", 3)
    server = LoopbackServer(lambda request: Answer(b""))
    lines = [socket.create_connection(("127.0.0.1", server.port), timeout=LIMIT_S) for _ in range(5)]
    assert [line.recv(1) for line in lines[:2]] == [b"", b""]
    assert ask(server, **bearer(server))[0] == 200
    server.close()
    for line in lines:
        line.close()


def test_no_crowd_of_strangers_costs_a_page_its_connection(monkeypatch):
    monkeypatch.setattr(connections, "MOST_WAITING", 3)
    server = LoopbackServer(lambda request: Answer(b"there"))
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", server.port, timeout=LIMIT_S)) as page:
        page.request("GET", "/", headers=bearer(server))
        assert page.getresponse().read() == b"there"
        strangers = [socket.create_connection(("127.0.0.1", server.port), timeout=LIMIT_S) for _ in range(5)]
        assert [line.recv(1) for line in strangers[:2]] == [b"", b""]
        page.request("GET", "/", headers=bearer(server))
        assert page.getresponse().read() == b"there"
        for line in strangers:
            line.close()
    server.close()


@pytest.mark.parametrize(("name", "value"), [("HEAD_S", 0.0), ("MOST_WAITING", 1)])
def test_a_request_that_has_come_is_answered_however_late_it_is_looked_at(name, value, monkeypatch):
    """A busy server may look at a request only when its time is over, or when another connection needs its place."""
    monkeypatch.setattr(connections, name, value)
    sent, accept = threading.Event(), connections.Connections._accept

    def late(self):
        assert sent.wait(LIMIT_S)
        accept(self)

    monkeypatch.setattr(connections.Connections, "_accept", late)
    server = LoopbackServer(lambda request: Answer(b"there"))
    lines = []
    for _ in range(3):
        line = http.client.HTTPConnection("127.0.0.1", server.port, timeout=LIMIT_S)
        line.request("GET", "/", headers=bearer(server))
        lines.append(line)
    sent.set()
    assert [line.getresponse().read() for line in lines] == [b"there"] * 3
    for line in lines:
        line.close()
    server.close()


def test_a_connection_that_is_answered_while_the_server_ends_is_hung_up_on(server):
    """Its thread has written the answer, and hands the connection back when nobody waits for requests any more."""
    pages = server._connections

    class Late(deque):
        def append(self, connection):
            eventually(lambda: not pages._thread.is_alive(), "the end of the server")
            super().append(connection)

    pages._answered = Late()
    line = http.client.HTTPConnection("127.0.0.1", server.port, timeout=LIMIT_S)
    line.request("GET", "/", headers=bearer(server))
    assert line.getresponse().read() == b"GET /"
    server.close()
    assert line.sock.recv(1) == b""
    line.close()


def test_a_connection_that_is_not_answered_any_more_is_hung_up_on(monkeypatch):
    """Its request has come, and no thread has taken it up before the server ends."""
    monkeypatch.setattr(connections, "MOST_SERVED", 1)
    handed_over, hand_over = [], connections.Connections._hand_over
    begun, end = threading.Event(), threading.Event()

    def noted(self, connection):
        hand_over(self, connection)
        handed_over.append(connection)

    def answer(request):
        begun.set()
        assert end.wait(LIMIT_S)
        return Answer(b"there")

    monkeypatch.setattr(connections.Connections, "_hand_over", noted)
    server = LoopbackServer(answer)
    lines = []
    for _ in range(3):
        line = http.client.HTTPConnection("127.0.0.1", server.port, timeout=LIMIT_S)
        line.request("GET", "/", headers=bearer(server))
        lines.append(line)
    eventually(lambda: len(handed_over) == 3, "that all requests have come")
    assert begun.wait(LIMIT_S)
    server.close()
    end.set()
    eventually(lambda: all(one.line.fileno() < 0 for one in handed_over), "the end of all connections")
    for line in lines:
        line.close()


def test_a_connection_takes_several_requests_in_any_portions(server):
    head = (
        f"GET /{{}} HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nAuthorization: Bearer {server.token}\r\n\r\n"
    )
    post = head.replace("GET", "POST").replace(
        "\r\n\r\n", "\r\nContent-Type: application/json\r\nContent-Length: 3\r\n\r\n[1]"
    )
    octets = (head.format("a") + post.format("b") + head.format("c")).encode()
    for portion in (1, 50, len(octets)):
        with socket.create_connection(("127.0.0.1", server.port), timeout=LIMIT_S) as line:
            for start in range(0, len(octets), portion):
                line.sendall(octets[start : start + portion])
            heard = b""
            while heard.count(b"HTTP/1.1 200") < 3 or not heard.endswith(b"GET /c"):
                heard += line.recv(1 << 16)
        assert [heard.index(text) for text in (b"GET /a", b"POST /b", b"GET /c")] == sorted(
            heard.index(text) for text in (b"GET /a", b"POST /b", b"GET /c")
        )


def test_a_head_without_end_is_refused(server):
    with socket.create_connection(("127.0.0.1", server.port), timeout=LIMIT_S) as line:
        with contextlib.suppress(OSError):
            line.sendall(b"GET / HTTP/1.1\r\n" + b"X-A: b\r\n" * 20_000)
        with contextlib.suppress(ConnectionResetError):
            assert line.recv(100).startswith(b"HTTP/1.1 431")
    assert ask(server, **bearer(server))[0] == 200


def test_it_listens_on_loopback_alone(server):
    table = [line.split() for line in Path("/proc/self/net/tcp").read_text().splitlines()[1:]]
    listening = [
        fields[1] for fields in table if fields[3] == "0A" and fields[1].endswith(f":{server.port:04X}")
    ]
    assert listening == [f"0100007F:{server.port:04X}"]


@pytest.mark.parametrize("path", ["/", "/?token=", "/?token=wrong", "/page.js", "/..%2f..%2fetc/passwd"])
def test_without_the_token_nothing_is_answered(server, path):
    status, text, headers = ask(server, path)
    assert status == 403 and "GET" not in text and "Set-Cookie" not in headers
    assert ask(server, path, Authorization="Bearer wrong")[0] == 403
    assert ask(server, path, Cookie=f"motorlens_{server.port}=wrong")[0] == 403
    # The token opens the first page only; elsewhere it would end in histories and logs.
    assert ask(server, f"/page.js?token={server.token}")[0] == 403


def test_a_name_that_points_here_and_another_site_are_refused(server):
    assert ask(server, **bearer(server))[0] == 200
    assert ask(server, Host=f"evil.example:{server.port}", **bearer(server))[0] == 403
    assert ask(server, Host="127.0.0.1:1", **bearer(server))[0] == 403
    json = {"Content_Type": "application/json", **bearer(server)}
    assert ask(server, "/x", "POST", "{}", **json)[:2] == (200, "POST /x")
    assert ask(server, "/x", "POST", "{}", Origin=f"http://127.0.0.1:{server.port}", **json)[0] == 200
    assert ask(server, "/x", "POST", "{}", Origin="http://evil.example", **json)[0] == 403
    # A form of another site can send text/plain without asking first.
    assert ask(server, "/x", "POST", "{}", Content_Type="text/plain", **bearer(server))[0] == 415


def test_long_and_endless_bodies_are_refused(server):
    json = {"Content_Type": "application/json", **bearer(server)}
    assert ask(server, "/x", "POST", b"", Content_Length="9" * 20, **json)[0] == 413
    assert ask(server, "/x", "POST", b"", Content_Length=str(MOST_OCTETS + 1), **json)[0] == 413
    assert ask(server, "/x", "POST", b"", Content_Length="-1", **json)[0] == 413


def test_a_mistake_in_an_answer_is_told_to_both_sides(capsys):
    server = LoopbackServer(lambda request: 1 // 0)
    status, text, _ = ask(server, **bearer(server))
    server.close()
    assert status == 500 and "mistake" in text and "ZeroDivision" not in text
    assert "ZeroDivisionError" in capsys.readouterr().err


def test_an_empty_token_lets_programs_of_this_machine_in_but_no_other_site():
    server = LoopbackServer(lambda request: Answer(b"here", "text/plain"), token="")
    assert server.url == f"http://127.0.0.1:{server.port}/"
    assert ask(server)[0] == 200
    assert ask(server, Host="evil.example")[0] == 403
    server.close()


def test_a_taken_port_is_one_line():
    first = LoopbackServer(lambda request: Answer(b""))
    with pytest.raises(DeviceError, match=rf"127\.0\.0\.1:{first.port}: cannot listen there"):
        LoopbackServer(lambda request: Answer(b""), first.port)
    first.close()


def test_the_style_has_a_dark_colour_for_each_light_one():
    light, _, dark = style().partition("@media (prefers-color-scheme: dark)")
    named = {word for word in light.replace(":", " : ").split() if word.startswith("--")}
    assert named and all(f"{name}:" in dark for name in named if not name.startswith("--on-accent"))
