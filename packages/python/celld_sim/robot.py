"""One simulated robot: what it is, where it listens, what is done to it.

In: options, as those of `celld-sim`. Out: a robot that is there within the `with` block. Every robot has an
address of its own, so that any number of them can run beside each other on the controller's own port
numbers.
"""

from __future__ import annotations

import os
import sys
import time
from types import TracebackType
from typing import Any, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple, Type, Union, cast

from celld_sim import control
from celld_sim.addresses import Gripper, Ports, loopback_addresses, port_offsets, ports_of
from celld_sim.errors import FaultRefused, SimulatorError
from celld_sim.process import AddressTaken, Process
from celld_sim.program import program as find_program
from celld_sim.world import Timing, World

MODELS = ("UR3e", "UR5e", "UR10e", "UR16e", "UR20", "UR30", "UR3", "UR5", "UR10")
"""Arms that can be simulated."""

TRIES = 20
"""How many addresses are tried when none is given."""

POWER_ON_S = 30.0
"""Longest wait for power and brakes, s."""

AnyPath = Union[str, "os.PathLike[str]"]


class Robot:
    """A UR controller with an arm, a VGC10 gripper, a table with objects and a camera.

    model: which arm, one of MODELS. software: version that the controller has, as "5.13.0". host: an
    address of this computer; without it one that is free (Linux), or 127.0.0.1 with ports that are free.
    port_offset: added to every port number, at 127.0.0.1 unless `host` says where. time_factor: simulated seconds per second; 1 is real time.
    running: whether power is on and the brakes are open when `start` returns; a controller that was just
    switched on has both off. config: a file as config/sim.yaml of the project. faults: what goes wrong and
    when, as a file of the project's docs/faults.md. program: the simulator, instead of the one in this
    package.
    """

    def __init__(
        self,
        model: Optional[str] = None,
        *,
        software: Optional[str] = None,
        host: Optional[str] = None,
        port_offset: Optional[int] = None,
        time_factor: Optional[float] = None,
        running: bool = False,
        config: Optional[AnyPath] = None,
        faults: Optional[AnyPath] = None,
        program: Optional[AnyPath] = None,
        start_timeout: float = 30.0,
    ) -> None:
        self.model = model
        self.software = software
        self.time_factor = time_factor
        self._running = running
        self._place = (host, port_offset)
        self._files = (config, faults)
        self._program = program
        self._start_timeout = start_timeout
        self._process: Optional[Process] = None
        self._where: Optional[Tuple[str, Ports]] = None
        self._last_log = ""

    def __repr__(self) -> str:
        where = "not running" if self._where is None else f"at {self._where[0]}"
        return f"<celld_sim.Robot {self.model or 'as configured'} {where}>"

    def __enter__(self) -> Robot:
        return self.start()

    def __exit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        self.stop()

    def start(self) -> Robot:
        """Starts the simulator; returns when all its servers listen.

        Raises SimulatorError with the simulator's own words.
        """
        if self._process is not None:
            raise SimulatorError("this robot runs already")
        taken: Optional[SimulatorError] = None
        for host, offset in self._places():
            try:
                process = Process(self._command(host, offset), self._start_timeout)
            except AddressTaken as error:
                taken = error
                continue
            self._process = process
            break
        else:
            raise taken or SimulatorError("no address was tried")
        try:
            self._where = _where(process.ready)
            if self._running:
                self.power_on()
        except BaseException:
            self.stop()
            raise
        return self

    def stop(self) -> None:
        """Ends the simulator. A robot that does not run stays as it is."""
        process, self._process, self._where = self._process, None, None
        if process is not None:
            self._last_log = process.stop()

    @property
    def host(self) -> str:
        """Address of all servers."""
        return self._at()[0]

    @property
    def ports(self) -> Ports:
        """Their port numbers."""
        return self._at()[1]

    @property
    def gripper(self) -> Gripper:
        """Modbus address of the gripper."""
        host, ports = self._at()
        return Gripper(host, ports.gripper)

    @property
    def camera_url(self) -> str:
        """Where the camera's pictures are: /frame.png, /depth.png and /intrinsics.json below it."""
        host, ports = self._at()
        return f"http://{host}:{ports.camera}"

    @property
    def pid(self) -> int:
        """Number of the simulator's process."""
        self._at()
        assert self._process is not None
        return self._process.pid

    @property
    def log(self) -> str:
        """What the simulator has written to standard error: of this run, or of the last one."""
        return self._last_log if self._process is None else self._process.log()

    def dashboard(self, command: str) -> str:
        """The dashboard's answer to one command, as "robotmode". PolyScope X has none: see `robot_api`."""
        host, ports = self._at()
        if ports.dashboard is None:
            raise SimulatorError("PolyScope X has no dashboard server; robot_api(...) takes its place")
        return control.dashboard(host, ports.dashboard, command)

    def robot_api(self, method: str, path: str, body: Optional[Any] = None) -> Any:
        """The answer of PolyScope X's Robot API: `robot_api("PUT", "/program/v1/state", {"action": "play"})`.

        Raises SimulatorError with the controller's words for any status but 200.
        """
        host, ports = self._at()
        if ports.robot_api is None:
            raise SimulatorError("there is no Robot API: choose software 10.12.0 or another of PolyScope X")
        place = (host, ports.robot_api, f"/universal-robots/robot-api{path}")
        status, answer = control.exchange(*place, body, method=method, timeout_s=POWER_ON_S)
        if status != 200:
            raise SimulatorError(f"{method} {path}: {status}: {answer}")
        return answer

    def power_on(self) -> None:
        """Switches the arm's power on and opens its brakes; returns when the robot mode is RUNNING."""
        if self.ports.robot_api is not None:
            for action in ("POWER_ON", "BRAKE_RELEASE"):
                self.robot_api("PUT", "/robotstate/v1/state", {"action": action})
            return
        deadline = time.monotonic() + POWER_ON_S
        for command, mode in (("power on", "IDLE"), ("brake release", "RUNNING")):
            if "RUNNING" in self.dashboard("robotmode"):
                return
            said = self.dashboard(command)
            while mode not in (now := self.dashboard("robotmode")):
                if time.monotonic() > deadline:
                    raise SimulatorError(f"no {mode} after {command!r}: answer {said!r}, now {now!r}")
                time.sleep(0.005)

    def world(self) -> World:
        """The truth about arm, objects, gripper and faults."""
        return cast(World, self._get("/world.json"))

    def timing(self) -> Timing:
        """How late packages have left the simulator."""
        return cast(Timing, self._get("/timing.json"))

    def fault(self, name: str, *, at: Optional[Mapping[str, Any]] = None, **args: Any) -> None:
        """Breaks something: `robot.fault("ur.estop", seconds=3)`, at once or when `at` says.

        Names, arguments and triggers are those of the project's docs/faults.md. Raises FaultRefused with the
        simulator's reason.
        """
        fault: Dict[str, Any] = {"do": name}
        if args:
            fault["args"] = args
        if at is not None:
            fault["at"] = dict(at)
        self._post(fault)

    def faults(self, plan: Sequence[Mapping[str, Any]]) -> None:
        """Hands over a whole plan of faults, each `{"at": ..., "do": ..., "args": ...}`; all of them or
        none."""
        self._post({"faults": [dict(fault) for fault in plan]})

    def clear(self, name: Optional[str] = None) -> None:
        """Ends the faults that last, or those of one name."""
        if name is None:
            self.fault("clear")
        else:
            self.fault("clear", fault=name)

    def requested(self) -> Optional[Dict[str, str]]:
        """What a program waits for (`request_integer_from_primary_client`): `{"type": ..., "text": ...}`; None if
        nothing."""
        request: Optional[Dict[str, str]] = self._get("/request")["request"]
        return request

    def answer(self, value: Any) -> None:
        """Types the value that a program waits for at the pendant. Raises FaultRefused when none does, or one of
        another type."""
        self._post(value, "/request")

    def _at(self) -> Tuple[str, Ports]:
        if self._where is None or self._process is None:
            raise SimulatorError("the robot does not run: use it within `with celld_sim.Robot() as robot:`")
        if not self._process.running():
            raise SimulatorError(f"the simulator has ended: {self._process.log().strip() or 'without a word'}")
        return self._where

    def _get(self, path: str) -> Any:
        host, ports = self._at()
        status, answer = control.exchange(host, ports.control, path)
        if status != 200:
            raise SimulatorError(f"{path}: {status}: {answer}")
        return answer

    def _post(self, order: Any, path: str = "/fault") -> None:
        host, ports = self._at()
        status, answer = control.exchange(host, ports.control, path, order, method="POST")
        if status != 200:
            raise FaultRefused(str(answer.get("error", answer) if isinstance(answer, dict) else answer))

    def _places(self) -> Iterator[Tuple[str, int]]:
        """Address and offset to try, the first that is free being taken."""
        host, offset = self._place
        if host is not None or offset is not None:
            yield host or "127.0.0.1", offset or 0
        elif sys.platform.startswith("linux"):
            for _, address in zip(range(TRIES), loopback_addresses()):
                yield address, 0
        else:
            for _, free in zip(range(TRIES), port_offsets()):
                yield "127.0.0.1", free

    def _command(self, host: str, offset: int) -> List[str]:
        command = [find_program() if self._program is None else _absolute(self._program)]
        command += ["--control", "--until-eof", "--bind", host, "--port-offset", str(offset)]
        config, faults = self._files
        options = {
            "--model": self.model,
            "--software": self.software,
            "--time-factor": self.time_factor,
            "--config": None if config is None else _absolute(config),
            "--faults": None if faults is None else _absolute(faults),
        }
        for name, value in options.items():
            if value is not None:
                command += [name, str(value)]
        return command


def _absolute(path: AnyPath) -> str:
    return os.path.abspath(os.fspath(path))


def _where(ready: Mapping[str, Any]) -> Tuple[str, Ports]:
    try:
        return str(ready["bind"]), ports_of(ready)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise SimulatorError(f"the ready line of another version of celld-sim: {ready}") from error
