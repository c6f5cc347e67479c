//! The robot actor follows the coordinator that the voters confirm, and the orders of people that it sends.

use super::message::{EndedReport, RobotMessage};
use super::state::{RobotState, UnconfirmedNotice};
use crate::robot::charging::ChargeControl;
use crate::robot::device_access::DeviceAccess;
use crate::robot::leader_poll::{LeaderPoll, Standing};
use consort_bus::{Author, Query, reply};
use consort_protocol::ids::NodeId;
use consort_protocol::message::{AwardNotice, Beacon, OrdersNotice};
use consort_protocol::units::NodeTime;
use ractor::ActorProcessingErr;
use tracing::{info, warn};

/// Maximum number of notices of a node that wait for the result of a poll. A coordinator repeats its notices.
const UNCONFIRMED_MAX: usize = 4;

impl RobotState {
    /// Returns a notice whose author is confirmed as the coordinator. Refuses any other, or keeps it until the voters have
    /// stated their leader.
    pub(super) fn confirm_notice(&mut self, query: Query, notice: AwardNotice) -> Option<(Query, AwardNotice)> {
        // In a fleet without certificates authors are unknown, and every node is trusted.
        let Some(author) = node_of(&query.author) else { return Some((query, notice)) };
        let now = self.now();
        self.leader_check.require_polls();
        match self.leader_check.standing(&author, notice.position(), now) {
            Standing::Confirmed => return Some((query, notice)),
            Standing::Refuted => self.refuse_notice(query),
            Standing::Unconfirmed => {
                let kept = self.unconfirmed_notices.iter().filter(|kept| kept.author == author).count();
                match kept < UNCONFIRMED_MAX {
                    true => self.unconfirmed_notices.push(UnconfirmedNotice { author, notice, query }),
                    false => self.refuse_notice(query),
                }
                self.poll_voters(now);
            }
        }
        None
    }

    /// Follows the orders of a node with this standing. Holds, closures and speed limits count for a short time although
    /// the voters have not confirmed the node: a robot that reaches few voters must not act against them.
    pub(super) fn follow_orders_of(&mut self, standing: Standing, orders: OrdersNotice, now: NodeTime) {
        match standing {
            Standing::Confirmed => self.follow_orders(orders, now),
            Standing::Unconfirmed => self.follow_for_now(&orders, now),
            Standing::Refuted => {}
        }
    }

    /// Keeps the reply to a report until the voters have stated their leader.
    pub(super) fn await_poll_for_reply(&mut self, report: EndedReport, now: NodeTime) {
        self.unconfirmed_reply = Some(report);
        self.poll_voters(now);
    }

    /// Records the beacon of a node that claims to coordinate. Returns false if the robot must ignore it.
    pub(super) fn hear_beacon(&mut self, beacon: &Beacon, author: &Author, now: NodeTime) -> bool {
        if node_of(author).is_none() {
            return true;
        }
        if !self.leader_check.hear(beacon, now) {
            return false;
        }
        if self.leader_check.has_moved(beacon, now) {
            self.poll_voters(now);
        }
        true
    }

    fn poll_voters(&mut self, now: NodeTime) {
        let RobotState { leader_check, settings, .. } = self;
        let poll = settings.links.knowledge.read(|base| {
            leader_check.begin_poll(now, |node| base.get(node).is_some_and(|known| known.record.knowledge.may_vote))
        });
        let Some(poll) = poll else { return };
        let (bus, keys) = (self.settings.links.bus.clone(), self.settings.links.keys.clone());
        let to = self.myself.clone();
        self.tasks.spawn(async move {
            // A stopped robot needs no result.
            let _ = to.cast(RobotMessage::LeaderPolled(poll.run(&bus, &keys).await));
        });
    }

    pub(super) async fn handle_leader_poll(&mut self, poll: LeaderPoll) -> Result<(), ActorProcessingErr> {
        let now = self.now();
        let change = self.leader_check.end_poll(&poll, now);
        if change.other_cluster {
            self.change_cluster(now);
        } else if change.new_session {
            self.orders.change_session();
        }
        if let Some(node) = self.lease.coordinator().filter(|node| poll.is_impostor(node)).cloned() {
            warn!(robot = %self.settings.robot, %node, "it claims to coordinate, and no voter follows it");
            self.lease.distrust(node, now);
        }
        for UnconfirmedNotice { author, notice, query } in std::mem::take(&mut self.unconfirmed_notices) {
            let standing = self.leader_check.standing_after(&poll, &author, notice.position(), now);
            match notice {
                AwardNotice::Orders(orders) if standing != Standing::Confirmed => {
                    self.follow_orders_of(standing, *orders, now);
                    self.refuse_notice(query);
                }
                AwardNotice::Leased { .. } if standing != Standing::Confirmed => self.refuse_notice(query),
                notice if standing != Standing::Refuted => self.perform_notice(query, notice).await?,
                _ => self.refuse_notice(query),
            }
        }
        self.perform_actions(vec![]).await?;
        let Some(report) = self.unconfirmed_reply.take() else { return Ok(()) };
        let standing = self.leader_check.standing_after(&poll, &report.recipient, report.position(), now);
        self.end_report(report, standing).await
    }

    /// Counts the positions in the ledger anew: the robot follows the coordinator of another cluster.
    pub(super) fn change_cluster(&mut self, now: NodeTime) {
        self.orders.change_cluster(now);
        self.charging.iter_mut().for_each(ChargeControl::change_cluster);
        self.devices.iter_mut().for_each(DeviceAccess::change_cluster);
        self.publish_claims();
    }

    /// Follows the orders of people: a held robot stops its task, and starts it again when the hold ends.
    pub(super) fn follow_orders(&mut self, orders: OrdersNotice, now: NodeTime) {
        self.orders.receive(orders, now);
        self.update_map_orders(now);
        self.stop_if_held(now);
    }

    /// Follows what keeps the robot from moving, for a node that may be the coordinator.
    fn follow_for_now(&mut self, orders: &OrdersNotice, now: NodeTime) {
        self.orders.receive_unconfirmed(orders, self.settings.lease_terms.lease, now);
        self.update_map_orders(now);
        self.stop_if_held(now);
    }

    fn stop_if_held(&mut self, now: NodeTime) {
        if !self.orders.is_held(now) {
            return;
        }
        if let Some(active) = self.execution.plan.as_mut().filter(|active| active.attempt.is_some()) {
            active.suspend();
            info!(robot = %self.settings.robot, mission = %active.award.mission, "held: suspended");
        }
    }

    fn refuse_notice(&mut self, query: Query) {
        let reason = format!("{} is not the coordinator of {}", query.author, self.settings.robot);
        reply::refuse_in(&mut self.tasks, query, reason);
    }
}

/// Returns the node with a verified signature.
fn node_of(author: &Author) -> Option<NodeId> {
    author.name()?.parse().ok()
}
