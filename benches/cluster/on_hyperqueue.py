"""`celld bench planning` over many machines with HyperQueue: a task a shard, then one table.

In: the celld binary, the folder of a running HyperQueue server (`hq server start`) or a number of workers to
start here, and the arguments of `celld bench planning`. Out: the merged table, in the order of one machine
with one thread; progress on stderr. The same command goes on where an earlier one was: complete shards are
not submitted again, and a shard that was cut short keeps its rows. With --work, and a time limit that is
never reached, the table is that of one machine but for the seconds.

    python3 on_hyperqueue.py --out rows.csv --shards 16 -- --figure rand-pp --solver paper --work 100000
    python3 on_hyperqueue.py --out rows.csv --local 2 -- --figure rand-pp --work 100000

Exit code: 0 the table is there, 1 a shard failed or a table is not as it should be, 2 usage, 130 Ctrl-C.
Needs the Python package `hyperqueue` (tests/cluster/requirements.txt). Tasks are programs with arguments,
not Python functions: the machines need celld and the shared folder, and no Python.
"""

import argparse
import contextlib
import os
import shlex
import signal
import sys
import tempfile
import time
from pathlib import Path

try:
    import hyperqueue
    from hyperqueue.cluster import LocalCluster, WorkerConfig
    from hyperqueue.ffi.protocol import ResourceRequest
except ModuleNotFoundError as missing:
    sys.exit(f"on_hyperqueue: {missing}; first: pip install --no-deps -r tests/cluster/requirements.txt")

sys.path.insert(0, str(Path(__file__).resolve().parent))

import shards
from shards import Trouble


def arguments():
    """What the command line says."""
    opening, rest = __doc__.split("\n\n", 1)
    parser = argparse.ArgumentParser(
        description=opening, epilog=rest, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    shards.add_arguments(parser, out_needed=False)
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--server-dir", type=Path, metavar="DIR", help=(
        "the server's folder (default: ~/.hq-server, as that of `hq`)"))
    where.add_argument("--local", type=shards.positive, metavar="WORKERS", help=(
        "start a server and so many workers here, each with the processors of one task; they end with it"))
    where.add_argument("--speedup", type=counts, metavar="A,B", help=(
        "all shards anew with A workers here, then with B, into tables that are deleted; prints both times"))
    options = parser.parse_args()
    if not (options.out or options.speedup):
        parser.error("--out TABLE is missing")
    return options


def counts(text):
    """Numbers of workers."""
    return [shards.positive(word) for word in text.split(",")]


@contextlib.contextmanager
def said_on_stderr():
    """What the library prints on standard output goes to standard error: a server's ports are no result."""
    sys.stdout.flush()
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


def plain(error):
    """What the library says, without the trace of its own calls."""
    return str(error).split("Stack backtrace")[0].strip()


@contextlib.contextmanager
def local(workers, cpus):
    """A client of a server with workers in this process."""
    with tempfile.TemporaryDirectory(prefix="celld-hyperqueue-") as folder:
        with said_on_stderr():
            cluster = LocalCluster(folder)
            for _ in range(workers):
                cluster.start_worker(WorkerConfig(cores=cpus))
        with cluster:
            yield cluster.client()


@contextlib.contextmanager
def client(options):
    """A client of the server that the command line names."""
    if options.local:
        with local(options.local, options.cpus) as found:
            yield found
        return
    try:
        found = hyperqueue.Client(options.server_dir)
    except Exception as error:
        where = f"--server-dir {options.server_dir}" if options.server_dir else "no --server-dir or --local"
        hint = "a server is started by `hq server start --server-dir DIR`, its workers by `hq worker start`"
        raise Trouble(f"{where}: {plain(error)}\n{hint}", 2) from None
    yield found


class CtrlC:
    """Whether it came: raised within a call of the library it would be lost."""

    came = False

    @staticmethod
    def note(number, frame):
        """The handler of the signal."""
        CtrlC.came = True
        signal.default_int_handler(number, frame)


class Progress:
    """How many runs are done, from the tables of the shards, which grow by a line a run."""

    def __init__(self, benchmark):
        self.benchmark = benchmark
        self.said = None

    def __call__(self, jobs):
        """Called by the library about once a second with the state of its jobs."""
        state = next(iter(jobs.values()))
        tables = map(self.benchmark.table, range(1, self.benchmark.shards + 1))
        runs = sum(max(len(shards.whole_lines(table)) - 1, 0) for table in tables)
        ended = f"{state['finished'] + state['failed']} of {state['total']} shards"
        failed = f", {state['failed']} failed" if state["failed"] else ""
        line = f"{ended}{failed}, {runs} of {len(self.benchmark.runs)} runs"
        # In a log a line a shard is enough.
        said, end = (line, "\r") if sys.stderr.isatty() else (ended, "\n")
        if said != self.said or state["completed"]:
            print(line, end="\n" if state["completed"] else end, file=sys.stderr, flush=True)
        self.said = said


def submit(found, benchmark, left):
    """Submits the shards in `left`, waits for all of them, and returns what failed: its context by shard.

    A shard that fails does not end the others: what they do is done."""
    job = hyperqueue.Job(max_fails=None, name=f"celld {benchmark.folder.stem}")
    for shard in left:
        job.program(
            benchmark.command(shard),
            name=f"shard {shard}",
            cwd=os.getcwd(),
            stdout=benchmark.folder / f"{shard}.out",
            stderr=benchmark.folder / f"{shard}.err",
            resources=ResourceRequest(cpus=benchmark.cpus),
        )
    try:
        submitted = found.submit(job)
        print(f"job {submitted.id}: {len(left)} shards", file=sys.stderr)
        # `wait_for_jobs` of the client draws a bar of tasks; runs say more.
        if not found.connection.wait_for_jobs([submitted.id], Progress(benchmark)):
            return {}
        failed = found.get_failed_tasks(submitted)
    except Exception as error:
        # A server in this process ends by the same Ctrl-C, and its end can come here before Python's signal,
        # which is raised within the pause at the latest.
        time.sleep(0.2)
        if CtrlC.came:
            raise KeyboardInterrupt from None
        raise Trouble(f"the server was lost: {plain(error)}\nthe same command goes on from there") from error
    return {left[task]: context for task, context in failed.items()}


def report(benchmark, failed):
    """Ends the program with the shards that failed, why, and how each is repeated."""
    lines = []
    for shard, context in sorted(failed.items()):
        lines += [f"shard {shard} of {benchmark.shards} failed: {context.error}", *benchmark.said(shard)]
        lines += [f"  alone again: {shlex.join(benchmark.command(shard))}"]
    raise Trouble("\n".join([*lines, "the same command runs what is missing of all shards"]))


def run(options):
    """Runs what is missing and merges."""
    benchmark = shards.prepare(options)
    left = shards.to_do(benchmark)
    if left:
        with client(options) as found:
            try:
                failed = submit(found, benchmark, left)
            except KeyboardInterrupt:
                if not options.local:
                    print("the job goes on; `hq job cancel NUMBER` ends it", file=sys.stderr)
                raise
        if failed:
            report(benchmark, failed)
    print(shards.merge(benchmark, options.out))


def speedup(options):
    """Times the same shards with different numbers of workers; the tables have to agree."""
    seconds, tables = [], []
    with tempfile.TemporaryDirectory(prefix="celld-speedup-") as folder:
        for workers in options.speedup:
            tables.append(Path(folder) / f"{len(tables)}.csv")
            benchmark = shards.prepare(with_out(options, tables[-1]))
            with local(workers, options.cpus) as found:
                begun = time.monotonic()
                failed = submit(found, benchmark, shards.to_do(benchmark))
                seconds.append(time.monotonic() - begun)
            if failed:
                report(benchmark, failed)
            shards.merge(benchmark, tables[-1])
        load = f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors"
        for workers, took in zip(options.speedup, seconds):
            print(f"workers: {workers}, {took:.1f} s, speedup {seconds[0] / took:.2f} ({load})")
        if any(word.split("=")[0] == "--work" for word in options.arguments):
            for other in tables[1:]:
                print(shards.compare(tables[0], other))


def with_out(options, out):
    """The same options for another table."""
    return argparse.Namespace(**{**vars(options), "out": out})


def main():
    """Runs or measures."""
    options = arguments()
    signal.signal(signal.SIGINT, CtrlC.note)
    work = speedup if options.speedup else run
    sys.exit(shards.ended("on_hyperqueue", lambda: work(options)))


main()
