//! Up, across and down again through two corners that are cut, at the limits of a cycle: the ways on which
//! a controller's blends are recorded.
//!
//! In: the arm, the cycle's heights and speeds, the size of the workspace, what may lie on the table. Out: a
//! [`Crossing`], and its checked path. Its ends are 5 cm over everything that may lie on the
//! table, and nothing of it is lower than 4 cm, so that nothing has to be seen before. Pure.

use crate::bodies::Room;
use crate::cycle::CycleParameters;
use crate::path::{ArmModel, CheckedPath, Leg, PathFault, out_of_reach};
use crate::pick_n_place::pieces::{corner, joint, linear, metres, widest};
use crate::pick_n_place::tool_down;
use cell_values::units::Joints;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// The ends of a crossing are so far over everything that may lie on the table, m: enough also for a table
/// that is only drawn yet.
const OVER_ALL_M: f64 = 0.05;

/// No place of it is nearer to what may lie there, m: a transfer sags between its ends.
const LOWEST_M: f64 = 0.04;

/// It goes up and down by at least so many blend radii, so that the corner is cut as the configuration says.
const RISE_IN_BLENDS: f64 = 2.0;

/// The ends of a crossing, in shares of the workspace; the first that the arm can reach are taken.
const ENDS: [[[f64; 2]; 2]; 4] =
    [[[0.2, 0.5], [0.8, 0.5]], [[0.5, 0.2], [0.5, 0.8]], [[0.3, 0.5], [0.7, 0.5]], [[0.3, 0.3], [0.7, 0.7]]];

/// Shares of the joint speed that are tried where a corner before a descent is no blend at full speed.
const SHARES: [f64; 4] = [0.7, 0.5, 0.35, 0.25];

/// Yaws of the tool that are tried at each.
const YAWS: usize = 8;

/// Up, across, down.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
pub struct Crossing {
    /// Where it begins, at rest.
    pub start: Joints,
    /// Straight over the start.
    pub lifted: Joints,
    /// Straight over the end.
    pub over: Joints,
    /// Where it ends, at rest.
    pub end: Joints,
    /// Slow the transfer until both corners are cut. Otherwise it is as fast as in a pick-n-place, and a
    /// corner that saves nothing is a stop.
    pub slower: bool,
}

impl Crossing {
    /// One over the middle of the workspace (width and depth, m), near to the joints `near`.
    ///
    /// # Errors
    /// Why the last of those that were tried cannot be carried out.
    pub fn over_table(
        model: &ArmModel,
        near: &Joints,
        workspace: [f64; 2],
        cycle: &CycleParameters,
        room: &Room,
    ) -> Result<Crossing, PathFault> {
        let mut fault = None;
        for ends in ENDS {
            for k in 0..YAWS {
                let yaw = TAU * k as f64 / YAWS as f64;
                let places = ends.map(|[x, y]| [x * workspace[0], y * workspace[1]]);
                let found = Crossing::between(model, near, places, yaw, cycle).and_then(|crossing| {
                    crossing.path(model, &crossing.start, cycle, room, f64::INFINITY)?;
                    let back = crossing.back();
                    back.path(model, &back.start, cycle, room, f64::INFINITY)?;
                    Ok(crossing)
                });
                match found {
                    Ok(crossing) => return Ok(crossing),
                    Err(why) => fault = Some(why),
                }
            }
        }
        let middle = tool_down(0.5 * workspace[0], 0.5 * workspace[1], cycle.layer() + OVER_ALL_M, 0.0);
        Err(fault.unwrap_or_else(|| out_of_reach("the middle of the workspace", &middle)))
    }

    fn between(
        model: &ArmModel,
        near: &Joints,
        [from, to]: [[f64; 2]; 2],
        yaw: f64,
        cycle: &CycleParameters,
    ) -> Result<Crossing, PathFault> {
        let low = cycle.layer() + OVER_ALL_M;
        let high = low + cycle.air.max(cycle.approach).max(RISE_IN_BLENDS * cycle.blend);
        let mut last = *near;
        let mut at = |what: &'static str, [x, y]: [f64; 2], z: f64| {
            let tool = tool_down(x, y, z, yaw);
            let found = model.joints_in_work_posture(&tool, &last);
            last = found.ok_or_else(|| out_of_reach(what, &tool))?;
            Ok(last)
        };
        Ok(Crossing {
            start: at("the start of a crossing", from, low)?,
            lifted: at("the corner over its start", from, high)?,
            over: at("the corner over its end", to, high)?,
            end: at("the end of a crossing", to, low)?,
            slower: false,
        })
    }

    /// The same from its end to its start.
    pub fn back(&self) -> Crossing {
        let Crossing { start, lifted, over, end, slower } = *self;
        Crossing { start: end, lifted: over, over: lifted, end: start, slower }
    }

    /// There and back as fast as the cycle allows, then there and back with both corners cut.
    pub fn both_ways(&self) -> Vec<Crossing> {
        let slow = Crossing { slower: true, ..*self };
        vec![*self, self.back(), slow, slow.back()]
    }

    /// The checked path of an arm that stands at `from`, which is near the start; what may hang on the cups
    /// withstands `hold` (m/s2).
    ///
    /// # Errors
    /// What the check of the path says.
    pub fn path(
        &self,
        model: &ArmModel,
        from: &Joints,
        cycle: &CycleParameters,
        room: &Room,
        hold: f64,
    ) -> Result<CheckedPath, PathFault> {
        let height = model.tool_at(&self.lifted).translation.z.min(model.tool_at(&self.over).translation.z);
        // There is a corner at both ends of the transfer.
        let across = 0.5 * metres(model, &self.lifted, &self.over);
        let straight = metres(model, &self.start, &self.lifted).min(metres(model, &self.over, &self.end));
        let radii = corner(height, 0.0, cycle, [across, straight]);
        let with_speed = |share: f64| {
            let slower = CycleParameters { joint_speed: share * cycle.joint_speed, ..cycle.clone() };
            widest(radii, |blend| {
                let segments = [
                    linear(self.lifted, cycle, blend),
                    joint(self.over, &slower, blend),
                    linear(self.end, cycle, 0.0),
                ];
                let legs = segments.map(|segment| Leg::over(segment, cycle.layer() + LOWEST_M).holding(hold));
                CheckedPath::new(model, from, &legs, room)
            })
        };
        let both = |path: &CheckedPath| path.segments().iter().filter(|one| one.blend() > 0.0).count() == 2;
        let slower = || SHARES.iter().filter_map(|share| with_speed(*share).ok()).find(both);
        let full = with_speed(1.0)?;
        Ok(if !self.slower || both(&full) { full } else { slower().unwrap_or(full) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{cycle, model, table};

    #[test]
    fn a_crossing_cuts_both_corners_and_stays_over_everything() {
        for width in [0.4, 0.8] {
            let (model, cycle) = (model(width), cycle());
            let room = Room::new(&model.bodies, &table(), None);
            let there = Crossing::over_table(&model, &model.home, [width, 0.5], &cycle, &room).unwrap();
            for crossing in there.both_ways().into_iter().filter(|crossing| crossing.slower) {
                let path = crossing.path(&model, &crossing.start, &cycle, &room, f64::INFINITY).unwrap();
                let radii: Vec<f64> = path.segments().iter().map(|segment| segment.blend()).collect();
                assert!(radii[..2].iter().all(|radius| *radius > 0.0) && radii[2] == 0.0, "{radii:?}");
                assert_eq!(path.end(), crossing.end);
                for q in [crossing.start, crossing.lifted, crossing.over, crossing.end] {
                    let height = model.tool_at(&q).translation.z;
                    assert!(height >= cycle.layer() + OVER_ALL_M - 1e-6, "{height}");
                }
            }
        }
    }

    #[test]
    fn a_table_out_of_reach_is_named() {
        let (model, cycle) = (model(0.5), cycle());
        let room = Room::empty();
        let fault = Crossing::over_table(&model, &model.home, [9.0, 9.0], &cycle, &room).unwrap_err();
        assert!(fault.to_string().contains("crossing"), "{fault}");
    }
}
