"""SDU's ur_rtde: the receive, input/output and dashboard interfaces."""

import math
import tempfile
import threading
import time

import dashboard_client
import rtde_control
import rtde_io
import rtde_receive
from harness import LONG, address, check, finish, near, power_on, wait_until

host = address()
dashboard = dashboard_client.DashboardClient(host)
dashboard.connect()
check("the dashboard is connected", dashboard.isConnected())
check("robotmode before power", dashboard.robotmode() == "Robotmode: POWER_OFF", dashboard.robotmode())
receive = rtde_receive.RTDEReceiveInterface(host)
near("receive says power off", receive.getRobotMode(), 3, 0)
power_on(dashboard)
wait_until("receive says running", lambda: receive.getRobotMode() == 7)

# Dashboard.
check("safetymode", dashboard.safetymode() == "Safetymode: NORMAL", dashboard.safetymode())
check("safetystatus", dashboard.safetystatus() == "Safetystatus: NORMAL", dashboard.safetystatus())
check("polyscopeVersion", dashboard.polyscopeVersion().startswith("5."), dashboard.polyscopeVersion())
check("getSerialNumber", dashboard.getSerialNumber().isdigit(), dashboard.getSerialNumber())
check("getRobotModel", dashboard.getRobotModel() == "UR5", dashboard.getRobotModel())
check("isInRemoteControl", dashboard.isInRemoteControl())
check("not running", not dashboard.running())
check("programState", dashboard.programState().startswith("STOPPED"), dashboard.programState())
check("getLoadedProgram", len(dashboard.getLoadedProgram()) > 0, dashboard.getLoadedProgram())
check("isProgramSaved", dashboard.isProgramSaved() in (True, False))
for name, call in [
    ("popup", lambda: dashboard.popup("hello")),
    ("closePopup", dashboard.closePopup),
    ("closeSafetyPopup", dashboard.closeSafetyPopup),
    ("addToLog", lambda: dashboard.addToLog("a line")),
]:
    call()
    check(name, dashboard.isConnected())


def refused(call):
    try:
        call()
        return False
    except RuntimeError:
        return True


check("loadURP of what is not there is refused", refused(lambda: dashboard.loadURP("missing.urp")))
dashboard.send("robotmode\n")
check("send and receive", dashboard.receive() == "Robotmode: RUNNING")

# Program states, with the control interface's own program.
control = rtde_control.RTDEControlInterface(host)
check("running", dashboard.running())
check("PLAYING rtde_control", "PLAYING" in dashboard.programState(), dashboard.programState())
wait_until("runtime state 2", lambda: receive.getRuntimeState() == 2)
dashboard.pause()
wait_until("pause ends in PAUSED", lambda: "PAUSED" in dashboard.programState())
wait_until("runtime state 4", lambda: receive.getRuntimeState() == 4)
dashboard.play()
wait_until("play goes on", lambda: "PLAYING" in dashboard.programState())

# Input and output.
outputs = rtde_io.RTDEIOInterface(host)
for pin in range(8):
    check(f"setStandardDigitalOut {pin}", outputs.setStandardDigitalOut(pin, True))
    wait_until(f"standard output {pin} is on", lambda: receive.getDigitalOutState(pin))
    check(f"setConfigurableDigitalOut {pin}", outputs.setConfigurableDigitalOut(pin, True))
    wait_until(f"configurable output {pin} is on", lambda: receive.getDigitalOutState(pin + 8))
for pin in range(2):
    check(f"setToolDigitalOut {pin}", outputs.setToolDigitalOut(pin, True))
    wait_until(f"tool output {pin} is on", lambda: receive.getDigitalOutState(pin + 16))
near("all 18 bits", receive.getActualDigitalOutputBits(), (1 << 18) - 1, 0)
outputs.setStandardDigitalOut(3, False)
wait_until("only output 3 goes off", lambda: receive.getActualDigitalOutputBits() == ((1 << 18) - 1) & ~8)
check("setAnalogOutputVoltage", outputs.setAnalogOutputVoltage(0, 0.5))
wait_until("half of 10 V", lambda: abs(receive.getStandardAnalogOutput0() - 5.0) < 1e-6)
check("setAnalogOutputCurrent", outputs.setAnalogOutputCurrent(1, 0.25))
wait_until("a quarter of 4 to 20 mA", lambda: abs(receive.getStandardAnalogOutput1() - 0.008) < 1e-6)
check("setSpeedSlider", outputs.setSpeedSlider(0.5))
wait_until("the slider stands at a half", lambda: abs(receive.getTargetSpeedFraction() - 0.5) < 1e-9)
outputs.setSpeedSlider(1.0)
check("setInputIntRegister", outputs.setInputIntRegister(20, 77))
check("setInputDoubleRegister", outputs.setInputDoubleRegister(20, 0.125))
echo = "write_output_integer_register(13, read_input_integer_register(20))\nwrite_output_float_register(13, read_input_float_register(20))\n"
check("a program reads them", control.sendCustomScriptFunction("ECHO", echo))
wait_until("int register", lambda: receive.getOutputIntRegister(13) == 77)
wait_until("double register", lambda: receive.getOutputDoubleRegister(13) == 0.125)
second = None
try:
    second = rtde_io.RTDEIOInterface(host)
    check("a second input/output client is refused its registers", False)
except RuntimeError as error:
    check("a second input/output client is refused its registers", "in use" in str(error).lower() or "IN_USE" in str(error), error)

# Receive: everything there is a getter for.
vectors = "ActualCurrent ActualJointVoltage ActualQ ActualQd ActualTCPForce ActualTCPPose ActualTCPSpeed FtRawWrench JointControlOutput JointMode JointTemperatures PayloadInertia TargetCurrent TargetMoment TargetQ TargetQd TargetQdd TargetTCPPose TargetTCPSpeed".split()
for name in vectors:
    value = getattr(receive, f"get{name}")()
    check(f"get{name} has six numbers", len(value) == 6 and all(abs(v) < 1e6 for v in value), value)
for name in "ActualToolAccelerometer PayloadCog".split():
    check(f"get{name} has three numbers", len(getattr(receive, f"get{name}")()) == 3)
for name, low, high in [
    ("ActualExecutionTime", 0.0, 2.0), ("ActualMainVoltage", 40.0, 56.0), ("ActualMomentum", 0.0, 100.0),
    ("ActualRobotCurrent", 0.0, 20.0), ("ActualRobotVoltage", 40.0, 56.0), ("SpeedScaling", 0.0, 1.0),
    ("SpeedScalingCombined", 0.0, 1.0), ("TargetSpeedFraction", 0.0, 1.0), ("StandardAnalogInput0", 0.0, 10.0),
    ("StandardAnalogInput1", 0.0, 10.0), ("Payload", 0.0, 10.0), ("Timestamp", 41.0, 1e6),
]:
    value = getattr(receive, f"get{name}")()
    check(f"get{name} lies in its range", low <= value <= high, value)
near("getSafetyMode", receive.getSafetyMode(), 1, 0)
near("getSafetyStatusBits", receive.getSafetyStatusBits(), 1, 0)
wait_until("getRobotStatus: power is on, a program runs", lambda: receive.getRobotStatus() == 3)
near("getActualDigitalInputBits", receive.getActualDigitalInputBits(), 0, 0)
check("getDigitalInState", not receive.getDigitalInState(0))
check("isProtectiveStopped", not receive.isProtectiveStopped())
check("isEmergencyStopped", not receive.isEmergencyStopped())
near("a standing arm's targets are its positions", receive.getTargetQ(), receive.getActualQ(), 1e-9)
with tempfile.NamedTemporaryFile("r", suffix=".csv") as record:
    check("startFileRecording", receive.startFileRecording(record.name, ["timestamp", "actual_q"]))
    first = receive.getTimestamp()
    wait_until("half a second is recorded", lambda: receive.getTimestamp() > first + 0.5)
    check("stopFileRecording", receive.stopFileRecording())
    rows = record.read().splitlines()
    # The client writes what it has every 2 ms of its own: on a busy computer it misses some, or has one twice.
    stamps = [float(row.split(",")[0]) for row in rows[1:]]
    steps = [b - a for a, b in zip(stamps, stamps[1:])]
    cycles = [step / 0.002 for step in steps]
    check("the recording has rows", len(rows) > 20, len(rows))
    check("each of a cycle, in order", all(c > -1e-3 and abs(c - round(c)) < 1e-3 for c in cycles), cycles)
# (Not receive.reconnect(): the client's own reading thread crashes in it now and then.)

# Several clients at once, each at its own rate; none disturbs another.
clients = [rtde_receive.RTDEReceiveInterface(host, rate) for rate in (500.0, 125.0, 50.0, 10.0)]
seen = [[] for _ in clients]
rates = [0.002, 0.008, 0.02, 0.1]
least = [math.inf for _ in clients]
began = time.monotonic()


def collect(index):
    # At least a second; longer only when this computer is too busy to see two neighbours.
    while time.monotonic() < began + (1.0 if least[index] < rates[index] + 1e-6 else LONG if index else 5.0):
        stamp = clients[index].getTimestamp()
        if not seen[index] or stamp != seen[index][-1]:
            least[index] = min([least[index]] + [stamp - last for last in seen[index][-1:]])
            seen[index].append(stamp)
        time.sleep(0.0005)


threads = [threading.Thread(target=collect, args=(index,)) for index in range(len(clients))]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
near("each gets its own rate", least[1:], rates[1:], 1e-9)
# A client that shares its processor with many does not look at every cycle.
cycles = least[0] / rates[0]
check("the fastest gets cycles", 0.5 < cycles < 25 and abs(cycles - round(cycles)) < 1e-6, least[0])
for client in clients:
    client.disconnect()

# Power off ends everything.
control.stopScript()
dashboard.powerOff()
wait_until("power off", lambda: "POWER_OFF" in dashboard.robotmode())
dashboard.restartSafety()
check("restartSafety leaves the arm off", "POWER_OFF" in dashboard.robotmode(), dashboard.robotmode())
dashboard.quit()
dashboard.disconnect()
check("disconnect", not dashboard.isConnected())
finish()
