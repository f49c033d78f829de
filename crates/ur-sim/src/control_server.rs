//! The simulator's own control interface: true state and faults, for tests and training.
//!
//! In: `GET /world.json`, `GET /timing.json`, `POST /fault` with `{"do": NAME, "args": {...}}`, with a
//! trigger `at`, or a whole `{"faults": [...]}` as in a fault file, `GET /request` and `POST /request` with
//! the value that a program waits for. Out: the true state; what a program has requested; how late RTDE
//! packages have left the simulator (us after their frame was due), how many were sent and skipped; `{"ok":
//! true}`, or 400 with `{"error": TEXT}`. Loopback only, and only when requested: the daemon has no client
//! for it.

use crate::faults::injector::FaultInjector;
use crate::faults::read::read_posted;
use crate::serve::MAX_CONNECTIONS;
use crate::serve::seats::Seats;
use crate::serve::stream::LinkListener;
use crate::world::{SharedWorld, lock};
use axum::body::Bytes;
use axum::extract::{DefaultBodyLimit, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router};
use serde_json::json;
use std::future::Future;
use std::net::IpAddr;
use std::sync::Arc;
use tokio::net::TcpListener;

/// Largest fault request, bytes: a plan of a thousand faults.
const BODY_LIMIT: usize = 1024 * 1024;

/// Why the control server ended.
#[derive(Debug, thiserror::Error)]
pub enum ControlError {
    /// The requested address is one that others could reach.
    #[error("the simulator's control server listens on loopback only, not on {0}")]
    NotLoopback(IpAddr),
    /// The listener failed.
    #[error("the simulator's control server failed")]
    Io(#[from] std::io::Error),
}

#[derive(Clone)]
struct Control {
    world: SharedWorld,
    injector: Arc<FaultInjector>,
}

/// Serves clients until `stop` resolves.
///
/// # Errors
/// [`ControlError::NotLoopback`] before anything is served; [`ControlError::Io`].
pub async fn serve(
    listener: TcpListener,
    world: SharedWorld,
    injector: Arc<FaultInjector>,
    stop: impl Future<Output = ()> + Send + 'static,
) -> Result<(), ControlError> {
    let address = listener.local_addr()?.ip();
    if !address.is_loopback() {
        return Err(ControlError::NotLoopback(address));
    }
    let router = Router::new()
        .route("/world.json", get(state))
        .route("/timing.json", get(timing))
        .route("/fault", post(fault))
        .route("/request", get(requested).post(answer))
        .layer(DefaultBodyLimit::max(BODY_LIMIT))
        .with_state(Control { world, injector });
    // No fault acts on what makes them.
    let link = Arc::default();
    let listener = LinkListener { listener, link, seats: Seats::new(MAX_CONNECTIONS) };
    Ok(axum::serve(listener, router).with_graceful_shutdown(stop).await?)
}

async fn state(State(control): State<Control>) -> Response {
    let mut snapshot = lock(&control.world).snapshot_json();
    snapshot["faults"] = control.injector.snapshot_json();
    Json(snapshot).into_response()
}

async fn timing(State(control): State<Control>) -> Response {
    let robot = control.injector.robot();
    let delays = robot.latency.delays();
    let (sent, skipped) = robot.publisher().counts();
    let timing = json!({
        "packages": delays.count,
        "within_1_ms": delays.within_1_ms,
        "median_us": delays.median_us,
        "p999_us": delays.p999_us,
        "worst_us": delays.worst_us,
        "sent": sent,
        "skipped": skipped,
        "frames": robot.controller().core.step,
    });
    Json(timing).into_response()
}

async fn fault(State(control): State<Control>, body: Bytes) -> Response {
    let text = String::from_utf8_lossy(&body);
    let done = read_posted(&text)
        .map_err(|complaints| complaints.to_string())
        .and_then(|plans| control.injector.submit(plans).map_err(|error| error.to_string()));
    match done {
        Ok(()) => Json(json!({"ok": true})).into_response(),
        Err(error) => (StatusCode::BAD_REQUEST, Json(json!({"error": error}))).into_response(),
    }
}

/// What the pendant would show.
async fn requested(State(control): State<Control>) -> Response {
    let controller = control.injector.robot().controller();
    let shown = controller.core.requests.shown();
    Json(
        json!({"request": shown.map(|request| json!({"type": request.wanted.name(), "text": request.text}))}),
    )
    .into_response()
}

/// A person at the pendant types a value.
async fn answer(State(control): State<Control>, body: Bytes) -> Response {
    let done = serde_json::from_slice(&body)
        .map_err(|error| format!("this is no JSON: {error}"))
        .and_then(|value| control.injector.robot().controller().core.requests.answer(&value));
    match done {
        Ok(()) => Json(json!({"ok": true})).into_response(),
        Err(error) => (StatusCode::BAD_REQUEST, Json(json!({"error": error}))).into_response(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::{Controller, ControllerConfig};
    use crate::robot_server::shared::RobotShared;
    use crate::world::empty_world;
    use std::net::SocketAddr;
    use std::sync::Mutex;

    fn injector(world: &SharedWorld) -> Arc<FaultInjector> {
        let robot = RobotShared::new(Controller::new(ControllerConfig::ur5e(1)));
        Arc::new(FaultInjector::new(robot, world.clone(), 1.0))
    }

    async fn started() -> (SocketAddr, SharedWorld) {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let world = Arc::new(Mutex::new(empty_world(5)));
        tokio::spawn(serve(listener, world.clone(), injector(&world), std::future::pending()));
        (address, world)
    }

    async fn exchange(
        address: SocketAddr,
        path: &'static str,
        body: Option<&'static str>,
    ) -> (u16, serde_json::Value) {
        let url = format!("http://{address}{path}");
        tokio::task::spawn_blocking(move || {
            let agent = ureq::Agent::new_with_config(
                ureq::config::Config::builder().http_status_as_error(false).build(),
            );
            let mut reply = match body {
                Some(text) => agent.post(&url).send(text).unwrap(),
                None => agent.get(&url).call().unwrap(),
            };
            let text = reply.body_mut().read_to_string().unwrap();
            (reply.status().as_u16(), serde_json::from_str(&text).unwrap())
        })
        .await
        .unwrap()
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn faults_come_in_and_the_truth_goes_out() {
        let (address, world) = started().await;
        let (status, reply) = exchange(address, "/fault", Some(r#"{"do": "camera.off"}"#)).await;
        assert_eq!((status, reply["ok"].as_bool()), (200, Some(true)));
        assert!(!lock(&world).camera_on());
        let (_, state) = exchange(address, "/world.json", None).await;
        assert_eq!(state["camera_on"].as_bool(), Some(false));
        assert_eq!(state["faults"]["active"][0].as_str(), Some("camera.off"));
        assert_eq!(state["events"][0]["name"].as_str(), Some("camera.off"));
        let (status, reply) = exchange(
            address,
            "/fault",
            Some(r#"{"do": "world.nudge", "args": {"object": "x", "dx_m": 0.01}}"#),
        )
        .await;
        assert_eq!(status, 400);
        assert!(reply["error"].as_str().unwrap().contains("\"x\""));
        let (status, _) = exchange(address, "/fault", Some("]")).await;
        assert_eq!(status, 400);
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_value_that_a_program_requests_is_posted() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let world: SharedWorld = Arc::new(Mutex::new(empty_world(5)));
        let config = ControllerConfig { running: true, ..ControllerConfig::ur5e(1) };
        let robot = RobotShared::new(Controller::new(config));
        let injector = Arc::new(FaultInjector::new(robot.clone(), world.clone(), 1.0));
        tokio::spawn(serve(listener, world, injector, std::future::pending()));
        let (status, reply) = exchange(address, "/request", None).await;
        assert_eq!((status, reply), (200, json!({"request": null})));
        assert_eq!(exchange(address, "/request", Some("3")).await.0, 400, "nothing is requested");
        let script = "def a():\n n = request_integer_from_primary_client(\"How many?\")\n \
                      write_output_integer_register(3, n)\nend\n";
        robot.controller().programs.upload(crate::controller::builtins::compile_program(script));
        (0..3).for_each(|_| robot.frame(None));
        let (_, reply) = exchange(address, "/request", None).await;
        assert_eq!(reply, json!({"request": {"type": "integer", "text": "How many?"}}));
        for wrong in ["\"many\"", "{"] {
            assert_eq!(exchange(address, "/request", Some(wrong)).await.0, 400, "{wrong}");
        }
        assert_eq!(exchange(address, "/request", Some("3")).await.0, 200);
        (0..3).for_each(|_| robot.frame(None));
        assert_eq!(robot.controller().core.registers.output_ints[3], 3);
    }

    #[tokio::test]
    async fn only_loopback_is_served() {
        let listener = TcpListener::bind("0.0.0.0:0").await.unwrap();
        let world = Arc::new(Mutex::new(empty_world(5)));
        let refused = serve(listener, world.clone(), injector(&world), std::future::pending()).await;
        assert!(matches!(refused, Err(ControlError::NotLoopback(_))));
    }
}
