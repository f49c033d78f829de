"""What being part of a fleet costs the cell: the evenness of the loop, and the daemon's time.

In: a celld binary built with the fleet, the program of a NATS server, optionally how many rounds and seconds
each. Out: figures on stdout, none of them judged: for each round the 99th percentile of the loop's step and the
share of a core, without `fleet:` and with it, in turn, so that what the machine does otherwise falls on both;
their medians.
"""

import json
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "page"))

from running import Running, loop_p99, share


def nats(program, folder):
    """A NATS server with JetStream on a port of its own; the process and its address."""
    config = folder / "nats.conf"
    config.write_text(f'listen: "127.0.0.1:-1"\nports_file_dir: "{folder}"\njetstream {{store_dir: "{folder}/store", max_file_store: 10GB}}\n')
    child = subprocess.Popen([program, "-c", config], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    until = time.monotonic() + 30
    while time.monotonic() < until:
        found = [json.loads(text) for text in (file.read_text() for file in folder.glob("*.ports")) if text]
        if found:
            return child, found[0]["nats"][0]
        time.sleep(0.1)
    raise SystemExit("FAILED: the NATS server does not say its port")


def in_fleet(cell, address):
    """That the server has a state of the cell."""
    done = subprocess.run([cell.binary, "fleet", "status", "--server", address, "--fleet", "cost"], capture_output=True, text=True)
    assert "cell-1" in done.stdout, (done.stdout, done.stderr, (cell.folder / "run.log").read_text()[-2000:])


def take(cell, address, rounds, seconds):
    """Loop and processor without the fleet and with it, in turn: figures of each round by name."""
    config = cell.folder / "config/cell.yaml"
    alone = config.read_text()
    part = f"\nfleet: {{name: cost, cell: cell-1, servers: ['{address}']}}\n"
    figures = {"alone": ([], []), "in a fleet": ([], [])}
    for number in range(rounds):
        for name, text in (("alone", alone), ("in a fleet", alone + part)):
            cell.celld.terminate()
            cell.celld.wait()
            config.write_text(text)
            cell.daemon()
            token = cell.open("--token", "--role", "view", "--name", "cost")
            figures[name][1].append(share(cell.celld.pid, seconds))
            figures[name][0].append(loop_p99(token))
        in_fleet(cell, address)
        print(f"round {number + 1}: p99 of the loop's step " + ", ".join(f"{ms[-1]:.3f} ms {name}" for name, (ms, _) in figures.items()), flush=True)
    return figures


def main():
    rounds = int(sys.argv[3]) if len(sys.argv) > 3 else 5
    seconds = float(sys.argv[4]) if len(sys.argv) > 4 else 35.0
    with tempfile.TemporaryDirectory() as text:
        folder = pathlib.Path(text)
        (folder / "cell").mkdir()
        server, address = nats(sys.argv[2], folder)
        cell = None
        try:
            cell = Running(folder / "cell", sys.argv[1])
            figures = take(cell, address, rounds, seconds)
        finally:
            if cell:
                cell.end()
            server.kill()
            server.wait()
    (alone_ms, alone), (fleet_ms, fleet) = ([statistics.median(values) for values in pair] for pair in figures.values())
    print(f"figure: loop p99, median of {rounds}: {alone_ms:.3f} ms alone, {fleet_ms:.3f} ms in a fleet, {fleet_ms - alone_ms:+.3f} ms; "
          f"of one core {alone:.1f} and {fleet:.1f} %")


if __name__ == "__main__":
    main()
