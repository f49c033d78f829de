"""A simulated UR robot for tests: celld-sim as a context manager.

In: what robot to simulate. Out: a running controller on an address of its own, with its ports, faults on
demand and the truth about its world.

    with celld_sim.Robot(model="UR5e") as robot:
        control = rtde_control.RTDEControlInterface(robot.host)
"""

from celld_sim.addresses import Gripper, Ports
from celld_sim.errors import FaultRefused, SimulatorError
from celld_sim.program import program
from celld_sim.robot import MODELS, Robot
from celld_sim.world import Channel, Contact, Event, Faults, Thing, Timing, World

__all__ = [
    "MODELS",
    "Channel",
    "Contact",
    "Event",
    "FaultRefused",
    "Faults",
    "Gripper",
    "Ports",
    "Robot",
    "SimulatorError",
    "Thing",
    "Timing",
    "World",
    "program",
]
