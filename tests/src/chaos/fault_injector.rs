//! Fault injection before nodes start: disks that lose writes, clocks that drift, skills that fail.

use super::chaos_fleet::ChaosFleet;
use super::dates::date_ms;
use super::generate::{is_large, lease_terms};
use super::mutants::Mutant;
use super::schedule::{ChaosAction, Schedule, ScheduledAction, SkillFault};
use super::small_limits::Limits;
use super::zones::zones;
use crate::AdjustNode;
use crate::disk::{LogWrites, VirtualDisk};
use consort_bus::BootInstant;
use consort_bus::clock::Clock;
use consort_fleet::coordinator::RequestLimits;
use consort_fleet::node::NodeSettings;
use consort_protocol::ledger::HistoryLimits;
use consort_protocol::mission::Domain;
use consort_protocol::units::{Seconds, WorldTime};
use consort_protocol::versions::VersionRange;
use consort_skills::bt::{Cause, Leaf, LeafContext, NodeKind, NodeManifest, NodeStatus};
use consort_skills::environment::Environment;
use consort_skills::extensions::Extensions;
use consort_skills::library::SkillLibrary;
use consort_skills::skill::TaskContext;
use consort_world::map;
use std::cell::RefCell;
use std::collections::{BTreeMap, VecDeque};
use std::rc::Rc;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// Duration of a hang in world seconds: half a minute of node time at ten times the speed.
const HANGS_S: f64 = 300.0;

/// Beginning and end.
type Period = (BootInstant, BootInstant);

/// Queued faults of the skills of a robot.
type FaultQueue = Arc<Mutex<VecDeque<SkillFault>>>;

/// Fault injector of a fleet. Clones share the same state.
#[derive(Clone)]
pub(super) struct FaultInjector(Rc<RefCell<Parts>>);

struct Parts {
    started: Instant,
    seed: u64,
    limits: Limits,
    /// The nodes that start from now on run the latest program.
    is_upgraded: bool,
    /// Nodes read new lists of revoked certificates; not for a mutation check.
    reads_revocations: bool,
    /// The fleet declares zones.
    has_zones: bool,
    /// Period in which the date of a node is wrong, and the error in milliseconds.
    wrong_dates: BTreeMap<String, (Period, i64)>,
    /// Periods that the clocks of the nodes do not count, for a mutation check.
    uncounted: BTreeMap<String, Period>,
    disks: BTreeMap<String, VirtualDisk>,
    /// Number of disks created so far.
    created_disks: u64,
    /// Writes of the disks that were lost.
    lost_log_writes: LogWrites,
    rates: BTreeMap<String, f64>,
    faults: BTreeMap<String, FaultQueue>,
    libraries: BTreeMap<String, Arc<SkillLibrary>>,
}

impl FaultInjector {
    /// Creates the injector of a run. With `mutant` the clocks of nodes may not count some periods, or nodes may not read lists
    /// of revoked certificates.
    pub(super) fn new(
        seed: u64,
        mutant: Option<Mutant>,
        composition: &ChaosFleet,
        schedule: &Schedule,
        extensions: Extensions,
    ) -> FaultInjector {
        let drift = |act: &ChaosAction| {
            if let ChaosAction::Drift { node, rate } = act { Some((node.clone(), *rate)) } else { None }
        };
        let rates = schedule.steps.iter().filter_map(|step| drift(&step.action)).collect();
        let map = map::shipped("hospital").expect("the shipped map is sound");
        let environment = map.environment().expect("the shipped map is sound");
        let robots = composition.carriers.iter().chain(&composition.arms).copied();
        let faults: BTreeMap<String, FaultQueue> =
            robots.map(|robot| (robot.to_owned(), FaultQueue::default())).collect();
        let library = |faults: &FaultQueue| Arc::new(faulty_library(extensions, environment.clone(), faults));
        let libraries = faults.iter().map(|(robot, faults)| (robot.clone(), library(faults))).collect();
        let (started, disks, created_disks) = (Instant::now(), BTreeMap::new(), 0);
        let now = BootInstant::now();
        let period =
            |at_ms: u64, for_ms: u64| (now + Duration::from_millis(at_ms), now + Duration::from_millis(at_ms + for_ms));
        let (mut wrong_dates, mut uncounted, mut is_upgraded) = (BTreeMap::new(), BTreeMap::new(), true);
        for ScheduledAction { at_ms, action } in &schedule.steps {
            match action {
                ChaosAction::WrongDate { node, ahead_s, for_ms } => {
                    wrong_dates.insert(node.clone(), (period(*at_ms, *for_ms), ahead_s * 1000));
                }
                ChaosAction::Suspend { node, for_ms } if mutant == Some(Mutant::SuspensionNotCounted) => {
                    uncounted.insert(node.clone(), period(*at_ms, *for_ms));
                }
                ChaosAction::Block { node, for_ms } if mutant == Some(Mutant::StoppedWithBus) => {
                    uncounted.insert(node.clone(), period(*at_ms, *for_ms));
                }
                ChaosAction::Upgrade { .. } => is_upgraded = false,
                _ => {}
            }
        }
        let parts = Parts {
            started,
            seed,
            limits: Limits::of(seed, schedule),
            is_upgraded,
            reads_revocations: mutant != Some(Mutant::RevocationsUnread),
            has_zones: schedule.names_zones(),
            wrong_dates,
            uncounted,
            disks,
            created_disks,
            lost_log_writes: LogWrites::default(),
            rates,
            faults,
            libraries,
        };
        FaultInjector(Rc::new(RefCell::new(parts)))
    }

    /// Returns a function that applies the faults to the settings of a node.
    pub(super) fn adjust(&self) -> AdjustNode {
        let injector = self.clone();
        Box::new(move |settings| injector.equip(settings))
    }

    fn equip(&self, settings: &mut NodeSettings) {
        let node = settings.node.to_string();
        settings.store = self.disk(&node).store();
        let parts = self.0.borrow();
        let Limits { snapshot_every, log_entries_kept, ended_missions_max, outcome_bytes_max, active_missions_max } =
            parts.limits;
        (settings.fleet.snapshot_every, settings.fleet.log_entries_kept) = (snapshot_every, log_entries_kept);
        let date = date_ms(parts.started.elapsed());
        settings.fleet.history_limits.missions_max = ended_missions_max;
        settings.fleet.history_limits.outcome_bytes_max = outcome_bytes_max;
        settings.fleet.request_limits.missions_max = active_missions_max;
        settings.fleet.lease_terms = lease_terms(parts.seed);
        settings.fleet.scoped_knowledge = is_large(parts.seed);
        if !parts.is_upgraded {
            settings.supported_versions = VersionRange::OWN.up_to(VersionRange::OWN.newest - 1);
        }
        if parts.has_zones {
            settings.fleet.domain = Arc::new(Domain::clone(&settings.fleet.domain).with_zones(zones()));
        }
        settings.clock = Clock::virtual_at(date).drifting(parts.rates.get(&node).copied().unwrap_or(1.0));
        if let Some(((from, until), ahead_ms)) = parts.wrong_dates.get(&node) {
            settings.clock = settings.clock.with_wrong_date(*from, *until, *ahead_ms);
        }
        if let Some((from, until)) = parts.uncounted.get(&node) {
            settings.clock = settings.clock.stopped(*from, *until);
        }
        if let (Some(robot), Some(library)) = (&mut settings.robot, parts.libraries.get(&node)) {
            robot.library = Arc::clone(library);
        }
    }

    /// Lets the fleet accept any number of missions and take snapshots seldom, as a fleet in operation does.
    pub(super) fn use_limits_of_operation(&self) {
        self.0.borrow_mut().limits = Limits {
            snapshot_every: consort_raft::SNAPSHOT_EVERY,
            log_entries_kept: consort_raft::LOG_ENTRIES_KEPT,
            ended_missions_max: HistoryLimits::default().missions_max,
            outcome_bytes_max: HistoryLimits::default().outcome_bytes_max,
            active_missions_max: RequestLimits::default().missions_max,
        };
    }

    /// Returns the number of ended missions that the fleet keeps whole.
    pub(super) fn ended_missions_max(&self) -> usize {
        self.0.borrow().limits.ended_missions_max as usize
    }

    /// Checks whether the ledger forgets outcomes of missions during the run.
    pub(super) fn forgets_outcomes(&self) -> bool {
        self.0.borrow().limits.outcome_bytes_max < HistoryLimits::default().outcome_bytes_max
    }

    /// Lets the nodes that start from now on run the latest program.
    pub(super) fn upgrade(&self) {
        self.0.borrow_mut().is_upgraded = true;
    }

    /// Checks whether the nodes read new lists of revoked certificates.
    pub(super) fn reads_revocations(&self) -> bool {
        self.0.borrow().reads_revocations
    }

    /// Checks whether a node replaces its process after a suspension of its machine.
    pub(super) fn notices_suspension(&self, node: &str) -> bool {
        !self.0.borrow().uncounted.contains_key(node)
    }

    /// Returns the disk of a node and creates it if necessary.
    pub(super) fn disk(&self, node: &str) -> VirtualDisk {
        let mut parts = self.0.borrow_mut();
        let parts = &mut *parts;
        let new = || {
            parts.created_disks += 1;
            VirtualDisk::new(parts.seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(parts.created_disks))
        };
        parts.disks.entry(node.to_owned()).or_insert_with(new).clone()
    }

    /// Removes the disk of a node. Its next incarnation starts with an empty disk.
    pub(super) fn lose_disk(&self, node: &str) {
        let mut parts = self.0.borrow_mut();
        if let Some(disk) = parts.disks.remove(node) {
            parts.lost_log_writes.add(disk.log_writes());
        }
    }

    /// Returns the numbers of writes of all disks.
    pub(super) fn log_writes(&self) -> LogWrites {
        let parts = self.0.borrow();
        let mut writes = parts.lost_log_writes;
        parts.disks.values().for_each(|disk| writes.add(disk.log_writes()));
        writes
    }

    /// Queues `times` faults for the skills of a robot.
    pub(super) fn inject_skill_fault(&self, robot: &str, how: SkillFault, times: u32) {
        if let Some(faults) = self.0.borrow().faults.get(robot) {
            let mut faults = faults.lock().unwrap_or_else(PoisonError::into_inner);
            faults.extend((0..times).map(|_| how));
        }
    }

    /// Removes all queued skill faults.
    pub(super) fn clear_skill_faults(&self) {
        for faults in self.0.borrow().faults.values() {
            faults.lock().unwrap_or_else(PoisonError::into_inner).clear();
        }
    }
}

/// Returns the skills, each preceded by a leaf that injects the queued faults.
fn faulty_library(extensions: Extensions, environment: Environment, faults: &FaultQueue) -> SkillLibrary {
    let mut library = extensions.library(environment).expect("its names are unique");
    let faults = Arc::clone(faults);
    let added = library.extend(|registry| {
        registry.register(NodeManifest::new("Stumble", NodeKind::Action, []), move |_: &TaskContext| {
            Box::new(FaultLeaf { faults: Arc::clone(&faults), until: None })
        })
    });
    added.expect("the leaf name is unique");
    library.precede_with("Stumble").expect("a leaf without ports");
    library
}

struct FaultLeaf {
    faults: FaultQueue,
    /// End of the current hang.
    until: Option<WorldTime>,
}

impl Leaf for FaultLeaf {
    fn tick(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        if let Some(until) = self.until {
            let over = context.now() >= until;
            self.until = self.until.filter(|_| !over);
            return Ok(if over { NodeStatus::Success } else { NodeStatus::Running });
        }
        let fault = self.faults.lock().unwrap_or_else(PoisonError::into_inner).pop_front();
        match fault {
            None => Ok(NodeStatus::Success),
            Some(SkillFault::Fails) => Err(Cause::new("chaos has it fail")),
            Some(SkillFault::Panics) => panic!("chaos has it panic"),
            Some(SkillFault::Hangs) => {
                self.until = Some(context.now() + Seconds::new(HANGS_S).map_err(|e| Cause::new(e.to_string()))?);
                Ok(NodeStatus::Running)
            }
        }
    }

    fn halt(&mut self, _: &mut LeafContext<'_, '_>) {
        self.until = None;
    }
}
