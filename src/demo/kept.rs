//! What is kept of a demo's run while it happens: pictures, log, plans, times.
//!
//! In: what the daemon shows, one thing after the other. Out: [`Kept`], from which the report is made.
//! Nothing is judged here.

use crate::report::run::LogRow;
use cell_machine::supervisor::order::{JobReport, RouteAction};
use cell_values::image::Image;
use cell_values::time::Timestamp;
use cell_vision::annotate::draw_detections;
use cell_vision::detect::Detection;
use cell_vision::observe::Observation;

/// Everything kept of a run.
pub struct Kept {
    /// Sentences with the cell's time.
    pub log: Vec<LogRow>,
    /// Annotated pictures of the look under way, then of the last one.
    look: Vec<Image>,
    look_over: bool,
    /// Annotated pictures of the first look.
    pub first_look: Vec<Image>,
    /// The first observation.
    pub first_seen: Option<Observation>,
    /// The last observation.
    pub last_seen: Option<Observation>,
    /// The first plan.
    pub plan: Vec<RouteAction>,
    /// Number of plans made.
    pub plans: usize,
    /// Number of looks.
    pub looks: usize,
    /// Carried-out moves with the time each ended.
    pub done: Vec<(RouteAction, Timestamp)>,
    route: Vec<RouteAction>,
    /// How the job ended.
    pub report: Option<JobReport>,
}

impl Default for Kept {
    fn default() -> Kept {
        Kept {
            log: Vec::new(),
            look: Vec::new(),
            look_over: true,
            first_look: Vec::new(),
            first_seen: None,
            last_seen: None,
            plan: Vec::new(),
            plans: 0,
            looks: 0,
            done: Vec::new(),
            route: Vec::new(),
            report: None,
        }
    }
}

impl Kept {
    /// Pictures of the last look.
    pub fn last_look(&self) -> &[Image] {
        &self.look
    }

    /// A picture of a look, and the markers found in it.
    pub fn picture(&mut self, image: &Image, detections: &[Detection]) {
        if self.look_over {
            self.look.clear();
            self.look_over = false;
        }
        let mut drawn = image.clone();
        draw_detections(&mut drawn, detections);
        self.look.push(drawn);
    }

    /// A look is over.
    pub fn observed(&mut self, observation: &Observation) {
        self.looks += 1;
        self.look_over = true;
        if self.first_seen.is_none() {
            self.first_seen = Some(observation.clone());
            self.first_look = self.look.clone();
        }
        self.last_seen = Some(observation.clone());
    }

    /// A shorter route is a move done; any other change is a new plan.
    pub fn routed(&mut self, now: Timestamp, route: &[RouteAction]) {
        // Where an object is picked up is measured anew before every move; the plan is the objects and
        // places.
        let places =
            |steps: &[RouteAction]| steps.iter().map(|s| (s.object.clone(), s.to)).collect::<Vec<_>>();
        let (before, after) = (places(&self.route), places(route));
        if before.get(1..) == Some(&after[..]) {
            self.done.push((self.route[0].clone(), now));
        } else if before != after && !after.is_empty() {
            self.plans += 1;
            if self.plan.is_empty() {
                self.plan = route.to_vec();
            }
        }
        self.route = route.to_vec();
    }
}
