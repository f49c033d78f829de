"""The page as an operator uses it, in Debian's Chromium: from signing in to a table rearranged to a goal that
was dragged, a pause, a step, a stop with an object in the gripper and the way back, a lost daemon.

In: the celld binary, a folder for pictures, sizes and languages from the tests below. Out: a line for every
check and exit code 1 at the first that fails; pictures of the screens, light and dark, phone and desktop. A
console error, a failed request or a finding of axe fails it too. Figures are printed, not judged.
"""

import os
import pathlib
import re
import shutil
import signal
import statistics
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "examples"))

from axe_playwright_python.sync_playwright import Axe
from cell_client import Cell, Refused
from playwright.sync_api import expect, sync_playwright
from running import ADDRESS, Running

CELLD = os.path.abspath(sys.argv[1])
PICTURES = pathlib.Path(sys.argv[2])
BROWSER = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
LONG = 60_000
WAYS = {"place": "Put it down", "hold": "Keep holding", "retreat": "Straight up", "release": "Let go (hold it by hand)"}

expect.set_options(timeout=LONG)


def check(name, held, why=""):
    print(f"{'ok' if held else 'FAILED'}: {name} {why if not held else ''}", flush=True)
    if not held:
        raise SystemExit(1)


class Page:
    """One browser window, and what went wrong in it."""

    def __init__(self, browser, cell, **options):
        self.errors = []
        self.bytes = 0
        self.context = browser.new_context(**options)
        self.page = self.context.new_page()
        self.page.on("console", lambda message: self.errors.append(message.text) if message.type == "error" else None)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.cell = cell

    def sign_in(self):
        self.page.goto(self.cell.open("--print"))
        expect(self.page.locator("#message")).to_be_visible()

    def screen(self, name):
        self.page.goto(f"http://{ADDRESS}:8737/#{name}")

    def picture(self, name):
        self.page.screenshot(path=PICTURES / f"{name}.png", full_page=True)

    def sound(self, what):
        found = Axe().run(self.page)
        check(f"axe finds nothing on {what}", found.violations_count == 0, found.generate_report() if found.violations_count else "")
        check(f"no console error on {what}", not self.errors, str(self.errors))

    def text(self, locator, words):
        expect(self.page.locator(locator)).to_contain_text(words)
        check(f"{locator} says {words!r}", True)

    def hold(self, locator):
        button = self.page.locator(locator)
        button.scroll_into_view_if_needed()
        box = button.bounding_box()
        self.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        self.page.mouse.down()
        self.page.wait_for_timeout(1500)
        self.page.mouse.up()


def figures(playwright, cell):
    """What a browser with an empty cache loads, and how soon something is painted, by its own clock; without the
    drawing in software that the other windows have, which takes its time to come up."""
    browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
    paints, size = [], 0
    for _ in range(5):
        window = Page(browser, cell, viewport={"width": 1400, "height": 1000}, locale="en-GB")
        window.sign_in()
        window.page.wait_for_function("() => performance.getEntriesByType('paint').length > 1")
        window.page.wait_for_timeout(500)
        paint, size = window.page.evaluate("""() => {
          const all = performance.getEntriesByType('resource').concat(performance.getEntriesByType('navigation'));
          const paint = performance.getEntriesByType('paint').find((e) => e.name === 'first-contentful-paint');
          return [paint?.startTime ?? -1, all.reduce((sum, entry) => sum + entry.transferSize, 0)];
        }""")
        paints.append(paint)
        window.context.close()
    browser.close()
    shown = ", ".join(f"{paint:.0f}" for paint in paints)
    print(f"figure: first paint after {statistics.median(paints):.0f} ms, median of {shown}; {size / 1e3:.0f} kB transferred", flush=True)


def drag(page, thing, dx, dy):
    box = page.locator(f"#goal-{thing} path").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + dx / 2, y + dy / 2)
    page.mouse.move(x + dx, y + dy)
    page.mouse.up()
    checked(page)


def checked(page):
    """The checker has said what it thinks of the last change."""
    expect(page.locator("#goal-table[aria-busy=false]")).to_be_visible()


def set_a_goal(window, cell):
    page = window.page
    window.screen("goal")
    page.click("#look")
    expect(page.locator("#looking")).to_be_visible()
    window.screen("live")
    page.click("#order-arm")
    window.text("#armed", "ARMED")
    window.screen("goal")
    expect(page.locator("#goal-lid")).to_be_visible()
    check("the table was looked at, and is the first goal", True)
    window.picture("goal-as-it-lies")
    # Onto another object: it slides to the nearest free place, and nothing is wrong then.
    block = page.locator("#goal-block path").bounding_box()
    lid = page.locator("#goal-lid path").bounding_box()
    drag(page, "lid", block["x"] - lid["x"] + 20, block["y"] - lid["y"])
    expect(page.locator("#troubles .note")).to_have_count(0)
    moved = page.locator("#goal-lid path").bounding_box()
    check("what is dropped onto another slides beside it", abs(moved["x"] - lid["x"]) > 20)
    # By keys, without a mouse: a millimetre an arrow.
    before = float(page.input_value("#n-lid-0"))
    page.focus("#goal-lid")
    page.keyboard.press("Shift+ArrowRight")
    checked(page)
    check("keys move what is chosen", abs(float(page.input_value("#n-lid-0")) - before - 10) < 0.2)
    page.fill("#n-block-0", "-200")
    page.press("#n-block-0", "Tab")
    window.text("#troubles", "over the table's edge")
    window.picture("goal-wrong")
    page.click("#take")
    checked(page)
    drag(page, "lid", -40, 90)
    page.click("#plan")
    window.text("#planned", "moves")
    window.picture("goal-preview")
    window.sound("the goal")
    page.fill("#goal-name", "mine")
    page.click("#save")
    window.text("#preview", "Saved as mine.yaml")
    check("the goal file is there", "lid" in (cell.folder / "config/mine.yaml").read_text())
    page.fill("#job-id", "mine")
    page.click("#submit")
    window.text("#submitted", "mine")


def pause_and_disarm_on_the_way(page, window):
    """What is under way is finished: so long no badge says that the arm rests."""
    expect(page.locator("#holding")).to_be_visible()
    page.click("#order-pause")
    # Bar and badge in one reading: both are of a moment that passes.
    until, said = time.monotonic() + LONG / 1000, ["", ""]
    while "pausing" not in said[1] and time.monotonic() < until:
        said = page.evaluate("() => ['bar-mode', 'paused'].map((id) => document.getElementById(id)?.textContent ?? '')")
    check("bar and badge say that the arm may still move", said[0].endswith("pausing, MAY STILL MOVE") and said[1] == "pausing, THE ARM MAY STILL MOVE", str(said))
    expect(page.locator("#paused")).to_have_text("paused")
    check("a pause is plain once the arm rests", not page.locator("#holding").is_visible())
    page.click("#order-resume")
    expect(page.locator("#holding")).to_be_visible()
    page.click("#order-disarm")
    window.text("#armed", "disarmed, THE ARM MAY STILL MOVE")
    check("arming is not what comes next", "first" not in (page.get_attribute("#order-arm", "class") or ""))
    expect(page.locator("#armed")).to_have_text("disarmed")
    check("the badge is plain once the arm rests", not page.locator("#holding").is_visible())
    page.click("#order-arm")
    window.text("#armed", "ARMED")
    # The rest of the plan was agreed to; where it has changed, it needs a new approval.
    waits, holding = page.locator("#waits"), page.locator("#holding")
    expect(waits.or_(holding).first).to_be_visible()
    if waits.is_visible():
        page.wait_for_timeout(2500)
        page.click("#order-approve")


def a_plan_that_has_just_come_is_not_approved(window):
    """A press meant what was there before: the plan cannot have been read."""
    page = window.page
    page.evaluate("""() => new Promise((done) => {
        const look = () => {
            const button = document.getElementById("order-approve");
            if (!button || button.disabled) return requestAnimationFrame(look);
            button.click();
            done();
        };
        location.hash = "#live";
        look();
    })""")
    window.text("#answer-click", "the plan had only just come")
    window.text("#waits", "Job mine waits for approval")


def carry_out(window):
    page = window.page
    a_plan_that_has_just_come_is_not_approved(window)
    page.locator("#scrub").fill("1")
    page.locator("#scrub").dispatch_event("input")
    window.text("output", "after move 1")
    window.picture("live-approval")
    for where in [".t-label, .t-number", ".p-text"]:
        hidden = page.evaluate("""(where) => {
            const boxes = [...document.querySelectorAll(where)].map((text) => [text.textContent, text.getBoundingClientRect()]);
            const meet = ([, a], [, b]) => a.left < b.right - 1 && b.left < a.right - 1 && a.top < b.bottom - 1 && b.top < a.bottom - 1;
            return [boxes.length, boxes.flatMap((a, i) => boxes.slice(i + 1).filter((b) => meet(a, b)).map((b) => `${a[0]} and ${b[0]}`))];
        }""", where)
        check(f"no label hides another: {where}", hidden[0] > 3 and not hidden[1], str(hidden))
    window.sound("the cell, while a plan waits")
    page.click("#order-pause")
    window.text("#answer", "paus")
    page.click("#order-approve")
    window.text("#answer", "approved")
    expect(page.locator("#order-approve")).to_be_disabled()
    expect(page.locator("#scrub")).to_have_value("0")
    page.click("#order-step")
    expect(page.locator("#message")).not_to_contain_text("approval")
    page.wait_for_selector("#order-resume", timeout=LONG)
    page.click("#order-resume")
    window.screen("jobs/mine")
    window.text("main", "every object is at its goal")
    window.picture("jobs-done")
    window.sound("a job")


def a_click_on_a_busy_page_is_a_click(window):
    """Of its end the page comes to know long after a held button would have acted."""
    page = window.page
    page.evaluate("""async () => {
        const { hold } = await import("/orders.js");
        const button = hold("tried", () => { button.dataset.acts = Number(button.dataset.acts ?? 0) + 1; }, { id: "tried" });
        button.addEventListener("pointerup", (event) => { button.dataset.late = performance.now() - event.timeStamp; });
        document.getElementById("main").prepend(button);
    }""")
    tried = page.locator("#tried")
    tried.hover()
    page.mouse.down()
    page.evaluate("() => { setTimeout(() => { const end = performance.now() + 2500; while (performance.now() < end); }, 50); }")
    time.sleep(0.3)
    page.mouse.up()
    expect(tried).to_have_attribute("data-late", re.compile("."))
    late = float(tried.get_attribute("data-late"))
    check("the page was busy when the button was let go", late > 1500, f"{late} ms")
    page.wait_for_timeout(1500)
    check("a click on a page that was busy is no held button", tried.get_attribute("data-acts") is None)
    window.hold("#tried")
    expect(tried).to_have_attribute("data-acts", "1")
    page.evaluate("() => document.getElementById('tried').remove()")


def ways_are_those_that_the_cell_takes(page, client):
    """Which ways back can be pressed is what `What happened?` says, and what the status says; each is of a moment
    of its own, and they agree once the arm rests."""
    until = time.monotonic() + LONG / 1000
    while True:
        page.click("#recover-show")
        expect(page.locator("#answer")).to_contain_text("ways back")
        said = page.locator("#answer").inner_text()
        refused = {way for way, label in WAYS.items() if f"not now: “{label}”" in said}
        enabled = {way for way in WAYS if page.locator(f"#recover-{way}").is_enabled()}
        if enabled == set(WAYS) - refused == set(client.status()["ways"]) or time.monotonic() > until:
            break
    check("the ways back that can be pressed are those that are not refused", enabled == set(WAYS) - refused == set(client.status()["ways"]), f"{enabled} {said}")
    check("and what is held can be put down", "place" in enabled, said)


def submit_again(window):
    """The goal of a job that failed, without setting it again."""
    page = window.page
    window.screen("jobs/second")
    window.text("#story", "taken up")
    page.click("#again")
    window.text("#submitted", "second.2")
    window.text("#submitted", "It begins once the cell is armed.")
    window.picture("jobs-again")
    window.screen("live")
    window.text("main", "Job second.2")
    page.wait_for_timeout(2500)
    page.click("#order-cancel")
    expect(page.locator("#order-cancel")).to_be_disabled()
    window.text("#last", "second.2")


def stop_with_an_object(window, cell):
    page = window.page
    token = cell.open("--token", "--role", "approve", "--name", "client")
    client = Cell(f"http://{ADDRESS}:8737", token)
    job = client.submit("version: 1\nid: second\ngoal: {swap: [plank-1, plank-2]}\n")
    check("the client in Python submits a job", job == "second")
    try:
        client.submit("version: 1\ngoal: {swap: [plank-1]}\n")
        check("a wrong job is refused", False)
    except Refused as refused:
        check("a wrong job is refused", refused.status == 422 and "change places" in str(refused), str(refused))
    window.screen("live")
    page.wait_for_selector("#waits", timeout=LONG)
    check("the client agrees to the plan", client.approve("second").accepted)
    pause_and_disarm_on_the_way(page, window)
    expect(page.locator("#holding")).to_be_visible()
    cell.fault("ur.pstop")
    window.text("#stopped", "protective stop")
    check("the stop is shown with an object in the gripper", page.locator("#holding").is_visible())
    check("the table has it where the arm has it", page.locator("#carried").count() == 1)
    window.text("#arm-refused", "It cannot be armed now: the arm is in a protective stop")
    check("what would be refused cannot be pressed", page.locator("#order-arm").is_disabled())
    window.picture("live-stopped")
    window.sound("a stop")
    check("what an order began is not announced beside the stop", page.locator("#answer.over").count() == 0)
    page.click("#recover-show")
    window.text("#answer", "plank")
    ways_are_those_that_the_cell_takes(page, client)
    page.click("#recover-place")
    window.text("#answer-click", "hold the button down")
    expect(page.locator("#recover-place")).to_have_text("hold for a second")
    expect(page.locator("#recover-place")).to_have_text("Put it down")
    check("what happened is still there to be read", "plank" in page.locator("#answer").inner_text())
    page.evaluate("() => { document.getElementById('recover-place').dataset.same = 'yes'; }")
    page.wait_for_timeout(2000)
    check("a button that could be held down stays while readings come in", page.locator("#recover-place[data-same]").count() == 1)
    # As while it is held down: what changes meanwhile is drawn when it is let go.
    page.evaluate("() => document.getElementById('recover-place').classList.add('holding')")
    check("a stop may be paused too", client.order("pause").accepted)
    expect(page.locator("#paused")).to_be_visible()
    check("a button that is held down is not replaced", page.locator("#recover-place[data-same]").count() == 1 and page.locator("#order-resume").is_disabled())
    page.evaluate("() => document.getElementById('recover-place').classList.remove('holding')")
    expect(page.locator("#order-resume")).to_be_enabled()
    page.click("#order-resume")
    expect(page.locator("#paused")).to_have_count(0)
    check("a click alone orders nothing", bool(client.status()["stopped"]) and page.locator("#stopped").is_visible())
    window.hold("#recover-place")
    expect(page.locator("#stopped")).to_have_count(0)
    expect(page.locator("#holding")).to_have_count(0)
    expect(page.locator("#carried")).to_have_count(0)
    expect(page.locator("#unfinished")).to_contain_text("second", timeout=LONG)
    check("the job that the stop ended is named once it is left", "protective stop" in page.locator("#unfinished").inner_text())
    expect(page.locator("#order-arm")).to_be_enabled()
    expect(page.locator("#arm-refused")).to_have_count(0)
    submit_again(window)
    expect(page.locator(".t-unseen")).to_have_count(1)
    check("and where it was put, until it is seen there", True)
    window.text("#bar-mode", "disarmed")
    window.screen("goal")
    expect(page.locator(".t-unseen")).to_have_count(1)
    check("also where a goal is set", True)
    window.screen("live")
    window.text("#armed", "disarmed")
    try:
        previewed = str(client._open("/api/v1/preview", {"text": "version: 1\ngoal: {look: true}\n"}))
    except Refused as refused:
        previewed = str(refused)
    check("no preview is made from a look that it has outlived", "was carried since the table was seen" in previewed, previewed)
    events = client.events()
    kinds = {next(events)[0] for _ in range(12)}
    check("the client follows the events", {"status", "arm", "beat"} <= kinds, str(kinds))
    page.click("#order-arm")
    window.text("#armed", "ARMED")
    window.screen("goal")
    window.text("#starts", "the arm moves as soon as a job is submitted")
    window.screen("setup")
    page.select_option("#sizes", "50")
    check("markers are printed in the size of the configuration", page.input_value("#ids") == "2" and page.input_value("#size") == "50")
    page.click("#stop")
    window.text("#stopping", "disarmed")
    window.screen("live")
    window.text("#armed", "disarmed")
    check("Stop ends what was armed", not client.status()["armed"])


def play_back(window):
    page = window.page
    window.screen("jobs/mine")
    with page.context.expect_page() as opened:
        page.click("#playback")
    played = opened.value
    expect(played.locator("#run")).to_contain_text("every object is at its goal", timeout=LONG)
    slider = played.locator("input[type=range]")
    slider.evaluate("(input) => { input.value = input.max; input.dispatchEvent(new Event('input')); }")
    expect(played.locator("#run img")).to_be_visible()
    played.wait_for_timeout(300)
    played.screenshot(path=PICTURES / "playback.png", full_page=True)
    check("a job is played back from its recording", played.locator("#run img, #run svg").count() >= 2)
    played.close()


def watch_the_film(window):
    page = window.page
    window.screen("live")
    page.click("#film")
    page.wait_for_function("() => document.querySelector('img[src*=\"/film\"]')?.naturalWidth === 1280", timeout=LONG)
    window.picture("live-film")
    window.sound("the film")
    page.click("#film")
    expect(page.locator("img[src*='/film']")).to_have_count(0)
    check("the camera's film is shown, and ends", True)


def calibrate(browser, cell):
    """Step by step, up to files that are kept; on a cell of its own whose time runs faster."""
    window = Page(browser, cell, viewport={"width": 1400, "height": 1000}, locale="en-GB")
    page = window.page
    window.sign_in()
    window.screen("calibrate")
    page.wait_for_function("() => / [1-9][0-9]* of objects/.test(document.getElementById('found')?.textContent ?? '')", timeout=LONG)
    check("markers are found in what the camera shows now", True)
    page.click("#board")
    page.click("#lens-picture")
    window.text("#lens-said", "not kept")
    page.click("#touches")
    window.text("#touch-wanted", "marker 500")
    page.click("#touch")
    window.text("#touch-wanted", "marker 501")
    window.hold("#round")
    window.text("#answer", "disarmed")
    check("no round in a cell that is disarmed", True)
    window.picture("calibrate-steps")
    window.sound("calibration")
    window.screen("live")
    page.click("#order-arm")
    window.text("#armed", "ARMED")
    window.screen("calibrate")
    page.wait_for_selector("#round:enabled")
    window.hold("#round")
    expect(page.locator("#round-state")).to_contain_text("complete", timeout=2 * LONG)
    page.click("#solve")
    window.text("#solved", "px")
    page.click("#show-3")
    expect(page.locator("#show-3")).to_have_attribute("aria-pressed", "true")
    page.wait_for_timeout(500)
    window.picture("calibrate-solved")
    window.sound("a calibration")
    window.hold("#keep")
    window.text("#kept", "next start")
    window.context.close()


def lost_daemon(window, cell):
    page = window.page
    window.screen("live")
    cell.celld.send_signal(signal.SIGKILL)
    begun = time.monotonic()
    expect(page.locator("#stale")).to_be_visible(timeout=10_000)
    print(f"figure: a lost daemon is shown after {time.monotonic() - begun:.1f} s", flush=True)
    check("nothing that moves can be ordered", page.locator("#order-arm").is_disabled() and page.locator("#stop").is_enabled())
    window.picture("live-stale")
    cell.celld.wait()
    page.evaluate("() => { document.body.dataset.before = 'yes'; }")
    cell.daemon()
    expect(page.locator("#stale")).to_be_hidden()
    window.text("#armed", "disarmed")
    window.text("main", "The table was not seen yet.")
    expect(page.locator("body[data-before]")).to_have_count(0)
    check("nothing of the earlier celld is left", True)
    check("the page comes back by itself, and the session with it", page.locator("#message").is_visible())


def all_sizes(browser, cell):
    sizes = {"desktop": {"width": 1400, "height": 1000}, "phone": {"width": 390, "height": 844}, "wall": {"width": 2560, "height": 1440}}
    for name, size in sizes.items():
        for scheme in ["light", "dark"]:
            locale = "de-DE" if scheme == "dark" else "en-GB"
            window = Page(browser, cell, viewport=size, color_scheme=scheme, locale=locale, has_touch=name == "phone")
            window.sign_in()
            for screen in ["live", "goal", "jobs", "calibrate", "setup"]:
                window.screen(screen)
                window.page.wait_for_selector("main .card", timeout=LONG)
                window.page.wait_for_timeout(200)
                window.picture(f"{screen}-{name}-{scheme}")
                wide = window.page.evaluate("() => document.documentElement.scrollWidth - window.innerWidth")
                check(f"{screen} fits {name}", wide <= 1, f"{wide} px too wide")
                small = window.page.evaluate("() => [...document.querySelectorAll('button, select, nav a')].filter((e) => e.offsetParent && !e.closest('table') && e.getBoundingClientRect().height < 47.5).map((e) => e.id || e.textContent)")
                check(f"targets on {screen} are large enough on {name}", not small, str(small))
                if name != "wall":
                    window.sound(f"{screen}, {name}, {scheme}, {locale}")
            if scheme == "dark":
                window.screen("live")
                window.page.wait_for_selector("#message", timeout=LONG)
                said = window.page.locator("#message").inner_text()
                check("the cell's own words are German", said in ("ruht", "angehalten"), said)
                job = window.page.evaluate("() => import('/text.js').then((text) => text.here('job tidy-7 is under way; job none is not the active one'))")
                step = window.page.evaluate("() => import('/text.js').then((text) => text.here('2. lid was gripped, on its way to its goal'))")
                check("and so is the story of a job", step == "2. lid wurde gegriffen, unterwegs zu seinem Ziel", step)
                shown = window.page.evaluate("() => import('/text.js').then((text) => text.here('what happened: the arm is in a protective stop; protective_stop, 3 s ago\\nways back:\\n  celld recover --release    the vacuum goes off where the arm is: hold lid by hand; then `--hold` unlocks the stop\\n  not now: --place          no vacuum holds anything'))")
                check("and what a way back does", "Auswege" in shown and "„Loslassen (von Hand halten)“" in shown and "lid von Hand halten" in shown and "kein Vakuum hält etwas" in shown and "dann entriegelt „" in shown and "jetzt nicht" in shown, shown)
                mixed = window.page.evaluate("() => import('/text.js').then((text) => text.here('the cell is armed: `celld disarm` or `celld abort` first; job 3.2 is under way; look at the plan, then `celld approve a` or `celld reject a`; done after 6.1 s'))")
                check("buttons, names and numbers in German sentences", mixed == "die Zelle ist scharf: zuerst „Entschärfen“ oder „Sofort anhalten“; Auftrag 3.2 läuft; den Plan ansehen, dann: „Freigeben“ oder „Ablehnen“; erledigt nach 6,1 s", mixed)
                check("whatever a job is called", job == "Auftrag tidy-7 läuft; Auftrag none ist nicht der laufende", job)
                check("German is spoken", "Befehle" in window.page.evaluate("() => fetch('/text-de.json').then((a) => a.text())") and window.page.locator("nav").inner_text().startswith("Jetzt"))
            window.context.close()


def main():
    PICTURES.mkdir(parents=True, exist_ok=True)
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        cell = Running(pathlib.Path(folder), CELLD)
        try:
            browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=BROWSER)
            stranger = Page(browser, cell)
            stranger.page.goto(f"http://{ADDRESS}:8737/")
            expect(stranger.page.locator("main")).to_contain_text("celld open")
            check("who is not signed in is told how", True)
            stranger.context.close()
            window = Page(browser, cell, viewport={"width": 1400, "height": 1000}, locale="en-GB")
            window.sign_in()
            figures(playwright, cell)
            window.picture("live-first")
            a_click_on_a_busy_page_is_a_click(window)
            set_a_goal(window, cell)
            carry_out(window)
            play_back(window)
            watch_the_film(window)
            stop_with_an_object(window, cell)
            check("no console error in all of it", not window.errors, str(window.errors))
            lost_daemon(window, cell)
            all_sizes(browser, cell)
            cell.end()
            with tempfile.TemporaryDirectory() as other:
                cell = Running(pathlib.Path(other), CELLD, factor=5)
                calibrate(browser, cell)
            browser.close()
        except BaseException:
            for name in ["run", "sim"]:
                log = pathlib.Path(folder) / f"{name}.log"
                print(f"--- {name}.log\n{log.read_text()[-3000:]}" if log.exists() else "", file=sys.stderr)
            raise
        finally:
            cell.end()
    print(f"page: all checks held, {time.monotonic() - begun:.0f} s; pictures in {PICTURES}", flush=True)


main()
