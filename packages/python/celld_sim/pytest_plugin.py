"""The pytest fixture `ur_robot`: a robot of its own for each test.

In: the marker `@pytest.mark.ur_robot(model="UR10e", ...)` with options of `celld_sim.Robot`, and the
options `--ur-model`, `--ur-software` and `--ur-time-factor` for tests that do not say. Out: a running
robot, powered on with open brakes unless the marker says `running=False`; it ends with the test. What the
simulator wrote is shown beside a test that fails.
"""

from __future__ import annotations

from typing import Any, Dict, Iterator

import pytest

from celld_sim.robot import MODELS, Robot

_OPTIONS = {"ur_model": "model", "ur_software": "software", "ur_time_factor": "time_factor"}


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options for the whole run."""
    group = parser.getgroup("celld-sim", "simulated UR robots")
    group.addoption("--ur-model", choices=MODELS, help="arm of the fixture ur_robot (default: UR5e)")
    group.addoption("--ur-software", metavar="VERSION", help="software version of its controller, as 5.13.0")
    group.addoption("--ur-time-factor", type=float, metavar="F", help="simulated seconds per second (default: 1)")


def pytest_configure(config: pytest.Config) -> None:
    """Makes the marker known."""
    config.addinivalue_line(
        "markers", "ur_robot(model, **options): what robot the fixture ur_robot is; options of celld_sim.Robot"
    )


@pytest.fixture
def ur_robot(request: pytest.FixtureRequest) -> Iterator[Robot]:
    """A running celld_sim.Robot, power on and brakes open, on an address of its own."""
    options: Dict[str, Any] = {"running": True}
    for option, name in _OPTIONS.items():
        value = request.config.getoption(option)
        if value is not None:
            options[name] = value
    # From the module's marker down to the test's own: the nearest decides.
    for marker in reversed(list(request.node.iter_markers("ur_robot"))):
        options.update(zip(("model",), marker.args))
        options.update(marker.kwargs)
    robot = Robot(**options)
    try:
        with robot:
            yield robot
    finally:
        if robot.log:
            print(f"celld-sim: {robot.log.strip()}")
