"""The live page in a real browser: what is drawn is what came, Hold holds, limits, recordings, a phone, nobody shut out."""

import csv
import io

import numpy as np
import pytest
from helpers.browser import chromium, needs_browser, opened, serious
from helpers.processes import eventually

from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.monitor.page import MonitorPage
from motorlens_runtime.publish import Header
from motorlens_runtime.sensor.specification import Output

pytestmark = [needs_browser, pytest.mark.fit]
HEADER = Header(
    "bench", "1.2", "ab" * 32,
    (Output("speed", "rad/s", 100.0), Output("temperature", "K", 40.0), Output("resistance", "ohm", 0.5)),
)  # fmt: skip


def rows(begin_s, end_s, speed=150.0, sigma=2.0, quality=int(Quality.SIMULATED)):
    """A row each 50 ms: the speed swings by a tenth, voltage and current beside."""
    t = np.arange(round(20 * begin_s), round(20 * end_s)) / 20
    n, ones = len(t), np.ones(len(t))
    values = np.stack(
        (speed * (1 + 0.1 * np.sin(t)), 20 - 10 * np.exp(-t / 60), 3.5 * ones, 240 * ones, 8 + np.cos(t)),
        axis=1,
    )
    deviations = np.stack((sigma * ones, 1.2 * ones, 0.02 * ones, 0 * ones, 0 * ones), axis=1)
    return Estimates(
        np.round(t * 1e9).astype(np.int64), values, deviations, np.full(n, quality, dtype=np.uint32)
    )


@pytest.fixture(scope="module")
def browser():
    with chromium() as browser:
        yield browser


@pytest.fixture
def page():
    # Nothing grows old, however long the machine takes.
    page = MonitorPage(HEADER, name="press", clock=lambda: 0.0)
    yield page
    page.close()


def card(tab, name):
    return tab.locator(".quantity", has=tab.locator("h2", has_text=name))


def scale(tab, name, axis):
    """Ends of an axis as the plot of a quantity has it."""
    return tab.evaluate(
        """([name, axis]) => {
            const card = cards.find(card => card.output.name === name);
            if (!card) return [0, 0];
            const {min, max} = card.plot.plot.scales[axis];
            return [min, max];
        }""",
        [name, axis],
    )


def drawn(tab, name):
    """Times and values of the line."""
    return tab.evaluate(
        """name => {
            const card = cards.find(card => card.output.name === name);
            return card ? card.plot.data.slice(0, 2) : [[], []];
        }""",
        name,
    )


def number_of(tab, name):
    return float(card(tab, name).locator(".value span").inner_text())


def drag(tab, name, begin, end):
    """Drag over a share of the width of a plot."""
    box = card(tab, name).locator(".u-over").bounding_box()
    y = box["y"] + box["height"] / 2
    tab.mouse.move(box["x"] + begin * box["width"], y)
    tab.mouse.down()
    tab.mouse.move(box["x"] + end * box["width"], y, steps=5)
    tab.mouse.up()


def test_what_is_drawn_is_what_came_with_voltage_and_current(browser, page):
    given = rows(0, 40)
    page.publish(given)
    with opened(browser, page.url) as tab:
        eventually(lambda: len(drawn(tab, "speed")[0]) == len(given), "all rows")
        for k, name in enumerate(("speed", "temperature", "resistance", "voltage", "current")):
            times, values = drawn(tab, name)
            assert values == given.values[:, k].tolist()
            assert np.allclose(np.diff(times), 0.05)
        assert number_of(tab, "speed") == pytest.approx(given.values[-1, 0], abs=0.05)
        assert tab.title() == "▲ Uncertain: simulated drive"
        tab.click("#unit")
        assert number_of(tab, "speed") == pytest.approx(given.values[-1, 0] * 30 / np.pi, abs=0.5)
        eventually(lambda: scale(tab, "speed", "y")[1] > 1000, "an axis in rpm")
        tab.reload()
        eventually(lambda: scale(tab, "speed", "y")[1] > 1000, "rpm after a reload")


def test_the_values_rule_the_axis_whatever_the_band_or_a_bad_row(browser, page):
    page.publish(rows(0, 36, 20.0, sigma=68.0))
    page.publish(rows(36, 37, -131.7, sigma=130.0, quality=int(Quality.LINE_LOST)))
    page.publish(rows(37, 50, 20.0))
    with opened(browser, page.url) as tab:
        eventually(lambda: len(drawn(tab, "speed")[0]) >= 1000, "all rows")
        low, high = scale(tab, "speed", "y")
        assert low < 18 and high > 22  # all of the data
        assert low > -10 and high < 50  # and not much else
        assert "−131" not in card(tab, "speed").inner_text()


def test_hold_holds_and_a_zoom_shows_the_part(browser, page):
    page.publish(rows(0, 40))
    with opened(browser, page.url) as tab:
        eventually(lambda: len(drawn(tab, "speed")[0]) == 800, "all rows")
        tab.keyboard.press("1")
        tab.click("#hold")
        eventually(lambda: tab.is_visible("#held"), "the mark")
        held = drawn(tab, "speed"), scale(tab, "speed", "x")
        assert len(held[0][0]) == 800
        page.publish(rows(40, 50, 300.0))
        eventually(lambda: number_of(tab, "speed") > 250, "the newest value beside the plot")
        card(tab, "current").locator(".u-over").hover()  # a pointer over a plot, a window of another size
        tab.set_viewport_size({"width": 1000, "height": 900})
        assert (drawn(tab, "speed"), scale(tab, "speed", "x")) == held
        drag(tab, "speed", 0.5, 0.75)
        begin, end = held[1]
        for name in ("speed", "temperature", "current"):  # the time axes are one
            assert scale(tab, name, "x") == pytest.approx(
                [begin + 0.5 * (end - begin), begin + 0.75 * (end - begin)], abs=0.5
            )
        card(tab, "speed").locator(".u-over").dblclick()
        eventually(lambda: not tab.is_visible("#held") and len(drawn(tab, "speed")[0]) == 1000, "live again")
        tab.click("#hold")
        tab.keyboard.press("2")  # another window is another question: live again
        eventually(lambda: not tab.is_visible("#held"), "live again")


def test_an_answer_to_what_nobody_asks_any_more_is_not_drawn(browser, page):
    saw = page.add(HEADER, "saw")
    page.publish(rows(0, 40))
    saw.publish(rows(0, 10, 50.0))
    with opened(browser, page.url) as tab:
        eventually(lambda: len(drawn(tab, "speed")[0]) == 800, "all rows")
        meanwhile(
            tab, "/live", "choose(60)"
        )  # the same window: the answer under way holds what is new, which is nothing
        tab.click("#hold")
        eventually(lambda: tab.is_visible("#held"), "the mark")
        assert len(drawn(tab, "speed")[0]) == 800
        meanwhile(tab, "/live", "document.querySelectorAll('#motors button')[1].click()")
        eventually(lambda: len(drawn(tab, "speed")[0]) == 200 and number_of(tab, "speed") < 60, "the saw")
        meanwhile(tab, "/motors", "about = null; document.querySelectorAll('#motors button')[0].click()")
        eventually(lambda: len(drawn(tab, "speed")[0]) == 800 and number_of(tab, "speed") > 100, "the press")
        assert tab.inner_text("#status").startswith("Uncertain: simulated drive")


def meanwhile(tab, path, act):
    """Do something in the page after the next answer to `path` has come and before it is read."""
    tab.evaluate(
        f"""() => new Promise(done => {{
            const plain = ask;
            ask = async (...all) => {{
                const reply = await plain(...all);
                if (all[0].startsWith("{path}")) {{ ask = plain; {act}; done(); }}
                return reply;
            }};
        }})"""
    )


def test_a_dead_line_is_bad_dated_and_without_a_time_to_the_limit(browser, page):
    page.publish(rows(0, 10))
    counts = {"samples": 10, "lost": 0, "time_to_limit_s": {"temperature within 120 s": 85.0}}
    page.counts(counts)
    with opened(browser, page.url) as tab:
        eventually(
            lambda: "1.4 min" in tab.inner_text("#counts") or "85 s" in tab.inner_text("#counts"), "the time"
        )
        page.publish(rows(10, 12, quality=int(Quality.LINE_LOST | Quality.STALE)))
        page.event({"event": "line_lost", "timestamp": 10.0, "message": "line lost: no sample for 2.0 s"})
        eventually(lambda: tab.inner_text("#status").startswith("Bad: the line is lost"), "bad")
        assert tab.title().startswith("■ Bad")
        assert "not known" in tab.inner_text("#counts") and "85 s" not in tab.inner_text("#counts")
        assert "not known now" in card(tab, "speed").inner_text()
        assert "line lost: no sample for 2.0 s" in tab.inner_text("#events")
        eventually(lambda: "Last values of" in tab.inner_text("#dated"), "the time of the last values")


def test_a_limit_is_set_drawn_told_with_its_unit_and_taken_away(browser, page):
    page.publish(rows(0, 30))
    with opened(browser, page.url) as tab:
        eventually(lambda: len(drawn(tab, "speed")[0]) == 600, "all rows")
        tab.fill("#value", "140")
        tab.click("#limit button")
        eventually(lambda: "speed > 140 rad/s" in tab.inner_text("#limits"), "the limit")
        page.publish(rows(30, 32))
        words = eventually(lambda: tab.inner_text("#alarms"), "the alarm")
        assert "speed > 140 (limit 140 rad/s), now 1" in words
        red = tab.evaluate(
            """() => {
            const plot = cards[0].plot.plot, at = Math.round(plot.valToPos(140, "y", true)), {left, width} = plot.bbox;
            let red = 0;
            for (const y of [at - 1, at]) {
              const row = plot.ctx.getImageData(left, y, width, 1).data;
              for (let k = 0; k < row.length; k += 4) if (row[k] > 180 && row[k + 1] < 90 && row[k + 2] < 100) red++;
            }
            return red / width; }"""
        )
        assert 0.3 < red < 2  # a dashed line over the whole width
        tab.fill("#value", "")
        tab.get_by_label("Remove the limit speed > 140").click()
        eventually(lambda: tab.inner_text("#limits") == "" and tab.inner_text("#alarms") == "", "no limit")


def test_limits_given_at_the_start_are_listed_and_stay(browser, page):
    page.publish(rows(0, 5))
    given = {"column": 1, "heading": "temperature_rise_K", "side": 1, "limit": 90.0}
    page.counts({"limits": [{"name": "temperature > 90", **given}, {"name": "hot", **given}]})
    with opened(browser, page.url) as tab:
        items = eventually(lambda: tab.locator("#limits li").all_inner_texts(), "the limits")
        assert items == [
            "temperature > 90 K, given at the start",
            "hot: temperature > 90 K, given at the start",
        ]
        assert tab.locator("#limits button").count() == 0
        assert serious(tab) == []


def test_recorded_exported_and_played_back_it_is_the_same(browser, page, tmp_path):
    page.publish(rows(0, 5))
    with opened(browser, page.url, accept_downloads=True) as tab:
        eventually(lambda: len(drawn(tab, "speed")[0]) == 100, "all rows")
        tab.click("#record")
        eventually(lambda: "Stop" in tab.inner_text("#record"), "recording")
        given = rows(5, 25)
        page.publish(given)
        eventually(lambda: "400 rows" in tab.inner_text("#record"), "400 rows")
        tab.click("#record")
        with tab.expect_download() as recorded:
            tab.click("#recording")
        recorded.value.save_as(tmp_path / "r.csv")
        with tab.expect_download() as exported:
            tab.click("#csv")
        table = list(csv.DictReader(io.StringIO(exported.value.path().read_text())))
        assert [float(row["speed_rad_s"]) for row in table][-400:] == given.values[:, 0].tolist()
        with tab.expect_download() as picture:
            tab.click("#png")
        assert (
            picture.value.path().read_bytes().startswith(b"\x89PNG")
            and picture.value.path().stat().st_size > 10_000
        )
        tab.set_input_files("#file", tmp_path / "r.csv")
        eventually(lambda: tab.is_visible("#player"), "the player")
        times, values = drawn(tab, "speed")
        assert values == given.values[:, 0].tolist() and times == (given.time_ns / 1e9).tolist()
        tab.locator("#position").fill("0")
        assert number_of(tab, "speed") == pytest.approx(given.values[0, 0], abs=0.05)
        tab.select_option("#pace", "60")
        tab.click("#run")
        eventually(lambda: number_of(tab, "speed") == pytest.approx(given.values[-1, 0], abs=0.05), "its end")
        tab.click("#live")
        eventually(lambda: len(drawn(tab, "speed")[0]) == 500, "live again")
        (tmp_path / "other.csv").write_text("a,b\n1,2\n")
        tab.set_input_files("#file", tmp_path / "other.csv")
        eventually(
            lambda: "other.csv has no column time_s" in tab.inner_text("#limit-said"), "what is wrong with it"
        )


def test_several_motors_are_chosen_by_name_with_their_state(browser, page):
    saw = page.add(HEADER, "saw")
    page.publish(rows(0, 10))
    saw.publish(rows(0, 10, 50.0, quality=int(Quality.STUCK)))
    with opened(browser, page.url) as tab:
        eventually(lambda: tab.locator("#motors button").count() == 2, "two motors")
        press, other = tab.locator("#motors button").all()
        assert press.inner_text().startswith("press: ") and other.inner_text() == "saw: ■ bad"
        other.click()
        eventually(lambda: tab.inner_text("#status").startswith("Bad: a channel repeats"), "the other motor")
        assert number_of(tab, "speed") < 60


@pytest.mark.parametrize(
    "how",
    [{}, {"color_scheme": "dark"}, {"forced_colors": "active"}, {"width": 390, "height": 844}],
    ids=["light", "dark", "high contrast", "phone"],
)
def test_nobody_is_shut_out(browser, page, how):
    page.publish(rows(0, 30))
    page.event(
        {"event": "alarm", "alarm": "hot", "active": True, "timestamp": 2.0, "message": "91, above 90"}
    )
    with opened(browser, page.url, **how) as tab:
        eventually(lambda: len(drawn(tab, "speed")[0]) == 600, "all rows")
        assert serious(tab) == []
        assert tab.evaluate("document.documentElement.scrollWidth") <= tab.viewport_size["width"]
        # Nothing is written again that has not changed: text can be selected, a screen reader does not repeat itself.
        changes = tab.evaluate(
            """async () => { let changes = 0;
            const watch = new MutationObserver(list => changes += list.length);
            const all = {childList: true, subtree: true, characterData: true};
            for (const id of ["status", "limits", "events", "alarms"]) watch.observe(document.getElementById(id), all);
            await new Promise(done => setTimeout(done, 1200));
            return changes; }"""
        )
        assert changes == 0
