"""What is done to a simulated robot: clients of others, faults, gripper, time, the truth about the world."""

import json
import time
import urllib.request

import celld_sim
import pytest
import rtde_control
import rtde_receive
from conftest import wait_until
from pymodbus.client import ModbusTcpClient

HOME = [-1.6, -1.9, 1.8, -1.5, -1.57, 0.1]


def test_ur_rtde_moves_the_arm():
    with celld_sim.Robot(model="UR10e", running=True) as robot:
        control = rtde_control.RTDEControlInterface(robot.host)
        receive = rtde_receive.RTDEReceiveInterface(robot.host)
        assert control.moveJ(HOME, 1.05, 1.4)
        wait_until(lambda: max(abs(a - b) for a, b in zip(receive.getActualQ(), HOME)) < 1e-3)
        control.stopScript()


def test_a_fault_happens_lasts_and_is_cleared():
    with celld_sim.Robot(running=True) as robot:
        robot.fault("ur.estop")
        wait_until(lambda: "EMERGENCY_STOP" in robot.dashboard("safetystatus"))
        assert robot.world()["faults"]["active"] == ["ur.estop"]
        robot.clear("camera.off")
        assert robot.world()["faults"]["active"] == ["ur.estop"]
        robot.clear()
        assert robot.world()["faults"]["active"] == []
        assert "EMERGENCY_STOP" not in wait_until(lambda: robot.dashboard("safetystatus"))


def test_faults_come_at_their_time_and_as_a_plan(robot):
    now = robot.world()["time_s"]
    robot.fault("camera.off", at={"time_s": now + 3600})
    assert robot.world()["faults"]["waiting"] == 1
    robot.faults([{"do": "camera.off", "args": {"seconds": 60}}, {"do": "vacuum.stick"}])
    assert robot.world()["faults"]["active"] == ["camera.off", "vacuum.stick"]
    assert not robot.world()["camera_on"]


def test_a_fault_that_is_none_is_refused_with_the_reason(robot):
    with pytest.raises(celld_sim.FaultRefused, match="ur.pstopp"):
        robot.fault("ur.pstopp")
    with pytest.raises(celld_sim.FaultRefused, match='"nothing"'):
        robot.fault("world.nudge", object="nothing", dx_m=0.01, dy_m=0)
    with pytest.raises(ValueError, match="JSON"):
        robot.fault("ur.slider", fraction=float("nan"))
    assert robot.world()["faults"]["active"] == []


def test_the_world_is_as_it_was_made(robot):
    world = robot.world()
    block = next(thing for thing in world["objects"] if thing["id"] == "block")
    robot.fault("world.place", object="block", pose=[0.25, 0.25, 0])
    moved = next(thing for thing in robot.world()["objects"] if thing["id"] == "block")
    assert block["pose"] != moved["pose"] and moved["pose"][:2] == pytest.approx([0.25, 0.25])
    assert robot.timing()["frames"] > 0


def test_the_gripper_answers_where_the_robot_says(robot):
    gripper = robot.gripper
    box = ModbusTcpClient(gripper.host, port=gripper.port)
    assert box.connect()
    assert not box.write_register(0, 0x0100 | 60, device_id=gripper.unit).isError()
    wait_until(lambda: robot.world()["channels"][0]["mode"] == "grip")
    box.close()


def test_the_camera_answers_where_the_robot_says(robot):
    with urllib.request.urlopen(f"{robot.camera_url}/intrinsics.json") as answer:
        assert json.load(answer)


def test_time_runs_by_its_factor():
    with celld_sim.Robot(time_factor=20) as robot:
        began, start = time.monotonic(), robot.world()["time_s"]
        wait_until(lambda: robot.world()["time_s"] > start + 10)
        # In real time it would take ten seconds, by the factor half a second.
        assert time.monotonic() - began < 8


def test_one_command_at_a_time(robot):
    with pytest.raises(ValueError, match="one command"):
        robot.dashboard("power on\nbrake release")
