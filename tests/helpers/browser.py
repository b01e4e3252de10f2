"""A real browser for the tests of pages: Chromium by Playwright. Where either is absent, tests are skipped and say so."""

import importlib.util
import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from helpers.processes import LIMIT_S

QUIET = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
# Nothing on a page takes longer than this, however busy the machine, but for a step of the workbench.
PATIENCE_MS = 1000 * LIMIT_S


def _reason() -> str:
    absent = [
        name for name in ("playwright", "axe_playwright_python") if importlib.util.find_spec(name) is None
    ]
    if CHROMIUM is None:
        return "no Chromium on this machine: apt-get install chromium"
    return f"not installed: {', '.join(absent)} (pip install 'motorlens[dev]')" if absent else ""


needs_browser = pytest.mark.skipif(bool(_reason()), reason=_reason() or "a browser is there")


@contextmanager
def chromium() -> Iterator["object"]:
    """A browser; `opened` makes pages of it."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=list(QUIET), timeout=PATIENCE_MS)
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def opened(browser, url, *, width=1280, height=900, **context):
    """A page that fails the test if its script throws, if the console reports an error, or if it asks anybody else."""
    tab = browser.new_context(viewport={"width": width, "height": height}, **context)
    tab.set_default_timeout(PATIENCE_MS)
    page, complaints = tab.new_page(), []
    page.on("pageerror", lambda error: complaints.append(f"script: {error}"))
    page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    page.on(
        "request", lambda request: complaints.append(f"asks {request.url}") if _foreign(request.url) else None
    )
    page.complaints = complaints
    page.goto(url)
    try:
        yield page
        assert not complaints, complaints
    finally:
        tab.close()


def _foreign(url: str) -> bool:
    return not url.startswith(("file:", "data:", "blob:", "about:", "http://127.0.0.1:"))


# Whether a region scrolls depends on the length of a path or the width of a window; whether it may does not.
_OUT_OF_REACH = """() => [...document.querySelectorAll("body *")].filter(node => {
  const {overflowX, overflowY} = getComputedStyle(node);
  return [overflowX, overflowY].some(one => one === "auto" || one === "scroll")
    && ![node, ...node.querySelectorAll("*")].some(one => one.tabIndex >= 0);
}).map(node => "may scroll and cannot be reached by keyboard: " + node.outerHTML.slice(0, 200))"""


# What Lighthouse asks of a page beside axe and the console: a doctype, a title, a language, a viewport that may be zoomed,
# targets of 24 px for a finger (WCAG 2.5.8; links in a sentence and what is not shown aside), a name for what is drawn,
# nothing fetched that is not there, and how much came over the line to show it first.
_LACKING = """most => {
  const lacks = [], shown = node => node.checkVisibility({visibilityProperty: true, opacityProperty: true});
  const say = (bad, text) => bad && lacks.push(text);
  say(document.compatMode !== "CSS1Compat", "no doctype");
  say(!document.title.trim(), "no title");
  say(!document.documentElement.lang, "no language");
  const viewport = document.querySelector("meta[name=viewport]")?.content ?? "";
  say(!viewport.includes("width=device-width"), "no viewport of the device's width");
  say(/user-scalable=no|maximum-scale/.test(viewport), "may not be zoomed");
  for (const node of document.querySelectorAll("a[href], button, select, input, summary, [role=tab], [role=button]")) {
    // A label is a target as well as what it labels.
    const boxes = [node, ...(node.labels ?? [])].map(one => one.getBoundingClientRect());
    const sides = boxes.map(box => Math.min(box.width, box.height));
    const within = getComputedStyle(node).display === "inline" && node.matches("a");
    say(shown(node) && !within && Math.max(...sides) < 24,
        `a target of ${Math.max(...sides).toFixed(1)} px: ` + node.outerHTML.slice(0, 120));
  }
  for (const node of document.querySelectorAll("img, canvas, svg")) {
    const named = node.hasAttribute("alt") || node.closest("[aria-label], [aria-hidden=true]");
    const titled = named || node.querySelector(":scope > title");
    say(shown(node) && !titled, `drawn without a name: ${node.outerHTML.slice(0, 120)}`);
  }
  const fetched = performance.getEntriesByType("resource");
  for (const one of fetched) say(one.responseStatus >= 400, `${one.responseStatus}: ${one.name}`);
  const first = fetched.filter(one => /script|link|css/.test(one.initiatorType));
  const all = [...performance.getEntriesByType("navigation"), ...first];
  const octets = all.reduce((sum, one) => sum + one.encodedBodySize, 0);
  say(octets > most, `${octets} octets to show it first, of ${most}`);
  return lacks;
}"""
# The page, its style, its scripts and the library that draws; a report holds its data as well.
MOST_OCTETS = 1_500_000


def serious(page) -> list[str]:
    """What axe finds that is serious or critical, what Lighthouse would ask for beside, and what may scroll and cannot be
    reached by keyboard; a line each."""
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(page).response["violations"]
    return (
        page.evaluate(_OUT_OF_REACH)
        + page.evaluate(_LACKING, MOST_OCTETS)
        + [
            f"{one['id']}: {one['help']}: {one['nodes'][0]['html'][:200]}"
            for one in found
            if one["impact"] in ("serious", "critical")
        ]
    )
