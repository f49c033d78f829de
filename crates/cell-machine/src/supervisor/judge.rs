//! What makes a look useless: a bumped camera, objects that cannot be trusted, things that carry no marker.
//!
//! In: the observation of a look, the active job. Out: the first doubt, with its code, a sentence and what
//! to do about it; and, where the configuration says so, foreign objects as obstacles for planning and
//! motion.

use crate::code::Code;
use crate::supervisor::cell::Supervisor;
use crate::supervisor::input::Action;
use crate::supervisor::model::{CellModel, ForeignRule};
use crate::supervisor::reason::{Reason, say};
use cell_motion::pick_n_place::CycleParameters;
use cell_vision::foreign::{ForeignObject, ForeignReport};
use cell_vision::observe::Observation;
use cell_vision::observe::reference::{MARKERS_MIN, ReferenceCheck};
use rearrange::geometry::collision::penetration;
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use rearrange::tabletop::instance::KeepOut;
use rearrange::tabletop::rule::GoalRule;

/// Share of the table in which depth has to be measured for a look to say that nothing foreign is there.
const MEASURED_SHARE: f64 = 0.9;

/// Largest piece of the table in which depth may have measured nothing, m2; known objects and their shadows
/// do not count.
const HOLE_M2: f64 = 20e-4;

/// Share of the table that has to be measured for a place to be chosen in the rest.
const HALF_SEEN: f64 = 0.5;

/// Share of the limits of drift from which on a look that is still within them is reported.
const DRIFT_REPORTED: f64 = 0.5;

impl Supervisor {
    /// What makes an observation useless for the active job.
    pub(crate) fn judge(&self, observation: &Observation) -> Option<Reason> {
        let objects = || {
            self.reject_objects(observation).map(|reason| {
                let hint =
                    "look at the end picture of the job, put the table right, submit again".to_string();
                Reason { hint, ..reason }
            })
        };
        let foreign = || self.reject_foreign(observation);
        let calibration = self.reject_calibration(observation);
        // What a marker says about a thing is more exact than that there is one; a missing object may be the
        // thing.
        let named = !observation.suspicious.is_empty() || !observation.duplicates.is_empty();
        if named {
            calibration.or_else(objects).or_else(foreign)
        } else {
            calibration.or_else(foreign).or_else(objects)
        }
    }

    /// What the cell would refuse a job for, as far as what was seen last shows; `whole`: that was all of
    /// the table. Of a part of it only what is wrong there counts, not what is not shown.
    pub(crate) fn rejection_of_sight(&self, seen: &Observation, whole: bool) -> Option<Reason> {
        if whole {
            return self.judge(seen);
        }
        let enough = |check: &ReferenceCheck| {
            check.markers.len() >= self.model.tolerances.reference_seen && !check.looks.is_empty()
        };
        let shown = Observation {
            reference: seen.reference.clone().filter(enough),
            foreign: seen.foreign.clone().map(|report| ForeignReport {
                measured_share: 1.0,
                holes: Vec::new(),
                ..report
            }),
            ..seen.clone()
        };
        let calibration = || shown.reference.as_ref().and_then(|_| self.reject_calibration(&shown));
        let foreign = || shown.foreign.as_ref().and_then(|_| self.reject_foreign(&shown));
        calibration().or_else(foreign).or_else(|| self.reject_objects(&shown))
    }

    /// What makes a look useless for putting down what is held, whatever job waits. Of the held object
    /// itself it says nothing: its marker is wherever the arm is.
    pub(crate) fn rejection_on_the_way(&self, seen: &Observation) -> Option<Reason> {
        let held = self.back.held.as_ref().map(|held| held.object.as_str());
        let tilted = || {
            let mut others = seen.suspicious.iter().filter(|suspicious| Some(suspicious.id.as_str()) != held);
            let suspicious = others.next()?;
            let message = format!("{} does not lie flat on the table: {}", suspicious.id, suspicious.reason);
            Some(Code::ObjectTilted.because(message, "put it right by hand").of(&suspicious.id))
        };
        let foreign = || {
            let holes_are_taken =
                seen.foreign.as_ref().is_some_and(|report| report.measured_share >= HALF_SEEN);
            let whole = Observation {
                foreign: seen.foreign.clone().map(|report| ForeignReport {
                    measured_share: 1.0,
                    holes: Vec::new(),
                    ..report
                }),
                ..Observation::default()
            };
            self.reject_foreign(if holes_are_taken { &whole } else { seen })
        };
        self.reject_calibration(seen).or_else(|| self.reject_marker(seen)).or_else(foreign).or_else(tilted)
    }

    /// A marker that belongs to nothing the cell knows.
    fn reject_marker(&self, observation: &Observation) -> Option<Reason> {
        let known = |id: &&u32| self.model.ignore_markers.contains(id);
        let id = observation.unknown.iter().find(|id| !known(id))?;
        let message = format!("marker {id} is on the table and belongs to nothing the cell knows");
        Some(
            Code::UnknownMarker
                .because(message, "take it away, or name it in `ignore_markers`; then submit again"),
        )
    }

    /// The reference markers are not where they were surveyed, or too few of them are seen to decide.
    fn reject_calibration(&self, observation: &Observation) -> Option<Reason> {
        let tolerances = &self.model.tolerances;
        let seen = observation.reference.as_ref().map_or(0, |check| check.markers.len());
        if seen < tolerances.reference_seen {
            let message =
                format!("{seen} reference markers were seen, {} are needed", tolerances.reference_seen);
            let hint = "uncover and clean the reference markers, see that the table is lit, submit again";
            return Some(Code::ReferenceHidden.because(message, hint));
        }
        let check = observation.reference.as_ref()?;
        // Their mean over all looks does not show a bump: what it shifts from one side it shifts back from
        // another.
        if tolerances.reference_seen >= MARKERS_MIN && check.looks.is_empty() {
            let message = format!("no look pose shows {MARKERS_MIN} reference markers at once");
            let hint =
                "uncover the reference markers, or teach a look pose that shows three of them, submit again";
            return Some(Code::ReferenceHidden.because(message, hint));
        }
        if !check.drifted(&tolerances.reference) {
            return None;
        }
        let mm = |metres: f64| metres * 1e3;
        let mut message = format!(
            "the reference markers are {:.1} mm off, {:.1} mm are allowed: the table seems shifted by {:.1} \
             mm in x, {:.1} mm in y and {:.2} degrees",
            mm(check.residual_rms_m),
            mm(tolerances.reference.residual_m),
            mm(check.shift_m[0]),
            mm(check.shift_m[1]),
            check.turn_rad.to_degrees()
        );
        if let Some((look, _)) = check.worst_look(&tolerances.reference) {
            message.push_str(&format!(
                "; from the worst look pose by {:.1} mm in x, {:.1} mm in y, {:.1} mm in height and {:.2} \
                 degrees, {:.1} mm and {:.2} degrees are allowed",
                mm(look.shift_m[0]),
                mm(look.shift_m[1]),
                mm(look.lift_m),
                look.turn_rad.to_degrees(),
                mm(tolerances.reference.shift_m),
                tolerances.reference.turn_rad.to_degrees()
            ));
        }
        let hint = "see whether camera or table was moved, then `celld calibrate`";
        Some(Code::CalibrationInvalid.because(message, hint))
    }

    fn reject_objects(&self, observation: &Observation) -> Option<Reason> {
        let job = self.job.as_ref()?;
        if let Some(rejection) = self.reject_marker(observation) {
            return Some(rejection);
        }
        if let Some(duplicate) = observation.duplicates.first() {
            let message =
                format!("marker {} of {} was seen in two places", duplicate.marker_id, duplicate.id);
            return Some(Code::MarkerTwice.because(message, "").of(&duplicate.id));
        }
        let seen = |id: &str| observation.objects.iter().find(|object| object.id == id);
        let goals = job.order.goals.iter().map(|(id, _)| id.as_str());
        let named = job.order.rule.iter().flat_map(GoalRule::named);
        for id in goals.chain(named).chain(job.last_seen.iter().map(|seen| seen.id.as_str())) {
            if let Some(suspicious) = observation.suspicious.iter().find(|suspicious| suspicious.id == *id) {
                let message = format!("{id} does not lie flat on the table: {}", suspicious.reason);
                return Some(Code::ObjectTilted.because(message, "").of(id));
            }
            match seen(id) {
                None => {
                    let message = format!("{id} is not seen on the table");
                    return Some(Code::ObjectMissing.because(message, "").of(id));
                }
                Some(object) if object.std_xy_m > self.model.tolerances.measurement_std => {
                    let mm = object.std_xy_m * 1e3;
                    let message = format!("the position of {id} is uncertain by {mm:.1} mm");
                    return Some(Code::ObjectUncertain.because(message, "").of(id));
                }
                Some(_) => {}
            }
        }
        let suspicious = observation.suspicious.first()?;
        let (id, reason) = (&suspicious.id, &suspicious.reason);
        let message = format!("{id} does not lie flat on the table: {reason}");
        Some(Code::ObjectTilted.because(message, "").of(id))
    }

    /// Something is on the table that nothing explains, or depth gives no answer.
    fn reject_foreign(&self, observation: &Observation) -> Option<Reason> {
        let needed = match self.model.foreign {
            ForeignRule::Off => return None,
            ForeignRule::Refuse { depth_needed } => depth_needed,
            ForeignRule::Obstacle { .. } => true,
        };
        let Some(report) = &observation.foreign else {
            let hint =
                "see that the camera streams depth, or set `foreign: {mode: off}` knowing what that means";
            let message =
                "the look came without depth, which `foreign` in the configuration asks for".to_owned();
            return needed.then(|| Code::DepthMissing.because(message, hint));
        };
        if let Some(message) = unmeasured(report).filter(|_| report.by_colour) {
            let hint = "clear the table and run `celld calibrate empty` for these look poses";
            return Some(Code::TableNotCompared.because(message, hint));
        }
        if let Some(message) = unmeasured(report) {
            let hint = "light the table, clean the lens, see that the look poses show all of it from within \
                        the camera's range";
            return Some(Code::DepthPoor.because(message, hint));
        }
        match self.model.foreign {
            ForeignRule::Refuse { .. } => {}
            ForeignRule::Off | ForeignRule::Obstacle { .. } => return None,
        }
        let largest = report.objects.first()?;
        let more = match report.objects.len() {
            1 => String::new(),
            count => format!(", and {} more", count - 1),
        };
        let message =
            format!("{largest} belongs to nothing the cell knows{more}{}", perhaps(&observation.missing));
        let hint = "take it away, or put the object back with its marker up, then submit again";
        Some(Code::ForeignObject.because(message, hint))
    }

    /// Says once that a look, although within its limits, comes near to those of drift: a calibration that
    /// starts there leaves little room for what it should notice.
    pub(crate) fn report_drift(&mut self, observation: &Observation, out: &mut Vec<Action>) {
        let limits = &self.model.tolerances.reference;
        let worst = observation.reference.as_ref().and_then(|check| check.worst_look(limits));
        let Some((_, share)) = worst.filter(|(_, share)| *share > DRIFT_REPORTED) else { return };
        if !std::mem::replace(&mut self.drift_reported, true) {
            let share = share * 100.0;
            say(
                out,
                format!(
                    "the reference markers are off by {share:.0} % of what is allowed; if that is so right \
                     after a calibration, survey them anew or take more poses, else calibrate before it \
                     stops a job"
                ),
            );
        }
    }

    /// Reports where the obstacles are that are not in the configuration.
    pub(crate) fn report_obstacles(&self, observation: &Observation, out: &mut Vec<Action>) {
        for object in foreign_obstacles(&self.model, observation) {
            say(out, format!("{object} is kept clear of"));
        }
    }

    /// Where nothing may be put: what the configuration says, and what was seen without a marker.
    pub(crate) fn obstacles(&self, seen: &Observation) -> Vec<KeepOut> {
        let foreign = self.foreign_regions(seen).map(|(region, _)| region);
        self.model.keep_out.iter().cloned().chain(foreign).collect()
    }

    /// What was seen without a marker and counts as an obstacle, with its margin, and how high that is, m.
    pub(crate) fn foreign_regions(&self, seen: &Observation) -> impl Iterator<Item = (KeepOut, f64)> {
        let margin_m = margin_m(&self.model);
        let region =
            move |object: &ForeignObject| Some((object.keep_out(margin_m)?, object.height_m + margin_m));
        foreign_obstacles(&self.model, seen).iter().filter_map(region)
    }

    /// Heights and speeds of a cycle, over what carries no marker too, as the last look that measured it saw
    /// it.
    pub(crate) fn cycle(&self) -> CycleParameters {
        let mut cycle = self.model.cycle.clone();
        cycle.tallest = cycle.tallest.max(self.foreign_height);
        cycle
    }

    /// True when a disc at any of `places` that reaches down to `underside_m` would touch a foreign
    /// obstacle.
    pub(crate) fn meets_foreign(
        &self,
        seen: &Observation,
        places: &[[f64; 2]],
        radius_m: f64,
        underside_m: f64,
    ) -> Option<String> {
        let margin_m = margin_m(&self.model);
        let disc = Footprint::Disc { radius: radius_m };
        let tall = foreign_obstacles(&self.model, seen)
            .iter()
            .filter(|object| object.height_m + margin_m > underside_m);
        let meets = |place: &KeepOut| {
            let at = |[x, y]: &[f64; 2]| Pose2::new(*x, *y, 0.0);
            places.iter().any(|p| penetration(&disc, &at(p), &place.footprint, &place.pose) > 0.0)
        };
        let mut near = tall.filter(|object| object.keep_out(margin_m).as_ref().is_some_and(meets));
        near.next().map(ToString::to_string)
    }
}

/// What of the table depth says too little about.
fn unmeasured(report: &ForeignReport) -> Option<String> {
    let what = match report.by_colour {
        true => "the picture was compared with the empty table",
        false => "depth was measured",
    };
    // A share that is no number proves nothing.
    if report.measured_share.is_nan() || report.measured_share < MEASURED_SHARE {
        let share = report.measured_share * 100.0;
        return Some(format!("{what} on {share:.0} % only, too little to see what lies there"));
    }
    let hole = report.largest_hole().filter(|hole| hole.area_m2.is_nan() || hole.area_m2 > HOLE_M2)?;
    Some(format!("{what} nowhere on {hole}, where something may lie unseen"))
}

/// What might lie there unseen.
fn perhaps(missing: &[String]) -> String {
    if missing.is_empty() {
        return String::new();
    }
    format!("; not seen: {} (tipped over, or on its marker?)", missing.join(", "))
}

/// Things without a marker that count as obstacles.
fn foreign_obstacles<'a>(model: &CellModel, seen: &'a Observation) -> &'a [ForeignObject] {
    match (model.foreign, &seen.foreign) {
        (ForeignRule::Obstacle { .. }, Some(report)) => &report.objects,
        (ForeignRule::Obstacle { .. }, None) | (ForeignRule::Off | ForeignRule::Refuse { .. }, _) => &[],
    }
}

fn margin_m(model: &CellModel) -> f64 {
    match model.foreign {
        ForeignRule::Obstacle { margin_m } => margin_m,
        ForeignRule::Off | ForeignRule::Refuse { .. } => 0.0,
    }
}

/// Height over which the arm has to travel because of what carries no marker, m; `None` when depth does not
/// show it. It counts also where such things are refused: the arm still has to look again, and to be parked.
pub(crate) fn foreign_height(model: &CellModel, seen: &Observation) -> Option<f64> {
    if model.foreign == ForeignRule::Off {
        return Some(0.0);
    }
    let heights = seen.foreign.as_ref()?.objects.iter().map(|object| object.height_m + margin_m(model));
    Some(heights.fold(0.0, f64::max))
}
