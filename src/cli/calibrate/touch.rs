//! `celld calibrate touches`, and tying the table to them.
//!
//! In: the cell's configuration, which points are touched, a robot that a person moves (celld reads where it
//! is and moves nothing). Out: `touches.yaml` with the arm's pose at each press of Enter, and each touch's
//! error by touch alone. `tied` later reports how the file and the table that the camera sees agree; a
//! disagreement above the limits is an error, and nothing is written. What is computed is
//! `cell_calibration::touching` and `cell_calibration::tied`.

use crate::cli::calibrate::fault::{Fault, bad_input};
use crate::cli::daemon::{open_shell, with_runtime};
use crate::config::cell::CellConfig;
use crate::config::load::load_cell;
use crate::config::setup::reference_markers;
use crate::daemon::shell::Shell;
use crate::jobs::utc;
use cell_calibration::files::hand_eye::Provenance;
use cell_calibration::files::touches::{Target, Touches};
use cell_calibration::fit::HandEye;
use cell_calibration::fit::touch::{Registration, RegistrationLimits, TouchFit};
use cell_calibration::tied::FittedTouches;
use cell_calibration::touching::TouchSession;
use cell_edge::clock::unix_now_s;
use cell_edge::files;
use cell_edge::terminal::complain;
use cell_values::units::{deg_from_rad, mm_from_m, rad_from_deg};
use clap::Args;
use nalgebra::Point3;
use rearrange::document::chain::chain;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use tokio::sync::oneshot::error::TryRecvError;

/// Shown under `celld calibrate touches --help`.
pub(super) const HELP: &str = "\
Mount a stiff pointed tip, measure where its point is in the flange frame (--tip-mm), and move the
arm with freedrive or by jogging, at the pendant in Local Control. celld names each point and reads
where the arm is when you press Enter; it moves nothing itself. Switch the pendant back to Remote
Control afterwards.
  celld calibrate touches --points 500,501:lower_left,503,0.25/0.25 --tip-mm 0,0,150 --save touches.yaml
A point is a reference marker's middle (500), a corner of its black square (500:lower_left, seen
upright), or a place in the table frame in m (0.25/0.25 or 0.25/0.25/0.02). Four far apart are
better than three; on one line they are refused. A file can also be written by hand: `tip_m: [x,
y, z]` for each touch, as the pendant shows it with the tip as its TCP.";

/// `celld calibrate touches`
#[derive(Args, Clone, Debug)]
pub struct TouchArgs {
    /// The cell's configuration.
    #[arg(long, default_value = "config/cell.yaml", value_name = "FILE")]
    config: PathBuf,
    /// What is touched, in this order: marker numbers, 500:lower_left, or x/y in m.
    #[arg(long, value_name = "LIST", value_delimiter = ',', required = true, value_parser = target)]
    points: Vec<Target>,
    /// The tip's point in the flange frame, mm; without it the tool of the configuration
    /// (`flange_from_tool`).
    #[arg(long, value_name = "X,Y,Z", value_parser = tip, allow_hyphen_values = true)]
    tip_mm: Option<Tip>,
    /// Where the touches are written.
    #[arg(long, value_name = "FILE")]
    save: PathBuf,
}

/// The tip in the flange frame, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tip([f64; 3]);

/// Tying the table to touches.
#[derive(Args, Clone, Debug)]
pub struct RegistrationArgs {
    /// Register the table to these touches (`celld calibrate touches`).
    #[arg(long, value_name = "FILE")]
    pub(super) touches: Option<PathBuf>,
    /// Leave these touches out, by their numbers: 2,5
    #[arg(long, value_name = "LIST", value_delimiter = ',', requires = "touches")]
    pub(super) drop_touch: Vec<usize>,
    /// How far touch and camera may put the table's middle apart, mm.
    #[arg(long, value_name = "MM", default_value = "1", value_parser = limit)]
    pub(super) tie_mm: f64,
    /// How far they may be turned against each other, degrees.
    #[arg(long, value_name = "DEG", default_value = "0.2", value_parser = limit)]
    pub(super) tie_deg: f64,
}

fn limit(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value <= 20.0 => Ok(value),
        _ => Err("give a number over 0 and up to 20".into()),
    }
}

fn numbers<const N: usize>(parts: std::str::Split<'_, char>) -> Option<[f64; N]> {
    let numbers: Option<Vec<f64>> =
        parts.map(|part| part.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
    numbers?.try_into().ok()
}

fn tip(text: &str) -> Result<Tip, String> {
    let found = numbers::<3>(text.split(',')).filter(|tip| tip.iter().all(|v| v.abs() <= 600.0));
    found.map(|mm| Tip(mm.map(|v| v / 1e3))).ok_or_else(|| "give three numbers in mm: 0,0,150".into())
}

fn target(text: &str) -> Result<Target, String> {
    text.parse()
}

/// Records touches; returns the exit code.
pub(super) fn run(args: &TouchArgs, stop: Arc<AtomicBool>) -> u8 {
    let config = match load_cell(&args.config).map_err(|error| error.to_string()).and_then(|config| {
        let survey = reference_markers(&config);
        let missing = args.points.iter().find(|target| target.on_table(&survey).is_none());
        match missing {
            None => Ok(config),
            Some(target) => {
                Err(format!("--points: {target}: the configuration has no such reference marker"))
            }
        }
    }) {
        Ok(config) => config,
        Err(message) => {
            complain(&message);
            return 2;
        }
    };
    let args = args.clone();
    with_runtime(stop, move |stop| async move { record(&config, &args, stop).await })
}

async fn record(config: &CellConfig, args: &TouchArgs, stop: Arc<AtomicBool>) -> Result<(), String> {
    let mut shell = open_shell(config, (unix_now_s() * 1e3) as u64)?;
    let stopped = || stop.load(Ordering::Relaxed);
    let arm = shell.identify(&stopped).await.map_err(|error| chain(&error))?;
    let tip = args.tip_mm.map_or_else(|| config.flange_from_tool.translation.vector.into(), |tip| tip.0);
    let begun = Touches {
        robot_serial: arm.serial.clone(),
        kinematics_checksum: arm.checksum.clone(),
        date: utc::text(unix_now_s()),
        flange_from_tip_m: Some(tip),
        touches: Vec::with_capacity(args.points.len()),
    };
    let mut session = TouchSession::new(args.points.clone(), arm.dh, begun);
    complain("move the arm at the pendant in Local Control, by jogging or with freedrive");
    while let Some((number, target)) = session.wanted() {
        let all = args.points.len();
        let reported = format!("touch {number}/{all}: bring the tip onto {target}, let go, press Enter");
        let at = touch(&mut shell, &mut session, &reported, &stopped).await?;
        complain(&format!("  tip at {:.4}, {:.4}, {:.4} m (base)", at.x, at.y, at.z));
    }
    let touches = session.touches();
    files::write_atomic(&args.save, touches.to_yaml().as_bytes()).map_err(|error| chain(&error))?;
    complain(&format!("wrote {}", args.save.display()));
    let fit = session.fit(&reference_markers(config))?;
    report(touches, &(0..touches.touches.len()).collect::<Vec<_>>(), &fit);
    let next = "now run `celld calibrate table --touches` with this file";
    complain(&format!("switch the pendant back to Remote Control; {next}"));
    Ok(())
}

/// Where the tip is when the person presses Enter and the arm is still, base frame, m; the robot's messages
/// are taken in meanwhile.
async fn touch(
    shell: &mut Shell,
    session: &mut TouchSession,
    prompt: &str,
    stopped: &dyn Fn() -> bool,
) -> Result<Point3<f64>, String> {
    loop {
        complain(prompt);
        // A thread of its own and not the runtime's, which would wait for the line at Ctrl-C.
        let (sender, mut reported) = tokio::sync::oneshot::channel();
        std::thread::spawn(move || sender.send(enter()));
        let pressed = loop {
            match reported.try_recv() {
                Ok(pressed) => break pressed,
                Err(TryRecvError::Closed) => break false,
                Err(TryRecvError::Empty) => {
                    shell.listen().await;
                }
            };
            if stopped() {
                return Err("stopped; nothing was written".into());
            }
        };
        if !pressed {
            return Err("no more input; nothing was written".into());
        }
        // What was sent before the press is old.
        shell.listen().await;
        let Some(state) = shell.robot_state() else {
            let links = shell.missing().join("; ");
            complain(&format!("  the robot does not say where it is ({links}); again"));
            continue;
        };
        match session.touch(&state.q, &state.qd) {
            Some(at) => return Ok(at),
            None => complain("  the arm was moving; let go of it, then press Enter again"),
        }
    }
}

/// Waits for a line; false at the end of the input.
fn enter() -> bool {
    let mut line = String::new();
    std::io::stdin().read_line(&mut line).is_ok_and(|count| count > 0)
}

impl RegistrationArgs {
    /// The touches, if any were given, and the table by them alone. What is wrong with them is to be
    /// reported before the arm moves for them.
    ///
    /// # Errors
    /// A file that is missing, broken or of another survey, a number that is not in it, touches that fix no
    /// table.
    pub(super) fn fitted(&self, config: &CellConfig) -> Result<Option<FittedTouches>, Fault> {
        let Some(path) = &self.touches else { return Ok(None) };
        let touches = read(path).map_err(bad_input)?;
        let survey = reference_markers(config);
        Ok(Some(FittedTouches::new(path.display().to_string(), touches, &self.drop_touch, &survey)?))
    }
}

fn read(path: &Path) -> Result<Touches, String> {
    let text = files::read_named(path, 1 << 20).map_err(|error| {
        format!("{}; touches are recorded with `celld calibrate touches --save FILE`", chain(&error))
    })?;
    Touches::parse(&text, &path.display().to_string()).map_err(|complaints| complaints.to_string())
}

/// The touches and the table by both, if touches were given.
///
/// # Errors
/// As [`RegistrationArgs::fitted`] and [`FittedTouches::check_robot`], or a disagreement.
pub(super) fn tied(
    config: &CellConfig,
    args: &RegistrationArgs,
    taken: &Provenance,
    camera: &HandEye,
) -> Result<Option<(FittedTouches, Registration)>, Fault> {
    let Some(touched) = args.fitted(config)? else { return Ok(None) };
    touched.check_robot(taken)?;
    report(touched.touches(), touched.used(), touched.fit());
    let limits = RegistrationLimits { shift_m: args.tie_mm / 1e3, turn_rad: rad_from_deg(args.tie_deg) };
    let registration =
        touched.register(camera, [config.workspace.width_m, config.workspace.height_m], &limits)?;
    let [x, y, z] = [registration.shift_m.x, registration.shift_m.y, registration.shift_m.z].map(mm_from_m);
    complain(&format!(
        "touch less camera: {x:+.2}, {y:+.2}, {z:+.2} mm at the table's middle, {:.3} degrees; {:.1} \
         standard deviations",
        deg_from_rad(registration.turn_rad),
        registration.in_std
    ));
    complain(&format!(
        "table by both: within {:.2} mm, {:.3} degrees (standard deviations)",
        mm_from_m(registration.std.translation_m),
        deg_from_rad(registration.std.rotation_rad)
    ));
    Ok(Some((touched, registration)))
}

/// Every touch with its error.
fn report(touches: &Touches, used: &[usize], fit: &TouchFit) {
    complain(&format!(
        "{} touches: {:.2} mm rms; a touch is taken to miss by {:.2} mm along each axis",
        used.len(),
        mm_from_m(fit.rms_m),
        mm_from_m(fit.touch_std_m)
    ));
    for (index, (residual, held_out)) in used.iter().zip(fit.residuals_m.iter().zip(&fit.held_out_m)) {
        let Some(touch) = touches.touches.get(*index) else { continue };
        let held_out = held_out.map_or(String::new(), |m| format!(", held out {:.2} mm", mm_from_m(m)));
        complain(&format!(
            "  touch {:2}, {}: {:.2} mm{held_out}",
            index + 1,
            touch.target,
            mm_from_m(*residual)
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_calibration::files::touches::Spot;

    #[test]
    fn points_and_tips_are_read_or_explained() {
        assert_eq!(target("500").unwrap(), Target::Marker { id: 500, at: Spot::Centre });
        assert_eq!(target("7:upper_left").unwrap(), Target::Marker { id: 7, at: Spot::UpperLeft });
        assert_eq!(target("0.25/0.1").unwrap(), Target::Point([0.25, 0.1, 0.0]));
        assert_eq!(target("0.25/-0.1/0.02").unwrap(), Target::Point([0.25, -0.1, 0.02]));
        for wrong in ["", "x", "500:middle", "250/100", "0.1/0.2/0.3/0.4", "nan/0"] {
            assert!(target(wrong).unwrap_err().contains("lower_left"), "{wrong}");
        }
        assert_eq!(tip("0,-1.5,150").unwrap(), Tip([0.0, -0.0015, 0.15]));
        assert!(tip("0,150").is_err() && tip("0,0,1500").is_err());
        assert!(limit("0").is_err() && limit("nan").is_err() && limit("0.5").is_ok());
    }
}
