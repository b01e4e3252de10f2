"""The server of the pages: who is answered and who is not."""

import http.client
from pathlib import Path

import pytest

from motorlens_runtime.errors import DeviceError
from motorlens_runtime.web import style
from motorlens_runtime.web.loopback import MOST_OCTETS, Answer, LoopbackServer


@pytest.fixture
def server():
    server = LoopbackServer(lambda request: Answer(f"{request.method} {request.path}".encode(), "text/plain"))
    yield server
    server.close()


def ask(server, path="/", method="GET", body=None, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
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
    assert ask(server, "/anything", Cookie=cookie.partition(";")[0])[:2] == (200, "GET /anything")
    assert "default-src 'none'" in headers["Content-Security-Policy"]


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
