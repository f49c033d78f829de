"""The page of all cells in Debian's Chromium: what it shows, in English by day and in German at night on a phone.

In: the link of a fleet's page that runs, the names of its cells, a folder for pictures. Out: a line for every
check and exit code 1 at the first that fails. A console error, a finding of axe or a page that is wider than
its window fails it too.
"""

import pathlib
import shutil
import sys

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import expect, sync_playwright

LINK, CELLS, PICTURES = sys.argv[1], sys.argv[2].split(","), pathlib.Path(sys.argv[3])
LONG = 60_000

expect.set_options(timeout=LONG)


def check(name, held, why=""):
    """A line; the end where it does not hold."""
    print(f"{'ok' if held else 'FAILED'}: {name} {why if not held else ''}", flush=True)
    if not held:
        raise SystemExit(1)


def visit(browser, name, words, **options):
    """The page in a window of its own: its cells, these words, and nothing wrong."""
    errors = []
    page = browser.new_context(**options).new_page()
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(LINK)
    for cell in CELLS:
        expect(page.get_by_role("heading", name=cell, exact=True)).to_be_visible()
        check(f"{name}: {cell} is there", True)
    for word in words:
        expect(page.get_by_text(word, exact=True).first).to_be_visible()
        check(f"{name}: it says {word!r}", True)
    check(f"{name}: the key is out of the address", "key=" not in page.url, page.url)
    wide = page.evaluate("() => document.documentElement.scrollWidth - innerWidth")
    check(f"{name}: it fits into its window", wide <= 0, f"{wide} pixels too wide")
    page.screenshot(path=PICTURES / f"fleet-{name}.png", full_page=True)
    found = Axe().run(page)
    check(f"{name}: axe finds nothing", found.violations_count == 0, found.generate_report() if found.violations_count else "")
    check(f"{name}: no console error", not errors, str(errors))


def without_key(browser):
    """Without the key of the link nothing of the cells is shown, and what is missing is."""
    page = browser.new_context(locale="en-GB").new_page()
    page.goto(LINK.split("#")[0])
    expect(page.locator("main")).not_to_contain_text("…")
    text = page.locator("body").inner_text()
    check("without the key no cell is shown", not any(cell in text for cell in CELLS), text)
    check("and how to get it is", "celld fleet page" in text, text)


with sync_playwright() as playwright:
    PICTURES.mkdir(parents=True, exist_ok=True)
    window = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
    desk = {"viewport": {"width": 1400, "height": 1000}, "locale": "en-GB", "color_scheme": "light"}
    phone = {"viewport": {"width": 390, "height": 844}, "locale": "de-DE", "color_scheme": "dark"}
    visit(window, "desktop", ["throughput", "cycle time"], **desk)
    visit(window, "phone", ["Durchsatz"], **phone)
    without_key(window)
    window.close()
