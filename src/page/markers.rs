//! Markers for the printer, as `celld markers` makes them.
//!
//! In: numbers, size, paper. Out: a PDF at true scale, with a ruler to check the print by.

use crate::jobs::utc;
use crate::page::guard::Refused;
use crate::report::prints::{self, Paper};
use axum::extract::Query;
use axum::http::StatusCode;
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use cell_edge::clock::unix_now_s;
use cell_vision::detect::Family;
use serde::Deserialize;

/// Most markers that are printed at once.
const MARKERS_MAX: usize = 200;

/// `GET /api/v1/markers.pdf`
#[derive(Deserialize)]
pub struct Prints {
    ids: String,
    size_mm: Option<f64>,
    paper: Option<String>,
}

/// Markers for the printer.
///
/// # Errors
/// The refusal, as the API answers it.
pub async fn markers(Query(Prints { ids, size_mm, paper }): Query<Prints>) -> Result<Response, Refused> {
    let wrong = |message: &str| Refused::new(StatusCode::UNPROCESSABLE_ENTITY, message);
    let ids: Result<Vec<u32>, _> = ids.split(',').map(|id| id.trim().parse()).collect();
    let ids = ids.map_err(|_| wrong("ids: numbers with commas between them"))?;
    let size_mm = size_mm.unwrap_or(30.0);
    if ids.is_empty() || ids.len() > MARKERS_MAX || !(1.0..=1000.0).contains(&size_mm) {
        return Err(wrong("1 to 200 markers of 1 to 1000 mm"));
    }
    let paper = if paper.as_deref() == Some("letter") { Paper::Letter } else { Paper::A4 };
    let sheets = prints::markers(Family::Tag36h11, &ids, size_mm / 1e3, paper);
    let sheets = sheets.map_err(|error| wrong(&error.to_string()))?;
    let name = format!("attachment; filename=\"markers-{}.pdf\"", utc::compact(unix_now_s()));
    let headers = [(CONTENT_TYPE, "application/pdf".to_string()), (CONTENT_DISPOSITION, name)];
    Ok((headers, prints::pdf(&sheets)).into_response())
}
