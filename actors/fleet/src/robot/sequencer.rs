//! Selection of the next step of a local plan (Algorithm 2 of the thesis), as a value.

use consort_protocol::ids::{RobotId, RoleId, TaskId};
use consort_protocol::lease::{Epoch, RoleHolder};
use consort_protocol::mission::TaskSpec;
use consort_protocol::plan::{
    Alternative, LocalPlan, PlanProgress, ProgressError, Signal, SignalKind, Step, StepAction, StepIndex,
};
use serde::{Deserialize, Serialize};
use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};

/// A plan in execution: ended steps, current task, next step.
#[derive(Debug, Clone)]
pub struct Sequencer {
    progress: PlanProgress,
    /// The current task.
    running: Option<StepRef>,
    alternatives: AlternativeProgress,
    /// Steps that the ledger is known to contain as ended.
    recorded: BTreeSet<StepIndex>,
    /// Holders of the mission's managed roles.
    holders: BTreeMap<RoleId, RoleHolder>,
    /// Latest known award of each role that has been held or is to be held. The default epoch means
    /// not yet awarded. A role in this map without a holder is about to be awarded.
    latest_awards: BTreeMap<RoleId, Epoch>,
    /// Signals that this role has sent.
    sent: BTreeSet<Signal>,
}

/// Reference to a task within a plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum StepRef {
    /// A step of the plan.
    Step(StepIndex),
    /// A task of an alternative.
    Alternative {
        /// Index of the alternative.
        alternative: usize,
        /// Index of the task within the alternative.
        task: usize,
    },
}

/// Alternatives that a role has started.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlternativeProgress {
    /// Alternatives started so far. An alternative starts at most once.
    started: BTreeSet<usize>,
    /// Current alternative, and the number of its tasks that have ended.
    current: Option<(usize, usize)>,
}

/// Next action for the caller.
#[derive(Debug, Clone, PartialEq)]
pub enum SequencerAction {
    /// Start a task.
    StartTask {
        /// Position of the task in the plan.
        step: StepRef,
        /// Its id.
        task: TaskId,
        /// Its specification.
        spec: TaskSpec,
    },
    /// Send a signal to another role.
    SendSignal(Signal),
    /// An awaited signal has arrived.
    SignalReceived(Signal),
}

/// The signal was sent under an award that is no longer in force. It is ignored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StaleSignal {
    /// Latest known award of the sending role.
    pub current: Epoch,
}

impl Sequencer {
    /// Starts a plan with the steps that the ledger contains as ended.
    ///
    /// # Errors
    /// [`ProgressError`] if these steps cannot have ended in this order.
    pub fn new(
        plan: LocalPlan,
        ended: &BTreeSet<StepIndex>,
        holders: BTreeMap<RoleId, RoleHolder>,
    ) -> Result<Sequencer, ProgressError> {
        Sequencer::resume(plan, ended, &BTreeSet::new(), AlternativeProgress::default(), holders)
    }

    /// Resumes a plan after a restart. The checkpoint (`own`) may be ahead of the ledger
    /// (`recorded`), or behind it.
    ///
    /// # Errors
    /// Same as [`new`](Sequencer::new).
    pub fn resume(
        plan: LocalPlan,
        recorded: &BTreeSet<StepIndex>,
        own: &BTreeSet<StepIndex>,
        mut alternatives: AlternativeProgress,
        holders: BTreeMap<RoleId, RoleHolder>,
    ) -> Result<Sequencer, ProgressError> {
        let ended: BTreeSet<StepIndex> = recorded.union(own).copied().collect();
        let sent = ended.iter().filter_map(|step| match &plan.steps.get(*step as usize)?.action {
            StepAction::Send(signal) => Some(signal.clone()),
            StepAction::Wait(_) | StepAction::Task { .. } => None,
        });
        let sent = sent.collect();
        let progress = PlanProgress::restore(plan, ended, BTreeSet::new())?;
        alternatives.current = alternatives.current.filter(|(alternative, _)| {
            let replacement = progress.plan().alternatives.get(*alternative);
            replacement.is_some_and(|replacement| !replacement.replaces.is_subset(progress.ended()))
        });
        let latest_awards = holders.iter().map(|(role, holding)| (role.clone(), holding.epoch)).collect();
        Ok(Sequencer {
            progress,
            running: None,
            alternatives,
            recorded: recorded.clone(),
            holders,
            latest_awards,
            sent,
        })
    }

    /// Returns the next action, which the caller performs at once. Returns `None` while a task is
    /// running, and while every open step waits: for a signal, for the ledger, or for a holder of
    /// another role that the task names. Sending and receiving a signal end with the return; a task
    /// ends with [`end_task`](Sequencer::end_task).
    pub fn next_action(&mut self) -> Option<SequencerAction> {
        if self.running.is_some() {
            return None;
        }
        let next = self.progress.next_guarded(&self.recorded).map(|(index, step)| (index, step.action.clone()));
        match next {
            Some((step, StepAction::Send(signal))) if signal.kind == SignalKind::Done => {
                Some(self.send_signal(step, signal))
            }
            Some((step, StepAction::Wait(signal))) => {
                self.finish(step);
                Some(SequencerAction::SignalReceived(signal))
            }
            // The current alternative takes precedence over all other tasks until it has ended.
            _ if self.alternatives.current.is_some() => self.next_alternative_task(),
            Some((step, StepAction::Send(signal))) => Some(self.send_signal(step, signal)),
            Some((step, StepAction::Task { id, spec })) => self.start_task(StepRef::Step(step), id, spec),
            None => None,
        }
    }

    fn send_signal(&mut self, step: StepIndex, signal: Signal) -> SequencerAction {
        self.finish(step);
        self.sent.insert(signal.clone());
        SequencerAction::SendSignal(signal)
    }

    fn next_alternative_task(&mut self) -> Option<SequencerAction> {
        let (alternative, task) = self.alternatives.current?;
        let (id, spec) = self.alternative(alternative)?.tasks.get(task)?.clone();
        self.start_task(StepRef::Alternative { alternative, task }, id, spec)
    }

    fn start_task(&mut self, step: StepRef, task: TaskId, spec: TaskSpec) -> Option<SequencerAction> {
        if self.names_vacant_role(&spec) {
            return None;
        }
        self.running = Some(step);
        Some(SequencerAction::StartTask { step, task, spec })
    }

    fn names_vacant_role(&self, spec: &TaskSpec) -> bool {
        let mut vacant = self.latest_awards.keys().filter(|role| !self.holders.contains_key(*role));
        vacant.any(|role| spec.roles.contains(role) || spec.parameters.values().any(|value| value == role.as_str()))
    }

    fn finish(&mut self, step: StepIndex) {
        self.progress.end(step).expect("a returned step may end");
    }

    fn alternative(&self, number: usize) -> Option<&Alternative> {
        self.progress.plan().alternatives.get(number)
    }

    /// Marks the current task as succeeded.
    pub fn end_task(&mut self, step: StepRef) {
        if self.running.take_if(|running| *running == step).is_none() {
            return;
        }
        match step {
            StepRef::Step(step) => self.finish(step),
            StepRef::Alternative { alternative, task } => {
                let tasks = self.alternative(alternative).map_or(0, |replacement| replacement.tasks.len());
                self.alternatives.current = Some((alternative, task + 1));
                if task + 1 >= tasks {
                    self.alternatives.current = None;
                    self.progress.apply_alternative(alternative).expect("the tasks of a started alternative may end");
                }
            }
        }
    }

    /// Aborts the current task. It starts again when the plan continues.
    pub fn abort_task(&mut self) {
        self.running = None;
    }

    /// Replaces the failed current task by the first alternative, in the order of the plan, that
    /// has not been started yet. Returns the index of the alternative. Returns `None` if there is
    /// none; the task is then only aborted.
    pub fn switch_to_alternative(&mut self) -> Option<usize> {
        let failed = self.running.take()?;
        let replaced_steps = match failed {
            StepRef::Step(step) => BTreeSet::from([step]),
            StepRef::Alternative { alternative, .. } => self.alternative(alternative)?.replaces.clone(),
        };
        let mut candidates = self.progress.alternatives_for(*replaced_steps.first()?);
        let (number, _) = candidates.find(|(number, candidate)| {
            !self.alternatives.started.contains(number) && replaced_steps.is_subset(&candidate.replaces)
        })?;
        self.alternatives.started.insert(number);
        self.alternatives.current = Some((number, 0));
        Some(number)
    }

    /// Receives a signal that another role sent under the award of `epoch`. Returns true if it was
    /// awaited and is new.
    ///
    /// # Errors
    /// [`StaleSignal`] if a later award of the sending role is known: the role has another holder.
    /// The state is unchanged.
    pub fn receive_signal(&mut self, signal: &Signal, epoch: Epoch) -> Result<bool, StaleSignal> {
        // Unmanaged roles have no award.
        if let Some(latest) = self.latest_awards.get_mut(&signal.from) {
            match epoch.cmp(latest) {
                Ordering::Less => return Err(StaleSignal { current: *latest }),
                Ordering::Equal => {}
                // The signal of the new holder has arrived before the notice of its award.
                Ordering::Greater => {
                    *latest = epoch;
                    self.progress.discard_signals_from(&signal.from);
                }
            }
        }
        Ok(self.progress.receive(signal))
    }

    /// Receives signals that the ledger contains as sent to this role. Their sender may be gone.
    pub fn receive_recorded(&mut self, signals: &BTreeSet<Signal>) {
        for signal in signals {
            self.progress.receive(signal);
        }
    }

    /// Returns the current task and its specification.
    pub fn current_step(&self) -> Option<(StepRef, &TaskId, &TaskSpec)> {
        let step = self.running?;
        let (id, spec) = match step {
            StepRef::Step(step) => match &self.progress.step(step)?.action {
                StepAction::Task { id, spec } => (id, spec),
                StepAction::Send(_) | StepAction::Wait(_) => return None,
            },
            StepRef::Alternative { alternative, task } => {
                let (id, spec) = self.alternative(alternative)?.tasks.get(task)?;
                (id, spec)
            }
        };
        Some((step, id, spec))
    }

    /// Returns the id of the current task.
    pub fn current_task(&self) -> Option<&TaskId> {
        self.current_step().map(|(_, id, _)| id)
    }

    /// Returns the remaining work, including the current task, as a plan that can be priced.
    pub fn remaining_plan(&self) -> LocalPlan {
        let plan = self.progress.plan();
        let (tasks, replaced) = match self.alternatives.current {
            Some((number, done)) => self.alternative(number).map_or((&[][..], None), |replacement| {
                (replacement.tasks.get(done..).unwrap_or_default(), Some(&replacement.replaces))
            }),
            None => (&[][..], None),
        };
        let first = tasks.iter().map(|(id, spec)| StepAction::Task { id: id.clone(), spec: spec.clone() });
        let open = plan.steps.iter().zip(0..).filter(|(_, step)| {
            !self.progress.ended().contains(step) && replaced.is_none_or(|replaced| !replaced.contains(step))
        });
        let actions = first.chain(open.map(|(step, _)| step.action.clone()));
        let steps = actions.map(|action| Step { action, after: vec![] }).collect();
        LocalPlan::of(plan.role.clone(), steps)
    }

    /// Checks whether this role may have received an item: a guarded step has ended. An item that
    /// was handed on still counts, because the plan does not contain the recipient.
    pub fn may_have_custody(&self) -> bool {
        !self.progress.plan().guarded.is_disjoint(self.progress.ended())
    }

    /// Returns the tasks of an alternative.
    pub fn alternative_tasks(&self, alternative: usize) -> Vec<TaskId> {
        let tasks = self.alternative(alternative).map_or(&[][..], |replacement| &replacement.tasks);
        tasks.iter().map(|(id, _)| id.clone()).collect()
    }

    /// Returns the signals that this role still needs and has not received.
    pub fn awaited_signals(&self) -> BTreeSet<Signal> {
        self.progress.awaited_signals().into_iter().cloned().collect()
    }

    /// Checks whether the next step is blocked only because the ledger is not yet known to contain
    /// the ended steps.
    pub fn awaits_ledger(&self) -> bool {
        self.running.is_none()
            && self.progress.permitted().iter().any(|step| !self.progress.is_guard_met(*step, &self.recorded))
    }

    /// Marks steps as ended in the ledger.
    pub fn set_recorded(&mut self, ended: &BTreeSet<StepIndex>) {
        self.recorded.extend(ended);
    }

    /// Returns the steps that have ended.
    pub fn ended(&self) -> &BTreeSet<StepIndex> {
        self.progress.ended()
    }

    /// Returns the alternatives that were started.
    pub fn alternative_progress(&self) -> &AlternativeProgress {
        &self.alternatives
    }

    /// Returns the signals that this role has sent.
    pub fn sent_signals(&self) -> &BTreeSet<Signal> {
        &self.sent
    }

    /// Checks whether every step has ended.
    pub fn is_complete(&self) -> bool {
        self.progress.is_complete()
    }

    /// Returns the holders of the managed roles.
    pub fn holders(&self) -> &BTreeMap<RoleId, RoleHolder> {
        &self.holders
    }

    /// Updates the holders of the managed roles. Signals of a former holder that were not yet acted
    /// on are discarded, because its successor sends the valid ones again. Returns true if a signal
    /// was discarded: the successor should then be queried.
    pub fn set_holders(&mut self, holders: BTreeMap<RoleId, RoleHolder>) -> bool {
        let mut discarded = false;
        for (role, holding) in &holders {
            let latest = self.latest_awards.entry(role.clone()).or_insert(holding.epoch);
            if *latest < holding.epoch {
                *latest = holding.epoch;
                discarded |= self.progress.discard_signals_from(role);
            }
        }
        self.holders = holders;
        discarded
    }

    /// Updates the managed roles without a holder; some may never have been held. Call
    /// [`set_holders`](Sequencer::set_holders) first.
    pub fn set_vacant_roles(&mut self, vacant: &BTreeSet<RoleId>) {
        for role in vacant {
            self.latest_awards.entry(role.clone()).or_default();
        }
    }

    /// Returns the robots that hold the managed roles.
    pub fn holder_robots(&self) -> BTreeMap<RoleId, RobotId> {
        RoleHolder::robots(&self.holders)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn plan(value: serde_json::Value) -> LocalPlan {
        serde_json::from_value(value).unwrap()
    }

    fn task(id: &str, after: &[u32]) -> serde_json::Value {
        json!({ "action": { "Task": { "id": id, "spec": { "type": id, "roles": ["r1"] } } }, "after": after })
    }

    fn send(task: &str, after: &[u32]) -> serde_json::Value {
        json!({ "action": { "Send": { "kind": "done", "task": task, "from": "r1", "to": "arm" } }, "after": after })
    }

    fn wait(task: &str, after: &[u32]) -> serde_json::Value {
        json!({ "action": { "Wait": { "kind": "done", "task": task, "from": "arm", "to": "r1" } }, "after": after })
    }

    fn alternative_json(replaces: &[u32], tasks: &[&str]) -> serde_json::Value {
        let tasks: Vec<_> = tasks.iter().map(|id| json!([id, { "type": id, "roles": ["r1"] }])).collect();
        json!({ "replaces": replaces, "tasks": tasks })
    }

    fn held(epochs: &[(&str, u64)]) -> BTreeMap<RoleId, RoleHolder> {
        let holding =
            |index: &u64| RoleHolder { robot: "ada".parse().unwrap(), epoch: Epoch { term: 1, index: *index } };
        epochs.iter().map(|(role, index)| (role.parse().unwrap(), holding(index))).collect()
    }

    fn at(index: u64) -> Epoch {
        Epoch { term: 1, index }
    }

    fn sequencer(plan: LocalPlan) -> Sequencer {
        Sequencer::new(plan, &BTreeSet::new(), held(&[("r1", 5), ("arm", 5)])).unwrap()
    }

    /// Executes until a task of `fails` is next. Returns the names of the actions performed.
    fn run(sequencer: &mut Sequencer, fails: &[&str]) -> Vec<String> {
        let mut done = vec![];
        while let Some(next) = sequencer.next_action() {
            match next {
                SequencerAction::StartTask { task, .. } if fails.contains(&task.as_str()) => break,
                SequencerAction::StartTask { step, task, .. } => {
                    sequencer.end_task(step);
                    done.push(task.to_string());
                }
                SequencerAction::SendSignal(signal) => done.push(format!("sent {}", signal.task)),
                SequencerAction::SignalReceived(signal) => done.push(format!("received {}", signal.task)),
            }
        }
        done
    }

    #[test]
    fn a_task_waits_until_the_role_it_names_has_a_holder_again() {
        let step = json!({ "action": { "Task": { "id": "meet", "spec": {
            "type": "approach_robot", "roles": ["r1"], "parameters": { "robot_role": "arm" } } } }, "after": [] });
        let mut sequencer = sequencer(plan(json!({ "role": "r1", "steps": [step] })));
        sequencer.set_holders(held(&[("r1", 5)]));
        assert_eq!(sequencer.next_action(), None);
        sequencer.set_holders(held(&[("r1", 5), ("arm", 6)]));
        assert!(matches!(sequencer.next_action(), Some(SequencerAction::StartTask { step: StepRef::Step(0), .. })));
    }

    #[test]
    fn a_task_waits_for_the_first_holder_of_the_role_it_names() {
        let step = |named: &str| {
            let spec = json!({ "type": "deposit", "roles": ["nurse"], "parameters": { "into_role": named } });
            json!({ "action": { "Task": { "id": "deposit", "spec": spec } }, "after": [] })
        };
        let sequencer_with = |named| {
            let plan = plan(json!({ "role": "nurse", "steps": [step(named)] }));
            let mut sequencer = Sequencer::new(plan, &BTreeSet::new(), held(&[("arm", 5)])).unwrap();
            sequencer.set_vacant_roles(&BTreeSet::from(["r1".parse().unwrap()]));
            sequencer
        };
        let mut waits = sequencer_with("r1");
        assert_eq!(waits.next_action(), None);
        assert!(!waits.set_holders(held(&[("arm", 5), ("r1", 6)])), "no signal was received before");
        waits.set_vacant_roles(&BTreeSet::new());
        assert!(matches!(waits.next_action(), Some(SequencerAction::StartTask { step: StepRef::Step(0), .. })));
        let starts = |named| matches!(sequencer_with(named).next_action(), Some(SequencerAction::StartTask { .. }));
        assert!(starts("arm") && starts("r3"), "arm has a holder, and r3 is not a role of the mission");
    }

    #[test]
    fn alternatives_are_tried_in_order_and_end_the_steps_they_replace() {
        let steps = [task("drive", &[]), task("knock", &[0]), task("enter", &[1]), send("enter", &[2])];
        let alternatives = [
            alternative_json(&[1], &["ring"]),
            alternative_json(&[1], &["call"]),
            alternative_json(&[0, 1, 2], &["lift", "descend"]),
        ];
        let plan = plan(json!({ "role": "r1", "steps": steps, "alternatives": alternatives }));
        let mut sequencer = sequencer(plan.clone());
        assert_eq!(run(&mut sequencer, &["knock"]), ["drive"]);
        assert_eq!(sequencer.switch_to_alternative(), Some(0));
        assert_eq!(run(&mut sequencer, &["ring"]), [""; 0]);
        assert_eq!(sequencer.switch_to_alternative(), Some(1));
        let second_alternative = sequencer.clone();
        assert_eq!(run(&mut sequencer, &["enter"]), ["call"]);
        assert_eq!(*sequencer.ended(), BTreeSet::from([0, 1]));
        assert_eq!(sequencer.switch_to_alternative(), Some(2), "the alternative to all steps");
        assert_eq!(run(&mut sequencer, &[]), ["lift", "descend", "sent enter"]);
        assert!(sequencer.is_complete());

        let mut stuck = second_alternative;
        run(&mut stuck, &["call"]);
        assert_eq!(stuck.switch_to_alternative(), Some(2), "the alternative of a replaced step is replaced, too");
        assert_eq!(run(&mut stuck, &["lift"]), [""; 0]);
        assert_eq!(stuck.switch_to_alternative(), None, "an alternative starts at most once");
    }

    #[test]
    fn a_restored_alternative_continues_unless_its_steps_have_ended() {
        let alternatives = [alternative_json(&[0], &["lift", "descend"])];
        let steps = [task("drive", &[]), task("knock", &[0])];
        let plan = plan(json!({ "role": "r1", "steps": steps, "alternatives": alternatives }));
        let mut former = sequencer(plan.clone());
        run(&mut former, &["drive"]);
        former.switch_to_alternative();
        run(&mut former, &["descend"]);
        let none = BTreeSet::new();
        let resume = |recorded: &BTreeSet<u32>| {
            Sequencer::resume(
                plan.clone(),
                recorded,
                former.ended(),
                former.alternative_progress().clone(),
                held(&[("r1", 5)]),
            )
            .unwrap()
        };
        assert_eq!(run(&mut resume(&none), &[]), ["descend", "knock"]);
        assert_eq!(run(&mut resume(&BTreeSet::from([0])), &[]), ["knock"]);
    }

    #[test]
    fn the_remaining_plan_has_the_alternative_and_no_replaced_steps() {
        let steps = [task("drive", &[]), task("knock", &[0]), task("enter", &[1])];
        let plan =
            plan(json!({ "role": "r1", "steps": steps, "alternatives": [alternative_json(&[1], &["ring", "call"])] }));
        let mut sequencer = sequencer(plan);
        let rest = |sequencer: &Sequencer| {
            sequencer.remaining_plan().tasks().map(|(id, _)| id.to_string()).collect::<Vec<_>>()
        };
        run(&mut sequencer, &["knock"]);
        assert_eq!(rest(&sequencer), ["knock", "enter"]);
        sequencer.switch_to_alternative();
        run(&mut sequencer, &["call"]);
        assert_eq!(rest(&sequencer), ["call", "enter"]);
    }

    #[test]
    fn a_guarded_step_waits_until_the_ledger_contains_its_predecessors() {
        let steps = [task("open", &[]), send("open", &[0]), task("close", &[1])];
        let plan = plan(json!({ "role": "r1", "steps": steps, "guarded": [1] }));
        let mut sequencer = sequencer(plan);
        assert_eq!(run(&mut sequencer, &[]), ["open"]);
        assert!(sequencer.awaits_ledger() && !sequencer.may_have_custody());
        sequencer.set_recorded(&BTreeSet::from([0]));
        assert!(!sequencer.awaits_ledger());
        assert_eq!(run(&mut sequencer, &[]), ["sent open", "close"]);
        assert!(sequencer.may_have_custody());
    }

    #[test]
    fn a_stale_signal_is_rejected_and_an_unused_signal_is_discarded() {
        let signal: Signal =
            serde_json::from_value(json!({ "kind": "done", "task": "lift", "from": "arm", "to": "r1" })).unwrap();
        let steps = [task("drive", &[]), wait("lift", &[0])];
        let mut sequencer = sequencer(plan(json!({ "role": "r1", "steps": steps })));
        assert_eq!(sequencer.receive_signal(&signal, at(4)), Err(StaleSignal { current: at(5) }));
        assert_eq!(sequencer.receive_signal(&signal, at(5)), Ok(true));
        assert!(!sequencer.set_holders(held(&[("r1", 5)])), "the role has no new holder yet");
        assert!(sequencer.set_holders(held(&[("r1", 5), ("arm", 9)])));
        assert_eq!(run(&mut sequencer, &[]), ["drive"]);
        assert_eq!(sequencer.receive_signal(&signal, at(5)), Err(StaleSignal { current: at(9) }));
        assert_eq!(sequencer.receive_signal(&signal, at(9)), Ok(true));
        assert_eq!(run(&mut sequencer, &[]), ["received lift"]);
    }

    #[test]
    fn an_unmanaged_role_has_no_award() {
        let signal: Signal =
            serde_json::from_value(json!({ "kind": "done", "task": "lift", "from": "arm", "to": "r1" })).unwrap();
        let plan = plan(json!({ "role": "r1", "steps": [wait("lift", &[])] }));
        let mut sequencer = Sequencer::new(plan, &BTreeSet::new(), held(&[("r1", 5)])).unwrap();
        assert_eq!(sequencer.receive_signal(&signal, Epoch::default()), Ok(true));
    }
}
