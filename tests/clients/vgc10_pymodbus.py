"""pymodbus on the gripper, ur_rtde on the arm, and the world's truth from the control socket: an object is
lifted only when the cup covers it and the vacuum holds it. Also what the Compute Box refuses."""

import json
import math
import urllib.request

import dashboard_client
import rtde_control
from harness import address, check, finish, near, power_on, wait_until
from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException

UNIT, MODBUS_PORT, CONTROL_PORT = 65, 5020, 8091
host = address()
box = ModbusTcpClient(host, port=MODBUS_PORT)
check("connect", box.connect())


def vacuum(channel=0):
    """Relative vacuum, per mille."""
    return box.read_holding_registers(258 + channel, count=1, device_id=UNIT).registers[0]


def grip(per_cent, register=0):
    return not box.write_register(register, 0x0100 | per_cent, device_id=UNIT).isError()


def release(register=0):
    return not box.write_register(register, 0, device_id=UNIT).isError()


def world():
    return json.load(urllib.request.urlopen(f"http://{host}:{CONTROL_PORT}/world.json"))


def state_of(name):
    return next(item for item in world()["objects"] if item["id"] == name)


def let_pass(seconds):
    """Waits for so much of the world's own time."""
    end = world()["time_s"] + seconds
    wait_until(f"{seconds} s pass", lambda: world()["time_s"] >= end)


# What the box says and refuses.
near("both channels at rest", [vacuum(0), vacuum(1)], [0, 0], 15)
near("the current limit", box.read_holding_registers(2, count=1, device_id=UNIT).registers, [500], 0)
check("it can be set", not box.write_register(2, 800, device_id=UNIT).isError())
near("and read back", box.read_holding_registers(2, count=1, device_id=UNIT).registers, [800], 0)
check("not above 1000 mA", box.write_register(2, 1200, device_id=UNIT).exception_code == 3)
check("no register 50", box.read_holding_registers(50, count=1, device_id=UNIT).exception_code == 2)
check("the vacuum cannot be written", box.write_register(258, 1, device_id=UNIT).exception_code == 2)
check("no coils", box.read_coils(0, count=1, device_id=UNIT).exception_code == 1)
check("no mode 7", box.write_register(0, 0x0714, device_id=UNIT).exception_code == 3)
check("both channels with one request", not box.write_registers(0, [0x0114, 0x0114], device_id=UNIT).isError())
check("both released with one request", not box.write_registers(0, [0, 0], device_id=UNIT).isError())
near("two status words at once", box.read_holding_registers(258, count=2, device_id=UNIT).registers, [0, 0], 80)

# In the air no vacuum builds up.
grip(60)
let_pass(0.5)
check("an open cup reaches little", vacuum() < 200, vacuum())
release()

# The arm goes to the block; cell frames as in config/sim.yaml, tool 0.2 m below the flange.
dashboard = dashboard_client.DashboardClient(host)
dashboard.connect()
power_on(dashboard)
control = rtde_control.RTDEControlInterface(host)
control.setTcp([0.0, 0.0, 0.2, 0.0, 0.0, 0.0])
control.setPayload(1.72, [0.0, -0.005, 0.065])
block = state_of("block")["pose"]
x, y = -0.25 + block[0], 0.18 + block[1]


def over(z):
    return [x, y, z, math.pi, 0.0, 0.0]


check("above the block", control.moveJ_IK(over(0.1), 1.0, 2.0))
check("down to just above it", control.moveL(over(0.036), 0.1, 0.5))
grip(60)
held = False
height = 0.036
while height > 0.022 and not held:
    height -= 0.0005
    control.moveL(over(height), 0.02, 0.5)
    held = vacuum() > 300
check("the cup seals on the block", held, vacuum())
wait_until("60 % are reached", lambda: vacuum() > 550)
wait_until("the world says it is held", lambda: state_of("block")["state"] == "held")
check("it is lifted", control.moveL(over(0.15), 0.2, 0.5))
check("it hangs in the air", state_of("block")["z_m"] > 0.08, state_of("block"))
near("and keeps its vacuum", vacuum(), 600, 40)

# A second client is turned away, and a lost connection leaves the last command active.
second = ModbusTcpClient(host, port=MODBUS_PORT, retries=0)
second.connect()
try:
    turned_away = second.read_holding_registers(258, count=1, device_id=UNIT).isError()
except (ConnectionError, ModbusException):
    turned_away = True
check("a second client is turned away", turned_away)
near("the first is served", vacuum(), 600, 40)
second.close()
box.close()
let_pass(0.2)
box.connect()
near("it still holds", vacuum(), 600, 40)

# Put down 30 mm beside, released, and left there.
x += 0.03
check("aside", control.moveL(over(0.15), 0.2, 0.5))
check("down", control.moveL(over(height + 0.001), 0.1, 0.5))
release()
wait_until("the vacuum is gone", lambda: vacuum() < 30)
wait_until("it rests", lambda: state_of("block")["state"] == "resting")
check("the arm rises without it", control.moveL(over(0.15), 0.2, 0.5))
moved = state_of("block")["pose"][0] - block[0]
near("it lies 30 mm further", moved, 0.03, 0.003)

# Too little vacuum to carry: gripped weakly it stays on the table.
check("down again", control.moveL(over(height + 0.001), 0.1, 0.5))
grip(10)
let_pass(0.5)
check("up with 10 %", control.moveL(over(0.15), 0.2, 0.5))
check("the block stayed", state_of("block")["state"] == "resting" and state_of("block")["z_m"] < 0.001, state_of("block"))
release()
control.stopScript()
finish()
