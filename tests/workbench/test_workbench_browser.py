"""The workbench in a real browser: the four steps, files brought in, a reload in the middle, a phone, the keyboard alone."""

import re
import shutil
import signal
from contextlib import contextmanager
from pathlib import Path

import pytest
from helpers.browser import chromium, needs_browser, opened, serious
from helpers.processes import MOTORLENS, Program, eventually

from motorlens_runtime.cli import main
from motorlens_runtime.files.words import WORDS
from motorlens_workbench.web.session import Session
from motorlens_workbench.web.shelf import Shelf
from motorlens_workbench.web.step import Choice, Order

pytestmark = [needs_browser, pytest.mark.fit]
MODEL = Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml"
STEP_MS = 600_000


@pytest.fixture(scope="module")
def browser():
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A recording with friction that the motor file lacks, one with odd headings, and one that is none."""
    found = tmp_path_factory.mktemp("bench")
    shutil.copy(MODEL, found / "motor.toml")
    simulate = [
        "simulate",
        str(MODEL),
        "--scenario",
        "load_steps",
        "--duration",
        "10",
        "--rate",
        "100",
        "--noise",
        "0.2%",
    ]
    assert main([*simulate, "--effect", "coulomb_friction.tau_c=0.4", "-o", str(found / "bench.csv")]) == 0
    heading, _, rows = (found / "bench.csv").read_text().partition("\n")
    odd = heading.replace("voltage_V", "Motor Voltage after bridge").replace("speed_rad_s", "n")
    (found / "odd.csv").write_text(f"{odd}\n{rows}")
    (found / "broken.csv").write_text("time_s,voltage_V,current_A\n0,1,2\n0.1,oops,2\n0.2,1,2\n")
    return found


@pytest.fixture(scope="module")
def compared(folder, tmp_path_factory):
    """The folder with a session in which bench.csv was looked at and compared."""
    found = shutil.copytree(folder, tmp_path_factory.mktemp("compared"), dirs_exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(found)
        session = Session(Shelf((), "."), Path("motorlens-session"))
        session.choose(Choice("motor.toml", ("bench.csv",)))
        for kind in ("look", "compare"):
            session.take(Order("motor.toml", ("bench.csv",), kind=kind))
            session.join()
        assert [step.state for step in session.steps] == ["done", "done"], session.steps
    return found


@contextmanager
def workbench(folder, *words):
    """The command itself; gives its address and ends it."""
    command = [*MOTORLENS, "workbench", "--folder", ".", "--motor", "motor.toml", *words, "--no-browser"]
    with Program(command, cwd=folder) as program:
        address = re.search(r"http://127\.0\.0\.1:\d+/\?token=\S+", program.line(of_error=True))
        assert address, program.told()
        yield address[0]
        program.send(signal.SIGTERM)
        program.ended()


def ended(page, place, text=re.compile(".")):
    """Wait until a step has ended; its sentence.

    Raises:
        AssertionError: it has not come; with what the page shows instead.
    """
    from playwright.sync_api import TimeoutError as Late

    sentence = page.locator(f"#{place}-result").locator(".verdict, .failed").filter(has_text=text).first
    try:
        sentence.wait_for(timeout=STEP_MS)
    except Late as error:
        raise AssertionError(f"{error}\nthe page shows:\n{page.locator('main').inner_text()}") from None
    return sentence.inner_text()


def test_a_step_asked_for_before_the_page_knows_what_is_chosen_waits_for_that(browser, folder, tmp_path):
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    with workbench(tmp_path, "bench.csv") as url, opened(browser, "about:blank") as page:
        asked, released = [], []
        page.route("**/choice", lambda route: asked.append(route) if not released else route.continue_())
        page.goto(url)
        page.get_by_role("button", name="Compare", exact=True).click()
        eventually(lambda: page.evaluate("1") and asked, "the question what is chosen")
        assert page.locator("#problem").is_hidden() and page.locator("#running").is_hidden()
        assert len(asked) == 1
        released.append(True)
        asked[0].continue_()
        page.locator("#running-what", has_text="compare").wait_for()
        page.set_viewport_size({"width": 360, "height": 700})
        assert page.get_by_role("button", name="Cancel").bounding_box()["height"] < 40  # its word in one line
        page.get_by_role("button", name="Cancel").click()
        assert "Cancelled" in ended(page, "compare")


def test_a_report_that_did_not_come_is_fetched_again(browser, folder, tmp_path):
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    with workbench(tmp_path, "bench.csv") as url, opened(browser, "about:blank") as page:
        page.route("**/results/*.html", lambda route: route.abort(), times=1)
        page.goto(url)
        page.get_by_role("button", name="Look at bench.csv").click()
        assert "1001 samples" in ended(page, "look")
        page.get_by_role("alert").wait_for(state="hidden")
        assert page.complaints and all("ERR_FAILED" in line for line in page.complaints), page.complaints
        page.complaints.clear()


@pytest.mark.blind
def test_the_four_steps_a_reload_in_the_middle_and_another_day(browser, folder, tmp_path):
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    with workbench(tmp_path, "bench.csv") as url, opened(browser, url) as page:
        page.get_by_role("button", name="Compare", exact=True).click()
        assert "mechanical equation" in ended(page, "compare")
        assert page.locator("#compare-result .uplot").count() >= 8
        page.get_by_role("tab", name="2 Diagnose").click()
        page.get_by_role("button", name="Diagnose", exact=True).click()
        page.locator("#running").wait_for()
        page.reload()  # in the middle: it goes on
        assert page.get_by_role("tab", name="2 Diagnose").get_attribute("aria-selected") == "true"
        page.locator("#running").wait_for()
        assert "coulomb friction" in ended(page, "diagnose")
        button = page.locator("#diagnose-result").get_by_role("button", name="Add coulomb friction")
        place = button.bounding_box()
        assert (
            0 < place["x"] and place["x"] + place["width"] < 1280
        )  # however wide the table of candidates is
        button.click()
        assert page.get_by_label("Effect or sensor fault").input_value() == "coulomb_friction"
        meaning = page.locator("#meaning")
        assert (
            "constant torque against the motion" in meaning.inner_text()
            and "tanh(w/w_s)" in meaning.inner_text()
        )
        # Several are told with commas, each with its meaning, and one that is not there is said before anything runs.
        effect = page.get_by_label("Effect or sensor fault")
        effect.fill("coulomb_friction, quadratic drag")
        assert "tanh(w/w_s)" in meaning.inner_text() and "Windage" in meaning.inner_text()
        assert (
            page.get_by_label("New motor file").input_value() == "motor_coulomb_friction_quadratic_drag.toml"
        )
        effect.fill("coulomb_friction, colomb")
        page.get_by_role("button", name="Add", exact=True).click()
        page.get_by_text("colomb is not in the catalogue").wait_for()
        effect.fill("coulomb_friction")
        page.get_by_role("button", name="Add", exact=True).click()
        assert "written to motor_coulomb_friction.toml" in ended(page, "add")
        assert page.get_by_label("Motor file", exact=True).input_value() == "motor_coulomb_friction.toml"
        # The comparison that is shown is of the file before, and says so.
        page.get_by_role("tab", name="1 Compare").click()
        assert "Of an earlier choice: motor.toml" in page.locator("#compare-result .stale").inner_text()
        page.get_by_role("tab", name="4 Compare again").click()
        page.get_by_role("button", name="Compare again").click()
        page.locator("#again-result .bars").filter(has_text="motor_coulomb_friction.toml").first.wait_for(
            timeout=STEP_MS
        )
        # Undo, and redo: a choice of files, nothing is lost.
        page.get_by_role("button", name="Undo: back to motor.toml").click()
        assert page.get_by_label("Motor file", exact=True).input_value() == "motor.toml"
        page.get_by_role("button", name="Redo: motor_coulomb_friction.toml").click()
        with page.expect_download() as waiting:
            page.get_by_role("link", name="Download it").click()
        assert "coulomb_friction" in Path(waiting.value.path()).read_text()
        commands = page.locator("#steps pre").all_inner_texts()
        assert [command.split()[1] for command in commands] == ["compare", "diagnose", "add", "compare"]
    with workbench(tmp_path) as url, opened(browser, url) as page:  # another process goes on with it
        assert "The model" in ended(page, "compare")
        assert page.locator("#steps pre").all_inner_texts() == commands
        assert page.get_by_role("checkbox", name="use bench.csv").is_checked()
        # Equations are beside the candidates, though the catalogue comes later than what was found.
        page.get_by_role("tab", name="2 Diagnose").click()
        row = page.locator("#diagnose-result tr[data-name=coulomb_friction]")
        row.get_by_text("equation", exact=True).click()
        assert "tanh(w/w_s)" in row.locator("details").inner_text() and row.locator("details").count() == 1


def test_a_file_is_brought_in_looked_at_mapped_and_a_range_of_it_picked(browser, folder, tmp_path):
    shutil.copy(folder / "motor.toml", tmp_path)
    with workbench(tmp_path) as url, opened(browser, url) as page:
        page.get_by_label("Bring in recordings").set_input_files(folder / "odd.csv")
        assert "no voltage column" in ended(page, "look")
        assert (tmp_path / "motorlens-session/files/odd.csv").read_bytes() == (
            folder / "odd.csv"
        ).read_bytes()
        # Sample values beside the choice.
        row = page.locator("#look-result tr", has_text="Motor Voltage after bridge")
        first = (folder / "odd.csv").read_text().splitlines()[1].split(",")[1]
        assert f"{float(first):.4g}" in row.inner_text()
        # Computed from what is there, or simply one of the columns.
        page.get_by_label("what is computed").select_option("voltage")
        page.get_by_label("formula over the columns").fill("Motor Voltage after bridge*1")
        page.get_by_role("button", name="Use it").click()
        assert "1001 samples" in ended(page, "look", re.compile("samples"))
        assert page.get_by_label("formula over the columns").input_value() == "Motor Voltage after bridge*1"
        page.get_by_label("what Motor Voltage after bridge is").select_option("voltage")
        page.locator("#look-result .command", has_text="'voltage=Motor Voltage after bridge'").wait_for(
            timeout=STEP_MS
        )
        page.get_by_label("what n is").select_option("speed")
        ended(page, "look", re.compile("speed"))
        page.get_by_label("unit of n").select_option("rpm")
        page.locator("#look-result .command", has_text="speed_rpm=n").wait_for(timeout=STEP_MS)
        for word, value in (("to", "8"), ("from", "3")):
            box = page.locator("#look-result").get_by_label(re.compile(f"^{word}, in seconds"))
            box.fill(value)
            box.press("Enter")
        page.get_by_role("button", name="Use only this range").click()
        page.get_by_text("How they were recorded").click()
        page.get_by_label("the voltage is what was commanded").check()
        for label, words in WORDS.items():
            choice = page.locator(f"#{label}")
            values = choice.locator("option").evaluate_all("options => options.map(option => option.value)")
            assert values == ["", *words]
            choice.select_option(words[0])
        page.get_by_role("tab", name="1 Compare").click()
        page.get_by_role("button", name="Compare", exact=True).click()
        ended(page, "compare")
        command = page.locator("#compare-result pre").first.inner_text()
        assert "--column 'voltage=Motor Voltage after bridge' --column speed_rpm=n" in command
        assert "--range motorlens-session/files/odd.csv=3:8" in command
        assert command.endswith("--voltage-commanded --terminal driven --shaft free")
        stop = page.locator("#compare-result").get_by_label(re.compile("^to, in seconds")).input_value()
        assert float(stop) == pytest.approx(5, abs=0.02)


def test_a_wrong_file_is_said_in_a_line_and_the_old_verdict_does_not_stand_for_it(
    browser, compared, tmp_path
):
    shutil.copytree(compared, tmp_path, dirs_exist_ok=True)
    with workbench(tmp_path, "bench.csv") as url, opened(browser, url) as page:
        ended(page, "compare", re.compile("misses"))
        page.get_by_role("checkbox", name="use bench.csv").uncheck()
        page.get_by_role("checkbox", name="use broken.csv").check()
        page.get_by_role("button", name="Compare", exact=True).click()
        assert "broken.csv: row 3, column 'voltage_V': 'oops' is not a number" in ended(
            page, "compare", re.compile("oops")
        )
        assert "Of an earlier choice: bench.csv" in page.locator("#compare-result .stale").inner_text()
        # A late answer to something else does not take away what is said.
        late = []
        page.route(
            "**/choice",
            lambda route: late.append(route) if route.request.method == "POST" else route.continue_(),
        )
        page.get_by_label("Bring in recordings").set_input_files(tmp_path / "motor.toml")
        page.get_by_text("motor.toml: here").wait_for()
        eventually(lambda: page.evaluate("1") and late, "the choice of the motor file")
        (tmp_path / "page.html").write_text("<b>")
        page.complaints.clear()
        page.get_by_label("Bring in recordings").set_input_files(tmp_path / "page.html")
        alert = page.get_by_role("alert").filter(has_text="ends in one of")
        alert.wait_for()
        with page.expect_response("**/choice"):
            late[0].continue_()
        page.wait_for_timeout(200)
        assert alert.is_visible()
        page.get_by_role("checkbox", name="use bench.csv").check()
        alert.wait_for(state="hidden")
        # The browser notes the refusal on its console.
        assert all("400" in line for line in page.complaints), page.complaints
        page.complaints.clear()


def test_by_keyboard_alone_with_the_result_announced(browser, folder, tmp_path):
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    with workbench(tmp_path, "bench.csv") as url, opened(browser, url) as page:
        button = page.get_by_role("button", name="Compare", exact=True)
        button.focus()
        page.keyboard.press("Enter")
        said = page.locator("#said")
        said.filter(has_text="compare has begun").wait_for()
        assert button.evaluate("node => node === document.activeElement")
        ended(page, "compare")
        assert (
            "compare done: The model misses" in said.inner_text() and said.get_attribute("role") == "status"
        )
        assert button.evaluate("node => node === document.activeElement")
        page.keyboard.press("2")
        assert page.get_by_role("tab", name="2 Diagnose").evaluate("node => node === document.activeElement")
        page.keyboard.press("End")
        assert page.get_by_role("tab", name="4 Compare again").get_attribute("aria-selected") == "true"
        page.go_back()
        page.locator("#tab-diagnose[aria-selected=true]").wait_for()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_serious_and_a_phone_is_wide_enough(browser, compared, tmp_path, scheme):
    shutil.copytree(compared, tmp_path, dirs_exist_ok=True)
    with workbench(tmp_path, "bench.csv") as url:
        with opened(browser, url, color_scheme=scheme) as page:
            page.get_by_role("tab", name="Look").click()
            ended(page, "look")
            assert serious(page) == []
            page.get_by_role("tab", name="1 Compare").click()
            ended(page, "compare")
            assert serious(page) == []
            page.get_by_role("tab", name="3 Add").click()
            assert serious(page) == []
        phone = {"width": 390, "height": 844, "is_mobile": True, "has_touch": True, "color_scheme": scheme}
        with opened(browser, url, **phone) as page:
            ended(page, "compare")
            assert page.evaluate("document.documentElement.scrollWidth") == 390
            # What was found is on the first screen: the files are folded away.
            assert page.locator("#compare-result .verdict").bounding_box()["y"] < 500
            page.get_by_role("tab", name="Look").click()
            assert page.evaluate("document.documentElement.scrollWidth") == 390
            # No word of a table is broken: at most three lines of values.
            heights = page.locator("#look-result tbody tr").evaluate_all(
                "rows => rows.map(row => row.offsetHeight)"
            )
            assert heights and max(heights) < 80


def test_when_it_is_ended_the_page_says_so_and_what_to_do(browser, folder, tmp_path):
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    with workbench(tmp_path, "bench.csv") as url, opened(browser, url) as page:
        page.get_by_role("button", name="Look at bench.csv").wait_for()
        page.route("**/*", lambda route: route.abort())
        page.get_by_role("alert").filter(has_text="start it again").wait_for()
        page.get_by_role("button", name="Compare", exact=True).click()
        page.unroute("**/*")
        page.get_by_role("alert").wait_for(state="hidden")
        assert all("ERR_FAILED" in line for line in page.complaints), page.complaints
        page.complaints.clear()
