"""What recording costs the daemon: two simulated cells side by side, one records and one does not.

In: the program celld, how many jobs each does. Out: processor time of both daemons as a share of one core,
printed; nothing is judged. Both cells are those of config/, and do the same jobs at the same time; no
pictures are recorded.
"""

import json
import pathlib
import subprocess
import sys
import tempfile
import time

CELLD, JOBS = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 6
ROOT = pathlib.Path(__file__).parent.parent
TICKS_S = 100
HALVES = [[0.02, 0.24], [0.26, 0.48]]


def cell_files(folder, address, recording):
    """The files of config/ for a cell on an address of its own."""
    cell = (ROOT / "config/cell.yaml").read_text()
    lines = []
    for line in cell.replace("host: 127.0.0.2", f"host: {address}").splitlines():
        if line.startswith("recording:"):
            line = recording
        elif line.startswith("page:"):
            line = ""
        elif line.startswith("approval:"):
            line = "approval: never"
        elif line.startswith("arm_at_start:"):
            line = "arm_at_start: true"
        lines.append(line.replace("../calibration", str(ROOT / "calibration")))
    (folder / "cell.yaml").write_text("\n".join(lines) + "\n")
    sim = (ROOT / "config/sim.yaml").read_text()
    (folder / "sim.yaml").write_text(sim.replace("bind: 127.0.0.2", f"bind: {address}"))


def processor_s(process):
    """Processor time that a process has used."""
    fields = pathlib.Path(f"/proc/{process.pid}/stat").read_text().rsplit(") ", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_S


def is_idle(status):
    """Whether a daemon has started and has nothing to do."""
    try:
        return json.loads(status.read_text())["state"] == "idle"
    except (OSError, ValueError):
        return False


with tempfile.TemporaryDirectory() as place:
    cells, started = {}, []
    try:
        for name, address, recording in [
            ("records", "127.0.45.1", "recording: {folder: recordings, pictures: false, decisions: true}"),
            ("does not", "127.0.45.2", ""),
        ]:
            folder = pathlib.Path(place) / name.replace(" ", "-")
            folder.mkdir()
            cell_files(folder, address, recording)
            quiet = {"stdout": subprocess.DEVNULL, "stderr": (folder / "log").open("w")}
            started.append(subprocess.Popen([CELLD, "sim", "--config", folder / "sim.yaml"], **quiet))
            run = [CELLD, "run", "--config", folder / "cell.yaml", "--state", folder / "state"]
            daemon = subprocess.Popen(run, **quiet)
            started.append(daemon)
            cells[name] = (folder, daemon)
        for folder, _ in cells.values():
            while not is_idle(folder / "state/status.json"):
                time.sleep(0.2)
        before = {name: processor_s(daemon) for name, (_, daemon) in cells.items()}
        begun = time.monotonic()
        for number in range(JOBS):
            left, right = HALVES[number % 2]
            polygon = [[left, 0.02], [right, 0.02], [right, 0.48], [left, 0.48]]
            goal = {"region": {"objects": ["plank-1", "plank-2", "block", "lid"], "polygon": polygon}}
            text = json.dumps({"version": 1, "id": f"job-{number}", "goal": goal})
            waits = []
            for folder, _ in cells.values():
                (folder / "job.yaml").write_text(text)
                submit = [CELLD, "submit", folder / "job.yaml", "--state", folder / "state", "--wait"]
                waits.append(subprocess.Popen(submit, stdout=subprocess.DEVNULL))
            assert all(wait.wait() == 0 for wait in waits), f"job {number} was not done by both"
        seconds = time.monotonic() - begun
        shares = {}
        for name, (folder, daemon) in cells.items():
            shares[name] = 100 * (processor_s(daemon) - before[name]) / seconds
            print(f"{name:>9}: {shares[name]:5.2f} % of a core over {seconds:.0f} s")
        size = sum(file.stat().st_size for file in (cells["records"][0] / "recordings").glob("*.mcap"))
        cost = shares["records"] - shares["does not"]
        print(f"recording costs {cost:.2f} % of a core; {size / 1e6:.1f} MB")
    finally:
        for process in reversed(started):
            process.terminate()
        for process in started:
            process.wait(30)
