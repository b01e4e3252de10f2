"""Reports in a real browser: a zoom shows what the file says, colours run the right way, nobody is shut out."""

import csv
import io
import re
from pathlib import Path

import pytest
from helpers.browser import chromium, needs_browser, opened, serious

from motorlens_runtime.cli import main

pytestmark = [needs_browser, pytest.mark.fit]
MODEL = Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml"


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """The tour of the README: its recording, and the page of compare."""
    folder = tmp_path_factory.mktemp("tour")
    simulate = ["simulate", str(MODEL), "--scenario", "load_steps", "--effect", "coulomb_friction.tau_c=0.3"]
    assert main([*simulate, "--noise", "0.2%", "-o", str(folder / "bench.csv")]) == 0
    compare = ["compare", str(folder / "bench.csv"), "--motor", str(MODEL)]
    assert main([*compare, "--html", str(folder / "compare.html")]) == 0
    return folder / "compare.html"


@pytest.fixture(scope="module")
def browser():
    with chromium() as found:
        yield found


def zoom(page, start, stop):
    """By the boxes above the plots."""
    low, high = (
        page.get_by_label(re.compile("^from, in seconds")),
        page.get_by_label(re.compile("^to, in seconds")),
    )
    for box, value in ((high, stop), (low, start), (high, stop)):
        box.fill(str(value))
        box.press("Enter")


def test_it_is_small_enough_to_send(report):
    assert report.stat().st_size <= 1_500_000


def test_zoomed_to_20_ms_the_plots_are_what_the_csv_says(browser, report):
    with (report.parent / "bench.csv").open() as file:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]
    # The first switching on: the steepest 20 ms of the recording.
    first = next(k for k, row in enumerate(rows) if abs(row["voltage_V"]) > 100)
    start, stop = rows[first - 3]["time_s"] - 1e-4, rows[first - 3]["time_s"] + 0.02
    inside = [row for row in rows if start <= row["time_s"] <= stop]
    assert 5 <= len(inside) <= 9
    with opened(browser, report.as_uri()) as page:
        zoom(page, start, stop)
        # What is under the pointer, read off the legends while it goes over the plot.
        over = page.locator(".u-over").first
        box = over.bounding_box()
        seen = {}
        for step in range(1, 100):
            page.mouse.move(box["x"] + box["width"] * step / 100, box["y"] + box["height"] / 2)
            texts = page.locator(".u-legend").first.locator(".u-value").all_inner_texts()
            time, measured = (float(text.split()[0]) for text in texts[:2])
            seen[time] = measured
        shown = sorted((t, i) for t, i in seen.items() if start <= t <= stop)
        assert [t for t, _ in shown] == pytest.approx([row["time_s"] for row in inside], abs=3e-6)
        assert [i for _, i in shown] == pytest.approx(
            [row["current_A"] for row in inside], rel=1e-5, abs=1e-6
        )
        # The file it saves holds the same samples.
        with page.expect_download() as waiting:
            page.get_by_role("button", name="Save the samples in view as CSV").click()
        saved = list(csv.DictReader(io.StringIO(Path(waiting.value.path()).read_text())))
        assert [float(r["speed_measured"]) for r in saved] == pytest.approx(
            [r["speed_rad_s"] for r in inside], rel=1e-5, abs=1e-6
        )


def test_axes_are_linked(browser, report):
    with opened(browser, report.as_uri()) as page:
        page.locator(".u-over").nth(2).scroll_into_view_if_needed()
        box = page.locator(".u-over").nth(2).bounding_box()
        page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 20)
        page.mouse.down()
        page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 20, steps=5)
        page.mouse.up()
        start, stop = (
            float(page.get_by_label(re.compile(f"^{word}, in")).input_value()) for word in ("from", "to")
        )
        whole = 31.6165
        assert start == pytest.approx(0.25 * whole, rel=0.01) and stop == pytest.approx(0.5 * whole, rel=0.01)
        # The cursor stands at the same sample in all of them.
        page.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 20)
        times = {
            texts.locator(".u-value").first.inner_text() for texts in page.locator(".time .u-legend").all()
        }
        assert len(times) == 1 and start < float(times.pop().split()[0]) < stop


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_one_pixel_of_the_map(browser, report, scheme):
    """The worse a cell, the further its colour is from the paper; read from the picture, not from the style sheet."""
    from PIL import Image

    with opened(browser, report.as_uri(), color_scheme=scheme) as page:
        cells = page.locator(".grid td:not(.empty)").filter(has=page.locator("button"))
        brightness = {}
        for cell in cells.all():
            value = float(cell.inner_text())
            image = Image.open(io.BytesIO(cell.screenshot())).convert("L")
            brightness[value] = image.getpixel((5, 5))
        best, worst = min(brightness), max(brightness)
        assert worst > 2 * best
        if scheme == "light":
            assert brightness[worst] < brightness[best] - 25
        else:
            assert brightness[worst] > brightness[best] + 25
        # The legend runs the same way.
        swatches = [
            Image.open(io.BytesIO(s.screenshot())).convert("L").getpixel((4, 4))
            for s in page.locator(".colours li").all()
        ]
        assert swatches == sorted(swatches, reverse=scheme == "light") and len(set(swatches)) == 9


def test_a_click_on_a_region_a_cell_and_an_equation_marks_their_samples(browser, report):
    with (report.parent / "bench.csv").open() as file:
        rows = list(csv.DictReader(file))
    speeds, times = ([float(row[name]) for row in rows] for name in ("speed_rad_s", "time_s"))
    with opened(browser, report.as_uri()) as page:
        marked = page.locator(".marked")
        assert not marked.is_visible()
        backwards = page.get_by_role("button", name=re.compile("^backwards"))
        backwards.click()
        slow = 0.02 * max(map(abs, speeds))
        expected = sum(speed < -slow for speed in speeds)
        count = int(re.search(r"(\d+) samples", marked.inner_text())[1])
        assert abs(count - expected) <= 2 and f"({expected} samples)" in backwards.inner_text()
        assert backwards.get_attribute("aria-pressed") == "true"
        page.get_by_role("button", name="Zoom to the next stretch").click()
        start, stop = (
            float(page.get_by_label(re.compile(f"^{word}, in")).input_value()) for word in ("from", "to")
        )
        assert 0 < start < stop
        cell = page.locator(".grid td button").first
        cell.click()
        samples = int(re.search(r"(\d+) samples", cell.locator("..").get_attribute("title"))[1])
        assert abs(int(re.search(r"(\d+) samples", marked.inner_text())[1]) - samples) <= 2
        page.get_by_role("button", name="mechanical", exact=True).click()
        tenth = int(re.search(r"(\d+) samples", marked.inner_text())[1])
        assert tenth == pytest.approx(len(speeds) / 10, rel=0.02)
        # The stretch of time that holds half of the error, as its button says it.
        when = page.get_by_role("button", name=re.compile("^half of the squared error"))
        when.click()
        start, stop = map(float, re.search(r"([\d.]+) to ([\d.]+) s$", when.inner_text()).groups())
        count = int(re.search(r"(\d+) samples in 1 stretch\b", marked.inner_text())[1])
        assert count == pytest.approx(sum(start <= time <= stop for time in times), abs=3)
        page.get_by_role("button", name="Mark no samples").click()
        assert not marked.is_visible()


@pytest.mark.parametrize(("scheme", "width"), [("light", 1280), ("dark", 390)])
def test_axe_finds_nothing_serious(browser, report, scheme, width):
    with opened(browser, report.as_uri(), color_scheme=scheme, width=width) as page:
        assert serious(page) == []
        scrolls = page.locator(".again pre").evaluate("node => node.scrollWidth > node.clientWidth")
        assert scrolls or width > 390  # the path of the recording is longer than a phone is wide
        assert (
            page.locator("main").count() == 1 and page.locator(".u-wrap[role=img][aria-label]").count() >= 8
        )


def test_on_a_phone_it_stays_as_wide_as_the_phone_and_a_swipe_scrolls(browser, report):
    phone = {"width": 390, "height": 844, "is_mobile": True, "has_touch": True}
    with opened(browser, report.as_uri(), **phone) as page:
        assert page.evaluate("document.documentElement.scrollWidth") == 390
        page.evaluate("scrollTo(0, 300)")
        box = page.locator(".u-over").nth(1).bounding_box()
        before = page.get_by_label(re.compile("^to, in")).input_value()
        finger = page.context.new_cdp_session(page)
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        for kind, up in [
            ("touchStart", 0),
            *(("touchMove", up) for up in range(20, 220, 20)),
            ("touchEnd", None),
        ]:
            points = [] if up is None else [{"x": x, "y": y - up}]
            finger.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        page.wait_for_function("scrollY > 400")
        assert page.get_by_label(re.compile("^to, in")).input_value() == before


def test_by_keyboard_and_in_high_contrast(browser, report):
    with opened(browser, report.as_uri(), forced_colors="active") as page:
        page.locator(".time").focus()
        page.keyboard.press("+")
        start, stop = (
            float(page.get_by_label(re.compile(f"^{word}, in")).input_value()) for word in ("from", "to")
        )
        assert stop - start == pytest.approx(31.6165 / 2, rel=1e-3)
        page.keyboard.press("Shift+ArrowRight")
        first = page.locator(".u-legend").first.locator(".u-value").first.inner_text()
        page.keyboard.press("Shift+ArrowRight")
        second = page.locator(".u-legend").first.locator(".u-value").first.inner_text()
        assert 0 < float(second.split()[0]) - float(first.split()[0]) < 0.004  # the next sample
        # A bar is seen: its fill is not the colour of its track, nor of the paper.
        colours = page.evaluate(
            "['.bars .track', '.bars .predicted'].map(s => getComputedStyle(document.querySelector(s)).fill)"
        )
        assert colours[0] != colours[1]
