//! Loss of the leader's process, noticed by its presence token.
//!
//! When a process dies, its sockets close, and the other nodes see its presence token vanish within
//! milliseconds. Its silence shows the same only after an election timeout. A token is a hint: it
//! also vanishes when a link closes or a session is opened again, and it may remain. So a voter
//! whose leader has lost its token queries that leader:
//!
//! ```text
//!  token of the leader vanishes ──▶ query the leader ─┬─ it replies, or its token returns: a false alarm
//!                                                     ├─ no reply, or a message of the leader since: query again
//!                                                     └─ nothing serves the query: the leader is lost
//!  lost ──▶ this voter grants pre-votes and votes, and asks for pre-votes itself in its turn
//! ```
//!
//! A voter that has not lost the leader itself still refuses. So an election needs a majority that
//! can neither see nor query the leader. If the leader is alive, it has lost its majority as well,
//! and no robot can report to it through these voters. A part of the voters that loses the leader
//! is refused by the others, and binds itself again at the next message of the leader. A missing
//! token causes no election as long as the leader replies; and a voter without a vanished token, or
//! with a leader that does not reply, waits for the election timeout.
//!
//! Safety does not rest on any of this: votes and logs decide. A leader that is alive but lost to a
//! majority may count itself leader until its check-quorum timeout, while another is elected. It
//! commits nothing, and its effects outside the ledger carry its term. Leases remain safe, since a
//! voter acknowledges a leader before it votes for the next, not after.
//!
//! Voters take turns in the order of their ids. Their tokens vanish at about the same time, so
//! without turns each would vote for itself.

use super::leader_contact::LeaderContact;
use super::leadership_view::LeadershipView;
use super::network::{LeaderReply, RaftClient};
use super::types::RaftId;
use consort_bus::{Presence, Stream};
use consort_protocol::ids::NodeId;
use consort_protocol::keys::Key;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{Instant, sleep};
use tracing::{debug, info};

/// Number of queries of a leader after its token has vanished. With the pauses between them they
/// cover a heartbeat interval: messages of the dead leader that were under way have arrived by then.
const QUERIES_MAX: u32 = 8;

/// Conclusion from a query of a leader whose token has vanished.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Finding {
    /// The leader works, or its link does again.
    FalseAlarm,
    /// Undecided.
    AskAgain,
    /// The leader's process is gone, or unreachable.
    Lost,
}

/// Draws the conclusion. `token_is_back` is true if the token has returned, and `heard_since` if a
/// message of the leader has arrived since the query was sent.
fn conclude(reply: LeaderReply, token_is_back: bool, heard_since: bool) -> Finding {
    match reply {
        LeaderReply::Received => Finding::FalseAlarm,
        _ if token_is_back => Finding::FalseAlarm,
        LeaderReply::NoService if !heard_since => Finding::Lost,
        // A message that was under way may have arrived late, or an old route was used.
        LeaderReply::NoService | LeaderReply::Missing => Finding::AskAgain,
    }
}

/// Returns the pause of this node before it campaigns in place of a lost leader. The first of the
/// other voters by id waits until they have noticed the loss as well; each further voter waits until
/// the one before it has been elected or has failed.
pub(super) fn turn(voters: impl Iterator<Item = RaftId>, lost: RaftId, me: RaftId, heartbeat: Duration) -> Duration {
    let earlier = voters.filter(|voter| *voter != lost && *voter < me).count();
    heartbeat / 16 + (heartbeat / 4).saturating_mul(u32::try_from(earlier).unwrap_or(u32::MAX))
}

/// Watches the presence token of each leader that this voter follows, and records its loss. A learner
/// elects no leader.
pub(super) async fn watch_leader(client: RaftClient, contact: Arc<LeaderContact>, heartbeat: Duration) {
    let mut leadership = client.leadership.clone();
    loop {
        let followed = leadership.wait_for(|view| followed_leader(view, client.me).is_some()).await;
        let Ok(Some((leader, name))) = followed.map(|view| followed_leader(&view, client.me)) else { return };
        let token = client.keys.write(&Key::AliveNode(name));
        let mut tokens = match client.bus.watch(&token).await {
            Ok(tokens) => tokens,
            Err(problem) => {
                debug!(token, %problem, "the leader's presence is not watched");
                return;
            }
        };
        loop {
            let other_leader =
                async { leadership.wait_for(|view| !is_followed(view, client.me, leader)).await.is_ok() };
            tokio::select! {
                biased;
                changed = other_leader => match changed {
                    true => break,
                    false => return,
                },
                change = tokens.recv() => match change {
                    Some(Presence { alive: false, .. }) => {
                        query_leader(&client, &contact, leader, heartbeat, &mut tokens).await;
                    }
                    Some(Presence { alive: true, .. }) => {}
                    None => return,
                },
            }
        }
    }
}

/// Returns the leader that a voter follows, unless it is the leader itself.
fn followed_leader(view: &LeadershipView, me: RaftId) -> Option<(RaftId, NodeId)> {
    let leader = view.leader_id?.leader;
    let follows = leader != me && view.voters.contains_key(&me);
    view.leader.clone().filter(|_| follows).map(|name| (leader, name))
}

fn is_followed(view: &LeadershipView, me: RaftId, leader: RaftId) -> bool {
    followed_leader(view, me).is_some_and(|(followed, _)| followed == leader)
}

/// Queries a leader whose token has vanished, and records its loss, as long as this voter follows it.
async fn query_leader(
    client: &RaftClient,
    contact: &LeaderContact,
    leader: RaftId,
    heartbeat: Duration,
    tokens: &mut Stream<Presence>,
) {
    let mut token_is_back = false;
    for _ in 0..QUERIES_MAX {
        if !is_followed(&client.leadership.borrow(), client.me, leader) {
            return;
        }
        // A message that was under way may have ended the loss.
        if !contact.has_lost(leader) {
            let asked_at = Instant::now();
            let reply = client.peer(leader).query_as_leader(heartbeat / 2).await;
            while let Some(change) = tokens.try_recv() {
                token_is_back = change.alive;
            }
            match conclude(reply, token_is_back, contact.last_contact() >= asked_at) {
                Finding::FalseAlarm => return,
                Finding::AskAgain => {}
                Finding::Lost => {
                    if contact.record_leader_lost(leader, asked_at) {
                        info!(node = %client.me, %leader, "the leader is gone: its presence has ended");
                    }
                }
            }
        }
        sleep(heartbeat / 8).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::types::LeaderId;

    #[test]
    fn only_other_voters_watch_a_leader() {
        let [leader, voter, learner] = [1, 2, 3].map(RaftId);
        let [ada, bob, cyd] = ["ada", "bob", "cyd"].map(|name| NodeId::new(name).unwrap());
        let view = LeadershipView {
            leader_id: Some(LeaderId { term: 5, leader }),
            leader: Some(ada.clone()),
            voters: [(leader, ada.clone()), (voter, bob)].into(),
            learners: [(learner, cyd)].into(),
            ..LeadershipView::default()
        };
        let followed = [leader, voter, learner].map(|me| followed_leader(&view, me));
        assert_eq!(followed, [None, Some((leader, ada)), None]);
        assert!(is_followed(&view, voter, leader) && !is_followed(&view, voter, voter));
        assert!(!is_followed(&LeadershipView { leader_id: None, ..view }, voter, leader));
    }

    #[test]
    fn only_a_silent_leader_without_token_and_service_is_lost() {
        for reply in [LeaderReply::Received, LeaderReply::NoService, LeaderReply::Missing] {
            for (token_is_back, heard_since) in [(false, false), (false, true), (true, false), (true, true)] {
                let expected = match (reply, token_is_back, heard_since) {
                    (LeaderReply::NoService, false, false) => Finding::Lost,
                    (LeaderReply::Received, ..) | (_, true, _) => Finding::FalseAlarm,
                    _ => Finding::AskAgain,
                };
                assert_eq!(conclude(reply, token_is_back, heard_since), expected, "{reply:?}");
            }
        }
    }

    #[test]
    fn the_voters_take_turns_in_the_order_of_their_ids() {
        let heartbeat = Duration::from_millis(160);
        let turn_ms = |me| turn([4, 2, 9, 7].map(RaftId).into_iter(), RaftId(2), RaftId(me), heartbeat).as_millis();
        assert_eq!([4, 7, 9].map(turn_ms), [10, 50, 90]);
    }
}
