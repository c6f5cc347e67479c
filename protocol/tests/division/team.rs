//! Robots that perform any permitted step, and a search over all states that they can reach.
//!
//! Elementary tasks are named `t0`, `t1`, … in the order of the file. The tests of the shipped
//! missions include this file, too.

use consort_protocol::ids::{RoleId, TaskId};
use consort_protocol::mission::TaskSpec;
use consort_protocol::plan::{Division, ItemMove, PlanProgress, Signal, StepAction, StepIndex};
use std::collections::{BTreeSet, HashSet};

/// Returns the number of a task named `t0`, `t1`, ….
pub(crate) fn number(id: &TaskId) -> usize {
    id.as_str()[1..].parse().unwrap()
}

/// Event that can happen next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Event<'d> {
    /// The robot performs a step; a task only begins.
    Perform(usize, StepIndex),
    /// The robot ends its current task.
    Finish(usize),
    /// The robot receives a signal that was sent.
    Receive(usize, &'d Signal),
    /// The current task fails; the robot completes an alternative.
    Replace(usize, usize),
    /// The robot reports all ended steps to the ledger.
    Report(usize),
}

/// A robot for each role, in some state of a mission.
#[derive(Debug, Clone)]
pub(crate) struct Team<'d> {
    pub(crate) before: &'d [Vec<bool>],
    pub(crate) robots: Vec<PlanProgress>,
    pub(crate) current: Vec<Option<StepIndex>>,
    /// Steps of each robot that the ledger contains, for plans with guards.
    pub(crate) known: Vec<BTreeSet<StepIndex>>,
    /// Moves of items with checked guards.
    pub(crate) moves: &'d [ItemMove],
    pub(crate) in_transit: BTreeSet<(usize, &'d Signal)>,
    pub(crate) division: &'d Division,
}

/// Identity of a state.
pub(crate) type Key<'d> = (Vec<(BTreeSet<StepIndex>, Option<StepIndex>, BTreeSet<StepIndex>)>, Sent<'d>);

/// Signals sent and not yet received, with their receivers.
pub(crate) type Sent<'d> = BTreeSet<(usize, &'d Signal)>;

impl<'d> Team<'d> {
    pub(crate) fn of(division: &'d Division, before: &'d [Vec<bool>]) -> Self {
        let robots: Vec<PlanProgress> = division.plans.values().cloned().map(PlanProgress::new).collect();
        let (current, known) = (vec![None; robots.len()], vec![BTreeSet::new(); robots.len()]);
        Team { before, current, known, moves: &[], robots, in_transit: BTreeSet::new(), division }
    }

    pub(crate) fn key(&self) -> Key<'d> {
        let robots = self.robots.iter().zip(&self.current).zip(&self.known);
        let robots = robots.map(|((robot, current), known)| (robot.ended().clone(), *current, known.clone()));
        (robots.collect(), self.in_transit.clone())
    }

    pub(crate) fn events(&self) -> Vec<Event<'d>> {
        let mut events: Vec<Event<'d>> =
            self.in_transit.iter().map(|(to, signal)| Event::Receive(*to, signal)).collect();
        for (robot, progress) in self.robots.iter().enumerate() {
            match self.current[robot] {
                Some(step) => {
                    events.push(Event::Finish(robot));
                    events.extend(progress.alternatives_for(step).map(|(other, _)| Event::Replace(robot, other)));
                }
                None => {
                    let permitted = progress.permitted().into_iter();
                    let may = permitted.filter(|step| progress.is_guard_met(*step, &self.known[robot]));
                    events.extend(may.map(|step| Event::Perform(robot, step)));
                }
            }
            if !progress.plan().guarded.is_empty() && *progress.ended() != self.known[robot] {
                events.push(Event::Report(robot));
            }
        }
        events
    }

    pub(crate) fn is_complete(&self) -> bool {
        self.robots.iter().all(PlanProgress::is_complete)
    }

    /// Applies an event; the error names the violated order.
    pub(crate) fn apply(&mut self, event: Event<'d>) -> Result<(), OrderViolation> {
        match event {
            Event::Receive(to, signal) => {
                assert!(self.robots[to].receive(signal), "{signal} was awaited and not received before");
                assert!(!self.robots[to].receive(signal), "{signal} is received once");
                self.in_transit.remove(&(to, signal));
            }
            Event::Report(robot) => self.known[robot] = self.robots[robot].ended().clone(),
            Event::Replace(robot, other) => {
                self.current[robot] = None;
                let progress = &self.robots[robot];
                for step in &progress.plan().alternatives[other].replaces {
                    let StepAction::Task { id, spec } = &progress.step(*step).unwrap().action else {
                        return Err(OrderViolation(format!("step {step} is replaced and is not a task")));
                    };
                    let of_it = |earlier: &TaskId| {
                        let replaced = progress.plan().alternatives[other].replaces.iter();
                        replaced.filter_map(|step| progress.step(*step)).any(|step| match &step.action {
                            StepAction::Task { id, .. } => id == earlier,
                            StepAction::Send(_) | StepAction::Wait(_) => false,
                        })
                    };
                    self.check_begin(id, spec, of_it)?;
                }
                self.robots[robot].apply_alternative(other).map_err(OrderViolation::of)?;
            }
            Event::Finish(robot) => {
                let step = self.current[robot].take().expect("the robot executes a task");
                self.robots[robot].end(step).map_err(OrderViolation::of)?;
            }
            Event::Perform(robot, step) => {
                let division: &'d Division = self.division;
                let (_, plan) = division.plans.iter().nth(robot).unwrap();
                match &plan.steps[step as usize].action {
                    StepAction::Task { id, spec } => {
                        self.check_begin(id, spec, |_| false)?;
                        self.current[robot] = Some(step);
                        return Ok(());
                    }
                    StepAction::Send(signal) => {
                        let to = self.index(&signal.to);
                        self.in_transit.insert((to, signal));
                    }
                    StepAction::Wait(_) => {}
                }
                self.robots[robot].end(step).map_err(OrderViolation::of)?;
            }
        }
        Ok(())
    }

    /// Checks the conditions of the mission for the begin of a task; tasks in `ignored` need not
    /// have ended.
    fn check_begin(
        &self,
        id: &TaskId,
        spec: &TaskSpec,
        ignored: impl Fn(&TaskId) -> bool,
    ) -> Result<(), OrderViolation> {
        for (role, guard) in self.moves.iter().filter(|moved| moved.task == *id).flat_map(|moved| &moved.guards) {
            let robot = self.index(role);
            let plan = self.robots[robot].plan();
            let mut open: Vec<StepIndex> = plan.steps[*guard as usize].after.clone();
            while let Some(step) = open.pop() {
                if !self.known[robot].contains(&step) {
                    return Err(OrderViolation(format!(
                        "{id} begins before the ledger contains step {step} of {role}"
                    )));
                }
                open.extend(&plan.steps[step as usize].after);
            }
        }
        for progress in &self.robots {
            for (index, step) in progress.plan().steps.iter().enumerate() {
                let StepAction::Task { id: earlier, .. } = &step.action else { continue };
                let due = self.before[number(earlier)][number(id)] && !ignored(earlier);
                if due && !progress.ended().contains(&(index as StepIndex)) {
                    return Err(OrderViolation(format!(
                        "{id} begins before {} has ended {earlier}",
                        progress.plan().role
                    )));
                }
            }
        }
        for partner in spec.roles.iter().filter(|_| spec.is_joint()) {
            let robot = self.index(partner);
            let progress = &self.robots[robot];
            let of_it = |step: StepIndex| match &progress.step(step).unwrap().action {
                StepAction::Task { id: other, .. } => other == id,
                StepAction::Send(_) | StepAction::Wait(_) => false,
            };
            let ended = progress.ended().iter().any(|step| of_it(*step));
            let ready = progress.committed() == Some(id) && self.current[robot].is_none_or(of_it);
            if !(ended || ready) {
                return Err(OrderViolation(format!("{id} begins while {partner} is not ready")));
            }
        }
        Ok(())
    }

    fn index(&self, role: &RoleId) -> usize {
        self.division.plans.keys().position(|other| other == role).unwrap()
    }
}

/// An event that the order of the mission forbids, or a run that cannot continue.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct OrderViolation(pub(crate) String);

impl OrderViolation {
    pub(crate) fn of(problem: impl ToString) -> OrderViolation {
        OrderViolation(problem.to_string())
    }
}

/// Result of a search over all states.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Explored {
    /// Every run keeps the order and ends.
    Sound,
    /// There are more states than the limit; no visited state is wrong.
    TooMany,
    /// A run is wrong.
    Wrong(String),
}

/// Visits every reachable state, up to a limit.
pub(crate) fn explore_all_states(division: &Division, before: &[Vec<bool>], most: usize) -> Explored {
    explore_from(Team::of(division, before), most)
}

/// Does the same from a given state.
pub(crate) fn explore_from(start: Team<'_>, most: usize) -> Explored {
    let mut seen: HashSet<Key<'_>> = [start.key()].into();
    let mut open = vec![start];
    while let Some(team) = open.pop() {
        let events = team.events();
        if events.is_empty() && !team.is_complete() {
            return Explored::Wrong(format!("deadlock: {:?}", team.key()));
        }
        for event in events {
            let mut then = team.clone();
            if let Err(wrong) = then.apply(event) {
                return Explored::Wrong(wrong.0);
            }
            if seen.insert(then.key()) {
                if seen.len() > most {
                    return Explored::TooMany;
                }
                open.push(then);
            }
        }
    }
    Explored::Sound
}
