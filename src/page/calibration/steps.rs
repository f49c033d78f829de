//! The steps of a calibration: what the page requests, and what there is.
//!
//! In: steps of an engineer. Out: the state of the bench after each. None of them moves the arm; a round is
//! ordered at `POST /api/v1/orders`.

use crate::jobs::utc;
use crate::page::access::Person;
use crate::page::calibration::bench::Request;
use crate::page::calibration::kept::Kept;
use crate::page::calibration::lens::LensWork;
use crate::page::calibration::touch::TouchWork;
use crate::page::guard::Refused;
use crate::page::shared::{App, Shared};
use axum::body::Bytes;
use axum::extract::rejection::JsonRejection;
use axum::extract::{Extension, Json, Path, State};
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use cell_calibration::taken::Wanted;
use cell_edge::clock::unix_now_s;
use cell_vision::board::Board;
use cell_vision::detect::Family;
use serde::Deserialize;
use serde_json::{Value, json};
use std::time::Duration;

/// From the press of the button to a state of the arm that is of after it: two states that are shown.
const AFTER_PRESS: Duration = Duration::from_millis(250);

/// Largest board.
const MARKERS_MAX: u32 = 500;

/// `POST /api/v1/calibration`
#[derive(Debug, Deserialize)]
#[serde(tag = "do", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Step {
    /// Pictures of this board are taken from now on; those before are gone.
    Board {
        /// Markers across.
        columns: u32,
        /// Markers up.
        rows: u32,
        /// Edge of a black square as measured, mm.
        size_mm: f64,
        /// White between two squares, mm; absent: as `celld markers` prints.
        gap_mm: Option<f64>,
        /// The lowest number.
        #[serde(default)]
        first_id: u32,
    },
    /// The camera's picture of now is one.
    Picture,
    /// One is taken whenever the board rests somewhere new, or no longer.
    Auto {
        /// On or off.
        on: bool,
    },
    /// The lens of the pictures but these.
    Lens {
        /// By name.
        #[serde(default)]
        drop: Vec<String>,
    },
    /// These points are touched from now on; touches before are gone.
    Touches {
        /// As for `celld calibrate touches --points`.
        points: Vec<String>,
        /// The tip in the flange frame; absent: the configuration's tool.
        tip_mm: Option<[f64; 3]>,
    },
    /// The tip is on the next point, and the arm rests.
    Touch,
    /// The last touch was none.
    Untouch,
    /// Camera and table of the round.
    Solve {
        /// The table alone: the camera's place is kept.
        #[serde(default)]
        table_only: bool,
        /// Samples to leave out, from 1.
        #[serde(default)]
        drop: Vec<usize>,
        /// The table is tied to the touches.
        #[serde(default)]
        #[serde(rename = "tie")]
        registration: bool,
    },
    /// What was solved is written into the calibration files.
    Keep {
        /// Which one was looked at, by `solved.number`.
        number: u64,
    },
}

fn unfit(message: impl Into<String>) -> Refused {
    Refused::new(StatusCode::UNPROCESSABLE_ENTITY, message)
}

fn conflict(message: impl Into<String>) -> Refused {
    Refused::new(StatusCode::CONFLICT, message)
}

async fn beside(work: impl FnOnce() -> Result<Value, Refused> + Send + 'static) -> Result<Value, Refused> {
    let done = tokio::task::spawn_blocking(work).await;
    done.map_err(|_| Refused::fault("this is a fault of celld; see its log"))?
}

/// `GET /api/v1/calibration`
///
/// # Errors
/// A fault of celld.
pub async fn state(State(app): State<App>) -> Result<Response, Refused> {
    app.calibrates();
    Ok(Json(beside(move || Ok(view(&app))).await?).into_response())
}

/// Takes a step.
///
/// # Errors
/// A body that is no step, or why the step cannot be taken now.
pub async fn step(
    State(app): State<App>,
    Extension(person): Extension<Person>,
    body: Result<Json<Step>, JsonRejection>,
) -> Result<Response, Refused> {
    let Json(step) = body.map_err(|error| Refused::new(error.status(), error.body_text()))?;
    tracing::info!(?step, by = person.grant.name, "calibration at the page");
    app.calibrates();
    let taken = beside(move || {
        take(&app, step)?;
        Ok(view(&app))
    });
    Ok(Json(taken.await?).into_response())
}

/// `GET /api/v1/calibration/pictures/{name}`
///
/// # Errors
/// There is no such picture.
pub async fn picture(State(app): State<App>, Path(name): Path<String>) -> Result<Response, Refused> {
    let found = tokio::task::spawn_blocking(move || app.calibration().jpeg(&name)).await;
    let jpeg: Option<Bytes> = found.map_err(|_| Refused::fault("this is a fault of celld; see its log"))?;
    let jpeg = jpeg.ok_or_else(|| Refused::new(StatusCode::NOT_FOUND, "there is no such picture"))?;
    Ok(([(CONTENT_TYPE, "image/jpeg")], jpeg).into_response())
}

fn view(app: &Shared) -> Value {
    let mut view = app.calibration().view(&app.cell);
    let (config, known) = (&app.cell, app.feed.cell());
    let files = &config.calibration;
    let paths = [&files.camera, &files.hand_eye, &files.table].map(|path| path.display().to_string());
    let tolerances = &config.tolerances;
    view["cell"] = json!({
        "poses": config.calibration_poses.len(), "mount": config.camera.as_str(),
        "references": config.reference_markers.iter().map(|marker| marker.id).collect::<Vec<u32>>(),
        "files": paths,
        "lens": known.as_ref().map(|known| json!({
            "source": known.lens.source, "date": known.lens.date, "px": known.lens.reprojection_px,
        })),
        "tip_mm": config.flange_from_tool.translation.vector.as_slice().iter().map(|m| m * 1e3).collect::<Vec<f64>>(),
        "limits": {
            "residual_mm": tolerances.reference_residual_m * 1e3, "shift_mm": tolerances.reference_shift_m * 1e3,
            "turn_deg": tolerances.reference_turn_rad.to_degrees(),
        },
    });
    let sight = app.feed.last_sight();
    view["drift"] = json!(sight.as_ref().and_then(|sight| sight.seen.reference.as_ref().map(|check| {
        let looks = check.looks.iter().map(|look| json!({
            "markers": look.markers, "shift_mm": look.shift_m.map(|m| m * 1e3), "lift_mm": look.lift_m * 1e3,
            "turn_deg": look.turn_rad.to_degrees(),
        }));
        json!({
            "unix_s": sight.unix_s, "residual_mm": check.residual_rms_m * 1e3, "most_mm": check.residual_max_m * 1e3,
            "looks": looks.collect::<Vec<Value>>(),
            "markers": check.markers.iter().map(|marker| json!({ "id": marker.id, "error_mm": marker.error_m.map(|m| m * 1e3) }))
                .collect::<Vec<Value>>(),
        })
    })));
    view
}

fn take(app: &Shared, step: Step) -> Result<(), Refused> {
    let now = unix_now_s();
    match step {
        Step::Board { columns, rows, size_mm, gap_mm, first_id } => {
            let sound = |mm: f64| mm.is_finite() && mm > 0.0 && mm <= 500.0;
            let count = columns.saturating_mul(rows);
            if !(1..=MARKERS_MAX).contains(&count) || !sound(size_mm) || gap_mm.is_some_and(|mm| !sound(mm)) {
                return Err(unfit("a board has 1 to 500 markers, squares of up to 500 mm"));
            }
            let mut board = Board::new(Family::Tag36h11, columns, rows, size_mm / 1e3, first_id);
            if let Some(mm) = gap_mm {
                board.gap_m = mm / 1e3;
            }
            app.calibration().lens = Some(LensWork::new(board).map_err(Refused::fault)?);
        }
        Step::Picture => {
            let image = app.screen.now();
            lens(app, |lens| lens.picture(image.as_deref()))?;
        }
        Step::Auto { on } => lens(app, |lens| lens.set_auto(on))?,
        Step::Lens { drop } => lens(app, |lens| lens.solve(&drop))?,
        Step::Touches { points, tip_mm } => {
            let known = app.feed.cell().ok_or_else(|| conflict("celld waits for the robot"))?;
            let work =
                TouchWork::new(&app.cell, &known.arm, &points, tip_mm, utc::text(now)).map_err(unfit)?;
            app.calibration().touches = Some(work);
        }
        Step::Touch => {
            std::thread::sleep(AFTER_PRESS);
            let (q, qd) = app
                .feed
                .joints_now(AFTER_PRESS)
                .ok_or_else(|| conflict("the robot does not say where it is; nothing was recorded"))?;
            touches(app, |work| work.touch(&q, &qd))?;
        }
        Step::Untouch => touches(app, TouchWork::untouch)?,
        Step::Solve { table_only, drop, registration } => {
            let known = app.feed.cell().ok_or_else(|| conflict("celld waits for the robot"))?;
            let wanted = if table_only { Wanted::Table } else { Wanted::MountAndTable };
            let request = Request { wanted, dropped: &drop, registration, date: &utc::text(now) };
            app.calibration().solve(&app.cell, &known, &request);
        }
        Step::Keep { number } => {
            let to = Kept { state: app.state.root(), when: &utc::compact(now) };
            app.calibration().keep(number, &app.cell, &to).map_err(conflict)?;
        }
    }
    Ok(())
}

fn lens<T>(app: &Shared, work: impl FnOnce(&mut LensWork) -> T) -> Result<T, Refused> {
    let mut bench = app.calibration();
    let lens = bench.lens.as_mut().ok_or_else(|| conflict("name the board first"))?;
    Ok(work(lens))
}

fn touches(app: &Shared, work: impl FnOnce(&mut TouchWork)) -> Result<(), Refused> {
    let mut bench = app.calibration();
    work(bench.touches.as_mut().ok_or_else(|| conflict("name the points first"))?);
    Ok(())
}
