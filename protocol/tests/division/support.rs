//! Generated missions, and robots that perform any permitted step.

use consort_protocol::ids::{RoleId, TaskId, TaskType};
use consort_protocol::mission::{Method, Mission, Role, RoleKind, TaskBody, TaskIndex, TaskNode, TaskOrder, TaskSpec};
use consort_protocol::plan::{Division, ItemMove, PlanProgress, Signal, StepAction, StepIndex};
use std::collections::{BTreeMap, BTreeSet, HashSet};

/// Tree of tasks: the order of a mission in its simplest form.
#[derive(Debug, Clone)]
pub(crate) enum Tree {
    /// Task of these roles, by number.
    Task(Vec<usize>),
    /// Subtrees in sequence.
    Sequence(Vec<Tree>),
    /// Unordered subtrees.
    Unordered(Vec<Tree>),
}

pub(crate) use Tree::{Sequence, Task, Unordered};

pub(crate) fn role(number: usize) -> RoleId {
    RoleId::new(format!("r{number}")).unwrap()
}

/// Creates the mission of a tree. Elementary tasks are named `t0`, `t1`, … in the order of the
/// tree. Roles with a number divisible by 3 are people, unless only people take part.
pub(crate) fn mission(tree: &Tree) -> Mission {
    fn add(tree: &Tree, tasks: &mut Vec<TaskNode>, leaves: &mut usize) -> TaskIndex {
        let index = tasks.len();
        let (order, below) = match tree {
            Task(roles) => {
                let spec = TaskSpec {
                    parameters: [("seconds".to_owned(), "1".to_owned())].into(),
                    ..TaskSpec::of(TaskType::new("wait").unwrap(), roles.iter().copied().map(role).collect())
                };
                tasks.push(TaskNode {
                    id: TaskId::new(format!("t{leaves}")).unwrap(),
                    body: TaskBody::Elementary(spec),
                });
                *leaves += 1;
                return index as TaskIndex;
            }
            Sequence(below) => (TaskOrder::Sequential, below),
            Unordered(below) => (TaskOrder::Unordered, below),
        };
        let id = TaskId::new(format!("a{index}")).unwrap();
        tasks.push(TaskNode { id, body: TaskBody::Abstract(Method::of(order, vec![])) });
        let children = below.iter().map(|tree| add(tree, tasks, leaves)).collect();
        tasks[index].body = TaskBody::Abstract(Method::of(order, children));
        index as TaskIndex
    }
    let mut tasks = Vec::new();
    add(tree, &mut tasks, &mut 0);
    let used: BTreeSet<usize> = leaves(tree).into_iter().flatten().collect();
    let people_only = used.iter().all(|number| number % 3 == 0);
    let kind = |number: &usize| match number % 3 {
        0 if !people_only => RoleKind::Unmanaged,
        _ => RoleKind::Managed,
    };
    let roles = used.iter().map(|number| (role(*number), Role::of(kind(number)))).collect();
    Mission { name: TaskId::new("trial").unwrap(), roles, tasks }
}

/// Returns the roles of each elementary task.
pub(crate) fn leaves(tree: &Tree) -> Vec<Vec<usize>> {
    match tree {
        Task(roles) => vec![roles.clone()],
        Sequence(below) | Unordered(below) => below.iter().flat_map(leaves).collect(),
    }
}

/// Computes the order of tasks slowly: separating branches, then joint tasks by file order, then
/// the transitive closure.
pub(crate) fn reference_order(tree: &Tree) -> Vec<Vec<bool>> {
    fn mark(tree: &Tree, first: usize, before: &mut Vec<Vec<bool>>) -> usize {
        let (below, sequential) = match tree {
            Task(_) => return first + 1,
            Sequence(below) => (below, true),
            Unordered(below) => (below, false),
        };
        let mut next = first;
        for tree in below {
            let end = mark(tree, next, before);
            for earlier in (first..next).filter(|_| sequential) {
                before[earlier][next..end].fill(true);
            }
            next = end;
        }
        next
    }
    let roles = leaves(tree);
    let n = roles.len();
    let mut before = vec![vec![false; n]; n];
    mark(tree, 0, &mut before);
    for later in 0..n {
        for earlier in 0..later {
            let both_joint = roles[earlier].len() > 1 && roles[later].len() > 1;
            before[earlier][later] |= both_joint && roles[earlier].iter().any(|role| roles[later].contains(role));
        }
    }
    for via in 0..n {
        for from in 0..n {
            for to in 0..n {
                before[from][to] |= before[from][via] && before[via][to];
            }
        }
    }
    before
}

/// Returns the number of a task named by [`mission`].
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
    before: &'d [Vec<bool>],
    robots: Vec<PlanProgress>,
    current: Vec<Option<StepIndex>>,
    /// Steps of each robot that the ledger contains, for plans with guards.
    known: Vec<BTreeSet<StepIndex>>,
    /// Moves of items with checked guards.
    moves: &'d [ItemMove],
    in_transit: BTreeSet<(usize, &'d Signal)>,
    division: &'d Division,
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

    /// Returns the same team, which reports an error as soon as an item moves before its guards are
    /// met.
    pub(crate) fn checking_guards(self, moves: &'d [ItemMove]) -> Self {
        Team { moves, ..self }
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

    /// Returns the events if every robot follows `next`.
    pub(crate) fn advised(&self) -> Vec<Event<'d>> {
        let next = |robot: &usize| self.robots[*robot].next_guarded(&self.known[*robot]).map(|(step, _)| step);
        let advised = |event: &Event<'d>| match event {
            Event::Perform(robot, step) => next(robot) == Some(*step),
            Event::Finish(_) | Event::Receive(..) | Event::Replace(..) | Event::Report(_) => true,
        };
        self.events().into_iter().filter(advised).collect()
    }

    pub(crate) fn is_complete(&self) -> bool {
        self.robots.iter().all(PlanProgress::is_complete)
    }

    /// Applies an event; the error names the violated order.
    pub(crate) fn apply(&mut self, event: Event<'d>) -> Result<(), String> {
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
                        return Err(format!("step {step} is replaced and is not a task"));
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
                self.robots[robot].apply_alternative(other).map_err(|error| error.to_string())?;
            }
            Event::Finish(robot) => {
                let step = self.current[robot].take().expect("the robot executes a task");
                self.robots[robot].end(step).map_err(|error| error.to_string())?;
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
                self.robots[robot].end(step).map_err(|error| error.to_string())?;
            }
        }
        Ok(())
    }

    /// Checks the conditions of the mission for the begin of a task; tasks in `ignored` need not
    /// have ended.
    fn check_begin(&self, id: &TaskId, spec: &TaskSpec, ignored: impl Fn(&TaskId) -> bool) -> Result<(), String> {
        for (role, guard) in self.moves.iter().filter(|moved| moved.task == *id).flat_map(|moved| &moved.guards) {
            let robot = self.index(role);
            let plan = self.robots[robot].plan();
            let mut open: Vec<StepIndex> = plan.steps[*guard as usize].after.clone();
            while let Some(step) = open.pop() {
                if !self.known[robot].contains(&step) {
                    return Err(format!("{id} begins before the ledger contains step {step} of {role}"));
                }
                open.extend(&plan.steps[step as usize].after);
            }
        }
        for progress in &self.robots {
            for (index, step) in progress.plan().steps.iter().enumerate() {
                let StepAction::Task { id: earlier, .. } = &step.action else { continue };
                let due = self.before[number(earlier)][number(id)] && !ignored(earlier);
                if due && !progress.ended().contains(&(index as StepIndex)) {
                    return Err(format!("{id} begins before {} has ended {earlier}", progress.plan().role));
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
                return Err(format!("{id} begins while {partner} is not ready"));
            }
        }
        Ok(())
    }

    fn index(&self, role: &RoleId) -> usize {
        self.division.plans.keys().position(|other| other == role).unwrap()
    }

    /// Returns the steps of a robot that the ledger contains.
    pub(crate) fn known(&self, robot: usize) -> &BTreeSet<StepIndex> {
        &self.known[robot]
    }

    /// Returns whether any robot has begun the task, and whether all have ended it.
    pub(crate) fn begun_and_ended(&self, task: &TaskId) -> (bool, bool) {
        let (mut begun, mut all) = (false, true);
        for (progress, current) in self.robots.iter().zip(&self.current) {
            for (index, step) in (0..).zip(&progress.plan().steps) {
                if matches!(&step.action, StepAction::Task { id, .. } if id == task) {
                    let ended = progress.ended().contains(&index);
                    begun |= ended || *current == Some(index);
                    all &= ended;
                }
            }
        }
        (begun, all)
    }

    pub(crate) fn robots_mut(&mut self) -> &mut Vec<PlanProgress> {
        &mut self.robots
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
                return Explored::Wrong(wrong);
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

/// Removes a step from the division; its successors get its predecessors.
pub(crate) fn without_step(division: &Division, role: &RoleId, step: usize) -> Division {
    let mut division = division.clone();
    let plan = division.plans.get_mut(role).unwrap();
    let removed = plan.steps.remove(step);
    for later in &mut plan.steps[step..] {
        let was_after = later.after.contains(&(step as StepIndex));
        let mut after: BTreeSet<StepIndex> = later
            .after
            .iter()
            .filter(|index| **index as usize != step)
            .map(|index| if *index as usize > step { index - 1 } else { *index })
            .collect();
        if was_after {
            after.extend(&removed.after);
        }
        later.after = after.into_iter().collect();
    }
    division
}

/// Position of a step: role and index.
pub(crate) type StepPlace = (RoleId, usize);

/// Returns every signal, with the positions of its send and its wait.
pub(crate) fn signals(division: &Division) -> Vec<(Signal, StepPlace, StepPlace)> {
    let mut places: BTreeMap<Signal, [Option<StepPlace>; 2]> = BTreeMap::new();
    for (role, plan) in &division.plans {
        for (index, step) in plan.steps.iter().enumerate() {
            let (signal, which) = match &step.action {
                StepAction::Send(signal) => (signal, 0),
                StepAction::Wait(signal) => (signal, 1),
                StepAction::Task { .. } => continue,
            };
            places.entry(signal.clone()).or_default()[which] = Some((role.clone(), index));
        }
    }
    places.into_iter().map(|(signal, [send, wait])| (signal, send.unwrap(), wait.unwrap())).collect()
}

/// Removes a signal from the division.
pub(crate) fn without_signal(division: &Division, signal: &Signal) -> Division {
    let (_, send, wait) = signals(division).into_iter().find(|(other, ..)| other == signal).unwrap();
    without_step(&without_step(division, &send.0, send.1), &wait.0, wait.1)
}
