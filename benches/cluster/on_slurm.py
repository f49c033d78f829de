"""`celld bench planning` over many machines with Slurm: an array job with a task a shard, then one table.

In: the celld binary and the arguments of `celld bench planning`; Slurm's `sbatch` and `squeue`. Out: two
jobs: the array over the shards that are not complete, and the merge, which begins when the array has ended
and names what is missing. The same command goes on where an earlier one was, say after a time limit. With
--work, and a time limit that is never reached, the table is that of one machine but for the seconds.

    python3 on_slurm.py --out rows.csv --shards 16 --cpus 4 --sbatch='--time=24:00:00' \\
      -- --figure all --solver paper --first --count 50 --time-limit 600

Exit code: 0 the jobs are submitted, with --wait: the table is there; 1 a shard failed or a table is not as
it should be; 2 usage; 130 Ctrl-C. Every node has to see celld, this folder and that of the table, at the
same paths.
"""

import argparse
import shlex
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import shards
from shards import Trouble


def arguments():
    """What the command line says."""
    opening, rest = __doc__.split("\n\n", 1)
    parser = argparse.ArgumentParser(
        description=opening, epilog=rest, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    shards.add_arguments(parser)
    parser.add_argument("--sbatch", action="append", default=[], metavar="OPTIONS", help=(
        "further options of sbatch for the array, such as --sbatch='--time=24:00:00 --partition=cpu'"))
    parser.add_argument("--wait", action="store_true", help="wait until the table is there, or is not")
    return parser.parse_args()


def call(command, script=None):
    """What a program of Slurm says."""
    try:
        done = subprocess.run(command, input=script or "", capture_output=True, text=True, check=False)
    except FileNotFoundError:
        raise Trouble(f"{command[0]}: no such program; this needs a computer with Slurm", 2) from None
    if done.returncode != 0:
        raise Trouble(f"{shlex.join(command)}\n{done.stderr.strip()}", 2)
    return done.stdout.strip()


def refuse_while_running(benchmark):
    """Two tasks of a shard would be in each other's way: the second fails at the lock of the table."""
    noted = benchmark.folder / "slurm-job"
    if not noted.exists():
        return
    job = noted.read_text().strip()
    # A job that Slurm has forgotten makes squeue fail.
    command = ["squeue", "--noheader", "--jobs", job, "--format", "%i"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode == 0 and done.stdout.strip():
        raise Trouble(f"job {job} still waits or runs; let it end, or end it with `scancel {job}`")


def array_script(benchmark):
    """What every task runs: `Benchmark.command` with the shard that Slurm gives the task."""
    own = f'--shard "$SLURM_ARRAY_TASK_ID/{benchmark.shards}"'
    table = f'--out {shlex.quote(str(benchmark.folder))}/"$SLURM_ARRAY_TASK_ID.csv"'
    return f"#!/bin/sh\nexec {shlex.join(benchmark.shared_words())} {own} {table}\n"


def submit_array(benchmark, left, more):
    """Submits the shards in `left` as one array and returns its number."""
    command = ["sbatch", "--parsable", f"--job-name=celld-{benchmark.folder.stem}"]
    command += [f"--array={','.join(map(str, left))}", f"--cpus-per-task={benchmark.cpus}"]
    command += [f"--output={benchmark.folder}/%a.out", f"--error={benchmark.folder}/%a.err"]
    command += [word for words in more for word in shlex.split(words)]
    return call(command, array_script(benchmark)).split(";")[0]


def submit_merge(benchmark, job, options):
    """Submits the merge, to begin when all tasks have ended, well or not: it says what is missing."""
    log = benchmark.folder / "merge.out"
    log.unlink(missing_ok=True)
    merge = [sys.executable, shards.__file__, "merge", benchmark.folder, "--out", options.out.resolve()]
    command = ["sbatch", "--parsable", f"--job-name=celld-merge-{benchmark.folder.stem}"]
    command += [f"--dependency=afterany:{job}", f"--output={log}"]
    command += ["--wait"] if options.wait else []
    script = f"#!/bin/sh\nexec {shlex.join(map(str, merge))}\n"
    print(f"job {job}: {options.out} is made when it has ended; {log} says how that went", file=sys.stderr)
    done = subprocess.run(command, input=script, capture_output=True, text=True, check=False)
    said = log.read_text() if log.exists() else ""
    if done.returncode != 0:
        raise Trouble(f"{done.stderr.strip()}\n{said.strip()}".strip())
    print(said, end="")


def run(options):
    """Submits what is missing; merges at once when nothing is."""
    benchmark = shards.prepare(options)
    refuse_while_running(benchmark)
    left = shards.to_do(benchmark)
    if not left:
        print(shards.merge(benchmark, options.out))
        return
    job = submit_array(benchmark, left, options.sbatch)
    shards.replace(benchmark.folder / "slurm-job", job + "\n")
    submit_merge(benchmark, job, options)


def main():
    """Runs."""
    options = arguments()
    sys.exit(shards.ended("on_slurm", lambda: run(options)))


main()
