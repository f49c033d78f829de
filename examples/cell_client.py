"""A small typed client of a cell's page, with nothing but Python's own library.

In: the address of the page and a token of `celld open --token --role operate`. Out: what the cell is and does
(docs/files.md, docs/openapi.json); orders with their answers; jobs.

    python3 examples/cell_client.py http://127.0.0.1:8737 TOKEN            # what the cell does, until Ctrl-C
    python3 examples/cell_client.py http://127.0.0.1:8737 TOKEN look.yaml  # submit a job and wait for its end
"""

from __future__ import annotations

import json
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Reply:
    """The answer to an order: what happens, or why not and what to do instead."""

    accepted: bool
    message: str


class Refused(Exception):
    """The page refused a request; the message says why."""

    def __init__(self, status: int, message: str) -> None:
        super().__init__(f"{message} (HTTP {status})")
        self.status = status


class Cell:
    """One cell by the address of its page."""

    def __init__(self, address: str, token: str, timeout_s: float = 30.0) -> None:
        self.address = address.rstrip("/")
        self.token = token
        self.timeout_s = timeout_s

    def _open(self, path: str, body: dict[str, Any] | None = None, timeout_s: float | None = None) -> Any:
        data = None if body is None else json.dumps(body).encode()
        headers = {"authorization": f"Bearer {self.token}"} | ({} if body is None else {"content-type": "application/json"})
        request = urllib.request.Request(f"{self.address}{path}", data=data, headers=headers)
        try:
            return urllib.request.urlopen(request, timeout=timeout_s or self.timeout_s)
        except urllib.error.HTTPError as error:
            text = error.read().decode(errors="replace")
            try:
                text = json.loads(text)["error"]
            except (ValueError, KeyError, TypeError):
                pass
            raise Refused(error.code, text) from None

    def get(self, path: str) -> Any:
        """Any address of the interface as JSON."""
        with self._open(path) as answer:
            return json.load(answer)

    def status(self) -> dict[str, Any]:
        """What the cell does: the keys of status.json."""
        return self.get("/api/v1/status")

    def order(self, do: str, **arguments: Any) -> Reply:
        """An order: arm, disarm, pause, resume, step, abort, park, cancel (id=), recover (how=), release."""
        with self._open("/api/v1/orders", {"command": {"do": do} | arguments}) as answer:
            return Reply(**json.load(answer))

    def approve(self, job: str) -> Reply:
        """Agrees to the plan that the status shows for a job."""
        plan = self.status().get("plan") or {}
        body = {"command": {"do": "approve", "id": job, "plan": plan.get("number")}}
        with self._open("/api/v1/orders", body) as answer:
            return Reply(**json.load(answer))

    def submit(self, text: str, name: str = "client") -> str:
        """Hands in a job as in a job file; its id. Raises `Refused` with every complaint."""
        with self._open("/api/v1/jobs", {"text": text, "name": name}) as answer:
            return json.load(answer)["id"]

    def job(self, job: str) -> dict[str, Any]:
        """A job with its story, plan, steps and result."""
        return self.get(f"/api/v1/jobs/{job}")

    def wait(self, job: str, timeout_s: float = 600.0) -> dict[str, Any]:
        """Waits for the end of a job. Raises `TimeoutError`."""
        until = time.monotonic() + timeout_s
        while time.monotonic() < until:
            record = self.job(job)
            if record["state"] not in ("waiting", "active"):
                return record
            time.sleep(0.2)
        raise TimeoutError(f"job {job} has not ended within {timeout_s:.0f} s")

    def events(self) -> Iterator[tuple[str, Any]]:
        """Kind and data of everything that happens, until the connection ends."""
        with self._open("/api/v1/events", timeout_s=5.0) as stream:
            kind = ""
            for raw in stream:
                line = raw.decode().rstrip("\n")
                if line.startswith("event: "):
                    kind = line[7:]
                elif line.startswith("data: "):
                    yield kind, json.loads(line[6:])


def main() -> int:
    if len(sys.argv) not in (3, 4):
        print(__doc__, file=sys.stderr)
        return 2
    cell = Cell(sys.argv[1], sys.argv[2])
    if len(sys.argv) == 4:
        with open(sys.argv[3], encoding="utf-8") as file:
            record = cell.wait(cell.submit(file.read()))
        print(f"{record['id']}: {record['state']}, {record['message']}")
        return 0 if record["state"] == "done" else 1
    last = None
    for kind, data in cell.events():
        if kind == "status" and data["message"] != last:
            last = data["message"]
            print(time.strftime("%H:%M:%S"), last, flush=True)
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except Refused as refused:
        sys.exit(f"refused: {refused}")
    except KeyboardInterrupt:
        pass
