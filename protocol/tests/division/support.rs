//! Missions made of little, and a robot for every role that does whatever its progress permits.

use consort_protocol::ids::{RoleId, TaskId, TaskType};
use consort_protocol::mission::{Method, Mission, Role, RoleKind, TaskBody, TaskIndex, TaskNode, TaskOrder, TaskSpec};
use consort_protocol::plan::{Division, ItemMove, PlanProgress, Signal, StepAction, StepIndex};
use std::collections::{BTreeMap, BTreeSet, HashSet};

/// A tree of tasks: what the order of a mission is, said once more in its plainest form.
#[derive(Debug, Clone)]
pub(crate) enum Tree {
    /// A task of these roles, by number.
    Task(Vec<usize>),
    /// One after the other.
    Sequence(Vec<Tree>),
    /// In no order.
    Unordered(Vec<Tree>),
}

pub(crate) use Tree::{Sequence, Task, Unordered};

pub(crate) fn role(number: usize) -> RoleId {
    RoleId::new(format!("r{number}")).unwrap()
}

/// The mission of a tree. Elementary tasks are called `t0`, `t1`, … in the order of the tree; roles whose number is a
/// multiple of three are people, unless nobody else takes part.
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

/// The roles of each elementary task.
pub(crate) fn leaves(tree: &Tree) -> Vec<Vec<usize>> {
    match tree {
        Task(roles) => vec![roles.clone()],
        Sequence(below) | Unordered(below) => below.iter().flat_map(leaves).collect(),
    }
}

/// Which task comes before which, computed slowly: parting branches, then joint tasks by file order, then the closure.
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

/// The number of a task that [`mission`] named.
pub(crate) fn number(id: &TaskId) -> usize {
    id.as_str()[1..].parse().unwrap()
}

/// Everything that can happen next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Event<'d> {
    /// The robot performs a step; a task it only begins.
    Perform(usize, StepIndex),
    /// The robot ends the task it does.
    Finish(usize),
    /// The robot hears a signal that was sent.
    Receive(usize, &'d Signal),
    /// The task it does fails; it does an alternative to its end.
    Replace(usize, usize),
    /// The ledger hears of all that the robot has ended.
    Report(usize),
}

/// One robot a role, in some state of a mission.
#[derive(Debug, Clone)]
pub(crate) struct Team<'d> {
    before: &'d [Vec<bool>],
    robots: Vec<PlanProgress>,
    doing: Vec<Option<StepIndex>>,
    /// What the ledger holds of each robot, where its plan has guards.
    known: Vec<BTreeSet<StepIndex>>,
    /// The moves of items, whose guards are watched.
    moves: &'d [ItemMove],
    on_the_way: BTreeSet<(usize, &'d Signal)>,
    division: &'d Division,
}

/// What tells one state from another.
pub(crate) type Key<'d> = (Vec<(BTreeSet<StepIndex>, Option<StepIndex>, BTreeSet<StepIndex>)>, Sent<'d>);

/// Signals that were sent and not heard, with the robots that await them.
pub(crate) type Sent<'d> = BTreeSet<(usize, &'d Signal)>;

impl<'d> Team<'d> {
    pub(crate) fn of(division: &'d Division, before: &'d [Vec<bool>]) -> Self {
        let robots: Vec<PlanProgress> = division.plans.values().cloned().map(PlanProgress::new).collect();
        let (doing, known) = (vec![None; robots.len()], vec![BTreeSet::new(); robots.len()]);
        Team { before, doing, known, moves: &[], robots, on_the_way: BTreeSet::new(), division }
    }

    /// The same team, which breaks off as soon as an item moves before its guards were met.
    pub(crate) fn watching(self, moves: &'d [ItemMove]) -> Self {
        Team { moves, ..self }
    }

    pub(crate) fn key(&self) -> Key<'d> {
        let robots = self.robots.iter().zip(&self.doing).zip(&self.known);
        let robots = robots.map(|((robot, doing), known)| (robot.ended().clone(), *doing, known.clone()));
        (robots.collect(), self.on_the_way.clone())
    }

    pub(crate) fn events(&self) -> Vec<Event<'d>> {
        let mut events: Vec<Event<'d>> =
            self.on_the_way.iter().map(|(to, signal)| Event::Receive(*to, signal)).collect();
        for (robot, progress) in self.robots.iter().enumerate() {
            match self.doing[robot] {
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

    /// What happens if everybody follows `next`.
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

    /// Lets it happen; an error says which order was broken.
    pub(crate) fn apply(&mut self, event: Event<'d>) -> Result<(), String> {
        match event {
            Event::Receive(to, signal) => {
                assert!(self.robots[to].receive(signal), "{signal} was awaited and is news");
                assert!(!self.robots[to].receive(signal), "{signal} is news once");
                self.on_the_way.remove(&(to, signal));
            }
            Event::Report(robot) => self.known[robot] = self.robots[robot].ended().clone(),
            Event::Replace(robot, other) => {
                self.doing[robot] = None;
                let progress = &self.robots[robot];
                for step in &progress.plan().alternatives[other].replaces {
                    let StepAction::Task { id, spec } = &progress.step(*step).unwrap().action else {
                        return Err(format!("step {step} is replaced and is no task"));
                    };
                    let of_it = |earlier: &TaskId| {
                        let replaced = progress.plan().alternatives[other].replaces.iter();
                        replaced.filter_map(|step| progress.step(*step)).any(|step| match &step.action {
                            StepAction::Task { id, .. } => id == earlier,
                            StepAction::Send(_) | StepAction::Wait(_) => false,
                        })
                    };
                    self.may_begin(id, spec, of_it)?;
                }
                self.robots[robot].apply_alternative(other).map_err(|error| error.to_string())?;
            }
            Event::Finish(robot) => {
                let step = self.doing[robot].take().expect("it does a task");
                self.robots[robot].end(step).map_err(|error| error.to_string())?;
            }
            Event::Perform(robot, step) => {
                let division: &'d Division = self.division;
                let (_, plan) = division.plans.iter().nth(robot).unwrap();
                match &plan.steps[step as usize].action {
                    StepAction::Task { id, spec } => {
                        self.may_begin(id, spec, |_| false)?;
                        self.doing[robot] = Some(step);
                        return Ok(());
                    }
                    StepAction::Send(signal) => {
                        let to = self.index(&signal.to);
                        self.on_the_way.insert((to, signal));
                    }
                    StepAction::Wait(_) => {}
                }
                self.robots[robot].end(step).map_err(|error| error.to_string())?;
            }
        }
        Ok(())
    }

    /// What the mission demands of the moment at which somebody begins a task; some need not have ended.
    fn may_begin(&self, id: &TaskId, spec: &TaskSpec, aside: impl Fn(&TaskId) -> bool) -> Result<(), String> {
        for (role, guard) in self.moves.iter().filter(|moved| moved.task == *id).flat_map(|moved| &moved.guards) {
            let robot = self.index(role);
            let plan = self.robots[robot].plan();
            let mut open: Vec<StepIndex> = plan.steps[*guard as usize].after.clone();
            while let Some(step) = open.pop() {
                if !self.known[robot].contains(&step) {
                    return Err(format!("{id} begins before the ledger knows of step {step} of {role}"));
                }
                open.extend(&plan.steps[step as usize].after);
            }
        }
        for progress in &self.robots {
            for (index, step) in progress.plan().steps.iter().enumerate() {
                let StepAction::Task { id: earlier, .. } = &step.action else { continue };
                let due = self.before[number(earlier)][number(id)] && !aside(earlier);
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
            let ready = progress.committed() == Some(id) && self.doing[robot].is_none_or(of_it);
            if !(ended || ready) {
                return Err(format!("{id} begins while {partner} does not stand ready"));
            }
        }
        Ok(())
    }

    fn index(&self, role: &RoleId) -> usize {
        self.division.plans.keys().position(|other| other == role).unwrap()
    }

    /// What the ledger holds of a robot.
    pub(crate) fn known(&self, robot: usize) -> &BTreeSet<StepIndex> {
        &self.known[robot]
    }

    /// Whether anybody has begun the task, and whether all have ended it.
    pub(crate) fn begun_and_ended(&self, task: &TaskId) -> (bool, bool) {
        let (mut begun, mut all) = (false, true);
        for (progress, doing) in self.robots.iter().zip(&self.doing) {
            for (index, step) in (0..).zip(&progress.plan().steps) {
                if matches!(&step.action, StepAction::Task { id, .. } if id == task) {
                    let ended = progress.ended().contains(&index);
                    begun |= ended || *doing == Some(index);
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

/// What a search over all states found.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Explored {
    /// Every run keeps the order and ends.
    Sound,
    /// There are more states than were asked for; none of those seen is wrong.
    TooMany,
    /// Some run is wrong.
    Wrong(String),
}

/// Visits every state that can be reached, up to a number of them.
pub(crate) fn explore_all_states(division: &Division, before: &[Vec<bool>], most: usize) -> Explored {
    explore_from(Team::of(division, before), most)
}

/// The same from a given state.
pub(crate) fn explore_from(start: Team<'_>, most: usize) -> Explored {
    let mut seen: HashSet<Key<'_>> = [start.key()].into();
    let mut open = vec![start];
    while let Some(team) = open.pop() {
        let events = team.events();
        if events.is_empty() && !team.is_complete() {
            return Explored::Wrong(format!("nothing can happen any more: {:?}", team.key()));
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

/// The division without one step: what stood after it stands after what it stood after.
pub(crate) fn without_step(division: &Division, role: &RoleId, step: usize) -> Division {
    let mut division = division.clone();
    let plan = division.plans.get_mut(role).unwrap();
    let gone = plan.steps.remove(step);
    for later in &mut plan.steps[step..] {
        let stood_after = later.after.contains(&(step as StepIndex));
        let mut after: BTreeSet<StepIndex> = later
            .after
            .iter()
            .filter(|index| **index as usize != step)
            .map(|index| if *index as usize > step { index - 1 } else { *index })
            .collect();
        if stood_after {
            after.extend(&gone.after);
        }
        later.after = after.into_iter().collect();
    }
    division
}

/// Where a step stands: whose, and its number.
pub(crate) type StepPlace = (RoleId, usize);

/// Every signal, with the places of its send and its wait.
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

/// The division without one signal.
pub(crate) fn without_signal(division: &Division, signal: &Signal) -> Division {
    let (_, send, wait) = signals(division).into_iter().find(|(other, ..)| other == signal).unwrap();
    without_step(&without_step(division, &send.0, send.1), &wait.0, wait.1)
}
