"""Where the servers of a simulated cell listen.

In: the line that the simulator prints when it is ready. Out: host and ports. The choice of an address is
here too: on Linux each of 127.0.0.1 to 127.255.255.254 has the controller's ports for itself.
"""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import Any, Iterator, Mapping, Optional

_RANDOM = random.SystemRandom()
"""Not the generator that tests seed: two test runs on one computer must not choose the same."""


@dataclass(frozen=True)
class Ports:
    """Port numbers of one robot; without an offset the controller's own.

    PolyScope X has `robot_api` (HTTP) in place of `dashboard`. `robotiq` is there with such a gripper,
    `tool_serial` with one on the tool's serial line.
    """

    dashboard: Optional[int]
    robot_api: Optional[int]
    robotiq: Optional[int]
    tool_serial: Optional[int]
    primary: int
    secondary: int
    realtime: int
    rtde: int
    interpreter: int
    gripper: int
    camera: int
    control: int
    controller_modbus: Optional[int]


@dataclass(frozen=True)
class Gripper:
    """Where the VGC10's Compute Box answers Modbus TCP, and as which unit."""

    host: str
    port: int
    unit: int = 65


def ports_of(ready: Mapping[str, Any]) -> Ports:
    """The ports that a ready line names. Raises KeyError, TypeError or ValueError for another line."""
    return Ports(
        dashboard=_if_any(ready["dashboard"]),
        robot_api=_if_any(ready["robot_api"]),
        robotiq=_if_any(ready["robotiq"]),
        tool_serial=_if_any(ready["tool_serial"]),
        primary=_port(ready["primary"]),
        secondary=_port(ready["secondary"]),
        realtime=_port(ready["realtime"]),
        rtde=_port(ready["rtde"]),
        interpreter=_port(ready["interpreter"]),
        gripper=_port(ready["modbus"]),
        camera=_port(ready["camera"]),
        control=_port(ready["control"]),
        controller_modbus=_if_any(ready["controller_modbus"]),
    )


def _if_any(address: Optional[str]) -> Optional[int]:
    return None if address is None else _port(address)


def _port(address: str) -> int:
    return int(address.rsplit(":", 1)[1])


def loopback_addresses() -> Iterator[str]:
    """Addresses of this computer in no order, without those near 127.0.0.1, which people use by hand."""
    while True:
        second, third, fourth = _RANDOM.randint(64, 254), _RANDOM.randint(0, 255), _RANDOM.randint(1, 254)
        yield f"127.{second}.{third}.{fourth}"


def port_offsets() -> Iterator[int]:
    """Offsets in no order under which the ports of two robots never meet: less than 25000 apart, by which the
    gripper's port would be the interpreter's of another."""
    while True:
        yield 100 * _RANDOM.randint(50, 290)
