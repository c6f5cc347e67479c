//! A single run: a fleet, a schedule, and the check of all invariants.
//!
//! ```text
//!  start    │ schedule: requests and faults │ all faults end  │ no faults, to the end of the run │ a link is cut for good
//!  ─────────┴──────── invariants at every step ─────────────┴─────── liveness ─────────────────┴──────── relay ───────▶
//! ```

mod shift;

pub use shift::{FaultyShift, run_shift};

use super::chaos_fleet::ChaosFleet;
use super::chargers;
use super::coverage::CoverageObserver;
use super::dates::{DATE_MS, millis};
use super::executor::ActionExecutor;
use super::fault_injector::FaultInjector;
use super::generate::{LIFTED, is_large, lease_terms};
use super::invariants::{self, Invariant, InvariantViolation};
use super::mutants::{Mutant, MutantInjection};
use super::people::person;
use super::poison::{MISSION_SHARE, PoisonBound};
use super::requested_missions::workload_with;
use super::run_counters::RunCounters;
use super::schedule::{ChaosAction, DiskAfterCrash, Schedule};
use crate::credentials::Signatures;
use crate::fleet::NodeOptions;
use crate::{Fleet, Observation, paused_runtime, slug};
use consort_fleet::coordinator::CandidateSettings;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, NodeId, RoleId};
use consort_protocol::ledger::{Ledger, MissionState, RoleEntry};
use consort_skills::workload::Workload;
use consort_world::world::World;
use serde::Serialize;
use std::any::Any;
use std::collections::{BTreeMap, BTreeSet};
use std::hash::{DefaultHasher, Hasher};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;
use tokio::time::timeout;

/// Interval at which the world is checked while nothing else happens.
const CHECK_INTERVAL: Duration = Duration::from_millis(20);

/// Limit for missions to end after all faults have ended. Up to a dozen missions wait for the only
/// arm.
const MISSION_LIMIT: Duration = Duration::from_secs(600);

/// Limit for the fleet to converge after all faults have ended.
const CONVERGENCE_LIMIT: Duration = Duration::from_secs(60);

/// Limit for the refusals of repeated requests with forgotten outcomes: a client repeats its request after 30 s at the latest,
/// and again while as many missions as allowed are active.
const REFUSAL_LIMIT: Duration = Duration::from_secs(180);

/// Longest time without a leader in a transfer of leadership, in milliseconds.
const TRANSFER_MAX_MS: u64 = 120;

/// Limit for the news of a restart to reach a node without a link to the restarted node.
const RELAY_LIMIT: Duration = Duration::from_secs(30);

/// Configuration of a run.
#[derive(Debug, Clone)]
pub struct RunConfig {
    /// Source of all randomness.
    pub seed: u64,
    /// Nodes of the fleet, without the world host.
    pub nodes: usize,
    /// Simulated minutes.
    pub minutes: f64,
    /// Nodes have certificates and sign their messages.
    pub closed: bool,
    /// Bug injected into all nodes.
    pub mutant: Option<Mutant>,
    /// Missions of a user, with the extensions of all nodes.
    pub workload: Workload,
}

/// Outcome of a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunOutcome {
    /// Its seed.
    pub seed: u64,
    /// The violated invariant, if any.
    pub violation: Option<Violation>,
    /// Counters of the run.
    pub counters: RunCounters,
    /// Digest of all events and messages. Equal runs have equal digests.
    pub digest: String,
}

/// Violation of an invariant.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Violation {
    /// Name of an invariant, or `liveness`, `relay`, `undisturbed`, `linearizable`, `read_age`, `panic`.
    pub invariant: String,
    /// Time in milliseconds since the start of the fleet.
    pub at_ms: u64,
    /// Description of the violation.
    pub reason: String,
    /// Event log before the violation, with a line per entry, oldest first.
    pub events_before: Vec<String>,
}

/// Executes a run. It uses its own paused runtime on the calling thread; no state remains
/// afterwards.
pub fn run(config: &RunConfig, schedule: &Schedule) -> RunOutcome {
    let runtime = paused_runtime();
    let outcome = catch_unwind(AssertUnwindSafe(|| runtime.block_on(execute_run(config, schedule))));
    outcome.unwrap_or_else(|panic| RunOutcome {
        seed: config.seed,
        violation: Some(Violation {
            invariant: "panic".to_owned(),
            at_ms: 0,
            reason: panic_text(&*panic),
            events_before: vec![],
        }),
        counters: RunCounters::default(),
        digest: String::new(),
    })
}

fn panic_text(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    text.unwrap_or("a panic without a message").to_owned()
}

async fn execute_run(config: &RunConfig, schedule: &Schedule) -> RunOutcome {
    let composition = ChaosFleet::of(config.nodes);
    let workload = workload_with(&config.workload, schedule);
    let injector = FaultInjector::new(config.seed, config.mutant, &composition, schedule, workload.extensions);
    let options = NodeOptions {
        world_speed: schedule.world_speed.into(),
        extensions: workload.extensions,
        charging: chargers::setup(schedule),
        candidates: candidates(config.seed),
        ..node_options(config, &injector)
    };
    let (mut members, people) = composition.participants(&workload);
    if options.charging.is_some() {
        members = chargers::with_small_batteries(members, schedule);
    }
    let fleet = Fleet::hospital_with(config.seed, members, &composition.stations, people, options).await;
    let checker = Checker::new(injector.ended_missions_max(), lease_terms(config.seed).lease, schedule);
    let executor = ActionExecutor::new(composition.clone(), injector, workload);
    let mut run = Run { fleet, executor, checker };
    for node in composition.nodes() {
        run.fleet.record_leadership(node);
    }
    let violation = run.run_phases(config, schedule, &composition).await.err();
    let Run { fleet, executor, checker } = run;
    let Checker { mut counters, coverage, .. } = checker;
    counters.end(&fleet, &executor.acknowledged(), |mission| coverage.forgotten_outcome(mission));
    counters.client_replies = executor.history().replies();
    let forgotten_refused = executor.refused().len();
    counters.coverage = coverage.end(executor.log_writes(), executor.history().refusals(), forgotten_refused);
    let mut hasher = DefaultHasher::new();
    hasher.write(fleet.event_log_text().as_bytes());
    hasher.write_u64(fleet.network.digest());
    let digest = format!("{:016x}", hasher.finish());
    RunOutcome { seed: config.seed, violation, counters, digest }
}

/// Returns the number of robots that auctions ask first: two in every second fleet with the settings of a large one. With
/// the default these fleets ask all.
fn candidates(seed: u64) -> usize {
    if is_large(seed) && seed.is_multiple_of(2) { 2 } else { CandidateSettings::DEFAULT_COUNT }
}

/// Returns the options that inject the faults, and the bug if there is one.
fn node_options(config: &RunConfig, injector: &FaultInjector) -> NodeOptions {
    let mut adjust = injector.adjust();
    let signatures = config.closed.then_some(Signatures::Simulated);
    let options = NodeOptions { signatures, date_ms: DATE_MS, ..NodeOptions::default() };
    let Some(mutant) = config.mutant else { return NodeOptions { adjust, ..options } };
    let injection = MutantInjection::new(mutant);
    let (at_bus, at_network, at_signer) = (injection.clone(), injection.clone(), injection.clone());
    NodeOptions {
        adjust: Box::new(move |settings| {
            adjust(settings);
            injection.equip(settings);
        }),
        wrap_bus: Box::new(move |settings, bus| at_bus.wrap_bus(settings, bus)),
        wrap_network: Box::new(move |settings, bus| at_network.wrap_network(settings, bus)),
        wrap_signer: Box::new(move |signer| at_signer.wrap_signer(signer)),
        ..options
    }
}

struct Run {
    fleet: Fleet,
    executor: ActionExecutor,
    checker: Checker,
}

impl Run {
    async fn run_phases(
        &mut self,
        config: &RunConfig,
        schedule: &Schedule,
        composition: &ChaosFleet,
    ) -> Result<(), Violation> {
        let faults_end = Duration::from_secs_f64(config.minutes * 60.0 * LIFTED);
        self.executor.spawn_readers(&self.fleet);
        self.schedule(schedule, faults_end).await?;
        self.executor.end_all_faults(&mut self.fleet).await;
        self.fleet.heal();
        self.executor.spawn_resolver(&self.fleet);
        self.executor.spawn_order_enders(&self.fleet, schedule);
        let since = self.fleet.elapsed();
        let is_upgraded = self.executor.upgrade_check();
        let has_settled = |fleet: &Fleet| has_converged(fleet) && is_upgraded(fleet);
        let what = "a single coordinator, all nodes alive in all views, and the latest version";
        self.until(what, CONVERGENCE_LIMIT, has_settled).await?;
        let requests: Vec<String> = schedule.steps.iter().filter_map(|step| step.action.submitted_request()).collect();
        let executor = self.executor.acknowledged_receiver();
        self.until("an end of every mission", MISSION_LIMIT * schedule.slowdown(), move |fleet| {
            let acknowledged = executor.borrow();
            requests.iter().all(|request| acknowledged.contains_key(request))
                && unfinished(fleet, &acknowledged).is_empty()
        })
        .await?;
        let what = "the occurrences of schedules that are due";
        self.until(what, CONVERGENCE_LIMIT, |fleet| {
            fleet.ledger(|ledger| invariants::all_handled(ledger, fleet.elapsed())) == Some(true)
        })
        .await?;
        self.checker.counters.converged_ms = Some(millis(self.fleet.elapsed() - since));
        if schedule.has_only_poison() {
            self.check_undisturbed_by_poison(schedule, composition.carriers.len())?;
        }
        self.checker.end(&self.fleet)?;
        self.check_forgotten_requests(schedule).await?;
        // The rest of the run has no faults.
        let end = Duration::from_secs_f64(config.minutes * 60.0);
        while self.fleet.elapsed() < end {
            self.pass(end).await;
            self.checker.check(&self.fleet)?;
        }
        self.check_relay(config.seed, composition).await?;
        let slowest = self.checker.counters.takeovers_ms.iter().max();
        if schedule.has_only_hostile_nodes()
            && let Some(slowest) = slowest.filter(|ms| **ms > TRANSFER_MAX_MS)
        {
            let reason = format!("there was no leader for {slowest} ms, with hostile nodes as the only faults");
            return Err(self.checker.violation("undisturbed", reason, &self.fleet));
        }
        let history = self.executor.history();
        let violation = |name, reason| self.checker.violation(name, reason, &self.fleet);
        history.check_linearizable().map_err(|reason| violation("linearizable", reason))?;
        history.check_ages().map_err(|reason| violation("read_age", reason))
    }

    /// Checks that the fleet refuses the named requests whose outcomes it has forgotten by now, as soon as their clients
    /// repeat them.
    async fn check_forgotten_requests(&mut self, schedule: &Schedule) -> Result<(), Violation> {
        let acknowledged = self.executor.acknowledged();
        let is_forgotten = |request: &String| {
            let mission: Option<MissionId> = acknowledged.get(request).map(|mission| slug(mission));
            mission.is_some_and(|mission| self.checker.coverage.forgotten_outcome(&mission).is_some())
        };
        let named = schedule.steps.iter().filter_map(|step| match &step.action {
            ChaosAction::Submit { request, unnamed: false, .. } => Some(request.clone()),
            _ => None,
        });
        let forgotten: Vec<String> = named.filter(is_forgotten).collect();
        if forgotten.is_empty() {
            return Ok(());
        }
        let refused = self.executor.refused_receiver();
        let what = format!("the refusal of the repeated requests {forgotten:?}, whose outcomes are forgotten");
        let are_refused = |_: &Fleet| forgotten.iter().all(|request| refused.borrow().contains(request));
        self.until(&what, REFUSAL_LIMIT, are_refused).await
    }

    /// Checks, when all missions have ended, that those that can be completed were, and in time, and that those that
    /// cannot cost robots no more time than the bounds of their classes.
    fn check_undisturbed_by_poison(&self, schedule: &Schedule, carriers: usize) -> Result<(), Violation> {
        let violation = |reason| Err(self.checker.violation("undisturbed", reason, &self.fleet));
        let acknowledged = self.executor.acknowledged();
        let (mut last_ms, mut missions) = (0, 0);
        for step in &schedule.steps {
            let ChaosAction::Submit { request, mission, deadline_s, .. } = &step.action else { continue };
            (last_ms, missions) = (last_ms.max(step.at_ms), missions + 1);
            if let Some(id) = acknowledged.get(request).filter(|_| step.action.is_poison())
                && let Some(excess) = self.excess(&slug(id), PoisonBound::of(mission, carriers))
            {
                return violation(format!("{request}, which cannot be completed, {excess}"));
            }
            let is_canceled = schedule
                .steps
                .iter()
                .any(|other| matches!(&other.action, ChaosAction::Cancel { request: name } if name == request));
            let state = acknowledged.get(request).and_then(|id| self.fleet.mission_state(&slug::<MissionId>(id)));
            match state {
                Some(MissionState::Failed { cause, .. }) if !step.action.is_poison() && deadline_s.is_none() => {
                    return violation(format!("{request} failed beside missions that cannot be completed: {cause}"));
                }
                Some(MissionState::NeedsIntervention { cause, .. }) if !is_canceled && deadline_s.is_none() => {
                    return violation(format!("{request} needs intervention: {cause}"));
                }
                _ => {}
            }
        }
        let took = self.fleet.elapsed().saturating_sub(Duration::from_millis(last_ms));
        if took > MISSION_SHARE * missions {
            return violation(format!("{missions} missions ended {} s after the last request", took.as_secs()));
        }
        Ok(())
    }

    /// Returns, as text, by what a mission cost the robots more than the bound.
    fn excess(&self, mission: &MissionId, bound: PoisonBound) -> Option<String> {
        let is_award = |kind: &EventKind| match kind {
            EventKind::Awarded { mission: of, holders, .. } => of == mission && !holders.is_empty(),
            _ => false,
        };
        let awards = self.fleet.event_log.count(is_award);
        if awards > bound.awards {
            return Some(format!("was awarded {awards} times; {} are allowed", bound.awards));
        }
        let (now, intervals) = (self.fleet.elapsed(), self.fleet.event_log.role_intervals());
        intervals.iter().filter(|interval| interval.mission == *mission).find_map(|interval| {
            let held = interval.to.unwrap_or(now).saturating_sub(interval.from);
            let text = || format!("held {} for {held:?}; {:?} are allowed", interval.robot, bound.held);
            (held > bound.held).then(text)
        })
    }

    /// Executes the schedule until all faults have ended.
    async fn schedule(&mut self, schedule: &Schedule, faults_end: Duration) -> Result<(), Violation> {
        // At the same instant, ends come before beginnings; both are in the order of the actions.
        let mut queue: BTreeMap<(u64, bool, usize), usize> = BTreeMap::new();
        for (number, step) in schedule.steps.iter().enumerate() {
            queue.insert((step.at_ms, true, number), number);
            if let Some(for_ms) = step.action.for_ms() {
                queue.insert((step.at_ms + for_ms, false, number), number);
            }
        }
        loop {
            self.executor.advance(&mut self.fleet).await;
            self.checker.check(&self.fleet)?;
            let now = self.fleet.elapsed();
            while let Some(((at_ms, begins, number), _)) = queue.first_key_value()
                && Duration::from_millis(*at_ms) <= now
            {
                let (begins, number) = (*begins, *number);
                queue.pop_first();
                let step = &schedule.steps[number];
                if begins {
                    self.checker.log_action(now, &format!("*** {}", step.action));
                    self.executor.begin(&mut self.fleet, number, &step.action).await;
                } else {
                    self.checker.log_action(now, &format!("*** over: {}", step.action));
                    self.executor.end(&mut self.fleet, number).await;
                }
                self.checker.check(&self.fleet)?;
            }
            let next = queue.first_key_value().map(|((at_ms, ..), _)| Duration::from_millis(*at_ms));
            if next.is_none() && now >= faults_end {
                return Ok(());
            }
            self.pass(next.unwrap_or(faults_end)).await;
        }
    }

    /// Lets time pass until something happens, at most until `end`.
    async fn pass(&mut self, end: Duration) {
        let left = end.saturating_sub(self.fleet.elapsed()).max(Duration::from_millis(1));
        // Both results, an event or a timeout, call for the next check.
        let _ = timeout(left.min(CHECK_INTERVAL), self.checker.grown.changed()).await;
    }

    /// Lets time pass until `done` returns true.
    async fn until(&mut self, what: &str, limit: Duration, done: impl Fn(&Fleet) -> bool) -> Result<(), Violation> {
        let end = self.fleet.elapsed() + limit;
        loop {
            self.executor.advance(&mut self.fleet).await;
            self.checker.check(&self.fleet)?;
            if done(&self.fleet) {
                return Ok(());
            }
            if self.fleet.elapsed() >= end {
                let reason = format!("timeout waiting for {what} within {} s: {}", limit.as_secs(), self.state_text());
                return Err(self.checker.violation("liveness", reason, &self.fleet));
            }
            self.pass(end).await;
        }
    }

    fn state_text(&self) -> String {
        let acknowledged = self.executor.acknowledged();
        let leading: Vec<_> = self.fleet.nodes.iter().filter(|(_, node)| leads(node)).map(|(name, _)| name).collect();
        let not_alive: Vec<String> = not_alive(&self.fleet).collect();
        format!(
            "leading {leading:?}; acknowledged {acknowledged:?}; unfinished {:?}; not alive {not_alive:?}",
            unfinished(&self.fleet, &acknowledged).iter().map(|id| self.mission_text(id)).collect::<Vec<_>>(),
        )
    }

    /// Describes the roles of a mission and its latest auction.
    fn mission_text(&self, id: &str) -> String {
        let describe = |ledger: &Ledger| {
            let entry = ledger.mission(&slug(id))?;
            let role = |(role, state): (&RoleId, &RoleEntry)| {
                let holder = state.holder.as_ref().map_or("nobody", |holder| holder.robot.as_str());
                format!("{role} {:?} by {holder}, {} steps ended", state.phase, state.ended.len())
            };
            let roles: Vec<String> = entry.roles.iter().map(role).collect();
            let refusals = entry.auction.iter().flat_map(|auction| &auction.entries);
            let refusals: Vec<String> = refusals.map(|entry| format!("{}: {:?}", entry.robot, entry.verdict)).collect();
            Some(format!("{id} ({}; last auction: {})", roles.join("; "), refusals.join(", ")))
        };
        self.fleet.ledger(describe).flatten().unwrap_or_else(|| id.to_owned())
    }

    /// Cuts the link between two nodes in both directions and restarts the first. The second node
    /// must learn of the restart through third nodes, because gossip crosses the fleet even without
    /// a direct link.
    async fn check_relay(&mut self, seed: u64, composition: &ChaosFleet) -> Result<(), Violation> {
        let nodes: Vec<&str> =
            composition.nodes().into_iter().filter(|node| self.fleet.nodes.contains_key(*node)).collect();
        let pick = |salt: u64| nodes[usize::try_from((seed ^ salt) % nodes.len() as u64).unwrap_or(0)];
        let (restarted, other) = (pick(0x51), pick(0xa7));
        if restarted == other {
            return Ok(());
        }
        let (one_id, other_id) = (slug::<NodeId>(restarted), slug::<NodeId>(other));
        self.fleet.network.cut(one_id.clone(), other_id.clone());
        self.fleet.network.cut(other_id.clone(), one_id.clone());
        self.checker.log_action(
            self.fleet.elapsed(),
            &format!("*** the link between {restarted} and {other} is cut; {restarted} restarts"),
        );
        let step = usize::MAX;
        self.executor.crash(&mut self.fleet, step, &[restarted.to_owned()], DiskAfterCrash::Kept).await;
        self.executor.end(&mut self.fleet, step).await;
        let end = self.fleet.elapsed() + RELAY_LIMIT;
        loop {
            self.checker.check(&self.fleet)?;
            let incarnation = |fleet: &Fleet, at: &str| {
                let node = fleet.nodes.get(at)?;
                node.knowledge.read(|base| base.get(&one_id).map(|known| known.record.stamp.incarnation))
            };
            let (own, seen_by_other) = (incarnation(&self.fleet, restarted), incarnation(&self.fleet, other));
            if own.is_some() && own == seen_by_other {
                break;
            }
            if self.fleet.elapsed() >= end {
                let limit = RELAY_LIMIT.as_secs();
                let rejections = self.fleet.signing_buses.get(other).map(|bus| bus.rejections()).unwrap_or_default();
                let reason = format!(
                    "{other} has not learned within {limit} s that {restarted} restarted (incarnation {own:?}, known {seen_by_other:?}; rejected {rejections:?})"
                );
                return Err(self.checker.violation("relay", reason, &self.fleet));
            }
            self.pass(end).await;
        }
        self.fleet.network.heal();
        Ok(())
    }
}

fn leads(node: &consort_fleet::node::NodeHandle) -> bool {
    node.replica.as_ref().is_some_and(|replica| replica.leadership().borrow().is_leader)
}

/// Checks that there is exactly one leader, and that every running node counts every other node
/// alive.
fn has_converged(fleet: &Fleet) -> bool {
    fleet.nodes.values().filter(|node| leads(node)).count() == 1 && not_alive(fleet).next().is_none()
}

/// Returns the pairs in which a node does not count another node alive.
fn not_alive(fleet: &Fleet) -> impl Iterator<Item = String> {
    let pairs = fleet.nodes.iter().flat_map(|(name, node)| fleet.nodes.keys().map(move |other| (name, node, other)));
    pairs
        .filter(|(_, node, other)| !node.knowledge.is_alive(&slug(other)))
        .map(|(name, _, other)| format!("{other} by {name}"))
}

/// Returns the acknowledged missions that have not ended in the ledger of the coordinator; all of
/// them without a coordinator.
fn unfinished(fleet: &Fleet, acknowledged: &BTreeMap<String, String>) -> Vec<String> {
    let open = |mission: &&String| {
        let id: MissionId = slug(mission);
        // A mission that the ledger has forgotten has ended.
        fleet.ledger(|ledger| ledger.mission_state(&id).is_none_or(MissionState::is_final)) != Some(true)
    };
    acknowledged.values().filter(open).cloned().collect()
}

/// Checks all invariants.
struct Checker {
    invariants: Vec<Box<dyn Invariant>>,
    /// Number of checked entries of the event log.
    seen: usize,
    /// Running nodes that have ended by themselves and are in the log as such.
    ended: BTreeSet<NodeId>,
    grown: tokio::sync::watch::Receiver<usize>,
    actions: Vec<(Duration, String)>,
    counters: RunCounters,
    coverage: CoverageObserver,
    /// Number of checked entries of the event log that are kept for the report of a violation; `None` for all.
    kept: Option<usize>,
}

/// Number of lines in the log of a violation.
const EVENT_LINES_MAX: usize = 80;

impl Checker {
    fn new(ended_missions_max: usize, lease: Duration, schedule: &Schedule) -> Checker {
        let cancelations = schedule.cancelations().into_iter();
        let cancelations = cancelations.map(|(number, selection)| (person(number), selection)).collect();
        let grown = tokio::sync::watch::Sender::new(0).subscribe();
        Checker {
            invariants: invariants::all(ended_missions_max, lease, cancelations),
            seen: 0,
            ended: BTreeSet::new(),
            grown,
            actions: vec![],
            counters: RunCounters::default(),
            coverage: CoverageObserver::default(),
            kept: None,
        }
    }

    /// Logs an action of the schedule for the report of a violation.
    fn log_action(&mut self, at: Duration, what: &str) {
        self.actions.push((at, what.to_owned()));
    }

    /// Checks everything that has happened since the last call.
    fn check(&mut self, fleet: &Fleet) -> Result<(), Violation> {
        if self.seen == 0 {
            self.grown = fleet.event_log.subscribe_len();
        }
        self.grown.mark_unchanged();
        for (at, entry) in fleet.event_log.since(self.seen) {
            self.seen += 1;
            self.counters.observe(at, &entry);
            self.coverage.observe(&entry);
            if let Observation::TestAction { node, action: "killed" } = &entry {
                self.ended.remove(node);
            }
            for invariant in &mut self.invariants {
                if let Err(InvariantViolation(reason)) = invariant.observe(at, &entry, fleet) {
                    let name = invariant.name();
                    return Err(self.violation(name, reason, fleet));
                }
            }
        }
        if let Some(kept) = self.kept {
            fleet.event_log.forget_before_latest(kept);
        }
        // After everything that the node published before.
        for node in fleet.ended_nodes() {
            if self.ended.insert(node.clone()) {
                fleet.event_log.add(Observation::TestAction { node, action: "ended" });
            }
        }
        let now = fleet.elapsed();
        for entry in fleet.world.with(World::drain_event_log) {
            for invariant in &mut self.invariants {
                if let Err(InvariantViolation(reason)) = invariant.observe_world(now, &entry, fleet) {
                    let name = invariant.name();
                    return Err(self.violation(name, reason, fleet));
                }
            }
        }
        for invariant in &mut self.invariants {
            if let Err(InvariantViolation(reason)) = invariant.check_state(now, fleet) {
                let name = invariant.name();
                return Err(self.violation(name, reason, fleet));
            }
        }
        Ok(())
    }

    fn end(&mut self, fleet: &Fleet) -> Result<(), Violation> {
        for invariant in &mut self.invariants {
            if let Err(InvariantViolation(reason)) = invariant.check_end(fleet) {
                let name = invariant.name();
                return Err(self.violation(name, reason, fleet));
            }
        }
        Ok(())
    }

    fn violation(&self, invariant: &str, reason: String, fleet: &Fleet) -> Violation {
        let entries =
            fleet.event_log.lines(|entry| !matches!(entry, Observation::LeadershipChanged { leading_as: None, .. }));
        let done = self.actions.iter().map(|(at, what)| (*at, format!("{:8.3} {what}", at.as_secs_f64())));
        let mut events_before: Vec<(Duration, String)> = entries.into_iter().chain(done).collect();
        events_before.sort_by_key(|(at, _)| *at);
        let events_before = events_before
            .split_off(events_before.len().saturating_sub(EVENT_LINES_MAX))
            .into_iter()
            .map(|(_, line)| line)
            .collect();
        Violation { invariant: invariant.to_owned(), at_ms: millis(fleet.elapsed()), reason, events_before }
    }
}
