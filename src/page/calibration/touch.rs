//! Touches: a person brings the tool's tip onto points of the table, by hand or with the pendant.
//!
//! In: the points, the tip, the arm as its last state shows it. Out: the touches, each with its error once
//! they place the table. Nothing moves the arm. Pure.

use crate::config::cell::CellConfig;
use crate::config::setup::reference_markers;
use cell_calibration::files::touches::{Target, Touches};
use cell_calibration::touching::TouchSession;
use cell_machine::event::Arm;
use cell_values::units::{Joints, mm_from_m};
use serde_json::{Value, json};

/// Most points of one session.
const POINTS_MAX: usize = 40;

/// Farthest tip from the flange, m.
const TIP_M: f64 = 0.6;

/// See the module.
pub struct TouchWork {
    session: TouchSession,
    targets: Vec<Target>,
    begun: Touches,
    arm: Arm,
    said: String,
}

impl TouchWork {
    /// No touch yet. Without `tip_mm` it is the configuration's tool that touches.
    ///
    /// # Errors
    /// A point that is none, or a tip that is too far.
    pub fn new(
        config: &CellConfig,
        arm: &Arm,
        points: &[String],
        tip_mm: Option<[f64; 3]>,
        date: String,
    ) -> Result<TouchWork, String> {
        let targets: Result<Vec<Target>, String> = points.iter().map(|text| text.parse()).collect();
        let targets = targets?;
        if targets.is_empty() || targets.len() > POINTS_MAX {
            return Err(format!("name 1 to {POINTS_MAX} points"));
        }
        let survey = reference_markers(config);
        if let Some(target) = targets.iter().find(|target| target.on_table(&survey).is_none()) {
            return Err(format!("{target}: the configuration has no such reference marker"));
        }
        let tip = tip_mm.map_or_else(
            || config.flange_from_tool.translation.vector.into(),
            |mm| mm.map(|value| value / 1e3),
        );
        if !tip.iter().all(|value: &f64| value.abs() <= TIP_M) {
            return Err("the tip: three numbers in mm, at most 600 each".to_string());
        }
        let begun = Touches {
            robot_serial: arm.serial.clone(),
            kinematics_checksum: arm.checksum.clone(),
            date,
            flange_from_tip_m: Some(tip),
            touches: Vec::new(),
        };
        let session = TouchSession::new(targets.clone(), arm.dh, begun.clone());
        Ok(TouchWork { session, targets, begun, arm: arm.clone(), said: String::new() })
    }

    /// The tip is on the point that is wanted.
    pub fn touch(&mut self, q: &Joints, qd: &[f64; 6]) {
        self.said = match (self.session.wanted(), self.session.touch(q, qd)) {
            (None, _) => "all points are touched".to_string(),
            (Some(_), None) => "the arm was moving: let go of it, then again".to_string(),
            (Some((number, target)), Some(at)) => {
                let [x, y, z] = [at.x, at.y, at.z].map(mm_from_m);
                format!("touch {number}, {target}: the tip is at {x:.1}, {y:.1}, {z:.1} mm from the base")
            }
        };
    }

    /// Takes the last touch back.
    pub fn untouch(&mut self) {
        let mut kept = self.session.touches().touches.clone();
        kept.pop();
        let begun = Touches { touches: kept, ..self.begun.clone() };
        self.session = TouchSession::new(self.targets.clone(), self.arm.dh, begun);
        self.said = String::new();
    }

    /// What is recorded.
    pub fn touches(&self) -> &Touches {
        self.session.touches()
    }

    /// For the page.
    pub fn view(&self, config: &CellConfig) -> Value {
        let fit = self.session.fit(&reference_markers(config));
        let touches: Vec<Value> = self
            .touches()
            .touches
            .iter()
            .enumerate()
            .map(|(index, touch)| {
                let mm = fit.as_ref().ok().and_then(|fit| fit.residuals_m.get(index)).map(|m| mm_from_m(*m));
                let held_out = fit.as_ref().ok().and_then(|fit| fit.held_out_m.get(index).copied().flatten());
                json!({ "target": touch.target.to_string(), "mm": mm, "held_out_mm": held_out.map(mm_from_m) })
            })
            .collect();
        let wanted = self
            .session
            .wanted()
            .map(|(number, target)| json!({ "number": number, "target": target.to_string() }));
        let few = touches.len() < 3;
        json!({
            "of": self.targets.len(), "wanted": wanted, "touches": touches, "said": self.said,
            "rms_mm": fit.as_ref().ok().map(|fit| mm_from_m(fit.rms_m)),
            "fault": fit.err().filter(|_| !few),
        })
    }
}
