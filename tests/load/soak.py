"""A daemon and its simulated cell at work for hours: does anything grow, is any job lost?

In: the program celld, hours of cell time, how much faster than real time. Out: a line for each sample and, in
the folder of --out, `samples.csv` and `soak.svg`: memory, handles and threads of both processes, the
journal's size for each job, how long an order takes to its answer. Jobs come back to back; every tenth one
has a fault and a recovery, page viewers never read their streams, and celld is restarted twice. The report
names each figure that grows by more than 1 % an hour of cell time after the first hour of a celld run, jobs
that were lost (no result in time), and jobs that did not end as `done` although no fault was injected beside
them. The exit code is 1 in each of these cases. It is 1 as well if celld, the simulator or a recovery fails:
the soak ends there and reports the samples so far.
"""

import argparse
import contextlib
import csv
import http.client
import itertools
import json
import math
import pathlib
import re
import signal
import statistics
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

# The time of an answer is noisy: it includes the start of a process on a busy computer. The least-squares
# slope of such samples exceeds the limit by chance in about every second run, as does one of hourly medians:
# a run has only a few of them. So its growth is the median slope between any two medians of a quarter of an
# hour (Theil and Sen). It is judged by its lower bound at 99 % confidence (Kendall's statistic). In a
# run of four hours it finds a growth of 20 % an hour only if the answers vary little; a longer run finds less
# growth too. Other load that begins late counts as growth.
ANSWER = "answer ms"
MEDIAN_OVER_H = 0.25
CONFIDENCE_Z = 2.33

# So many jobs are named in the report.
NAMED = 10

# What a failing cell or computer raises here.
FAILURES = (busy_computer.Failed, subprocess.TimeoutExpired, OSError)

GAUGES = ["memory", "handles", "threads"]
COLUMNS = (
    ["hours", "run", "jobs"]
    + [f"{process} {gauge}" for process in ("celld", "sim") for gauge in GAUGES]
    + ["journal KiB a job", ANSWER]
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
        self.samples, self.lost, self.failed, self.ends = [], [], [], {}
        self.run, self.jobs, self.faults = 0, 0, 0
        self.processes = {}
        self.began, self.reached = time.monotonic(), 0.0

    def ask_simulator(self, path, order=None):
        """The answer of its control server; with an order, that is posted."""
        data = None if order is None else json.dumps(order).encode()
        try:
            with urllib.request.urlopen(f"{CONTROL}/{path}", data, timeout=10) as answer:
                return answer.read()
        except (OSError, http.client.HTTPException) as error:
            why = getattr(error, "reason", error)
            raise busy_computer.Failed(f"the request /{path} to the simulator failed: {why}") from error

    def hours(self):
        """Cell time since the simulator's start."""
        return json.loads(self.ask_simulator("world.json"))["time_s"] / 3600

    def inject_fault(self):
        order = FAULTS[self.faults % len(FAULTS)]
        self.faults += 1
        self.ask_simulator("fault", order)

    def status(self):
        try:
            return self.cell.status()
        except (ValueError, KeyError) as error:
            raise busy_computer.Failed(f"`celld status` printed no status: {error}") from error

    def ended_process(self):
        """A sentence about the process that should run and has ended; None if both run."""
        for name, process in self.processes.items():
            if (code := process.poll()) is not None:
                return f"{name} ended with exit code {code}"
        return None

    def check_processes(self):
        # `celld status` goes on printing the last status of a celld that has ended.
        if ended := self.ended_process():
            raise busy_computer.Failed(ended)

    def cause(self, failure):
        """Why the soak failed, in one sentence."""
        if ended := self.ended_process():
            return ended
        if isinstance(failure, subprocess.TimeoutExpired):
            return f"`celld {' '.join(failure.cmd[1:])}` did not end within {failure.timeout} s"
        return str(failure)

    def back_to_work(self):
        """Recovers like an operator: reads the status, chooses a recovery option, arms the cell."""
        end = time.monotonic() + BACK_WITHIN
        said = ""
        while time.monotonic() < end:
            status = self.status()
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
        fault_due, had_fault = self.jobs % FAULT_EVERY == 0, False
        while not (ended := self.result(name)):
            self.check_processes()
            if time.monotonic() > end:
                self.lost.append(name)
                return
            status = self.status()
            if fault_due and not had_fault and status["moving"]:
                had_fault = True
                self.inject_fault()
            if not status["armed"] and status["job"]:
                self.back_to_work()
            time.sleep(0.1)
        status, code = ended
        self.ends[code] = self.ends.get(code, 0) + 1
        # A fault may end its job. Without one every job can be done: block and places are the same.
        if status != "done" and not had_fault:
            self.failed.append(f"{name} ({code})")
        if not self.status()["armed"]:
            self.back_to_work()

    def result(self, name):
        """Status and code with which a job ended; None until then."""
        for result in (self.folder / "state" / "jobs").glob(f"*/*/{name}/result.yaml"):
            text = result.read_text()
            found = [re.search(rf'^{key}: *"?([^\s"]+)', text, re.MULTILINE) for key in ("status", "code")]
            if all(found):
                return tuple(one.group(1) for one in found)
        return None

    def sample(self):
        began = time.monotonic()
        # A stop that changes nothing but the pause, and its end.
        self.cell.call("pause", within=ANSWER_WITHIN)
        answered = (time.monotonic() - began) * 1e3
        self.cell.call("resume", within=ANSWER_WITHIN)
        journal = sum(path.stat().st_size for path in (self.folder / "state").glob("history.sqlite*"))
        row = [self.hours(), self.run, self.jobs]
        self.check_processes()
        for process in ("celld", "sim"):
            row += gauges(self.processes[process].pid)
        row += [journal / 1024 / max(self.jobs, 1), answered]
        self.samples.append(row)
        self.reached = row[0] * 3600 / (time.monotonic() - self.began)
        print("  " + ", ".join(f"{name} {value:.4g}" for name, value in zip(COLUMNS, row)), flush=True)

    def work(self, until_h):
        """Jobs back to back until so many hours of cell time."""
        with contextlib.ExitStack() as stack:
            stop_latency.viewers(VIEWERS, ADDRESS, self.cell, stack)
            next_at = 0
            while self.hours() < until_h:
                self.job()
                if time.monotonic() >= next_at:
                    next_at = time.monotonic() + self.args.every
                    self.sample()

    def start(self, log):
        run = [self.args.celld, "run", "--config", "config/cell.yaml"]
        return busy_computer.running(run, cwd=self.folder, stderr=log)


def settled(samples):
    """The samples of each celld run after its first hour."""
    for run in sorted({row[1] for row in samples}):
        rows = [row for row in samples if row[1] == run]
        yield [row for row in rows if row[0] >= rows[0][0] + SETTLED_H]


def growth(samples, column):
    """The steepest growth in an hour of cell time as a share of the level, over runs long enough to say."""
    steepest = None
    for rows in settled(samples):
        if len(rows) < 3:
            continue
        hours, values = [row[0] for row in rows], [row[column] for row in rows]
        mean_h, mean = sum(hours) / len(hours), sum(values) / len(values)
        spread = sum((hour - mean_h) ** 2 for hour in hours)
        slope = sum((h - mean_h) * (v - mean) for h, v in zip(hours, values)) / max(spread, 1e-9)
        share = slope / max(abs(mean), 1e-9)
        steepest = share if steepest is None else max(steepest, share)
    return steepest


def noisy_growth(samples, column):
    """Growth of a noisy figure: its lower bound and its median, of the run with the highest bound; None if
    no run is long enough."""
    steepest = None
    for rows in settled(samples):
        spans = itertools.groupby(rows, lambda row: int((row[0] - rows[0][0]) / MEDIAN_OVER_H))
        spans = [list(span) for _, span in spans]
        points = [[statistics.median(row[at] for row in span) for at in (0, column)] for span in spans]
        slopes = sorted((v2 - v1) / (h2 - h1) for (h1, v1), (h2, v2) in itertools.combinations(points, 2))
        count = len(points)
        deviation = math.sqrt(count * (count - 1) * (2 * count + 5) / 18)
        below = (len(slopes) - CONFIDENCE_Z * deviation) / 2
        if not slopes or below < 0:
            continue
        level = max(statistics.median(value for _, value in points), 1e-9)
        bound = (slopes[int(below)] / level, statistics.median(slopes) / level)
        steepest = bound if steepest is None else max(steepest, bound)
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


def soak(run):
    args, folder = run.args, run.folder
    busy_computer.configure(folder, args.factor)
    sim_command = [args.celld, "sim", "--config", "config/sim.yaml", "--control"]
    with (
        open(run.out / "celld.log", "w") as log,
        busy_computer.running(sim_command, cwd=folder, stdout=subprocess.DEVNULL) as sim,
    ):
        # The first run is the shortest: a restart early, one in the middle of the rest.
        for number, share in enumerate([0.1, 0.5, 1.0]):
            run.run = number
            with run.start(log) as daemon:
                run.processes = {"sim": sim, "celld": daemon}
                try:
                    run.cell.until(
                        "celld starts", lambda status: status["state"] == "idle", busy_computer.STARTS_WITHIN
                    )
                    run.back_to_work()
                    run.work(args.hours * share)
                except FAILURES as failure:
                    # Before both processes are ended here.
                    raise busy_computer.Failed(run.cause(failure)) from failure


def report_growth(samples):
    """Prints how much each figure grows; the names of those that grow too much."""
    grown, unjudged = [], []
    for column, name in list(enumerate(COLUMNS))[3:]:
        if name == ANSWER:
            least, share = noisy_growth(samples, column) or (None, None)
        else:
            least = share = growth(samples, column)
        if share is None:
            unjudged.append(name)
            continue
        sure = f" (at least {100 * least:+.2f} %, with 99 % confidence)" if name == ANSWER else ""
        print(f"{name + ', growth an hour':36} {100 * share:+.2f} %{sure}")
        if least > GROWTH:
            grown.append(name)
    print(f"{'grows':36} {', '.join(grown) or 'nothing that was judged'}")
    if unjudged:
        print(f"{'not judged, no celld run long enough':36} {', '.join(unjudged)}")
    return grown


def listed(jobs):
    """Their number and the names of the first."""
    more = ", ..." if len(jobs) > NAMED else ""
    return f"{len(jobs)}" + (f": {', '.join(jobs[:NAMED])}{more}" if jobs else "")


def report(run):
    """Writes the samples and their picture, prints the figures; whether anything is wrong with them."""
    with open(run.out / "samples.csv", "w", newline="") as file:
        csv.writer(file).writerows([COLUMNS, *run.samples])
    print(f"{'time factor reached':36} {run.reached:.2f}")
    print(f"{'jobs, faults':36} {run.jobs}, {run.faults}")
    print(f"{'lost (no result)':36} {listed(run.lost)}")
    print(f"{'failed without a fault':36} {listed(run.failed)}")
    print(f"{'ends':36} {', '.join(f'{code} {count}' for code, count in sorted(run.ends.items()))}")
    grown = report_growth(run.samples)
    drawn = run.out / "soak.svg"
    # Without samples: not that of an earlier soak.
    drawn.unlink(missing_ok=True)
    if run.samples:
        drawn.write_text(picture(run.samples))
        print(f"{'picture':36} {drawn}")
    return bool(grown or run.lost or run.failed)


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
        run, failure = Soak(args, pathlib.Path(name), out), None
        try:
            soak(run)
        except FAILURES as error:
            failure = " ".join(str(error).split())
        finally:
            # Also of a soak that failed or was interrupted.
            wrong = report(run)
    if failure:
        sys.exit(f"soak: {failure}; celld's log is {out / 'celld.log'}")
    sys.exit(int(wrong))


if __name__ == "__main__":
    main()
