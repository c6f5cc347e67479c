//! A robot of the model: its node, its messages in flight, its driver server and its body.

use super::{FIRST_TICK, clock, ticks};
use crate::robot_driver::DriverCommand;
use crate::robot_driver::model_driver::{GoalPhase, ModelServer};
use consort_protocol::ids::RobotId;
use consort_protocol::lease::Action as LeaseAction;
use consort_protocol::lease::{Award, Epoch, Event, LeaseTerms, RoleLease};
use consort_protocol::message::ReportReply;
use consort_protocol::units::NodeTime;
use std::sync::Arc;
use std::time::Duration;

/// A robot.
#[derive(Debug, Clone)]
pub(super) struct Robot {
    pub(super) node: Node,
    /// The report in flight, or its reply.
    pub(super) report: Option<ReportInFlight>,
    /// The latest command to the driver server. It arrives any number of times.
    pub(super) command: Option<DriverCommand>,
    pub(super) server: Arc<ModelServer>,
    /// Tick at which the body is at rest, after its permission has ended.
    pub(super) rest_at: u64,
}

/// The node of a robot.
#[derive(Debug, Clone)]
pub(super) struct Node {
    pub(super) lease: Arc<RoleLease>,
    pub(super) incarnation: u64,
    /// Tick at which the award was received.
    pub(super) received_at: u64,
    /// Award in the checkpoint.
    pub(super) checkpoint: Option<Arc<Award>>,
    /// Award that was restored from the checkpoint.
    pub(super) resumed: Option<Epoch>,
    /// Bit for each award: the robot reports when it receives the notice.
    pub(super) answers: u8,
    /// The goal that the node supervises.
    pub(super) goal: Option<u64>,
    pub(super) next_goal: u64,
    /// The machine is suspended.
    pub(super) asleep: bool,
    /// Ticks that the node's clock has not counted; only with a flaw.
    pub(super) uncounted: u64,
}

/// A report on its way to a coordinator, or the reply on its way back.
#[derive(Debug, Clone)]
pub(super) struct ReportInFlight {
    pub(super) epoch: Epoch,
    pub(super) incarnation: u64,
    pub(super) from_checkpoint: bool,
    /// Time of sending, by the robot's clock.
    pub(super) sent: NodeTime,
    pub(super) reply: Option<ReportReply>,
}

/// Start of the clock of a driver server, different from those of other nodes.
const SERVER_CLOCK: u64 = 50_000;

/// Start of the clock of a robot's node.
const NODE_CLOCK: u64 = 3_000;

impl Robot {
    pub(super) fn new(robot: &RobotId, terms: LeaseTerms) -> Robot {
        let mut server = ModelServer::new(robot.clone(), server_time(0));
        for tick in 0..=FIRST_TICK {
            server.tick(tick, server_time(tick));
        }
        let node = Node {
            lease: Arc::new(RoleLease::new(robot.clone(), terms)),
            incarnation: 1,
            received_at: 0,
            checkpoint: None,
            resumed: None,
            answers: 0,
            goal: None,
            next_goal: 1,
            asleep: false,
            uncounted: 0,
        };
        Robot { node, report: None, command: None, server: Arc::new(server), rest_at: 0 }
    }

    /// Checks whether the body may act or move.
    pub(super) fn acts(&self, tick: u64) -> bool {
        self.server.acts_until().is_some_and(|until| until > server_time(tick)) || self.rest_at > tick
    }

    /// Advances the driver server to a tick. The body comes to rest `reaction` after a stop.
    pub(super) fn tick(&mut self, tick: u64, reaction: u64) {
        if Arc::make_mut(&mut self.server).tick(tick, server_time(tick)) {
            self.rest_at = tick + reaction;
        }
        if self.node.asleep {
            self.node.uncounted += 1;
        }
    }

    /// Checks whether the driver server has stopped the goal that the node supervises. Goals have no other
    /// end in the model.
    pub(super) fn is_cut(&self) -> bool {
        self.node.goal.is_some_and(|goal| self.goal_phase(goal) == GoalPhase::Ended)
    }

    /// Returns the phase of a goal at the driver server.
    pub(super) fn goal_phase(&self, goal: u64) -> GoalPhase {
        self.server.phase(goal)
    }
}

impl Node {
    /// Returns the time of the node's clock.
    pub(super) fn now(&self, tick: u64) -> NodeTime {
        clock(NODE_CLOCK, tick - self.uncounted)
    }

    /// Handles an event of the lease and performs the resulting actions. Returns them. While the node
    /// supervises a goal, it checks its lease ahead by the `lead` of the goal, like the actor.
    pub(super) fn handle(&mut self, event: Event, tick: u64, lead: Duration) -> Vec<LeaseAction> {
        let (now, held) = (self.now(tick), self.lease.award().map(|award| award.epoch));
        let checks_ahead = matches!(event, Event::Tick) && self.goal.is_some() && self.lease.acts_until().is_some();
        let ahead = if checks_ahead { lead } else { Duration::ZERO };
        let actions = Arc::make_mut(&mut self.lease).handle(event, now + ahead);
        if self.lease.award().map(|award| award.epoch) != held {
            self.received_at = tick;
        }
        for action in &actions {
            match action {
                LeaseAction::Start(award, _) => self.checkpoint = Some(Arc::new((**award).clone())),
                LeaseAction::Suspend { .. } | LeaseAction::Halt(_) => self.goal = None,
                LeaseAction::Report | LeaseAction::Resume => {}
            }
        }
        actions
    }

    /// Restarts the node, with or without its checkpoint.
    pub(super) fn restart(&mut self, robot: &RobotId, terms: LeaseTerms, finds_checkpoint: bool) {
        let restored = self.checkpoint.take_if(|_| finds_checkpoint);
        let lease = match &restored {
            Some(award) => RoleLease::restore(robot.clone(), terms, (**award).clone()),
            None => RoleLease::new(robot.clone(), terms),
        };
        *self = Node {
            lease: Arc::new(lease),
            incarnation: self.incarnation + 1,
            received_at: 0,
            resumed: restored.as_ref().map(|award| award.epoch),
            checkpoint: restored,
            answers: 0,
            goal: None,
            next_goal: self.next_goal,
            asleep: false,
            uncounted: self.uncounted,
        };
    }
}

/// Returns the time of a driver server's clock.
pub(super) fn server_time(tick: u64) -> NodeTime {
    clock(SERVER_CLOCK, tick)
}

/// Returns the tick at which a command no longer has an effect.
pub(super) fn useless_from(command: &DriverCommand) -> u64 {
    let stop = server_time(command.permit.state.sequence) + Duration::from_millis(command.permit.keep_for_ms);
    stop.since(server_time(0)).as_secs_f64().ceil() as u64
}

impl ReportInFlight {
    /// Checks whether a reply has come too late to renew the lease.
    pub(super) fn is_useless(&self, node: &Node, terms: LeaseTerms, tick: u64) -> bool {
        let renews = matches!(self.reply, Some(ReportReply::Renewed { .. }));
        renews && self.sent + terms.lease <= node.now(tick)
    }

    /// Returns the ticks since the report was sent, at most `max`.
    pub(super) fn age(&self, node: &Node, tick: u64, max: u64) -> u64 {
        node.now(tick).since(self.sent).min(ticks(max)).as_secs()
    }
}
