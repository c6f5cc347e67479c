//! The state of the model, and the effects of its actions.

use super::flaw::Flaw;
use super::robot::{ReportInFlight, Robot, server_time, useless_from};
use super::{FIRST_TICK, REACTION, SLOW_CANCEL, clock, ticks};
use crate::coordinator::model_session::ModelSession;
use crate::robot_driver::model_driver::start_command;
use consort_protocol::auction::{AuctionId, AuctionRecord};
use consort_protocol::ids::{MissionId, RequestId, RobotId, RoleId};
use consort_protocol::lease::{Action as LeaseAction, Award, Epoch, Event, LeaseTerms, RoleLease, stop_lead};
use consort_protocol::ledger::{Branch, Command, CommandOutcome, Ledger, RoleEntry, Submission};
use consort_protocol::message::{Report, ReportReply};
use consort_protocol::mission::{Format, MissionTemplate};
use consort_protocol::plan::{LocalPlan, divide_and_check};
use consort_protocol::units::NodeTime;
use consort_skills::domain::hospital;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

const MISSION: &str = r#"{"mission": "m", "roles": {"r": {"kind": "managed"}},
  "root": {"task": "t", "type": "wait", "roles": ["r"], "parameters": {"seconds": "1"}}}"#;

/// What stays the same in all states.
#[derive(Debug)]
pub(super) struct Setup {
    pub(super) terms: LeaseTerms,
    pub(super) flaw: Option<Flaw>,
    /// Goals stop slowly: the body needs [`SLOW_CANCEL`].
    is_slow: bool,
    robots: [RobotId; 2],
    mission: MissionId,
    role: RoleId,
    plan: LocalPlan,
}

/// A state of the model.
#[derive(Debug, Clone)]
pub(super) struct World {
    setup: Arc<Setup>,
    pub(super) tick: u64,
    term: u64,
    /// The committed ledger.
    ledger: Arc<Ledger>,
    /// All awards so far.
    pub(super) awards: Vec<Awarded>,
    pub(super) leader: usize,
    /// Session of each coordinator; that of a deposed coordinator until it can no longer reply.
    pub(super) sessions: [Option<Arc<ModelSession>>; 2],
    pub(super) deposed_at: u64,
    /// Release that the leader has decided and not committed yet.
    pub(super) release: Option<Epoch>,
    pub(super) robots: [Robot; 2],
    pub(super) left: Faults,
}

/// Faults that are still possible.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Faults {
    /// Restarts of robots' nodes.
    pub(super) crashes: u8,
    /// Suspensions of robots' machines.
    pub(super) suspensions: u8,
    /// Takeovers; [`NO_LIMIT`] stays.
    pub(super) takeovers: u8,
}

/// No limit of takeovers.
pub(super) const NO_LIMIT: u8 = u8::MAX;

/// An award.
#[derive(Debug, Clone, Copy)]
pub(super) struct Awarded {
    pub(super) robot: usize,
    pub(super) epoch: Epoch,
    at: u64,
}

/// Clock of a coordinator, different from those of other nodes.
const COORDINATOR_CLOCK: u64 = 700_000;

/// A coordinator checks leases just after a tick.
const MOMENT: Duration = Duration::from_millis(1);

fn index(position: usize) -> u64 {
    2 + position as u64
}

impl Setup {
    /// Creates the setup and its ledger with a mission.
    pub(super) fn new(flaw: Option<Flaw>, is_slow: bool) -> (Setup, Ledger) {
        let template = MissionTemplate::parse(MISSION, Format::Json).expect("a mission");
        let (mission, _) = template.instantiate_with_recovery(&BTreeMap::new(), &hospital()).expect("parameters");
        let division = divide_and_check(&mission).expect("a division");
        let role: RoleId = "r".parse().expect("a role");
        let plan = division.plans[&role].clone();
        let mut ledger = Ledger::default();
        let submission = Submission::of(RequestId::new("q").expect("a request"), mission, division);
        ledger.apply(Epoch { term: 1, index: 1 }, Command::Submit(Box::new(submission)));
        let mission = ledger.missions().next().expect("a mission").id.clone();
        let robots = ["ada", "bob"].map(|name| name.parse().expect("a robot"));
        (Setup { terms: LeaseTerms::default(), flaw, is_slow, robots, mission, role, plan }, ledger)
    }

    fn has(&self, flaw: Flaw) -> bool {
        self.flaw == Some(flaw)
    }

    /// Returns the time from the cancel of a goal until its body is at rest, as the driver client knows it.
    fn cancel_within(&self) -> Duration {
        if self.is_slow && !self.has(Flaw::NoStopLead) { SLOW_CANCEL } else { Duration::ZERO }
    }

    /// Returns the ticks from the end of a permission until the body is at rest.
    fn reaction(&self) -> u64 {
        REACTION + u64::from(self.is_slow) + u64::from(self.has(Flaw::SlowBody))
    }

    fn coordinator_terms(&self) -> LeaseTerms {
        if self.has(Flaw::NoGrace) { LeaseTerms { grace: Duration::ZERO, ..self.terms } } else { self.terms }
    }
}

impl World {
    pub(super) fn new(setup: Setup, ledger: Ledger, left: Faults) -> World {
        let (setup, ledger) = (Arc::new(setup), Arc::new(ledger));
        let started =
            ModelSession::start(setup.coordinator_terms(), Arc::clone(&ledger), clock(COORDINATOR_CLOCK, FIRST_TICK));
        World {
            tick: FIRST_TICK,
            term: 1,
            ledger,
            awards: vec![],
            leader: 0,
            sessions: [Some(Arc::new(started)), None],
            deposed_at: 0,
            release: None,
            robots: [0, 1].map(|robot| Robot::new(&setup.robots[robot], setup.terms)),
            left,
            setup,
        }
    }

    pub(super) fn acting(&self) -> [bool; 2] {
        [0, 1].map(|robot: usize| self.robots[robot].acts(self.tick))
    }

    /// Checks whether the clocks of robots count the suspension of their machines.
    pub(super) fn counts_suspension(&self) -> bool {
        !self.setup.has(Flaw::ClockStopsInSuspension)
    }

    /// Checks whether a command has an effect after the end of its permission.
    pub(super) fn permits_late_commands(&self) -> bool {
        self.setup.has(Flaw::DriverIgnoresPermission) || self.setup.has(Flaw::PermissionCountsFromArrival)
    }

    /// Returns the time of a coordinator's clock.
    pub(super) fn coordinator_time(&self, node: usize) -> NodeTime {
        clock(COORDINATOR_CLOCK * (node as u64 + 1), self.tick)
    }

    /// Returns the role in a ledger.
    pub(super) fn role<'a>(&self, ledger: &'a Ledger) -> &'a RoleEntry {
        &ledger.mission(&self.setup.mission).expect("the mission stays active").roles[&self.setup.role]
    }

    /// Returns the award as its robot receives it.
    pub(super) fn notice(&self, awarded: &Awarded) -> Award {
        let Setup { robots, mission, role, plan, .. } = &*self.setup;
        Award {
            mission: mission.clone(),
            role: role.clone(),
            robot: robots[awarded.robot].clone(),
            epoch: awarded.epoch,
            plan: plan.clone(),
            holders: BTreeMap::new(),
        }
    }

    pub(super) fn advance_time(&mut self) {
        self.tick += 1;
        let (tick, reaction, counts) = (self.tick, self.setup.reaction(), self.counts_suspension());
        for robot in &mut self.robots {
            robot.tick(tick, reaction);
            if counts {
                robot.node.uncounted = 0;
            }
        }
        self.forget_useless();
    }

    /// Drops messages and sessions that can have no effect any more.
    fn forget_useless(&mut self) {
        let (tick, terms, late) = (self.tick, self.setup.terms, self.permits_late_commands());
        for robot in &mut self.robots {
            robot.command.take_if(|command| !late && useless_from(command) <= tick);
            let node = &robot.node;
            robot.report.take_if(|report| report.is_useless(node, terms, tick));
        }
        let age = ticks(self.tick - self.deposed_at);
        if age > terms.leadership_age_max() && !self.setup.has(Flaw::DeposedReplies) {
            self.sessions[1 - self.leader] = None;
        }
    }

    /// The other node becomes leader. Until then, the deposed leader had contact with a majority.
    pub(super) fn take_over(&mut self) {
        let since = match self.awards.last().filter(|_| self.setup.has(Flaw::TakeoverKeepsContacts)) {
            Some(award) => award.at,
            None => self.tick,
        };
        if self.left.takeovers != NO_LIMIT {
            self.left.takeovers -= 1;
        }
        self.leader = 1 - self.leader;
        let started = clock(COORDINATOR_CLOCK * (self.leader as u64 + 1), since);
        let session = ModelSession::start(self.setup.coordinator_terms(), Arc::clone(&self.ledger), started);
        self.sessions[self.leader] = Some(Arc::new(session));
        self.term += 1;
        (self.deposed_at, self.release) = (self.tick, None);
    }

    /// Applies a command to the committed ledger and to the leader's copy.
    fn commit(&mut self, command: Command, epoch: Epoch) -> CommandOutcome {
        let outcome = Arc::make_mut(&mut self.ledger).apply(epoch, command);
        let (ledger, now) = (Arc::clone(&self.ledger), self.coordinator_time(self.leader));
        if let Some(session) = &mut self.sessions[self.leader] {
            Arc::make_mut(session).apply(ledger, now);
        }
        outcome
    }

    /// The leader computes its pending actions. Returns false if there are none.
    pub(super) fn reconcile(&mut self) -> bool {
        let now = self.coordinator_time(self.leader) + MOMENT;
        let keeps_renewing = self.setup.has(Flaw::RenewsDuringRelease);
        let Some(session) = &mut self.sessions[self.leader] else { return false };
        self.release = Arc::make_mut(session).release_expired(keeps_renewing, now).first().copied();
        self.release.is_some()
    }

    pub(super) fn commit_release(&mut self) {
        if let Some(epoch) = self.release.take() {
            self.release_role(epoch);
        }
    }

    fn release_role(&mut self, epoch: Epoch) {
        let (mission, role) = (self.setup.mission.clone(), self.setup.role.clone());
        let release = Command::Release {
            mission,
            role,
            epoch,
            cause: String::new(),
            class: None,
            moved_nothing: false,
            place: None,
            gave_way: false,
        };
        self.commit(release, epoch);
    }

    /// Checks whether the leader would call for bids.
    pub(super) fn is_auction_due(&self) -> bool {
        let now = self.coordinator_time(self.leader);
        self.sessions[self.leader].as_ref().is_some_and(|session| session.is_auction_due(now))
    }

    pub(super) fn award(&mut self, robot: usize) {
        let epoch = Epoch { term: self.term, index: index(self.awards.len()) };
        let (mission, role) = (self.setup.mission.clone(), self.setup.role.clone());
        let auction = AuctionId { mission: mission.clone(), term: self.term, round: 1 };
        let auction = AuctionRecord::empty(auction);
        let holders = BTreeMap::from([(role, self.setup.robots[robot].clone())]);
        self.awards.push(Awarded { robot, epoch, at: self.tick });
        let outcome = self.commit(Command::Award { mission, branch: Branch::Main, holders, auction }, epoch);
        assert_eq!(outcome, CommandOutcome::Awarded { epoch });
        self.update_answers(robot);
    }

    /// The node of a robot handles an event of its lease, and reports if that results.
    pub(super) fn handle(&mut self, robot: usize, event: Event) -> Vec<LeaseAction> {
        let lead = stop_lead(self.setup.cancel_within());
        let actions = self.robots[robot].node.handle(event, self.tick, lead);
        self.update_answers(robot);
        if actions.contains(&LeaseAction::Report) {
            self.report(robot);
        }
        actions
    }

    /// Checks whether a robot's node can send a report: it has none in flight.
    pub(super) fn can_report(&self, robot: usize) -> bool {
        let Robot { node, report, .. } = &self.robots[robot];
        node.lease.award().is_some() && report.as_ref().is_none_or(|report| report.incarnation != node.incarnation)
    }

    pub(super) fn report(&mut self, robot: usize) {
        if !self.can_report(robot) {
            return;
        }
        let node = &self.robots[robot].node;
        let Some(epoch) = node.lease.award().map(|award| award.epoch) else { return };
        let (from_checkpoint, sent) = (node.resumed == Some(epoch), node.now(self.tick));
        let incarnation = node.incarnation;
        self.robots[robot].report = Some(ReportInFlight { epoch, incarnation, from_checkpoint, sent, reply: None });
    }

    /// A coordinator receives the report of a robot. Its reply is on the way, unless it is none.
    pub(super) fn deliver(&mut self, robot: usize, node: usize) {
        let Some(mut flight) = self.robots[robot].report.take() else { return };
        let Setup { robots, mission, role, .. } = &*self.setup;
        let report = Report {
            robot: robots[robot].clone(),
            incarnation: flight.incarnation,
            mission: mission.clone(),
            role: role.clone(),
            epoch: flight.epoch,
            ended: BTreeSet::new(),
            outcomes: BTreeMap::new(),
            current_task: None,
            place: None,
            from_checkpoint: flight.from_checkpoint,
            failure: None,
            question: None,
        };
        let reply = self.reply(&report, node);
        let reaches = flight.incarnation == self.robots[robot].node.incarnation;
        flight.reply = reply.filter(|reply| reaches && !matches!(reply, ReportReply::NotCoordinator { .. }));
        self.robots[robot].report = Some(flight).filter(|flight| flight.reply.is_some());
        self.forget_useless();
    }

    fn reply(&mut self, report: &Report, node: usize) -> Option<ReportReply> {
        let now = self.coordinator_time(node);
        let reply = loop {
            let command = match self.sessions[node].as_ref()?.next_step(report) {
                Ok(reply) => break reply,
                Err(_) if node != self.leader => return None, // a deposed leader commits nothing
                Err(command) => *command,
            };
            let outcome = self.commit(command, report.epoch);
            if let Some(reply) = ModelSession::reply_to_refusal(&outcome, report) {
                if self.setup.has(Flaw::RestartReleases) {
                    self.release_role(report.epoch);
                }
                break reply;
            }
            if matches!(outcome, CommandOutcome::Refused(_)) {
                return None; // production repeats this and then does not reply
            }
        };
        let is_taken_for_leader = node == self.leader || self.setup.has(Flaw::DeposedReplies);
        let age = if is_taken_for_leader { Duration::ZERO } else { ticks(self.tick - self.deposed_at) };
        let session = Arc::make_mut(self.sessions[node].as_mut()?);
        Some(session.confirm(reply, report, age, now))
    }

    /// The node of a robot receives the reply to its report.
    pub(super) fn receive_reply(&mut self, robot: usize) -> Vec<LeaseAction> {
        let Some(flight) = self.robots[robot].report.take() else { return vec![] };
        let from_reply = self.setup.has(Flaw::LeaseCountsFromReply);
        let sent = if from_reply { self.robots[robot].node.now(self.tick) } else { flight.sent };
        match flight.reply {
            Some(ReportReply::Renewed { epoch, ended, .. }) => {
                self.handle(robot, Event::Renewed { epoch, sent, ended })
            }
            Some(ReportReply::Ended { epoch, reason, .. }) => self.handle(robot, Event::Revoked { epoch, reason }),
            Some(ReportReply::NotCoordinator { .. }) | None => vec![],
        }
    }

    /// The node of a robot sends a command to its driver server, `late` ticks after it has received a
    /// state that was `late` ticks on the way.
    pub(super) fn send_command(&mut self, robot: usize, late: u64) {
        let tick = self.tick;
        let (setup, id, robot) = (&self.setup, &self.setup.robots[robot], &mut self.robots[robot]);
        if robot.is_cut() || robot.node.goal.is_none() {
            robot.node.goal = Some(robot.node.next_goal);
            robot.node.next_goal += 1;
        }
        let (goal, now) = (robot.node.goal.unwrap_or_default(), robot.node.now(tick));
        let goal = (goal, setup.cancel_within());
        let received = NodeTime::at(now.since(NodeTime::ZERO) - ticks(late));
        let command = start_command(id, goal, (tick - 2 * late, received), robot.node.lease.acts_until(), now);
        robot.command = Some(command).filter(|command| command.request.is_some());
        self.forget_useless();
    }

    /// A driver server receives the latest command; it may arrive again.
    pub(super) fn deliver_command(&mut self, robot: usize) {
        let (tick, setup) = (self.tick, Arc::clone(&self.setup));
        let robot = &mut self.robots[robot];
        let Some(mut command) = robot.command.clone() else { return };
        if setup.has(Flaw::DriverIgnoresPermission) {
            command.permit.keep_for_ms = 3_600_000;
        }
        if setup.has(Flaw::PermissionCountsFromArrival) {
            command.permit.state.sequence = tick;
        }
        Arc::make_mut(&mut robot.server).receive(command, server_time(tick));
    }

    /// The node of a robot crashes and restarts. A report on its way is not lost by that.
    pub(super) fn crash(&mut self, robot: usize, finds_checkpoint: bool) {
        let (id, terms) = (self.setup.robots[robot].clone(), self.setup.terms);
        self.left.crashes -= 1;
        let state = &mut self.robots[robot];
        state.node.restart(&id, terms, finds_checkpoint);
        state.report.take_if(|report| report.reply.is_some());
        self.update_answers(robot);
    }

    /// Computes whether a robot would report after the notice of each award: the latest epoch that it
    /// has received decides.
    fn update_answers(&mut self, robot: usize) {
        let node = &self.robots[robot].node;
        let reports = |awarded: &Awarded| {
            let event = Event::AwardReceived(Box::new(self.notice(awarded)));
            awarded.robot == robot && !RoleLease::clone(&node.lease).handle(event, node.now(self.tick)).is_empty()
        };
        let bits = self.awards.iter().enumerate().map(|(number, awarded)| u8::from(reports(awarded)) << number);
        let answers = bits.sum();
        self.robots[robot].node.answers = answers;
    }
}
