//! Which step of its local plan a role takes next (Algorithm 2 of the thesis), as a value.

use consort_protocol::ids::{RobotId, RoleId, TaskId};
use consort_protocol::lease::{Epoch, RoleHolder};
use consort_protocol::mission::TaskSpec;
use consort_protocol::plan::{
    Alternative, LocalPlan, PlanProgress, ProgressError, Signal, SignalKind, Step, StepAction, StepIndex,
};
use serde::{Deserialize, Serialize};
use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};

/// A plan on its way: what has ended, what is under way, what comes next.
#[derive(Debug, Clone)]
pub struct Sequencer {
    progress: PlanProgress,
    /// The task under way.
    running: Option<StepRef>,
    detours: AlternativeProgress,
    /// Steps that the ledger is known to hold.
    known: BTreeSet<StepIndex>,
    /// Who holds the mission's managed roles.
    holders: BTreeMap<RoleId, RoleHolder>,
    /// Roles that somebody has held or is to hold, and the latest award of each, the default before the first: one that
    /// nobody holds now is being given to somebody.
    cast: BTreeMap<RoleId, Epoch>,
    /// What this role has told others.
    said: BTreeSet<Signal>,
}

/// Where a task stands in a plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum StepRef {
    /// A step of it.
    Step(StepIndex),
    /// A task of one of its alternatives.
    Alternative {
        /// Which alternative.
        alternative: usize,
        /// Which of its tasks.
        task: usize,
    },
}

/// The alternatives that a role has resorted to.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlternativeProgress {
    /// Those begun so far: none is begun twice.
    begun: BTreeSet<usize>,
    /// The one under way, and how many of its tasks have ended.
    under_way: Option<(usize, usize)>,
}

/// What to do next.
#[derive(Debug, Clone, PartialEq)]
pub enum SequencerAction {
    /// Begin a task.
    StartTask {
        /// Where it stands.
        step: StepRef,
        /// Its name.
        task: TaskId,
        /// What is to be achieved.
        spec: TaskSpec,
    },
    /// Tell another role.
    SendSignal(Signal),
    /// What was waited for has been heard.
    SignalReceived(Signal),
}

/// Something said under an award that is no longer in force. Nobody goes by it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StaleSignal {
    /// The latest award of that role which is known.
    pub current: Epoch,
}

impl Sequencer {
    /// Takes up a plan of which some steps have ended already, as the ledger says.
    ///
    /// # Errors
    /// [`ProgressError`] when those steps cannot have ended so.
    pub fn new(
        plan: LocalPlan,
        ended: &BTreeSet<StepIndex>,
        holders: BTreeMap<RoleId, RoleHolder>,
    ) -> Result<Sequencer, ProgressError> {
        Sequencer::resume(plan, ended, &BTreeSet::new(), AlternativeProgress::default(), holders)
    }

    /// Takes up a plan where a former life left it: it may have come further than the ledger knows, or less far than it
    /// had written down.
    ///
    /// # Errors
    /// As for [`new`](Sequencer::new).
    pub fn resume(
        plan: LocalPlan,
        known: &BTreeSet<StepIndex>,
        own: &BTreeSet<StepIndex>,
        mut detours: AlternativeProgress,
        holders: BTreeMap<RoleId, RoleHolder>,
    ) -> Result<Sequencer, ProgressError> {
        let ended: BTreeSet<StepIndex> = known.union(own).copied().collect();
        let said = ended.iter().filter_map(|step| match &plan.steps.get(*step as usize)?.action {
            StepAction::Send(signal) => Some(signal.clone()),
            StepAction::Wait(_) | StepAction::Task { .. } => None,
        });
        let said = said.collect();
        let progress = PlanProgress::restore(plan, ended, BTreeSet::new())?;
        detours.under_way = detours.under_way.filter(|(alternative, _)| {
            let detour = progress.plan().alternatives.get(*alternative);
            detour.is_some_and(|detour| !detour.replaces.is_subset(progress.ended()))
        });
        let cast = holders.iter().map(|(role, holding)| (role.clone(), holding.epoch)).collect();
        Ok(Sequencer { progress, running: None, detours, known: known.clone(), holders, cast, said })
    }

    /// The next thing to do, which the caller does at once; `None` while a task is under way or all is waiting, be it for
    /// a signal, for the ledger or, in a task that names another role, for somebody to hold that role. Telling
    /// and hearing end with being returned; a task ends with [`end`](Sequencer::end).
    pub fn next_action(&mut self) -> Option<SequencerAction> {
        if self.running.is_some() {
            return None;
        }
        let next = self.progress.next_guarded(&self.known).map(|(index, step)| (index, step.action.clone()));
        match next {
            Some((step, StepAction::Send(signal))) if signal.kind == SignalKind::Done => Some(self.tell(step, signal)),
            Some((step, StepAction::Wait(signal))) => {
                self.finish(step);
                Some(SequencerAction::SignalReceived(signal))
            }
            // A detour takes the place of all tasks until it has ended.
            _ if self.detours.under_way.is_some() => self.next_aside(),
            Some((step, StepAction::Send(signal))) => Some(self.tell(step, signal)),
            Some((step, StepAction::Task { id, spec })) => self.perform(StepRef::Step(step), id, spec),
            None => None,
        }
    }

    fn tell(&mut self, step: StepIndex, signal: Signal) -> SequencerAction {
        self.finish(step);
        self.said.insert(signal.clone());
        SequencerAction::SendSignal(signal)
    }

    fn next_aside(&mut self) -> Option<SequencerAction> {
        let (alternative, task) = self.detours.under_way?;
        let (id, spec) = self.alternative(alternative)?.tasks.get(task)?.clone();
        self.perform(StepRef::Alternative { alternative, task }, id, spec)
    }

    fn perform(&mut self, spot: StepRef, task: TaskId, spec: TaskSpec) -> Option<SequencerAction> {
        if self.names_a_vacancy(&spec) {
            return None;
        }
        self.running = Some(spot);
        Some(SequencerAction::StartTask { step: spot, task, spec })
    }

    fn names_a_vacancy(&self, spec: &TaskSpec) -> bool {
        let mut vacant = self.cast.keys().filter(|role| !self.holders.contains_key(*role));
        vacant.any(|role| spec.roles.contains(role) || spec.parameters.values().any(|value| value == role.as_str()))
    }

    fn finish(&mut self, step: StepIndex) {
        self.progress.end(step).expect("a step that was given out may end");
    }

    fn alternative(&self, number: usize) -> Option<&Alternative> {
        self.progress.plan().alternatives.get(number)
    }

    /// The task under way has ended well.
    pub fn end_task(&mut self, spot: StepRef) {
        if self.running.take_if(|running| *running == spot).is_none() {
            return;
        }
        match spot {
            StepRef::Step(step) => self.finish(step),
            StepRef::Alternative { alternative, task } => {
                let tasks = self.alternative(alternative).map_or(0, |detour| detour.tasks.len());
                self.detours.under_way = Some((alternative, task + 1));
                if task + 1 >= tasks {
                    self.detours.under_way = None;
                    self.progress.apply_alternative(alternative).expect("tasks of one of which was under way may end");
                }
            }
        }
    }

    /// The task under way was broken off; it is begun anew when the plan goes on.
    pub fn abort_task(&mut self) {
        self.running = None;
    }

    /// The task under way failed for good: the first alternative to it that was not begun before, in the order of the plan,
    /// takes its place. Its number; `None` when there is none, and the task is merely broken off.
    pub fn switch_to_alternative(&mut self) -> Option<usize> {
        let failed = self.running.take()?;
        let in_place_of = match failed {
            StepRef::Step(step) => BTreeSet::from([step]),
            StepRef::Alternative { alternative, .. } => self.alternative(alternative)?.replaces.clone(),
        };
        let mut others = self.progress.alternatives_for(*in_place_of.first()?);
        let (number, _) = others
            .find(|(number, other)| !self.detours.begun.contains(number) && in_place_of.is_subset(&other.replaces))?;
        self.detours.begun.insert(number);
        self.detours.under_way = Some((number, 0));
        Some(number)
    }

    /// Another role has said this under the award of `epoch`. True if it was awaited and is news.
    ///
    /// # Errors
    /// [`Outdated`] when a later award of that role is known: it is somebody else's by now. Nothing is changed.
    pub fn receive_signal(&mut self, signal: &Signal, epoch: Epoch) -> Result<bool, StaleSignal> {
        // Unmanaged roles are nobody's award.
        if let Some(known) = self.cast.get_mut(&signal.from) {
            match epoch.cmp(known) {
                Ordering::Less => return Err(StaleSignal { current: *known }),
                Ordering::Equal => {}
                // The word of a successor before word of it.
                Ordering::Greater => {
                    *known = epoch;
                    self.progress.discard_signals_from(&signal.from);
                }
            }
        }
        Ok(self.progress.receive(signal))
    }

    /// The ledger says that this role was told so: whoever said it may be gone.
    pub fn receive_recorded(&mut self, told: &BTreeSet<Signal>) {
        for signal in told {
            self.progress.receive(signal);
        }
    }

    /// The task under way, and what is to be achieved.
    pub fn current_step(&self) -> Option<(StepRef, &TaskId, &TaskSpec)> {
        let spot = self.running?;
        let (id, spec) = match spot {
            StepRef::Step(step) => match &self.progress.step(step)?.action {
                StepAction::Task { id, spec } => (id, spec),
                StepAction::Send(_) | StepAction::Wait(_) => return None,
            },
            StepRef::Alternative { alternative, task } => {
                let (id, spec) = self.alternative(alternative)?.tasks.get(task)?;
                (id, spec)
            }
        };
        Some((spot, id, spec))
    }

    /// The name of the task under way.
    pub fn current_task(&self) -> Option<&TaskId> {
        self.current_step().map(|(_, id, _)| id)
    }

    /// What is still to be done, the task under way included, as a plan of its own to be priced.
    pub fn remaining_plan(&self) -> LocalPlan {
        let plan = self.progress.plan();
        let (aside, replaced) = match self.detours.under_way {
            Some((number, done)) => self.alternative(number).map_or((&[][..], None), |detour| {
                (detour.tasks.get(done..).unwrap_or_default(), Some(&detour.replaces))
            }),
            None => (&[][..], None),
        };
        let first = aside.iter().map(|(id, spec)| StepAction::Task { id: id.clone(), spec: spec.clone() });
        let open = plan.steps.iter().zip(0..).filter(|(_, step)| {
            !self.progress.ended().contains(step) && replaced.is_none_or(|replaced| !replaced.contains(step))
        });
        let actions = first.chain(open.map(|(step, _)| step.action.clone()));
        let steps = actions.map(|action| Step { action, after: vec![] }).collect();
        LocalPlan::of(plan.role.clone(), steps)
    }

    /// Whether an item may have come into the hands of this role: a guarded step has ended. Said of the past: what was
    /// handed on since still counts, since the plan does not tell who received it.
    pub fn may_have_custody(&self) -> bool {
        !self.progress.plan().guarded.is_disjoint(self.progress.ended())
    }

    /// The tasks of an alternative, by its number.
    pub fn alternative_tasks(&self, alternative: usize) -> Vec<TaskId> {
        let tasks = self.alternative(alternative).map_or(&[][..], |detour| &detour.tasks);
        tasks.iter().map(|(id, _)| id.clone()).collect()
    }

    /// Signals that this role will yet need and has not heard.
    pub fn awaited_signals(&self) -> BTreeSet<Signal> {
        self.progress.awaited_signals().into_iter().cloned().collect()
    }

    /// Whether something could be done if only the ledger were known to hold what has ended.
    pub fn awaits_ledger(&self) -> bool {
        self.running.is_none()
            && self.progress.permitted().iter().any(|step| !self.progress.is_guard_met(*step, &self.known))
    }

    /// The ledger holds these steps of the plan as ended.
    pub fn set_recorded(&mut self, ended: &BTreeSet<StepIndex>) {
        self.known.extend(ended);
    }

    /// Steps that have ended.
    pub fn ended(&self) -> &BTreeSet<StepIndex> {
        self.progress.ended()
    }

    /// The alternatives that were begun.
    pub fn alternative_progress(&self) -> &AlternativeProgress {
        &self.detours
    }

    /// What this role has told others.
    pub fn sent_signals(&self) -> &BTreeSet<Signal> {
        &self.said
    }

    /// Whether every step has ended.
    pub fn is_complete(&self) -> bool {
        self.progress.is_complete()
    }

    /// Who holds the managed roles.
    pub fn holders(&self) -> &BTreeMap<RoleId, RoleHolder> {
        &self.holders
    }

    /// Takes in who holds the managed roles now. What a former holder had said and was not yet acted on no longer holds: its
    /// successor says what still does. True if there was such a thing, so that the successor is worth asking.
    pub fn set_holders(&mut self, holders: BTreeMap<RoleId, RoleHolder>) -> bool {
        let mut forgotten = false;
        for (role, holding) in &holders {
            let former = self.cast.entry(role.clone()).or_insert(holding.epoch);
            if *former < holding.epoch {
                *former = holding.epoch;
                forgotten |= self.progress.discard_signals_from(role);
            }
        }
        self.holders = holders;
        forgotten
    }

    /// Takes in which managed roles nobody holds: some may never have been held. Who holds a role is told before.
    pub fn set_vacant_roles(&mut self, vacant: &BTreeSet<RoleId>) {
        for role in vacant {
            self.cast.entry(role.clone()).or_default();
        }
    }

    /// The robots alone.
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

    fn aside(replaces: &[u32], tasks: &[&str]) -> serde_json::Value {
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

    /// Performs until `fails` is at hand; the names of what was done.
    fn run(sequencer: &mut Sequencer, fails: &[&str]) -> Vec<String> {
        let mut done = vec![];
        while let Some(next) = sequencer.next_action() {
            match next {
                SequencerAction::StartTask { task, .. } if fails.contains(&task.as_str()) => break,
                SequencerAction::StartTask { step: spot, task, .. } => {
                    sequencer.end_task(spot);
                    done.push(task.to_string());
                }
                SequencerAction::SendSignal(signal) => done.push(format!("tell {}", signal.task)),
                SequencerAction::SignalReceived(signal) => done.push(format!("heard {}", signal.task)),
            }
        }
        done
    }

    #[test]
    fn a_task_that_names_a_role_begins_once_somebody_holds_that_role_again() {
        let step = json!({ "action": { "Task": { "id": "meet", "spec": {
            "type": "approach_robot", "roles": ["r1"], "parameters": { "robot_role": "arm" } } } }, "after": [] });
        let mut sequencer = sequencer(plan(json!({ "role": "r1", "steps": [step] })));
        sequencer.set_holders(held(&[("r1", 5)]));
        assert_eq!(sequencer.next_action(), None);
        sequencer.set_holders(held(&[("r1", 5), ("arm", 6)]));
        assert!(matches!(sequencer.next_action(), Some(SequencerAction::StartTask { step: StepRef::Step(0), .. })));
    }

    #[test]
    fn a_task_that_names_a_role_which_nobody_has_held_yet_begins_once_somebody_does() {
        let step = |named: &str| {
            let spec = json!({ "type": "deposit", "roles": ["nurse"], "parameters": { "into_role": named } });
            json!({ "action": { "Task": { "id": "deposit", "spec": spec } }, "after": [] })
        };
        let taken_up = |named| {
            let plan = plan(json!({ "role": "nurse", "steps": [step(named)] }));
            let mut sequencer = Sequencer::new(plan, &BTreeSet::new(), held(&[("arm", 5)])).unwrap();
            sequencer.set_vacant_roles(&BTreeSet::from(["r1".parse().unwrap()]));
            sequencer
        };
        let mut waits = taken_up("r1");
        assert_eq!(waits.next_action(), None);
        assert!(!waits.set_holders(held(&[("arm", 5), ("r1", 6)])), "nobody has said anything before");
        waits.set_vacant_roles(&BTreeSet::new());
        assert!(matches!(waits.next_action(), Some(SequencerAction::StartTask { step: StepRef::Step(0), .. })));
        let begins = |named| matches!(taken_up(named).next_action(), Some(SequencerAction::StartTask { .. }));
        assert!(begins("arm") && begins("r3"), "that role is held, and this one is none that anybody could hold");
    }

    #[test]
    fn alternatives_are_tried_in_their_order_and_the_steps_they_replace_have_then_ended() {
        let steps = [task("drive", &[]), task("knock", &[0]), task("enter", &[1]), send("enter", &[2])];
        let alternatives = [aside(&[1], &["ring"]), aside(&[1], &["call"]), aside(&[0, 1, 2], &["lift", "descend"])];
        let plan = plan(json!({ "role": "r1", "steps": steps, "alternatives": alternatives }));
        let mut sequencer = sequencer(plan.clone());
        assert_eq!(run(&mut sequencer, &["knock"]), ["drive"]);
        assert_eq!(sequencer.switch_to_alternative(), Some(0));
        assert_eq!(run(&mut sequencer, &["ring"]), [""; 0]);
        assert_eq!(sequencer.switch_to_alternative(), Some(1));
        let halfway = sequencer.clone();
        assert_eq!(run(&mut sequencer, &["enter"]), ["call"]);
        assert_eq!(*sequencer.ended(), BTreeSet::from([0, 1]));
        assert_eq!(sequencer.switch_to_alternative(), Some(2), "a way around all of it");
        assert_eq!(run(&mut sequencer, &[]), ["lift", "descend", "tell enter"]);
        assert!(sequencer.is_complete());

        let mut stuck = halfway;
        run(&mut stuck, &["call"]);
        assert_eq!(stuck.switch_to_alternative(), Some(2), "what replaces one step is replaced with it");
        assert_eq!(run(&mut stuck, &["lift"]), [""; 0]);
        assert_eq!(stuck.switch_to_alternative(), None, "none is begun twice");
    }

    #[test]
    fn a_former_lifes_detour_is_taken_up_where_it_was_unless_its_steps_have_ended() {
        let alternatives = [aside(&[0], &["lift", "descend"])];
        let steps = [task("drive", &[]), task("knock", &[0])];
        let plan = plan(json!({ "role": "r1", "steps": steps, "alternatives": alternatives }));
        let mut former = sequencer(plan.clone());
        run(&mut former, &["drive"]);
        former.switch_to_alternative();
        run(&mut former, &["descend"]);
        let none = BTreeSet::new();
        let resume = |known: &BTreeSet<u32>| {
            Sequencer::resume(
                plan.clone(),
                known,
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
    fn what_is_left_is_priced_with_the_detour_and_without_what_it_replaces() {
        let steps = [task("drive", &[]), task("knock", &[0]), task("enter", &[1])];
        let plan = plan(json!({ "role": "r1", "steps": steps, "alternatives": [aside(&[1], &["ring", "call"])] }));
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
    fn a_guarded_step_waits_until_the_ledger_holds_what_came_before_it() {
        let steps = [task("open", &[]), send("open", &[0]), task("close", &[1])];
        let plan = plan(json!({ "role": "r1", "steps": steps, "guarded": [1] }));
        let mut sequencer = sequencer(plan);
        assert_eq!(run(&mut sequencer, &[]), ["open"]);
        assert!(sequencer.awaits_ledger() && !sequencer.may_have_custody());
        sequencer.set_recorded(&BTreeSet::from([0]));
        assert!(!sequencer.awaits_ledger());
        assert_eq!(run(&mut sequencer, &[]), ["tell open", "close"]);
        assert!(sequencer.may_have_custody());
    }

    #[test]
    fn what_is_said_under_an_older_award_is_not_heard_and_what_was_not_acted_on_is_forgotten() {
        let signal: Signal =
            serde_json::from_value(json!({ "kind": "done", "task": "lift", "from": "arm", "to": "r1" })).unwrap();
        let steps = [task("drive", &[]), wait("lift", &[0])];
        let mut sequencer = sequencer(plan(json!({ "role": "r1", "steps": steps })));
        assert_eq!(sequencer.receive_signal(&signal, at(4)), Err(StaleSignal { current: at(5) }));
        assert_eq!(sequencer.receive_signal(&signal, at(5)), Ok(true));
        assert!(!sequencer.set_holders(held(&[("r1", 5)])), "nobody has taken its place yet");
        assert!(sequencer.set_holders(held(&[("r1", 5), ("arm", 9)])));
        assert_eq!(run(&mut sequencer, &[]), ["drive"]);
        assert_eq!(sequencer.receive_signal(&signal, at(5)), Err(StaleSignal { current: at(9) }));
        assert_eq!(sequencer.receive_signal(&signal, at(9)), Ok(true));
        assert_eq!(run(&mut sequencer, &[]), ["heard lift"]);
    }

    #[test]
    fn an_unmanaged_role_is_nobodys_award() {
        let signal: Signal =
            serde_json::from_value(json!({ "kind": "done", "task": "lift", "from": "arm", "to": "r1" })).unwrap();
        let plan = plan(json!({ "role": "r1", "steps": [wait("lift", &[])] }));
        let mut sequencer = Sequencer::new(plan, &BTreeSet::new(), held(&[("r1", 5)])).unwrap();
        assert_eq!(sequencer.receive_signal(&signal, Epoch::default()), Ok(true));
    }
}
