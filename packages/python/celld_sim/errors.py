"""What goes wrong: the simulator's own words, and what was being done."""

from __future__ import annotations


class SimulatorError(RuntimeError):
    """The simulator did not start, ended, or did not answer; the text has its own words."""


class FaultRefused(ValueError):
    """The simulator cannot carry out a fault; the text is its reason."""
