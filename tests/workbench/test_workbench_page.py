"""The page of the workbench, over HTTP: the four steps are the commands they stand for, and nothing else can be reached."""

import http.client
import json
import os
import re
import shlex
import signal
import urllib.request
from pathlib import Path
from urllib.parse import urlencode

import pytest
from helpers.processes import LIMIT_S, MOTORLENS, Program, eventually

from motorlens_physics.motor_file import read_motor_file
from motorlens_runtime.cli import main
from motorlens_runtime.errors import DataError
from motorlens_runtime.web.loopback import LoopbackServer
from motorlens_workbench.web.serve import WorkbenchPage
from motorlens_workbench.web.session import Session
from motorlens_workbench.web.shelf import Shelf
from motorlens_workbench.web.step import Choice, Order, words_of

MOTOR = (Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml").read_text(encoding="utf-8")
TAU_C = 0.4


class Effects:
    """In place of the catalogue, which a process of its own reads."""

    def entries(self):
        return [{"name": "coulomb_friction", "equation": "mechanical", "summary": "", "equations": []}]


class Browser:
    """Asks as the page's script does."""

    def __init__(self, folder: Path, named: tuple[str, ...] = ()) -> None:
        self.results = folder / "results"
        self.results.mkdir()
        self.session = Session(Shelf(named, "."), Path("results"))
        self.server = LoopbackServer(WorkbenchPage(self.session, Effects()).answer)

    def ask(self, path, document=None, **headers):
        connection = http.client.HTTPConnection("127.0.0.1", self.server.port, timeout=LIMIT_S)
        headers = {"Authorization": f"Bearer {self.server.token}", **headers}
        if document is None:
            connection.request("GET", path, None, headers)
        else:
            connection.request(
                "POST", path, json.dumps(document), {"Content-Type": "application/json", **headers}
            )
        reply = connection.getresponse()
        found = reply.status, reply.read()
        self.headers = dict(reply.getheaders())
        connection.close()
        return found

    def send(self, name, content, piece=1 << 20, **query):
        """A file, in pieces, as the page sends it; returns the last answer."""
        for offset in range(0, max(len(content), 1), piece):
            fields = {"name": name, "offset": offset, "size": len(content), **query}
            connection = http.client.HTTPConnection("127.0.0.1", self.server.port, timeout=LIMIT_S)
            headers = {
                "Authorization": f"Bearer {self.server.token}",
                "Content-Type": "application/octet-stream",
            }
            connection.request(
                "POST", f"/upload?{urlencode(fields)}", content[offset : offset + piece], headers
            )
            reply = connection.getresponse()
            answer = {"status": reply.status, **json.loads(reply.read())}
            connection.close()
            if answer["status"] != 200:
                break
        return answer

    def json(self, path, document=None):
        status, body = self.ask(path, document)
        return {"status": status, **json.loads(body)}

    def take(self, **order):
        """A step, to its end; returns it as the page sees it, and what it found."""
        begun = self.json("/steps", {"motor": "motor.toml", "recordings": ["bench.csv"], **order})
        assert begun["status"] == 200 and begun["state"] == "running", begun
        self.session.join()
        step = self.json("/state")["steps"][-1]
        return step, self.json(f"/results/{step['number']}.json") if step["state"] == "done" else None

    def close(self):
        self.session.cancel()
        self.server.close()


@pytest.fixture
def bench(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("motor.toml").write_text(MOTOR, encoding="utf-8")
    browser = Browser(tmp_path)
    yield browser
    browser.close()


def simulate(duration="10", rate="100"):
    arguments = [
        "motor.toml",
        "--scenario",
        "load_steps",
        "--duration",
        duration,
        "--rate",
        rate,
        "--noise",
        "0.2%",
    ]
    assert (
        main(["simulate", *arguments, "--effect", f"coulomb_friction.tau_c={TAU_C}", "-o", "bench.csv"]) == 0
    )


@pytest.mark.long
@pytest.mark.fit
def test_steps_are_the_commands_that_are_shown(bench, capsys):
    simulate()
    choice = bench.json("/choice")
    assert choice["motors"] == [{"name": "motor.toml", "parts": [], "stated": []}] and choice[
        "recordings"
    ] == ["bench.csv"]

    step, before = bench.take(kind="compare")
    assert step["command"] == "motorlens compare bench.csv --motor motor.toml"
    # The command that is shown gives the same document and the same page.
    assert main([*shlex.split(step["command"])[1:], "--json", "cli.json", "--html", "cli.html"]) == 0
    assert json.loads(Path("cli.json").read_text()) == {k: v for k, v in before.items() if k != "status"}
    status, page = bench.ask("/results/1.html")
    assert status == 200 and page == Path("cli.html").read_bytes()
    assert bench.headers["Content-Security-Policy"].startswith("sandbox allow-scripts")
    assert step["sentence"] in capsys.readouterr().out and "mechanical equation" in step["sentence"]

    step, added = bench.take(kind="add", effect="coulomb_friction", output="better.toml")
    assert step["written"] == "better.toml" and "--fit bench.csv -o better.toml" in step["command"]
    assert [rung["added"] for rung in added["ladder"]] == ["", "coulomb_friction"]
    for channel in ("current", "speed"):
        assert added["ladder"][1]["held_out"][channel] < 0.8 * added["ladder"][0]["held_out"][channel]
    assert read_motor_file("better.toml").values()["coulomb_friction.tau_c"] == pytest.approx(TAU_C, rel=0.05)
    assert Path("motor.toml").read_text(encoding="utf-8") == MOTOR
    entries = {entry["name"]: entry["parts"] for entry in bench.json("/choice")["motors"]}
    assert entries == {"motor.toml": [], "better.toml": ["coulomb_friction"]}

    step, removed = bench.take(
        kind="remove", motor="better.toml", effect="coulomb_friction", output="back.toml"
    )
    assert "--remove" in step["command"] and step["written"] == "back.toml"
    rungs = [rung["held_out"]["current"] for rung in removed["ladder"]]
    assert rungs[1] > rungs[0] and "higher" in step["sentence"]
    assert [step["number"] for step in bench.json("/state")["steps"]] == [1, 2, 3]


@pytest.mark.fit
def test_an_error_is_the_line_that_the_command_prints(bench, capsys):
    Path("bench.csv").write_text("time_s,voltage_V\n0,1\n1,2\n")
    step, _ = bench.take(kind="compare")
    assert step["state"] == "failed"
    assert main(shlex.split(step["command"])[1:]) == 1
    assert capsys.readouterr().err == f"motorlens compare: {step['sentence']}\n"
    assert bench.ask("/results/1.html")[0] == 404


@pytest.mark.fit
def test_a_step_can_be_cancelled_and_leaves_nothing(bench):
    simulate(duration="60", rate="500")
    order = {"kind": "diagnose", "motor": "motor.toml", "recordings": ["bench.csv"]}
    assert bench.json("/steps", order)["status"] == 200
    process = bench.session._job._process
    told = eventually(lambda: bench.json("/state")["progress"], "progress")
    assert "estimating the motor" in told[0]
    assert bench.json("/steps", order)["status"] == 409
    assert bench.json("/cancel", {})["status"] == 200
    state = bench.json("/state")["steps"]
    assert [(step["state"], step["sentence"]) for step in state] == [("cancelled", "Cancelled.")]
    assert process.poll() is not None and not list((bench.results / "results").iterdir())
    assert bench.ask("/results/1.json")[0] == 404
    assert bench.json("/cancel", {})["status"] == 200  # nothing runs: nothing happens


def test_what_the_page_may_not_do_is_said(bench):
    Path("bench.csv").touch()
    good = {
        "kind": "add",
        "motor": "motor.toml",
        "recordings": ["bench.csv"],
        "effect": "radiation",
        "output": "new.toml",
    }
    for change, said in (
        ({"motor": "../motor.toml"}, "none of the motor files here"),
        ({"motor": "/etc/passwd"}, "none of the motor files here"),
        ({"motor": "--html=x"}, "none of the motor files here"),
        ({"recordings": ["../secret.csv"]}, "none of the recordings here"),
        ({"recordings": []}, "choose at least one"),
        ({"judge": ["/etc/passwd"]}, "none of the recordings here"),
        ({"effect": "--html"}, "choose an effect"),
        ({"effect": ""}, "choose an effect"),
        ({"output": "motor.toml"}, "is there already"),
        ({"output": "../new.toml"}, "plain name"),
        ({"output": "-new.toml"}, "plain name"),
        ({"output": "new.py"}, "plain name"),
        ({"columns": ["--json"]}, "write QUANTITY=NAME"),
        ({"terminal": "--html"}, "one of driven, open, shorted, current"),
        ({"shaft": "open"}, "one of free, locked, turned"),
        ({"shaft": 1}, "not of the form"),
        ({"kind": "serve"}, "is no step"),
        ({"recordings": "bench.csv"}, "none of the recordings here"),
        ({"motor": 3}, "not of the form"),
        ({"recordings": [{}]}, "not of the form"),
        ({"recordings": 3}, "not of the form"),
    ):
        answer = bench.json("/steps", {**good, **change})
        assert answer["status"] == 400 and said in answer["error"], change
    assert bench.json("/state")["steps"] == [] and sorted(os.listdir()) == [
        "bench.csv",
        "motor.toml",
        "results",
    ]


def test_only_its_own_pages_and_only_with_the_key(bench):
    Path("secret.html").write_text("secret")
    for path in ("/", "/page.js", "/files.js", "/results.js", "/plots.js", "/time_plots.js", "/curves.js", "/page.css",
                 "/report.css", "/style.css", "/state", "/choice", "/effects"):  # fmt: skip
        assert bench.ask(path)[0] == 200
        assert bench.ask(path, Authorization="Bearer wrong")[0] == 403
        # Nothing from elsewhere: it works without a network. (The name of SVG is no address.)
        assert b"http" not in bench.ask(path)[1].replace(b"http://www.w3.org/2000/svg", b"")
    for path in ("/serve.py", "/../serve.py", "/results/1.html", "/results/../secret.html", "/results/..%2fsecret.html",
                 "/results/secret.html", "/results//etc/passwd", "/motor.toml", "/file?name=secret.html",
                 "/file?name=../x.csv",
                 "/file?name=/etc/passwd", "/file"):  # fmt: skip
        status, body = bench.ask(path)
        assert status == 404 and b"secret" not in body, path
    assert bench.ask("/steps", {}, Authorization="")[0] == 403
    assert bench.ask("/steps", [])[0] == 400
    assert bench.ask("/elsewhere", {})[0] == 404


def test_the_shelf_holds_the_folder_and_what_was_named_and_no_more(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in (
        "in/a.csv",
        "in/a.csv.gz",
        "in/x.gz",
        "in/deep/b.parquet",
        "in/.hidden/c.csv",
        "in/notes.txt",
        "out/d.csv",
        "out/e.csv",
    ):
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).touch()
    Path("in/motor.toml").write_text(MOTOR, encoding="utf-8")
    Path("in/pyproject.toml").write_text("[project]\n")
    Path("in/broken.toml").write_text("[")
    Path("in/link.csv").symlink_to(tmp_path / "out/d.csv")
    Path("in/folder").symlink_to(tmp_path / "out")
    shelf = Shelf(("out/e.csv",), "in")
    assert shelf.recordings() == ["in/a.csv", "in/a.csv.gz", "in/deep/b.parquet", "out/e.csv"]
    assert [entry.name for entry in shelf.motors()] == ["in/motor.toml"]
    assert shelf.new_motor("new.toml") == "in/new.toml"
    with pytest.raises(DataError, match=r"link\.csv: is none of the recordings"):
        shelf.chosen(["in/link.csv"])


@pytest.mark.fit
def test_the_command_serves_until_it_is_told_to_end(tmp_path):
    (tmp_path / "motor.toml").write_text(MOTOR, encoding="utf-8")
    command = [*MOTORLENS, "workbench", "--folder", ".", "--no-browser", "--json", "s.json"]
    with Program(command, cwd=tmp_path) as program:
        line = program.line(of_error=True)
        url = re.search(r"http://127\.0\.0\.1:\d+/\?token=\S+", line)[0]
        with urllib.request.urlopen(url, timeout=LIMIT_S) as answer:
            assert answer.status == 200 and b"motorlens workbench" in answer.read()
        program.send(signal.SIGTERM)
        assert program.ended() == 0 and program.error == line + "\n", program.told()
    assert json.loads((tmp_path / "s.json").read_text()) == {"schema": "motorlens.workbench/1", "steps": []}


def test_a_command_is_complete(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("-motor.toml").write_text(MOTOR, encoding="utf-8")
    for name in ("a b.csv", "c.csv"):
        Path(name).touch()
    order = Order(
        "./-motor.toml", ("a b.csv",), ("c.csv",), ("speed=w rad/s",), ("a b.csv=2:8.5", "other.csv=1:2"),
        True, "open", "locked", "add", "radiation iron_core", "new.toml", True,
    )  # fmt: skip
    assert words_of(order, Shelf((), "."), "own.py") == (
        "add", "radiation", "iron_core", "--motor", "./-motor.toml", "--fit", "a b.csv", "--judge", "c.csv", "--force",
        "-o", "new.toml",
        "--column", "speed=w rad/s", "--range", "a b.csv=2:8.5", "--effects-from", "own.py", "--voltage-commanded",
        "--terminal", "open", "--shaft", "locked",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(["nowhere.csv"], "nowhere.csv: there is no such file"),
     (["notes.md"], "notes.md: recordings end in .csv, .csv.gz"),
     (["--folder", "nowhere"], "--folder nowhere: there is no such folder"),
     (["--motor", "notes.md"], "notes.md: is none of the motor files here")],
)  # fmt: skip
def test_a_mistake_gets_one_line(tmp_path, monkeypatch, capsys, arguments, said):
    monkeypatch.chdir(tmp_path)
    Path("notes.md").touch()
    assert main(["workbench", "--no-browser", *arguments]) == 1
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1 and error.startswith("motorlens workbench: ")


def test_columns_belong_to_their_recording(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("motor.toml").write_text(MOTOR, encoding="utf-8")
    for name in ("a.csv", "b.csv"):
        Path(name).touch()
    shelf = Shelf((), ".")
    columns = ("a.csv::speed_rpm=n [1/min]", "current=i")
    words = words_of(Order("motor.toml", ("a.csv",), columns=columns, kind="compare"), shelf)
    assert words[-4:] == ("--column", "speed_rpm=n [1/min]", "--column", "current=i")
    assert words_of(Order("", ("b.csv",), columns=columns, kind="look"), shelf) == (
        "look",
        "b.csv",
        "--column",
        "current=i",
    )
    with pytest.raises(
        DataError, match=r"a\.csv and b\.csv name their columns differently.*b\.csv\.columns\.toml"
    ):
        words_of(Order("motor.toml", ("a.csv", "b.csv"), columns=columns, kind="compare"), shelf)


def test_files_are_sent_in_pieces_within_bounds_and_over_nothing(bench, monkeypatch):
    content = bytes(range(256)) * 10
    assert bench.send("run 1.csv", content, piece=1000)["path"] == "results/files/run 1.csv"
    assert Path("results/files/run 1.csv").read_bytes() == content
    assert bench.send("run 1.csv", b"x")["path"] == "results/files/run 1_2.csv"  # what is there stays
    assert bench.ask("/file?name=results/files/run%201.csv") == (200, content)
    assert bench.json("/choice")["recordings"] == ["results/files/run 1.csv", "results/files/run 1_2.csv"]
    assert bench.send("m.toml", MOTOR.encode())["path"] == "results/files/m.toml"
    for name, sent, said in (
        ("../up.csv", b"x", "plain file name"),
        (".hidden.csv", b"x", "plain file name"),
        ("a/b.csv", b"x", "plain file name"),
        ("-x.csv", b"x", "plain file name"),
        ("page.html", b"x", "ends in one of"),
        ("other.toml", b"[project]", "no motor file"),
        ("empty.csv", b"", "not empty"),
    ):
        answer = bench.send(name, sent)
        assert answer["status"] == 400 and said in answer["error"], name
    assert "up to 1074 MB" in bench.send("big.csv", b"x", size=1 << 40)["error"]
    assert "piece is missing" in bench.send("gap.csv", b"x", offset=5, size=10)["error"]
    assert "piece is missing" in bench.send("more.csv", b"xyz", size=2)["error"]
    assert sorted(path.name for path in Path("results/files").iterdir()) == [
        "m.toml",
        "run 1.csv",
        "run 1_2.csv",
    ]
    # A body that is neither JSON nor octets, and one without the key.
    assert bench.ask("/upload?name=a.csv&offset=0&size=2", {}, **{"Content-Type": "text/csv"})[0] == 415
    assert bench.ask("/upload?name=a.csv&offset=0&size=2", {}, Authorization="")[0] == 403


@pytest.mark.fit
def test_a_session_outlives_the_workbench(bench, tmp_path):
    rows = "".join(f"{k / 100},{k % 7},{k % 5},{k % 3}\n" for k in range(200))
    Path("odd.csv").write_text("time_s,u_mot,current_A,speed_rad_s\n" + rows)
    choice = {
        "motor": "motor.toml",
        "recordings": ["odd.csv"],
        "columns": ["odd.csv::voltage_V=u_mot"],
        "ranges": [],
    }
    bench.json("/choice", choice)
    failed, _ = bench.take(kind="look", recordings=["odd.csv"])
    assert failed["state"] == "failed" and "no voltage column" in failed["sentence"]
    # What cannot be read so shows its columns all the same.
    headings = [column["heading"] for column in bench.json("/results/1.json")["columns"]]
    assert headings == ["time_s", "u_mot", "current_A", "speed_rad_s"]
    step, found = bench.take(kind="look", **{key: choice[key] for key in ("recordings", "columns")})
    assert step["command"] == "motorlens look odd.csv --column voltage_V=u_mot" and found["rows"] == 200
    bench.json("/choice", choice)
    again = Session(Shelf((), "."), bench.results)
    assert again.choice == Choice("motor.toml", ("odd.csv",), (), ("odd.csv::voltage_V=u_mot",))
    assert [(s.number, s.state, s.command) for s in again.steps] == [
        (1, "failed", "motorlens look odd.csv"),
        (2, "done", step["command"]),
    ]
    assert again.steps[1].result == {k: v for k, v in found.items() if k != "status"}
    Path("results/session.json").write_text("{}")
    with pytest.raises(DataError, match=r"session\.json: is no session.*move it away"):
        Session(Shelf((), "."), bench.results)
