"""Shapes of what the control server answers, for type checkers and editors.

Lengths in m, angles in rad, times in simulated seconds since the controller's start, vacuum as a share of an
atmosphere.
"""

from __future__ import annotations

from typing import Any, Dict, List, Optional, TypedDict


class Thing(TypedDict):
    """An object on the table; `pose` is x, y, theta in the table's frame."""

    id: str
    state: str
    on: List[str]
    pose: List[float]
    z_m: float
    tilt_rad: float


class Channel(TypedDict):
    """A channel of the gripper; `holds` names an object."""

    mode: str
    target: float
    vacuum: float
    sealed: bool
    holds: Optional[str]


class Contact(TypedDict):
    """What the arm presses on."""

    moving: str
    against: str
    depth_m: float


Event = Dict[str, Any]
"""Something that happened: `time_s`, `event`, and what that kind of event has beside them."""


class Faults(TypedDict):
    """Faults in force and still to come."""

    active: List[str]
    waiting: int
    step: int
    phase: str
    time_s: float


class World(TypedDict):
    """The truth about the simulated cell."""

    time_s: float
    seed: int
    camera_on: bool
    objects: List[Thing]
    channels: List[Channel]
    contact: Optional[Contact]
    events: List[Event]
    faults: Faults


class Timing(TypedDict):
    """How late RTDE packages have left the simulator, us after they were due, and how many were skipped."""

    packages: int
    within_1_ms: float
    median_us: float
    p999_us: float
    worst_us: float
    sent: int
    skipped: int
    frames: int
