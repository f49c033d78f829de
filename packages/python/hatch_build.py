"""Puts the simulator's program into the wheel.

In: CELLD_SIM_BINARY, the path of a statically linked celld-sim. Out: a wheel for any Python 3 of that
machine's Linux; the program needs no library, so neither glibc nor musl of any version matters.
"""

import os
import struct
from pathlib import Path

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

MACHINES = {62: "x86_64", 183: "aarch64"}
"""By their number in an ELF header."""


class ProgramInside(BuildHookInterface):
    """The build hook."""

    def initialize(self, version, build_data):
        """Names the program's place in the wheel and the wheel's platforms."""
        if version == "editable":
            return
        named = os.environ.get("CELLD_SIM_BINARY")
        if not named or not Path(named).is_file():
            raise SystemExit(f"CELLD_SIM_BINARY: no file {named!r}; `make wheel` builds the program first")
        machine = machine_of(Path(named))
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-manylinux_2_17_{machine}.manylinux2014_{machine}.musllinux_1_1_{machine}"
        build_data["force_include"][named] = "celld_sim/bin/celld-sim"


def machine_of(program):
    """The architecture of an ELF file."""
    header = program.read_bytes()[:20]
    number = struct.unpack_from("<H", header, 18)[0] if header[:4] == b"\x7fELF" else None
    if number not in MACHINES:
        raise SystemExit(f"{program}: not a program for {' or '.join(MACHINES.values())}")
    return MACHINES[number]
