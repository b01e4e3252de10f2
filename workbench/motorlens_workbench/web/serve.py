"""The server of the page: who asks for what, and what is sent."""

import argparse
import json
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from motorlens_runtime.cli import write_json
from motorlens_runtime.errors import DataError, MotorlensError
from motorlens_runtime.web import asset
from motorlens_runtime.web.browser import announce
from motorlens_runtime.web.loopback import Answer, LoopbackServer, Request, refusal
from motorlens_workbench.web.session import Busy, Session
from motorlens_workbench.web.shelf import RECORDINGS, Shelf
from motorlens_workbench.web.step import Choice, choice_of, order_of, to_json

_OWN, _REPORT, _SHARED = "motorlens_workbench.web", "motorlens_workbench.report", "motorlens_runtime.web"
_CSS, _JS = "text/css; charset=utf-8", "text/javascript; charset=utf-8"
_FILES = {
    "/": (_OWN, "page.html", "text/html; charset=utf-8"),
    "/page.js": (_OWN, "page.js", _JS),
    "/files.js": (_OWN, "files.js", _JS),
    "/results.js": (_OWN, "results.js", _JS),
    "/curves.js": (_REPORT, "curves.js", _JS),
    "/time_plots.js": (_REPORT, "time_plots.js", _JS),
    "/plots.js": (_REPORT, "plots.js", _JS),
    "/uplot.js": (f"{_SHARED}.uplot", "uPlot.iife.min.js", _JS),
    "/page.css": (_OWN, "page.css", _CSS),
    "/report.css": (_REPORT, "report.css", _CSS),
    "/uplot.css": (f"{_SHARED}.uplot", "uPlot.min.css", _CSS),
    "/style.css": (_SHARED, "style.css", _CSS),
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
        effects: what can be added, see `Catalogue`.
    """

    def __init__(self, session: Session, effects: "Catalogue") -> None:
        self._session, self._effects = session, effects

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
        if request.path == "/effects":
            return _json({"effects": self._effects.entries()})
        if request.path == "/file":
            return self._file(request.query.get("name", ""))
        if request.path.startswith("/results/"):
            return self._result(request.path.removeprefix("/results/"))
        return refusal(404)

    def choice(self) -> dict[str, Any]:
        """What can be chosen, and what is."""
        shelf = self._session.shelf
        return {
            "schema": "motorlens.workbench/1", "folder": shelf.folder, "recordings": shelf.recordings(),
            "motors": [vars(entry) for entry in shelf.motors()],
            "chosen": vars(self._session.choice), "ends": list(RECORDINGS),
        }  # fmt: skip

    def state(self) -> dict[str, Any]:
        """All steps without their results, and what the one under way says."""
        steps = [to_json(step) for step in self._session.steps]
        if steps and steps[-1]["state"] == "running":
            steps[-1]["seconds"] = round(self._session.seconds, 1)
        return {"steps": steps, "progress": list(self._session.progress)}

    def _post(self, request: Request) -> Answer:
        try:
            if request.path == "/upload":
                return self._upload(request)
            document = json.loads(request.body or b"{}")
        except (ValueError, RecursionError):
            return refusal(400)
        except MotorlensError as error:
            return _json({"error": str(error)}, 400)
        if not isinstance(document, dict):
            return refusal(400)
        try:
            if request.path == "/cancel":
                self._session.cancel()
                return _json({})
            if request.path == "/choice":
                self._session.choose(choice_of(document))
                return _json({})
            if request.path == "/steps":
                return _json(to_json(self._session.take(order_of(document))))
        except Busy:
            return _json({"error": "a step is under way; wait for it or cancel it"}, 409)
        except MotorlensError as error:
            return _json({"error": str(error)}, 400)
        return refusal(404)

    def _upload(self, request: Request) -> Answer:
        query = request.query
        offset, size = int(query.get("offset", "")), int(query.get("size", ""))
        path = self._session.uploads.take(query.get("name", ""), offset, size, request.body)
        return _json({"received": offset + len(request.body), "path": path})

    def _file(self, name: str) -> Answer:
        try:
            return Answer(self._session.shelf.path(name).read_bytes(), "application/octet-stream")
        except (MotorlensError, OSError):
            return refusal(404)

    def _result(self, name: str) -> Answer:
        number, _, kind = name.partition(".")
        known = {str(step.number): step for step in self._session.steps if step.state in ("done", "failed")}
        if number not in known or kind not in ("html", "json"):
            return refusal(404)
        try:
            body = self._session.file(known[number].number, kind).read_bytes()
        except OSError:
            return refusal(404)
        if kind == "json":
            return Answer(body)
        return Answer(body, "text/html; charset=utf-8", policy=_REPORT_POLICY)


class Catalogue:
    """What can be added, with equation and meaning: `motorlens effects` in a process of its own, as it loads much."""

    def __init__(self, effects_from: str | None = None) -> None:
        self._entries: list[dict[str, Any]] = []
        more = ["--effects-from", effects_from] if effects_from else []
        self._process = subprocess.Popen(
            [sys.executable, "-m", "motorlens_runtime", "effects", "--json", "-", *more],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def entries(self, patience_s: float = 300.0) -> list[dict[str, Any]]:
        """Name, equation, summary and equations of each."""
        self._reader.join(patience_s)
        return self._entries

    def close(self) -> None:
        """End the process, if it still runs."""
        with suppress(OSError):
            self._process.kill()
        self._reader.join()

    def _read(self) -> None:
        output, _ = self._process.communicate()
        with suppress(ValueError, KeyError, TypeError):
            document = json.loads(output)
            self._entries = [
                {
                    "name": entry["name"], "summary": entry["summary"], "equations": entry["equations"],
                    "equation": entry.get("equation") or entry.get("channel", ""),
                }
                for entry in [*document["effects"], *document["sensors"]]
                if not entry.get("simulation_only")
            ]  # fmt: skip


def serve(arguments: argparse.Namespace) -> int:
    """See `commands.workbench`. Runs until interrupted.

    Raises:
        DataError: a file that was named is absent or of no known kind, or the session is none.
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
    chosen = Choice(
        arguments.motor or "", tuple(shelf.chosen(arguments.recordings)), (), tuple(arguments.column)
    )
    with tempfile.TemporaryDirectory(prefix="motorlens-") as passing:
        kept = arguments.session or str(Path(arguments.folder or ".") / "motorlens-session")
        folder = Path(passing) if arguments.session == "" else Path(kept)
        session = Session(shelf, folder, arguments.effects_from, chosen)
        catalogue = Catalogue(arguments.effects_from)
        server = LoopbackServer(WorkbenchPage(session, catalogue).answer, arguments.port)
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
            catalogue.close()
        steps = [{**to_json(step), "result": step.result} for step in session.steps]
        write_json({"schema": "motorlens.workbench/1", "steps": steps}, arguments.json)
    return 0


def _json(document: Mapping[str, Any], status: int = 200) -> Answer:
    return Answer(json.dumps(document, allow_nan=False).encode(), status=status)
