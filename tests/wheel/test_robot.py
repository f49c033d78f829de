"""celld_sim.Robot: what it is, where it listens, how it ends, what it says when it cannot start."""

import os
import signal
import socket
import subprocess
import sys

import celld_sim
import pytest
from conftest import listens, wait_until


def test_the_ports_are_the_controller_s_own(robot):
    ports = robot.ports
    own = (ports.dashboard, ports.primary, ports.secondary, ports.realtime, ports.rtde, ports.interpreter)
    assert own == (29999, 30001, 30002, 30003, 30004, 30020)
    assert (ports.gripper, ports.controller_modbus) == (5020, None)
    numbers = [*own, ports.gripper, ports.camera, ports.control]
    assert len(set(numbers)) == len(numbers)
    assert all(listens(robot.host, port) for port in numbers)
    assert robot.gripper == celld_sim.Gripper(robot.host, 5020, 65)


def test_many_robots_run_side_by_side_with_the_same_ports():
    robots = [celld_sim.Robot().start() for _ in range(8)]
    try:
        assert len({robot.host for robot in robots}) == len(robots)
        assert len({robot.ports for robot in robots}) == 1
        robots[3].power_on()
        modes = ["RUNNING" in robot.dashboard("robotmode") for robot in robots]
        assert modes == [number == 3 for number in range(8)]
    finally:
        for robot in robots:
            robot.stop()


@pytest.mark.parametrize("model", celld_sim.MODELS)
def test_every_model_starts_and_moves_to_running(model):
    with celld_sim.Robot(model=model, running=True, time_factor=20) as robot:
        assert robot.dashboard("get robot model") == model.rstrip("e")
        assert robot.dashboard("robotmode") == "Robotmode: RUNNING"


def test_a_robot_has_the_software_that_was_ordered():
    with celld_sim.Robot(software="5.13.1.42") as robot:
        assert "5.13.1.42" in robot.dashboard("PolyscopeVersion")
    with celld_sim.Robot(software="3.15.8") as robot:
        assert "3.15.8" in robot.dashboard("PolyscopeVersion")


def test_polyscope_x_has_the_robot_api_in_place_of_the_dashboard():
    with celld_sim.Robot(software="10.12.0", host="127.0.0.1", port_offset=1700, running=True) as robot:
        assert (robot.ports.dashboard, robot.ports.robot_api) == (None, 1780)
        assert robot.robot_api("GET", "/robotstate/v1/robotmode")["mode"] == "RUNNING"
        with pytest.raises(celld_sim.SimulatorError, match="404"):
            robot.robot_api("GET", "/programs/v1/absent")
        with pytest.raises(celld_sim.SimulatorError, match="no dashboard"):
            robot.dashboard("robotmode")
    with celld_sim.Robot() as robot, pytest.raises(celld_sim.SimulatorError, match="no Robot API"):
        robot.robot_api("GET", "/openapi.json")


def test_an_offset_moves_every_port():
    with celld_sim.Robot(host="127.0.0.1", port_offset=2300) as robot:
        assert robot.host == "127.0.0.1"
        assert (robot.ports.dashboard, robot.ports.interpreter, robot.ports.gripper) == (32299, 32320, 7320)
        assert robot.dashboard("robotmode") == "Robotmode: POWER_OFF"


def test_where_there_are_no_more_addresses_robots_share_one_and_differ_by_ports(monkeypatch):
    monkeypatch.setattr(sys, "platform", "darwin")
    with celld_sim.Robot() as first, celld_sim.Robot() as second:
        assert first.host == second.host == "127.0.0.1"
        assert first.ports.dashboard != second.ports.dashboard
        assert first.dashboard("robotmode") == second.dashboard("robotmode")


def test_an_address_that_is_taken_is_named(robot):
    with pytest.raises(celld_sim.SimulatorError, match="in use") as refused:
        celld_sim.Robot(host=robot.host).start()
    assert robot.host in str(refused.value)


def test_another_address_is_taken_when_the_first_is_not_free(robot, monkeypatch):
    import celld_sim.robot

    monkeypatch.setattr(celld_sim.robot, "loopback_addresses", lambda: iter([robot.host, "127.63.1.7"]))
    with celld_sim.Robot() as second:
        assert second.host == "127.63.1.7"
    monkeypatch.setattr(celld_sim.robot, "loopback_addresses", lambda: iter([robot.host] * 3))
    with pytest.raises(celld_sim.SimulatorError, match="in use"):
        celld_sim.Robot().start()


def test_what_is_wrong_comes_in_the_simulator_s_own_words(tmp_path):
    for options, words in [
        ({"model": "UR9"}, "give one of UR5e"),
        ({"software": "latest"}, "give a version"),
        ({"time_factor": 0}, "simulated seconds per second"),
        ({"host": "8.8.8.8"}, "this machine only"),
        ({"config": tmp_path / "none.yaml"}, "none.yaml: No such file"),
    ]:
        with pytest.raises(celld_sim.SimulatorError) as refused:
            celld_sim.Robot(**options).start()
        assert words in str(refused.value), options
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text("version: 1\nbind: somewhere\n")
    with pytest.raises(celld_sim.SimulatorError, match=r"wrong.yaml:2"):
        celld_sim.Robot(config=wrong).start()


def test_files_are_found_from_where_the_caller_is(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "faults.yaml").write_text("faults:\n  - {do: ur.pstop}\n")
    # A folder that happens to have this name is not the simulator's.
    (tmp_path / "config").mkdir()
    (tmp_path / "config" / "sim.yaml").write_text("something: else\n")
    with celld_sim.Robot(faults="faults.yaml", running=False) as robot:
        wait_until(lambda: robot.world()["events"])
        assert robot.world()["events"][0]["name"] == "ur.pstop"


def test_a_program_that_is_none_is_named(tmp_path, monkeypatch):
    with pytest.raises(celld_sim.SimulatorError, match="no-such-program cannot be run"):
        celld_sim.Robot(program=tmp_path / "no-such-program").start()
    with pytest.raises(celld_sim.SimulatorError, match="ended with 0: it wrote nothing"):
        celld_sim.Robot(program="/bin/true").start()
    with pytest.raises(celld_sim.SimulatorError, match="wrote no ready line"):
        celld_sim.Robot(program="/bin/echo").start()
    monkeypatch.setenv("CELLD_SIM", "/bin/echo")
    with pytest.raises(celld_sim.SimulatorError, match="wrote no ready line"):
        celld_sim.Robot().start()


def test_a_program_that_says_nothing_is_given_up(tmp_path):
    silent = tmp_path / "silent"
    silent.write_text("#!/bin/sh\necho waiting >&2\nexec sleep 60\n")
    silent.chmod(0o755)
    with pytest.raises(celld_sim.SimulatorError, match="not ready within 0.5 s: waiting"):
        celld_sim.Robot(program=silent, start_timeout=0.5).start()


def test_a_robot_ends_with_its_block_and_can_start_again():
    robot = celld_sim.Robot()
    with pytest.raises(KeyError), robot:
        host = robot.host
        assert listens(host, 30004)
        with pytest.raises(celld_sim.SimulatorError, match="runs already"):
            robot.start()
        raise KeyError("what a test may raise")
    assert not listens(host, 30004)
    assert "time factor reached" in robot.log
    with pytest.raises(celld_sim.SimulatorError, match="does not run"):
        robot.dashboard("robotmode")
    robot.stop()
    with robot:
        assert listens(robot.host, 30004)


def test_a_simulator_that_was_killed_is_reported(robot):
    os.kill(robot.pid, signal.SIGKILL)
    wait_until(lambda: not listens(robot._where[0], 30004))
    with pytest.raises(celld_sim.SimulatorError, match="has ended"):
        wait_until(lambda: robot.world() and None)


HOLDER = """
import celld_sim, time
robot = celld_sim.Robot().start()
print(robot.host, flush=True)
time.sleep(60)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_robot_ends_with_python_however_that_ends(number):
    with subprocess.Popen([sys.executable, "-c", HOLDER], stdout=subprocess.PIPE, text=True) as holder:
        host = holder.stdout.readline().strip()
        assert listens(host, 30004)
        holder.send_signal(number)
        holder.wait()
        wait_until(lambda: not listens(host, 30004))


def test_a_robot_ends_with_a_python_that_forgets_it():
    code = "import celld_sim; print(celld_sim.Robot().start().host)"
    host = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.strip()
    wait_until(lambda: not listens(host, 30004))


def test_the_command_is_the_simulator():
    command = os.path.join(os.path.dirname(sys.executable), "celld-sim")
    said = subprocess.run([command, "--version"], check=True, capture_output=True, text=True).stdout
    assert said.startswith("celld-sim ")
    page = subprocess.run([command, "--conformance"], check=True, capture_output=True, text=True).stdout
    assert "modelled" in page


def test_offsets_keep_the_ports_of_robots_apart(robot):
    from celld_sim.addresses import port_offsets

    ports = robot.ports
    own = [ports.gripper, ports.camera, ports.control, 30011, 30012, 30013, ports.interpreter]
    own += [ports.dashboard, ports.primary, ports.secondary, ports.realtime, ports.rtde]
    offsets = sorted({offset for _, offset in zip(range(5000), port_offsets())})
    assert len(offsets) > 100 and max(offsets) + max(own) < 65536
    taken = [port + offset for offset in offsets for port in own]
    assert len(taken) == len(set(taken))


def test_programs_get_what_they_request(robot):
    robot.power_on()
    assert robot.requested() is None
    script = 'def ask():\n n = request_integer_from_primary_client("How many?")\n write_output_integer_register(3, n)\nend\n'
    with socket.create_connection((robot.host, robot.ports.primary)) as link:
        link.sendall(script.encode())
        assert wait_until(robot.requested) == {"type": "integer", "text": "How many?"}
        with pytest.raises(celld_sim.FaultRefused, match="wants a integer"):
            robot.answer("many")
        robot.answer(7)
        assert robot.requested() is None
