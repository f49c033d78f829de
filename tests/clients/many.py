"""The client scripts of this folder over and over, several at a time, each against a simulator of its own.

In: the simulator's command, how many runs and how many at a time. Out: a line for each run that failed, with
all it said in a file, and the number of failures. A run of `recordings.py` or `realsense_record.py` needs files
of celld and is not among them. Run it with the Python that has the clients (`make test-clients-many`).
"""

import argparse
import json
import os
import pathlib
import select
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor

HERE = pathlib.Path(__file__).parent
SCRIPTS = ["ur_rtde_moves.py", "ur_rtde_calls.py", "ur_rtde_rest.py", "ur_python_rtde.py", "vgc10_pymodbus.py"]
READY = 60.0
"""Longest wait for a simulator that starts, s."""
LONGEST = 300.0
"""Longest run of a script, s; it gives up itself before that (harness.py)."""


def arguments():
    """What the command line says."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--parallel", type=int, default=20)
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("target/client-runs"))
    parser.add_argument("--scripts", nargs="+", default=SCRIPTS, choices=SCRIPTS)
    parser.add_argument("simulator", nargs="+", help="for example `target/release/celld sim`; after `--`")
    return parser.parse_args()


def ready(simulator):
    """The first line of a simulator, when it comes in time."""
    arrived, _, _ = select.select([simulator.stdout], [], [], READY)
    return json.loads(simulator.stdout.readline()) if arrived else {}


def run(options, index):
    """One run; what went wrong and what was said, or nothing."""
    script = options.scripts[index % len(options.scripts)]
    # Clients insist on the port numbers of the controller: each run has an address.
    address = f"127.72.{index // 250}.{index % 250 + 1}"
    command = [*options.simulator, "--control", "--bind", address]
    with (
        tempfile.TemporaryFile() as log,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log) as simulator,
    ):
        try:
            if ready(simulator).get("ready") is not True:
                return f"{script} at {address}: the simulator does not start", b""
            client = subprocess.run(
                [sys.executable, "-B", HERE / script, address],
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                timeout=LONGEST,
                check=False,
            )
            if simulator.poll() is not None:
                log.seek(0)
                return f"{script} at {address}: the simulator has ended", client.stdout + log.read()
        except subprocess.TimeoutExpired as late:
            return f"{script} at {address}: not done after {LONGEST:.0f} s", late.stdout or b""
        except ValueError as error:
            return f"{script} at {address}: the simulator's first line: {error}", b""
        finally:
            simulator.kill()
    # The closing line too: a script that ends early must not pass for one that found nothing.
    if client.returncode != 0 or not client.stdout.rstrip().endswith(b" checks, 0 failed"):
        return f"{script} at {address}: failed", client.stdout
    return None


def main():
    """Runs them all."""
    options = arguments()
    options.out.mkdir(parents=True, exist_ok=True)
    began, failed = time.monotonic(), 0
    with ThreadPoolExecutor(options.parallel) as pool:
        for index, failure in enumerate(pool.map(lambda index: run(options, index), range(options.runs))):
            if failure is not None:
                failed += 1
                (options.out / f"{index}.txt").write_bytes(failure[1])
                print(f"FAILED  run {index}: {failure[0]} ({options.out / f'{index}.txt'})", flush=True)
            if (index + 1) % 50 == 0:
                print(f"{index + 1} of {options.runs} runs, {failed} failed", flush=True)
    took = time.monotonic() - began
    load = os.getloadavg()[0]
    how = f"{options.parallel} at a time, in {took:.0f} s, load {load:.1f}"
    print(f"{options.runs} runs ({how}): {failed} failed")
    sys.exit(failed != 0)


main()
