//! What is kept of the work: `recording:` and `history:` of a cell's configuration.
//!
//! In: located values and a decoder that collects complaints. Out: [`RecordingConfig`], [`HistoryLimits`],
//! or `None` with a complaint kept. Sizes are in 10^9 bytes, as disks are sold. Pure.

use crate::config::cell::{RecordedPictures, RecordingConfig};
use crate::jobs::journal::old::HistoryLimits;
use cell_parts::fields::{optional, path};
use rearrange::document::decode::{At, Decoder, Fields};
use std::path::Path;

/// A size on the disk, in 10^9 bytes.
fn gigabytes(decoder: &mut Decoder, fields: &Fields, key: &'static str, usual: f64) -> Option<u64> {
    let read = |decoder: &mut Decoder, at: &At| decoder.number_in(at, 0.01..=1e6, "GB");
    optional(decoder, fields, key, usual, read).map(|size: f64| (size * 1e9) as u64)
}

pub(super) fn history(decoder: &mut Decoder, at: &At) -> Option<HistoryLimits> {
    let fields = decoder.map(at, &["days", "jobs"])?;
    let read = |decoder: &mut Decoder, at: &At| decoder.number_in(at, 1.0..=36_500.0, "days");
    let days = optional(decoder, &fields, "days", HistoryLimits::YEAR.days, read);
    let read = |decoder: &mut Decoder, at: &At| decoder.integer(at, 10..=10_000_000);
    let jobs = optional(decoder, &fields, "jobs", i64::from(HistoryLimits::YEAR.jobs), read);
    Some(HistoryLimits { days: days?, jobs: u32::try_from(jobs?).ok()?, ..HistoryLimits::YEAR })
}

pub(super) fn recording(decoder: &mut Decoder, at: &At, folder: &Path) -> Option<RecordingConfig> {
    let fields = decoder.map(at, &["folder", "pictures", "decisions", "budget_gb", "reserve_gb"])?;
    let target = fields.required("folder", decoder).and_then(|at| path(decoder, &at, folder));
    let words = [
        ("jpeg", RecordedPictures::Jpeg),
        ("lossless", RecordedPictures::Lossless),
        ("true", RecordedPictures::Jpeg),
        ("false", RecordedPictures::Off),
    ];
    let pictures = optional(decoder, &fields, "pictures", RecordedPictures::Jpeg, |decoder, at| {
        decoder.choice(at, &words)
    });
    let decisions = optional(decoder, &fields, "decisions", true, |decoder, at| decoder.boolean(at));
    let budget_bytes = gigabytes(decoder, &fields, "budget_gb", 20.0);
    let reserve_bytes = gigabytes(decoder, &fields, "reserve_gb", 1.0);
    Some(RecordingConfig {
        folder: target?,
        pictures: pictures?,
        decisions: decisions?,
        budget_bytes: budget_bytes?,
        reserve_bytes: reserve_bytes?,
    })
}
