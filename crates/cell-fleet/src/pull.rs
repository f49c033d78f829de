//! Pulls one job at a time from a cell's lanes, the most urgent first.
//!
//! In: whether a job is wanted. Out: messages. First each lane is requested in its order for one;
//! then all wait at once, and the first that brings one ends it. Requests that are open then run out by
//! themselves; what they still bring is passed on too, and the agent sends it back.

use crate::subjects::Lane;
use async_nats::jetstream::consumer::{PullConsumer, pull::BatchConfig};
use async_nats::{Client, Message, StatusCode, Subscriber};
use futures_util::StreamExt;
use std::time::Duration;
use tokio::sync::{mpsc, watch};

/// An open request runs out after so long.
const EXPIRES: Duration = Duration::from_secs(10);

/// A lane answers at once whether it has a message.
const AT_ONCE: Duration = Duration::from_secs(2);

/// A request that was neither answered nor ran out is taken for lost.
const LOST: Duration = Duration::from_secs(12);

/// A lane whose server does not answer gets the next request after so long.
const AGAIN: Duration = Duration::from_millis(250);

/// A lane that is refused gets the next request after so long.
const REFUSED_AGAIN: Duration = Duration::from_secs(1);

struct Puller {
    consumers: Vec<PullConsumer>,
    inbox: String,
    answers: Subscriber,
    /// When a request at a lane was made that is still open.
    open: Vec<Option<tokio::time::Instant>>,
    found: mpsc::UnboundedSender<Message>,
}

/// What an answer was.
enum Answer {
    Job,
    None,
}

/// Pulls until the sender of `wanted` is gone. Each change of `wanted` to a new odd number wants one job.
pub async fn pull(
    client: Client,
    consumers: Vec<(Lane, PullConsumer)>,
    mut wanted: watch::Receiver<u64>,
    found: mpsc::UnboundedSender<Message>,
) {
    let inbox = client.new_inbox();
    let Ok(answers) = client.subscribe(format!("{inbox}.*")).await else { return };
    let consumers: Vec<PullConsumer> = consumers.into_iter().map(|(_, consumer)| consumer).collect();
    let open = vec![None; consumers.len()];
    let mut puller = Puller { consumers, inbox, answers, open, found };
    let mut served = 0;
    loop {
        let want = *wanted.borrow_and_update();
        let more = if is_on(want) && want != served {
            puller.one(&mut wanted, want).await.map(|got| {
                if got {
                    served = want;
                }
            })
        } else {
            puller.rest(&mut wanted).await
        };
        if more.is_none() {
            return;
        }
    }
}

/// Odd numbers want a job.
fn is_on(wanted: u64) -> bool {
    wanted % 2 == 1
}

/// Whether an answer says that a request was served: with a job, or that there is none. Anything else (no
/// such consumer yet, too many who wait) would come at once again.
fn ends_a_request(status: Option<StatusCode>) -> bool {
    matches!(status, None | Some(StatusCode::NOT_FOUND | StatusCode::TIMEOUT))
}

impl Puller {
    /// Nothing is wanted: passes on what open requests still bring. `None`: it is over.
    async fn rest(&mut self, wanted: &mut watch::Receiver<u64>) -> Option<()> {
        tokio::select! {
            changed = wanted.changed() => changed.ok(),
            message = self.answers.next() => self.take(message?).map(drop),
        }
    }

    /// Waits for one job; true when there was one, false when it is not wanted any more.
    async fn one(&mut self, wanted: &mut watch::Receiver<u64>, want: u64) -> Option<bool> {
        for lane in 0..self.consumers.len() {
            if self.is_open(lane) {
                continue;
            }
            self.request(lane, true).await;
            match tokio::time::timeout(AT_ONCE, self.answer_of(lane)).await {
                Ok(answer) => {
                    if let Answer::Job = answer? {
                        return Some(true);
                    }
                }
                Err(_) => self.close(lane),
            }
            if *wanted.borrow() != want {
                return Some(false);
            }
        }
        loop {
            for lane in 0..self.consumers.len() {
                if !self.is_open(lane) {
                    self.request(lane, false).await;
                }
            }
            tokio::select! {
                changed = wanted.changed() => {
                    changed.ok()?;
                    return Some(false);
                }
                message = self.answers.next() => {
                    if let Answer::Job = self.take(message?)? {
                        return Some(true);
                    }
                }
                () = tokio::time::sleep(REFUSED_AGAIN) => {}
            }
        }
    }

    async fn answer_of(&mut self, lane: usize) -> Option<Answer> {
        loop {
            let message = self.answers.next().await?;
            let of = self.lane_of(&message);
            match self.take(message)? {
                Answer::Job => return Some(Answer::Job),
                Answer::None if of == Some(lane) => return Some(Answer::None),
                Answer::None => {}
            }
        }
    }

    fn is_open(&self, lane: usize) -> bool {
        self.open.get(lane).copied().flatten().is_some_and(|since| since.elapsed() < LOST)
    }

    fn close(&mut self, lane: usize) {
        if let Some(open) = self.open.get_mut(lane) {
            *open = None;
        }
    }

    /// The lane counts as open a little longer.
    fn leave_alone(&mut self, lane: usize) {
        let since = tokio::time::Instant::now().checked_sub(LOST.saturating_sub(REFUSED_AGAIN));
        if let Some(open) = self.open.get_mut(lane) {
            *open = since;
        }
    }

    async fn request(&mut self, lane: usize, no_wait: bool) {
        let Some(consumer) = self.consumers.get(lane) else { return };
        let expires = (!no_wait).then_some(EXPIRES);
        let batch = BatchConfig { batch: 1, expires, no_wait, ..BatchConfig::default() };
        let inbox = format!("{}.{lane}", self.inbox);
        // The connection is away: what is requested now goes out when it is back, or runs out.
        if consumer.request_batch(batch, inbox.into()).await.is_err() {
            tokio::time::sleep(AGAIN).await;
        }
        if let Some(open) = self.open.get_mut(lane) {
            *open = Some(tokio::time::Instant::now());
        }
    }

    /// An empty answer names the inbox of its lane; a job has its own subject, and names the consumer where
    /// it is to be settled.
    fn lane_of(&self, message: &Message) -> Option<usize> {
        if let Some(lane) = message.subject.strip_prefix(&self.inbox) {
            return lane.strip_prefix('.')?.parse().ok();
        }
        let reply = message.reply.as_ref()?;
        let names =
            |consumer: &PullConsumer| reply.split('.').any(|token| token == consumer.cached_info().name);
        self.consumers.iter().position(names)
    }

    /// Passes a job on, and notes that a request is over. `None`: no one takes it any more.
    fn take(&mut self, message: Message) -> Option<Answer> {
        let lane = self.lane_of(&message);
        // A sign of life, not an end.
        if message.status == Some(StatusCode::IDLE_HEARTBEAT) {
            return Some(Answer::None);
        }
        if let Some(lane) = lane {
            match ends_a_request(message.status) {
                true => self.close(lane),
                false => self.leave_alone(lane),
            }
        }
        if message.status.is_some() || message.reply.is_none() {
            return Some(Answer::None);
        }
        self.found.send(message).ok().map(|()| Answer::Job)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lane_without_a_consumer_is_not_requested_again_at_once() {
        assert!(ends_a_request(None) && ends_a_request(Some(StatusCode::NOT_FOUND)));
        assert!(ends_a_request(Some(StatusCode::TIMEOUT)));
        assert!(!ends_a_request(Some(StatusCode::NO_RESPONDERS)));
        assert!(!ends_a_request(Some(StatusCode::REQUEST_TERMINATED)));
    }
}
