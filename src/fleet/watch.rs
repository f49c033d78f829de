//! A fleet followed for as long as it is shown.
//!
//! In: a person's connection. Out: a [`FleetView`] a second, also while the server does not answer: then it
//! says so. Whatever ended or was silent is begun anew, from what the server has.

use crate::fleet::view::{Board, FleetView};
use cell_edge::clock::unix_now_s;
use cell_fleet::changes::{Change, Changes};
use cell_fleet::client::Client;
use futures_util::StreamExt;
use std::ops::ControlFlow;
use std::time::Duration;
use tokio::time::{Instant, MissedTickBehavior, interval_at, sleep, timeout};

/// Events that are read at the beginning: those of a shift of a large fleet.
const LAST_EVENTS: u64 = 50_000;

/// How often there is a view.
const EVERY: Duration = Duration::from_secs(1);

/// What does not answer by then is not there.
const WITHIN: Duration = Duration::from_secs(3);

/// Follows a fleet until `each` breaks.
pub async fn watch(client: &Client, fleet: &str, mut each: impl FnMut(FleetView) -> ControlFlow<()>) {
    let mut watch = FleetFollower { board: Board::default(), fleet: fleet.to_string(), ahead_s: 0.0 };
    loop {
        match timeout(WITHIN, client.changes(LAST_EVENTS)).await {
            Ok(Ok(changes)) => {
                // What was known stays: it comes once more, and until then it is what there is to show.
                if watch.follow(client, changes, &mut each).await.is_break() {
                    return;
                }
            }
            Ok(Err(_)) | Err(_) => sleep(EVERY).await,
        }
        if each(watch.view(false)).is_break() {
            return;
        }
    }
}

struct FleetFollower {
    board: Board,
    fleet: String,
    /// How far the server's clock is ahead of ours.
    ahead_s: f64,
}

impl FleetFollower {
    fn view(&self, connected: bool) -> FleetView {
        self.board.view(&self.fleet, unix_now_s() + self.ahead_s, connected)
    }

    /// Until something has ended or the server does not answer.
    async fn follow(
        &mut self,
        client: &Client,
        mut changes: Changes,
        each: &mut impl FnMut(FleetView) -> ControlFlow<()>,
    ) -> ControlFlow<()> {
        // Not at once: what is there comes first.
        let mut ticks = interval_at(Instant::now() + EVERY, EVERY);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                change = changes.next() => match change {
                    None | Some(Change::Ended(_)) => return ControlFlow::Continue(()),
                    Some(change) => self.board.take(change),
                },
                _ = ticks.tick() => {
                    if !self.request(client).await {
                        return ControlFlow::Continue(());
                    }
                    each(self.view(true))?;
                }
            }
        }
    }

    /// What is not followed but requested: the time and the queue. False without an answer.
    async fn request(&mut self, client: &Client) -> bool {
        let requested = timeout(WITHIN, async { (client.server_unix_s().await, client.queued().await) });
        let Ok((Ok(server_unix_s), Ok(queued))) = requested.await else { return false };
        self.ahead_s = server_unix_s - unix_now_s();
        self.board.queue(queued);
        true
    }
}
