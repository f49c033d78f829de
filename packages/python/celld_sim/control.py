"""The simulator's control server and its dashboard, one request a connection.

In: address, request. Out: the answer, or a SimulatorError. No proxy of the environment is used: the address
is this computer's.
"""

from __future__ import annotations

import http.client
import json
import socket
from typing import Any, Optional, Tuple

from celld_sim.errors import SimulatorError

TIMEOUT_S = 10.0
"""Longest wait for an answer, s."""


def exchange(
    host: str,
    port: int,
    path: str,
    body: Optional[Any] = None,
    *,
    method: Optional[str] = None,
    timeout_s: float = TIMEOUT_S,
) -> Tuple[int, Any]:
    """Status and JSON of a request: a GET, or a POST where there is a body, unless `method` says otherwise."""
    connection = http.client.HTTPConnection(host, port, timeout=timeout_s)
    try:
        if body is None and method != "POST":
            connection.request(method or "GET", path)
        else:
            headers = {"Content-Type": "application/json"}
            connection.request(method or "POST", path, json.dumps(body, allow_nan=False), headers)
        answer = connection.getresponse()
        text = answer.read()
    except (OSError, http.client.HTTPException) as error:
        raise SimulatorError(f"the simulator at {host}:{port} did not answer {path}: {error!r}") from error
    finally:
        connection.close()
    try:
        return answer.status, json.loads(text)
    except ValueError:
        said = text[:200].decode(errors="replace").strip()
        raise SimulatorError(f"{path} at {host}:{port}: {answer.status} {answer.reason}: {said}") from None


def dashboard(host: str, port: int, command: str) -> str:
    """The dashboard's answer to one command, without its line end."""
    if "\n" in command or "\r" in command:
        raise ValueError(f"one command at a time, without a line end: {command!r}")
    try:
        with socket.create_connection((host, port), timeout=TIMEOUT_S) as link:
            stream = link.makefile("rb")
            stream.readline()  # Its greeting.
            link.sendall(command.encode() + b"\n")
            answer = stream.readline()
    except OSError as error:
        raise SimulatorError(f"the dashboard at {host}:{port} did not answer {command!r}: {error!r}") from error
    if not answer:
        raise SimulatorError(f"the dashboard at {host}:{port} closed after {command!r}")
    return answer.decode(errors="replace").rstrip("\r\n")
