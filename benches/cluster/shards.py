"""A planning benchmark in shards: which runs each shard has, what is done of them, and one table of all.

In: the celld binary, the arguments of `celld bench planning`, a number of shards, and a folder that all
machines share. Out: the command of each shard; which runs are missing; the merged table, whose rows are in
the order of one machine with one thread. Which runs there are, in which order and in which shard, comes from
celld: with a time limit of 0 s it lists every run and searches for no plan. What is written here is a
merge that can fail: `cat` takes a shard twice, half a shard, or a shard of another command without a word.

    python3 benches/cluster/shards.py merge rows.csv.shards --out rows.csv
    python3 benches/cluster/shards.py compare rows.csv one-machine.csv

Used by on_hyperqueue.py and on_slurm.py; needs Python alone.
"""

import argparse
import collections
import dataclasses
import fcntl
import json
import os
import shlex
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

MOST_FAULTS = 10
"""Faults of a table that are shown; the others are counted."""
TAIL = 10
"""Lines of a failed shard's messages that are shown."""
OURS = {
    "--shard": "the shards are made here: --shards N, before the `--`",
    "--out": "each shard has a table of its own: --out TABLE for the merged one, before the `--`",
    "--format": "the rows go to tables: leave it out",
    "--threads": "it has to agree with what a task may use: --cpus N, before the `--`",
}
"""Options of `celld bench planning` that are given by these programs, and what to write in their place."""


class Trouble(Exception):
    """What ends a program: a text for people, and the exit code."""

    def __init__(self, text, code=1):
        super().__init__(text)
        self.code = code


@dataclasses.dataclass
class Benchmark:
    """One command in shards, with the folder that holds its state: `runs.json`, and a table a shard."""

    folder: Path
    celld: str
    arguments: list
    shards: int
    cpus: int
    head: str = ""
    runs: dict = dataclasses.field(default_factory=dict)
    """Shard by run; a run is the first fields of its row, up to the seed. In the order of one machine."""

    def table(self, shard):
        """The path of a shard's table."""
        return self.folder / f"{shard}.csv"

    def shared_words(self):
        """What the commands of all shards begin with."""
        return [self.celld, "bench", "planning", *self.arguments, "--threads", str(self.cpus)]

    def command(self, shard):
        """What runs a shard, from its beginning or from where it was."""
        return [*self.shared_words(), "--shard", f"{shard}/{self.shards}", "--out", str(self.table(shard))]

    def runs_of(self, shard):
        """The runs of a shard."""
        return [run for run, owner in self.runs.items() if owner == shard]

    def said(self, shard):
        """The last messages of a shard's task, for people."""
        log = self.folder / f"{shard}.err"
        lines = log.read_text(errors="replace").splitlines() if log.exists() else []
        return [f"  {log} ends with:", *(f"    {line}" for line in lines[-TAIL:])] if lines else []

    def save(self):
        """Writes `runs.json`."""
        self.folder.mkdir(parents=True, exist_ok=True)
        kept = {name: value for name, value in vars(self).items() if name != "folder"}
        replace(self.folder / "runs.json", json.dumps(kept, indent=1) + "\n")


@dataclasses.dataclass
class Found:
    """What the tables of the shards hold."""

    rows: dict
    """The row by run."""
    faults: list
    """What must not be merged, with file and line."""
    missing: dict
    """How many runs are still to do, by shard; shards without any are left out."""


def replace(path, text):
    """Writes a file whole or not at all."""
    draft = path.with_name(path.name + ".draft")
    draft.write_text(text)
    os.replace(draft, path)


def key_of(row, head):
    """The run a row is of: its fields before the first result."""
    return ",".join(row.split(",")[: head.split(",").index("status")])


def without_seconds(row, head):
    """A row with the columns blanked that a clock gives: the others are the same on every machine."""
    names = head.split(",")
    return ",".join("" if name.endswith("seconds") else field for name, field in zip(names, row.split(",")))


def without_time_limit(arguments):
    """The arguments less `--time-limit S`."""
    kept, words = [], iter(arguments)
    for word in words:
        if word == "--time-limit":
            next(words, None)
        elif not word.startswith("--time-limit="):
            kept.append(word)
    return kept


def listing(celld, arguments, *more):
    """Head and runs of a command, in its order; searches for no plan."""
    command = [celld, "bench", "planning", *without_time_limit(arguments), *more]
    command += ["--time-limit", "0", "--threads", "1", "--format", "csv"]
    done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
    if done.returncode != 0:
        raise Trouble(f"{shlex.join(command)}\n{done.stderr.strip()}", 2)
    head, *rows = done.stdout.splitlines() or [""]
    if not head.startswith("scenario,") or ",status," not in head:
        raise Trouble(f"{shlex.join(command)}\nno table came of it", 2)
    return head, [key_of(row, head) for row in rows]


def list_runs(benchmark):
    """Fills in head and runs."""
    def one(shard):
        part = [] if shard is None else ["--shard", f"{shard}/{benchmark.shards}"]
        return listing(benchmark.celld, benchmark.arguments, *part)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        (head, order), *parts = pool.map(one, [None, *range(1, benchmark.shards + 1)])
    owner = {run: shard for shard, (_, runs) in enumerate(parts, 1) for run in runs}
    if sorted(owner) != sorted(set(order)):
        raise Trouble("the shards do not make up the whole: the instances changed while they were listed")
    benchmark.head, benchmark.runs = head, {run: owner[run] for run in order}


def load(folder):
    """The benchmark of a folder."""
    try:
        return Benchmark(folder=folder, **json.loads((folder / "runs.json").read_text()))
    except FileNotFoundError:
        raise Trouble(f"{folder}: not a folder of shards, it has no runs.json", 2) from None
    except (TypeError, ValueError) as error:
        raise Trouble(f"{folder / 'runs.json'}: {error}; delete the folder to begin again", 2) from None


def prepare(options):
    """The benchmark of a command line, a new one or the one that its folder holds."""
    for word in options.arguments:
        hint = OURS.get(word.split("=")[0])
        if hint:
            raise Trouble(f"{word}: {hint}", 2)
    celld = shutil.which(options.celld)
    if celld is None:
        raise Trouble(f"--celld {options.celld}: there is no such program", 2)
    folder = options.out.resolve().with_name(options.out.name + ".shards")
    new = Benchmark(folder, os.path.abspath(celld), options.arguments, options.shards, options.cpus)
    if (folder / "runs.json").exists():
        old = load(folder)
        if (old.arguments, old.shards) != (new.arguments, new.shards):
            raise Trouble(
                f"{folder} holds {old.shards} shards of another command: {shlex.join(old.arguments)}\n"
                "name another --out, or delete that folder to begin again",
                2,
            )
        new.head, new.runs = old.head, old.runs
    else:
        print(f"listing the runs of {shlex.join(new.arguments)}", file=sys.stderr)
        list_runs(new)
    guard(options.out, new)
    new.save()
    return new


def guard(out, benchmark):
    """Refuses a file in the table's place that is not of this benchmark, before hours are spent."""
    if not out.exists():
        return
    head, *rows = out.read_text(errors="replace").splitlines() or [benchmark.head]
    if head != benchmark.head:
        raise Trouble(f"{out}: not a table of this benchmark; name another --out", 2)
    if any(key_of(row, head) not in benchmark.runs for row in rows):
        raise Trouble(f"{out}: holds runs that this command does not have; name another --out", 2)


def whole_lines(path):
    """The lines of a shard's table; one that is being written, or was when its task was killed, is none."""
    text = path.read_text(errors="replace") if path.exists() else ""
    return text[: text.rfind("\n") + 1].splitlines()


def read(benchmark):
    """What there is, and what of it is wrong."""
    rows, faults, places, head = {}, [], {}, benchmark.head
    for shard in range(1, benchmark.shards + 1):
        path = benchmark.table(shard)
        for number, line in enumerate(whole_lines(path), 1):
            place = f"{path}:{number}"
            if number == 1:
                if line != head:
                    faults.append(f"{place}: the head is not that of the other tables\n  {line}\n  {head}")
                    break
                continue
            if line.count(",") != head.count(","):
                faults.append(f"{place}: {line.count(',') + 1} fields, not {head.count(',') + 1}")
                continue
            run = key_of(line, head)
            if run in places:
                faults.append(f"{place}: the run {run} is at {places[run]} too")
            elif run not in benchmark.runs:
                faults.append(f"{place}: {run} is no run of this command")
            elif benchmark.runs[run] != shard:
                faults.append(f"{place}: the run {run} belongs to shard {benchmark.runs[run]}")
            places.setdefault(run, place)
            rows.setdefault(run, line)
    missing = collections.Counter(owner for run, owner in benchmark.runs.items() if run not in rows)
    return Found(rows, faults, dict(sorted(missing.items())))


def is_locked(path):
    """Whether celld writes to a table now, as far as this machine can see the locks of the others."""
    if not path.exists():
        return False
    with path.open() as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def some(faults):
    """The first faults as text."""
    left = len(faults) - MOST_FAULTS
    return "\n".join([*faults[:MOST_FAULTS], *([f"and {left} more"] if left > 0 else [])])


def to_do(benchmark):
    """The shards that are not complete.

    Tables that could never be merged end the program here, before their shards are run on."""
    found = read(benchmark)
    if found.faults:
        raise Trouble(f"{some(found.faults)}\nremove these lines or their tables, and begin again")
    busy = [f"shard {shard}: a task writes to {benchmark.table(shard)}" for shard in found.missing
            if is_locked(benchmark.table(shard))]
    if busy:
        raise Trouble("\n".join([*busy, "let it end, or end its job; then the same command goes on"]))
    done, runs = benchmark.shards - len(found.missing), len(benchmark.runs)
    print(
        f"{runs} runs in {benchmark.shards} shards; earlier: {len(found.rows)} runs, {done} shards complete",
        file=sys.stderr,
    )
    return list(found.missing)


def merge(benchmark, out):
    """Writes the table of all shards and says so, or says what is in the way."""
    found = read(benchmark)
    if found.faults:
        raise Trouble(f"not merged:\n{some(found.faults)}")
    if found.missing:
        lines = []
        for shard, count in found.missing.items():
            lines.append(f"shard {shard}: {count} of {len(benchmark.runs_of(shard))} runs are missing")
            lines += [*benchmark.said(shard), f"  alone again: {shlex.join(benchmark.command(shard))}"]
        raise Trouble("\n".join(["not merged:", *lines]))
    guard(out, benchmark)
    replace(out, "\n".join([benchmark.head, *(found.rows[run] for run in benchmark.runs)]) + "\n")
    return f"{out}: {len(benchmark.runs)} runs of {benchmark.shards} shards"


def compare(one, other):
    """Holds two tables against each other but for what a clock gives."""
    tables = []
    for path in (one, other):
        head, *rows = path.read_text().splitlines() or [""]
        if ",status," not in head:
            raise Trouble(f"{path}: not a table of `celld bench planning`", 2)
        tables.append([head, *(without_seconds(row, head) for row in rows)])
    if tables[0] == tables[1]:
        return f"{one.name} and {other.name}: the same {len(tables[0]) - 1} rows but for the seconds"
    if sorted(tables[0]) == sorted(tables[1]):
        raise Trouble("the same rows in another order: several threads write them as they end")
    only = [[row for row in mine if row not in set(yours)] for mine, yours in (tables, tables[::-1])]
    faults = [f"{path}: {row}" for path, rows in zip((one, other), only) for row in rows]
    raise Trouble("the tables differ:\n" + some(faults or ["a row is there twice"]))


def add_arguments(parser, out_needed=True):
    """What both programs take."""
    parser.add_argument("--celld", default="celld", metavar="PROGRAM", help=(
        "celld, at this path on every machine (default: the one in PATH)"))
    parser.add_argument("--out", type=Path, required=out_needed, metavar="TABLE", help=(
        "the merged table; beside it TABLE.shards holds the shards' tables, which all machines have to see"))
    parser.add_argument("--shards", type=positive, default=8, metavar="N", help=(
        "parts, each a task; several for each worker, so that none waits long for the last (default: 8)"))
    parser.add_argument("--cpus", type=positive, default=1, metavar="N", help=(
        "processors of a task, and cases that it runs at the same time (default: 1)"))
    parser.add_argument("arguments", nargs="+", metavar="ARGUMENT", help=(
        "behind `--`: arguments of `celld bench planning`, such as --figure rand-pp --work 100000"))


def positive(text):
    """A number of at least 1."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError("has to be 1 or more")
    return number


def ended(program, run):
    """The exit code of a program: 0, 1 for what failed, 2 for usage, 130 after Ctrl-C."""
    try:
        run()
    except Trouble as trouble:
        print(f"{program}: {trouble}", file=sys.stderr)
        return trouble.code
    except OSError as error:
        print(f"{program}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"{program}: stopped; the same command goes on from there", file=sys.stderr)
        return 130
    return 0


def main():
    """`merge` and `compare`."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(required=True)
    one = commands.add_parser("merge", help="one table of a folder of shards, when all runs are there")
    one.add_argument("folder", type=Path, help="TABLE.shards")
    one.add_argument("--out", type=Path, required=True, metavar="TABLE")
    one.set_defaults(run=lambda options: merge(load(options.folder.resolve()), options.out))
    two = commands.add_parser("compare", help="whether two tables are the same but for the seconds")
    two.add_argument("tables", type=Path, nargs=2, metavar="TABLE")
    two.set_defaults(run=lambda options: compare(*options.tables))
    options = parser.parse_args()
    sys.exit(ended("shards", lambda: print(options.run(options))))


if __name__ == "__main__":
    main()
