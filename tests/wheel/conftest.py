"""What the tests of the wheel share. They run where the wheel is installed, never from the sources."""

import socket
import time
from pathlib import Path

import celld_sim
import pytest

pytest_plugins = ["pytester"]

LONG = 30.0
"""Longest wait for anything, s: far above what is expected, so that a busy computer fails nothing."""


def wait_until(condition, seconds=LONG):
    """What a condition returns once it is true."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(0.005)
    raise AssertionError(f"not within {seconds} s")


def listens(host, port):
    """Whether a server accepts connections."""
    try:
        socket.create_connection((host, port), timeout=LONG).close()
    except (ConnectionRefusedError, ConnectionResetError):
        # Reset: it closed while the connection was on its way.
        return False
    return True


@pytest.fixture(scope="session", autouse=True)
def installed():
    """The package under test is the one of the wheel, with its program inside."""
    assert "site-packages" in celld_sim.__file__
    assert Path(celld_sim.program()).parent == Path(celld_sim.__file__).parent / "bin"


@pytest.fixture
def robot():
    """A UR5e as it is after boot."""
    with celld_sim.Robot(model="UR5e") as robot:
        yield robot
