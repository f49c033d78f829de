//! The `goal` of a job file: poses, a file with poses, or a rule.
//!
//! In: the located value and what it is checked against. Out: a [`WantedGoal`], or complaints at the places
//! in the job file, and those about a goal file apart. A rule is checked as far as that needs no look at
//! the table; its poses are worked out after the job's first look (`rearrange::tabletop::rule`). `restore`
//! needs none: where the objects of the other job lay is in the journal. `look` wants nothing moved: the
//! job looks at the table, and what it found can be restored later.

use crate::jobs::goal::{
    GoalContext, GoalEntry, JobContext, check_goal, decode_goal, parse_goal_file, stays_below,
};
use crate::jobs::record::GoalPose;
use rearrange::document::Diagnostics;
use rearrange::document::decode::{At, Decoder, Fields};
use rearrange::geometry::collision::TOUCH_M;
use rearrange::tabletop::decode;
use rearrange::tabletop::instance::Workspace;
use rearrange::tabletop::rule::{GoalRule, Members, RuleFault, RuleTable};

/// The ways in which a goal is written; exactly one.
const WAYS: [&str; 7] = ["file", "objects", "region", "grid", "swap", "restore", "look"];

/// Most objects that a rule names one by one.
const MAX_NAMED: usize = 1000;

/// Marks a job that has no complaint of its own but whose goal file has.
pub(super) const UNUSED: &str = "the goal file has complaints";

/// What a job file says of its goal.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WantedGoal {
    /// Poses; empty for a rule, and for a look.
    pub poses: Vec<GoalPose>,
    /// How to get them once the table is seen.
    pub rule: Option<GoalRule>,
    /// The job whose first sight is wanted back, while its poses are not known (`celld submit`).
    pub restore: Option<String>,
}

impl WantedGoal {
    fn of(entries: Vec<GoalEntry>) -> WantedGoal {
        let poses = entries.into_iter().filter_map(GoalEntry::into_goal).collect();
        WantedGoal { poses, ..WantedGoal::default() }
    }

    fn by(rule: GoalRule) -> WantedGoal {
        WantedGoal { rule: Some(rule), ..WantedGoal::default() }
    }
}

/// Reads a goal in any of its ways.
pub(super) fn decode_goal_source(
    decoder: &mut Decoder,
    at: &At,
    context: &JobContext,
    goal_complaints: &mut Diagnostics,
) -> Option<WantedGoal> {
    let fields = decoder.map(at, &WAYS)?;
    let given: Vec<_> = WAYS.iter().filter_map(|way| Some((*way, fields.optional(way)?))).collect();
    let (way, value) = match given.as_slice() {
        [(way, value)] => (*way, value),
        [] => {
            let names = WAYS.map(|way| format!("{way:?}")).join(", ");
            let message = format!("none of {names} is given");
            decoder.complain_at(at, message, "say in one of these ways where things go");
            return None;
        }
        [(first, _), (_, second), ..] => {
            let message = format!("beside {first:?}");
            decoder.complain(second.key_at, &second.path, message, "remove one of the two");
            return None;
        }
    };
    let sound = decoder.count();
    let rule = match way {
        "file" => return decode_file(decoder, value, context, goal_complaints),
        "objects" => {
            let entries = decode_goal(decoder, value)?;
            if let Some(goal) = &context.goal {
                check_goal(decoder, &entries, goal);
            }
            return Some(WantedGoal::of(entries));
        }
        "restore" => return decode_restore(decoder, value, context),
        "look" => return decode_look(decoder, value),
        "region" => decode_region(decoder, value),
        "grid" => decode_grid(decoder, value),
        _ => decode_swap(decoder, value),
    }?;
    if let Some(goal) = context.goal.as_ref().filter(|_| decoder.count() == sound) {
        check_rule(decoder, value, &rule, goal);
    }
    Some(WantedGoal::by(rule))
}

fn decode_file(
    decoder: &mut Decoder,
    at: &At,
    context: &JobContext,
    goal_complaints: &mut Diagnostics,
) -> Option<WantedGoal> {
    let path = decoder.text(at)?;
    if !stays_below(&path) {
        let help = "name a file in the goal folder or below it: no leading /, no ..";
        decoder.complain_at(at, format!("{path:?} leads out of the goal folder"), help);
        return None;
    }
    let text = match (context.read_goal)(&path) {
        Ok(text) => text,
        Err(reason) => {
            let help = match context.goal.is_some() {
                true => "name a file of the cell's goal_folder",
                false => {
                    "name a file beside the job or in the cell's goal_folder (`--config` names the cell)"
                }
            };
            decoder.complain_at(at, format!("{path}: {reason}"), help);
            return None;
        }
    };
    match parse_goal_file(&text, &path, context.goal.as_ref()) {
        Ok(entries) => Some(WantedGoal::of(entries)),
        Err(complaints) => {
            goal_complaints.0.extend(complaints.0);
            decoder.complain_at(at, UNUSED, "");
            None
        }
    }
}

/// Nothing is wanted but to know what lies where.
fn decode_look(decoder: &mut Decoder, at: &At) -> Option<WantedGoal> {
    if !decoder.boolean(at)? {
        decoder.complain_at(at, "a look that is not wanted", "write `look: true`, or another goal");
        return None;
    }
    Some(WantedGoal::default())
}

/// The arrangement that a job found, as the journal has it; objects that never move are none of it.
fn decode_restore(decoder: &mut Decoder, at: &At, context: &JobContext) -> Option<WantedGoal> {
    let id = decoder.text(at)?;
    let Some(found) = context.found else {
        return Some(WantedGoal { restore: Some(id), ..WantedGoal::default() });
    };
    let mut poses = match found(&id) {
        Ok(poses) => poses,
        Err(reason) => {
            decoder.complain_at(at, reason, "`celld jobs` lists the jobs");
            return None;
        }
    };
    if let Some(goal) = &context.goal {
        poses.retain(|pose| goal.objects.iter().any(|object| object.id == pose.id && !object.fixed));
        if poses.is_empty() {
            decoder.complain_at(at, format!("job {id:?} found nothing that the catalogue has now"), "");
            return None;
        }
        let entry = |GoalPose { id, pose }: &GoalPose| GoalEntry {
            id: Some(id.clone()),
            pose: Some(*pose),
            at: at.node.at,
            path: at.path.clone(),
        };
        check_goal(decoder, &poses.iter().map(entry).collect::<Vec<_>>(), goal);
    }
    Some(WantedGoal { poses, ..WantedGoal::default() })
}

fn decode_region(decoder: &mut Decoder, at: &At) -> Option<GoalRule> {
    let fields = decoder.map(at, &["objects", "group", "polygon"])?;
    let members = decode_members(decoder, &fields);
    let polygon = fields.required("polygon", decoder).and_then(|at| decode::polygon(decoder, &at));
    Some(GoalRule::Region { members: members?, polygon: polygon?.points().to_vec() })
}

fn decode_grid(decoder: &mut Decoder, at: &At) -> Option<GoalRule> {
    let keys = ["objects", "group", "origin", "pitch", "columns", "theta", "theta_deg"];
    let fields = decoder.map(at, &keys)?;
    let members = decode_members(decoder, &fields);
    let lengths = |decoder: &mut Decoder, key: &str| {
        let at = fields.required(key, decoder)?;
        decoder.numbers_in::<2>(&at, -100.0..=100.0, "m")
    };
    let (origin, pitch) = (lengths(decoder, "origin"), lengths(decoder, "pitch"));
    let columns = fields.required("columns", decoder).and_then(|at| decoder.integer(&at, 1..=1000));
    let theta = match (fields.optional("theta"), fields.optional("theta_deg")) {
        (Some(_), Some(second)) => {
            decoder.complain(second.key_at, &second.path, "beside \"theta\"", "remove one of the two");
            None
        }
        (Some(at), None) => decoder.number_in(&at, -100.0..=100.0, "rad"),
        (None, Some(at)) => decoder.number_in(&at, -6000.0..=6000.0, "degrees").map(f64::to_radians),
        (None, None) => Some(0.0),
    };
    Some(GoalRule::Grid {
        members: members?,
        origin: origin?,
        pitch: pitch?,
        columns: u32::try_from(columns?).ok()?,
        theta: theta?,
    })
}

fn decode_swap(decoder: &mut Decoder, at: &At) -> Option<GoalRule> {
    let items = decoder.sequence(at)?;
    let [first, second] = items.as_slice() else {
        decoder.complain_at(at, format!("{} objects, 2 change places", items.len()), "write [a, b]");
        return None;
    };
    let (a, b) = (decoder.text(first), decoder.text(second));
    let (a, b) = (a?, b?);
    if a == b {
        decoder.complain_at(second, format!("{b:?} cannot change places with itself"), "name another one");
        return None;
    }
    Some(GoalRule::Swap(a, b))
}

/// `objects: [...]` or `group: G`.
fn decode_members(decoder: &mut Decoder, fields: &Fields) -> Option<Members> {
    match (fields.optional("objects"), fields.optional("group")) {
        (Some(objects), None) => {
            let items = decoder.sequence(&objects)?;
            if items.is_empty() || items.len() > MAX_NAMED {
                let message = format!("{} objects, between 1 and {MAX_NAMED} are wanted", items.len());
                decoder.complain_at(&objects, message, "a job has to ask for something");
                return None;
            }
            let ids: Vec<_> = items.iter().map(|item| decoder.text(item)).collect();
            let ids: Vec<String> = ids.into_iter().collect::<Option<_>>()?;
            for (k, id) in ids.iter().enumerate() {
                if ids[..k].contains(id) {
                    decoder.complain_at(&items[k], format!("{id:?} is named twice"), "remove one");
                }
            }
            Some(Members::Objects(ids))
        }
        (None, Some(group)) => decoder.text(&group).map(Members::Group),
        (Some(_), Some(second)) => {
            decoder.complain(second.key_at, &second.path, "beside \"objects\"", "remove one of the two");
            None
        }
        (None, None) => {
            let message = "neither \"objects\" nor \"group\" is given";
            decoder.complain(fields.at(), fields.path(), message, "say which objects are meant");
            None
        }
    }
}

/// Complains about what no table could fulfil: objects that are not there, a grid that is no arrangement, a
/// region off the table or without room.
fn check_rule(decoder: &mut Decoder, at: &At, rule: &GoalRule, goal: &GoalContext) {
    if let Err(fault) = rule.members(goal.objects) {
        return decoder.complain_at(at, fault.to_string(), advice(&fault, goal));
    }
    if let GoalRule::Region { polygon, .. } = rule {
        let outside = polygon.iter().find(|[x, y]| {
            let beyond = |value: f64, end: f64| value < -TOUCH_M || value > end + TOUCH_M;
            beyond(*x, goal.width_m) || beyond(*y, goal.height_m)
        });
        if let Some([x, y]) = outside {
            let help = format!("the table is {} m x {} m", goal.width_m, goal.height_m);
            return decoder.complain_at(at, format!("the corner [{x}, {y}] is off the table"), help);
        }
    }
    if let GoalRule::Swap(..) = rule {
        return;
    }
    let table = RuleTable {
        objects: goal.objects,
        workspace: Workspace { width: goal.width_m, height: goal.height_m },
        clearance: goal.clearance_m,
        overlap_tolerance: goal.overlap_tolerance_m,
        keep_out: goal.keep_out,
        at: &[],
    };
    match rule.resolve(&table, 0) {
        Err(fault) => decoder.complain_at(at, fault.to_string(), advice(&fault, goal)),
        Ok(poses) => {
            let entry = |(id, pose)| GoalEntry {
                id: Some(id),
                pose: Some(pose),
                at: at.node.at,
                path: at.path.clone(),
            };
            check_goal(decoder, &poses.into_iter().map(entry).collect::<Vec<_>>(), goal);
        }
    }
}

fn advice(fault: &RuleFault, goal: &GoalContext) -> String {
    match fault {
        RuleFault::Unknown(_) => {
            let ids: Vec<_> = goal.objects.iter().map(|object| object.id.as_str()).collect();
            format!("the catalogue has: {}", ids.join(", "))
        }
        RuleFault::UnknownGroup(_) => "give its members `group:` in the catalogue".to_string(),
        RuleFault::Fixed(_) => "remove it from the goal".to_string(),
        RuleFault::NotSeen(_) => String::new(),
        RuleFault::NoRoom(_) => "make the region larger, or name fewer objects".to_string(),
    }
}
