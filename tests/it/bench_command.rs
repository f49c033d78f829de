//! `celld generate`, `celld bench planning` and `celld bench figures` over real files, as a user goes
//! through them.

use celld::bench::table::{CSV_HEADER, Key, Table};
use celld::cli::bench_figures::{BenchFiguresArgs, run as figures};
use celld::cli::bench_planning::{BenchPlanningArgs, run as bench};
use celld::cli::generate::{GenerateArgs, run as generate};
use clap::{Args, Command};
use rearrange::planning::problem::Problem;
use rearrange::tabletop::parse::parse_with_sound_goals;
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

fn args<A: Args>(words: &[&str]) -> A {
    let command = A::augment_args(Command::new("celld").no_binary_name(true));
    let matches = command.try_get_matches_from(words).expect("valid arguments");
    A::from_arg_matches(&matches).expect("valid arguments")
}

fn refused<A: Args>(words: &[&str]) -> bool {
    A::augment_args(Command::new("celld").no_binary_name(true)).try_get_matches_from(words).is_err()
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Folder {
        Folder(tempfile::tempdir().expect("a temporary folder"))
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).expect("written")
    }

    /// A small run with deterministic ends into the named file.
    fn bench(&self, out: &str, more: &[&str], stopped: bool) -> u8 {
        let out = self.path(out).display().to_string();
        let words = [
            "--scenario",
            "rand",
            "--density",
            "0.2,0.4",
            "--n",
            "6",
            "--count",
            "3",
            "--solver",
            "rbm,erbm",
        ];
        let limits = ["--work", "200000", "--time-limit", "1e9", "--first", "--out", &out];
        bench(
            &args::<BenchPlanningArgs>(&[&words[..], &limits[..], more].concat()),
            &AtomicBool::new(stopped),
        )
    }

    fn keys(&self, name: &str) -> Vec<Key> {
        let mut table = Table::default();
        table.read(&self.text(name), name).expect("a table");
        assert_eq!(table.repeated, 0, "a case was run twice");
        table.rows.into_iter().map(|row| row.key).collect()
    }

    fn figures(&self, table: &str, more: &[&str]) -> u8 {
        let (table, out) =
            (self.path(table).display().to_string(), self.path("figures").display().to_string());
        figures(&args::<BenchFiguresArgs>(&[&[table.as_str(), "--out", &out], more].concat()))
    }
}

fn generate_into(folder: &Path, words: &[&str]) -> u8 {
    let out = folder.display().to_string();
    generate(&args::<GenerateArgs>(&[words, &["--out", &out]].concat()))
}

#[test]
fn generated_files_are_tasks_with_sound_starts_and_goals() {
    let folder = Folder::new();
    let words = ["sq", "--objects", "8", "--density", "0.45", "--count", "2", "--seed", "5"];
    assert_eq!(generate_into(&folder.path("a"), &words), 0);
    assert_eq!(generate_into(&folder.path("b"), &words), 0);
    for case in 0..2 {
        let name = format!("sq-n8-d0.45-s5-{case}.yaml");
        let text = folder.text(&format!("a/{name}"));
        assert_eq!(text, folder.text(&format!("b/{name}")), "same seed, same file");
        assert!(text.starts_with("# celld generate sq --objects 8 --density 0.45 --seed 5"), "{text}");
        assert!(text.contains("start by push-apart") && text.contains("goal by push-apart"));
        let instance = parse_with_sound_goals(&text, &name, &|_| None).expect("sound");
        assert!((instance.density() - 0.45).abs() < 1e-9);
        assert!(Problem::new(&instance).expect("a problem").goal_conflict().is_none());
    }
    assert_eq!(generate_into(&folder.path("c"), &["sq", "--objects", "2", "--density", "0.3"]), 2);
    assert!(!folder.path("c").exists());
    assert!(refused::<GenerateArgs>(&["sq", "--objects", "9", "--density", "much", "--out", "x"]));
}

#[test]
fn an_interrupted_run_goes_on_where_it_stopped() {
    let folder = Folder::new();
    assert_eq!(folder.bench("rows.csv", &[], true), 130);
    assert_eq!(folder.text("rows.csv"), format!("{CSV_HEADER}\n"));
    assert_eq!(folder.bench("rows.csv", &["--threads", "2"], false), 0);
    let whole = folder.text("rows.csv");
    let keys: HashSet<Key> = folder.keys("rows.csv").into_iter().collect();
    assert_eq!(keys.len(), 2 * 3 * 2);
    assert_eq!(folder.bench("rows.csv", &[], false), 0);
    assert_eq!(folder.text("rows.csv"), whole, "nothing was left to do");
    let kept: usize = whole.split_inclusive('\n').take(5).map(str::len).sum();
    std::fs::write(folder.path("rows.csv"), &whole[..kept + 17]).expect("writable");
    assert_eq!(folder.bench("rows.csv", &[], false), 0);
    assert!(folder.text("rows.csv").starts_with(&whole[..kept]));
    assert_eq!(folder.keys("rows.csv").into_iter().collect::<HashSet<Key>>(), keys);
}

#[test]
fn the_parts_of_several_machines_make_the_whole() {
    let folder = Folder::new();
    assert_eq!(folder.bench("whole.csv", &[], false), 0);
    let mut together = String::new();
    for part in ["1/3", "2/3", "3/3"] {
        assert_eq!(folder.bench("part.csv", &["--shard", part], false), 0);
        together += &folder.text("part.csv");
        std::fs::remove_file(folder.path("part.csv")).expect("there");
    }
    std::fs::write(folder.path("together.csv"), together).expect("writable");
    let set = |name: &str| folder.keys(name).into_iter().collect::<HashSet<Key>>();
    assert_eq!(set("together.csv"), set("whole.csv"));
    assert!(refused::<BenchPlanningArgs>(&["--shard", "4/3"]));
}

#[test]
fn what_cannot_be_run_is_reported_before_anything_is() {
    let folder = Folder::new();
    assert_eq!(folder.bench("rows.csv", &["--objective", "time"], false), 2);
    assert!(!folder.path("rows.csv").exists());
    let none = |words: &[&str]| bench(&args::<BenchPlanningArgs>(words), &AtomicBool::new(false));
    assert_eq!(none(&["--scenario", "disk"]), 2);
    assert_eq!(none(&["--data", "/nowhere/at/all"]), 2);
    assert_eq!(none(&["--n", "0"]), 2);
    assert_eq!(none(&["--n", "1001"]), 2);
    assert!(refused::<BenchPlanningArgs>(&["--figure", "rand-pp", "--n", "20"]));
}

#[test]
fn figures_are_drawn_from_the_rows_there_are() {
    let folder = Folder::new();
    let out = folder.path("rows.csv").display().to_string();
    let words =
        ["--figure", "rand-density", "--count", "1", "--work", "2000", "--time-limit", "1e9", "--first"];
    let run = args::<BenchPlanningArgs>(&[&words[..], &["--out", &out]].concat());
    assert_eq!(bench(&run, &AtomicBool::new(false)), 0);
    assert_eq!(folder.figures("rows.csv", &[]), 0);
    let svg = folder.text("figures/rand-density.svg");
    assert!(
        svg.contains(">RAND, 20 objects") && svg.contains(">ERBM</text>") && svg.contains(">lower bound<")
    );
    let png = image::open(folder.path("figures/rand-density.png")).expect("a picture").to_rgb8();
    let coloured = png.pixels().filter(|pixel| pixel.0 == [0xd5, 0x5e, 0x00]).count();
    assert!(coloured > 100, "{coloured} pixels of ERBM's curve");
    assert!(folder.path("figures/rand-pp.png").exists(), "0.40 with 20 objects is one point of it");
    assert!(!folder.path("figures/sq-ti.png").exists());
    assert_eq!(folder.figures("rows.csv", &["--figure", "sq-ti"]), 2);
    std::fs::write(folder.path("other.csv"), "a,b\n1,2\n").expect("writable");
    assert_eq!(folder.figures("other.csv", &[]), 2);
    assert_eq!(folder.figures("missing.csv", &[]), 2);
}

/// Two squares that change places, in the public files' own form.
const PUBLIC_SWAP: &str = r#"{"Workspace_Density": 0.2, "Workspace_Height": 1000, "Workspace_Width": 1000,
 "number_of_objects": 2, "object_list": [
 {"Object_Shape": "cuboid", "Object_Length": 200, "Object_Width": 200,
  "initial_pose": [200, 200, 0], "goal_pose": [800, 200, 0]},
 {"Object_Shape": "cuboid", "Object_Length": 200, "Object_Width": 200,
  "initial_pose": [800, 200, 0], "goal_pose": [200, 200, 0]}]}"#;

#[test]
fn the_public_codes_rows_are_run_and_compared() {
    let folder = Folder::new();
    let cell = folder.path("hetori/instances/random_general/Density=0.20/numObjs=2");
    std::fs::create_dir_all(&cell).expect("a folder");
    std::fs::write(cell.join("0_2_0.20.json"), PUBLIC_SWAP).expect("writable");
    let head = "set,label,density,n,instance,method,status,actions,ti_cost,wall_s";
    let rows = "hete,random_general,0.2,2,0,RBM,ok,3,3,1.5\nhete,random_general,0.2,2,9,RBM,ok,3,3,1.5\n";
    std::fs::write(folder.path("theirs.csv"), format!("{head}\n{rows}")).expect("writable");
    let word = |name: &str| folder.path(name).display().to_string();
    let (data, theirs, out) = (word(""), word("theirs.csv"), word("rows.csv"));
    let words = ["--data", &data, "--baseline", &theirs, "--solver", "rbm,erbm", "--seed", "1,2", "--first"];
    let run = |more: &[&str]| {
        bench(&args::<BenchPlanningArgs>(&[&words[..], more].concat()), &AtomicBool::new(false))
    };
    assert_eq!(run(&["--out", &out, "--strict-paper"]), 0);
    assert_eq!(folder.keys("rows.csv").len(), 2, "theirs has no ERBM, and instance 9 is not there");
    std::fs::write(folder.path("theirs.csv"), format!("{head}\nhete,x,0.2,2,0,RBM,ok,,3,1\n"))
        .expect("writable");
    assert_eq!(run(&[]), 2);
    assert!(refused::<BenchPlanningArgs>(&["--baseline", "x.csv"]), "without --data");
}

#[test]
fn the_parts_of_the_vision_benchmark_print_one_object() {
    let words = [
        "bench",
        "vision",
        "--part",
        "drift,foreign,hand-eye",
        "--trials",
        "20",
        "--looks",
        "40",
        "--rendered",
        "0",
        "--scenes",
        "4",
        "--rounds",
        "2",
        "--format",
        "json",
    ];
    let run = std::process::Command::new(env!("CARGO_BIN_EXE_celld")).args(words).output().expect("it runs");
    let reported: serde_json::Value = serde_json::from_slice(&run.stdout).expect("one JSON object");
    assert_eq!(
        (&reported["drift"]["noticed"], &reported["drift"]["false_alarms"]),
        (&20.into(), &0.into()),
        "{reported}"
    );
    assert_eq!(reported["foreign"]["found_rate"], 1.0, "{reported}");
    assert_eq!(reported["foreign"]["false_alarm_rate"], 0.0, "{reported}");
    assert_eq!(reported["foreign"]["by_colour"]["false_alarm_rate"], 0.0, "{reported}");
    assert_eq!(reported["hand_eye"]["degenerate"].as_array().map(Vec::len), Some(3), "{reported}");
    assert!(reported["detection_rate"].is_null(), "the markers were not asked for");
}
