//! `celld fleet export | metrics`: for shift reports, spreadsheets and Prometheus.
//!
//! In: claims, events, states. Out: CSV or JSON Lines on stdout; the metrics in Prometheus' text form. Pure
//! but for the reading.

use crate::cli::fleet::reach::{Failure, ReachArgs};
use crate::cli::fleet::show::now_s;
use crate::cli::task::outln;
use crate::fleet::words::words;
use crate::jobs::history::since;
use crate::jobs::utc;
use cell_edge::clock::unix_now_s;
use cell_fleet::client::Shown;
use cell_fleet::payloads::Claim;
use clap::{Args, ValueEnum};
use serde_json::json;
use std::fmt::Write as _;

/// What is exported.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Rows {
    /// One row a job.
    Jobs,
    /// One row an event.
    Events,
}

/// In which form.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Form {
    /// With a head.
    Csv,
    /// JSON, one object a line.
    Jsonl,
}

/// `celld fleet export`
#[derive(Args, Debug)]
pub struct ExportArgs {
    /// What: jobs or events
    #[arg(value_enum, default_value_t = Rows::Jobs)]
    rows: Rows,
    /// csv or jsonl
    #[arg(long, value_enum, default_value_t = Form::Csv)]
    format: Form,
    /// Only what came since: 8h, 2d, or a date such as 2026-11-21
    #[arg(long, value_name = "TIME")]
    since: Option<String>,
    #[command(flatten)]
    reach: ReachArgs,
}

/// `celld fleet metrics`
#[derive(Args, Debug)]
pub struct MetricsArgs {
    #[command(flatten)]
    reach: ReachArgs,
}

/// # Errors
/// One sentence for the terminal: what is wrong with the arguments, the server or the answer.
pub async fn export(args: &ExportArgs) -> Result<(), Failure> {
    let from = match &args.since {
        None => f64::MIN,
        Some(text) => since(text, unix_now_s()).ok_or_else(|| {
            Failure::Usage("--since: write 90s, 30m, 12h, 2d or 1w, or a date such as 2026-11-21".to_string())
        })?,
    };
    let client = args.reach.client().await?;
    match args.rows {
        Rows::Jobs => {
            let claims = client.claims().await?;
            let wanted: Vec<&Claim> =
                claims.iter().filter(|claim| claim.job.submitted_unix_s >= from).collect();
            match args.format {
                Form::Csv => outln!("{}", csv(&wanted).trim_end()),
                Form::Jsonl => wanted.iter().for_each(|claim| outln!("{}", json!(claim))),
            }
        }
        Rows::Events => {
            let events = client.events().await?;
            let wanted = events.iter().filter(|event| event.unix_s >= from);
            match args.format {
                Form::Jsonl => wanted.for_each(|event| outln!("{}", json!(event))),
                Form::Csv => {
                    outln!("time,cell,series,number,kind,job,words");
                    for event in wanted {
                        let event_words = field(&words(event));
                        let job = field(event.job.as_deref().unwrap_or_default());
                        let (time, kind) = (utc::text(event.unix_s), event.what.kind());
                        outln!(
                            "{time},{},{},{},{kind},{job},{event_words}",
                            event.cell,
                            event.series,
                            event.number
                        );
                    }
                }
            }
        }
    }
    Ok(())
}

/// A field of CSV: in quotes where it has to be. One that a spreadsheet would take for a formula is a text.
fn field(text: &str) -> String {
    let text = text.replace(['\r', '\n'], " ");
    let formula = text.starts_with(['=', '+', '-', '@', '\t']);
    let text = if formula { format!("'{text}") } else { text };
    match text.contains([',', '"']) {
        true => format!("\"{}\"", text.replace('"', "\"\"")),
        false => text,
    }
}

fn csv(claims: &[&Claim]) -> String {
    let mut text =
        "submitted,id,campaign,by,target,priority,state,cell,epoch,status,code,moves,lower_bound,seconds\n"
            .to_string();
    for claim in claims {
        let job = &claim.job;
        let outcome = claim.outcome.clone().unwrap_or_default();
        let bound = outcome.lower_bound.map(|bound| bound.to_string()).unwrap_or_default();
        let texts = [
            &utc::text(job.submitted_unix_s),
            &job.id,
            job.campaign.as_deref().unwrap_or_default(),
            &claim.by,
            &claim.target,
            &claim.priority,
            claim.state.as_str(),
            &claim.cell,
        ];
        let texts: Vec<String> = texts.into_iter().map(field).collect();
        let end = format!(
            "{},{},{},{bound},{:.1}",
            field(&outcome.status),
            field(&outcome.code),
            outcome.moves,
            outcome.seconds
        );
        let _ = writeln!(text, "{},{},{end}", texts.join(","), job.epoch);
    }
    text
}

/// # Errors
/// One sentence for the terminal: what is wrong with the arguments, the server or the answer.
pub async fn metrics(args: &MetricsArgs) -> Result<(), Failure> {
    let client = args.reach.client().await?;
    let (cells, queued) = (client.cells().await?, client.queued().await?);
    outln!("{}", prometheus(&cells, queued.values().sum(), now_s(&client).await).trim_end());
    Ok(())
}

/// The fleet in Prometheus' text form.
fn prometheus(cells: &[Shown], queued: usize, now: f64) -> String {
    type Value = fn(&Shown, f64) -> Option<f64>;
    let rows: [(&str, &str, &str, Value); 12] = [
        ("state_age_seconds", "gauge", "Age of the cell's state", |cell, now| Some(now - cell.unix_s)),
        ("armed", "gauge", "1 while motion is allowed", |cell, _| {
            Some(f64::from(u8::from(cell.state.armed)))
        }),
        ("idle", "gauge", "1 while nothing is to be done", |cell, _| {
            Some(f64::from(u8::from(cell.state.idle)))
        }),
        (
            "jobs_done_total",
            "counter",
            "Jobs that were done, also those of the cells' own folders",
            |c, _| Some(c.state.totals.done as f64),
        ),
        ("jobs_failed_total", "counter", "Jobs that ended otherwise", |c, _| {
            Some(c.state.totals.failed as f64)
        }),
        ("moves_total", "counter", "Pick-n-places", |cell, _| Some(cell.state.totals.moves as f64)),
        ("moves_bound_total", "counter", "The least they could have been", |cell, _| {
            Some(cell.state.totals.bound)
        }),
        ("busy_seconds_total", "counter", "Working time", |cell, _| Some(cell.state.totals.seconds)),
        ("events_undelivered", "gauge", "Events that wait for the network", |c, _| {
            Some(c.state.undelivered as f64)
        }),
        ("complaints", "gauge", "What is wrong with its part", |cell, _| {
            Some(cell.state.complaints.len() as f64)
        }),
        ("vacuum_percent", "gauge", "Vacuum while something was held", |cell, _| cell.state.vacuum_percent),
        ("drift_mm", "gauge", "Residual of the reference markers", |cell, _| cell.state.drift_mm),
    ];
    let mut text = format!(
        "# HELP celld_fleet_jobs_queued Jobs that no cell has taken\n# TYPE celld_fleet_jobs_queued gauge\n\
         celld_fleet_jobs_queued {queued}\n"
    );
    for (name, kind, help, value) in rows {
        let _ = write!(text, "# HELP celld_fleet_{name} {help}\n# TYPE celld_fleet_{name} {kind}\n");
        for cell in cells {
            if let Some(value) = value(cell, now) {
                let _ = writeln!(text, "celld_fleet_{name}{{cell=\"{}\"}} {value}", cell.name);
            }
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_fleet::payloads::{CellState, ClaimState, Job, Outcome, Totals};
    use cell_fleet::subjects::{Lane, Priority, Target};

    #[test]
    fn a_row_a_job_and_no_formula_for_a_spreadsheet() {
        let lane = Lane { priority: Priority::Urgent, target: Target::Cell("c1".into()) };
        let mut claim = Claim::new(Job::new("tidy", "x", 0.0), &lane, "anna", ClaimState::Ended, "c1", 0.0);
        claim.outcome = Some(Outcome {
            status: "done".into(),
            code: "=cmd()".into(),
            moves: 3,
            lower_bound: Some(3.0),
            seconds: 12.34,
            ..Outcome::default()
        });
        let text = csv(&[&claim]);
        let row = text.lines().nth(1).unwrap();
        assert_eq!(row, "1970-01-01T00:00:00Z,tidy,,anna,cell=c1,urgent,ended,c1,1,done,'=cmd(),3,3,12.3");
        assert_eq!(text.lines().next().unwrap().split(',').count(), row.split(',').count());
        assert_eq!(field("a, \"b\"\nc"), "\"a, \"\"b\"\" c\"");
    }

    #[test]
    fn each_cell_has_its_metrics() {
        let state = CellState { totals: Totals { done: 7, ..Totals::default() }, ..CellState::default() };
        let text = prometheus(&[Shown { name: "c1".into(), state, unix_s: 90.0 }], 4, 100.0);
        assert!(text.contains("celld_fleet_jobs_queued 4\n"));
        assert!(text.contains("celld_fleet_jobs_done_total{cell=\"c1\"} 7\n"));
        assert!(text.contains("celld_fleet_state_age_seconds{cell=\"c1\"} 10\n"));
        assert!(!text.contains("celld_fleet_drift_mm{"), "what is not known is not nought");
    }
}
