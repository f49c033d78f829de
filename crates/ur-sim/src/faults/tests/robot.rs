//! What clients of controller, gripper and their connections see of faults.

use super::*;

const LOOP: &str = "def ours():\n  while True:\n    sync()\n  end\nend\n";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn safety_faults_show_in_rtde_and_end_when_cleared() {
    let bench = bench("").await;
    let mut rtde = Rtde::connect(bench.sim.addresses.robot.rtde, &["safety_mode", "robot_mode"]).await;
    let modes = |safety, robot| [Value::Int32(safety), Value::Int32(robot)];
    rtde.until(&modes(1, 7)).await;
    bench.fault("{do: ur.safeguard}");
    rtde.until(&modes(5, 7)).await;
    bench.fault("{do: clear, args: {fault: ur.safeguard}}");
    rtde.until(&modes(1, 7)).await;
    bench.fault("{do: ur.safety, args: {mode: 99, seconds: 0.5}}");
    rtde.until(&modes(99, 7)).await;
    rtde.until(&modes(1, 7)).await;
    bench.fault("{do: ur.pstop}");
    rtde.until(&modes(3, 7)).await;
    assert_eq!(bench.refusal("{do: ur.safeguard}"), FaultError::NotNow);
    bench.fault("{do: ur.estop, args: {seconds: 1}}");
    rtde.until(&modes(7, 3)).await;
    rtde.until(&modes(1, 3)).await;
    bench.fault("{do: ur.fault}");
    rtde.until(&modes(9, 3)).await;
    bench.sim.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn slider_and_payload_are_what_the_fault_says() {
    let bench = bench("").await;
    let mut rtde = Rtde::connect(bench.sim.addresses.robot.rtde, &["target_speed_fraction", "payload"]).await;
    let numbers = |fraction, mass| [Value::Double(fraction), Value::Double(mass)];
    rtde.until(&numbers(1.0, 0.0)).await;
    bench.fault("{do: ur.slider, args: {fraction: 0.01}}");
    rtde.until(&numbers(0.01, 0.0)).await;
    bench.fault("{do: ur.payload, args: {mass_kg: 1.5}}");
    rtde.until(&numbers(0.01, 1.5)).await;
    bench.fault("{do: clear}");
    rtde.until(&numbers(1.0, 1.5)).await;
    bench.sim.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn programs_are_paused_killed_replaced_and_kept_from_starting() {
    let bench = bench("").await;
    let playing = |sim: &RunningSim| sim.robot().controller().programs.playing();
    assert_eq!(bench.refusal("{do: ur.pause}"), FaultError::NoProgram);
    assert_eq!(bench.refusal("{do: ur.kill_program}"), FaultError::NoProgram);
    let _ours = bench.upload(LOOP).await;
    bench.until("the start", playing).await;
    bench.fault("{do: ur.pause, args: {seconds: 100}}");
    assert_eq!(bench.request("programState").await, "PAUSED ours");
    bench.fault("{do: clear, args: {fault: ur.pause}}");
    assert_eq!(bench.request("programState").await, "PLAYING ours");
    bench.fault("{do: ur.foreign_script, args: {runs_s: 1000}}");
    bench
        .until("the other program", |sim| sim.robot().controller().programs.name() == Some("foreign_program"))
        .await;
    assert_eq!(bench.request("programState").await, "PLAYING foreign_program");
    bench.fault("{do: ur.kill_program}");
    assert_eq!(bench.request("programState").await, "STOPPED foreign_program");
    bench.fault("{do: ur.never_start}");
    let _deaf = bench.upload(LOOP).await;
    let began = bench.step();
    bench.until("a second", |sim| sim.robot().controller().core.step > began + 500).await;
    assert_eq!(bench.request("running").await, "Program running: false");
    bench.sim.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_script_error_is_reported_on_the_primary_interface() {
    let bench = bench("").await;
    let mut ours = bench.upload(LOOP).await;
    bench.until("the start", |sim| sim.robot().controller().programs.playing()).await;
    bench.fault("{do: ur.script_error}");
    assert!(!bench.sim.robot().controller().programs.playing());
    let (mut received, text) = (Vec::new(), b"runtime exception by the fault injector");
    while !received.windows(text.len()).any(|window| window == text) {
        let mut buffer = [0; 4096];
        let count = tokio::time::timeout(PATIENCE, ours.read(&mut buffer)).await.unwrap().unwrap();
        assert!(count > 0, "closed");
        received.extend_from_slice(&buffer[..count]);
    }
    bench.sim.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn local_mode_refuses_commands_and_scripts() {
    let bench = bench("").await;
    let mut ours = bench.upload(LOOP).await;
    bench.until("the start", |sim| sim.robot().controller().programs.playing()).await;
    bench.fault("{do: ur.local}");
    assert_eq!(bench.request("is in remote control").await, "false");
    assert!(bench.request("power off").await.starts_with("Command is not allowed"));
    let mut rest = Vec::new();
    // The script connection is closed, in order or not.
    let _ = tokio::time::timeout(PATIENCE, ours.read_to_end(&mut rest)).await.unwrap();
    bench.fault("{do: clear}");
    assert_eq!(bench.request("is in remote control").await, "true");
    bench.sim.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stalled_arm_stands_while_everything_says_it_moves() {
    let bench = bench("").await;
    let _ours =
        bench.upload("def ours():\n  movej([1.5,-1.57,1.57,-1.57,-1.57,0], a=1, v=0.01)\nend\n").await;
    let moves = |sim: &RunningSim| !sim.robot().controller().core.mover.stands();
    bench.until("motion", moves).await;
    bench.fault("{do: ur.stall}");
    bench.until("standstill", |sim| !moves(sim)).await;
    let mut rtde =
        Rtde::connect(bench.sim.addresses.robot.rtde, &["actual_qd", "runtime_state", "speed_scaling"]).await;
    rtde.until(&[Value::Vector6D([0.0; 6]), Value::Uint32(2), Value::Double(1.0)]).await;
    bench.fault("{do: clear}");
    bench.until("motion", moves).await;
    bench.sim.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_claimed_input_is_in_use() {
    let bench = bench("").await;
    let mut rtde = Rtde::connect(bench.sim.addresses.robot.rtde, &["timestamp"]).await;
    for (fault, offer) in [
        ("{do: ur.claim, args: {input: speed_slider_mask}}", Some(Offer::InUse)),
        ("{do: clear, args: {fault: ur.claim}}", None),
    ] {
        bench.fault(fault);
        let names = vec!["speed_slider_mask".to_owned()];
        rtde.send(&Request::SetupInputs { names }, Version::V2).await;
        let offers = loop {
            if let Reply::SetupInputs { offers, .. } = rtde.reply().await.expect("closed") {
                break offers;
            }
        };
        assert_eq!(offers.first().filter(|offer| **offer == Offer::InUse).copied(), offer);
    }
    bench.sim.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_reboot_closes_refuses_and_comes_back_as_another_robot() {
    let bench = bench("").await;
    bench.until("some time", |sim| sim.robot().controller().core.step > 500).await;
    let mut rtde = Rtde::connect(bench.sim.addresses.robot.rtde, &["timestamp"]).await;
    let mut dashboard = bench.dashboard().await;
    bench.fault("{do: ur.reboot, args: {serial: \"20240000009\", kinematics: 4, seconds: 1000}}");
    while rtde.reply().await.is_some() {}
    assert_eq!(line(&mut dashboard).await, "", "closed");
    let address = bench.sim.addresses.robot.dashboard;
    let began = Instant::now();
    while TcpStream::connect(address).await.is_ok() {
        assert!(began.elapsed() < PATIENCE, "somebody listens");
    }
    let dh = bench.sim.robot().controller().core.config.dh;
    bench.fault("{do: clear}");
    let began = Instant::now();
    while TcpStream::connect(address).await.is_err() {
        assert!(began.elapsed() < PATIENCE, "nobody listens");
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    assert_eq!(bench.request("get serial number").await, "20240000009");
    assert_eq!(bench.request("robotmode").await, "Robotmode: POWER_OFF");
    assert_ne!(bench.sim.robot().controller().core.config.dh.a, dh.a);
    bench.sim.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn connections_are_reset_and_new_ones_work() {
    let bench = bench("").await;
    let mut rtde = Rtde::connect(bench.sim.addresses.robot.rtde, &["timestamp"]).await;
    let (mut gripper, mut dashboard) = (bench.gripper().await, bench.dashboard().await);
    gripper.read_holding_registers(2, 1).await.unwrap().unwrap();
    bench.fault("{do: net.reset_peer, args: {link: rtde}}");
    while rtde.reply().await.is_some() {}
    assert_eq!(request(&mut dashboard, "robotmode").await, "Robotmode: RUNNING", "the others go on");
    bench.fault("{do: net.reset_peer, args: {link: all}}");
    assert!(gripper.read_holding_registers(2, 1).await.is_err());
    let mut rest = Vec::new();
    assert!(
        tokio::time::timeout(PATIENCE, dashboard.read_to_end(&mut rest)).await.unwrap().is_err(),
        "a reset"
    );
    assert_eq!(bench.request("robotmode").await, "Robotmode: RUNNING");
    bench.gripper().await.read_holding_registers(2, 1).await.unwrap().unwrap();
    bench.sim.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_half_open_connection_is_silent_and_loses_nothing() {
    let bench = bench("").await;
    let mut dashboard = bench.dashboard().await;
    bench.fault("{do: net.timeout, args: {link: dashboard}}");
    dashboard.write_all(b"robotmode\n").await.unwrap();
    let began = bench.step();
    bench.until("ten seconds", |sim| sim.robot().controller().core.step > began + 5000).await;
    let mut buffer = [0; 64];
    let early = dashboard.try_read(&mut buffer).unwrap_err();
    assert_eq!(early.kind(), std::io::ErrorKind::WouldBlock, "silent, and open");
    bench.fault("{do: clear, args: {fault: net.timeout}}");
    assert_eq!(tokio::time::timeout(PATIENCE, line(&mut dashboard)).await.unwrap(), "Robotmode: RUNNING");
    bench.sim.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn answers_come_late_in_pieces_or_not_whole() {
    let bench = bench("").await;
    let mut dashboard = bench.dashboard().await;
    bench.fault("{do: net.latency, args: {link: dashboard, latency_s: 5}}");
    let began = Instant::now();
    assert_eq!(request(&mut dashboard, "robotmode").await, "Robotmode: RUNNING");
    assert!(began.elapsed().as_secs_f64() * FACTOR >= 5.0, "{:?}", began.elapsed());
    bench.fault("{do: clear}");
    bench.fault("{do: net.slicer, args: {link: dashboard, bytes: 1}}");
    assert_eq!(request(&mut dashboard, "safetymode").await, "Safetymode: NORMAL");
    bench.fault("{do: clear}");
    bench.fault("{do: net.limit_data, args: {link: dashboard, bytes: 7}}");
    let mut greeting = Vec::new();
    // The reset may come before the connection was noticed to be there.
    if let Ok(mut cut) = TcpStream::connect(bench.sim.addresses.robot.dashboard).await {
        let end = tokio::time::timeout(PATIENCE, cut.read_to_end(&mut greeting)).await.unwrap();
        assert!(end.is_err(), "a reset");
    }
    assert!(greeting.len() <= 7, "{}", greeting.len());
    bench.sim.shutdown().await;
}

#[tokio::test]
async fn a_slice_is_never_larger_than_requested() {
    use crate::faults::link::{Link, LinkState};
    use crate::serve::stream::LinkStream;
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let mut peer = TcpStream::connect(listener.local_addr().unwrap()).await.unwrap();
    let link = Link::default();
    link.set(LinkState { slice: Some(2), ..LinkState::default() });
    let mut stream = LinkStream::new(listener.accept().await.unwrap().0, &link, None);
    assert_eq!(stream.write(b"hello").await.unwrap(), 2);
    stream.write_all(b"llo").await.unwrap();
    let mut all = [0; 5];
    peer.read_exact(&mut all).await.unwrap();
    assert_eq!(&all, b"hello");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_gripper_answers_with_an_exception_and_leaks() {
    let bench = bench("").await;
    let mut gripper = bench.gripper().await;
    bench.fault("{do: net.exception, args: {code: 4}}");
    let refused = gripper.read_holding_registers(2, 1).await.unwrap().map(drop);
    assert_eq!(refused, Err(ExceptionCode::ServerDeviceFailure));
    bench.fault("{do: clear}");
    gripper.write_single_register(0, 0x013C).await.unwrap().unwrap();
    bench.until("the vacuum of an open cup", |sim| lock(&sim.world()).vacuum(Channel::A) > 0.115).await;
    bench.fault("{do: vacuum.leak, args: {vacuum: 0.03}}");
    bench.until("the leak", |sim| lock(&sim.world()).vacuum(Channel::A) < 0.031).await;
    assert!(gripper.read_holding_registers(258, 1).await.unwrap().unwrap()[0] <= 39);
    bench.sim.shutdown().await;
}

/// Down to the block, up, 0.2 m aside, down, up. Something switches the vacuum.
const PICK_AND_PLACE: &str = "def ours():\n  p = get_actual_tcp_pose()\n  movel(pose_trans(p, \
                              p[0,0,0.0998,0,0,0]), v=0.25)\n  \
    sleep(1)\n  movel(p, v=0.25)\n  movel(pose_add(p, p[0.2,0,0,0,0,0]), a=0.5, v=0.25)\n  \
    movel(pose_trans(pose_add(p, p[0.2,0,0,0,0,0]), p[0,0,0.0998,0,0,0]), v=0.25)\n  sleep(1)\n  movel(p, \
    v=0.25)\nend\n";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_vacuum_drops_half_way_through_the_first_carry() {
    let faults = "faults:\n  - {at: {step: 1, phase: carry, progress: 0.5}, do: vacuum.drop}\n";
    let bench = bench(faults).await;
    bench.gripper().await.write_single_register(0, 0x013C).await.unwrap().unwrap();
    let _ours = bench.upload(PICK_AND_PLACE).await;
    bench.until("the fall", |_| bench.happened(|kind| matches!(kind, EventKind::Dropped { .. }))).await;
    let world = bench.sim.world();
    let x = lock(&world).object("block").unwrap().pose().x;
    assert!((0.55..0.68).contains(&x), "{x}");
    let fault = |kind: &EventKind| *kind == EventKind::Fault { name: "vacuum.drop".to_owned() };
    assert!(bench.happened(fault));
    bench.sim.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_event_brings_a_fault_and_a_sticky_object_comes_off_at_its_end() {
    let faults = "faults:\n  - {at: {event: grip, object: block}, do: vacuum.stick}\n";
    let bench = bench(faults).await;
    let mut gripper = bench.gripper().await;
    gripper.write_single_register(0, 0x013C).await.unwrap().unwrap();
    let _ours = bench.upload(PICK_AND_PLACE).await;
    let held = |sim: &RunningSim| lock(&sim.world()).held().count() > 0;
    bench.until("the grip", held).await;
    gripper.write_single_register(0, 0x0000).await.unwrap().unwrap();
    bench.until("the vacuum gone", |sim| lock(&sim.world()).vacuum(Channel::A) < 0.001).await;
    assert!(held(&bench.sim), "it sticks");
    bench.fault("{do: clear, args: {fault: vacuum.stick}}");
    bench.until("the end", |sim| !held(sim)).await;
    bench.sim.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn people_move_objects_and_faults_name_what_exists() {
    let bench = bench("").await;
    bench.fault("{do: world.nudge, args: {object: block, dx_m: 0.03}}");
    let pose = || lock(&bench.sim.world()).object("block").unwrap().pose();
    assert!((pose().x - 0.53).abs() < 1e-9);
    bench.fault("{do: world.place, args: {object: block, pose: [0.1, 0.9, 0]}}");
    assert!((pose().y - 0.9).abs() < 1e-9);
    bench.fault("{do: world.place, args: {object: block, pose: [5, 5, 0]}}");
    assert!(bench.happened(|kind| matches!(kind, EventKind::Fallen { .. })));
    assert_eq!(
        bench.refusal("{do: world.nudge, args: {object: block, dx_m: 0.01}}"),
        FaultError::NotFree("block".into())
    );
    assert_eq!(
        bench.refusal("{do: world.nudge, args: {object: x, dx_m: 0.01}}"),
        FaultError::NoSuchObject("x".into())
    );
    assert_eq!(
        bench.refusal("{at: {event: grip, object: y}, do: ur.pstop}"),
        FaultError::NoSuchObject("y".into())
    );
    bench.sim.shutdown().await;
    let mut bad = config();
    bad.faults =
        read_faults("faults: [{at: {time_s: 1}, do: camera.occlude, args: {marker: 9}}]", "f").unwrap();
    assert!(matches!(start(bad).await, Err(SimError::Fault(FaultError::NoSuchMarker(9)))));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn things_without_a_marker_stand_on_the_table_until_their_fault_ends() {
    let bench = bench("").await;
    let heights = || -> Vec<f64> {
        let scene = lock(&bench.sim.world()).scene();
        scene
            .prisms
            .iter()
            .filter(|p| p.table_from_prism.translation.z.abs() < 1e-9)
            .map(|p| p.height_m)
            .collect()
    };
    assert_eq!(heights(), [0.03], "the block alone");
    let thing = |shape: &str, y: f64, height_m: f64| {
        format!(
            "{{do: world.foreign, args: {{shape: {shape}, size_m: [0.08, 0.05], height_m: {height_m}, pose: \
             [0.2, {y}, 0]}}}}"
        )
    };
    bench.fault(&thing("mug", 0.2, 0.09));
    bench.fault(&thing("box", 0.8, 0.05));
    // Ordered again it is still one thing.
    bench.fault(&thing("mug", 0.2, 0.09));
    assert_eq!(heights(), [0.03, 0.09, 0.05]);
    bench.fault("{do: camera.gain, args: {gain: 0.9}}");
    bench.fault("{do: clear, args: {fault: camera.gain}}");
    assert_eq!(heights(), [0.03, 0.09, 0.05], "other faults leave them alone");
    bench.fault("{do: clear, args: {fault: world.foreign}}");
    assert_eq!(heights(), [0.03]);
    bench.sim.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn rtde_comes_at_another_rate_than_was_agreed() {
    let bench = bench("").await;
    let mut rtde = Rtde::connect(bench.sim.addresses.robot.rtde, &["control_step"]).await;
    // 25 Hz were agreed: every 20 frames.
    bench.fault("{do: ur.rate, args: {hz: 5}}");
    rtde.until_gap(100).await;
    bench.fault("{do: clear}");
    rtde.until_gap(20).await;
    bench.sim.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_controller_says_it_is_another_one() {
    let bench = bench("").await;
    bench.fault("{do: ur.version, args: {version: 3.15.8.106339}}");
    bench.fault("{do: ur.model, args: {model: UR10}}");
    assert_eq!(bench.request("version").await, "3.15.8.106339");
    assert_eq!(bench.request("get robot model").await, "UR10");
    bench.fault("{do: clear, args: {fault: ur.model}}");
    assert_eq!(bench.request("get robot model").await, "UR5");
    bench.fault("{do: clear}");
    assert!(bench.request("PolyscopeVersion").await.starts_with("URSoftware 5."));
    bench.sim.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn answers_of_the_gripper_have_another_number() {
    let bench = bench("").await;
    bench.fault("{do: net.transaction}");
    let mut stream = TcpStream::connect(bench.sim.addresses.modbus).await.unwrap();
    let request = [0x12, 0x34, 0, 0, 0, 6, 65, 3, 0, 2, 0, 1];
    let mut answer = [0; 11];
    stream.write_all(&request).await.unwrap();
    stream.read_exact(&mut answer).await.unwrap();
    assert_eq!(answer[..2], [0x12, 0x35]);
    bench.fault("{do: clear}");
    stream.write_all(&request).await.unwrap();
    stream.read_exact(&mut answer).await.unwrap();
    assert_eq!(answer[..2], [0x12, 0x34]);
    drop(stream);
    bench.sim.shutdown().await;
}
