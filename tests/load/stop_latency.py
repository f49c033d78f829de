"""How soon a stop is on the wire while everything else wants celld's attention.

In: the program celld, how many stops, how much beside them. Out: a table of the time from the rename of an
order's file into the folder of commands to the package with which celld passes it on: a stop to the robot, a
`release` (of a cell at rest) to the gripper, which gets one request at a time, so from the answer to the one
under way. An `arm` is given when nothing but it is missing; its package is celld's program, or the first move
if the program runs already. The table also says when celld has the file of an `arm` and when it is answered.
The robot is a simulated one that waits for nobody, behind a relay that notes when each package left celld.
Beside it: clients at nice 10 that give orders as fast as they are answered, a script that fills the folder
with orders, viewers of the page, a log that nobody reads. The exit code is 1 if a stop was refused, or an
order not answered. A stop that was answered with nothing on the wire is counted apart: whether the arm stood
then is not checked. All stops come while the arm sets out.

At the end celld gets SIGTERM, under the same load, while the arm sets out once more. The table has the time
from the signal to the stop on the wire (the goal is 20 ms) and to the end of celld, which waits at most 6 s
for arm and gripper and 15 s for the disk. With --judge the exit code is 1 also if a time exceeds its limit,
and a line names each: a stop p99 20 ms, worst 100 ms; `arm` and `release` p99 100 ms; after SIGTERM 100 ms
to the stop on the wire, 10 s to the end, and the exit code 0.
"""

import argparse
import collections
import contextlib
import fcntl
import json
import multiprocessing
import os
import pathlib
import random
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time

import busy_computer

ROOT = pathlib.Path(__file__).resolve().parents[2]
ROBOT = "127.9.9.3"
RELAY = "127.9.9.4"
PORTS = [29999, 30001, 30004, 5020]
PRIMARY, RTDE, GRIPPER = 30001, 30004, 5020

# Packages of the robot's interface (RTDE guide): size and type before the content; inputs have this type.
HEAD = 3
DATA = ord("U")

# celld's commands (hardware/ur5e/README.md): the recipe's number, 3 whole numbers, 9 real ones.
COMMAND_SIZE = HEAD + 1 + 3 * 4 + 9 * 8
OPCODE = slice(HEAD + 5, HEAD + 9)
MOVE, STOP = 1, 5

# Not one of its commands: something for the primary interface, which gets programs only.
PROGRAM = "program"

# Modbus TCP: where the function code is; these two write registers.
FUNCTION, WRITES = 7, (6, 16)
VACUUM, REQUEST, ANSWER = "vacuum", "request", "answer"

# Linux: who has a lock on this part of the file, of those that belong to an open file (struct flock).
F_OFD_GETLK, FLOCK = 36, "hhqqi"

# Longest waits, s. A stop is on the wire before its answer.
ANSWER_WITHIN = 30
MOVES_WITHIN = 5
STOPS_WITHIN = 0.5

# systemd kills a celld that has not ended so long after SIGTERM (docs/operation.md), s.
ENDS_WITHIN = 40

# With --judge: the share of the times that has to be within the limit (1: all), and the limit, s.
LIMITS = {
    "a stop, from then to the wire": [(0.99, 0.02), (1, 0.1)],
    "a release, from then to the wire": [(0.99, 0.1)],
    "arm, to its program or first move": [(0.99, 0.1)],
    "SIGTERM, to the stop on the wire": [(1, 0.1)],
    "SIGTERM, to the end of celld": [(1, 10)],
}

# The first move to a look takes longer than this, s.
MOVES_FOR = 0.1

# So many jobs wait at the start: each `arm` ends one at most.
JOBS_AHEAD = 20

# So often in a row the arm may stay where it is before that is a fault.
MISSES = 20


def be_prompt():
    """What is measured is celld: this thread does not wait for a processor, where the system allows that."""
    with contextlib.suppress(PermissionError):
        # What it starts is as usual.
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(threading.get_native_id(), policy, os.sched_param(10))


class Relay:
    """Passes bytes on in both directions, and notes programs, orders to the gripper, and celld's moves and
    stops."""

    def __init__(self):
        self.seen = {MOVE: [], STOP: [], PROGRAM: [], VACUUM: [], REQUEST: [], ANSWER: []}
        self.condition = threading.Condition()
        for port in PORTS:
            listener = socket.create_server((RELAY, port))
            threading.Thread(target=self.serve, args=(listener, port), daemon=True).start()

    def serve(self, listener, port):
        while True:
            near, _ = listener.accept()
            with contextlib.suppress(OSError):
                far = socket.create_connection((ROBOT, port))
                for one in (near, far):
                    one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                watches = {
                    RTDE: self.commands(),
                    PRIMARY: lambda at, _: self.note(at, PROGRAM),
                    GRIPPER: self.gripper_order,
                }
                back = (lambda at, _: self.note(at, ANSWER)) if port == GRIPPER else None
                for ends in ((near, far, watches.get(port)), (far, near, back)):
                    threading.Thread(target=self.pump, args=ends, daemon=True).start()

    @staticmethod
    def pump(source, sink, watch):
        be_prompt()
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                at = time.monotonic()
                sink.sendall(data)
                if watch:
                    watch(at, data)
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def commands(self):
        """A function that takes the bytes of one connection and notes the commands in them."""
        rest = b""

        def watch(at, data):
            nonlocal rest
            rest += data
            while len(rest) >= HEAD:
                size = int.from_bytes(rest[:2], "big")
                if size < HEAD or len(rest) < size:
                    break
                package, rest = rest[:size], rest[size:]
                if package[2] == DATA and size == COMMAND_SIZE:
                    self.note(at, int.from_bytes(package[OPCODE], "big"))

        return watch

    def gripper_order(self, at, data):
        # One request at a time: a package is one.
        self.note(at, REQUEST)
        if len(data) > FUNCTION and data[FUNCTION] in WRITES:
            self.note(at, VACUUM)

    def note(self, at, opcode):
        with self.condition:
            if opcode in self.seen:
                self.seen[opcode].append(at)
            self.condition.notify_all()

    def first_after(self, opcodes, at, within):
        """When one of these went out first after this moment; None if none did in so many seconds."""
        with self.condition:
            last = lambda: [one for opcode in opcodes for one in self.seen[opcode][-50:] if one >= at]
            return min(self.condition.wait_for(last, within) or [], default=None)

    def gripper_is_free(self, at):
        """This moment, or when the answer to the request came that was under way then."""
        with self.condition:
            request = max((one for one in self.seen[REQUEST][-50:] if one < at), default=at)
            answers = [one for one in self.seen[ANSWER][-50:] if one >= request]
        return max(min(answers, default=at), at)


class Orders:
    """Orders as files in the folder of commands, as `celld arm` and its like leave them."""

    def __init__(self, folder, daemon):
        self.folder, self.daemon, self.number = folder / "state" / "commands", daemon, 0

    def leave(self, order):
        """Just before and after the rename, where the answer will be, and the lock that says that we wait."""
        self.number += 1
        boot_s = time.clock_gettime(time.CLOCK_BOOTTIME)
        text = json.dumps({"daemon": self.daemon, "boot_s": boot_s, "command": {"do": order}})
        stop = "-stop" if order in ("abort", "disarm", "pause") else ""
        name = f"{int(time.time() * 1e6):020}-{os.getpid()}-{self.number:05}{stop}"
        draft = self.folder / f".{name}.tmp"
        draft.write_text(text)
        lock = open(draft)
        fcntl.flock(lock, fcntl.LOCK_EX)
        before = time.monotonic()
        draft.rename(self.folder / f"{name}.command")
        return (before, time.monotonic()), self.folder / f"{name}.reply", lock

    @staticmethod
    def taken(lock):
        """When celld had the file of this lock, or had removed it."""
        end = time.monotonic() + ANSWER_WITHIN
        asked = struct.pack(FLOCK, fcntl.F_WRLCK, os.SEEK_SET, 0, 1, 0)
        while (now := time.monotonic()) < end:
            owned = struct.unpack(FLOCK, fcntl.fcntl(lock, F_OFD_GETLK, asked))[0] != fcntl.F_UNLCK
            if owned or os.fstat(lock.fileno()).st_nlink == 0:
                return now
            time.sleep(0.0005)
        raise busy_computer.Failed(f"celld has not taken an order within {ANSWER_WITHIN} s")

    @staticmethod
    def answer(reply):
        end = time.monotonic() + ANSWER_WITHIN
        while time.monotonic() < end:
            with contextlib.suppress(OSError, ValueError):
                answer = json.loads(reply.read_text())
                reply.unlink()
                return answer
            time.sleep(0.001)
        return None


def flood(folder, daemon, files):
    """A script's orders, whose sender is gone: as many again as soon as few are left."""
    text = json.dumps({"daemon": daemon, "boot_s": 1.0, "command": {"do": "resume"}})
    # The folder goes before this process does.
    while folder.is_dir():
        if len(list(folder.glob("flood_*.command"))) < files // 4:
            for number in range(files):
                draft = folder / ".flood.tmp"
                with contextlib.suppress(FileNotFoundError):
                    draft.write_text(text)
                    draft.rename(folder / f"flood_{number:05}.command")
        for reply in folder.glob("flood_*.reply"):
            with contextlib.suppress(OSError):
                reply.unlink()
        time.sleep(0.5)


def viewers(count, address, cell, stack):
    """Opens event streams of the page and never reads them."""
    token = cell.call("open", "--token", "--role", "view", "--name", "viewer")[1].splitlines()[-1]
    for _ in range(count):
        viewer = stack.enter_context(contextlib.closing(socket.create_connection((address, 8737))))
        head = f"GET /api/v1/events HTTP/1.1\r\nhost: {address}:8737\r\nauthorization: Bearer {token}\r\n\r\n"
        viewer.sendall(head.encode())


def clients(args, folder, stack):
    """People and scripts that give orders as fast as they are answered."""
    if args.clients == 0:
        return
    one = f"while :; do {args.celld} recover >/dev/null 2>&1; done"
    # In one session: where each session has its share of the processor, `nice` counts within one alone.
    all_of_them = f"for k in $(seq {args.clients}); do ({one}) & done; wait"
    command = ["nice", "-n", "10", "sh", "-c", all_of_them]
    process = subprocess.Popen(command, cwd=folder, start_new_session=True)
    stack.callback(os.killpg, process.pid, signal.SIGKILL)


def configure(folder):
    busy_computer.configure(folder, 1)
    path = folder / "config" / "cell.yaml"
    text = path.read_text().replace(busy_computer.ADDRESS, ROBOT)
    for device in ("robot", "gripper"):
        text = text.replace(f"{device}: {{host: {ROBOT}", f"{device}: {{host: {RELAY}")
    path.write_text(text)
    path = folder / "config" / "sim.yaml"
    path.write_text(path.read_text().replace(busy_computer.ADDRESS, ROBOT))


class Times:
    """Times by what they are of, s; how many stops found the arm at rest, how many orders were lost, and why an
    armed arm did not move."""

    def __init__(self):
        self.renames, self.stops, self.releases = [], [], []
        self.taken, self.wire, self.answer = [], [], []
        self.signal_to_stop, self.signal_to_end, self.exit_code = [], [], None
        self.stood = self.lost = self.unanswered = 0
        self.rests = collections.Counter()

    def named(self):
        return {
            "rename of a stop, by its sender": self.renames,
            "a stop, from then to the wire": self.stops,
            "a release, from then to the wire": self.releases,
            "arm, until celld has its file": self.taken,
            "arm, to its program or first move": self.wire,
            "arm, to its answer; before it a stop": self.answer,
            "SIGTERM, to the stop on the wire": self.signal_to_stop,
            "SIGTERM, to the end of celld": self.signal_to_end,
        }

    def report(self):
        print(f"{'ms':38} {'count':>6} {'median':>8} {'p99':>8} {'worst':>8}")
        for name, times in self.named().items():
            figures = [share(times, part) for part in (0.5, 0.99, 1)] if times else []
            print(f"{name:38} {len(times):6}" + "".join(f" {figure:8.1f}" for figure in figures))
        print(f"{'stops answered, none on the wire':38} {self.stood:6}")
        print(f"{'stops refused or not answered':38} {self.lost:6}")
        print(f"{'other orders not answered':38} {self.unanswered:6}")
        print(f"{'arms with no move, by what stopped it':38} {dict(self.rests)}")
        print(f"{'exit code of celld after SIGTERM':38} {self.exit_code}")

    def exceeded(self):
        """A line for each limit that is exceeded, or has no time to compare with."""
        for name, limits in LIMITS.items():
            times = self.named()[name]
            for part, limit in limits:
                if not times or share(times, part) > limit * 1e3:
                    found = f"{share(times, part):.1f} ms" if times else "not seen"
                    figure = "worst" if part == 1 else f"p{100 * part:.0f}"
                    yield f"{name}: {figure} {found}, limit {limit * 1e3:.0f} ms"
        if self.exit_code != 0:
            yield f"exit code of celld after SIGTERM: {self.exit_code}, expected 0"


def waits_for_arm(cell):
    """A job is there, the arm stands, and an `arm` would not be refused."""
    status = json.loads((cell.folder / "state" / "status.json").read_text())
    return status["job"] and not status["moving"] and not status["armed"] and status["arm_refused"] is None


def wait_until_ready_to_arm(cell):
    end = time.monotonic() + ANSWER_WITHIN
    while time.monotonic() < end:
        with contextlib.suppress(OSError, ValueError):
            if waits_for_arm(cell):
                return
        time.sleep(0.01)
    raise busy_computer.Failed(f"no job waits for `celld arm` within {ANSWER_WITHIN} s")


def hand_in(folder, number):
    """One more job, as `celld submit` leaves it, without a process that has to get a processor first."""
    incoming = folder / "state" / "jobs" / "incoming"
    draft = incoming / ".job.tmp"
    draft.write_text(busy_computer.JOB.format(name=f"look-{number}"))
    draft.rename(incoming / f"look-{number:05}.yaml")


def measure(args, cell, relay, orders, times):
    be_prompt()
    jobs = misses = 0
    while len(times.renames) < args.stops:
        while jobs < len(times.taken) + JOBS_AHEAD:
            jobs += 1
            hand_in(cell.folder, jobs)
        wait_until_ready_to_arm(cell)
        release(relay, orders, times)
        arm = set_out(relay, orders, times)
        if arm.moves:
            stop(relay, orders, times)
        answer = answer_to_arm(arm, cell, orders, times)
        misses = 0 if arm.moves else misses + 1
        if misses > MISSES:
            raise busy_computer.Failed(f"the arm rests; `celld arm` was answered {answer}")
        if len(times.renames) % 10 == 0:
            print(f"  {len(times.renames)} of {args.stops}", flush=True)


Arm = collections.namedtuple("Arm", "moves after reply lock")


def set_out(relay, orders, times):
    """Orders `arm`; returns a moment after the arm's first move went out, or if none does."""
    (began, after), reply, lock = orders.leave("arm")
    times.taken.append(orders.taken(lock) - after)
    first = relay.first_after([PROGRAM, MOVE], began, MOVES_WITHIN)
    if first:
        times.wire.append(max(first - after, 0.0))
    moves = relay.first_after([MOVE], began, MOVES_WITHIN)
    if moves:
        time.sleep(random.uniform(0, MOVES_FOR))
    return Arm(moves, after, reply, lock)


def answer_to_arm(arm, cell, orders, times):
    if not arm.moves:
        # An arm that is armed and does not move is disarmed again.
        orders.leave("disarm")[2].close()
    answer = orders.answer(arm.reply)
    times.answer.append(time.monotonic() - arm.after)
    times.unanswered += answer is None
    arm.lock.close()
    if not arm.moves:
        refused = answer is not None and not answer["accepted"]
        stopped = (cell.status()["stopped"] or {}).get("code", "nothing")
        times.rests[f"refused ({stopped})" if refused else stopped] += 1
    return answer


def terminate(cell, relay, orders, times, daemon):
    """Sends SIGTERM to celld while the arm sets out, for a job that `measure` has left."""
    for _ in range(MISSES):
        wait_until_ready_to_arm(cell)
        arm = set_out(relay, orders, times)
        if arm.moves:
            break
        answer_to_arm(arm, cell, orders, times)
    else:
        raise busy_computer.Failed(f"no SIGTERM was sent: the arm rests after {MISSES} orders to arm")
    sent = time.monotonic()
    daemon.send_signal(signal.SIGTERM)
    with contextlib.suppress(subprocess.TimeoutExpired):
        # This looks every 50 ms.
        times.exit_code = daemon.wait(ENDS_WITHIN)
        times.signal_to_end.append(time.monotonic() - sent)
    # The stop is on the wire before the end. Whether celld still answers the `arm` is not judged.
    if seen := relay.first_after([STOP], sent, STOPS_WITHIN):
        times.signal_to_stop.append(seen - sent)
    arm.lock.close()


def release(relay, orders, times):
    (before, after), reply, lock = orders.leave("release")
    seen = relay.first_after([VACUUM], before, MOVES_WITHIN)
    if seen:
        times.releases.append(max(seen - relay.gripper_is_free(after), 0.0))
    times.unanswered += orders.answer(reply) is None
    lock.close()


def stop(relay, orders, times):
    (before, after), reply, lock = orders.leave("abort")
    answer = orders.answer(reply)
    seen = relay.first_after([STOP], before, STOPS_WITHIN)
    times.renames.append(after - before)
    if seen and answer:
        times.stops.append(max(seen - after, 0.0))
    elif answer and answer["accepted"]:
        # Between two moves the arm is at rest, and nothing has to be sent. That it was is not checked.
        times.stood += 1
    else:
        times.lost += 1
    lock.close()


def share(times, part):
    """So many ms this share of the times takes at most."""
    return sorted(times)[min(int(len(times) * part), len(times) - 1)] * 1e3


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--celld", type=pathlib.Path, required=True)
    parser.add_argument("--stops", type=int, default=1000)
    parser.add_argument("--clients", type=int, default=200)
    parser.add_argument("--files", type=int, default=1000)
    parser.add_argument("--viewers", type=int, default=100)
    limits = "stop p99 20 ms, worst 100 ms; arm, release p99 100 ms; SIGTERM: stop 100 ms, end 10 s, code 0"
    parser.add_argument("--judge", action="store_true", help=f"exit code 1 also beyond a limit: {limits}")
    args = parser.parse_args()
    args.celld = args.celld.resolve()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name, contextlib.ExitStack() as stack:
        folder = pathlib.Path(name)
        configure(folder)
        relay = Relay()
        sim = [args.celld, "sim", "--strict", "--config", "config/sim.yaml"]
        stack.enter_context(busy_computer.running(sim, cwd=folder, stdout=subprocess.DEVNULL))
        # The other end of its log stays open, and unread.
        run = [args.celld, "run", "--config", "config/cell.yaml"]
        daemon = stack.enter_context(busy_computer.running(run, cwd=folder, stderr=subprocess.PIPE))
        cell = busy_computer.Cell(args.celld, folder)
        status = cell.until("celld starts", lambda status: status["state"] == "idle", 120)
        orders = Orders(folder, status["daemon"])
        viewers(args.viewers, ROBOT, cell, stack)
        clients(args, folder, stack)
        # Not a thread: it could lose the processor while it holds the interpreter's lock, and the relay would wait.
        script = multiprocessing.get_context("spawn").Process(
            target=flood, args=(orders.folder, orders.daemon, args.files), daemon=True
        )
        script.start()
        stack.callback(script.kill)
        times = Times()
        try:
            measure(args, cell, relay, orders, times)
            terminate(cell, relay, orders, times, daemon)
        finally:
            # Also of a run that was cut short.
            times.report()
    exceeded = list(times.exceeded()) if args.judge else []
    for line in exceeded:
        print(f"exceeded: {line}")
    sys.exit(int(times.lost + times.unanswered > 0 or not times.stops or bool(exceeded)))


if __name__ == "__main__":
    main()
