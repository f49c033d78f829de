//! The Robot API over real sockets.

use super::*;
use crate::controller::{Controller, ControllerConfig};
use crate::core::Core;
use crate::robot_server::RobotPorts;
use crate::serve::{MAX_CONNECTIONS, Servers};
use crate::world::empty_world;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;

struct Bench {
    core: Core,
    at: SocketAddr,
    stop: watch::Sender<bool>,
    servers: Servers,
}

async fn bench() -> Bench {
    let config = ControllerConfig { version: [10, 12, 0, 1], ..ControllerConfig::ur5e(1) };
    let core = Core::new(Controller::new(config), empty_world(5), 1.0);
    let (stop, stopped) = watch::channel(false);
    let mut servers = Servers::default();
    let bind = IpAddr::V4(Ipv4Addr::LOCALHOST);
    let at = servers.take_robot(&core, bind, &RobotPorts::ANY, &stopped).await.unwrap();
    Bench { core, at: at.dashboard, stop, servers }
}

/// Status and text of a reply.
async fn put(at: SocketAddr, path: &str, body: Vec<u8>) -> (u16, String) {
    let url = format!("http://{at}{path}");
    tokio::task::spawn_blocking(move || {
        let config = ureq::config::Config::builder().http_status_as_error(false).build();
        let request = ureq::Agent::new_with_config(config).put(&url).content_type("application/json");
        let mut reply = request.send(&body[..]).unwrap();
        (reply.status().as_u16(), reply.body_mut().read_to_string().unwrap())
    })
    .await
    .unwrap()
}

const STATE: &str = "/universal-robots/robot-api/robotstate/v1/state";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn power_on_is_answered_when_the_arm_has_booted() {
    let bench = bench().await;
    let request = tokio::spawn(put(bench.at, STATE, br#"{"action": "POWER_ON"}"#.to_vec()));
    while bench.core.robot.controller().core.modes.robot_mode().name() != "BOOTING" {
        tokio::task::yield_now().await;
    }
    assert!(!request.is_finished());
    while !bench.core.robot.controller().core.modes.powered() {
        bench.core.advance(None);
    }
    let (status, text) = request.await.unwrap();
    assert_eq!((status, text.as_str()), (200, r#"{"message":"Robot powered on"}"#));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_request_that_waits_does_not_hold_up_the_end() {
    let bench = bench().await;
    let request = tokio::spawn(put(bench.at, STATE, br#"{"action": "POWER_ON"}"#.to_vec()));
    while bench.core.robot.controller().core.modes.robot_mode().name() != "BOOTING" {
        tokio::task::yield_now().await;
    }
    bench.stop.send_replace(true);
    assert_eq!(request.await.unwrap().0, 504);
    bench.servers.stopped().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_request_that_is_never_sent_whole_does_not_hold_up_the_end() {
    let bench = bench().await;
    let mut half = TcpStream::connect(bench.at).await.unwrap();
    half.write_all(b"PUT /universal-robots HTTP/1.1\r\nHost: sim\r\nContent-Length: 10\r\n\r\n{")
        .await
        .unwrap();
    // Answered, so the first half has been taken in.
    put(bench.at, STATE, br#"{"action": "POWER_OFF"}"#.to_vec()).await;
    bench.stop.send_replace(true);
    bench.servers.stopped().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn bodies_that_are_too_large_and_other_paths_are_refused_in_json() {
    let bench = bench().await;
    let (status, text) = put(bench.at, STATE, vec![b' '; BODY_LIMIT + 1]).await;
    assert_eq!(status, 413);
    assert!(serde_json::from_str::<serde_json::Value>(&text).is_ok(), "{text}");
    assert_eq!(put(bench.at, "/robotstate/v1/state", Vec::new()).await.0, 404);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_old_path_leads_to_the_new_one() {
    let bench = bench().await;
    let old = "/universal-robots/robot-api/program/v1/load";
    let url = format!("http://{}{old}", bench.at);
    let place = tokio::task::spawn_blocking(move || {
        let config = ureq::config::Config::builder().max_redirects(0).http_status_as_error(false).build();
        let reply = ureq::Agent::new_with_config(config).put(&url).send("{}").unwrap();
        (reply.status().as_u16(), reply.headers()["location"].to_str().unwrap().to_owned())
    });
    let expected = (307, "/universal-robots/robot-api/program/v1/loaded".to_owned());
    assert_eq!(place.await.unwrap(), expected);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn connections_that_are_forgotten_shut_out_no_client_of_the_robot_api() {
    let bench = bench().await;
    let mut forgotten = Vec::new();
    for _ in 0..3 * MAX_CONNECTIONS {
        forgotten.push(TcpStream::connect(bench.at).await.unwrap());
    }
    assert_eq!(put(bench.at, STATE, br#"{"action": "POWER_OFF"}"#.to_vec()).await.0, 200);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_controller_that_boots_answers_no_request() {
    let bench = bench().await;
    let link = bench.core.robot.links.get(LinkName::Dashboard);
    link.set(crate::faults::link::LinkState { down: true, ..Default::default() });
    let url = format!("http://{}{STATE}", bench.at);
    let requested = tokio::task::spawn_blocking(move || ureq::get(&url).call().is_err());
    assert!(requested.await.unwrap());
    link.set(Default::default());
    assert_eq!(put(bench.at, STATE, br#"{"action": "POWER_OFF"}"#.to_vec()).await.0, 200);
}
