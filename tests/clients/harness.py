"""What the client tests share: checks, waiting, and forward kinematics that owe nothing to celld.

In: the address of a running `celld sim` as the first argument. Out: a line for each check; the exit code is 1
when one failed. The kinematics are those the controller itself publishes on its primary interface
(sub-package 5), so that a pose can be compared with the joint positions it belongs to without trusting the
simulator's own arithmetic.
"""

import faulthandler
import math
import socket
import struct
import sys
import time

LONG = 30.0
"""Longest wait for anything, s: far above what is expected, so that a busy computer fails nothing."""

PATIENCE = 240.0
"""Longest run of a script, s; then it says where it hangs, in place of being killed without a word."""

faulthandler.dump_traceback_later(PATIENCE, exit=True)

failures = []
count = 0


def address():
    """The simulator's address."""
    if len(sys.argv) != 2:
        sys.exit(f"usage: {sys.argv[0]} ADDRESS")
    return sys.argv[1]


def check(name, truth, detail=""):
    """Notes one expectation."""
    global count
    count += 1
    if truth:
        print(f"ok      {name}")
    else:
        failures.append(name)
        print(f"FAILED  {name}  {detail}")
    sys.stdout.flush()


def near(name, seen, expected, tolerance):
    """Expects numbers or lists of numbers to agree."""
    seen_list = list(seen) if hasattr(seen, "__len__") else [seen]
    expected_list = list(expected) if hasattr(expected, "__len__") else [expected]
    same = len(seen_list) == len(expected_list) and all(
        abs(a - b) <= tolerance for a, b in zip(seen_list, expected_list)
    )
    check(name, same, f"seen {seen_list}, expected {expected_list} within {tolerance}")


def same_pose(name, seen, expected, metres, radians):
    """Expects two poses (x, y, z and a rotation vector) to agree; a rotation has more than one vector."""
    apart = math.dist(seen[:3], expected[:3])
    turned = angle_between(rotation(seen[3:]), rotation(expected[3:]))
    check(name, apart <= metres and turned <= radians, f"{seen} and {expected}: {apart} m, {turned} rad apart")


def wait_until(name, condition, seconds=LONG):
    """Expects a condition to come true; returns what made it true."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        value = condition()
        if value:
            check(name, True)
            return value
        time.sleep(0.002)
    check(name, False, f"not within {seconds} s")
    return None


def finish():
    """Says how it went and ends the process."""
    print(f"{count} checks, {len(failures)} failed")
    sys.exit(1 if failures or count == 0 else 0)


# --- the controller's kinematics, from the wire ---


def kinematics(host):
    """(theta, a, d, alpha), six each, as the primary interface announces them (m, rad)."""
    with socket.create_connection((host, 30001), timeout=LONG) as link:
        stream = link.makefile("rb")
        while True:
            length, kind = struct.unpack(">iB", stream.read(5))
            body = stream.read(length - 5)
            if kind != 16:
                continue
            while body:
                size, part = struct.unpack(">IB", body[:5])
                if part == 5:
                    numbers = struct.unpack(">24d", body[5 + 24 : 5 + 24 + 24 * 8])
                    return numbers[0:6], numbers[6:12], numbers[12:18], numbers[18:24]
                body = body[size:]


def forward(model, q, tcp=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)):
    """Pose of the tool centre point for joint positions, standard Denavit-Hartenberg: x, y, z, rotation
    vector."""
    theta, a, d, alpha = model
    frame = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
    for i in range(6):
        ct, st = math.cos(q[i] + theta[i]), math.sin(q[i] + theta[i])
        ca, sa = math.cos(alpha[i]), math.sin(alpha[i])
        link = [
            [ct, -st * ca, st * sa, a[i] * ct],
            [st, ct * ca, -ct * sa, a[i] * st],
            [0.0, sa, ca, d[i]],
            [0.0, 0.0, 0.0, 1.0],
        ]
        frame = product(frame, link)
    tool = [row + [shift] for row, shift in zip(rotation(tcp[3:]), tcp[:3])] + [[0.0, 0.0, 0.0, 1.0]]
    frame = product(frame, tool)
    return [frame[0][3], frame[1][3], frame[2][3]] + rotation_vector([row[:3] for row in frame[:3]])


def product(left, right):
    """Matrix product."""
    return [[sum(a * b for a, b in zip(row, column)) for column in zip(*right)] for row in left]


def rotation(vector):
    """Rotation matrix of a rotation vector (Rodrigues)."""
    angle = math.sqrt(sum(v * v for v in vector))
    if angle < 1e-12:
        return [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    x, y, z = (v / angle for v in vector)
    c, s = math.cos(angle), math.sin(angle)
    k = 1.0 - c
    return [
        [c + x * x * k, x * y * k - z * s, x * z * k + y * s],
        [y * x * k + z * s, c + y * y * k, y * z * k - x * s],
        [z * x * k - y * s, z * y * k + x * s, c + z * z * k],
    ]


def rotation_vector(m):
    """Rotation vector of a matrix; of the two at half a turn, either."""
    cosine = max(-1.0, min(1.0, (m[0][0] + m[1][1] + m[2][2] - 1.0) / 2.0))
    angle = math.acos(cosine)
    if angle < 1e-9:
        return [0.0, 0.0, 0.0]
    if math.pi - angle > 1e-6:
        k = angle / (2.0 * math.sin(angle))
        return [k * (m[2][1] - m[1][2]), k * (m[0][2] - m[2][0]), k * (m[1][0] - m[0][1])]
    axis = max(range(3), key=lambda i: m[i][i])
    column = [(m[i][axis] + (1.0 if i == axis else 0.0)) for i in range(3)]
    length = math.sqrt(sum(v * v for v in column))
    return [angle * v / length for v in column]


def angle_between(first, second):
    """Angle of the rotation from one matrix to the other, rad."""
    difference = product(list(map(list, zip(*first))), second)
    vector = rotation_vector(difference)
    return math.sqrt(sum(v * v for v in vector))


def power_on(dashboard):
    """Brings the arm to RUNNING through the dashboard, as an operator does."""
    dashboard.powerOn()
    wait_until("power on ends in IDLE", lambda: "IDLE" in dashboard.robotmode())
    dashboard.brakeRelease()
    wait_until("brake release ends in RUNNING", lambda: "RUNNING" in dashboard.robotmode())
