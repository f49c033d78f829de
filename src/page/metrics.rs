//! Counts and states in the words of Prometheus: names and labels from fixed lists, so that their number is
//! bounded.
//!
//! In: the status, the journal's counts. Out: text of the exposition format, version 0.0.4.

use crate::page::shared::App;
use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use std::fmt::Write as _;
use std::sync::atomic::Ordering;

/// Text while it grows.
struct Text(String);

impl Text {
    fn family(&mut self, name: &str, kind: &str, help: &str) {
        let _ = writeln!(self.0, "# HELP celld_{name} {help}\n# TYPE celld_{name} {kind}");
    }

    fn value(&mut self, name: &str, labels: &str, value: f64) {
        let _ = writeln!(self.0, "celld_{name}{labels} {value}");
    }

    fn gauge(&mut self, name: &str, help: &str, value: f64) {
        self.family(name, "gauge", help);
        self.value(name, "", value);
    }
}

/// `GET /metrics`
pub async fn metrics(State(app): State<App>) -> Response {
    let mut text = Text(String::new());
    let flag = |on: bool| f64::from(u8::from(on));
    text.gauge("viewers", "Open event streams", app.feed.viewers() as f64);
    text.gauge("pictures", "Pictures since celld was started", app.feed.picture_number() as f64);
    text.gauge("film_viewers", "Who watch the camera's film", app.film.viewers() as f64);
    let shares = [0.5, 0.99];
    if let Some(steps) = app.feed.turns().quantiles(shares) {
        text.family("loop_step_seconds", "gauge", "From one turn of the loop to the next, of the last turns");
        for (share, step) in shares.into_iter().zip(steps) {
            text.value("loop_step_seconds", &format!("{{quantile=\"{share}\"}}"), step);
        }
    }
    text.family("orders_total", "counter", "Orders given at the page");
    for (index, answer) in ["accepted", "refused"].into_iter().enumerate() {
        let count = app.orders[index].load(Ordering::Relaxed);
        text.value("orders_total", &format!("{{answer=\"{answer}\"}}"), count as f64);
    }
    if let Some(status) = app.feed.last_status() {
        text.gauge("start_time_seconds", "When celld was started, s since 1970", status.started_unix_s);
        text.gauge("armed", "Motion is allowed", flag(status.armed));
        text.gauge("paused", "Stopped between steps", flag(status.paused));
        text.gauge("working", "A job is under way", flag(status.job.is_some()));
        text.gauge("stopped", "A stop is still to be left", flag(status.stopped.is_some()));
        text.gauge("holding", "Something hangs on the gripper", flag(status.holding.is_some()));
        text.gauge(
            "awaiting_approval",
            "Plans that wait for a person",
            status.awaiting_approval.len() as f64,
        );
        text.gauge("jobs_waiting", "Jobs that wait for their turn", f64::from(status.waiting));
        text.gauge("files_unread", "Files not taken up yet", f64::from(status.unread));
        text.family("device_ready", "gauge", "The device may be used");
        for device in &status.devices {
            text.value("device_ready", &format!("{{device=\"{}\"}}", device.name), flag(device.ready));
        }
        text.family("device_answer_age_seconds", "gauge", "How long ago the device answered");
        for device in &status.devices {
            if let Some(age) = device.age_s {
                text.value("device_answer_age_seconds", &format!("{{device=\"{}\"}}", device.name), age);
            }
        }
    }
    if let Some((_, residual)) = app.feed.trends().reference_residual_mm.back() {
        text.gauge("reference_residual_mm", "Of the reference markers at the last look", *residual);
    }
    ([(CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], text.0).into_response()
}
