"""What the tests of `benches/cluster` share: the real celld, a small benchmark, its table of one machine.

In: the binary's path in the environment variable CELLD_BINARY (`make test-cluster` sets it). The benchmark
ends by a work limit, never by a time limit: all columns but the seconds are the same in every run of it.
"""

import contextlib
import fcntl
import os
import subprocess
import sys
from pathlib import Path

import pytest

SOURCES = Path(__file__).resolve().parents[2] / "benches" / "cluster"
sys.path.insert(0, str(SOURCES))

BENCHMARK = [
    *["--scenario", "rand,sq", "--density", "0.3,0.4", "--n", "12", "--count", "3", "--solver", "rbm,auto"],
    *["--seed", "0,1", "--work", "3000", "--time-limit", "600"],
]
"""2 * 2 cells of 3 cases, each run by 2 solvers with 2 seeds; the work limit ends half of the runs."""
RUNS = 48
LONG = 120.0
"""Longest wait for anything, s: far above what is expected, so that a busy computer fails nothing."""


def call(program, *words, **more):
    """A program of benches/cluster, run to its end."""
    command = [sys.executable, "-B", SOURCES / program, *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=LONG, check=False, **more)


@pytest.fixture(scope="session")
def celld():
    """The binary under test."""
    path = Path(os.environ["CELLD_BINARY"])
    assert path.is_file(), path
    return path


@pytest.fixture(scope="session")
def one_machine(celld, tmp_path_factory):
    """The benchmark's table of one machine with one thread."""
    table = tmp_path_factory.mktemp("one") / "machine.csv"
    command = [celld, "bench", "planning", *BENCHMARK, "--threads", "1", "--out", table]
    subprocess.run(command, capture_output=True, timeout=LONG, check=True)
    text = table.read_text()
    assert len(text.splitlines()) == RUNS + 1
    assert all(f",{status}," in text for status in ("optimal", "solved", "timeout"))
    return table


@pytest.fixture
def same(one_machine):
    """Asserts that a table is the one machine's but for the seconds, row by row in the same order."""

    def check(table):
        done = call("shards.py", "compare", one_machine, table)
        assert done.returncode == 0, done.stderr
        assert f"the same {RUNS} rows" in done.stdout

    return check


@contextlib.contextmanager
def held(table):
    """Holds a table as another run of its shard does: celld refuses to write to it then."""
    table.parent.mkdir(exist_ok=True)
    with table.open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def spoil(table):
    """Leaves of a table a part that celld refuses to go on with: its task fails."""
    head, row, *_ = cut(table)
    fields = row.split(",")
    fields[7] = "?"
    table.write_text(head + ",".join(fields))


def cut(table):
    """Leaves of a table its head, some rows and half a row, as a kill in the middle of a write does."""
    lines = table.read_text().splitlines(keepends=True)
    kept = lines[: len(lines) // 2]
    assert len(kept) > 2
    table.write_text("".join(kept) + lines[len(kept)][:20])
    return kept
