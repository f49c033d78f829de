"""`on_slurm.py` with the real celld and stand-ins for `sbatch` and `squeue` that run a script at once.

What Slurm itself does with these jobs is tried by slurm_node.py (`make check-slurm`), which needs root.
"""

import json
import os
import sys

import pytest
from conftest import BENCHMARK, RUNS, call, cut, spoil

SBATCH = """
import json, os, subprocess, sys
words, script = sys.argv[1:], sys.stdin.read()
named = dict(word.lstrip("-").split("=", 1) for word in words if "=" in word)
folder = os.environ["STAND_IN"]
with open(f"{folder}/calls", "a") as calls:
    calls.write(json.dumps(named) + "\\n")
if "array" in named:
    for task in named["array"].split(","):
        more = {**os.environ, "SLURM_ARRAY_TASK_ID": task}
        with open(named["output"].replace("%a", task), "w") as out, \\
             open(named["error"].replace("%a", task), "w") as err:
            subprocess.run(["sh"], input=script, stdout=out, stderr=err, env=more, text=True)
    print("41;cluster")
else:
    assert named["dependency"] == "afterany:41"
    with open(named["output"], "w") as out:
        code = subprocess.run(["sh"], input=script, stdout=out, stderr=out, text=True).returncode
    print("42")
    sys.exit(code if "--wait" in words else 0)
"""
SQUEUE = """
import os, sys
print(open(os.environ["STAND_IN"] + "/active").read(), end="")
"""


@pytest.fixture
def slurm(tmp_path, celld):
    """Runs the benchmark with the stand-ins in the path; `slurm.folder` holds what they were called with."""
    programs = tmp_path / "programs"
    programs.mkdir()
    for name, text in (("sbatch", SBATCH), ("squeue", SQUEUE)):
        (programs / name).write_text(f"#!{sys.executable}\n{text}")
        (programs / name).chmod(0o755)
    (programs / "active").write_text("")

    def run(*words):
        own = ["--celld", celld, "--out", run.out, "--shards", "3", *words]
        more = {"PATH": f"{programs}:{os.environ['PATH']}", "STAND_IN": str(programs)}
        return call("on_slurm.py", *own, "--", *BENCHMARK, env={**os.environ, **more})

    run.out = tmp_path / "a folder" / "rows.csv"
    run.out.parent.mkdir()
    run.folder = programs
    return run


def arrays(slurm):
    """The arrays that were submitted."""
    calls = map(json.loads, (slurm.folder / "calls").read_text().splitlines())
    return [call for call in calls if "array" in call]


def shard(slurm, number):
    return slurm.out.with_name("rows.csv.shards") / f"{number}.csv"


def test_an_array_and_a_merge_make_the_table_of_one_machine(slurm, same):
    done = slurm("--wait", "--cpus", "2", "--sbatch", "--time=1:00 --partition='some nodes'")
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{slurm.out}: {RUNS} runs of 3 shards\n"
    same(slurm.out)
    (array,) = arrays(slurm)
    assert array["array"] == "1,2,3" and array["cpus-per-task"] == "2"
    assert array["time"] == "1:00" and array["partition"] == "some nodes"


def test_only_what_is_missing_is_submitted_again(slurm, same):
    assert slurm("--wait").returncode == 0
    shard(slurm, 2).unlink()
    kept = cut(shard(slurm, 3))
    assert slurm().returncode == 0
    assert [array["array"] for array in arrays(slurm)] == ["1,2,3", "2,3"]
    assert shard(slurm, 3).read_text().startswith("".join(kept))
    same(slurm.out)
    # Nothing is left: merged here and now.
    slurm.out.unlink()
    assert slurm().returncode == 0 and len(arrays(slurm)) == 2
    same(slurm.out)


def test_a_shard_that_fails_is_named(slurm):
    assert slurm("--wait").returncode == 0
    slurm.out.unlink()
    shard(slurm, 1).unlink()
    spoil(shard(slurm, 2))
    done = slurm("--wait")
    assert done.returncode == 1 and not slurm.out.exists()
    assert "shard 2: 15 of 16 runs are missing" in done.stderr and "2.csv:2: status: " in done.stderr
    assert "shard 1:" not in done.stderr and "shard 3:" not in done.stderr


def test_a_job_that_still_runs_is_not_submitted_twice(slurm):
    assert slurm("--wait").returncode == 0
    shard(slurm, 2).unlink()
    (slurm.folder / "active").write_text("41_2\n")
    done = slurm("--wait")
    assert done.returncode == 1 and "job 41 still waits or runs" in done.stderr
    assert len(arrays(slurm)) == 1


def test_a_computer_without_slurm_is_said(tmp_path, celld):
    own = ["--celld", celld, "--out", tmp_path / "rows.csv", "--", *BENCHMARK]
    done = call("on_slurm.py", *own, env={"PATH": str(tmp_path)})
    assert done.returncode == 2 and "needs a computer with Slurm" in done.stderr
