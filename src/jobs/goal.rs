//! Wanted arrangements: the list of poses in a job or goal file, and whether the table can hold it.
//!
//! In: located values, the catalogue and the table. Out: poses with the places where they were written, and
//! complaints at those places; what decoded is judged although other parts did not. A goal file holds
//! `objects: [{id, pose}]`, or is an instance whose goals count.

use crate::jobs::record::GoalPose;
use cell_edge::files::read_regular;
use cell_machine::orders::Approval;
use rearrange::document::decode::{At, Decoder, Fields, suggestion};
use rearrange::document::{Diagnostics, Location, Node};
use rearrange::geometry::collision::{TOUCH_M, overhang, penetration};
use rearrange::geometry::pose::Pose2;
use rearrange::tabletop::decode;
use rearrange::tabletop::instance::{KeepOut, ObjectSpec};
use rearrange::tabletop::parse::{INSTANCE_KEYS, header, unique_names_and_markers};
use std::collections::BTreeMap;
use std::path::{Component, Path};

/// Most objects in one goal.
const MAX_OBJECTS: usize = 1000;

/// Largest goal file read, bytes: a thousand objects with outlines of some dozen corners.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// Catalogue and table a goal is checked against.
#[derive(Clone, Copy, Debug)]
pub struct GoalContext<'a> {
    /// The catalogue.
    pub objects: &'a [ObjectSpec],
    /// Table extent along x, m.
    pub width_m: f64,
    /// Table extent along y, m.
    pub height_m: f64,
    /// Gap between objects at new places, m.
    pub clearance_m: f64,
    /// Places that stay free.
    pub keep_out: &'a [KeepOut],
    /// Overlap that a measured goal may have, m (three standard deviations of the measurement).
    pub overlap_tolerance_m: f64,
}

/// Text of a goal file, by the path as the job writes it; `Err` says why it cannot be had.
pub type ReadGoal<'a> = dyn Fn(&str) -> Result<String, String> + 'a;

/// Where the objects lay when the named job first looked; `Err` says why that is not known.
pub type FoundBy<'a> = dyn Fn(&str) -> Result<Vec<GoalPose>, String> + 'a;

/// What a job is checked against.
#[derive(Clone, Copy)]
pub struct JobContext<'a> {
    /// Catalogue and table; absent where they are not known (`celld check`, `celld submit`).
    pub goal: Option<GoalContext<'a>>,
    /// Least approval; a job may only be stricter.
    pub approval: Approval,
    /// Finds goal files.
    pub read_goal: &'a ReadGoal<'a>,
    /// Finds what another job found; absent where the journal is not at hand.
    pub found: Option<&'a FoundBy<'a>>,
}

/// A wanted pose and where it was written. What is absent was complained about.
#[derive(Clone, Debug, PartialEq)]
pub struct GoalEntry {
    /// Which object.
    pub id: Option<String>,
    /// Where it is wanted.
    pub pose: Option<Pose2>,
    /// Place of the entry.
    pub at: Location,
    /// Path of the entry.
    pub path: String,
}

impl GoalEntry {
    /// The wanted pose, if all of it could be read.
    pub fn into_goal(self) -> Option<GoalPose> {
        Some(GoalPose { id: self.id?, pose: self.pose? })
    }
}

/// Reads the list under `objects`; entries that are wrong are complained about and kept as far as they go.
pub fn decode_goal(decoder: &mut Decoder, at: &At) -> Option<Vec<GoalEntry>> {
    let items = decoder.sequence(at)?;
    if items.is_empty() || items.len() > MAX_OBJECTS {
        let message = format!("{} objects, between 1 and {MAX_OBJECTS} are wanted", items.len());
        decoder.complain_at(at, message, "a job has to ask for something");
        return None;
    }
    let entries: Vec<_> = items.iter().filter_map(|item| decode_entry(decoder, item)).collect();
    check_unique(decoder, &entries);
    Some(entries)
}

fn decode_entry(decoder: &mut Decoder, at: &At) -> Option<GoalEntry> {
    let fields = decoder.map(at, &["id", "pose", "pose_deg"])?;
    let id = fields.required("id", decoder).and_then(|at| decoder.text(&at));
    let pose = required_pose(decoder, &fields, "pose");
    Some(GoalEntry { id, pose, at: at.node.at, path: at.path.clone() })
}

fn required_pose(decoder: &mut Decoder, fields: &Fields, key: &str) -> Option<Pose2> {
    let found = decode::pose(decoder, fields, key)?;
    if found.is_none() {
        let help = "add it: [x, y, theta] in m, m, rad, or the same with _deg and the angle in degrees";
        decoder.complain(fields.at(), fields.path(), format!("key {key:?} is missing"), help);
    }
    found
}

fn check_unique(decoder: &mut Decoder, entries: &[GoalEntry]) {
    let mut first: BTreeMap<&str, Location> = BTreeMap::new();
    for entry in entries {
        let Some(id) = entry.id.as_deref() else { continue };
        match first.get(id) {
            Some(at) => {
                let message = format!("object {id:?} has a goal already, at line {}", at.line);
                decoder.complain(entry.at, &entry.path, message, "remove one of the two");
            }
            None => {
                first.insert(id, entry.at);
            }
        }
    }
}

/// Text of the goal file `name` of the goal folder, as the daemon reads it on its control loop: a plain file
/// of bounded size in the folder or below it. What is wrong otherwise, in words.
///
/// # Errors
/// Why it cannot be had.
pub fn read_goal_file(folder: &Path, name: &str) -> Result<String, String> {
    if !stays_below(name) {
        return Err("it leads out of the goal folder".to_owned());
    }
    read_regular(&folder.join(name), MAX_FILE_BYTES).map(|(text, _)| text).map_err(|error| error.reason())
}

/// Text of the goal file `name` as commands find it: beside the job's file, or in the cell's goal folder
/// where one is known, which is where the daemon looks for jobs that are dropped into `incoming`. One rule
/// for all: of two files that differ, none is taken.
///
/// # Errors
/// Why it cannot be had.
pub fn find_goal_file(beside: &Path, goal_folder: Option<&Path>, name: &str) -> Result<String, String> {
    let folder = goal_folder.filter(|folder| !is_same(folder, beside));
    let found = [Some(beside), folder].map(|folder| folder.map(|folder| read_goal_file(folder, name)));
    match found {
        [Some(Ok(one)), Some(Ok(other))] if one != other => Err(format!(
            "it lies beside the job ({}) and in the goal folder ({}), and the two differ; give one another name",
            beside.join(name).display(),
            folder.unwrap_or(beside).join(name).display()
        )),
        [Some(Ok(text)), _] | [_, Some(Ok(text))] => Ok(text),
        [Some(Err(near)), Some(Err(far))] => {
            let folder = folder.unwrap_or(beside).display();
            Err(format!("beside the job: {near}; in the goal folder {folder}: {far}"))
        }
        [Some(Err(reason)), None] | [None, Some(Err(reason))] => Err(reason),
        [None, None] => Err("no folder is known".to_owned()),
    }
}

/// Both name the same folder.
fn is_same(one: &Path, other: &Path) -> bool {
    let real = |path: &Path| match path.as_os_str().is_empty() {
        true => Path::new(".").canonicalize(),
        false => path.canonicalize(),
    };
    matches!((real(one), real(other)), (Ok(one), Ok(other)) if one == other)
}

/// True for a path that leads to a file in the folder it is joined to, or below it.
pub(crate) fn stays_below(path: &str) -> bool {
    let mut named = false;
    for component in Path::new(path).components() {
        match component {
            Component::Normal(_) => named = true,
            Component::CurDir => {}
            Component::Prefix(_) | Component::RootDir | Component::ParentDir => return false,
        }
    }
    named
}

/// Reads a goal file; with a context, also checks it.
///
/// # Errors
/// Every complaint, with the places in the goal file.
pub fn parse_goal_file(
    text: &str,
    source: &str,
    context: Option<&GoalContext>,
) -> Result<Vec<GoalEntry>, Diagnostics> {
    let (node, mut decoder) = Decoder::open(text, source)?;
    let top = At::top(&node);
    let entries = if node.get("workspace").is_some() {
        decode_instance_goals(&mut decoder, &top)
    } else {
        decoder.map(&top, &["version", "objects"]).and_then(|fields| {
            if let Some(version) = fields.optional("version") {
                decoder.integer(&version, 1..=1);
            }
            let objects = fields.required("objects", &mut decoder);
            objects.and_then(|at| decode_goal(&mut decoder, &at))
        })
    };
    if let (Some(entries), Some(context)) = (&entries, context) {
        check_goal(&mut decoder, entries, context);
    }
    decoder.finish(entries)
}

/// The goals of an instance file. Every key of it is read as the instance parser reads it; its starts are
/// not compared, for the camera says where things are.
fn decode_instance_goals(decoder: &mut Decoder, top: &At) -> Option<Vec<GoalEntry>> {
    let fields = decoder.map(top, INSTANCE_KEYS)?;
    header(decoder, &fields);
    let objects = fields.required("objects", decoder)?;
    let items = decoder.sequence(&objects)?;
    if items.len() > MAX_OBJECTS {
        decoder.complain_at(&objects, format!("{} objects, at most {MAX_OBJECTS} are read", items.len()), "");
        return None;
    }
    let mut entries = Vec::new();
    for item in &items {
        let wanted = item.node.get("goal").or_else(|| item.node.get("goal_deg")).is_some();
        let object = decode::object(decoder, item);
        if wanted {
            let id = item.node.get("id").and_then(Node::scalar).map(str::to_owned);
            let pose = object.and_then(|object| object.goal);
            entries.push(GoalEntry { id, pose, at: item.node.at, path: item.path.clone() });
        }
    }
    if entries.is_empty() {
        let help = "add `goal: [x, y, theta]` to at least one; a job has to ask for something";
        decoder.complain_at(&objects, "no object has a goal", help);
    }
    unique_names_and_markers(decoder, &items);
    Some(entries)
}

/// A goal of an object that the catalogue has.
struct KnownGoal<'a> {
    /// The entry, for complaints.
    entry: &'a GoalEntry,
    /// The object.
    object: &'a ObjectSpec,
    /// Where it is wanted, table frame.
    pose: Pose2,
}

/// Complains about what the catalogue does not know and the table cannot hold.
pub fn check_goal(decoder: &mut Decoder, entries: &[GoalEntry], context: &GoalContext) {
    let ids: Vec<_> = context.objects.iter().map(|object| object.id.as_str()).collect();
    let mut known: Vec<KnownGoal> = Vec::new();
    for entry in entries {
        let Some(id) = entry.id.as_deref() else { continue };
        match context.objects.iter().find(|object| object.id == id) {
            None => complain_unknown(decoder, entry, id, &ids),
            Some(object) if object.fixed => {
                let message = format!("object {:?} is fixed, it never moves", object.id);
                decoder.complain(entry.at, &entry.path, message, "remove it from the goal");
            }
            Some(object) => known.extend(entry.pose.map(|pose| KnownGoal { entry, object, pose })),
        }
    }
    let tolerance_m = context.overlap_tolerance_m.max(TOUCH_M);
    for (index, goal) in known.iter().enumerate() {
        check_place(decoder, goal, context, tolerance_m);
        let KnownGoal { entry, object, pose } = goal;
        for other in known.iter().take(index) {
            let depth = penetration(&object.footprint, pose, &other.object.footprint, &other.pose);
            // The same object twice is another complaint, and has been made.
            if depth > tolerance_m && object.id != other.object.id {
                let message = format!(
                    "the goals of {:?} and {:?} (line {}) overlap by {}",
                    object.id,
                    other.object.id,
                    other.entry.at.line,
                    millimetres(depth)
                );
                decoder.complain(entry.at, &entry.path, message, "move them apart");
            }
        }
    }
}

fn complain_unknown(decoder: &mut Decoder, entry: &GoalEntry, id: &str, ids: &[&str]) {
    let help = match suggestion(id, ids) {
        Some(near) => format!("did you mean {near:?}?"),
        None => format!("the catalogue has: {}", ids.join(", ")),
    };
    decoder.complain(entry.at, &entry.path, format!("object {id:?} is unknown"), help);
}

fn check_place(decoder: &mut Decoder, goal: &KnownGoal, context: &GoalContext, tolerance_m: f64) {
    let KnownGoal { entry, object, pose } = goal;
    let beyond = overhang(&object.footprint, pose, context.width_m, context.height_m);
    if beyond > tolerance_m {
        let message =
            format!("the goal of {:?} reaches {} over the table's edge", object.id, millimetres(beyond));
        let help = format!("the table is {} m x {} m", context.width_m, context.height_m);
        decoder.complain(entry.at, &entry.path, message, help);
    }
    for region in context.keep_out {
        let depth = penetration(&object.footprint, pose, &region.footprint, &region.pose);
        if depth > TOUCH_M {
            let message =
                format!("the goal of {:?} reaches {} into a keep-out region", object.id, millimetres(depth));
            decoder.complain(entry.at, &entry.path, message, "move it away");
        }
    }
}

fn millimetres(metres: f64) -> String {
    let mm = metres * 1e3;
    if mm < 0.01 { format!("{mm:.6} mm") } else { format!("{mm:.2} mm") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::edit::replace_once;
    use rearrange::geometry::footprint::Footprint;

    fn complaints(text: &str) -> String {
        let plank = |id: &str| ObjectSpec::new(id, Footprint::rectangle(0.1, 0.04).unwrap());
        let base = ObjectSpec { fixed: true, ..plank("base") };
        let objects = [plank("plank-1"), plank("plank-2"), base];
        let keep_out =
            [KeepOut { footprint: Footprint::disc(0.02).unwrap(), pose: Pose2::new(0.45, 0.45, 0.0) }];
        let context = GoalContext {
            objects: &objects,
            width_m: 0.5,
            height_m: 0.5,
            clearance_m: 0.002,
            keep_out: &keep_out,
            overlap_tolerance_m: 0.0005,
        };
        match parse_goal_file(text, "goal.yaml", Some(&context)) {
            Ok(entries) => format!("{} fine", entries.len()),
            Err(complaints) => complaints.to_string(),
        }
    }

    #[test]
    fn a_version_that_is_none_and_a_place_beyond_the_world_are_reported() {
        let goal = "version: 1\nobjects:\n  - {id: plank-1, pose: [0.1, 0.1, 0]}\n";
        assert_eq!(complaints(goal), "1 fine");
        for version in ["x", "2", "-1e308"] {
            let reported = complaints(&replace_once(goal, "version: 1", &format!("version: {version}")));
            assert!(reported.starts_with("goal.yaml:1:10: version: "), "{reported}");
        }
        let far = complaints(&replace_once(goal, "[0.1, 0.1, 0]", "[0.1, -1e308, 0]"));
        assert!(far.contains("goal.yaml:3:31") && far.contains("out of range"), "{far}");
    }

    #[test]
    fn a_goal_that_the_table_holds_is_fine() {
        let touching =
            "objects:\n  - {id: plank-1, pose: [0.1, 0.1, 0]}\n  - {id: plank-2, pose: [0.2, 0.1, 0]}\n";
        assert_eq!(complaints(touching), "2 fine");
        assert_eq!(
            complaints(&replace_once(touching, "0.2,", "0.1996,")),
            "2 fine",
            "0.4 mm are measurement"
        );
        assert_eq!(complaints("objects:\n  - {id: plank-1, pose_deg: [0.02, 0.05, 90]}\n"), "1 fine");
        let instance = "workspace: {width: 1, height: 1}\n\
                        objects:\n  - \
                        {id: plank-1, footprint: {disc: {radius: 0.1}}, goal: [0.1, 0.1, 0]}\n  - {id: other, footprint: {disc: {radius: 0.1}}}\n";
        assert_eq!(complaints(instance), "1 fine");
    }

    #[test]
    fn an_instance_as_goal_is_read_key_by_key() {
        let object = |rest: &str| format!("  - {{footprint: {{disc: {{radius: 0.1}}}}, {rest}}}\n");
        let file = |rest: &[&str]| {
            let objects: String = rest.iter().map(|rest| object(rest)).collect();
            format!("workspace: {{width: 1, height: 1}}\nobjects:\n{objects}")
        };
        let none = complaints(&file(&["id: plank-1"]));
        assert!(none.contains("goal.yaml:3:3: objects: no object has a goal; add `goal:"), "{none}");
        let several = complaints(&file(&[
            "id: plank-1, gaol: [0.1, 0.1, 0]",
            "id: plank-2, goal: [0.1, 0.1]",
            "id: plnk, goal: [0.3, 0.3, 0]",
            "id: plnk-2, goal: [0.3, .nan, 0]",
        ]));
        for wanted in [
            "3:53: objects[0].gaol: unknown key; did you mean \"goal\"?",
            "4:59: objects[1].goal: 2 values, 3 are wanted",
            "5:5: objects[2]: object \"plnk\" is unknown",
            "6:5: objects[3]: object \"plnk-2\" is unknown",
            "6:64: objects[3].goal[1]: .nan is not a finite number",
        ] {
            assert!(several.contains(wanted), "{wanted}:\n{several}");
        }
        let fine = file(&["id: plank-1, goal: [0.1, 0.1, 0]"]);
        let top = complaints(&replace_once(&fine, "height: 1", "height: 1 m"));
        assert!(top.contains("goal.yaml:1:31: workspace.height: \"1 m\" is not a number"), "{top}");
    }

    #[test]
    fn every_fault_of_a_goal_is_named_with_its_line() {
        let text = "objects:
  - {id: plank-1, pose: [0.1, 0.1, 0]}
  - {id: plank-2, pose: [0.19, 0.1, 0]}
  - {id: plnk-1, pose: [0.3, 0.3, 0]}
  - {id: base, pose: [0.3, 0.3, 0]}
";
        assert_eq!(
            complaints(text),
            "goal.yaml:3:5: objects[1]: the goals of \"plank-2\" and \"plank-1\" (line 2) overlap by 10.00 \
             mm; move them apart\n\
             goal.yaml:4:5: objects[2]: object \"plnk-1\" is unknown; did you mean \"plank-1\"?\n\
             goal.yaml:5:5: objects[3]: object \"base\" is fixed, it never moves; remove it from the goal"
        );
        let off = complaints("objects:\n  - {id: plank-1, pose: [0.04, 0.1, 0]}\n");
        assert!(off.contains("2:5: objects[0]: the goal of \"plank-1\" reaches 10.00 mm over"), "{off}");
        let keep_out = complaints("objects:\n  - {id: plank-1, pose: [0.45, 0.42, 0]}\n");
        assert!(keep_out.contains("into a keep-out region"), "{keep_out}");
        let twice = complaints(
            "objects:\n  - {id: plank-1, pose: [0.1, 0.1, 0]}\n  - {id: plank-1, pose: [0.3, 0.3, 0]}\n",
        );
        assert!(
            twice.contains("3:5: objects[1]: object \"plank-1\" has a goal already, at line 2"),
            "{twice}"
        );
    }

    #[test]
    fn a_goal_lies_beside_its_job_or_in_the_goal_folder_and_two_that_differ_are_none() {
        let folder = tempfile::tempdir().unwrap();
        let (near, far) = (folder.path().join("jobs"), folder.path().join("goals"));
        for path in [&near, &far] {
            std::fs::create_dir(path).unwrap();
        }
        let find = |name: &str| find_goal_file(&near, Some(&far), name);
        std::fs::write(near.join("near.yaml"), "near").unwrap();
        std::fs::write(far.join("far.yaml"), "far").unwrap();
        assert_eq!((find("near.yaml").as_deref(), find("far.yaml").as_deref()), (Ok("near"), Ok("far")));
        let absent = find("none.yaml").unwrap_err();
        assert!(absent.contains("beside the job: ") && absent.contains("goals"), "{absent}");
        for (text, taken) in [("same", true), ("other", false)] {
            std::fs::write(near.join("both.yaml"), "same").unwrap();
            std::fs::write(far.join("both.yaml"), text).unwrap();
            assert_eq!(find("both.yaml").is_ok(), taken, "{:?}", find("both.yaml"));
        }
        assert!(find("both.yaml").unwrap_err().contains("the two differ"));
        assert_eq!(find_goal_file(&near, None, "near.yaml").as_deref(), Ok("near"));
        assert_eq!(find_goal_file(&near, Some(&near), "near.yaml").as_deref(), Ok("near"));
    }

    #[test]
    fn the_daemon_reads_plain_files_of_the_goal_folder_only() {
        let folder = tempfile::tempdir().unwrap();
        let goals = folder.path().join("goals");
        std::fs::create_dir_all(goals.join("below")).unwrap();
        std::fs::write(goals.join("below/goal.yaml"), "text").unwrap();
        std::fs::write(folder.path().join("secret.yaml"), "secret").unwrap();
        std::fs::write(goals.join("large.yaml"), vec![b' '; (MAX_FILE_BYTES + 1) as usize]).unwrap();
        std::os::unix::fs::symlink("/dev/zero", goals.join("zero.yaml")).unwrap();
        let mode = rustix::fs::Mode::from_raw_mode(0o600);
        let fifo = goals.join("fifo.yaml");
        rustix::fs::mknodat(rustix::fs::CWD, &fifo, rustix::fs::FileType::Fifo, mode, 0).unwrap();
        assert_eq!(read_goal_file(&goals, "below/goal.yaml").as_deref(), Ok("text"));
        for (name, reason) in [
            ("../secret.yaml", "leads out"),
            ("/dev/zero", "leads out"),
            ("zero.yaml", "not a regular file"),
            ("fifo.yaml", "not a regular file"),
            ("below", "not a regular file"),
            ("large.yaml", "larger than 1048576 bytes"),
            ("none.yaml", "No such file"),
        ] {
            let reported = read_goal_file(&goals, name).unwrap_err();
            assert!(reported.contains(reason), "{name}: {reported}");
        }
    }

    #[test]
    fn a_missing_pose_and_a_unit_are_named_together() {
        let reported = complaints("objects:\n  - {id: plank-1}\n  - {id: plank-2, pose: [100 mm, 0, 0]}\n");
        assert!(reported.contains("2:5: objects[0]: key \"pose\" is missing"), "{reported}");
        assert!(reported.contains("objects[1].pose[0]: \"100 mm\" is not a number"), "{reported}");
    }
}
