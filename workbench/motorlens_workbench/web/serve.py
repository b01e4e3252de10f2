"""The server of the page: who asks for what, and what is sent."""

import argparse
import json
import signal
import tempfile
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from motorlens_physics.effect import catalogue, load_effects
from motorlens_physics.sensor_model import sensor_models
from motorlens_runtime.cli import write_json
from motorlens_runtime.errors import DataError, MotorlensError
from motorlens_runtime.web import asset
from motorlens_runtime.web.browser import announce
from motorlens_runtime.web.loopback import Answer, LoopbackServer, Request, refusal
from motorlens_workbench.web.session import Busy, Session, Step, order_of
from motorlens_workbench.web.shelf import RECORDINGS, Shelf

_OWN = "motorlens_workbench.web"
_FILES = {
    "/": (_OWN, "page.html", "text/html; charset=utf-8"),
    "/page.js": (_OWN, "page.js", "text/javascript; charset=utf-8"),
    "/draw.js": (_OWN, "draw.js", "text/javascript; charset=utf-8"),
    "/page.css": (_OWN, "page.css", "text/css; charset=utf-8"),
    "/style.css": ("motorlens_runtime.web", "style.css", "text/css; charset=utf-8"),
}
# A report brings its script along; in a sandbox it has no access to this server, whatever a recording's headings say.
_REPORT_POLICY = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src data: blob:"
)


class WorkbenchPage:
    """Answers the requests of the page.

    Args:
        session: what it works on.
        chosen: what is chosen at first: motor, recordings, columns.
        effects: names of effects and sensor models that can be added.
    """

    def __init__(self, session: Session, chosen: Mapping[str, Any], effects: list[str]) -> None:
        self._session, self._chosen, self._effects = session, chosen, effects

    def answer(self, request: Request) -> Answer:
        """What the server sends."""
        if request.method == "POST":
            return self._post(request)
        if request.path in _FILES:
            package, name, kind = _FILES[request.path]
            return Answer(asset(package, name), kind)
        if request.path == "/state":
            return _json(self.state())
        if request.path == "/choice":
            return _json(self.choice())
        if request.path.startswith("/results/"):
            return self._result(request.path.removeprefix("/results/"))
        return refusal(404)

    def choice(self) -> dict[str, Any]:
        """What can be chosen, and what is at first."""
        shelf = self._session.shelf
        return {
            "schema": "motorlens.workbench/1", "folder": shelf.folder, "recordings": shelf.recordings(),
            "motors": [{"name": entry.name, "parts": list(entry.parts)} for entry in shelf.motors()],
            "effects": self._effects, "chosen": dict(self._chosen),
        }  # fmt: skip

    def state(self) -> dict[str, Any]:
        """All steps without their results, and what the one under way says."""
        steps = [shown(step) for step in self._session.steps]
        if steps and steps[-1]["state"] == "running":
            steps[-1]["seconds"] = round(self._session.seconds, 1)
        return {"steps": steps, "progress": list(self._session.progress)}

    def _post(self, request: Request) -> Answer:
        try:
            document = json.loads(request.body or b"{}")
        except (ValueError, RecursionError):
            return refusal(400)
        if not isinstance(document, dict):
            return refusal(400)
        if request.path == "/cancel":
            self._session.cancel()
            return _json({})
        if request.path != "/steps":
            return refusal(404)
        try:
            return _json(shown(self._session.take(order_of(document))))
        except Busy:
            return _json({"error": "a step is under way; wait for it or cancel it"}, 409)
        except MotorlensError as error:
            return _json({"error": str(error)}, 400)

    def _result(self, name: str) -> Answer:
        number, _, kind = name.partition(".")
        known = {str(step.number): step for step in self._session.steps if step.state == "done"}
        if number not in known or kind not in ("html", "json"):
            return refusal(404)
        body = self._session.file(known[number].number, kind).read_bytes()
        if kind == "json":
            return Answer(body)
        return Answer(body, "text/html; charset=utf-8", policy=_REPORT_POLICY)


def shown(step: Step) -> dict[str, Any]:
    """A step as the page sees it."""
    return {
        "number": step.number, "kind": step.order.kind, "motor": step.order.motor, "effect": step.order.effect,
        "recordings": list(step.order.recordings), "judge": list(step.order.judge),
        "columns": list(step.order.columns), "command": step.command, "state": step.state,
        "sentence": step.sentence, "notes": list(step.notes), "written": step.written, "seconds": step.seconds,
    }  # fmt: skip


def serve(arguments: argparse.Namespace) -> int:
    """See `commands.workbench`. Runs until interrupted.

    Raises:
        DataError: a file that was named is absent or of no known kind.
        DeviceError: the port is taken.
    """
    named = [*arguments.recordings, *([arguments.motor] if arguments.motor else [])]
    for name in named:
        if not Path(name).is_file():
            raise DataError(f"{name}: there is no such file")
    for name in arguments.recordings:
        if not name.lower().endswith(RECORDINGS):
            raise DataError(f"{name}: recordings end in {', '.join(RECORDINGS)}")
    if arguments.folder is not None and not Path(arguments.folder).is_dir():
        raise DataError(f"--folder {arguments.folder}: there is no such folder")
    shelf = Shelf(tuple(named), arguments.folder)
    if arguments.motor:
        shelf.motor(arguments.motor)
    own = load_effects(arguments.effects_from) if arguments.effects_from else {}
    chosen = {
        "motor": arguments.motor or "", "recordings": shelf.chosen(arguments.recordings), "columns": arguments.column,
    }  # fmt: skip
    with tempfile.TemporaryDirectory(prefix="motorlens-") as results:
        session = Session(shelf, Path(results), arguments.effects_from)
        page = WorkbenchPage(session, chosen, sorted({*catalogue(), *own, *sensor_models()}))
        server = LoopbackServer(page.answer, arguments.port)
        # Before the address is told: who reads it may end the command at once.
        stopped = threading.Event()
        signal.signal(signal.SIGTERM, lambda number, frame: stopped.set())
        announce("workbench", server.url, None if arguments.no_browser else server.url_for_once())
        try:
            stopped.wait()
        except KeyboardInterrupt:
            pass
        finally:
            session.cancel()
            server.close()
        steps = [{**shown(step), "result": step.result} for step in session.steps]
        write_json({"schema": "motorlens.workbench/1", "steps": steps}, arguments.json)
    return 0


def _json(document: Mapping[str, Any], status: int = 200) -> Answer:
    return Answer(json.dumps(document, allow_nan=False).encode(), status=status)
