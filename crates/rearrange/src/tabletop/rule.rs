//! Goals in other words than poses: a region, a grid, two objects that change places.
//!
//! In: a [`GoalRule`], the objects with where they lie now (as far as that is known), the table, a seed.
//! Out: a pose for each object that the rule names, or why there is none. An object that satisfies the rule
//! where it lies stays there: the fewest moves begin with goals that need none. The search in a region is
//! random and proves nothing; the same seed gives the same poses. Pure.

use crate::geometry::collision::{Placed, inside, penetration};
use crate::geometry::footprint::Footprint;
use crate::geometry::polygon::{Point, contains, cross, distance_to_outline, sub};
use crate::geometry::pose::Pose2;
use crate::tabletop::instance::{KeepOut, ObjectSpec, Workspace};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Tries of a whole region, from the start.
const ATTEMPTS: u32 = 60;

/// Places tried for one object in one attempt.
const PLACES: u32 = 300;

/// What reaches over a region's outline by less than this is inside it, m: the grain of written numbers.
const ON_THE_OUTLINE_M: f64 = 1e-9;

/// Which objects a rule is about.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Members {
    /// These, in this order.
    Objects(Vec<String>),
    /// All of one group of the catalogue; they are interchangeable.
    Group(String),
}

/// A wanted arrangement in words.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GoalRule {
    /// Each member lies wholly inside the polygon, wherever there is room.
    Region {
        /// Which objects.
        members: Members,
        /// A simple polygon, table frame, m.
        polygon: Vec<Point>,
    },
    /// The members lie in rows: member k at `origin + [k % columns * pitch[0], k / columns * pitch[1]]`.
    Grid {
        /// Which objects; those of a group take the cells as it suits them.
        members: Members,
        /// The first cell's origin, m.
        origin: Point,
        /// From cell to cell along x and from row to row along y, m.
        pitch: [f64; 2],
        /// Cells in a row, at least 1.
        columns: u32,
        /// Angle of each object, rad.
        theta: f64,
    },
    /// The two objects change places.
    Swap(String, String),
}

/// The table on which a rule is to hold.
#[derive(Clone, Copy, Debug)]
pub struct RuleTable<'a> {
    /// The catalogue.
    pub objects: &'a [ObjectSpec],
    /// Its extent.
    pub workspace: Workspace,
    /// Gap between objects, m.
    pub clearance: f64,
    /// Overlap up to which what lies on the table counts as apart, m: the error of a measurement.
    pub overlap_tolerance: f64,
    /// Places that stay free.
    pub keep_out: &'a [KeepOut],
    /// Where objects lie now; empty where nothing has been seen.
    pub at: &'a [(String, Pose2)],
}

/// Why a rule gives no poses.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RuleFault {
    /// The catalogue does not have it.
    #[error("object {0:?} is unknown")]
    Unknown(String),
    /// No object that moves is of this group.
    #[error("no object that moves is of group {0:?}")]
    UnknownGroup(String),
    /// It never moves.
    #[error("object {0:?} is fixed, it never moves")]
    Fixed(String),
    /// It is needed where it lies, and was not seen.
    #[error("object {0:?} is not seen on the table")]
    NotSeen(String),
    /// The search found no place for it beside the others.
    #[error("no place was found inside the region for {0:?} beside the others")]
    NoRoom(String),
}

impl GoalRule {
    /// The objects that the rule names, or all of its group that move.
    ///
    /// # Errors
    /// An object or group that the catalogue does not have, an object that never moves.
    pub fn members<'a>(&self, objects: &'a [ObjectSpec]) -> Result<Vec<&'a ObjectSpec>, RuleFault> {
        let named = |id: &String| {
            let object = objects.iter().find(|object| object.id == *id);
            let object = object.ok_or_else(|| RuleFault::Unknown(id.clone()))?;
            if object.fixed { Err(RuleFault::Fixed(id.clone())) } else { Ok(object) }
        };
        match self {
            GoalRule::Swap(a, b) => [a, b].into_iter().map(named).collect(),
            GoalRule::Region { members, .. } | GoalRule::Grid { members, .. } => match members {
                Members::Objects(ids) => ids.iter().map(named).collect(),
                Members::Group(group) => {
                    let of = |object: &&ObjectSpec| !object.fixed && object.group.as_ref() == Some(group);
                    let found: Vec<_> = objects.iter().filter(of).collect();
                    if found.is_empty() { Err(RuleFault::UnknownGroup(group.clone())) } else { Ok(found) }
                }
            },
        }
    }

    /// The objects that it names one by one.
    pub fn named(&self) -> Vec<&str> {
        match self {
            GoalRule::Swap(a, b) => vec![a, b],
            GoalRule::Region { members, .. } | GoalRule::Grid { members, .. } => match members {
                Members::Objects(ids) => ids.iter().map(String::as_str).collect(),
                Members::Group(_) => Vec::new(),
            },
        }
    }

    /// A pose for each member. Poses of a grid are not compared with the table: that is the caller's check
    /// of any goal.
    ///
    /// # Errors
    /// As [`GoalRule::members`]; for a region no place that was found, for a swap an object that was not
    /// seen.
    pub fn resolve(&self, table: &RuleTable, seed: u64) -> Result<Vec<(String, Pose2)>, RuleFault> {
        let members = self.members(table.objects)?;
        match self {
            GoalRule::Swap(a, b) => {
                let at = |id: &String| table.pose(id).ok_or_else(|| RuleFault::NotSeen(id.clone()));
                Ok(vec![(a.clone(), at(b)?), (b.clone(), at(a)?)])
            }
            GoalRule::Grid { members: who, origin, pitch, columns, theta } => {
                let columns = (*columns).max(1) as usize;
                let cell = |k: usize| {
                    let (column, row) = ((k % columns) as f64, (k / columns) as f64);
                    Pose2::new(origin[0] + column * pitch[0], origin[1] + row * pitch[1], *theta)
                };
                let cells: Vec<Pose2> = (0..members.len()).map(cell).collect();
                Ok(match who {
                    Members::Objects(ids) => ids.iter().cloned().zip(cells).collect(),
                    Members::Group(_) => table.nearest(&members, cells),
                })
            }
            GoalRule::Region { polygon, .. } => table.in_region(&members, polygon, seed),
        }
    }
}

impl RuleTable<'_> {
    fn pose(&self, id: &str) -> Option<Pose2> {
        self.at.iter().find(|(seen, _)| seen == id).map(|(_, pose)| *pose)
    }

    /// Which member takes which cell: the nearest pairs first, so that a member at a cell keeps it.
    fn nearest(&self, members: &[&ObjectSpec], cells: Vec<Pose2>) -> Vec<(String, Pose2)> {
        let mut pairs = Vec::new();
        for (member, object) in members.iter().enumerate() {
            // One that was not seen takes what is left, in the catalogue's order.
            let at = self.pose(&object.id);
            let far = |cell: &Pose2| at.map_or(f64::INFINITY, |at| at.distance(cell));
            pairs.extend(cells.iter().enumerate().map(|(cell, pose)| (far(pose), member, cell)));
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        let (mut taken, mut given) = (vec![false; cells.len()], BTreeMap::new());
        for (_, member, cell) in pairs {
            if !taken[cell] && !given.contains_key(&member) {
                taken[cell] = true;
                given.insert(member, cell);
            }
        }
        given.into_iter().map(|(member, cell)| (members[member].id.clone(), cells[cell])).collect()
    }

    /// Poses inside `polygon`. The first half of the attempts also keeps away from where other objects lie;
    /// the last quarter moves members that are inside already.
    fn in_region(
        &self,
        members: &[&ObjectSpec],
        polygon: &[Point],
        seed: u64,
    ) -> Result<Vec<(String, Pose2)>, RuleFault> {
        let mut large_first: Vec<usize> = (0..members.len()).collect();
        large_first.sort_by(|&a, &b| members[b].footprint.area().total_cmp(&members[a].footprint.area()));
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut fault = None;
        for attempt in 0..ATTEMPTS {
            let (keep, avoid) = (attempt < ATTEMPTS / 4 * 3, attempt < ATTEMPTS / 2);
            let blocked = if avoid { self.others(members) } else { Vec::new() };
            let mut search = Search { table: self, polygon, blocked, placed: Vec::new() };
            match search.run(members, &large_first, keep, &mut rng) {
                Ok(poses) => {
                    return Ok(members.iter().map(|member| member.id.clone()).zip(poses).collect());
                }
                Err(member) => fault = Some(RuleFault::NoRoom(members[member].id.clone())),
            }
        }
        Err(fault.unwrap_or_else(|| RuleFault::NoRoom(String::new())))
    }

    /// Objects that the rule does not name, where they lie.
    fn others(&self, members: &[&ObjectSpec]) -> Vec<Placed> {
        let named = |id: &str| members.iter().any(|member| member.id == id);
        let others = self.at.iter().filter(|(id, _)| !named(id));
        let footprint = |id: &str| self.objects.iter().find(|object| object.id == id).map(|o| &o.footprint);
        others.filter_map(|(id, pose)| Some(Placed::new(footprint(id)?, *pose))).collect()
    }
}

/// One attempt at a region.
struct Search<'a> {
    table: &'a RuleTable<'a>,
    polygon: &'a [Point],
    blocked: Vec<Placed>,
    placed: Vec<Placed>,
}

impl Search<'_> {
    /// A pose for each member, or the first for which there is none.
    fn run(
        &mut self,
        members: &[&ObjectSpec],
        order: &[usize],
        keep: bool,
        rng: &mut ChaCha8Rng,
    ) -> Result<Vec<Pose2>, usize> {
        let mut poses = vec![None; members.len()];
        for &member in order {
            let here = self.table.pose(&members[member].id).filter(|_| keep);
            poses[member] = here.filter(|pose| self.take(&members[member].footprint, *pose, false));
        }
        for &member in order {
            if poses[member].is_none() {
                let found = self.sample(members[member], rng);
                poses[member] = Some(found.ok_or(member)?);
            }
        }
        Ok(poses.into_iter().flatten().collect())
    }

    /// A free place for an object; with its present angle first.
    fn sample(&mut self, object: &ObjectSpec, rng: &mut ChaCha8Rng) -> Option<Pose2> {
        let range = |axis: usize| {
            let values = self.polygon.iter().map(|p| p[axis]);
            (values.clone().fold(f64::INFINITY, f64::min), values.fold(f64::NEG_INFINITY, f64::max))
        };
        let (x, y) = (range(0), range(1));
        let angle = self.table.pose(&object.id).map_or(0.0, |pose| pose.theta);
        (0..PLACES).find_map(|k| {
            let theta = if k < PLACES / 2 { angle } else { rng.random_range(0.0..TAU) };
            let pose = Pose2::new(
                x.0 + (x.1 - x.0) * rng.random_range(0.0..=1.0),
                y.0 + (y.1 - y.0) * rng.random_range(0.0..=1.0),
                theta,
            );
            self.take(&object.footprint, pose, true).then_some(pose)
        })
    }

    /// Puts a footprint down where it fits. What is `new` there keeps the clearance; what lies there already
    /// only has to be apart, as far as can be measured.
    fn take(&mut self, footprint: &Footprint, pose: Pose2, new: bool) -> bool {
        let RuleTable { workspace, clearance, overlap_tolerance, keep_out, .. } = self.table;
        if !inside(footprint, &pose, workspace.width, workspace.height)
            || !is_within(footprint, &pose, self.polygon)
            || keep_out.iter().any(|out| penetration(footprint, &pose, &out.footprint, &out.pose) > 0.0)
        {
            return false;
        }
        let placed = Placed::new(footprint, pose);
        let meets = |other: &Placed| match new {
            true => placed.closer_than(other, *clearance),
            false => placed.penetration(other) > *overlap_tolerance,
        };
        if self.placed.iter().chain(&self.blocked).any(meets) {
            return false;
        }
        self.placed.push(placed);
        true
    }
}

/// True when the whole footprint lies inside the simple polygon; to touch its outline is inside. A curve
/// counts as a circumscribed polygon.
pub fn is_within(footprint: &Footprint, pose: &Pose2, polygon: &[Point]) -> bool {
    let corners: Vec<Point> = footprint.outline(64).into_iter().map(|p| pose.transform(p)).collect();
    let on_it = |p: &Point| distance_to_outline(polygon, *p) <= ON_THE_OUTLINE_M;
    if !corners.iter().all(|p| contains(polygon, *p) || on_it(p)) {
        return false;
    }
    let edges = |points: &[Point]| -> Vec<[Point; 2]> {
        (0..points.len()).map(|k| [points[k], points[(k + 1) % points.len()]]).collect()
    };
    let (own, outline) = (edges(&corners), edges(polygon));
    // Of a polygon that is not convex, an edge or a corner may reach in between the corners.
    let crossed = own.iter().any(|a| outline.iter().any(|b| crosses(a, b)));
    let middle = |[a, b]: &[Point; 2]| [(a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0];
    let bridged = own.iter().map(middle).any(|p| !contains(polygon, p) && !on_it(&p));
    let reaches_in = polygon.iter().any(|p| footprint.contains_point(pose.inverse_transform(*p), 1e-9));
    !crossed && !bridged && !reaches_in
}

/// True when the segments cross in a point inside both.
fn crosses([a, b]: &[Point; 2], [c, d]: &[Point; 2]) -> bool {
    let side = |p: &Point, q: &Point, r: &Point| cross(sub(*q, *p), sub(*r, *p));
    let (first, second) = (side(a, b, c) * side(a, b, d), side(c, d, a) * side(c, d, b));
    first < -1e-18 && second < -1e-18
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SQUARE: [Point; 4] = [[0.0, 0.0], [0.4, 0.0], [0.4, 0.4], [0.0, 0.4]];

    /// A U, open at the top: its two arms are 0.1 m wide.
    const U: [Point; 8] =
        [[0.0, 0.0], [0.4, 0.0], [0.4, 0.4], [0.3, 0.4], [0.3, 0.1], [0.1, 0.1], [0.1, 0.4], [0.0, 0.4]];

    fn plank(id: &str, group: Option<&str>) -> ObjectSpec {
        let footprint = Footprint::rectangle(0.1, 0.04).expect("a rectangle");
        ObjectSpec { group: group.map(str::to_string), ..ObjectSpec::new(id, footprint) }
    }

    fn table<'a>(objects: &'a [ObjectSpec], at: &'a [(String, Pose2)]) -> RuleTable<'a> {
        let workspace = Workspace { width: 1.0, height: 1.0 };
        RuleTable { objects, workspace, clearance: 0.005, overlap_tolerance: 1e-6, keep_out: &[], at }
    }

    fn region(polygon: &[Point]) -> GoalRule {
        GoalRule::Region { members: Members::Group("planks".into()), polygon: polygon.to_vec() }
    }

    #[test]
    fn a_swap_takes_both_poses_as_they_are() {
        let objects = [plank("a", None), plank("b", None)];
        let at = [("a".to_string(), Pose2::new(0.1, 0.2, 0.3)), ("b".to_string(), Pose2::new(0.5, 0.6, 0.7))];
        let swap = GoalRule::Swap("a".into(), "b".into());
        let goals = swap.resolve(&table(&objects, &at), 0).expect("both are seen");
        assert_eq!(goals, [("a".to_string(), at[1].1), ("b".to_string(), at[0].1)]);
        let fault = swap.resolve(&table(&objects, &at[..1]), 0);
        assert_eq!(fault, Err(RuleFault::NotSeen("b".into())));
        let fault = GoalRule::Swap("a".into(), "c".into()).resolve(&table(&objects, &at), 0);
        assert_eq!(fault, Err(RuleFault::Unknown("c".into())));
    }

    #[test]
    fn a_grid_is_filled_in_the_order_named_and_by_a_group_as_it_lies() {
        let objects: Vec<_> = ["a", "b", "c"].map(|id| plank(id, Some("planks"))).to_vec();
        let grid = |members| GoalRule::Grid {
            members,
            origin: [0.1, 0.1],
            pitch: [0.2, 0.3],
            columns: 2,
            theta: 0.5,
        };
        let named = grid(Members::Objects(vec!["c".into(), "a".into(), "b".into()]));
        let goals = named.resolve(&table(&objects, &[]), 0).expect("a grid");
        let poses = [(0.1, 0.1), (0.3, 0.1), (0.1, 0.4)].map(|(x, y)| Pose2::new(x, y, 0.5));
        let near = |a: &Pose2, b: &Pose2| a.distance(b) < 1e-12 && a.theta == b.theta;
        assert!(goals.iter().zip(&poses).all(|((_, a), b)| near(a, b)), "{goals:?}");
        assert_eq!(goals.iter().map(|(id, _)| id.as_str()).collect::<Vec<_>>(), ["c", "a", "b"]);
        // b lies where the first cell is, and stays; a is nearer to the second than c.
        let at = [("a", 0.4, 0.1), ("b", 0.1, 0.1), ("c", 0.9, 0.9)]
            .map(|(id, x, y)| (id.to_string(), Pose2::new(x, y, 0.5)));
        let goals = grid(Members::Group("planks".into())).resolve(&table(&objects, &at), 0);
        let by_name: BTreeMap<_, _> = goals.expect("a grid").into_iter().collect();
        assert!(near(&by_name["b"], &poses[0]) && near(&by_name["a"], &poses[1]), "{by_name:?}");
        assert!(near(&by_name["c"], &poses[2]), "{by_name:?}");
    }

    #[test]
    fn what_lies_in_the_region_stays_and_the_rest_comes_beside_it() {
        let objects: Vec<_> = ["a", "b", "c"].map(|id| plank(id, Some("planks"))).to_vec();
        let inside = Pose2::new(0.2, 0.2, 0.1);
        let at = [("a".to_string(), Pose2::new(0.8, 0.8, 0.4)), ("b".to_string(), inside)];
        let goals = region(&SQUARE).resolve(&table(&objects, &at), 7).expect("there is room");
        let by_name: BTreeMap<_, _> = goals.iter().cloned().collect();
        assert_eq!(by_name["b"], inside);
        assert_eq!(by_name["a"].theta, 0.4, "the angle is kept where it can be");
        assert_eq!(region(&SQUARE).resolve(&table(&objects, &at), 7), Ok(goals), "the seed decides");
        let narrow = [[0.0, 0.0], [0.12, 0.0], [0.12, 0.09], [0.0, 0.09]];
        let fault = region(&narrow).resolve(&table(&objects, &at), 7);
        assert!(matches!(fault, Err(RuleFault::NoRoom(_))), "{fault:?}");
    }

    #[test]
    fn a_place_between_the_arms_of_a_region_is_not_inside_it() {
        let plank = Footprint::rectangle(0.3, 0.02).expect("a rectangle");
        assert!(is_within(&plank, &Pose2::new(0.2, 0.05, 0.0), &U));
        // Both ends in the arms, the middle over the gap.
        assert!(!is_within(&plank, &Pose2::new(0.2, 0.3, 0.0), &U));
        let disc = Footprint::disc(0.05).expect("a disc");
        assert!(!is_within(&disc, &Pose2::new(0.1, 0.1, 0.0), &U), "the inner corner reaches in");
        let rectangle = Footprint::rectangle(0.4, 0.1).expect("a rectangle");
        assert!(is_within(&rectangle, &Pose2::new(0.2, 0.05, 0.0), &U), "what touches is inside");
    }

    proptest! {
        #[test]
        fn poses_of_a_region_are_inside_it_and_apart(
            seed in 0u64..1000, count in 1usize..7, x in 0.0f64..1.0, y in 0.0f64..1.0,
        ) {
            let objects: Vec<_> = (0..count).map(|k| plank(&k.to_string(), Some("planks"))).collect();
            let at = [("0".to_string(), Pose2::new(x, y, 1.0))];
            let table = table(&objects, &at);
            let Ok(goals) = region(&U).resolve(&table, seed) else { return Ok(()) };
            prop_assert_eq!(goals.len(), count);
            let placed: Vec<_> = goals.iter().map(|(_, pose)| Placed::new(&objects[0].footprint, *pose)).collect();
            for (k, (_, pose)) in goals.iter().enumerate() {
                prop_assert!(is_within(&objects[k].footprint, pose, &U), "{:?}", pose);
                prop_assert!(placed[..k].iter().all(|other| !placed[k].closer_than(other, 0.0049)));
            }
        }
    }
}
