"""A daemon and its simulated cell at work for hours: does anything grow, is any job lost?

In: the program celld, hours of cell time, how much faster than real time. Out: a line for each sample and, in
the folder of --out, `samples.csv` and `soak.svg`: memory, handles and threads of both processes, the
journal's size for each job, how long an order takes to its answer. Jobs come back to back; every tenth one
has a fault and a recovery, page viewers never read their streams, and celld is restarted twice. The report
names each figure that grows by more than 1 % an hour of cell time after the first hour of a celld run.
The exit code is 1 then, or where a job has no result.
"""

import argparse
import contextlib
import csv
import json
import pathlib
import re
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request

import busy_computer
import stop_latency

ADDRESS = busy_computer.ADDRESS
CONTROL = f"http://{ADDRESS}:8091"

# The block goes to and fro between two free places of the example's table.
PLACES = ["0.15, 0.34, 10", "0.24, 0.25, 40"]
JOB = """version: 1
id: {name}
goal: {{objects: [{{id: block, pose_deg: [{place}]}}]}}
"""

FAULTS = [
    {"do": "ur.pstop"},
    {"do": "net.timeout", "args": {"link": "rtde", "seconds": 2}},
    {"do": "net.timeout", "args": {"link": "gripper", "seconds": 2}},
    {"do": "ur.kill_program"},
    {"do": "ur.estop", "args": {"seconds": 3}},
]
FAULT_EVERY = 10

# Longest waits, s of the wall's clock.
JOB_WITHIN = 600
BACK_WITHIN = 240
ANSWER_WITHIN = 30

VIEWERS = 5

# Growth is judged after the first hour of a celld run; the limit is a share of the mean, an hour.
SETTLED_H = 1.0
GROWTH = 0.01

GAUGES = ["memory", "handles", "threads"]
COLUMNS = (
    ["hours", "run", "jobs"]
    + [f"{process} {gauge}" for process in ("celld", "sim") for gauge in GAUGES]
    + ["journal KiB a job", "answer ms"]
)


def gauges(pid):
    """Resident memory in MiB, open handles, threads."""
    status = dict(
        line.split(":", 1) for line in pathlib.Path(f"/proc/{pid}/status").read_text().splitlines() if ":" in line
    )
    handles = sum(1 for _ in pathlib.Path(f"/proc/{pid}/fd").iterdir())
    return [int(status["VmRSS"].split()[0]) / 1024, handles, int(status["Threads"])]


class Soak:
    def __init__(self, args, folder, out):
        self.args, self.folder, self.out = args, folder, out
        self.cell = busy_computer.Cell(args.celld, folder)
        self.samples, self.lost, self.ends = [], [], {}
        self.run, self.jobs, self.faults = 0, 0, 0

    def hours(self):
        """Cell time since the simulator's start."""
        with urllib.request.urlopen(f"{CONTROL}/world.json", timeout=10) as answer:
            return json.load(answer)["time_s"] / 3600

    def fault(self):
        order = FAULTS[self.faults % len(FAULTS)]
        self.faults += 1
        request = urllib.request.Request(f"{CONTROL}/fault", data=json.dumps(order).encode())
        urllib.request.urlopen(request, timeout=10).close()

    def back_to_work(self):
        """Recovers like an operator: reads the status, chooses a recovery option, arms the cell."""
        end = time.monotonic() + BACK_WITHIN
        said = ""
        while time.monotonic() < end:
            status = self.cell.status()
            if status["armed"] and not status["stopped"]:
                return
            if status["stopped"] or status["holding"]:
                way = "--place" if status["holding"] else "--hold"
                said = self.cell.call("recover", way, within=BACK_WITHIN)[1]
                self.cell.until("at rest", lambda status: not status["moving"], BACK_WITHIN)
            code, answer = self.cell.call("arm", within=BACK_WITHIN)
            if code == 0:
                return
            said = f"{said}; {answer}"
            time.sleep(1)
        raise busy_computer.Failed(f"no way back to work: {said}")

    def job(self):
        """One job to its end, whatever happens to it."""
        self.jobs += 1
        name = f"soak-{self.jobs:05}"
        place = PLACES[self.jobs % len(PLACES)]
        (self.folder / "job.yaml").write_text(JOB.format(name=name, place=place))
        code, answer = self.cell.call("submit", "job.yaml")
        if code != 0:
            raise busy_computer.Failed(f"submit: {answer}")
        end = time.monotonic() + JOB_WITHIN
        struck = self.jobs % FAULT_EVERY != 0
        while not (code := self.code(name)):
            if time.monotonic() > end:
                self.lost.append(name)
                return
            status = self.cell.status()
            if not struck and status["moving"]:
                struck = True
                self.fault()
            if not status["armed"] and status["job"]:
                self.back_to_work()
            time.sleep(0.1)
        self.ends[code] = self.ends.get(code, 0) + 1
        if not self.cell.status()["armed"]:
            self.back_to_work()

    def code(self, name):
        """The word with which a job ended; None until then."""
        for result in (self.folder / "state" / "jobs").glob(f"*/*/{name}/result.yaml"):
            if found := re.search(r"^code: *(\S+)", result.read_text(), re.MULTILINE):
                return found.group(1)
        return None

    def sample(self, daemon, sim):
        began = time.monotonic()
        # A stop that changes nothing but the pause, and its end.
        self.cell.call("pause", within=ANSWER_WITHIN)
        answered = (time.monotonic() - began) * 1e3
        self.cell.call("resume", within=ANSWER_WITHIN)
        journal = sum(path.stat().st_size for path in (self.folder / "state").glob("history.sqlite*"))
        row = [self.hours(), self.run, self.jobs, *gauges(daemon.pid), *gauges(sim.pid)]
        row += [journal / 1024 / max(self.jobs, 1), answered]
        self.samples.append(row)
        print("  " + ", ".join(f"{name} {value:.4g}" for name, value in zip(COLUMNS, row)), flush=True)

    def work(self, until_h, daemon, sim):
        """Jobs back to back until so many hours of cell time."""
        with contextlib.ExitStack() as stack:
            stop_latency.viewers(VIEWERS, ADDRESS, self.cell, stack)
            next_at = 0
            while self.hours() < until_h:
                self.job()
                if time.monotonic() >= next_at:
                    next_at = time.monotonic() + self.args.every
                    self.sample(daemon, sim)

    def start(self, log):
        run = [self.args.celld, "run", "--config", "config/cell.yaml"]
        return busy_computer.running(run, cwd=self.folder, stderr=log)


def growth(samples, column):
    """The steepest growth in an hour of cell time as a share of the level, over runs long enough to say."""
    steepest = None
    for run in sorted({row[1] for row in samples}):
        rows = [row for row in samples if row[1] == run]
        rows = [row for row in rows if row[0] >= rows[0][0] + SETTLED_H]
        if len(rows) < 3:
            continue
        hours, values = [row[0] for row in rows], [row[column] for row in rows]
        mean_h, mean = sum(hours) / len(hours), sum(values) / len(values)
        spread = sum((hour - mean_h) ** 2 for hour in hours)
        slope = sum((h - mean_h) * (v - mean) for h, v in zip(hours, values)) / max(spread, 1e-9)
        share = slope / max(abs(mean), 1e-9)
        steepest = share if steepest is None else max(steepest, share)
    return steepest


def picture(samples):
    """A panel for each column, its line broken where celld was restarted."""
    width, height, left = 760, 90, 150
    names = COLUMNS[3:]
    most_h = max(row[0] for row in samples) or 1
    parts = []
    for place, name in enumerate(names):
        column, top = COLUMNS.index(name), place * height
        values = [row[column] for row in samples]
        high = max(values) or 1
        for run in sorted({row[1] for row in samples}):
            points = " ".join(
                f"{left + row[0] / most_h * (width - left - 20):.1f},{top + height - 20 - row[column] / high * (height - 35):.1f}"
                for row in samples
                if row[1] == run
            )
            parts.append(f'<polyline points="{points}" fill="none" stroke="#1f5fa8" stroke-width="1.5"/>')
        base = top + height - 20
        parts.append(f'<line x1="{left}" y1="{base}" x2="{width - 20}" y2="{base}" stroke="#999"/>')
        parts.append(f'<text x="8" y="{top + 30}">{name}</text>')
        parts.append(f'<text x="8" y="{top + 46}" fill="#666">0 to {high:.4g}</text>')
    bottom = len(names) * height + 10
    parts.append(f'<text x="{left}" y="{bottom}" fill="#666">0 to {most_h:.2f} h of cell time</text>')
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{bottom + 20}" '
        f'font-family="sans-serif" font-size="12">\n<rect width="100%" height="100%" fill="#fff"/>\n{body}\n</svg>\n'
    )


def soak(args, folder, out):
    busy_computer.configure(folder, args.factor)
    run = Soak(args, folder, out)
    sim_command = [args.celld, "sim", "--config", "config/sim.yaml", "--control"]
    began = time.monotonic()
    with (
        open(out / "celld.log", "w") as log,
        busy_computer.running(sim_command, cwd=folder, stdout=subprocess.DEVNULL) as sim,
    ):
        # The first run is the shortest: a restart early, one in the middle of the rest.
        for number, share in enumerate([0.1, 0.5, 1.0]):
            run.run = number
            with run.start(log) as daemon:
                run.cell.until("celld starts", lambda status: status["state"] == "idle", busy_computer.STARTS_WITHIN)
                run.back_to_work()
                run.work(args.hours * share, daemon, sim)
        reached = run.hours() * 3600 / (time.monotonic() - began)
    return run, reached


def report(run, reached, out):
    with open(out / "samples.csv", "w", newline="") as file:
        csv.writer(file).writerows([COLUMNS, *run.samples])
    (out / "soak.svg").write_text(picture(run.samples))
    print(f"{'time factor reached':36} {reached:.2f}")
    print(f"{'jobs, lost, faults':36} {run.jobs}, {len(run.lost)}, {run.faults}")
    print(f"{'ends':36} {', '.join(f'{code} {count}' for code, count in sorted(run.ends.items()))}")
    grown, judged = [], False
    for column, name in enumerate(COLUMNS):
        share = growth(run.samples, column) if column >= 3 else None
        if share is None:
            continue
        judged = True
        print(f"{name + ', growth an hour':36} {100 * share:+.2f} %")
        # An answer's time is no store that fills.
        if share > GROWTH and name != "answer ms":
            grown.append(name)
    verdict = ", ".join(grown) or ("nothing" if judged else "not judged: no celld run was long enough")
    print(f"{'grows':36} {verdict}")
    print(f"{'picture':36} {out / 'soak.svg'}")
    return bool(grown or run.lost)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--celld", type=pathlib.Path, required=True)
    parser.add_argument("--hours", type=float, default=8, help="of cell time")
    parser.add_argument("--factor", type=int, default=5, help="how much faster than real time")
    parser.add_argument("--every", type=float, default=30, help="s of the wall's clock between two samples")
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("out/soak"))
    args = parser.parse_args()
    args.celld, out = args.celld.resolve(), args.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    with tempfile.TemporaryDirectory() as name:
        try:
            run, reached = soak(args, pathlib.Path(name), out)
        except busy_computer.Failed as failed:
            sys.exit(f"soak: {failed}; celld's log is {out / 'celld.log'}")
    sys.exit(int(report(run, reached, out)))


if __name__ == "__main__":
    main()
