//! Looks over the shoulders of all nodes of a trial, and sends robots on their way at the speed that the travel model gives.

use consort_actors::observe::Observer;
use consort_protocol::auction::{AuctionRecord, Verdict};
use consort_protocol::event::{Event, Happening};
use consort_protocol::ids::{NodeId, PlaceId, RobotId, RoleId, TaskId, TaskType};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Command, MissionState};
use consort_protocol::mission::TaskSpec;
use consort_protocol::units::MetresPerSecond;
use consort_sim::experiment::calibration::Observation;
use consort_sim::experiment::design::ScenarioRobot;
use consort_sim::experiment::prospect::context;
use consort_sim::experiment::seeds::generator;
use consort_sim::experiment::travel::TravelModel;
use consort_sim::world::SharedWorld;
use consort_skills::actions::BodyHost;
use consort_skills::descriptor::{Context, Estimator};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;
use tokio::time::Instant;

/// The one skill whose tasks lead from place to place.
const NAVIGATION: &str = "navigation";

/// What a watcher is told beforehand.
pub(super) struct Brief {
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
pub(super) struct Watcher {
    brief: Arc<Brief>,
    seen: Arc<Mutex<Seen>>,
    changed: watch::Sender<u64>,
}

/// What was seen.
#[derive(Default)]
pub(super) struct Seen {
    /// When the world began.
    began: Option<Instant>,
    /// Who holds which role.
    pub(super) holders: BTreeMap<RoleId, RobotId>,
    /// When robots last had a role taken from them.
    gave_up: BTreeMap<RobotId, f64>,
    /// Who was chosen at first.
    pub(super) chosen: BTreeMap<RoleId, RobotId>,
    /// Every robot that ever held a role.
    pub(super) ever: BTreeSet<RobotId>,
    /// What the bids of those chosen at first promised, in seconds: the longest.
    pub(super) predicted_s: Option<f64>,
    /// The latest auction that filled its roles.
    record: Option<AuctionRecord>,
    /// Who first began a task without the skill.
    pub(super) unskilled: Option<(f64, RobotId, TaskType)>,
    /// When robots that were given a role although their battery was empty got it.
    pub(super) empty: BTreeMap<RobotId, f64>,
    /// How the mission ended.
    pub(super) end: Option<MissionState>,
    /// Why roles were taken from robots.
    pub(super) releases: Vec<String>,
    under_way: BTreeMap<RobotId, UnderWay>,
    /// Tasks that met with a setback teach nothing.
    upset: BTreeSet<(RobotId, TaskId)>,
    pub(super) observations: Vec<Observation>,
}

impl Seen {
    /// Whether a robot held a role at a time that has just passed. Whoever stands still with an empty battery loses its role
    /// within a message or two, and that may be heard of before the battery is.
    pub(super) fn held(&self, robot: &RobotId, at_s: f64) -> bool {
        self.holders.values().any(|holder| holder == robot) || self.gave_up.get(robot).is_some_and(|end| *end >= at_s)
    }
}

struct UnderWay {
    task: TaskId,
    began_s: f64,
    charge: f64,
    predicted: Observation,
}

impl Watcher {
    pub(super) fn new(brief: Brief) -> Watcher {
        Watcher { brief: Arc::new(brief), seen: Arc::default(), changed: watch::Sender::new(0) }
    }

    /// The world begins now.
    pub(super) fn begin(&self) {
        self.look().began = Some(Instant::now());
    }

    /// World time in seconds: ahead of what the world itself says by as long as nothing has happened in it.
    pub(super) fn now_s(&self) -> f64 {
        self.time(&self.look())
    }

    fn time(&self, seen: &Seen) -> f64 {
        seen.began.map_or(0.0, |began| began.elapsed().as_secs_f64() * self.brief.speed)
    }

    /// Is told whenever there is something new to see.
    pub(super) fn changed(&self) -> watch::Receiver<u64> {
        self.changed.subscribe()
    }

    pub(super) fn look(&self) -> MutexGuard<'_, Seen> {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn see(&self, node: &NodeId, what: &Happening) {
        let mut seen = self.look();
        let now_s = self.time(&seen);
        match what {
            Happening::Closed { record, .. } if record.failure.is_none() => seen.record = Some(record.clone()),
            Happening::Awarded { holders, .. } => self.awarded(&mut seen, holders, now_s),
            Happening::Released { role, cause, .. } => {
                if let Some(robot) = seen.holders.remove(role) {
                    seen.gave_up.insert(robot, now_s);
                }
                seen.releases.push(format!("{role}: {cause}"));
            }
            Happening::Mission { state, .. } if state.is_end() => seen.end = Some(state.clone()),
            Happening::TaskBegan { task, .. } => self.task_began(&mut seen, &RobotId::from(node.clone()), task, now_s),
            Happening::TaskEnded { task, .. } => self.task_ended(&mut seen, &RobotId::from(node.clone()), task, now_s),
            Happening::Suspended { .. } | Happening::TaskRetried { .. } => {
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

    fn awarded(&self, seen: &mut Seen, holders: &BTreeMap<RoleId, RobotId>, now_s: f64) {
        for robot in holders.values().filter(|robot| self.brief.robots.contains_key(*robot)) {
            seen.ever.insert(robot.clone());
            let able = self.brief.world.telemetry(robot).is_none_or(|report| report.able);
            if !able {
                seen.empty.entry(robot.clone()).or_insert(now_s);
            }
        }
        if seen.chosen.is_empty() {
            seen.chosen = holders.clone();
            let times = seen.record.iter().flat_map(|record| &record.entries).filter_map(|entry| {
                let chosen = holders.get(&entry.role) == Some(&entry.robot);
                match &entry.verdict {
                    Verdict::Viable { time, .. } | Verdict::Unviable { time, .. } if chosen => Some(time.get()),
                    _ => None,
                }
            });
            seen.predicted_s = times.max_by(f64::total_cmp);
        }
        seen.holders.extend(holders.iter().map(|(role, robot)| (role.clone(), robot.clone())));
    }

    fn task_began(&self, seen: &mut Seen, robot: &RobotId, task: &TaskId, now_s: f64) {
        let Some(spec) = self.brief.tasks.get(task) else { return };
        let able = self.brief.skills.get(robot).is_some_and(|skills| skills.contains(&spec.task_type));
        if !able {
            seen.unskilled.get_or_insert((now_s, robot.clone(), spec.task_type.clone()));
            return;
        }
        let Some((own, report)) = self.brief.robots.get(robot).zip(self.brief.world.telemetry(robot)) else { return };
        let here = Context { place: report.place.clone(), pose: Some(report.pose), ..context(own) };
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

    fn task_ended(&self, seen: &mut Seen, robot: &RobotId, task: &TaskId, now_s: f64) {
        let Some(under_way) = seen.under_way.remove(robot).filter(|under_way| under_way.task == *task) else { return };
        if seen.upset.contains(&(robot.clone(), task.clone())) {
            return;
        }
        let Some(report) = self.brief.world.telemetry(robot) else { return };
        let (actual_s, actual_share) = (now_s - under_way.began_s, under_way.charge - report.battery.get());
        seen.observations.push(Observation { actual_s, actual_share, ..under_way.predicted });
    }
}

impl Observer for Watcher {
    fn told(&self, event: &Event) {
        self.see(&event.node, &event.what);
    }

    fn applied(&self, _: &NodeId, _: Epoch, _: &[Command]) {}
}
