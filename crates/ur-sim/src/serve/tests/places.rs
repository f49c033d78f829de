//! More connections than there are places.

use super::*;

/// A server that only answers closes the connection that has been silent longest, and keeps the others.
#[tokio::test]
async fn forgotten_dashboard_connections_shut_out_no_other() {
    let bench = bench(12, running()).await;
    let mut busy = dashboard(&bench).await;
    let mut forgotten = Vec::new();
    for _ in 0..5 * MAX_CONNECTIONS {
        forgotten.push(TcpStream::connect(bench.at.dashboard).await.unwrap());
        assert_eq!(busy.request("running").await, "Program running: false");
    }
    assert_eq!(dashboard(&bench).await.request("robotmode").await, "Robotmode: RUNNING");
    let mut rest = Vec::new();
    // An end or a reset: it has left.
    let first = forgotten.first_mut().unwrap().read_to_end(&mut rest);
    let _ = tokio::time::timeout(PATIENCE, first).await.expect("the first still has its place");
}

/// A server that sends unrequested takes more, and a client that only reads is not silent.
#[tokio::test]
async fn forgotten_rtde_connections_shut_out_no_other_and_readers_stay() {
    let bench = bench(20, running()).await;
    let mut reader = Rtde::connect(&bench, Version::V2).await;
    let recipe = reader.outputs(500.0, &["timestamp"]).await.unwrap();
    assert_eq!(reader.request(Request::Start).await, Reply::Start(true));
    let mut forgotten = Vec::new();
    for _ in 0..2 * MAX_LISTENERS {
        forgotten.push(TcpStream::connect(bench.at.rtde).await.unwrap());
        bench.during(reader.data(&recipe)).await;
    }
    let mut next = Rtde::connect(&bench, Version::V2).await;
    assert!(next.outputs(500.0, &["timestamp"]).await.is_some());
    let mut rest = Vec::new();
    // An end or a reset: it has left.
    let first = forgotten.first_mut().unwrap().read_to_end(&mut rest);
    let _ = tokio::time::timeout(PATIENCE, first).await.expect("the first still has its place");
    assert!(bench.shared.publisher().subscribers(Feed::Rtde) <= MAX_LISTENERS + 1);
    bench.during(reader.data(&recipe)).await;
}

/// As many as there are places are all served.
#[tokio::test]
async fn a_full_primary_interface_serves_all_of_its_clients() {
    let bench = bench(21, running()).await;
    let mut clients = Vec::new();
    for _ in 0..MAX_LISTENERS {
        let mut client = Primary::connect(bench.at.primary).await;
        assert!(client.next().await.is_some());
        clients.push(client);
    }
    assert_eq!(bench.shared.publisher().subscribers(Feed::Primary), MAX_LISTENERS);
    for client in &mut clients {
        assert!(bench.during(client.next()).await.is_some());
    }
}
