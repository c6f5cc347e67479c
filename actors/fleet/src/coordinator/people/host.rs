//! The host of simulated people, as a coordinator reaches it.

use crate::robot_driver::{PersonCommand, PersonRequestState};
use consort_bus::{Author, SharedBus};
use consort_protocol::codec;
use consort_protocol::keys::{Key, Keys, PeopleCall};
use std::time::Duration;
use tokio::task::JoinSet;
use tracing::{debug, warn};

/// Timeout for the host to reply.
const HOST_TIMEOUT: Duration = Duration::from_millis(500);

/// Attempts to send a command before a request of a person goes on. Raised: fewer commands are late, and the request takes
/// longer while the host is unreachable. Default: a guess.
const ATTEMPTS: usize = 2;

/// The way to the host of simulated people. Without such a host there are no replies.
#[derive(Clone)]
pub(in crate::coordinator) struct PeopleHost {
    bus: SharedBus,
    key: String,
}

impl PeopleHost {
    /// Returns the way to the host of this fleet.
    pub(in crate::coordinator) fn new(bus: &SharedBus, keys: &Keys) -> PeopleHost {
        PeopleHost { bus: bus.clone(), key: keys.write(&Key::People(PeopleCall::Ask)) }
    }

    /// Sends a command, and passes the replies to `receive`. Returns whether a host has done what is requested: each host
    /// replies, also those of other robots.
    pub(super) async fn send(&self, command: &PersonCommand, receive: impl Fn(PersonRequestState, Author)) -> bool {
        let bytes = match codec::encode(command) {
            Ok(bytes) => bytes.into(),
            Err(problem) => {
                warn!(%problem, "person request does not fit a message");
                return false;
            }
        };
        let Ok(mut replies) = self.bus.query(&self.key, bytes, HOST_TIMEOUT).await else { return false };
        let mut is_done = false;
        while let Some(reply) = replies.recv().await {
            match reply.payload.map(|bytes| codec::decode::<PersonRequestState>(&bytes)) {
                Ok(Ok(state)) => {
                    is_done |= matches!(state, PersonRequestState::Ended(Ok(_)));
                    receive(state, reply.author);
                }
                other => debug!(?other, "person request got no reply"),
            }
        }
        is_done
    }

    /// Sends the commands at once, and returns when all are done, or after the last attempt.
    pub(in crate::coordinator) async fn send_all(&self, commands: Vec<PersonCommand>) {
        let mut sent = JoinSet::new();
        for command in commands {
            let host = self.clone();
            sent.spawn(async move {
                for _ in 0..ATTEMPTS {
                    if host.send(&command, |_, _| ()).await {
                        return;
                    }
                }
            });
        }
        sent.join_all().await;
    }
}
