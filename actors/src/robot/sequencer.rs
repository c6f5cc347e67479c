//! Which step of its local plan a role takes next (Algorithm 2 of the thesis), as a value.

use consort_protocol::ids::{RobotId, RoleId, TaskId};
use consort_protocol::mission::TaskSpec;
use consort_protocol::plan::{LocalPlan, PlanProgress, ProgressError, Signal, StepAction, StepIndex};
use std::collections::{BTreeMap, BTreeSet};

/// A plan on its way: what has ended, what is under way, what comes next.
#[derive(Debug, Clone)]
pub struct Sequencer {
    progress: PlanProgress,
    /// The task under way.
    running: Option<StepIndex>,
    /// Who holds the mission's managed roles.
    holders: BTreeMap<RoleId, RobotId>,
    /// Roles that somebody has held: one of them that nobody holds now is being given to another.
    cast: BTreeSet<RoleId>,
    /// What this role has told others.
    said: BTreeSet<Signal>,
}

/// What to do next.
#[derive(Debug, Clone, PartialEq)]
pub enum Move {
    /// Begin a task.
    Perform {
        /// Which step it is.
        step: StepIndex,
        /// Its name.
        task: TaskId,
        /// What is to be achieved.
        spec: TaskSpec,
    },
    /// Tell another role.
    Tell(Signal),
    /// What was waited for has been heard.
    Heard(Signal),
}

impl Sequencer {
    /// Takes up a plan of which some steps have ended already.
    ///
    /// # Errors
    /// [`ProgressError`] when those steps cannot have ended so.
    pub fn new(
        plan: LocalPlan,
        ended: &BTreeSet<StepIndex>,
        holders: BTreeMap<RoleId, RobotId>,
    ) -> Result<Sequencer, ProgressError> {
        let said = ended.iter().filter_map(|step| match &plan.steps.get(*step as usize)?.action {
            StepAction::Send(signal) => Some(signal.clone()),
            StepAction::Wait(_) | StepAction::Task { .. } => None,
        });
        let said = said.collect();
        let progress = PlanProgress::restore(plan, ended.clone(), BTreeSet::new())?;
        let cast = holders.keys().cloned().collect();
        Ok(Sequencer { progress, running: None, holders, cast, said })
    }

    /// The next thing to do, which the caller does at once; `None` while a task is under way or all is waiting, be it for
    /// a signal or, in a task that names another role, for somebody to hold that role. Telling
    /// and hearing end with being returned; a task ends with [`end`](Sequencer::end).
    pub fn next_move(&mut self) -> Option<Move> {
        if self.running.is_some() {
            return None;
        }
        let (step, action) = self.progress.next().map(|(index, step)| (index, step.action.clone()))?;
        match action {
            StepAction::Task { spec, .. } if self.names_a_vacancy(&spec) => None,
            StepAction::Task { id, spec } => {
                self.running = Some(step);
                Some(Move::Perform { step, task: id, spec })
            }
            StepAction::Send(signal) => {
                self.finish(step);
                self.said.insert(signal.clone());
                Some(Move::Tell(signal))
            }
            StepAction::Wait(signal) => {
                self.finish(step);
                Some(Move::Heard(signal))
            }
        }
    }

    fn names_a_vacancy(&self, spec: &TaskSpec) -> bool {
        let mut vacant = self.cast.iter().filter(|role| !self.holders.contains_key(*role));
        vacant.any(|role| spec.roles.contains(role) || spec.parameters.values().any(|value| value == role.as_str()))
    }

    fn finish(&mut self, step: StepIndex) {
        self.progress.end(step).expect("a step that was given out may end");
    }

    /// The task under way has ended well.
    pub fn end(&mut self, step: StepIndex) {
        if self.running.take_if(|running| *running == step).is_some() {
            self.finish(step);
        }
    }

    /// The task under way was broken off; it is begun anew when the plan goes on.
    pub fn break_off(&mut self) {
        self.running = None;
    }

    /// Another role has said this. True if it was awaited and is news.
    pub fn hear(&mut self, signal: &Signal) -> bool {
        self.progress.hear(signal)
    }

    /// The task under way.
    pub fn at(&self) -> Option<&TaskId> {
        match &self.progress.step(self.running?)?.action {
            StepAction::Task { id, .. } => Some(id),
            StepAction::Send(_) | StepAction::Wait(_) => None,
        }
    }

    /// Signals that this role will yet need and has not heard.
    pub fn awaiting(&self) -> BTreeSet<Signal> {
        self.progress.awaiting().into_iter().cloned().collect()
    }

    /// Steps that have ended.
    pub fn ended(&self) -> &BTreeSet<StepIndex> {
        self.progress.ended()
    }

    /// What this role has told others.
    pub fn said(&self) -> &BTreeSet<Signal> {
        &self.said
    }

    /// Whether every step has ended.
    pub fn is_complete(&self) -> bool {
        self.progress.is_complete()
    }

    /// Who holds the managed roles.
    pub fn holders(&self) -> &BTreeMap<RoleId, RobotId> {
        &self.holders
    }

    /// Takes in who holds the managed roles now.
    pub fn set_holders(&mut self, holders: BTreeMap<RoleId, RobotId>) {
        self.cast.extend(holders.keys().cloned());
        self.holders = holders;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::plan::Step;

    #[test]
    fn a_task_that_names_a_role_begins_once_somebody_holds_that_role_again() {
        let role = |name: &str| RoleId::new(name).unwrap();
        let robot = |name: &str| RobotId::new(name).unwrap();
        let spec = TaskSpec {
            parameters: BTreeMap::from([("robot_role".to_owned(), "arm".to_owned())]),
            ..TaskSpec::of("approach_robot".parse().unwrap(), vec![role("r1")])
        };
        let id: TaskId = "meet".parse().unwrap();
        let step = Step { action: StepAction::Task { id: id.clone(), spec: spec.clone() }, after: vec![] };
        let plan = LocalPlan::of(role("r1"), vec![step]);
        let alone = BTreeMap::from([(role("r1"), robot("ada"))]);
        let both = BTreeMap::from([(role("r1"), robot("ada")), (role("arm"), robot("bob"))]);

        let mut sequencer = Sequencer::new(plan, &BTreeSet::new(), both.clone()).unwrap();
        sequencer.set_holders(alone);
        assert_eq!(sequencer.next_move(), None);
        sequencer.set_holders(both);
        assert_eq!(sequencer.next_move(), Some(Move::Perform { step: 0, task: id, spec }));
    }
}
