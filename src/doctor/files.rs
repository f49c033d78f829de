//! The configuration and the calibration files: what is in them, how old they are, whether they are this
//! arm's, and whether the taught poses are free.
//!
//! In: the checked configuration, the calibration set or the complaints about it, the arm where it is known.
//! Out: lines. Pure.

use crate::config::blends::recorded_blends;
use crate::config::cell::CellConfig;
use crate::config::setup::{Measured, arm_model, cell_model};
use crate::doctor::{Area, Line};
use crate::jobs::utc;
use cell_calibration::files::set::CalibrationSet;
use cell_machine::event::Arm;
use cell_machine::supervisor::model::CellModel;
use cell_motion::bodies::Room;
use cell_motion::bodies::sweep::{Meeting, Sweep, Zone};
use cell_values::units::Joints;

/// A calibration older than this is worth a new look, s.
const OLD_S: f64 = 90.0 * 86_400.0;

fn ok(item: &'static str, found: impl Into<String>) -> Line {
    Line::ok(Area::Files, item, found)
}

fn problem(item: &'static str, found: impl Into<String>, hint: impl Into<String>) -> Line {
    Line::problem(Area::Files, item, found, hint)
}

/// What the configuration holds.
pub fn configuration(config: &CellConfig, simulated: bool) -> Line {
    let found = format!(
        "{} objects, {} reference markers, {} look poses, approval {}{}",
        config.objects.len(),
        config.reference_markers.len(),
        config.look_poses.len(),
        config.approval,
        if simulated { "; a simulation" } else { "" }
    );
    ok("configuration", found)
}

/// The three calibration files.
pub fn calibration(read: &Result<CalibrationSet, String>, unix_s: f64) -> Vec<Line> {
    let set = match read {
        Ok(set) => set,
        Err(complaints) => {
            let hint =
                "`celld calibrate` makes them, in the order camera, hand-eye, table (docs/calibration.md)";
            return complaints.lines().map(|line| problem("calibration", line, hint)).collect();
        }
    };
    let dated = |item, what: String, date: &str| age_line(item, &what, date, unix_s);
    let made_with = &set.hand_eye.provenance;
    let mount = format!("camera {} on arm {}", made_with.camera_serial, made_with.robot_serial);
    let table = format!("{:.2} mm uncertain", 1e3 * set.table.std.translation_m);
    vec![
        dated("lens", format!("{}, {}", set.camera.model.serial, set.camera.source), &set.camera.date),
        dated("camera mount", mount, &made_with.date),
        dated("table", table, &set.table.provenance.date),
    ]
}

fn age_line(item: &'static str, what: &str, date: &str, unix_s: f64) -> Line {
    let Some(made) = utc::parse(date) else {
        return Line::note(Area::Files, item, format!("{what}, of unknown age ({date})"), "");
    };
    let age_s = unix_s - made;
    let days = (age_s / 86_400.0).floor();
    let found = match days {
        days if days < 1.0 => format!("{what}, made today"),
        days if days < 2.0 => format!("{what}, 1 day old"),
        days => format!("{what}, {days:.0} days old"),
    };
    if age_s < -60.0 {
        let found = format!("{what}, dated {date}, which is still to come");
        return Line::note(Area::Files, item, found, "one of the two computers' clocks is wrong");
    }
    if age_s > OLD_S {
        let hint = "see the line on drift; `celld calibrate` again if it shows any";
        return Line::note(Area::Files, item, found, hint);
    }
    ok(item, found)
}

/// Whether the calibration is this arm's.
pub fn fits(config: &CellConfig, set: &CalibrationSet, arm: &Arm) -> Line {
    match set.check_arm(&config.calibration.hand_eye.display().to_string(), &arm.serial, &arm.checksum) {
        Ok(()) => ok("arm", format!("the calibration was made with this arm ({})", arm.serial)),
        Err(complaint) => problem("arm", complaint, "`celld calibrate` with this arm (docs/calibration.md)"),
    }
}

/// Whether the arm cuts corners.
pub fn blends(config: &CellConfig, measured: &Measured, arm: &Arm) -> Line {
    if config.limits.blend_m <= 0.0 {
        return ok("blends", "none: `limits.blend_m` is 0");
    }
    if config.simulation.is_some() {
        return ok("blends", "on, radius from `limits.blend_m`; simulated cells need no recording");
    }
    let model = arm_model(config, measured.dh, measured.base_from_table);
    let recorded = match recorded_blends(config, &model, arm) {
        Ok(recorded) => recorded,
        Err(why) => {
            let hint = "`celld calibrate blends` records how this controller passes corners; until then the \
                        arm stops at each corner";
            return Line::note(Area::Files, "blends", why, hint);
        }
    };
    let (fastest_m_s, off_mm) = (recorded.fastest_m_s(), 1e3 * recorded.off_m());
    let (date, ways) = (recorded.date, recorded.passages.len());
    let found =
        format!("recorded {date}: {ways} ways at up to {fastest_m_s:.2} m/s, at most {off_mm:.1} mm off");
    ok("blends", found)
}

/// The taught poses, with the bodies of the cell round them and nothing on the table.
pub fn taught_poses(config: &CellConfig, measured: &Measured) -> Vec<Line> {
    let model = match cell_model(config, measured) {
        Ok(model) => model,
        Err(error) => {
            let hint = "correct the catalogue in the configuration";
            return vec![problem("objects", error.to_string(), hint)];
        }
    };
    let blocked = blocked_poses(config, &model);
    if blocked.is_empty() {
        return vec![ok("taught poses", "all keep clear of every body of the cell")];
    }
    let hint = "teach it anew with more room, or correct what the configuration says of the cell (`cell:`)";
    blocked.into_iter().map(|found| problem("taught poses", found, hint)).collect()
}

/// The taught poses in which the arm would be too near to itself or to something of the cell, and to what.
pub fn blocked_poses(config: &CellConfig, model: &CellModel) -> Vec<String> {
    let room = Room::empty();
    let mut sweep = Sweep::new(&model.arm.bodies, &room);
    let blocked = taught(config).into_iter().filter_map(|(key, q)| {
        let meeting = sweep.place(&q, Zone::Over).err()?;
        Some(format!("{key}: {}", meets(&meeting)))
    });
    blocked.collect()
}

fn meets(Meeting { one, other, distance, .. }: &Meeting) -> String {
    if *distance > 0.0 {
        format!("{one} is {:.1} mm from {other}, nearer than `cell.margin_m` allows", 1e3 * distance)
    } else {
        format!("{one} meets {other}")
    }
}

/// Each with its key in the configuration.
fn taught(config: &CellConfig) -> Vec<(String, Joints)> {
    let listed = |key: &'static str, poses: &[Joints]| {
        poses.iter().enumerate().map(|(i, q)| (format!("{key}[{i}]"), *q)).collect::<Vec<_>>()
    };
    let mut all = vec![("park_pose_deg".to_string(), config.park_pose)];
    all.push(("work_pose_deg".to_string(), config.work_pose));
    all.extend(listed("look_poses_deg", &config.look_poses));
    all.extend(listed("calibration_poses_deg", &config.calibration_poses));
    all
}
