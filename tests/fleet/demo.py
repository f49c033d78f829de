"""The fleet's demo as a person uses it: cells, page, report, files, shared configuration, the end.

In: the program celld with the feature fleet, a NATS server's program, a folder, and where the page is to be
looked at in a browser, the Python that drives one. Out: exit code 0, or the first thing that is not as it
should be. All parts are real: server, daemons, simulators, sockets. Nothing waits for a time: each condition
has a long bound.
"""

import json
import pathlib
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request

CELLD, NATS, OUT = sys.argv[1], sys.argv[2], pathlib.Path(sys.argv[3])
BROWSER = sys.argv[4] if len(sys.argv) > 4 else None
PATIENCE_S = 300
CELLS = 2
# Addresses that no other suite uses.
FIRST = "127.0.43.1"


def until(what, holds):
    """Waits until something holds and returns it."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        found = holds()
        if found:
            return found
        if demo.poll() is not None:
            raise SystemExit(f"{what}: the demo has ended with {demo.returncode}")
        time.sleep(0.2)
    raise SystemExit(f"{what}: not within {PATIENCE_S} s")


def view():
    """What the page shows."""
    base, key = link.split("/#key=")
    request = urllib.request.Request(base + "/api/v1/fleet", headers={"authorization": "Bearer " + key})
    try:
        return json.load(urllib.request.urlopen(request, timeout=10))
    except urllib.error.HTTPError as error:
        assert error.code == 503, error
        return {"cells": [], "jobs": []}


def celld(*arguments, code=0):
    """A command of celld; what it prints."""
    done = subprocess.run([CELLD, *arguments], capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == code, (arguments, done.returncode, done.stdout, done.stderr)
    return done.stdout


def fleet(*arguments, code=0):
    """A command of the fleet, by the name anna."""
    return celld("fleet", *arguments, "--server", server, "--fleet", "demo", "--user", "anna", code=code)


def cell(name):
    """The state of a cell as the page shows it; empty where it shows none."""
    return next((cell["state"] for cell in view()["cells"] if cell["name"] == name), {})


def state(name):
    """The state folder of a cell."""
    return str(OUT / name / "state")


arguments = ["fleet", "demo", "--cells", str(CELLS), "--jobs", "1", "--keep", "--out", str(OUT)]
arguments += ["--nats-server", NATS, "--bind", FIRST, "--listen", "127.0.0.1:0"]
OUT.parent.mkdir(parents=True, exist_ok=True)
said = OUT.with_suffix(".log")
demo = subprocess.Popen([CELLD, *arguments], stdout=subprocess.PIPE, stderr=said.open("w"), text=True)
try:
    link = demo.stdout.readline().strip()
    assert "/#key=" in link, (link, said.read_text())
    port = until("the server's port", lambda: next(iter((OUT / "ports").glob("*")), None))
    server = json.loads(port.read_text())["nats"][0]

    # The page, without its key and with it.
    try:
        urllib.request.urlopen(link.split("/#")[0] + "/api/v1/fleet", timeout=10)
        raise SystemExit("the fleet is shown without a key")
    except urllib.error.HTTPError as error:
        assert error.code == 401, error
    until("the cells on the page", lambda: len(view()["cells"]) == CELLS)
    until("a job on the page", lambda: [job for job in view()["jobs"] if job["cell"]])

    # The report comes when all jobs are over; each was done, and the arm has moved for it.
    until("the report", lambda: (OUT / "result.json").exists() and (OUT / "report.html").exists())
    jobs = json.loads((OUT / "result.json").read_text())["jobs"]
    assert len(jobs) == CELLS + 1 and all(job["outcome"]["status"] == "done" for job in jobs), jobs
    assert sum(job["outcome"]["moves"] for job in jobs) >= 2, jobs
    assert "all jobs done" in (OUT / "report.html").read_text()
    assert all(cell["counts"]["done"] >= 1 and cell["drift_mm"] for cell in view()["cells"]), view()["cells"]

    # The page in a browser.
    if BROWSER:
        names = ",".join(sorted(cell["name"] for cell in view()["cells"]))
        looked = [BROWSER, "-B", "tests/page/fleet.py", link, names, str(OUT.with_name("pictures"))]
        assert subprocess.run(looked, timeout=PATIENCE_S).returncode == 0, looked
    else:
        print("SKIPPED: the page in a browser, no Python with playwright was named")

    # Files of a job, from the cell that did it.
    job = next(job for job in jobs if job["outcome"]["moves"] > 0)
    paths = fleet("fetch", job["id"], "--what", "plan,pictures,report,result,recording", "--out", str(OUT / "got"))
    names = [pathlib.Path(path) for path in paths.split()]
    assert {"plan.svg", "plan.jpg", "report.html", "result.json"} <= {path.name for path in names}, paths
    assert any(path.suffix == ".mcap" for path in names), paths
    assert json.loads((OUT / "got" / job["id"] / "result.json").read_text())["id"] == job["id"]
    recording = next(path for path in names if path.suffix == ".mcap")
    recorded = next((OUT / job["cell"]).rglob(recording.name))
    assert recording.read_bytes()[:8] == b"\x89MCAP0\r\n" and recorded.stat().st_size >= recording.stat().st_size
    fleet("fetch", "no-such-job", code=1)

    # A job of a cell's own folder has its end among the events, once, as those of the fleet have.
    own = OUT / "own.yaml"
    own.write_text("version: 1\nid: own\ngoal: {look: true}\n")
    celld("submit", str(own), "--state", state("cell-2"))
    # So has one that is cancelled before its time.
    later = OUT / "later.yaml"
    later.write_text("version: 1\nid: later\nnot_before: 2099-01-01T00:00:00Z\ngoal: {look: true}\n")
    celld("submit", str(later), "--state", state("cell-2"))
    celld("cancel", "later", "--state", state("cell-2"))

    def ends():
        events = [json.loads(line) for line in fleet("export", "events", "--format", "jsonl").splitlines()]
        return [event["job"] for event in events if event["kind"] == "done"]

    ended = until("their ends among the events", lambda: {"own", "later"} <= set(found := ends()) and found)
    assert sorted(ended) == sorted([job["id"] for job in jobs] + ["own", "later"]), ended

    # A shared configuration: an armed cell waits, a disarmed one takes it and stays disarmed.
    shared = OUT / "shared.yaml"
    shared.write_text("version: 1\nlimits: {tool_speed_m_s: 1}\n")
    fleet("config", "publish", str(shared), "--to", "any", code=2)
    shared.write_text("version: 1\nplanner: {solver: auto, objective: ti, time_limit_s: 3, seed: 0}\n")
    number = int(fleet("config", "publish", str(shared), "--to", "cell=cell-1", "--check", "config/cell.yaml"))
    until("an armed cell waits", lambda: cell("cell-1").get("fragment_waits") == number)
    celld("disarm", "--state", state("cell-1"))
    until("a disarmed cell takes it", lambda: cell("cell-1").get("fragment") == number)
    ready = until("and is there", lambda: (c := cell("cell-1")).get("state") == "idle" and c)
    assert not ready["armed"] and cell("cell-2")["armed"], ready
    assert f"fragment {number}" in fleet("config", "show")
    status = json.loads(celld("status", "--state", state("cell-1"), "--format", "json"))
    assert f"fragment {number} of cell=cell-1 by anna" in status["status"]["shared"], status
    fleet("config", "withdraw", "--to", "cell=cell-1")
    until("and goes back", lambda: (c := cell("cell-1")).get("state") == "idle" and "fragment" not in c)

    # Everything that was started ends with it.
    demo.send_signal(signal.SIGINT)
    demo.wait(60)
    assert demo.returncode == 130, demo.returncode
    left = subprocess.run(["pgrep", "-af", str(OUT)], capture_output=True, text=True).stdout
    left = [line for line in left.splitlines() if "demo.py" not in line and "pgrep" not in line]
    assert not left, left
finally:
    if demo.poll() is None:
        demo.send_signal(signal.SIGINT)
        demo.wait(60)
    print(said.read_text())
print("the fleet's demo: all as it should be")
