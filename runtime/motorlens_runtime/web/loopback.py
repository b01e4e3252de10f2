"""A small web server for the browser of whoever started it: on 127.0.0.1 alone, and only to who has its token.

Any program on the machine and any web site in the browser can send requests to 127.0.0.1. So the address that is opened
holds a random token, which becomes a cookie that other sites' requests do not carry (SameSite); programs may send it as
`Authorization: Bearer`. The Host header must be this server's own (a site may point its name at 127.0.0.1), and a
POST must come from a page of this server and be JSON.
"""

import hmac
import secrets
import threading
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from http.cookies import CookieError, SimpleCookie
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qsl, quote, urlsplit

from motorlens_runtime.errors import DeviceError

MOST_OCTETS = 1 << 20
# A page loads its own scripts and styles, shows its own pages in frames, talks to its own server, and nothing else.
POLICY = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; frame-src 'self'; img-src data:"
_STATUS_WORDS = {
    400: "not understood",
    403: "refused",
    404: "there is no such page",
    405: "GET and POST only",
    413: "too long",
    415: "JSON only",
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
            self._server = _Server(("127.0.0.1", port), _Handler)
        except OSError as error:
            raise DeviceError(
                f"http://127.0.0.1:{port}: cannot listen there: {error.strerror or error}"
            ) from None
        self._server.guard = _Guard(answer, self.token, self.port)
        self._thread = threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": 0.1}, name="pages", daemon=True
        )
        self._thread.start()

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._server.server_address[1])

    @property
    def url(self) -> str:
        """The address to open, token included."""
        return f"http://127.0.0.1:{self.port}/" + (f"?token={quote(self.token)}" if self.token else "")

    def close(self) -> None:
        """Stop listening."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(2.0)


class _Guard:
    """Decides who is answered."""

    def __init__(self, answer: Callable[[Request], Answer], token: str, port: int) -> None:
        self._answer, self._token = answer, token
        # Cookies do not know ports: each server has a name of its own.
        self._cookie = f"motorlens_{port}"
        self._hosts = (f"127.0.0.1:{port}", f"localhost:{port}")

    def judge(self, request: Request, headers: Mapping[str, str]) -> Answer:
        if headers.get("Host", "") not in self._hosts:
            return refusal(403)
        cookies: dict[str, str] = {}
        if self._token and request.path == "/" and self._is_token(request.query.get("token", "")):
            # No redirect: after one, a browser that came from another site would not send the cookie yet.
            cookies = {"Set-Cookie": f"{self._cookie}={self._token}; HttpOnly; SameSite=Strict; Path=/"}
        elif self._token and not any(self._is_token(text) for text in self._shown(headers)):
            return refusal(403, "open the address that the command printed; it holds the key to this page")
        if request.method == "POST":
            origin = headers.get("Origin")
            if origin is not None and origin not in [f"http://{host}" for host in self._hosts]:
                return refusal(403)
            if headers.get("Content-Type", "").partition(";")[0].strip() != "application/json":
                return refusal(415)
        answer = self._answer(request)
        return replace(answer, headers={**answer.headers, **cookies})

    def _is_token(self, text: str) -> bool:
        return hmac.compare_digest(text.encode(), self._token.encode())

    def _shown(self, headers: Mapping[str, str]) -> list[str]:
        shown = []
        scheme, _, bearer = headers.get("Authorization", "").partition(" ")
        if scheme == "Bearer":
            shown.append(bearer.strip())
        try:
            cookies = SimpleCookie(headers.get("Cookie", ""))
        except CookieError:
            return shown
        if self._cookie in cookies:
            shown.append(cookies[self._cookie].value)
        return shown


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False
    guard: _Guard

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that went away is no concern of ours."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    protocol_version = "HTTP/1.1"
    server_version = "motorlens"
    sys_version = ""
    timeout = 30.0

    def do_GET(self) -> None:
        self._handle(b"")

    def do_POST(self) -> None:
        text = self.headers.get("Content-Length", "")
        if not text.isascii() or not text.isdigit() or int(text) > MOST_OCTETS:
            self.close_connection = True
            self._send(refusal(413))
            return
        self._handle(self.rfile.read(int(text)))

    def _handle(self, body: bytes) -> None:
        parts = urlsplit(self.path)
        request = Request(self.command, parts.path, dict(parse_qsl(parts.query)), body)
        try:
            answer = self.server.guard.judge(request, dict(self.headers.items()))
        except Exception:  # a mistake of ours: the browser is told, and whoever started this sees where
            traceback.print_exc()
            answer = refusal(500)
        self._send(answer)

    def _send(self, answer: Answer) -> None:
        self.send_response(answer.status)
        fixed = {
            "Content-Type": answer.kind, "Content-Length": str(len(answer.body)), "Cache-Control": "no-store",
            "Content-Security-Policy": answer.policy, "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer", "Cross-Origin-Resource-Policy": "same-origin",
        }  # fmt: skip
        for name, value in {**fixed, **answer.headers}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(answer.body)

    def log_message(self, format: str, *arguments: object) -> None:
        """Nothing is logged: the address holds the token."""
