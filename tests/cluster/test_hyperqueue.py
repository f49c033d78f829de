"""The benchmark over a real HyperQueue server with real workers on this computer, with the real celld."""

import fcntl
import signal
import subprocess
import sys
import time

from conftest import BENCHMARK, LONG, RUNS, SOURCES, call, cut, held, spoil

SERVER = """
import sys
from hyperqueue.cluster import LocalCluster, WorkerConfig
with LocalCluster(sys.argv[1]) as cluster:
    cluster.start_worker(WorkerConfig(cores=2))
    print("ready", flush=True)
    sys.stdin.read()
"""


def run(celld, out, *words, shards=3):
    """The benchmark in shards."""
    own = ["--celld", celld, "--out", out, "--shards", str(shards), *words]
    return call("on_hyperqueue.py", *own, "--", *BENCHMARK)


def shard(out, number):
    """The table of a shard."""
    return out.with_name(f"{out.name}.shards") / f"{number}.csv"


def test_two_workers_make_the_table_of_one_machine(celld, tmp_path, same):
    out = tmp_path / "a folder" / "rows.csv"
    out.parent.mkdir()
    done = run(celld, out, "--local", "2", shards=5)
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{out}: {RUNS} runs of 5 shards\n"
    assert f"5 of 5 shards, {RUNS} of {RUNS} runs" in done.stderr
    same(out)
    assert all(len(shard(out, number).read_text().splitlines()) > 1 for number in range(1, 6))


def test_a_task_with_two_processors_changes_no_order(celld, tmp_path, same):
    out = tmp_path / "rows.csv"
    done = run(celld, out, "--local", "1", "--cpus", "2")
    assert done.returncode == 0, done.stderr
    same(out)


def test_only_what_is_missing_is_run_again(celld, tmp_path, same):
    out = tmp_path / "rows.csv"
    assert run(celld, out, "--local", "2").returncode == 0
    first = out.read_text()
    whole = shard(out, 1).stat().st_mtime_ns
    shard(out, 2).unlink()
    kept = cut(shard(out, 3))
    out.unlink()
    done = run(celld, out, "--local", "2")
    assert done.returncode == 0, done.stderr
    assert "1 shards complete" in done.stderr and ": 2 shards\n" in done.stderr
    same(out)
    assert shard(out, 1).stat().st_mtime_ns == whole
    # With the seconds of the first run: they are its rows.
    assert shard(out, 3).read_text().startswith("".join(kept))
    assert all(line in first for line in kept)

    before = out.read_text()
    # Without a server: there is nothing to submit.
    done = run(celld, out, "--server-dir", tmp_path / "none")
    assert done.returncode == 0 and out.read_text() == before


def test_a_shard_that_fails_is_named_and_the_others_are_done(celld, tmp_path, same):
    out = tmp_path / "rows.csv"
    assert run(celld, out, "--local", "1").returncode == 0
    out.unlink()
    shard(out, 1).unlink()
    spoil(shard(out, 2))
    shard(out, 3).unlink()
    done = run(celld, out, "--local", "1")
    assert done.returncode == 1 and not out.exists()
    assert "shard 2 of 3 failed" in done.stderr and "2.csv:2: status: " in done.stderr
    assert "alone again: " in done.stderr and f"--shard 2/3 --out {shard(out, 2)}" in done.stderr
    assert "shard 1 of 3 failed" not in done.stderr and "shard 3 of 3 failed" not in done.stderr
    shard(out, 2).unlink()
    again = run(celld, out, "--local", "1")
    assert again.returncode == 0, again.stderr
    assert "2 shards complete" in again.stderr
    same(out)


def test_a_shard_that_a_task_runs_is_not_submitted_again(celld, tmp_path):
    out = tmp_path / "rows.csv"
    with held(shard(out, 2)):
        done = run(celld, out, "--local", "1")
    assert done.returncode == 1 and "shard 2: a task writes to" in done.stderr
    assert not shard(out, 1).exists()


def test_a_table_that_can_not_be_merged_is_not_run_on(celld, tmp_path):
    out = tmp_path / "rows.csv"
    assert run(celld, out, "--local", "1").returncode == 0
    row = shard(out, 1).read_text().splitlines(keepends=True)[1]
    shard(out, 2).write_text(shard(out, 2).read_text() + row)
    shard(out, 3).unlink()
    done = run(celld, out, "--local", "1")
    assert done.returncode == 1 and "2.csv:" in done.stderr and "1.csv:2 too" in done.stderr
    assert not shard(out, 3).exists()


def test_a_server_that_runs_already_is_found_by_its_folder(celld, tmp_path, same):
    folder, out = tmp_path / "server", tmp_path / "rows.csv"
    folder.mkdir()
    command = [sys.executable, "-c", SERVER, str(folder)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert any(line == "ready\n" for line in server.stdout)
            done = run(celld, out, "--server-dir", folder)
            server.communicate("", timeout=LONG)
        finally:
            server.kill()
    assert done.returncode == 0, done.stderr
    same(out)


def test_no_server_and_no_program_are_said_in_a_few_lines(celld, tmp_path):
    done = run(celld, tmp_path / "rows.csv", "--server-dir", tmp_path / "none")
    assert done.returncode == 2 and "hq server start" in done.stderr
    assert len(done.stderr.splitlines()) < 10, done.stderr
    done = run(tmp_path / "none", tmp_path / "rows.csv", "--local", "1")
    assert done.returncode == 2 and "no such program" in done.stderr


def test_after_ctrl_c_no_task_is_left_and_every_row_stays(celld, tmp_path):
    out = tmp_path / "rows.csv"
    # The case of 5 objects ends at once, that of 30 at its time limit.
    words = ["--scenario", "sq", "--density", "0.4", "--n", "5,30", "--count", "1", "--solver", "auto"]
    command = [sys.executable, "-B", SOURCES / "on_hyperqueue.py", "--celld", celld, "--out", out]
    command += ["--shards", "1", "--local", "1", "--", *words, "--time-limit", "600"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as program:
        try:
            end = time.monotonic() + LONG
            while not (shard(out, 1).exists() and len(shard(out, 1).read_text().splitlines()) > 1):
                assert time.monotonic() < end and program.poll() is None
                time.sleep(0.01)
            program.send_signal(signal.SIGINT)
            _, said = program.communicate(timeout=LONG)
        finally:
            program.kill()
    assert program.returncode == 130 and "goes on from there" in said, said
    with shard(out, 1).open() as table:
        # Ends when the task's lock is gone, and with it the task.
        fcntl.flock(table, fcntl.LOCK_EX)
        assert len(table.read().splitlines()) == 2


def test_the_speedup_is_printed_and_both_tables_agree(celld, tmp_path):
    done = run(celld, tmp_path / "rows.csv", "--speedup", "1,2")
    assert done.returncode == 0, done.stderr
    assert "workers: 1, " in done.stdout and "workers: 2, " in done.stdout and "speedup " in done.stdout
    assert f"the same {RUNS} rows" in done.stdout
    assert list(tmp_path.iterdir()) == []
