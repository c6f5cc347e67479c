//! Observes all nodes of a trial, and sets the speed of robots according to the travel model.

use consort_evaluation::calibration::Observation;
use consort_evaluation::design::ScenarioRobot;
use consort_evaluation::seeds::generator;
use consort_evaluation::success_estimate::start_context;
use consort_evaluation::travel::TravelModel;
use consort_fleet::observe::Observer;
use consort_protocol::auction::{AuctionRecord, BidVerdict};
use consort_protocol::event::{Event, EventKind};
use consort_protocol::ids::{NodeId, RobotId, RoleId, TaskId, TaskType};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Command, MissionState};
use consort_protocol::mission::TaskSpec;
use consort_protocol::units::MetresPerSecond;
use consort_skills::actions::RobotBackend;
use consort_skills::descriptor::{EstimateContext, Estimator};
use consort_world::SharedWorld;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;
use tokio::time::Instant;

/// Settings of an observer.
pub(super) struct ObserverSettings {
    pub(super) world: SharedWorld,
    /// World seconds per second of the fleet's time.
    pub(super) speed: f64,
    /// Seed of the drives.
    pub(super) seed: u64,
    pub(super) travel: TravelModel,
    /// The estimator of the robots.
    pub(super) estimator: Arc<Estimator>,
    /// The robots that drive.
    pub(super) robots: BTreeMap<RobotId, ScenarioRobot>,
    /// Skills of every robot.
    pub(super) skills: BTreeMap<RobotId, BTreeSet<TaskType>>,
    /// The tasks of managed roles.
    pub(super) tasks: BTreeMap<TaskId, TaskSpec>,
}

/// Observer of a trial. Clones share their state.
#[derive(Clone)]
pub(super) struct TrialObserver {
    settings: Arc<ObserverSettings>,
    observed: Arc<Mutex<TrialState>>,
    changed: watch::Sender<u64>,
}

/// Observations so far.
#[derive(Default)]
pub(super) struct TrialState {
    /// Start of the world.
    started: Option<Instant>,
    /// Current robot of each role.
    pub(super) holders: BTreeMap<RoleId, RobotId>,
    /// Time at which robots last lost a role.
    lost_role_at: BTreeMap<RobotId, f64>,
    /// Robots of the first award.
    pub(super) first_holders: BTreeMap<RoleId, RobotId>,
    /// Every robot that held a role at any time.
    pub(super) ever_assigned: BTreeSet<RobotId>,
    /// Longest time in the bids of the first award, in seconds.
    pub(super) predicted_s: Option<f64>,
    /// Latest auction that filled its roles.
    record: Option<AuctionRecord>,
    /// The first task begun without the skill: time, robot and task type.
    pub(super) unskilled: Option<(f64, RobotId, TaskType)>,
    /// Robots that held a role with an empty battery, with the time.
    pub(super) depleted: BTreeMap<RobotId, f64>,
    /// Final state of the mission.
    pub(super) end_state: Option<MissionState>,
    /// Causes of role releases.
    pub(super) releases: Vec<String>,
    /// The last task that a managed role began.
    pub(super) last_task: Option<TaskId>,
    running_tasks: BTreeMap<RobotId, RunningTask>,
    /// Tasks with a failure or a retry, which give no observation.
    disturbed: BTreeSet<(RobotId, TaskId)>,
    pub(super) observations: Vec<Observation>,
}

impl TrialState {
    /// Checks whether a robot held a role shortly before. A robot that stops with an empty battery
    /// loses its role within a message or two, possibly before this observer processes the battery
    /// event.
    pub(super) fn held_role_at(&self, robot: &RobotId, at_s: f64) -> bool {
        self.holders.values().any(|holder| holder == robot)
            || self.lost_role_at.get(robot).is_some_and(|end| *end >= at_s)
    }
}

struct RunningTask {
    task: TaskId,
    began_s: f64,
    charge: f64,
    predicted: Observation,
}

impl TrialObserver {
    pub(super) fn new(settings: ObserverSettings) -> TrialObserver {
        TrialObserver { settings: Arc::new(settings), observed: Arc::default(), changed: watch::Sender::new(0) }
    }

    /// Starts the clock of the world.
    pub(super) fn start_clock(&self) {
        self.state().started = Some(Instant::now());
    }

    /// Returns the world time in seconds. It advances also while nothing happens in the world.
    pub(super) fn now_s(&self) -> f64 {
        self.world_time_s(&self.state())
    }

    fn world_time_s(&self, observed: &TrialState) -> f64 {
        observed.started.map_or(0.0, |started| started.elapsed().as_secs_f64() * self.settings.speed)
    }

    /// Returns a receiver that changes with every new observation.
    pub(super) fn changed(&self) -> watch::Receiver<u64> {
        self.changed.subscribe()
    }

    pub(super) fn state(&self) -> MutexGuard<'_, TrialState> {
        self.observed.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn observe(&self, node: &NodeId, what: &EventKind) {
        let mut observed = self.state();
        let now_s = self.world_time_s(&observed);
        match what {
            EventKind::Closed { record, .. } if record.failure.is_none() => observed.record = Some(record.clone()),
            EventKind::Awarded { holders, .. } => self.awarded(&mut observed, holders, now_s),
            EventKind::Released { role, cause, .. } => {
                if let Some(robot) = observed.holders.remove(role) {
                    observed.lost_role_at.insert(robot, now_s);
                }
                observed.releases.push(format!("{role}: {cause}"));
            }
            EventKind::Mission { state, .. } if state.is_final() => observed.end_state = Some(state.clone()),
            EventKind::TaskBegan { task, .. } => {
                self.task_began(&mut observed, &RobotId::from(node.clone()), task, now_s);
            }
            EventKind::TaskEnded { task, .. } => {
                self.task_ended(&mut observed, &RobotId::from(node.clone()), task, now_s);
            }
            EventKind::Suspended { .. } | EventKind::TaskRetried { .. } => {
                let robot = RobotId::from(node.clone());
                if let Some(running_tasks) = observed.running_tasks.remove(&robot) {
                    observed.disturbed.insert((robot, running_tasks.task));
                }
            }
            _ => return,
        }
        drop(observed);
        self.changed.send_modify(|count| *count += 1);
    }

    fn awarded(&self, observed: &mut TrialState, holders: &BTreeMap<RoleId, RobotId>, now_s: f64) {
        for robot in holders.values().filter(|robot| self.settings.robots.contains_key(*robot)) {
            observed.ever_assigned.insert(robot.clone());
            let able = self.settings.world.telemetry(robot).is_none_or(|report| report.able);
            if !able {
                observed.depleted.entry(robot.clone()).or_insert(now_s);
            }
        }
        if observed.first_holders.is_empty() {
            observed.first_holders = holders.clone();
            let times = observed.record.iter().flat_map(|record| &record.entries).filter_map(|entry| {
                let chosen = holders.get(&entry.role) == Some(&entry.robot);
                match &entry.verdict {
                    BidVerdict::Viable { time, .. } | BidVerdict::Unviable { time, .. } if chosen => Some(time.get()),
                    _ => None,
                }
            });
            observed.predicted_s = times.max_by(f64::total_cmp);
        }
        observed.holders.extend(holders.iter().map(|(role, robot)| (role.clone(), robot.clone())));
    }

    fn task_began(&self, observed: &mut TrialState, robot: &RobotId, task: &TaskId, now_s: f64) {
        let Some(spec) = self.settings.tasks.get(task) else { return };
        observed.last_task = Some(task.clone());
        let able = self.settings.skills.get(robot).is_some_and(|skills| skills.contains(&spec.task_type));
        if !able {
            observed.unskilled.get_or_insert((now_s, robot.clone(), spec.task_type.clone()));
            return;
        }
        let Some((scenario_robot, report)) = self.settings.robots.get(robot).zip(self.settings.world.telemetry(robot))
        else {
            return;
        };
        let context_here =
            EstimateContext { place: report.place.clone(), pose: Some(report.pose), ..start_context(scenario_robot) };
        let to = self.settings.estimator.destination(spec);
        if let Some(to) = &to {
            let mut rng = generator(self.settings.seed, &["drive", robot.as_str(), report.place.as_str(), to.as_str()]);
            let factor = self.settings.travel.factor(&report.place, to, &mut rng);
            let speed =
                MetresPerSecond::new(scenario_robot.speed_mps / factor).expect("a speed over a factor that is not 0");
            self.settings.world.with(|world| world.set_speed(robot, speed));
        }
        let Ok(estimate) = self.settings.estimator.estimate(spec, &context_here) else { return };
        let predicted = Observation {
            skill: spec.task_type.clone(),
            from: to.is_some().then_some(report.place),
            to,
            predicted_s: estimate.time.get(),
            actual_s: 0.0,
            predicted_share: estimate.energy,
            actual_share: 0.0,
            budget_share: estimate.energy + self.settings.estimator.margin_sds() * estimate.energy_sd,
        };
        let charge = report.battery.get();
        observed
            .running_tasks
            .insert(robot.clone(), RunningTask { task: task.clone(), began_s: now_s, charge, predicted });
    }

    fn task_ended(&self, observed: &mut TrialState, robot: &RobotId, task: &TaskId, now_s: f64) {
        let Some(running_tasks) =
            observed.running_tasks.remove(robot).filter(|running_tasks| running_tasks.task == *task)
        else {
            return;
        };
        if observed.disturbed.contains(&(robot.clone(), task.clone())) {
            return;
        }
        let Some(report) = self.settings.world.telemetry(robot) else { return };
        let (actual_s, actual_share) = (now_s - running_tasks.began_s, running_tasks.charge - report.battery.get());
        observed.observations.push(Observation { actual_s, actual_share, ..running_tasks.predicted });
    }
}

impl Observer for TrialObserver {
    fn on_event(&self, event: &Event) {
        self.observe(&event.node, &event.kind);
    }

    fn on_applied(&self, _: &NodeId, _: Epoch, _: &[Command]) {}
}
