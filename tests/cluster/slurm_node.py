"""Slurm on this one computer, in a folder of its own, and the planning benchmark over it.

In: the celld binary; Debian's packages `slurm-wlm` and `munge`; root, which Slurm's daemons need. Out: a
line for each thing that holds, exit code 0 if all do. Three daemons run for it and end with it: munged (who
sends a message), slurmctld (the queue) and slurmd (the node), on free ports, with sockets, keys, state and
logs in the folder. Nothing of the system's own Slurm is read or written. It works without cgroups, so in a
container too: processes are found by their parents (`proctrack/linuxproc`), tasks are bound to no processor.

    target/cluster/bin/python tests/cluster/slurm_node.py target/debug/celld [FOLDER]

That Python is the one of `make test-cluster`. The folder stays if one is named or something fails: its *.log
say why.
"""

import contextlib
import os
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from conftest import BENCHMARK, LONG, RUNS, SOURCES, cut, spoil

READY = 60.0
"""Longest wait for the daemons, s."""
CONFIGURATION = """\
ClusterName=celld
SlurmctldHost={host}(127.0.0.1)
SlurmUser=root
SlurmctldPort={controller_port}
SlurmdPort={node_port}
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
CredType=cred/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
MpiDefault=none
ReturnToService=2
NodeName={host} NodeAddr=127.0.0.1 CPUs={cpus} State=UNKNOWN
PartitionName=all Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""


def free_ports(count):
    """Ports that are free now."""
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(count)]
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [one.getsockname()[1] for one in sockets]


def configure(folder):
    """Writes key and configuration."""
    for name in ("state", "spool"):
        (folder / name).mkdir()
    # munged wants to see that its socket can be reached, and the key can not.
    folder.chmod(0o755)
    key = folder / "munge.key"
    key.touch(0o600)
    key.write_bytes(secrets.token_bytes(1024))
    controller_port, node_port = free_ports(2)
    text = CONFIGURATION.format(
        host=socket.gethostname().split(".")[0], folder=folder, controller_port=controller_port,
        node_port=node_port, cpus=os.cpu_count(),
    )
    (folder / "slurm.conf").write_text(text)


def munged(folder):
    """The command of the daemon that says who sends a message."""
    files = [("key-file", "munge.key"), ("socket", "munge.socket"), ("pid-file", "munged.pid")]
    files += [("seed-file", "munged.seed")]
    # --force: a folder below /tmp, whose sticky bit it does not count.
    return ["munged", "--foreground", "--force", *(f"--{name}={folder / file}" for name, file in files)]


@contextlib.contextmanager
def node(folder):
    """The daemons, until the node waits for jobs; ends them afterwards, last begun first."""
    configure(folder)
    os.environ["SLURM_CONF"] = str(folder / "slurm.conf")
    # Slurm puts the variables of a job around this one into its own jobs.
    for name in [name for name in os.environ if name.startswith("SLURM_") and name != "SLURM_CONF"]:
        del os.environ[name]
    with contextlib.ExitStack() as stack:
        for command in (munged(folder), ["slurmctld", "-D"], ["slurmd", "-D"]):
            log = stack.enter_context((folder / f"{command[0]}.out.log").open("w"))
            daemon = stack.enter_context(subprocess.Popen(command, stdout=log, stderr=log))
            stack.callback(daemon.terminate)
            if command[0] == "munged":
                until(lambda: (folder / "munge.socket").exists(), "munged")
        until(lambda: "idle" in output_of("sinfo", "--noheader", "--format=%T"), "the node")
        yield


def output_of(*command):
    """What a program says, if it says something in time."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=LONG, check=False)
    return done.stdout if done.returncode == 0 else ""


def until(holds, what):
    """Waits for something."""
    end = time.monotonic() + READY
    while not holds():
        if time.monotonic() > end:
            raise AssertionError(f"{what}: not ready within {READY:.0f} s")
        time.sleep(0.1)


def holds(what, condition, said=""):
    """Notes what was found; the first that does not hold ends the check."""
    print(f"{'ok' if condition else 'FAILED'}  {what}", flush=True)
    if not condition:
        raise AssertionError(said)


def submit(celld, out):
    """The benchmark as an array of four, awaited."""
    command = [sys.executable, "-B", SOURCES / "on_slurm.py", "--celld", celld, "--out", out, "--wait"]
    command += ["--shards", "4", "--", *BENCHMARK]
    return subprocess.run(command, capture_output=True, text=True, timeout=5 * LONG, check=False)


def same(out, single):
    """Whether the table is that of one machine; what it says."""
    command = [sys.executable, "-B", SOURCES / "shards.py", "compare", single, out]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.returncode == 0, done.stdout + done.stderr


def check(celld, folder):
    """What has to hold."""
    out, single = folder / "rows.csv", folder / "one-machine.csv"
    command = [celld, "bench", "planning", *BENCHMARK, "--threads", "1", "--out", single]
    subprocess.run(command, capture_output=True, check=True)
    begun = time.monotonic()
    done = submit(celld, out)
    took = time.monotonic() - begun
    holds(f"an array of 4 tasks and its merge end well ({took:.1f} s)", done.returncode == 0, done.stderr)
    holds(f"the merged table is that of one machine ({RUNS} runs)", *same(out, single))

    shards = folder / "rows.csv.shards"
    whole = (shards / "1.csv").stat().st_mtime_ns
    (shards / "2.csv").unlink()
    kept = cut(shards / "3.csv")
    out.unlink()
    done = submit(celld, out)
    holds("a deleted table and a cut one are run again", done.returncode == 0, done.stderr)
    holds("of the cut one what was there stays", (shards / "3.csv").read_text().startswith("".join(kept)))
    holds("complete ones are left alone", (shards / "1.csv").stat().st_mtime_ns == whole)
    holds("the table is that of one machine again", *same(out, single))

    spoil(shards / "2.csv")
    out.unlink()
    done = submit(celld, out)
    failed = done.returncode == 1 and "shard 2: " in done.stderr and "2.csv:2: status: " in done.stderr
    holds("a shard that fails is named, and there is no table", failed and not out.exists(), done.stderr)


def main():
    """Sets up, checks, takes down."""
    if os.geteuid() != 0:
        sys.exit("slurm_node: Slurm's daemons need root")
    for program in ("munged", "slurmctld", "slurmd", "sbatch"):
        if shutil.which(program) is None:
            sys.exit(f"slurm_node: no {program}; first: apt-get install slurm-wlm munge")
    celld = Path(sys.argv[1]).resolve()
    named = len(sys.argv) > 2
    folder = Path(sys.argv[2]).resolve() if named else Path(tempfile.mkdtemp(prefix="celld-slurm-"))
    folder.mkdir(exist_ok=True)
    try:
        with node(folder):
            check(celld, folder)
    except (AssertionError, subprocess.SubprocessError) as failure:
        sys.exit(f"{failure}\nslurm_node: the logs are in {folder}")
    if not named:
        shutil.rmtree(folder)


main()
