"""The pytest plugin of the wheel, its README and its type hints, as a user of the wheel meets them."""

import re
import subprocess
import sys
from pathlib import Path

README = Path(__file__).parents[2] / "packages" / "python" / "README.md"


def test_the_fixture_is_a_running_robot_for_each_test(pytester):
    pytester.makepyfile(
        """
        hosts = set()

        def test_one(ur_robot):
            hosts.add(ur_robot.host)
            assert ur_robot.dashboard("robotmode") == "Robotmode: RUNNING"
            assert ur_robot.dashboard("get robot model") == "UR5"

        def test_two(ur_robot):
            assert ur_robot.host not in hosts
        """
    )
    pytester.runpytest_subprocess("-p", "no:cacheprovider").assert_outcomes(passed=2)


def test_markers_and_options_choose_the_robot_and_the_nearest_marker_decides(pytester):
    pytester.makepyfile(
        """
        import pytest

        pytestmark = pytest.mark.ur_robot(model="UR3e")

        def test_by_module(ur_robot):
            assert ur_robot.dashboard("get robot model") == "UR3"
            assert "5.13.1" in ur_robot.dashboard("PolyscopeVersion")

        @pytest.mark.ur_robot("UR16e", software="5.20.0", running=False)
        def test_by_its_own(ur_robot):
            assert ur_robot.dashboard("get robot model") == "UR16"
            assert "5.20.0" in ur_robot.dashboard("PolyscopeVersion")
            assert ur_robot.dashboard("robotmode") == "Robotmode: POWER_OFF"
        """
    )
    options = ["-p", "no:cacheprovider", "--strict-markers", "--ur-software", "5.13.1", "--ur-model", "UR20"]
    pytester.runpytest_subprocess(*options).assert_outcomes(passed=2)
    pytester.makepyfile(
        """
        def test_by_the_option(ur_robot):
            assert ur_robot.dashboard("get robot model") == "UR20"
            assert ur_robot.time_factor == 5.0
        """
    )
    pytester.runpytest_subprocess(*options, "--ur-time-factor", "5").assert_outcomes(passed=1)


def test_a_failing_test_shows_what_the_simulator_wrote(pytester):
    pytester.makepyfile("def test_fails(ur_robot):\n    assert False\n")
    result = pytester.runpytest_subprocess("-p", "no:cacheprovider")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*celld-sim: time factor reached*"])


def test_a_robot_that_does_not_start_is_an_error_with_its_words(pytester):
    pytester.makepyfile(
        """
        import pytest

        @pytest.mark.ur_robot(model="UR9")
        def test_never_begins(ur_robot):
            pass
        """
    )
    result = pytester.runpytest_subprocess("-p", "no:cacheprovider")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines(["*give one of UR5e*"])


def test_the_examples_of_the_readme_run(pytester):
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    assert len(blocks) == 2
    subprocess.run([sys.executable, "-c", blocks[0]], check=True)
    pytester.makepyfile(blocks[1])
    pytester.runpytest_subprocess("-p", "no:cacheprovider").assert_outcomes(passed=2)


def typed(path):
    """What mypy says of a file that uses the installed package."""
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(path.parent / "cache"), str(path)]
    return subprocess.run(command, capture_output=True, text=True)


def test_type_hints_hold_and_are_seen_by_users(tmp_path):
    user = tmp_path / "user.py"
    user.write_text(
        "import celld_sim\n"
        "with celld_sim.Robot(model='UR5e') as robot:\n"
        "    host: str = robot.host\n"
        "    port: int = robot.ports.rtde\n"
        "    tilt: float = robot.world()['objects'][0]['tilt_rad']\n"
    )
    checked = typed(user)
    assert checked.returncode == 0, checked.stdout
    user.write_text("import celld_sim\nport: str = celld_sim.Robot().ports.rtde\n")
    assert "Incompatible types" in typed(user).stdout
    inside = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(tmp_path / "cache"), "-p", "celld_sim"],
        capture_output=True,
        text=True,
    )
    assert inside.returncode == 0, inside.stdout
