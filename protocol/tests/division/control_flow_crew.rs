//! Robots and people that execute a divided mission through its ledger: robots get roles as these are to be
//! auctioned, and signals and outcomes arrive once they are reported.

use crate::properties::SeededRng;
use consort_protocol::auction::{AuctionId, AuctionRecord};
use consort_protocol::cause::CauseClass;
use consort_protocol::ids::{MissionId, RequestId, RobotId, RoleId, TaskId};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{
    Branch, Command, CommandOutcome, Ledger, MissionEntry, MissionState, RecoveryBranch, RolePhase, Submission,
};
use consort_protocol::mission::{GlobalOrder, Mission, RoleKind, TaskOutcome, TaskOutcomes, TaskSpec};
use consort_protocol::plan::{Division, LocalPlan, PlanProgress, StepAction, StepIndex};
use consort_protocol::scalar::Scalar;
use std::collections::{BTreeMap, BTreeSet};

/// Maximum number of events of a run.
const EVENTS_MAX: usize = 100_000;

/// A run has a loss after this number of events on average, until there are no more.
const EVENTS_PER_LOSS: usize = 40;

/// A divided mission, and its divided recovery branch.
pub(crate) type Branches = (Mission, Division, Option<(Mission, Division)>);

/// How a run ends.
#[derive(Debug)]
pub(crate) struct Ending {
    pub(crate) state: MissionState,
    /// Numbers of parts of tasks; roles have parts in joint tasks.
    pub(crate) executed: usize,
    pub(crate) skipped: usize,
}

/// The crew of a mission.
pub(crate) struct Crew<'m> {
    rng: SeededRng,
    ledger: Ledger,
    mission: MissionId,
    /// Index of the latest command.
    index: u64,
    robots: Vec<RobotId>,
    /// Number of robots still to be lost.
    losses: usize,
    orders: Vec<GlobalOrder<'m>>,
    parts: BTreeMap<RoleId, RolePart>,
    /// Decision for each task: true if it is executed. All roles and all successors must decide the same.
    decisions: BTreeMap<TaskId, bool>,
    ended: BTreeSet<(TaskId, RoleId)>,
}

/// Execution of a role by its holder.
struct RolePart {
    branch: Branch,
    epoch: Epoch,
    progress: PlanProgress,
    current: Option<StepIndex>,
    outcomes: TaskOutcomes,
    /// By step, the other tasks with outcomes that the task of the step reads.
    used: BTreeMap<StepIndex, BTreeSet<TaskId>>,
}

impl RolePart {
    fn of(branch: Branch, epoch: Epoch, plan: &LocalPlan) -> RolePart {
        let used = (0..).zip(&plan.steps).filter_map(|(index, step)| match &step.action {
            StepAction::Task { spec, .. } => Some((index, spec.tasks_used().unwrap())),
            StepAction::Send(_) | StepAction::Wait(_) => None,
        });
        let used = used.collect();
        let progress = PlanProgress::new(plan.clone());
        RolePart { branch, epoch, progress, current: None, outcomes: TaskOutcomes::new(), used }
    }

    fn task(&self, step: StepIndex) -> Option<(TaskId, TaskSpec)> {
        self.progress.plan().step_task(step).map(|(id, spec)| (id.clone(), spec.clone()))
    }
}

impl<'m> Crew<'m> {
    pub(crate) fn of(branches: &'m Branches, robots: usize, losses: usize, seed: u64) -> Crew<'m> {
        let (mission, division, recovery) = branches;
        let mut orders = vec![GlobalOrder::of(mission).unwrap()];
        let mut submission = Submission::of(RequestId::new("a").unwrap(), mission.clone(), division.clone());
        if let Some((mission, division)) = recovery {
            orders.push(GlobalOrder::of(mission).unwrap());
            submission.recovery = Some(RecoveryBranch { mission: mission.clone(), division: division.clone() });
        }
        let mut ledger = Ledger::default();
        ledger.apply(Epoch { term: 1, index: 1 }, Command::Submit(Box::new(submission)));
        let mission = ledger.missions().next().unwrap().id.clone();
        Crew {
            rng: SeededRng(seed),
            ledger,
            mission,
            index: 1,
            robots: (0..robots).map(|number| RobotId::new(format!("robot-{number}")).unwrap()).collect(),
            losses,
            orders,
            parts: BTreeMap::new(),
            decisions: BTreeMap::new(),
            ended: BTreeSet::new(),
        }
    }

    /// Executes the mission to its end.
    pub(crate) fn run(mut self) -> Result<Ending, String> {
        let may_lose = self.losses > 0;
        for _ in 0..EVENTS_MAX {
            let state = self.entry().state.clone();
            if state.is_final() {
                let of_task = |order: &GlobalOrder<'_>| order.tasks().iter().map(|(_, spec)| spec.roles.len()).sum();
                let all: usize = of_task(&self.orders[0]);
                if state == MissionState::Completed && !may_lose && self.ended.len() != all {
                    return Err(format!("completed with {} of {all} parts of tasks", self.ended.len()));
                }
                let executed = self.ended.iter().filter(|(task, _)| self.decisions[task]).count();
                return Ok(Ending { state, executed, skipped: self.ended.len() - executed });
            }
            self.update_parts();
            if !self.event()? {
                return Err(self.deadlock());
            }
        }
        Err(format!("no end after {EVENTS_MAX} events"))
    }

    fn entry(&self) -> &MissionEntry {
        self.ledger.mission(&self.mission).unwrap()
    }

    fn apply(&mut self, command: Command) -> Result<Epoch, String> {
        self.index += 1;
        let at = Epoch { term: 1, index: self.index };
        match self.ledger.apply(at, command.clone()) {
            CommandOutcome::Refused(problem) => Err(format!("{problem}: {command:?}")),
            _ => Ok(at),
        }
    }

    /// Removes roles that have ended or were lost, and begins those of people.
    fn update_parts(&mut self) {
        let entry = self.ledger.mission(&self.mission).unwrap();
        self.parts.retain(|role, part| {
            let is_held = entry.roles.get(role).is_some_and(|state| {
                let epoch = state.holder.as_ref().map(|holder| holder.epoch);
                state.phase != RolePhase::Ended && (state.kind == RoleKind::Unmanaged || epoch == Some(part.epoch))
            });
            is_held && part.branch == entry.branch
        });
        for role in entry.unmanaged_roles().filter(|role| entry.roles[*role].phase != RolePhase::Ended) {
            let part = || RolePart::of(entry.branch, Epoch::default(), entry.plan(role).unwrap());
            self.parts.entry(role.clone()).or_insert_with(part);
        }
    }

    /// Lets something happen. Returns false if nothing can.
    fn event(&mut self) -> Result<bool, String> {
        if self.losses > 0 && self.rng.below(EVENTS_PER_LOSS) == 0 && self.lose_robot()? {
            return Ok(true);
        }
        let roles: Vec<RoleId> = self.parts.keys().cloned().collect();
        let count = roles.len() + 1;
        let first = self.rng.below(count);
        for number in 0..count {
            let has_happened = match roles.get((first + number) % count) {
                Some(role) => self.act(role)?,
                None => self.auction()?,
            };
            if has_happened {
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn lose_robot(&mut self) -> Result<bool, String> {
        let held: Vec<(RoleId, Epoch)> =
            self.entry().held_roles().map(|(role, _, holder)| (role.clone(), holder.epoch)).collect();
        let Some((role, epoch)) = held.get(self.rng.below(held.len().max(1))).cloned() else { return Ok(false) };
        self.losses -= 1;
        let (mission, cause) = (self.mission.clone(), "lost".to_owned());
        let (class, moved_nothing, place, gave_way) = (None, false, None, false);
        self.apply(Command::Release { mission, role, epoch, cause, class, moved_nothing, place, gave_way })?;
        Ok(true)
    }

    /// Gives free robots the roles to be auctioned: all that the mission needs, and any of spread loops.
    fn auction(&mut self) -> Result<bool, String> {
        let entry = self.ledger.mission(&self.mission).unwrap();
        let busy: BTreeSet<&RobotId> = entry.held_roles().map(|(.., holder)| &holder.robot).collect();
        let free: Vec<RobotId> = self.robots.iter().filter(|robot| !busy.contains(robot)).cloned().collect();
        let (mut spread, mut roles): (Vec<RoleId>, Vec<RoleId>) =
            entry.roles_to_auction().into_iter().partition(|role| entry.is_spread(role));
        let branch = entry.branch;
        let Some(left) = free.len().checked_sub(roles.len()) else { return Ok(false) };
        let most = left.min(spread.len());
        let least = usize::from(roles.is_empty()).min(most);
        for _ in 0..least + self.rng.below(most - least + 1) {
            roles.push(spread.swap_remove(self.rng.below(spread.len())));
        }
        if roles.is_empty() {
            return Ok(false);
        }
        let mission = self.mission.clone();
        let auction = AuctionRecord::empty(AuctionId { mission: mission.clone(), term: 1, round: 1 });
        let holders: BTreeMap<RoleId, RobotId> = roles.iter().cloned().zip(free).collect();
        let epoch = self.apply(Command::Award { mission: mission.clone(), branch, holders, auction })?;
        for role in roles {
            let (accepted, mission) = (role.clone(), mission.clone());
            let (incarnation, from_checkpoint) = (1, false);
            self.apply(Command::Accept { mission, role: accepted, epoch, incarnation, from_checkpoint })?;
            for part in self.parts.values_mut() {
                part.progress.discard_signals_from(&role);
            }
            let part = RolePart::of(branch, epoch, self.entry().plan(&role).unwrap());
            self.parts.insert(role, part);
        }
        Ok(true)
    }

    /// Lets a role report, receive signals, or perform a step.
    fn act(&mut self, role: &RoleId) -> Result<bool, String> {
        let first = self.rng.below(3);
        for number in 0..3 {
            let has_happened = match (first + number) % 3 {
                0 => self.report(role)?,
                1 => self.receive(role),
                _ => self.perform(role)?,
            };
            if has_happened {
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn report(&mut self, role: &RoleId) -> Result<bool, String> {
        let part = &self.parts[role];
        let ended = part.progress.ended().clone();
        if ended == self.entry().roles[role].ended {
            return Ok(false);
        }
        let (mission, epoch, branch) = (self.mission.clone(), part.epoch, part.branch);
        let outcomes = part.outcomes.clone();
        self.apply(Command::Progress { mission, role: role.clone(), epoch, branch, ended, outcomes })?;
        Ok(true)
    }

    fn receive(&mut self, role: &RoleId) -> bool {
        let sent = self.entry().signals_to(role);
        let progress = &mut self.parts.get_mut(role).unwrap().progress;
        sent.iter().filter(|signal| progress.receive(signal)).count() > 0
    }

    fn perform(&mut self, role: &RoleId) -> Result<bool, String> {
        let part = &self.parts[role];
        if let Some(step) = part.current {
            let results =
                [("ok", Scalar::Bool(self.rng.below(2) == 0)), ("level", Scalar::Number(self.rng.below(4) as f64))];
            let results = results.map(|(name, value)| (name.to_owned(), value)).into();
            self.end_task(role, step, TaskOutcome::Done(results));
            return Ok(true);
        }
        let recorded = &self.entry().roles[role].ended;
        let mut open: Vec<StepIndex> = part.progress.permitted();
        open.retain(|step| part.progress.is_guard_met(*step, recorded));
        let uses_outcomes = open.iter().any(|step| part.used.get(step).is_some_and(|used| !used.is_empty()));
        let outcomes = if uses_outcomes { self.entry().outcomes_for(role) } else { TaskOutcomes::new() };
        let are_known = |used: &BTreeSet<TaskId>| used.iter().all(|task| outcomes.contains_key(task));
        open.retain(|step| part.used.get(step).is_none_or(are_known));
        if open.is_empty() {
            return Ok(false);
        }
        let step = open[self.rng.below(open.len())];
        match self.parts[role].task(step) {
            Some((task, spec)) => self.begin(role, step, &task, spec, &outcomes)?,
            None => self.parts.get_mut(role).unwrap().progress.end(step).map_err(|problem| problem.to_string())?,
        }
        Ok(true)
    }

    /// Begins or skips a task.
    fn begin(
        &mut self,
        role: &RoleId,
        step: StepIndex,
        task: &TaskId,
        mut spec: TaskSpec,
        outcomes: &TaskOutcomes,
    ) -> Result<(), String> {
        self.check_order(task)?;
        let decision = spec.conditions_hold(outcomes);
        let decision =
            decision.and_then(|holds| if holds { spec.set_inputs(outcomes).map(|()| true) } else { Ok(false) });
        match decision {
            Err(cause) if cause.contains("skipped") => {
                let (mission, branch, places) = (self.mission.clone(), Some(self.entry().branch), BTreeMap::new());
                let class = CauseClass::Task;
                self.apply(Command::Fail { mission, cause, branch, places, class }).map(drop)
            }
            Err(cause) => Err(format!("{role} cannot decide about {task}: {cause}")),
            Ok(is_executed) if *self.decisions.entry(task.clone()).or_insert(is_executed) != is_executed => {
                Err(format!("{role} executes or skips {task}, unlike another role or a predecessor"))
            }
            Ok(true) => {
                self.parts.get_mut(role).unwrap().current = Some(step);
                Ok(())
            }
            Ok(false) => {
                self.end_task(role, step, TaskOutcome::Skipped);
                Ok(())
            }
        }
    }

    fn end_task(&mut self, role: &RoleId, step: StepIndex, outcome: TaskOutcome) {
        let part = self.parts.get_mut(role).unwrap();
        let (task, _) = part.task(step).unwrap();
        part.current = None;
        part.progress.end(step).unwrap();
        part.outcomes.insert(task.clone(), outcome);
        self.ended.insert((task, role.clone()));
    }

    /// Checks that the tasks before a task have ended in all their roles.
    fn check_order(&self, task: &TaskId) -> Result<(), String> {
        let place = |order: &&GlobalOrder<'m>| order.tasks().iter().position(|(id, _)| *id == task);
        let order = self.orders.iter().find(|order| place(order).is_some()).expect("a task of the mission");
        let number = place(&order).unwrap();
        for (earlier, (id, spec)) in order.tasks().iter().enumerate() {
            let has_ended = |role: &RoleId| self.ended.contains(&((*id).clone(), role.clone()));
            if order.precedes(earlier, number) && !spec.roles.iter().all(has_ended) {
                return Err(format!("{task} begins before {id} has ended in all its roles"));
            }
        }
        Ok(())
    }

    fn deadlock(&self) -> String {
        let part = |(role, part): (&RoleId, &RolePart)| {
            format!("{role}: ended {:?}, awaits {:?}", part.progress.ended(), part.progress.awaited_signals())
        };
        let parts: Vec<String> = self.parts.iter().map(part).collect();
        format!("deadlock with open roles {:?}:\n{}", self.entry().open_roles(), parts.join("\n"))
    }
}
