//! Keeps the connection, and sees to it that what the fleet needs is on the server, now and after each
//! reconnection.
//!
//! In: the settings. Out: [`Link`]s: the server serves, it does not any more, or why it does not.

use crate::connect::{ConnectFault, connect};
use crate::server::{Server, consumer, open};
use crate::side::Settings;
use crate::subjects::Lane;
use async_nats::{Client, Event, jetstream};
use futures_util::future::try_join_all;
use std::time::Duration;
use tokio::sync::mpsc;

/// What the connection's own task says.
pub enum Link {
    /// The server serves.
    Up(Box<Ready>),
    /// It does not.
    Down,
    /// Why not.
    Fault(String),
}

/// A connection that failed is tried again after so long.
const CONNECT_AGAIN: Duration = Duration::from_secs(1);

/// Connects, and sees to it that what the fleet needs is on the server, now and after each reconnection.
pub async fn keep_linked(settings: Settings, ack_wait: Duration, link: mpsc::UnboundedSender<Link>) {
    let (events_sender, mut events) = mpsc::unbounded_channel();
    let client = loop {
        match connect(&settings.access, events_sender.clone()).await {
            Ok(client) => break client,
            Err(fault) => {
                let _ = link.send(Link::Fault(fault.to_string()));
                tokio::time::sleep(CONNECT_AGAIN).await;
            }
        }
    };
    let mut up = true;
    loop {
        if up {
            match prepare(&client, &settings, ack_wait).await {
                Ok(ready) => {
                    let _ = link.send(Link::Up(Box::new(ready)));
                    up = false;
                }
                Err(fault) => {
                    let _ = link.send(Link::Fault(fault.to_string()));
                }
            }
        }
        let event = match up {
            true => tokio::time::timeout(CONNECT_AGAIN, events.recv()).await.ok().flatten(),
            false => events.recv().await,
        };
        match event {
            Some(Event::Connected) => up = true,
            Some(Event::Disconnected) => {
                let _ = link.send(Link::Down);
                up = false;
            }
            Some(Event::ServerError(error)) => {
                let _ = link.send(Link::Fault(format!("the NATS server says: {error}")));
            }
            Some(_) | None => {}
        }
        if link.is_closed() {
            return;
        }
    }
}

/// A connection that serves: client, streams and buckets, a consumer a lane.
pub type Ready = (Client, Server, Vec<(Lane, jetstream::consumer::PullConsumer)>);

async fn prepare(client: &Client, settings: &Settings, ack_wait: Duration) -> Result<Ready, ConnectFault> {
    let server = open(client, settings.access.domain.as_deref(), &settings.fleet, settings.storage).await?;
    let lanes = Lane::of_cell(&settings.cell, &settings.labels);
    let made = lanes.iter().map(|lane| consumer(&server.jobs, &settings.fleet, lane, ack_wait));
    let made = try_join_all(made).await?;
    Ok((client.clone(), server, lanes.into_iter().zip(made).collect()))
}
