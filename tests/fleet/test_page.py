"""The fleet's page in a real browser, of recordings that nobody had to fit."""

import numpy as np
import pytest
from helpers.browser import chromium, needs_browser, opened, serious
from helpers.drawn_fleet import BROKEN, DRAGS, MAKE, drawn, fleet_of

from motorlens_physics.motor_file import read_motor_file
from motorlens_workbench.report.fleet import to_html, to_json

pytestmark = [needs_browser, pytest.mark.fit]


@pytest.fixture(scope="module")
def fleet():
    return fleet_of(read_motor_file("mellah2016"), drawn(np.random.default_rng(5), 0.0)[0])


@pytest.fixture(scope="module")
def page_file(fleet, tmp_path_factory):
    path = tmp_path_factory.mktemp("fleet") / "index.html"
    path.write_text(
        "".join(to_html(fleet, "mellah2016", "motorlens fleet plant/ --motor mellah2016 -o fleet/"))
    )
    return path


@pytest.fixture(scope="module")
def browser():
    with chromium() as found:
        yield found


def rows_below(page, heading):
    """The cells of the first table of a section, row by row."""
    table = (
        page.locator("section", has=page.get_by_role("heading", name=heading, exact=True))
        .locator("table")
        .first
    )
    return [row.locator("td, th").all_inner_texts() for row in table.locator("tbody tr").all()]


def test_it_says_what_was_drawn(browser, page_file):
    with opened(browser, page_file.as_uri()) as page:
        assert "m07, m11 are not like the others" in page.locator("main").inner_text().replace(
            "m11, m07", "m07, m11"
        )
        odd = {row[0]: row[1] for row in rows_below(page, "Odd motors")}
        assert odd[f"m{BROKEN:02d}"].startswith("R_a0 differs by +1.")
        assert "coulomb friction" in odd[f"m{DRAGS:02d}"] and "since 2026-04-01" in odd[f"m{DRAGS:02d}"]
        make = {row[0]: row[1:] for row in rows_below(page, "The make")}
        assert float(make["R_a0"][0]) == pytest.approx(MAKE[0], rel=0.03)
        assert make["k0"][2] == "not told"
        motors = rows_below(page, "All motors")
        assert len(motors) == 60 and {motors[0][0], motors[1][0]} == {"m07", "m11"}
        spoilt = rows_below(page, "Recordings that could not be used")
        assert spoilt == [["m00/spoilt.csv", "m00", "no column holds a voltage"]]


def test_under_the_pointer_stands_what_the_document_says(browser, page_file, fleet):
    """In the first picture: the share of the motors below a value of R."""
    document = to_json(fleet, "mellah2016")
    values = np.array([motor["parameters"]["R_a0"]["value"] for motor in document["motors"]])
    with opened(browser, page_file.as_uri()) as page:
        plot = page.locator(".u-over").first
        plot.scroll_into_view_if_needed()
        box = plot.bounding_box()
        shares = []
        for part in (0.2, 0.5, 0.8):
            page.mouse.move(box["x"] + part * box["width"], box["y"] + box["height"] / 2)
            texts = page.locator(".u-legend").first.locator(".u-value").all_inner_texts()
            at, motors, normal = (float(text.split()[0]) for text in texts)
            # Numbers on the page are rounded: a motor at that place may fall on either side of it.
            low, high = (np.mean(values <= at * (1 + side)) for side in (-1e-4, 1e-4))
            assert low - 1e-3 <= motors <= high + 1e-3
            shares.append((motors, normal))
    assert shares[0] < shares[1] < shares[2]


@pytest.mark.parametrize(("scheme", "width"), [("light", 1280), ("dark", 390)])
def test_nobody_is_shut_out(browser, page_file, scheme, width):
    with opened(browser, page_file.as_uri(), color_scheme=scheme, width=width) as page:
        assert serious(page) == []
        assert page.evaluate("document.documentElement.scrollWidth") == width


def test_whose_row_it_is_stays_in_view(browser, page_file):
    with opened(browser, page_file.as_uri()) as page:
        table = page.locator("section", has=page.get_by_role("heading", name="All motors")).locator(".scroll")
        first, second = (table.locator(f"tbody tr:first-child td:nth-child({k})") for k in (1, 2))
        table.evaluate("node => { node.style.width = '20rem'; }")  # this fleet's has few parameters
        before = first.bounding_box()["x"], second.bounding_box()["x"]
        table.evaluate("node => { node.scrollLeft = 60; }")
        after = first.bounding_box()["x"], second.bounding_box()["x"]
        assert after[0] == pytest.approx(before[0], abs=1) and after[1] == pytest.approx(
            before[1] - 60, abs=1
        )


def test_it_is_small_enough_to_send(page_file):
    assert page_file.stat().st_size <= 1_500_000
