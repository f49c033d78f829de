//! Packages take two ways to a client: past the queue of its connection while that is empty, and through it.
//! In: a client that stops reading and goes on. Checked: nothing is torn, nothing overtakes, faults of the
//! link hold on both.

use super::*;
use crate::faults::link::{Link, LinkName, LinkState};
use crate::robot_server::line::Way;
use crate::robot_server::rtde;
use ur_wire::rtde_variables::OUTPUTS;

fn timestamp(values: &[Value]) -> f64 {
    match values.first() {
        Some(Value::Double(timestamp)) => *timestamp,
        other => panic!("{other:?}"),
    }
}

#[tokio::test]
async fn packages_arrive_whole_and_in_order_whether_the_queue_is_used_or_not() {
    let bench = bench(15, running()).await;
    let mut rtde = Rtde::connect(&bench, Version::V2).await;
    let mut names = vec!["timestamp"];
    names.extend(OUTPUTS.iter().map(|(name, _)| *name).filter(|name| *name != "timestamp"));
    let recipe = rtde.outputs(500.0, &names).await.unwrap();
    rtde.request(Request::Start).await;
    // One socket buffer after the other fills, then the queue, then packages are skipped.
    bench.until(|b| (b.shared.publisher().counts().1 > 0).then_some(())).await;
    let behind = bench.shared.publisher().counts().0;
    // A reply takes its place behind what is queued.
    rtde.send(Request::ControllerVersion).await;
    let mut last = 0.0;
    let reading = async {
        let mut replies = 0;
        for _ in 0..behind + 500 {
            match rtde.next().await.expect("closed") {
                Reply::Data { recipe: 1, payload } => {
                    let values = recipe.decode(&payload, Leftover::Refuse).unwrap();
                    assert!(timestamp(&values) > last, "{} after {last}", timestamp(&values));
                    last = timestamp(&values);
                }
                Reply::ControllerVersion(_) => replies += 1,
                other => panic!("{other:?}"),
            }
        }
        replies
    };
    assert_eq!(bench.during(reading).await, 1);
    // Both ways were taken.
    let publisher = bench.shared.publisher();
    let (sent, at_once) = (publisher.counts().0, publisher.sent_at_once());
    assert!(at_once > 100 && sent - at_once > 100, "{at_once} of {sent}");
}

#[tokio::test]
async fn data_follow_the_reply_to_their_start() {
    let bench = bench(18, running()).await;
    let (mut session, mut inlet) = rtde::Session::open(&bench.shared, None);
    let names = vec!["timestamp".to_owned()];
    let requests = [Request::ProtocolVersion(2), Request::SetupOutputs { frequency_hz: Some(500.0), names }];
    let bytes = [requests[0].encode(Version::V1), requests[1].encode(Version::V2)].concat();
    assert_eq!(session.receive(&bench.shared, &bytes).unwrap().len(), 2);
    session.answered(&bench.shared);
    let start = Request::Start.encode(Version::V2);
    assert_eq!(session.receive(&bench.shared, &start).unwrap(), [Reply::Start(true).encode(Version::V2)]);
    // Frames go on between the reply and the moment it is on its way.
    bench.shared.frame(None);
    assert!(inlet.take().is_none());
    session.answered(&bench.shared);
    bench.shared.frame(None);
    assert!(inlet.take().is_some());
    // A pause in the same packet as the start wins.
    let both = [start, Request::Pause.encode(Version::V2)].concat();
    assert_eq!(session.receive(&bench.shared, &both).unwrap().len(), 2);
    session.answered(&bench.shared);
    bench.shared.frame(None);
    assert!(inlet.take().is_none());
    session.close(&bench.shared);
}

#[tokio::test]
async fn an_answer_that_is_held_back_comes_without_anything_behind_it() {
    let bench = bench(17, running()).await;
    let late = LinkState { latency: Duration::from_millis(30), ..LinkState::default() };
    bench.shared.links.get(LinkName::Rtde).set(late);
    let mut rtde = Rtde::connect(&bench, Version::V2).await;
    assert!(matches!(rtde.request(Request::ControllerVersion).await, Reply::ControllerVersion(_)));
}

#[tokio::test]
async fn a_reset_connection_gives_its_inputs_back() {
    let bench = bench(16, running()).await;
    let mut rtde = Rtde::connect(&bench, Version::V2).await;
    assert_eq!(rtde.inputs(&["input_int_register_24", "speed_slider_mask"]).await.0, 1);
    bench.shared.links.get(LinkName::Rtde).reset();
    let claimed = |b: &Bench| b.shared.controller().core.registers.claimed("input_int_register_24");
    bench.until(|b| (!claimed(b)).then_some(())).await;
    let mut again = Rtde::connect(&bench, Version::V2).await;
    assert_eq!(again.inputs(&["input_int_register_24", "speed_slider_mask"]).await.0, 1);
}

#[tokio::test]
async fn the_shortcut_is_closed_while_anything_is_wrong_with_the_link() {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let mut peer = TcpStream::connect(listener.local_addr().unwrap()).await.unwrap();
    let link = Link::default();
    let mut stream = LinkStream::new(listener.accept().await.unwrap().0, &link, None);
    let shortcut = stream.shortcut();
    // The runtime has to get an event from the socket once.
    stream.write_all(b"a").await.unwrap();
    assert_eq!(shortcut.try_write(b"bc"), 2);
    let wrong = [
        LinkState { silent: true, ..LinkState::default() },
        LinkState { slice: Some(1), ..LinkState::default() },
        LinkState { limit: Some(100), ..LinkState::default() },
        LinkState { latency: Duration::from_millis(20), ..LinkState::default() },
    ];
    for state in wrong {
        link.set(state);
        assert_eq!(shortcut.try_write(b"x"), 0);
    }
    // What is held back goes first, even when the delay is over for those after it.
    stream.write_all(b"d").await.unwrap();
    link.set(LinkState::default());
    assert_eq!(shortcut.try_write(b"x"), 0);
    let mut all = [0; 4];
    let mut nothing = [0; 1];
    tokio::select! {
        read = peer.read_exact(&mut all) => drop(read.unwrap()),
        // Held back bytes are sent by the reader.
        _ = stream.read(&mut nothing) => unreachable!("the peer sent nothing"),
    }
    assert_eq!(&all, b"abcd");
    assert_eq!(shortcut.try_write(b"e"), 1);
    // Bytes of both ways count against a limit.
    link.set(LinkState { limit: Some(6), ..LinkState::default() });
    assert_eq!(stream.write(b"fgh").await.unwrap(), 1);
    assert!(stream.write(b"g").await.is_err());
    link.set(LinkState::default());
    link.reset();
    assert_eq!(shortcut.try_write(b"x"), 0);
}
