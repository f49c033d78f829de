"""Universal Robots' own Python client of the real-time data exchange: recipes, rates, inputs, and a control
loop in the style of its examples (a program on the robot follows set points written to registers)."""

import logging
import socket
import time

from harness import LONG, address, check, finish, near, wait_until
from third_party.rtde import rtde, serialize

logging.disable(logging.CRITICAL)
host = address()


panel = socket.create_connection((host, 29999), timeout=LONG).makefile("rw", newline="\n")
greeting = panel.readline()
check("the dashboard greets", greeting == "Connected: Universal Robots Dashboard Server\n", greeting)


def dashboard(line):
    panel.write(line + "\n")
    panel.flush()
    return panel.readline().strip()


check("power on", dashboard("power on") == "Powering on")
wait_until("idle", lambda: dashboard("robotmode").endswith("IDLE"))
check("brake release", dashboard("brake release") == "Brake releasing")
wait_until("running", lambda: dashboard("robotmode").endswith("RUNNING"))

link = rtde.RTDE(host)
link.connect()
version = link.get_controller_version()
check("get_controller_version", len(version) == 4 and version[0] == 5, version)
other = rtde.RTDE(host)
other.connect()
try:
    other.send_output_setup(["timestamp", "no_such_variable"], frequency=125)
    check("send_output_setup raises for an unknown variable", False)
except ValueError:
    check("send_output_setup raises for an unknown variable", True)
other.disconnect()

NAMES = ["timestamp", "actual_q", "actual_TCP_pose", "output_int_register_0", "runtime_state", "robot_mode", "actual_digital_output_bits"]
TYPES = ["DOUBLE", "VECTOR6D", "VECTOR6D", "INT32", "UINT32", "INT32", "UINT64"]
check("send_output_setup with its types", link.send_output_setup(NAMES, TYPES, frequency=500))
setpoint = link.send_input_setup([f"input_double_register_{i}" for i in range(24, 30)], ["DOUBLE"] * 6)
watchdog = link.send_input_setup(["input_int_register_24"], ["INT32"])
check("send_input_setup", setpoint is not None and watchdog is not None)
rival = rtde.RTDE(host)
rival.connect()
try:
    rival.send_input_setup(["input_int_register_24"], ["INT32"])
    check("a register in use raises for another client", False)
except ValueError as error:
    check("a register in use raises for another client", "IN_USE" in str(error) or "in use" in str(error).lower(), error)
rival.disconnect()
check("send_start", link.send_start())
first = link.receive()
check("receive", first is not None and first.robot_mode == 7, first)
check("send_message", link.send_message(b"hello from a client", b"test", serialize.Message.INFO_MESSAGE))

stamps = []
while len(stamps) < 1000:
    stamps.append(link.receive().timestamp)
steps = [round((b - a) / 0.002) for a, b in zip(stamps, stamps[1:])]
check("packages come in order, whole cycles apart", all(step >= 1 for step in steps), min(steps))
missing = sum(step - 1 for step in steps) - link.skipped_package_count
check("what this client did not skip itself, it got", missing <= 0, (sum(steps), link.skipped_package_count))

PROGRAM = """def follow():
  rtde_set_watchdog("input_int_register_24", 2, "stop")
  write_output_integer_register(0, 1)
  while True:
    target = [0, 0, 0, 0, 0, 0]
    i = 0
    while i < 6:
      target[i] = read_input_float_register(24 + i)
      i = i + 1
    end
    movej(target, a=4, v=2)
    if norm(get_actual_joint_positions() - target) < 0.0001:
      write_output_integer_register(0, 2)
    end
    sync()
  end
end
"""


def write(q):
    for i, value in enumerate(q):
        setattr(setpoint, f"input_double_register_{24 + i}", value)
    link.send(setpoint)
    watchdog.input_int_register_24 = int(time.monotonic() * 1000) % 1000000
    link.send(watchdog)


start = list(first.actual_q)
write(start)
with socket.create_connection((host, 30002), timeout=LONG) as secondary:
    secondary.sendall(PROGRAM.encode())
    for target in ([start[0] + 0.2] + start[1:], start):
        def there():
            write(target)
            state = link.receive()
            return state.output_int_register_0 == 2 and max(abs(a - b) for a, b in zip(state.actual_q, target)) < 1e-4

        wait_until("the program follows the set point", there)
    near("the arm stands where it was told", link.receive().actual_q, start, 1e-4)
    # Silence: the watchdog on the controller ends the program.
    wait_until("without signs of life the watchdog stops the program", lambda: link.receive().runtime_state == 1)

check("send_pause", link.send_pause())
check("send_start again", link.send_start())
check("and receive", link.receive() is not None)
link.disconnect()
check("disconnect", not link.is_connected())
finish()
