//! Elections, heartbeats and check-quorum: the parts of Raft that openraft 0.9 lacks.
//!
//! openraft's own elections are switched off. Its followers wait `election_max` *and* a timeout of
//! their own, which each draws once at its start. On the virtual bus that made failovers of 504 ms
//! (median, heartbeat 50 ms, election 150 to 300 ms) where this file takes 176 ms. Two more
//! measurements with openraft alone: a voter that was unreachable for five seconds deposes the
//! leader each time it returns, because by then it has raised its term in vain about ten times. And
//! a leader that can send but not receive stays leader without a limit, in a fleet that commits
//! nothing. Nothing in this file affects the safety of Raft, which rests only on openraft's
//! handling of terms, votes and logs.
//!
//! - *Pre-vote* (Ongaro's dissertation, 9.6): a node without leader contact for a time drawn anew
//!   from `election_min..election_max` asks the other voters whether they have leader contact, and
//!   whether its log is as long as theirs. It campaigns only if a majority grants the pre-vote.
//! - *Lost leader*: a node whose leader's process is gone asks at once, in its turn, and grants
//!   pre-votes and votes without waiting for `election_min` (`leader_loss`).
//! - *Slow disks*: a voter that is writing its vote to disk, or has just done so, neither campaigns
//!   nor grants a pre-vote, for `SYNCS_TO_LEAD` times the duration of that write. Otherwise a
//!   candidate that waits for votes would be overtaken by the next candidate, in the next term,
//!   again and again.
//! - *Vote rejection*: a voter grants no vote within `election_min` of the last contact from its
//!   leader (openraft's leader lease, set to that time), unless that leader has resigned
//!   (`leadership_transfer`) or is lost (`leader_loss`). So a leader that a majority acknowledged
//!   more recently, and that is not lost to a majority, is the only leader.
//! - *Check-quorum* (as in etcd): a leader that no majority acknowledges suspends its appends, so
//!   that the followers that still receive them become free to elect another leader. It resumes
//!   them now and then, in case the majority was only temporarily unreachable.
//! - *Heartbeat*: openraft checks its own heartbeat only every 1.5 intervals, so heartbeats are
//!   driven from here. A voter that has not replied to the last heartbeat receives a heartbeat
//!   request outside openraft, whose core may be waiting for a disk, here or there. The reply
//!   counts as an acknowledgement, so it binds the voter as openraft's does: see
//!   [`LeaderContact::answer_heartbeat`].

use super::leader_contact::LeaderContact;
use super::leader_loss;
use super::messages::PreVoteRequest;
use super::network::RaftClient;
use super::settings::{APPEND_TIMEOUT, RaftSettings};
use super::types::{Peer, Raft, RaftId, StateMachine};
use futures::FutureExt as _;
use openraft::ServerState;
use openraft::metrics::RaftServerMetrics;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{Instant, MissedTickBehavior, interval, sleep, sleep_until};

/// Heartbeat intervals for which a leader waits for the reply to a heartbeat request. On a slow link a reply takes longer
/// than an interval, and still shows that the voter followed when the request was sent. The shortest election timeout
/// has at least three intervals; an older acknowledgement is of no use.
const HEARTBEATS_AWAITED: u32 = 3;

/// Runs campaigns: when there is no leader contact and a majority grants the pre-vote, this node
/// campaigns.
pub(super) async fn run_elections<S: StateMachine>(
    raft: Raft<S>,
    client: RaftClient,
    contact: Arc<LeaderContact>,
    settings: RaftSettings,
    seed: u64,
) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let heartbeat = settings.heartbeat;
    let mut metrics = raft.server_metrics();
    loop {
        if !can_campaign(&metrics.borrow(), client.me) {
            // A leader has no leader contact, and a non-voter receives no replication: both would
            // ask without end. A node that has just become a voter leaves the bootstrapping node a
            // moment to become leader.
            if metrics.wait_for(|now| can_campaign(now, client.me)).await.is_err() {
                return;
            }
            sleep(rng.random_range(heartbeat / 8..heartbeat / 4)).await;
        }
        let timeout = rng.random_range(settings.election_min..settings.election_max);
        tokio::select! {
            biased;
            lost = contact.wait_leader_lost() => {
                let now = metrics.borrow().membership_config.clone();
                sleep(leader_loss::turn(now.membership().voter_ids(), lost, client.me, heartbeat)).await;
            }
            () = sleep_until(contact.last_contact() + timeout) => {}
        }
        let started = Instant::now();
        while contact.last_contact().elapsed() >= timeout && can_campaign(&metrics.borrow(), client.me) {
            // The pre-vote takes time: in the meantime a leader may have made contact, or a
            // candidate may have received our vote.
            let campaigns = contact.resignation_is_past(settings.election_max)
                && contact.no_leader_for(timeout, heartbeat)
                && wins_pre_vote(&raft, &client, heartbeat).await
                && contact.no_leader_for(timeout, heartbeat);
            let campaigns = campaigns && contact.try_begin_vote(settings.election_min);
            if campaigns {
                if raft.trigger().elect().await.is_err() {
                    return;
                }
                // openraft handles requests in order: when this returns, it has voted for itself.
                let vote = raft.with_raft_state(|state| *state.vote_ref()).await;
                contact.end_vote(vote.ok());
            }
            // An election takes a few round trips; candidates of a split vote separate by the
            // random pause. A node that has asked for longer than an election may take is waiting
            // for links or nodes, and asks less often.
            let overdue = started.elapsed() >= settings.election_max;
            let pause = match (campaigns, overdue) {
                (true, _) => heartbeat..heartbeat * 2,
                (false, false) => heartbeat / 8..heartbeat / 4,
                (false, true) => heartbeat / 2..heartbeat,
            };
            sleep(rng.random_range(pause)).await;
        }
    }
}

/// Checks whether this node is a voter and not the leader.
fn can_campaign(metrics: &RaftServerMetrics<RaftId, Peer>, me: RaftId) -> bool {
    let votes = metrics.membership_config.membership().get_joint_config().iter().any(|half| half.contains(&me));
    votes && metrics.state != ServerState::Leader
}

async fn wins_pre_vote<S: StateMachine>(raft: &Raft<S>, client: &RaftClient, limit: Duration) -> bool {
    let voters = raft.server_metrics().borrow().membership_config.membership().get_joint_config().clone();
    let request = PreVoteRequest { last_log_id: raft.data_metrics().borrow().last_log };
    let mut granted_by = BTreeSet::from([client.me]);
    let others: BTreeSet<RaftId> = voters.iter().flatten().copied().filter(|voter| *voter != client.me).collect();
    let request = &request;
    client
        .query_until_majority(
            &voters,
            &mut granted_by,
            &others,
            |peer| async move { peer.pre_vote(request, limit).await },
        )
        .await
}

/// Triggers openraft's heartbeats at the interval of the settings, and sends heartbeat requests
/// outside openraft to late voters. A leader whose own core hangs for longer than an append may
/// take sends nothing more: another leader does better.
pub(super) async fn send_heartbeats<S: StateMachine>(raft: Raft<S>, client: RaftClient, heartbeat: Duration) {
    let metrics = raft.server_metrics();
    let mut ticks = interval(heartbeat);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut core_probe = None;
    loop {
        ticks.tick().await;
        let (vote, voters) = {
            let now = metrics.borrow();
            if now.state != ServerState::Leader {
                continue;
            }
            (now.vote, now.membership_config.membership().voter_ids().collect::<BTreeSet<_>>())
        };
        if raft.trigger().heartbeat().await.is_err() {
            return;
        }
        let (sent_at, reply) = core_probe.get_or_insert_with(|| {
            let raft = raft.clone();
            (Instant::now(), async move { raft.with_raft_state(|_| ()).await.is_ok() }.boxed())
        });
        let core_hangs = sent_at.elapsed() >= APPEND_TIMEOUT;
        if reply.now_or_never().is_some() {
            core_probe = None;
        } else if core_hangs {
            continue;
        }
        let late =
            |voter: &RaftId| client.last_contacts.of(*voter).is_none_or(|at| at.elapsed() >= heartbeat.mul_f64(1.5));
        for voter in voters.into_iter().filter(|voter| *voter != client.me).filter(late) {
            let peer = client.peer(voter);
            tokio::spawn(async move { peer.heartbeat(vote, heartbeat * HEARTBEATS_AWAITED).await });
        }
    }
}
