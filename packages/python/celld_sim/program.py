"""The simulator's program: where it is, and `celld-sim` at a prompt."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import NoReturn

from celld_sim.errors import SimulatorError

VARIABLE = "CELLD_SIM"
"""Environment variable with the path of another program."""

_INSIDE = Path(__file__).with_name("bin") / "celld-sim"


def program() -> str:
    """Path of the program: what CELLD_SIM names, the one in this package, or `celld-sim` of the PATH."""
    named = os.environ.get(VARIABLE)
    if named:
        return os.path.abspath(named)
    if _INSIDE.is_file():
        return str(_INSIDE)
    found = shutil.which("celld-sim")
    if found is None:
        raise SimulatorError(
            f"no celld-sim: this package has none for {sys.platform}, and there is none in the PATH; "
            f"build it (cargo build --release -p ur-sim) and name it in the variable {VARIABLE}"
        )
    return found


def main() -> NoReturn:
    """Becomes the program, with the arguments of this one."""
    # The command that runs this has the same name; the PATH would only find it again.
    inside = os.environ.get(VARIABLE) or str(_INSIDE)
    try:
        os.execv(inside, ["celld-sim", *sys.argv[1:]])
    except OSError as error:
        sys.exit(f"celld-sim: {inside}: {error.strerror}")
