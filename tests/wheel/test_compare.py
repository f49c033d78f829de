"""`celld-sim compare` with what ur_rtde's own recorder writes.

The recorded arm is a simulated one in real time over sockets; the one it is compared with is driven by
calls, with the kinematics of another arm of its model.
"""

import json
import socket
import subprocess
import time

import celld_sim
import pytest
import rtde_receive
from conftest import wait_until

PROGRAM = """def work():
  movej([-1.6, -1.9, 1.8, -1.5, -1.57, 0.1], a=3, v=2)
  sleep(0.3)
  movel(pose_trans(get_actual_tcp_pose(), p[0, 0, -0.05, 0, 0, 0]), a=1.2, v=0.25)
  movej([-1.5, -1.8, 1.7, -1.47, -1.57, 0.2], a=3, v=2)
end
"""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A recording and the script that it is of."""
    folder = tmp_path_factory.mktemp("recorded")
    csv, script = folder / "arm.csv", folder / "work.script"
    script.write_text(PROGRAM)
    with celld_sim.Robot(model="UR5e", running=True) as robot:
        receive = rtde_receive.RTDEReceiveInterface(robot.host, 500.0)
        assert receive.startFileRecording(str(csv))
        with socket.create_connection((robot.host, robot.ports.secondary)) as link:
            link.sendall(PROGRAM.encode())
            wait_until(lambda: "true" in robot.dashboard("running"))
            wait_until(lambda: "false" in robot.dashboard("running"))
        time.sleep(0.2)
        receive.stopFileRecording()
        receive.disconnect()
    return csv, script


def compare(*arguments):
    """Exit code, standard output and standard error."""
    command = [celld_sim.program(), "compare", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True)
    return done.returncode, done.stdout, done.stderr


def test_a_recording_agrees_with_its_program(recorded):
    code, page, errors = compare(*recorded)
    assert code == 0, page + errors
    assert page.endswith("within the tolerances\n")
    code, text, _ = compare(*recorded, "--format", "json", "--model", "UR5e")
    found = json.loads(text)
    assert code == 0 and found["within"] and found["beyond"] == []
    comparison = found["comparison"]
    # Between the last two the arm rests for a moment only.
    assert len(comparison["motions"]) == 3 and comparison["samples"] > 500
    assert [state["name"] for state in comparison["states"]] == ["robot_mode", "safety_mode", "runtime_state"]
    assert max(joint["largest_rad"] for joint in comparison["joints"]) < 0.01


def test_another_program_and_another_tolerance_do_not_agree(recorded, tmp_path):
    csv, script = recorded
    other = tmp_path / "other.script"
    other.write_text(PROGRAM.replace("-0.05", "-0.15"))
    code, page, _ = compare(csv, other)
    assert code == 1 and "beyond the tolerances: joint" in page
    code, text, _ = compare(csv, script, "--joint-tolerance", "0", "--format", "json")
    assert code == 1 and not json.loads(text)["within"]


def test_what_is_no_recording_or_no_program_is_said(recorded, tmp_path):
    csv, script = recorded
    lines = csv.read_text().splitlines(keepends=True)
    half = tmp_path / "half.csv"
    half.write_text("".join([*lines[:5], "1.0,2.0\n", *lines[5:]]))
    assert compare(half, script)[0] == 2
    assert "half.csv: line 6: 2 values for" in compare(half, script)[2]
    bad = tmp_path / "bad.script"
    bad.write_text("def work():\n nowhere()\nend\n")
    code, _, errors = compare(csv, bad)
    assert code == 2 and "bad.script:2:2: name not found: nowhere" in errors
    assert compare(tmp_path / "none.csv", script)[0] == 2
    assert compare(csv)[0] == 2
