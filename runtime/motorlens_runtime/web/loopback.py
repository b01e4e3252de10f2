"""A small web server for the browser of whoever started it: on 127.0.0.1 alone, and only to who has its token.

Any program on the machine and any web site in the browser can send requests to 127.0.0.1. So the address that is opened
holds a random token, which becomes a cookie that other sites' requests do not carry (SameSite); programs may send it as
`Authorization: Bearer`. The Host header must be this server's own (a site may point its name at 127.0.0.1), and a
POST must come from a page of this server and be JSON or octets.

Cookies do not know ports: a browser shows ours to every server on 127.0.0.1 that it visits. So the cookie is not the token,
and counts only in a request of which the browser says that a page of this very server, or the user, has made it
(Sec-Fetch-Site); and where the kernel tells whose program has connected, it must be the user's own, or root's. No other
page may show ours in a frame.
"""

import hashlib
import hmac
import math
import os
import secrets
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from http.cookies import CookieError, SimpleCookie
from http.server import BaseHTTPRequestHandler
from urllib.parse import parse_qsl, quote, urlsplit

from motorlens_runtime.errors import DeviceError
from motorlens_runtime.web.connections import Connection, Connections
from motorlens_runtime.web.peer import user_of

MOST_OCTETS = 1 << 20
# A page loads its own scripts and styles, shows its own pages in frames, talks to its own server, and nothing else.
POLICY = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; frame-src 'self'; img-src data:"
# Added to every answer's policy, whatever it is.
_FRAMED = "; frame-ancestors 'self'; base-uri 'none'; form-action 'none'"
_STATUS_WORDS = {
    400: "not understood",
    403: "refused",
    404: "there is no such page",
    405: "GET and POST only",
    413: "too long",
    415: "JSON or octets only",
    500: "the server has made a mistake; its terminal says where",
}


@dataclass(frozen=True)
class Request:
    """What was asked for. `body` is empty for GET."""

    method: str
    path: str
    query: Mapping[str, str]
    body: bytes = b""


@dataclass(frozen=True)
class Answer:
    """What is sent back. `policy` is the Content-Security-Policy."""

    body: bytes
    kind: str = "application/json"
    status: int = 200
    policy: str = POLICY
    headers: Mapping[str, str] = field(default_factory=dict)


def refusal(status: int, text: str = "") -> Answer:
    """An error as plain text."""
    return Answer((text or _STATUS_WORDS[status]).encode() + b"\n", "text/plain; charset=utf-8", status)


# What a POST may be: neither is what a form of another site can send without being asked for leave first.
_KINDS = ("application/json", "application/octet-stream")
# How long a browser may take to open the page.
_TICKET_S = 300.0
_TOO_LONG = b"HTTP/1.1 431 Request Header Fields Too Large\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"


class LoopbackServer:
    """Answers requests, each in a thread of its own, from the moment it is made until `close`.

    Args:
        answer: from a request to an answer; called in several threads at once.
        port: where to listen on 127.0.0.1; 0 is a free one.
        token: what a browser must know; None makes a random one, "" lets every program on this machine in.

    Raises:
        DeviceError: the port is taken.
    """

    def __init__(self, answer: Callable[[Request], Answer], port: int = 0, token: str | None = None) -> None:
        self.token = secrets.token_urlsafe(24) if token is None else token
        try:
            self._connections = Connections(port, self._serve, _TOO_LONG)
        except OSError as error:
            raise DeviceError(
                f"http://127.0.0.1:{port}: cannot listen there: {error.strerror or error}"
            ) from None
        self._guard = _Guard(answer, self.token, self.port)

    def _serve(self, connection: Connection) -> bool:
        return _Handler(connection, self._guard).one()

    @property
    def port(self) -> int:
        """Where it listens."""
        return self._connections.port

    def url_for_once(self) -> str:
        """An address that opens the page one time, within five minutes; `url` where no token is needed.

        For a browser's command line, which every user of the machine can read.
        """
        return f"http://127.0.0.1:{self.port}/?once={self._guard.ticket()}" if self.token else self.url

    @property
    def url(self) -> str:
        """The address to open, token included: for the user's eyes, not for a command line."""
        return f"http://127.0.0.1:{self.port}/" + (f"?token={quote(self.token)}" if self.token else "")

    def close(self) -> None:
        """Stop listening."""
        self._connections.close()


class _Guard:
    """Decides who is answered."""

    def __init__(self, answer: Callable[[Request], Answer], token: str, port: int) -> None:
        self._answer, self._token = answer, token
        # Cookies do not know ports: each server has a name of its own.
        self._cookie = f"motorlens_{port}"
        self._tickets: dict[str, float] = {}
        self._lock = threading.Lock()
        self._mark = hmac.digest(token.encode(), b"cookie", hashlib.sha256).hex()
        self._hosts = (f"127.0.0.1:{port}", f"localhost:{port}")

    def refused(self, request: Request, headers: Mapping[str, str], user: int | None) -> Answer | None:
        """Why a request is not answered, None if it is; `request` without its body."""
        if headers.get("Host", "") not in self._hosts or user not in (None, 0, os.getuid()):
            return refusal(403)
        if self._token and not (
            self._bears(headers) or (self._marked(headers) and _from_here(headers)) or self._opens(request)
        ):
            return refusal(403, "open the address that the command printed; it holds the key to this page")
        if request.method == "POST":
            origin = headers.get("Origin")
            if origin is not None and origin not in [f"http://{host}" for host in self._hosts]:
                return refusal(403)
            if headers.get("Content-Type", "").partition(";")[0].strip() not in _KINDS:
                return refusal(415)
        return None

    def answer(self, request: Request) -> Answer:
        """The answer to a request that is not refused."""
        answer = self._answer(request)
        if not (self._token and request.path == "/"):
            return answer
        # No redirect: after one, a browser that came from another site would not send the cookie yet.
        cookie = {"Set-Cookie": f"{self._cookie}={self._mark}; HttpOnly; SameSite=Strict; Path=/"}
        return replace(answer, headers={**answer.headers, **cookie})

    def _opens(self, request: Request) -> bool:
        """Whether it is the first page with the token in its address, or a ticket, which is torn."""
        if request.path != "/":
            return False
        with self._lock:
            deadline_s = self._tickets.pop(request.query.get("once", ""), -math.inf)
        return time.monotonic() < deadline_s or self._is_token(request.query.get("token", ""))

    def ticket(self) -> str:
        """A word that opens the first page once."""
        word = secrets.token_urlsafe(24)
        with self._lock:
            self._tickets[word] = time.monotonic() + _TICKET_S
        return word

    def _bears(self, headers: Mapping[str, str]) -> bool:
        scheme, _, bearer = headers.get("Authorization", "").partition(" ")
        return scheme == "Bearer" and self._is_token(bearer.strip())

    def _marked(self, headers: Mapping[str, str]) -> bool:
        with suppress(CookieError):
            cookies = SimpleCookie(headers.get("Cookie", ""))
            if self._cookie in cookies:
                return hmac.compare_digest(cookies[self._cookie].value.encode(), self._mark.encode())
        return False

    def _is_token(self, text: str) -> bool:
        return hmac.compare_digest(text.encode(), self._token.encode())


def _from_here(headers: Mapping[str, str]) -> bool:
    """Whether the browser says that a page of this server, or the user, has made the request."""
    return headers.get("Sec-Fetch-Site", "") in ("same-origin", "none")


class _Handler(BaseHTTPRequestHandler):
    """Answers one request; `http.server` reads its head and writes the head of the answer."""

    protocol_version = "HTTP/1.1"
    server_version = "motorlens"
    sys_version = ""

    def __init__(self, connection: Connection, guard: _Guard) -> None:
        self._connection, self._guard = connection, guard
        self.rfile = self.wfile = connection  # type: ignore[assignment]
        self.client_address = ("127.0.0.1", 0)
        self.close_connection = True

    def one(self) -> bool:
        """Answer; returns whether the connection stays open."""
        self.handle_one_request()
        return not self.close_connection

    def do_GET(self) -> None:
        if "Content-Length" in self.headers or "Transfer-Encoding" in self.headers:
            self.close_connection = True  # a body that nobody reads is not the next request
        self._handle(0)

    def do_POST(self) -> None:
        text = self.headers.get("Content-Length", "")
        if not text.isascii() or not text.isdigit() or int(text) > MOST_OCTETS:
            self.close_connection = True
            self._send(refusal(413))
            return
        self._handle(int(text))

    def _handle(self, octets: int) -> None:
        parts = urlsplit(self.path)
        request = Request(self.command, parts.path, dict(parse_qsl(parts.query)))
        connection, headers = self._connection, dict(self.headers.items())
        if connection.user is None:
            connection.user = user_of(connection.line)
        answer = self._guard.refused(request, headers, connection.user)
        if answer is not None:
            # The body of who has no key is not waited for.
            self.close_connection = True
            self._send(answer)
            return
        connection.let_in = True
        body = connection.read(octets)
        if len(body) < octets:
            self.close_connection = True
            return
        try:
            answer = self._guard.answer(replace(request, body=body))
        except Exception:  # a mistake of ours: the browser is told, and whoever started this sees where
            traceback.print_exc()
            answer = refusal(500)
        self._send(answer)

    def _send(self, answer: Answer) -> None:
        self.send_response(answer.status)
        fixed = {
            "Content-Type": answer.kind, "Content-Length": str(len(answer.body)), "Cache-Control": "no-store",
            "Content-Security-Policy": answer.policy + _FRAMED, "X-Content-Type-Options": "nosniff",
            "X-Frame-Options": "SAMEORIGIN", "Referrer-Policy": "no-referrer", "Cross-Origin-Resource-Policy": "same-origin",
        }  # fmt: skip
        for name, value in {**fixed, **answer.headers}.items():
            self.send_header(name, value)
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(answer.body)

    def log_message(self, format: str, *arguments: object) -> None:
        """Nothing is logged: the address holds the token."""
