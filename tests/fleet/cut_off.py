"""A cell that is cut off from its fleet for long, with the real daemon, simulator and server.

In: a celld binary built with the fleet, the program of a NATS server, how many minutes it is cut off. Out: that
it finishes the job of the fleet that it had begun, does the jobs of its own folder meanwhile, and that its events
arrive afterwards complete and in their order; its memory in each tenth of that time, as a figure.
"""

import collections
import json
import pathlib
import re
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "page"))

from loop_cost import nats
from running import Running

MINUTES = float(sys.argv[3]) if len(sys.argv) > 3 else 60.0
SWAP = "version: 1\nid: {id}\nrerun: true\ngoal: {{swap: [plank-1, plank-2]}}\n"
# Swaps alone would walk off the table in time: each adds the errors of its places to what it found.
BACK = "version: 1\nid: {id}\nrerun: true\ngoal: {{restore: local-1}}\n"
FLEET = "cut-off"


def until(what, holds, seconds=240):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if held := holds():
            return held
        time.sleep(0.2)
    raise SystemExit(f"FAILED: {what}")


class CutOff:
    cell = None

    def __init__(self, folder):
        (folder / "cell").mkdir()
        self.folder = folder
        self.server, self.address = nats(sys.argv[2], folder)

    def up(self):
        self.cell = Running(self.folder / "cell", sys.argv[1])
        self.cell.celld.terminate()
        self.cell.celld.wait()
        config = self.cell.folder / "config/cell.yaml"
        text = re.sub(r"\bapproval: \w+", "approval: never", config.read_text())
        config.write_text(text + f"\nfleet: {{name: {FLEET}, cell: cell-1, servers: ['{self.address}']}}\n")
        self.cell.daemon()

    def run_celld(self, *arguments):
        return subprocess.run([self.cell.binary, *arguments], cwd=self.cell.folder, capture_output=True, text=True)

    def celld(self, *arguments):
        done = self.run_celld(*arguments)
        assert done.returncode == 0, (arguments, done.stdout, done.stderr)
        return done.stdout

    def fleet(self, *arguments):
        return self.celld("fleet", *arguments, "--server", self.address, "--fleet", FLEET, "--user", "anna")

    def status(self):
        return json.loads((self.cell.folder / "state/status.json").read_text())

    def result(self, job):
        found = list((self.cell.folder / "state/jobs").glob(f"*/*/{job}/result.yaml"))
        return found and found[0].read_text()

    def memory_mb(self):
        lines = pathlib.Path(f"/proc/{self.cell.celld.pid}/status").read_text().splitlines()
        return next(int(line.split()[1]) / 1000 for line in lines if line.startswith("VmRSS"))

    def file(self, job, text):
        file = self.cell.folder / f"{job}.yaml"
        file.write_text(text.format(id=job))
        return str(file)

    def was_stopped(self, ended):
        """A cell whose robot is not read in time stops, rightly, and a person takes it up again."""
        if "status: done" in ended:
            return False
        assert "code: \"link_silent\"" in ended, ended
        print(ended, flush=True)
        if self.status()["holding"]:
            # Not before the arm is known to stand.
            until("a way back is taken", lambda: self.run_celld("recover", "--place", "--state", "state").returncode == 0)
            until("what is held is put down", lambda: not self.status()["holding"] and self.status()["state"] == "idle")
        until("the cell is armed again", lambda: self.run_celld("arm", "--state", "state").returncode == 0)
        return True

    def run(self):
        self.up()
        self.celld("arm", "--state", "state")
        job = self.fleet("submit", self.file("from-the-fleet", SWAP)).split()[0]
        until("the fleet's job moves something", lambda: self.status()["job"] == job and self.status()["holding"])
        self.server.kill()
        self.server.wait()
        print(f"cut off with {job} under way, for {MINUTES:.0f} min", flush=True)
        begun, number, stopped, memory = time.monotonic(), 0, 0, []
        until("it finishes what it began", lambda: self.result(job))
        assert "status: done" in self.result(job), self.result(job)
        while time.monotonic() - begun < 60 * MINUTES:
            number += 1
            self.celld("submit", self.file(f"local-{number}", SWAP if number % 2 else BACK), "--state", "state")
            ended = until("a job of its own folder ends", lambda: self.result(f"local-{number}"))
            stopped += self.was_stopped(ended)
            memory.append(self.memory_mb())
        self.again(job, number)
        assert number > 2 * stopped, f"{stopped} of {number} jobs were stopped"
        print(f"figure: {number - stopped} jobs of its own done while cut off, {stopped} stopped by the load of this computer")
        # A process that was just started still grows: it is the later tenths that have to be alike.
        tenths = [memory[len(memory) * k // 10 : len(memory) * (k + 1) // 10] for k in range(10)]
        print("figure: MB at most in each tenth of that time: " + ", ".join(f"{max(tenth):.1f}" for tenth in tenths if tenth))

    def again(self, job, locally):
        """The server is back, on the same port: all that happened arrives."""
        config = self.folder / "nats.conf"
        port = self.address.rsplit(":", 1)[1]
        config.write_text(config.read_text().replace(":-1", f":{port}"))
        self.server = subprocess.Popen([sys.argv[2], "-c", config], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        back = time.monotonic()

        def events():
            done = subprocess.run([self.cell.binary, "fleet", "export", "events", "--format", "jsonl", "--server", self.address, "--fleet", FLEET],
                                  cwd=self.cell.folder, capture_output=True, text=True)
            return [json.loads(line) for line in done.stdout.splitlines()]

        ends = lambda: collections.Counter(event["job"] for event in events() if event["kind"] == "done")
        wanted = {job} | {f"local-{number + 1}" for number in range(locally)}
        until("an event for the end of each job", lambda: wanted <= set(ends()))
        assert all(count == 1 for count in ends().values()), ends()
        numbers = [event["number"] for event in events()]
        assert numbers == list(range(1, len(numbers) + 1)), numbers
        assert not [event for event in events() if event["kind"] == "gap"]
        until("the fleet knows the job's end", lambda: "ended" in self.fleet("why", job) or "done" in self.fleet("why", job))
        print(f"figure: {len(numbers)} events arrived in their order, complete {time.monotonic() - back:.1f} s after the server was back")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as text:
        cut_off = CutOff(pathlib.Path(text))
        try:
            cut_off.run()
        finally:
            if cut_off.cell:
                cut_off.cell.end()
            cut_off.server.kill()
            cut_off.server.wait()
