"""Merging and comparing, on tables written here: what must not be merged is named with file and line."""

import types

import pytest
import shards
from conftest import call
from shards import Benchmark, Trouble

HEAD = "scenario,density,n,id,solver,objective,seed,status,moves,cost,lower_bound,first_plan_seconds,seconds"


def row(case, seconds="0.5"):
    """A row of a case."""
    return f"rand,0.40,20,g0-{case},erbm,pp,0,solved,24,24.000000,20.000000,{seconds},{seconds}"


def run(case):
    """The run that the row is of."""
    return row(case).split(",solved")[0]


@pytest.fixture
def benchmark(tmp_path):
    """Four runs in two shards, both complete; not in the order of any sorting."""
    made = Benchmark(tmp_path / "rows.csv.shards", "celld", ["--figure", "rand-pp"], 2, 1, HEAD)
    made.runs = {run(10): 1, run(9): 2, run(11): 1, run(2): 2}
    made.save()
    write(made, 1, row(11), row(10))
    write(made, 2, row(9), row(2))
    return made


def write(benchmark, shard, *rows, head=HEAD):
    benchmark.table(shard).write_text("".join(f"{line}\n" for line in (head, *rows)))


def merge(benchmark):
    """Exit code, messages, and the merged table if there is one."""
    out = benchmark.folder.with_suffix("")
    done = call("shards.py", "merge", benchmark.folder, "--out", out)
    return done.returncode, done.stderr, out.read_text().splitlines() if out.exists() else None


def test_the_rows_are_in_the_order_of_one_machine(benchmark):
    assert merge(benchmark) == (0, "", [HEAD, row(10), row(9), row(11), row(2)])


def test_tables_that_overlap_are_not_merged(benchmark):
    write(benchmark, 2, row(9), row(2), row(10))
    code, said, table = merge(benchmark)
    assert (code, table) == (1, None)
    assert f"2.csv:4: the run {run(10)} is at " in said and "1.csv:3 too" in said
    write(benchmark, 2, row(9), row(9), row(2))
    assert "2.csv:3: the run" in merge(benchmark)[1]


def test_a_table_with_another_head_is_not_merged(benchmark):
    write(benchmark, 2, row(9), row(2), head=HEAD.replace("cost", "price"))
    code, said, table = merge(benchmark)
    assert (code, table) == (1, None)
    assert "2.csv:1: the head is not that of the other tables" in said


def test_rows_of_another_shard_or_another_command_are_not_merged(benchmark):
    write(benchmark, 1, row(10))
    write(benchmark, 2, row(9), row(11), row(3), row(2) + ",1")
    code, said, table = merge(benchmark)
    assert (code, table) == (1, None)
    assert "2.csv:3: the run" in said and "belongs to shard 1" in said
    assert f"2.csv:4: {run(3)} is no run of this command" in said
    assert "2.csv:5: 14 fields, not 13" in said


def test_what_is_missing_is_counted_and_its_command_named(benchmark):
    benchmark.table(1).unlink()
    benchmark.table(2).write_text(f"{HEAD}\n{row(9)}\n{row(2)}")
    code, said, table = merge(benchmark)
    assert (code, table) == (1, None)
    assert "shard 1: 2 of 2 runs are missing" in said
    assert "shard 2: 1 of 2 runs are missing" in said
    assert f"bench planning --figure rand-pp --threads 1 --shard 2/2 --out {benchmark.table(2)}" in said


def test_a_file_that_is_not_of_this_benchmark_stays(benchmark):
    out = benchmark.folder.with_suffix("")
    for foreign in ("once upon a time\n", f"{HEAD}\n{row(77)}\n"):
        out.write_text(foreign)
        code, said, _ = merge(benchmark)
        assert code == 2 and "name another --out" in said
        assert out.read_text() == foreign


def test_a_folder_that_is_none_is_said(tmp_path):
    done = call("shards.py", "merge", tmp_path, "--out", tmp_path / "rows.csv")
    assert done.returncode == 2 and "no runs.json" in done.stderr
    (tmp_path / "runs.json").write_text("{")
    done = call("shards.py", "merge", tmp_path, "--out", tmp_path / "rows.csv")
    assert done.returncode == 2 and "delete the folder" in done.stderr


def test_tables_are_compared_but_for_the_seconds(tmp_path):
    def compared(*rows):
        (tmp_path / "a.csv").write_text(f"{HEAD}\n{row(1)}\n{row(2)}\n")
        (tmp_path / "b.csv").write_text("".join(f"{line}\n" for line in (HEAD, *rows)))
        done = call("shards.py", "compare", tmp_path / "a.csv", tmp_path / "b.csv")
        return done.returncode, done.stdout + done.stderr

    code, said = compared(row(1, "9.75"), row(2, "0.125"))
    assert code == 0 and "the same 2 rows but for the seconds" in said
    code, said = compared(row(2), row(1))
    assert code == 1 and "in another order" in said
    code, said = compared(row(1), row(2).replace(",24,24.0", ",25,25.0"))
    assert code == 1 and "a.csv: rand,0.40,20,g0-2" in said and "b.csv: rand,0.40,20,g0-2" in said
    assert compared(row(1))[0] == 1 and compared(row(1), row(2), row(2))[0] == 1


def options(tmp_path, celld, *arguments, count=2):
    """What the programs' command lines give."""
    return types.SimpleNamespace(
        celld=str(celld), out=tmp_path / "rows.csv", shards=count, cpus=1, arguments=list(arguments)
    )


def test_options_that_are_given_here_are_refused(tmp_path, celld):
    for word in ("--shard", "--out=rows.csv", "--format", "--threads=2"):
        with pytest.raises(Trouble, match=word) as refused:
            shards.prepare(options(tmp_path, celld, word, "1/2"))
        assert refused.value.code == 2


def test_what_celld_refuses_is_said_before_anything_is_submitted(tmp_path, celld):
    with pytest.raises(Trouble, match="magic") as refused:
        shards.prepare(options(tmp_path, celld, "--solver", "magic"))
    assert refused.value.code == 2 and not (tmp_path / "rows.csv.shards").exists()
    with pytest.raises(Trouble, match="no such program"):
        shards.prepare(options(tmp_path, tmp_path / "none"))


def test_a_file_in_the_place_of_the_table_is_refused_before_anything_is_run(tmp_path, celld):
    (tmp_path / "rows.csv").write_text("once upon a time\n")
    with pytest.raises(Trouble, match="name another --out"):
        shards.prepare(options(tmp_path, celld, "--scenario", "rand", "--n", "4", "--count", "2"))
    assert [path.name for path in tmp_path.iterdir()] == ["rows.csv"]


def test_a_folder_is_of_one_command(tmp_path, celld):
    words = ["--scenario", "rand", "--density", "0.2", "--n", "4", "--count", "5", "--time-limit"]
    made = shards.prepare(options(tmp_path, celld, *words, "7"))
    assert [len(made.runs_of(shard)) for shard in (1, 2)] == [3, 2]
    assert shards.prepare(options(tmp_path, celld, *words, "7")) == made
    for other in (options(tmp_path, celld, *words, "8"), options(tmp_path, celld, *words, "7", count=3)):
        with pytest.raises(Trouble, match="another command"):
            shards.prepare(other)
