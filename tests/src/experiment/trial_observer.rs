//! Looks over the shoulders of all nodes of a trial, and sends robots on their way at the speed that the travel model gives.

use consort_actors::observe::Observer;
use consort_protocol::auction::{AuctionRecord, BidVerdict};
use consort_protocol::event::{Event, EventKind};
use consort_protocol::ids::{NodeId, PlaceId, RobotId, RoleId, TaskId, TaskType};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Command, MissionState};
use consort_protocol::mission::TaskSpec;
use consort_protocol::units::MetresPerSecond;
use consort_sim::experiment::calibration::Observation;
use consort_sim::experiment::design::ScenarioRobot;
use consort_sim::experiment::seeds::generator;
use consort_sim::experiment::success_estimate::start_context;
use consort_sim::experiment::travel::TravelModel;
use consort_sim::world::SharedWorld;
use consort_skills::actions::RobotBackend;
use consort_skills::descriptor::{EstimateContext, Estimator};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;
use tokio::time::Instant;

/// The one skill whose tasks lead from place to place.
const NAVIGATION: &str = "navigation";

/// What a watcher is told beforehand.
pub(super) struct ObserverSettings {
    pub(super) world: SharedWorld,
    /// World seconds in one second of the fleet's time.
    pub(super) speed: f64,
    /// Where the chance of drives comes from.
    pub(super) seed: u64,
    pub(super) travel: TravelModel,
    /// What robots reckon with.
    pub(super) estimator: Arc<Estimator>,
    /// The robots that drive.
    pub(super) robots: BTreeMap<RobotId, ScenarioRobot>,
    /// What everybody can do.
    pub(super) skills: BTreeMap<RobotId, BTreeSet<TaskType>>,
    /// The tasks of managed roles.
    pub(super) tasks: BTreeMap<TaskId, TaskSpec>,
}

/// See the [module](self). Clones are one.
#[derive(Clone)]
pub(super) struct TrialObserver {
    brief: Arc<ObserverSettings>,
    seen: Arc<Mutex<TrialState>>,
    changed: watch::Sender<u64>,
}

/// What was seen.
#[derive(Default)]
pub(super) struct TrialState {
    /// When the world began.
    began: Option<Instant>,
    /// Who holds which role.
    pub(super) holders: BTreeMap<RoleId, RobotId>,
    /// When robots last had a role taken from them.
    gave_up: BTreeMap<RobotId, f64>,
    /// Who was chosen at first.
    pub(super) first_holders: BTreeMap<RoleId, RobotId>,
    /// Every robot that ever held a role.
    pub(super) ever_assigned: BTreeSet<RobotId>,
    /// What the bids of those chosen at first promised, in seconds: the longest.
    pub(super) predicted_s: Option<f64>,
    /// The latest auction that filled its roles.
    record: Option<AuctionRecord>,
    /// Who first began a task without the skill.
    pub(super) unskilled: Option<(f64, RobotId, TaskType)>,
    /// When robots that were given a role although their battery was empty got it.
    pub(super) depleted: BTreeMap<RobotId, f64>,
    /// How the mission ended.
    pub(super) end_state: Option<MissionState>,
    /// Why roles were taken from robots.
    pub(super) releases: Vec<String>,
    under_way: BTreeMap<RobotId, UnderWay>,
    /// Tasks that met with a setback teach nothing.
    upset: BTreeSet<(RobotId, TaskId)>,
    pub(super) observations: Vec<Observation>,
}

impl TrialState {
    /// Whether a robot held a role at a time that has just passed. Whoever stands still with an empty battery loses its role
    /// within a message or two, and that may be heard of before the battery is.
    pub(super) fn held_role_at(&self, robot: &RobotId, at_s: f64) -> bool {
        self.holders.values().any(|holder| holder == robot) || self.gave_up.get(robot).is_some_and(|end| *end >= at_s)
    }
}

struct UnderWay {
    task: TaskId,
    began_s: f64,
    charge: f64,
    predicted: Observation,
}

impl TrialObserver {
    pub(super) fn new(brief: ObserverSettings) -> TrialObserver {
        TrialObserver { brief: Arc::new(brief), seen: Arc::default(), changed: watch::Sender::new(0) }
    }

    /// The world begins now.
    pub(super) fn start_clock(&self) {
        self.state().began = Some(Instant::now());
    }

    /// World time in seconds: ahead of what the world itself says by as long as nothing has happened in it.
    pub(super) fn now_s(&self) -> f64 {
        self.time(&self.state())
    }

    fn time(&self, seen: &TrialState) -> f64 {
        seen.began.map_or(0.0, |began| began.elapsed().as_secs_f64() * self.brief.speed)
    }

    /// Is told whenever there is something new to see.
    pub(super) fn changed(&self) -> watch::Receiver<u64> {
        self.changed.subscribe()
    }

    pub(super) fn state(&self) -> MutexGuard<'_, TrialState> {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn see(&self, node: &NodeId, what: &EventKind) {
        let mut seen = self.state();
        let now_s = self.time(&seen);
        match what {
            EventKind::Closed { record, .. } if record.failure.is_none() => seen.record = Some(record.clone()),
            EventKind::Awarded { holders, .. } => self.awarded(&mut seen, holders, now_s),
            EventKind::Released { role, cause, .. } => {
                if let Some(robot) = seen.holders.remove(role) {
                    seen.gave_up.insert(robot, now_s);
                }
                seen.releases.push(format!("{role}: {cause}"));
            }
            EventKind::Mission { state, .. } if state.is_final() => seen.end_state = Some(state.clone()),
            EventKind::TaskBegan { task, .. } => self.task_began(&mut seen, &RobotId::from(node.clone()), task, now_s),
            EventKind::TaskEnded { task, .. } => self.task_ended(&mut seen, &RobotId::from(node.clone()), task, now_s),
            EventKind::Suspended { .. } | EventKind::TaskRetried { .. } => {
                let robot = RobotId::from(node.clone());
                if let Some(under_way) = seen.under_way.remove(&robot) {
                    seen.upset.insert((robot, under_way.task));
                }
            }
            _ => return,
        }
        drop(seen);
        self.changed.send_modify(|count| *count += 1);
    }

    fn awarded(&self, seen: &mut TrialState, holders: &BTreeMap<RoleId, RobotId>, now_s: f64) {
        for robot in holders.values().filter(|robot| self.brief.robots.contains_key(*robot)) {
            seen.ever_assigned.insert(robot.clone());
            let able = self.brief.world.telemetry(robot).is_none_or(|report| report.able);
            if !able {
                seen.depleted.entry(robot.clone()).or_insert(now_s);
            }
        }
        if seen.first_holders.is_empty() {
            seen.first_holders = holders.clone();
            let times = seen.record.iter().flat_map(|record| &record.entries).filter_map(|entry| {
                let chosen = holders.get(&entry.role) == Some(&entry.robot);
                match &entry.verdict {
                    BidVerdict::Viable { time, .. } | BidVerdict::Unviable { time, .. } if chosen => Some(time.get()),
                    _ => None,
                }
            });
            seen.predicted_s = times.max_by(f64::total_cmp);
        }
        seen.holders.extend(holders.iter().map(|(role, robot)| (role.clone(), robot.clone())));
    }

    fn task_began(&self, seen: &mut TrialState, robot: &RobotId, task: &TaskId, now_s: f64) {
        let Some(spec) = self.brief.tasks.get(task) else { return };
        let able = self.brief.skills.get(robot).is_some_and(|skills| skills.contains(&spec.task_type));
        if !able {
            seen.unskilled.get_or_insert((now_s, robot.clone(), spec.task_type.clone()));
            return;
        }
        let Some((own, report)) = self.brief.robots.get(robot).zip(self.brief.world.telemetry(robot)) else { return };
        let here = EstimateContext { place: report.place.clone(), pose: Some(report.pose), ..start_context(own) };
        let to = spec.parameters.get("to").filter(|_| spec.task_type.as_str() == NAVIGATION);
        let to = to.and_then(|to| to.parse::<PlaceId>().ok());
        if let Some(to) = &to {
            let mut rng = generator(self.brief.seed, &["drive", robot.as_str(), report.place.as_str(), to.as_str()]);
            let factor = self.brief.travel.factor(&report.place, to, &mut rng);
            let speed = MetresPerSecond::new(own.speed_mps / factor).expect("a speed over a factor that is not 0");
            self.brief.world.with(|world| world.set_speed(robot, speed));
        }
        let Ok(estimate) = self.brief.estimator.estimate(spec, &here) else { return };
        let predicted = Observation {
            skill: spec.task_type.clone(),
            from: to.is_some().then_some(report.place),
            to,
            predicted_s: estimate.time.get(),
            actual_s: 0.0,
            predicted_share: estimate.energy,
            actual_share: 0.0,
            budget_share: estimate.energy + self.brief.estimator.margin_sds() * estimate.energy_sd,
        };
        let charge = report.battery.get();
        seen.under_way.insert(robot.clone(), UnderWay { task: task.clone(), began_s: now_s, charge, predicted });
    }

    fn task_ended(&self, seen: &mut TrialState, robot: &RobotId, task: &TaskId, now_s: f64) {
        let Some(under_way) = seen.under_way.remove(robot).filter(|under_way| under_way.task == *task) else { return };
        if seen.upset.contains(&(robot.clone(), task.clone())) {
            return;
        }
        let Some(report) = self.brief.world.telemetry(robot) else { return };
        let (actual_s, actual_share) = (now_s - under_way.began_s, under_way.charge - report.battery.get());
        seen.observations.push(Observation { actual_s, actual_share, ..under_way.predicted });
    }
}

impl Observer for TrialObserver {
    fn on_event(&self, event: &Event) {
        self.see(&event.node, &event.kind);
    }

    fn on_applied(&self, _: &NodeId, _: Epoch, _: &[Command]) {}
}
