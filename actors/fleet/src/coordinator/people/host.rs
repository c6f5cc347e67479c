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

    /// Sends a command, and passes the replies to `receive`. Returns whether a host has done what is requested. Each host
    /// replies. A reply of a host that serves neither the robot nor the person shows only that a host is there.
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
                    let state = match may_answer(command, &reply.author) {
                        true => state,
                        false => PersonRequestState::Requested,
                    };
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

/// Checks whether the author of a reply serves the person of a request, or the robots whose items are taken. A
/// cancelation names neither; hosts cancel requests that are not repeated, so a false confirmation has no effect.
fn may_answer(command: &PersonCommand, author: &Author) -> bool {
    match &command.request {
        Some(request) if request.takes_items() => {
            request.holders.values().all(|robot| author.may_serve(robot.as_str()))
        }
        Some(request) => author.may_serve(request.role.as_str()),
        None => true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::ids::TaskType;
    use consort_protocol::mission::TaskSpec;
    use consort_skills::actions::{GoalId, PersonRequest};
    use std::collections::BTreeMap;
    use std::sync::Arc;

    #[test]
    fn only_the_host_of_a_person_or_a_robot_answers_for_it() {
        let host = |serves: &str| {
            let identity = format!("consort://ward/node/world?roles=host&serves={serves}").parse().unwrap();
            Author::verified(Arc::new(identity))
        };
        let (clerk, r1, ada) = ("clerk".parse().unwrap(), "r1".parse().unwrap(), "ada".parse().unwrap());
        let task = TaskSpec::of(TaskType::new("deposit").unwrap(), vec![clerk]);
        let to_clerk = PersonRequest { role: task.roles[0].clone(), holders: BTreeMap::new(), task };
        let command = |request| PersonCommand { id: GoalId(1), request };
        let (asks, removes) = (command(Some(to_clerk)), command(Some(PersonRequest::taking_items(r1, ada))));
        let may = |serves: &str| [&asks, &removes].map(|command| may_answer(command, &host(serves)));
        assert_eq!(may("clerk"), [true, false]);
        assert_eq!(may("ada"), [false, true]);
        assert_eq!(may("r1,eve"), [false, false], "the name of a role is no robot");
        assert_eq!(may("*"), [true, true]);
        assert!(may_answer(&command(None), &host("eve")), "a cancelation");
        assert!(may_answer(&asks, &Author::UNKNOWN), "in an open fleet");
    }
}
