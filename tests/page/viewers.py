"""What viewers cost: the loop's evenness with 20 of them, and the daemon's time with one who watches the film.

In: the celld binary, optionally how many rounds and seconds each. Out: figures on stdout, none of them judged:
for each round the 99th percentile of the loop's step without and with viewers, in turn, so that what the
machine does otherwise falls on both; their medians; and the processor time of the daemon, in percent of one
core, without a viewer, with one page, and with one page and the film.
"""

import http.client
import http.server
import itertools
import statistics
import sys
import tempfile
import threading
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from running import ADDRESS, Running, loop_p99, share

ROUNDS = int(sys.argv[2]) if len(sys.argv) > 2 else 5
SECONDS = float(sys.argv[3]) if len(sys.argv) > 3 else 35.0
VIEWERS = 20


class Camera(http.server.BaseHTTPRequestHandler):
    """The simulated camera's pictures again, without the time that drawing them takes: a camera of the field
    gives its pictures as fast as they are wanted."""

    pictures = []
    intrinsics = b""
    serial = ""
    numbers = itertools.count(1_000_000)
    protocol_version = "HTTP/1.1"

    @classmethod
    def take(cls, count):
        for _ in range(count):
            connection = http.client.HTTPConnection(ADDRESS, 8090, timeout=30)
            connection.request("GET", "/frame.png")
            answer = connection.getresponse()
            cls.serial = answer.getheader("X-Serial")
            cls.pictures.append(answer.read())
        connection.request("GET", "/intrinsics.json")
        cls.intrinsics = connection.getresponse().read()
        server = http.server.ThreadingHTTPServer((ADDRESS, 8099), cls)
        threading.Thread(target=server.serve_forever, daemon=True).start()

    def do_GET(self):
        number = next(self.numbers)
        body = self.intrinsics if self.path == "/intrinsics.json" else self.pictures[number % len(self.pictures)]
        self.send_response(200)
        for name, value in {"Content-Length": len(body), "X-Sequence": number, "X-Time": number / 10, "X-Serial": self.serial}.items():
            self.send_header(name, str(value))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


class Viewer:
    """Reads a stream of the page until it is closed."""

    def __init__(self, token, path):
        self.bytes = self.pictures = 0
        self.ended = False
        self.connection = http.client.HTTPConnection(ADDRESS, 8737, timeout=10)
        self.connection.request("GET", path, headers={"Authorization": f"Bearer {token}"})
        self.answer = self.connection.getresponse()
        assert self.answer.status == 200, self.answer.read()
        self.thread = threading.Thread(target=self.read, daemon=True)
        self.thread.start()

    def read(self):
        while not self.ended:
            try:
                part = self.answer.read1(1 << 16)
            except (OSError, ValueError, AttributeError):
                return
            if not part:
                return
            self.bytes += len(part)
            self.pictures += part.count(b"Content-Type: image/jpeg")

    def close(self):
        self.ended = True
        self.connection.close()


def main():
    with tempfile.TemporaryDirectory() as folder:
        cell = Running(Path(folder), sys.argv[1])
        try:
            Camera.take(8)
            cell.celld.terminate()
            cell.celld.wait()
            config = cell.folder / "config/cell.yaml"
            config.write_text(config.read_text().replace("port: 8090", "port: 8099"))
            cell.daemon()
            token = cell.open("--token", "--role", "view", "--name", "viewers")
            without, watched = [], []
            for number in range(ROUNDS):
                time.sleep(SECONDS)
                without.append(loop_p99(token))
                viewers = [Viewer(token, "/api/v1/events") for _ in range(VIEWERS)]
                time.sleep(SECONDS)
                watched.append(loop_p99(token))
                print(f"round {number + 1}: p99 of the loop's step {without[-1]:.3f} ms, with {VIEWERS} viewers "
                      f"{watched[-1]:.3f} ms, {sum(v.bytes for v in viewers) / 1e3 / SECONDS:.0f} kB/s", flush=True)
                for viewer in viewers:
                    viewer.close()
            medians = statistics.median(without), statistics.median(watched)
            print(f"figure: loop p99, median of {ROUNDS}: {medians[0]:.3f} ms without, {medians[1]:.3f} ms with "
                  f"{VIEWERS} viewers, {medians[1] - medians[0]:+.3f} ms")
            shares = {"none": [], "page": [], "film": []}
            for _ in range(ROUNDS):
                pid = cell.celld.pid
                shares["none"].append(share(pid, 10))
                page = Viewer(token, "/api/v1/events")
                shares["page"].append(share(pid, 10))
                film = Viewer(token, "/api/v1/film")
                begun = time.monotonic()
                shares["film"].append(share(pid, 10))
                rate = film.pictures / (time.monotonic() - begun)
                film.close()
                page.close()
                print(f"share of one core: {shares['none'][-1]:.1f} % without a viewer, {shares['page'][-1]:.1f} % with a page, "
                      f"{shares['film'][-1]:.1f} % with its film of {rate:.1f} pictures/s", flush=True)
            none, page, film = (statistics.median(values) for values in shares.values())
            print(f"figure: of one core, medians: {none:.1f} % without a viewer, {page - none:+.1f} % for a page, {film - none:+.1f} % with its film")
        finally:
            cell.end()


main()
