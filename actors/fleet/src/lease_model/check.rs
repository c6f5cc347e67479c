//! The model as a state space, its properties, and the checks.

use super::flaw::Flaw;
use super::world::{Faults, NO_LIMIT, Setup, World};
use consort_protocol::lease::{Action as LeaseAction, Event};
use stateright::{Checker, HasDiscoveries, Model, Property};
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Model of two robots, a role and two coordinators.
struct LeaseModel {
    flaw: Option<Flaw>,
    bounds: Bounds,
    /// Number of transitions by which a lease was resumed after it had been suspended.
    resumed: AtomicUsize,
}

/// Bounds of the state space. Time, losses, delays and repetitions are not bounded.
#[derive(Debug, Clone, Copy)]
struct Bounds {
    /// Number of awards of the role, each to the other robot.
    awards: usize,
    /// Ticks by which states of driver servers may be late.
    late: u64,
    /// Goals stop slowly.
    is_slow: bool,
    /// Only the events of the first robot are explored. The second counts as acting from its award on.
    first_only: bool,
    faults: Faults,
}

impl Bounds {
    /// Returns the bounds of a role that passes on to the second robot, with goals that stop at once.
    fn passing_on(faults: Faults) -> Bounds {
        Bounds { awards: 2, late: 0, is_slow: false, first_only: false, faults }
    }

    /// Returns the numbers of the robots whose events are explored.
    fn robots(&self) -> Range<usize> {
        let count = if self.first_only { 1 } else { 2 };
        0..count
    }
}

/// An event. Robots and coordinators are numbered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    /// A tick passes.
    Tick,
    /// The other node becomes leader.
    TakeOver,
    /// The leader finds an expired lease.
    Reconcile,
    /// The release of an expired lease is committed.
    CommitRelease,
    /// The role is awarded to a robot.
    Award(usize),
    /// The notice of an award arrives, for the first time or again.
    Notice(usize),
    /// The node of a robot checks its lease.
    CheckLease(usize),
    /// The node of a robot reports.
    Report(usize),
    /// The report of a robot arrives at a coordinator.
    DeliverReport(usize, usize),
    /// The report of a robot, or its reply, is lost.
    LoseReport(usize),
    /// The reply to a report arrives.
    DeliverReply(usize),
    /// The node of a robot sends a command to its driver server, after late states.
    SendCommand(usize, u64),
    /// A command arrives, for the first time or again.
    DeliverCommand(usize),
    /// The node of the first holder restarts, with or without its checkpoint.
    Crash(usize, bool),
    /// The machine of the first holder's node is suspended.
    Suspend(usize),
    /// The machine of a robot's node continues.
    Wake(usize),
}

/// The property of leases.
const ONE_BODY: &str = "at most one body acts in the role";

/// A stronger property: the body of the former holder is at rest at the award to the other robot, and stays so,
/// whatever the other robot does.
const FORMER_RESTS: &str = "the body of the former holder rests once the role is awarded to the other robot";

// Situations that must be possible, so that the model is not empty.
const FIRST_ACTS: &str = "the first robot acts";
const PASSES_ON: &str = "the role passes on to the second robot, which acts";
const ACTS_ASLEEP: &str = "a body acts while its node is suspended";
const RESTORED_ACTS: &str = "a restored robot acts again";
const DEPOSED_REPLIES: &str = "a reply is on its way while a deposed coordinator still replies";
const LATER_RELEASES: &str = "a later coordinator releases the role";
const CUT_IN_LEASE: &str = "the driver server stops the goal of a silent node within its lease";
const CUT_ASLEEP: &str = "the driver server has stopped the goal of a suspended node whose lease has run out";
const AWARDED_ASLEEP: &str = "the role is awarded to the second robot while the first robot's node is suspended";
const PASSES_ON_ASLEEP: &str = "the second robot acts while the first robot's node is suspended";
const WAKES_LATE: &str = "the second robot acts, and the first robot's node wakes and has not checked its lease";

impl Model for LeaseModel {
    type State = World;
    type Action = Step;

    fn init_states(&self) -> Vec<World> {
        let (setup, ledger) = Setup::new(self.flaw, self.bounds.is_slow);
        vec![World::new(setup, ledger, self.bounds.faults)]
    }

    fn actions(&self, world: &World, steps: &mut Vec<Step>) {
        steps.push(Step::Tick);
        if world.left.takeovers > 0 {
            steps.push(Step::TakeOver);
        }
        match world.release {
            Some(_) => steps.push(Step::CommitRelease),
            None => steps.push(Step::Reconcile),
        }
        if world.awards.len() < self.bounds.awards && world.is_auction_due() {
            // The robots are alike, so the first award is to the first robot.
            steps.push(Step::Award(world.awards.len() % 2));
        }
        let receives = |robot: usize| self.bounds.robots().contains(&robot) && !world.robots[robot].node.asleep;
        let notices = world.awards.iter().enumerate().filter(|(_, award)| receives(award.robot));
        steps.extend(notices.map(|(number, _)| Step::Notice(number)));
        for robot in self.bounds.robots() {
            self.robot_steps(world, robot, steps);
        }
    }

    fn next_state(&self, world: &World, step: Step) -> Option<World> {
        let mut next = world.clone();
        match step {
            Step::Tick => next.advance_time(),
            Step::TakeOver => next.take_over(),
            Step::Reconcile => next.reconcile().then_some(())?,
            Step::CommitRelease => next.commit_release(),
            Step::Award(robot) => next.award(robot),
            Step::Notice(number) => {
                let award = world.awards[number];
                let actions = next.handle(award.robot, Event::AwardReceived(Box::new(world.notice(&award))));
                (!actions.is_empty()).then_some(())?;
            }
            Step::CheckLease(robot) => {
                let actions = next.handle(robot, Event::Tick);
                (!actions.is_empty() || next.robots[robot].node.lease.award().is_none()).then_some(())?;
            }
            Step::Report(robot) => next.report(robot),
            Step::DeliverReport(robot, node) => next.deliver(robot, node),
            Step::LoseReport(robot) => next.robots[robot].report = None,
            Step::DeliverReply(robot) => {
                let actions = next.receive_reply(robot);
                self.resumed.fetch_add(usize::from(actions.contains(&LeaseAction::Resume)), Ordering::Relaxed);
            }
            Step::SendCommand(robot, late) => next.send_command(robot, late),
            Step::DeliverCommand(robot) => next.deliver_command(robot),
            Step::Crash(robot, finds_checkpoint) => next.crash(robot, finds_checkpoint),
            Step::Suspend(robot) => {
                next.left.suspensions -= 1;
                next.robots[robot].node.asleep = true;
            }
            Step::Wake(robot) => next.robots[robot].node.asleep = false,
        }
        Some(next)
    }

    fn properties(&self) -> Vec<Property<LeaseModel>> {
        vec![
            Property::always(ONE_BODY, |_, world: &World| world.acting() != [true, true]),
            Property::always(FORMER_RESTS, |_, world: &World| {
                world.awards.last().is_none_or(|award| !world.acting()[1 - award.robot])
            }),
            Property::sometimes(FIRST_ACTS, |_, world: &World| world.acting()[0]),
            Property::sometimes(PASSES_ON, |_, world: &World| world.acting()[1]),
            Property::sometimes(ACTS_ASLEEP, |_, world: &World| world.acting()[0] && world.robots[0].node.asleep),
            Property::sometimes(RESTORED_ACTS, |_, world: &World| {
                let node = &world.robots[0].node;
                node.resumed.is_some() && node.goal.is_some() && world.acting()[0]
            }),
            Property::sometimes(DEPOSED_REPLIES, |_, world: &World| {
                let replied = world.robots[0].report.as_ref().is_some_and(|report| report.reply.is_some());
                world.sessions[1 - world.leader].is_some() && replied
            }),
            Property::sometimes(LATER_RELEASES, |_, world: &World| world.leader == 1 && world.release.is_some()),
            Property::sometimes(CUT_IN_LEASE, |_, world: &World| {
                let node = &world.robots[0].node;
                world.robots[0].is_cut() && node.lease.may_act(node.now(world.tick))
            }),
            Property::sometimes(CUT_ASLEEP, |_, world: &World| {
                let node = &world.robots[0].node;
                world.robots[0].is_cut() && node.asleep && !node.lease.may_act(node.now(world.tick))
            }),
            Property::sometimes(AWARDED_ASLEEP, |_, world: &World| {
                world.robots[0].node.asleep && world.awards.last().is_some_and(|award| award.robot == 1)
            }),
            Property::sometimes(PASSES_ON_ASLEEP, |_, world: &World| world.robots[0].node.asleep && world.acting()[1]),
            Property::sometimes(WAKES_LATE, |_, world: &World| {
                let node = &world.robots[0].node;
                let has_woken = world.left.suspensions == 0 && !node.asleep;
                has_woken && node.lease.acts_until().is_some() && world.acting()[1]
            }),
        ]
    }
}

impl LeaseModel {
    fn new(flaw: Option<Flaw>, bounds: Bounds) -> LeaseModel {
        LeaseModel { flaw, bounds, resumed: AtomicUsize::new(0) }
    }

    /// Adds the events of a robot.
    fn robot_steps(&self, world: &World, robot: usize, steps: &mut Vec<Step>) {
        let (state, node) = (&world.robots[robot], &world.robots[robot].node);
        let now = node.now(world.tick);
        if let Some(report) = &state.report {
            let is_here = report.incarnation == node.incarnation;
            if report.reply.is_none() {
                let nodes = (0..2).filter(|node| world.sessions[*node].is_some());
                steps.extend(nodes.map(|node| Step::DeliverReport(robot, node)));
            } else if is_here && !node.asleep {
                steps.push(Step::DeliverReply(robot));
            }
            steps.push(Step::LoseReport(robot));
        }
        if state.command.is_some() {
            steps.push(Step::DeliverCommand(robot));
        }
        if world.left.crashes > 0 && robot == 0 && !world.awards.is_empty() {
            steps.push(Step::Crash(robot, false));
            if node.checkpoint.is_some() {
                steps.push(Step::Crash(robot, true));
            }
        }
        if node.asleep {
            return steps.push(Step::Wake(robot));
        }
        if node.lease.award().is_some() {
            steps.push(Step::CheckLease(robot));
            if world.left.suspensions > 0 && robot == 0 && node.lease.may_act(now) {
                steps.push(Step::Suspend(robot));
            }
        }
        if world.can_report(robot) {
            steps.push(Step::Report(robot));
        }
        if node.lease.may_act(now) {
            steps.extend((0..=self.bounds.late).map(|late| Step::SendCommand(robot, late)));
        }
    }
}

/// Explores all states. Panics if the body of a former holder acts, or if a property in `possible` never holds.
/// Returns the number of states.
fn explore(bounds: Bounds, possible: &[&str]) -> usize {
    let checker = LeaseModel::new(None, bounds).checker().threads(1).spawn_bfs().join();
    let discoveries = checker.discoveries();
    for property in [ONE_BODY, FORMER_RESTS] {
        if let Some(path) = checker.discovery(property) {
            panic!("not always: {property}; after {:?}", path.into_actions());
        }
    }
    let missing: Vec<_> = possible.iter().filter(|name| !discoveries.contains_key(*name)).collect();
    assert!(missing.is_empty(), "never reached: {missing:?}");
    assert!(checker.model().resumed.load(Ordering::Relaxed) > 0, "no lease was resumed after it had been suspended");
    checker.unique_state_count()
}

/// Checks that the model with a bug violates a property.
fn is_found(flaw: Flaw, bounds: Bounds, property: &'static str) {
    let finish = HasDiscoveries::AnyOf([property].into());
    let checker = LeaseModel::new(Some(flaw), bounds).checker().threads(1).finish_when(finish).spawn_bfs().join();
    let states = checker.unique_state_count();
    assert!(checker.discovery(property).is_some(), "{flaw:?} is not found in {states} states: {property}");
}

#[test]
fn at_most_one_body_acts_in_a_role() {
    let faults = Faults { crashes: 1, suspensions: 0, takeovers: NO_LIMIT };
    let possible = [FIRST_ACTS, PASSES_ON, RESTORED_ACTS, DEPOSED_REPLIES, LATER_RELEASES];
    assert_eq!(explore(Bounds::passing_on(faults), &possible), 1_611_078);
}

#[test]
fn at_most_one_body_acts_while_states_are_late() {
    let faults = Faults { crashes: 0, suspensions: 0, takeovers: NO_LIMIT };
    let bounds = Bounds { late: 1, ..Bounds::passing_on(faults) };
    assert_eq!(explore(bounds, &[FIRST_ACTS, PASSES_ON]), 863_075);
}

/// A million states: both robots, with a suspension, goals that stop slowly, and takeovers.
#[test]
fn the_role_of_a_suspended_robot_passes_on() {
    let faults = Faults { crashes: 0, suspensions: 1, takeovers: NO_LIMIT };
    let bounds = Bounds { is_slow: true, ..Bounds::passing_on(faults) };
    let possible = [FIRST_ACTS, ACTS_ASLEEP, CUT_IN_LEASE, CUT_ASLEEP, PASSES_ON, PASSES_ON_ASLEEP, WAKES_LATE];
    assert_eq!(explore(bounds, &possible), 999_735);
}

/// All faults together.
const ALL_FAULTS: Faults = Faults { crashes: 1, suspensions: 1, takeovers: NO_LIMIT };

/// Situations that must be possible with all faults.
const WITH_ALL_FAULTS: [&str; 7] =
    [ACTS_ASLEEP, RESTORED_ACTS, DEPOSED_REPLIES, LATER_RELEASES, CUT_IN_LEASE, CUT_ASLEEP, AWARDED_ASLEEP];

/// A quarter of a million states. The role returns to the first robot and passes on once more, so a late report, a
/// repeated notice and the checkpoint of its first award meet its second.
#[test]
fn a_former_body_rests_before_its_role_passes_on() {
    let bounds = Bounds { awards: 4, late: 1, first_only: true, ..Bounds::passing_on(ALL_FAULTS) };
    assert_eq!(explore(bounds, &WITH_ALL_FAULTS), 251_229);
}

/// A hundred thousand states.
#[test]
fn a_former_body_that_stops_slowly_rests_before_its_role_passes_on() {
    let bounds = Bounds { late: 1, is_slow: true, first_only: true, ..Bounds::passing_on(ALL_FAULTS) };
    assert_eq!(explore(bounds, &WITH_ALL_FAULTS), 92_098);
}

#[test]
fn every_injected_bug_is_found() {
    let none = Faults { crashes: 0, suspensions: 0, takeovers: 0 };
    let takeover = Faults { takeovers: 1, ..none };
    for flaw in [
        Flaw::DriverIgnoresPermission,
        Flaw::PermissionCountsFromArrival,
        Flaw::NoGrace,
        Flaw::LeaseCountsFromReply,
        Flaw::RenewsDuringRelease,
    ] {
        is_found(flaw, Bounds::passing_on(none), ONE_BODY);
    }
    for flaw in [Flaw::TakeoverKeepsContacts, Flaw::DeposedReplies, Flaw::SlowBody] {
        is_found(flaw, Bounds::passing_on(takeover), ONE_BODY);
    }
    let (suspension, crash) = (Faults { suspensions: 1, ..none }, Faults { crashes: 1, ..none });
    is_found(Flaw::ClockStopsInSuspension, Bounds::passing_on(suspension), ONE_BODY);
    is_found(Flaw::RestartReleases, Bounds::passing_on(crash), ONE_BODY);
    // The events of the first robot alone suffice.
    let first_only = |faults| Bounds { first_only: true, ..Bounds::passing_on(faults) };
    is_found(Flaw::NoStopLead, Bounds { is_slow: true, ..first_only(takeover) }, FORMER_RESTS);
    is_found(Flaw::ClockStopsInSuspension, first_only(suspension), FORMER_RESTS);
    is_found(Flaw::RestartReleases, first_only(crash), FORMER_RESTS);
    is_found(Flaw::TakeoverKeepsContacts, first_only(takeover), FORMER_RESTS);
}

/// Found by the model: the robot acts, its node restarts without its checkpoint and receives a
/// repeated award notice. Its report made the coordinator release the role at once, while the driver
/// server still acted on a command of the previous incarnation.
#[test]
fn a_restart_without_a_checkpoint_does_not_release_a_role_at_work() {
    let act = [Step::DeliverReply(0), Step::SendCommand(0, 0), Step::DeliverCommand(0)];
    let restart = [Step::Crash(0, false), Step::Notice(0), Step::DeliverReport(0, 0)];
    let run = |flaw| {
        let faults = Faults { crashes: 1, suspensions: 0, takeovers: 0 };
        let model = LeaseModel::new(flaw, Bounds::passing_on(faults));
        let mut world = model.init_states().remove(0);
        let award = [Step::Award(0), Step::Notice(0), Step::DeliverReport(0, 0)];
        for step in award.into_iter().chain(act).chain(restart) {
            world = model.next_state(&world, step).expect("a possible event");
        }
        (model, world)
    };
    let (_, released) = run(Some(Flaw::RestartReleases));
    assert!(released.acting()[0] && released.is_auction_due());
    let (model, mut world) = run(None);
    assert!(world.acting()[0] && !world.is_auction_due());
    for step in [Step::Tick; 6].into_iter().chain([Step::Reconcile, Step::CommitRelease]) {
        world = model.next_state(&world, step).expect("a possible event");
    }
    assert!(!world.acting()[0] && world.is_auction_due(), "released after the lease");
}
