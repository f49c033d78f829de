"""What a busy computer does to a simulated cell.

In: the program celld, the load to make beside it, how many rounds. Out: a line for each round and a table: how
many rounds ended with a stop or disarmed by celld for whatever reason, and how fast the simulated cells ran.
A round is `celld arm` and a job that looks at the table; then come demos. The exit code is 0 without a stop, 1
with one; with --expect-stops (for `celld sim --strict`, which waits for nobody) it is the other way round.
Everything that is started here ends with it.
"""

import argparse
import contextlib
import json
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
ADDRESS = "127.9.9.1"

# Longest waits, s of the wall's clock; the simulated cell may run at a small part of real time.
STARTS_WITHIN = 120
ROUND_WITHIN = 180
DEMO_WITHIN = 900

# Root may raise the priority of threads, which would hide what most users see.
ORDINARY = ["setpriv", "--inh-caps=-sys_nice", "--bounding-set=-sys_nice"] if os.geteuid() == 0 else []

JOB = """version: 1
id: {name}
goal: {{objects: [{{id: block, pose_deg: [0.15, 0.34, 10]}}]}}
"""


class Failed(Exception):
    pass


def configure(folder, factor):
    """The example cell at an address of its own."""
    (folder / "config").mkdir()
    shutil.copytree(ROOT / "calibration" / "sim", folder / "calibration" / "sim")
    changes = {
        "cell.yaml": [
            ("127.0.0.2", ADDRESS),
            ("\napproval: always", "\napproval: never"),
            ("\npage: {listen: 127.0.0.1:8737}", f"\npage: {{listen: '{ADDRESS}:8737'}}"),
            ("clock_factor: 1}", f"clock_factor: {factor}}}"),
        ],
        "sim.yaml": [("127.0.0.2", ADDRESS), ("\ntime_factor: 1\n", f"\ntime_factor: {factor}\n")],
    }
    for name, pairs in changes.items():
        text = (ROOT / "config" / name).read_text()
        for old, new in pairs:
            if old not in text:
                raise Failed(f"config/{name} has no {old!r} any more")
            text = text.replace(old, new)
        (folder / "config" / name).write_text(text)


@contextlib.contextmanager
def running(command, **options):
    process = subprocess.Popen([str(part) for part in command], **options)
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(30)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


class Cell:
    def __init__(self, celld, folder):
        self.celld, self.folder = celld, folder

    def call(self, *words, within=60):
        done = subprocess.run(
            [str(self.celld), *words], cwd=self.folder, capture_output=True, text=True, timeout=within
        )
        return done.returncode, (done.stdout + done.stderr).strip()

    def status(self):
        _, text = self.call("status", "--format", "json")
        return json.loads(text)["status"]

    def until(self, what, is_so, within):
        end = time.monotonic() + within
        while time.monotonic() < end:
            with contextlib.suppress(ValueError, KeyError, TypeError, subprocess.TimeoutExpired):
                status = self.status()
                if is_so(status):
                    return status
            time.sleep(0.2)
        raise Failed(f"{what}: not within {within} s")

    def round(self, number):
        """Arms, looks, disarms; what went wrong, if anything did."""
        code, answer = self.call("arm")
        if code != 0:
            return f"arm: {answer}"
        (self.folder / "job.yaml").write_text(JOB.format(name=f"look-{number}"))
        code, answer = self.call("submit", "job.yaml", "--wait", within=ROUND_WITHIN)
        if code != 0:
            return f"job: {answer}"
        status = self.status()
        factors.append(status.get("time_factor"))
        if not status["armed"]:
            return f"disarmed: {status['message']} ({status['stopped']})"
        self.call("disarm")
        return None


# Factors reached, as the status gave them.
factors = []


@contextlib.contextmanager
def load(tasks, folder):
    """So many tasks that always want a processor: a compiler that begins again and again, and stress-ng."""
    if tasks == 0:
        yield
        return
    source = ROOT / "crates" / "urscript" / "src" / "lib.rs"
    compile_it = f"rustc --edition 2024 --crate-type lib -O --out-dir {folder} {source}"
    compiler = ["sh", "-c", f"while :; do {compile_it} >/dev/null 2>&1 || sleep 1; done"]
    others = ["stress-ng", "--quiet", "--cpu", str(max(tasks - 2, 1)), "--vm", "1", "--vm-bytes", "64M"]
    with running(others), running(compiler, start_new_session=True) as shell:
        try:
            yield
        finally:
            os.killpg(shell.pid, 15)


def runnable():
    """Tasks of this computer that run or want to."""
    return int(pathlib.Path("/proc/loadavg").read_text().split()[3].split("/")[0]) - 1


def rounds(args, folder):
    """What went wrong in each round, and the mean load."""
    configure(folder, args.factor)
    sim = [*ORDINARY, args.celld, "sim", "--config", "config/sim.yaml"] + ["--strict"] * args.strict
    run = [*ORDINARY, args.celld, "run", "--config", "config/cell.yaml"]
    found, loads = [], []
    with (
        open(folder / "celld.log", "w") as log,
        running(sim, cwd=folder, stdout=subprocess.DEVNULL),
        running(run, cwd=folder, stderr=log),
    ):
        cell = Cell(args.celld, folder)
        cell.until("celld starts", lambda status: status["state"] == "idle", STARTS_WITHIN)
        with load(args.load, folder):
            for number in range(1, args.arms + 1):
                loads.append(runnable())
                began = time.monotonic()
                try:
                    wrong = cell.round(number)
                except subprocess.TimeoutExpired as late:
                    wrong = f"no answer within {late.timeout} s"
                found.append(wrong)
                print(f"  arm {number}: {wrong or 'done'} ({time.monotonic() - began:.1f} s)", flush=True)
                if wrong:
                    cell.call("abort")
                    cell.call("recover", "--hold")
                    cell.until("at rest", lambda status: not status["moving"], ROUND_WITHIN)
    return found, sum(loads) / max(len(loads), 1)


def demos(args, folder):
    found = []
    with load(args.load, folder):
        for number in range(1, args.demos + 1):
            began = time.monotonic()
            out = f"demo-{number}"
            command = [*ORDINARY, str(args.celld), "demo", "--seed", str(number), "--out", out]
            try:
                done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=DEMO_WITHIN)
                said = (done.stdout + done.stderr).strip().splitlines()
                wrong = None if done.returncode == 0 else " / ".join(said[-3:])
            except subprocess.TimeoutExpired as late:
                wrong = f"not over within {late.timeout} s"
            found.append(wrong)
            with contextlib.suppress(OSError, ValueError, KeyError):
                result = json.loads((folder / out / "result.json").read_text())
                print(f"  demo {number}: time factor reached {result['time_factor_reached']:.2f}")
            print(f"  demo {number}: {wrong or 'done'} ({time.monotonic() - began:.1f} s)", flush=True)
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--celld", type=pathlib.Path, required=True)
    parser.add_argument("--arms", type=int, default=20)
    parser.add_argument("--demos", type=int, default=2)
    parser.add_argument("--load", type=int, default=24, help="tasks beside the cell; 0: none")
    parser.add_argument("--factor", type=int, default=1, help="of the rounds; demos have their own")
    parser.add_argument("--strict", action="store_true", help="with a simulator that waits for nobody")
    parser.add_argument("--expect-stops", action="store_true")
    args = parser.parse_args()
    args.celld = args.celld.resolve()
    # What was started here is ended in any case.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        try:
            found, mean = rounds(args, folder) if args.arms else ([], 0.0)
            found_in_demos = demos(args, folder) if args.demos else []
        except Failed as failed:
            with contextlib.suppress(OSError):
                print((folder / "celld.log").read_text()[-2000:], file=sys.stderr)
            sys.exit(f"busy_computer: {failed}")
    reached = [factor for factor in factors if factor]
    stops, demo_stops = (sum(wrong is not None for wrong in all) for all in (found, found_in_demos))
    print(f"{'tasks that want a processor, mean':40} {mean:.0f}")
    print(f"{'arms with a look, ended by a stop':40} {len(found)}, {stops}")
    print(f"{'demos, ended by a stop':40} {len(found_in_demos)}, {demo_stops}")
    if reached:
        print(f"{'time factor reached, least and mean':40} {min(reached):.2f}, {sum(reached) / len(reached):.2f}")
    sys.exit(int(bool(stops + demo_stops) != args.expect_stops))


if __name__ == "__main__":
    main()
