"""A simulated cell of a test's own: simulator and daemon as processes, in a folder, at addresses of their own.

In: a folder, the celld binary. Out: what runs, the way to break it, and its end.
"""

import http.client
import json
import os
import pathlib
import shutil
import signal
import subprocess
import time
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parents[2]
ADDRESS = "127.7.8.1"


class Running:
    """Simulator and daemon of this test's own; the cell's time runs `factor` times as fast."""

    def __init__(self, folder, celld, factor=1):
        self.folder = folder
        self.binary = os.path.abspath(celld)
        self.children = []
        shutil.copytree(ROOT / "calibration" / "sim", folder / "calibration" / "sim")
        (folder / "config").mkdir()
        cell = (ROOT / "config/cell.yaml").read_text()
        cell = cell.replace("127.0.0.2", ADDRESS).replace("clock_factor: 1}", f"clock_factor: {factor}}}")
        cell = cell.replace("listen: 127.0.0.1:8737", f"listen: '{ADDRESS}:8737'")
        (folder / "config/cell.yaml").write_text(cell)
        sim = (ROOT / "config/sim.yaml").read_text().replace("127.0.0.2", ADDRESS)
        (folder / "config/sim.yaml").write_text(sim.replace("\ntime_factor: 1\n", f"\ntime_factor: {factor}\n"))
        self.start("sim", "--config", "config/sim.yaml", "--control")
        self.wait("the simulator listens", lambda: urllib.request.urlopen(f"http://{ADDRESS}:8091/world.json", timeout=2))
        self.daemon()

    def start(self, *arguments):
        log = open(self.folder / f"{arguments[0]}.log", "a")
        child = subprocess.Popen([self.binary, *arguments], cwd=self.folder, stdout=log, stderr=log)
        self.children.append(child)
        return child

    def daemon(self):
        self.celld = self.start("run", "--config", "config/cell.yaml", "--state", "state")
        self.wait("celld signs people in", lambda: self.open("--print"))
        self.wait("celld takes orders", self.started)

    def started(self):
        status = json.loads((self.folder / "state/status.json").read_text())
        if status["state"] == "starting":
            raise OSError(status["message"])

    def open(self, *arguments):
        done = subprocess.run([self.binary, "open", "--state", "state", *arguments], cwd=self.folder, capture_output=True, text=True)
        if done.returncode:
            raise OSError(done.stderr)
        return done.stdout.strip()

    def wait(self, what, ready):
        until = time.monotonic() + 60
        while time.monotonic() < until:
            try:
                return ready()
            except OSError as error:
                last = error
                time.sleep(0.1)
        raise SystemExit(f"FAILED: {what}: {last}\n{(self.folder / 'run.log').read_text()[-2000:] if (self.folder / 'run.log').exists() else ''}")

    def fault(self, do, **arguments):
        body = json.dumps({"do": do, "args": arguments} if arguments else {"do": do}).encode()
        urllib.request.urlopen(f"http://{ADDRESS}:8091/fault", data=body, timeout=10).read()

    def end(self):
        for child in self.children:
            child.send_signal(signal.SIGKILL)
            child.wait()


def metrics(token):
    connection = http.client.HTTPConnection(ADDRESS, 8737, timeout=10)
    connection.request("GET", "/metrics", headers={"Authorization": f"Bearer {token}"})
    lines = connection.getresponse().read().decode().splitlines()
    connection.close()
    return dict(line.rsplit(" ", 1) for line in lines if not line.startswith("#"))


def loop_p99(token):
    """The 99th percentile of the daemon's loop step of the last while, ms."""
    return 1e3 * float(metrics(token)['celld_loop_step_seconds{quantile="0.99"}'])


def processor(pid):
    """Seconds of processor time that the process has used."""
    fields = pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def share(pid, seconds):
    used, begun = processor(pid), time.monotonic()
    time.sleep(seconds)
    return 100 * (processor(pid) - used) / (time.monotonic() - begun)
