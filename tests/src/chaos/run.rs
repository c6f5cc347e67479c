//! One run: a fleet, a schedule, and whether all that must hold held.
//!
//! ```text
//!  founding │ schedule: requests and faults │ all faults lift │ quiet, to the end of the run │ two that do not hear one another
//!  ─────────┴──────── invariants at every step ───────────────┴─────── liveness ─────────────┴──────────── relay ───────────▶
//! ```

use super::chaos_fleet::{ChaosFleet, ROOMS};
use super::executor::ActionExecutor;
use super::fault_injector::FaultInjector;
use super::generate::LIFTED;
use super::invariants::{self, Invariant};
use super::run_counters::RunCounters;
use super::schedule::{DiskAfterCrash, Schedule};
use crate::{Fleet, Observation, slug};
use consort_protocol::ids::{MissionId, NodeId};
use consort_sim::world::World;
use serde::Serialize;
use std::any::Any;
use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hasher};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;
use tokio::time::timeout;

/// How often the world is looked at while nothing else happens.
const LOOK: Duration = Duration::from_millis(20);

/// How long missions may take to end once all faults have lifted: each of up to a dozen waits for the one arm.
const ENDS_WITHIN: Duration = Duration::from_secs(600);

/// How long a fleet may take to be of one mind once all faults have lifted.
const SETTLES_WITHIN: Duration = Duration::from_secs(60);

/// How long word of a restart may take to somebody who does not hear that node.
const RELAYED_WITHIN: Duration = Duration::from_secs(30);

/// What is to be run.
#[derive(Debug, Clone, PartialEq)]
pub struct RunConfig {
    /// Where all chance comes from.
    pub seed: u64,
    /// Nodes of the fleet, the host of the world not counted.
    pub nodes: usize,
    /// Simulated minutes.
    pub minutes: f64,
    /// Whether nodes have certificates, and seal what they say.
    pub closed: bool,
}

/// What came of a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunOutcome {
    /// Its seed.
    pub seed: u64,
    /// What did not hold, if anything.
    pub violation: Option<Violation>,
    /// What was counted.
    pub tally: RunCounters,
    /// A digest of all that happened and every message: equal runs have equal ones.
    pub digest: String,
}

/// Something did not hold.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Violation {
    /// What: the name of an invariant, or `liveness`, `relay`, `panic`.
    pub invariant: String,
    /// When, in milliseconds since the fleet was started.
    pub at_ms: u64,
    /// How, in words.
    pub why: String,
    /// What happened before, a line each, the last at the end.
    pub tale: Vec<String>,
}

/// Carries an order out. It takes a thread for itself: one paused runtime, nothing of which is left afterwards.
pub fn run(order: &RunConfig, schedule: &Schedule) -> RunOutcome {
    let mut builder = tokio::runtime::Builder::new_current_thread();
    let runtime = builder.enable_time().start_paused(true).build().expect("a runtime without I/O");
    let played = catch_unwind(AssertUnwindSafe(|| runtime.block_on(play(order, schedule))));
    played.unwrap_or_else(|panic| RunOutcome {
        seed: order.seed,
        violation: Some(Violation { invariant: "panic".to_owned(), at_ms: 0, why: in_words(&*panic), tale: vec![] }),
        tally: RunCounters::default(),
        digest: String::new(),
    })
}

fn in_words(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    text.unwrap_or("a panic without words").to_owned()
}

async fn play(order: &RunConfig, schedule: &Schedule) -> RunOutcome {
    let cast = ChaosFleet::of(order.nodes);
    let gear = FaultInjector::new(order.seed, &cast, schedule);
    let adjust = gear.adjust();
    let fleet = Fleet::hospital_with(order.seed, cast.members(), &cast.stations, &ROOMS, adjust, order.closed).await;
    let mut run = Run { fleet, hand: ActionExecutor::new(cast.clone(), gear), judge: Judge::new() };
    for node in cast.nodes() {
        run.fleet.record_leadership(node);
    }
    let violation = run.through(order, schedule, &cast).await.err();
    let Run { fleet, hand, mut judge } = run;
    judge.tally.end(&fleet, &hand.acknowledged());
    let mut hasher = DefaultHasher::new();
    hasher.write(fleet.event_log_text().as_bytes());
    hasher.write_u64(fleet.network.digest());
    let digest = format!("{:016x}", hasher.finish());
    RunOutcome { seed: order.seed, violation, tally: judge.tally, digest }
}

struct Run {
    fleet: Fleet,
    hand: ActionExecutor,
    judge: Judge,
}

impl Run {
    async fn through(&mut self, order: &RunConfig, schedule: &Schedule, cast: &ChaosFleet) -> Result<(), Violation> {
        let lifted = Duration::from_secs_f64(order.minutes * 60.0 * LIFTED);
        self.schedule(schedule, lifted).await?;
        self.hand.end_all_faults(&mut self.fleet).await;
        self.fleet.heal();
        self.hand.spawn_resolver(&self.fleet);
        let since = self.fleet.elapsed();
        self.until("one coordinator whom all follow, and all known to all", SETTLES_WITHIN, of_one_mind).await?;
        let requests: Vec<String> = schedule.steps.iter().filter_map(|step| step.action.submitted_request()).collect();
        let hand = self.hand.acknowledged_receiver();
        self.until("an end of every mission", ENDS_WITHIN, move |fleet| {
            let acknowledged = hand.borrow();
            requests.iter().all(|request| acknowledged.contains_key(request))
                && unfinished(fleet, &acknowledged).is_empty()
        })
        .await?;
        self.judge.tally.converged_ms = Some(millis(self.fleet.elapsed() - since));
        self.judge.end(&self.fleet)?;
        // What is left of the run is quiet.
        let end = Duration::from_secs_f64(order.minutes * 60.0);
        while self.fleet.elapsed() < end {
            self.pass(end).await;
            self.judge.look(&self.fleet)?;
        }
        self.estrange(order.seed, cast).await
    }

    /// Requests and faults, until all have lifted.
    async fn schedule(&mut self, schedule: &Schedule, lifted: Duration) -> Result<(), Violation> {
        // Ends before beginnings of the same instant, both in the order of the steps.
        let mut agenda: BTreeMap<(u64, bool, usize), usize> = BTreeMap::new();
        for (number, step) in schedule.steps.iter().enumerate() {
            agenda.insert((step.at_ms, true, number), number);
            if let Some(for_ms) = step.action.for_ms() {
                agenda.insert((step.at_ms + for_ms, false, number), number);
            }
        }
        loop {
            self.judge.look(&self.fleet)?;
            let now = self.fleet.elapsed();
            while let Some(((at_ms, begins, number), _)) = agenda.first_key_value()
                && Duration::from_millis(*at_ms) <= now
            {
                let (begins, number) = (*begins, *number);
                agenda.pop_first();
                let step = &schedule.steps[number];
                if begins {
                    self.judge.tell(now, &format!("*** {}", step.action));
                    self.hand.begin(&mut self.fleet, number, &step.action).await;
                } else {
                    self.judge.tell(now, &format!("*** over: {}", step.action));
                    self.hand.end(&mut self.fleet, number).await;
                }
                self.judge.look(&self.fleet)?;
            }
            let next = agenda.first_key_value().map(|((at_ms, ..), _)| Duration::from_millis(*at_ms));
            if next.is_none() && now >= lifted {
                return Ok(());
            }
            self.pass(next.unwrap_or(lifted)).await;
        }
    }

    /// Lets time pass until something happens, at most until `end`.
    async fn pass(&mut self, end: Duration) {
        let left = end.saturating_sub(self.fleet.elapsed()).max(Duration::from_millis(1));
        // Whether it ends by news or by time, it is time to look.
        let _ = timeout(left.min(LOOK), self.judge.grown.changed()).await;
    }

    /// Lets time pass until `done` says so.
    async fn until(&mut self, what: &str, limit: Duration, done: impl Fn(&Fleet) -> bool) -> Result<(), Violation> {
        let end = self.fleet.elapsed() + limit;
        loop {
            self.judge.look(&self.fleet)?;
            if done(&self.fleet) {
                return Ok(());
            }
            if self.fleet.elapsed() >= end {
                let why = format!("{what} has not come within {} s: {}", limit.as_secs(), self.state_of_things());
                return Err(self.judge.violation("liveness", why, &self.fleet));
            }
            self.pass(end).await;
        }
    }

    fn state_of_things(&self) -> String {
        let acknowledged = self.hand.acknowledged();
        let leading: Vec<_> = self.fleet.nodes.iter().filter(|(_, node)| leads(node)).map(|(name, _)| name).collect();
        let strangers: Vec<String> = strangers(&self.fleet).collect();
        format!(
            "leading {leading:?}; acknowledged {acknowledged:?}; unfinished {:?}; judged dead {strangers:?}",
            unfinished(&self.fleet, &acknowledged),
        )
    }

    /// Two nodes do not hear one another at all. One of them starts anew: the other must hear of it through third parties,
    /// for word of nodes crosses the fleet even where it does not meet.
    async fn estrange(&mut self, seed: u64, cast: &ChaosFleet) -> Result<(), Violation> {
        let nodes = cast.nodes();
        let pick = |salt: u64| nodes[usize::try_from((seed ^ salt) % nodes.len() as u64).unwrap_or(0)];
        let (one, other) = (pick(0x51), pick(0xa7));
        if one == other {
            return Ok(());
        }
        let (one_id, other_id) = (slug::<NodeId>(one), slug::<NodeId>(other));
        self.fleet.network.cut(one_id.clone(), other_id.clone());
        self.fleet.network.cut(other_id.clone(), one_id.clone());
        self.judge
            .tell(self.fleet.elapsed(), &format!("*** {one} and {other} do not hear one another; {one} starts anew"));
        let step = usize::MAX;
        self.hand.crash(&mut self.fleet, step, &[one.to_owned()], DiskAfterCrash::Kept).await;
        self.hand.end(&mut self.fleet, step).await;
        let end = self.fleet.elapsed() + RELAYED_WITHIN;
        loop {
            self.judge.look(&self.fleet)?;
            let life = |fleet: &Fleet, at: &str| {
                let node = fleet.nodes.get(at)?;
                node.knowledge.read(|base| base.get(&one_id).map(|heard| heard.record.stamp.incarnation))
            };
            let (own, heard) = (life(&self.fleet, one), life(&self.fleet, other));
            if own.is_some() && own == heard {
                break;
            }
            if self.fleet.elapsed() >= end {
                let limit = RELAYED_WITHIN.as_secs();
                let why = format!(
                    "{other} has not heard within {limit} s that {one} started anew (life {own:?}, heard {heard:?})"
                );
                return Err(self.judge.violation("relay", why, &self.fleet));
            }
            self.pass(end).await;
        }
        self.fleet.network.heal();
        Ok(())
    }
}

fn leads(node: &consort_actors::node::NodeHandle) -> bool {
    node.replica.as_ref().is_some_and(|replica| replica.leadership().borrow().is_leader)
}

/// Exactly one leads, and everybody that runs counts everybody else alive.
fn of_one_mind(fleet: &Fleet) -> bool {
    fleet.nodes.values().filter(|node| leads(node)).count() == 1 && strangers(fleet).next().is_none()
}

/// Who does not count whom alive.
fn strangers(fleet: &Fleet) -> impl Iterator<Item = String> {
    let pairs = fleet.nodes.iter().flat_map(|(name, node)| fleet.nodes.keys().map(move |other| (name, node, other)));
    pairs
        .filter(|(_, node, other)| !node.knowledge.is_alive(&slug(other)))
        .map(|(name, _, other)| format!("{other} by {name}"))
}

/// Acknowledged missions that have not ended, as the coordinator's ledger says; all, while there is none.
fn unfinished(fleet: &Fleet, acknowledged: &BTreeMap<String, String>) -> Vec<String> {
    let open = |mission: &&String| {
        let id: MissionId = slug(mission);
        fleet.ledger(|ledger| ledger.mission(&id).is_some_and(|entry| entry.state.is_final())) != Some(true)
    };
    acknowledged.values().filter(open).cloned().collect()
}

pub(super) fn millis(time: Duration) -> u64 {
    u64::try_from(time.as_millis()).unwrap_or(u64::MAX)
}

/// Watches all invariants.
struct Judge {
    invariants: Vec<Box<dyn Invariant>>,
    /// Entries of the chronicle that were looked at.
    seen: usize,
    grown: tokio::sync::watch::Receiver<usize>,
    told: Vec<(Duration, String)>,
    tally: RunCounters,
}

/// Lines of a violation's tale.
const TALE: usize = 80;

impl Judge {
    fn new() -> Judge {
        let grown = tokio::sync::watch::Sender::new(0).subscribe();
        Judge { invariants: invariants::all(), seen: 0, grown, told: vec![], tally: RunCounters::default() }
    }

    /// Notes what chaos does, for the tale.
    fn tell(&mut self, at: Duration, what: &str) {
        self.told.push((at, what.to_owned()));
    }

    /// Looks at all that has happened since the last look.
    fn look(&mut self, fleet: &Fleet) -> Result<(), Violation> {
        if self.seen == 0 {
            self.grown = fleet.event_log.subscribe_len();
        }
        self.grown.mark_unchanged();
        for (at, entry) in fleet.event_log.since(self.seen) {
            self.seen += 1;
            self.tally.observe(at, &entry);
            for invariant in &mut self.invariants {
                if let Err(why) = invariant.observe(at, &entry, fleet) {
                    let name = invariant.name();
                    return Err(self.violation(name, why, fleet));
                }
            }
        }
        let now = fleet.elapsed();
        for entry in fleet.world.with(World::drain_event_log) {
            for invariant in &mut self.invariants {
                if let Err(why) = invariant.observe_world(now, &entry, fleet) {
                    let name = invariant.name();
                    return Err(self.violation(name, why, fleet));
                }
            }
        }
        Ok(())
    }

    fn end(&mut self, fleet: &Fleet) -> Result<(), Violation> {
        for invariant in &mut self.invariants {
            if let Err(why) = invariant.check_end(fleet) {
                let name = invariant.name();
                return Err(self.violation(name, why, fleet));
            }
        }
        Ok(())
    }

    fn violation(&self, invariant: &str, why: String, fleet: &Fleet) -> Violation {
        let entries =
            fleet.event_log.lines(|entry| !matches!(entry, Observation::LeadershipChanged { leading_as: None, .. }));
        let done = self.told.iter().map(|(at, what)| (*at, format!("{:8.3} {what}", at.as_secs_f64())));
        let mut tale: Vec<(Duration, String)> = entries.into_iter().chain(done).collect();
        tale.sort_by_key(|(at, _)| *at);
        let tale = tale.split_off(tale.len().saturating_sub(TALE)).into_iter().map(|(_, line)| line).collect();
        Violation { invariant: invariant.to_owned(), at_ms: millis(fleet.elapsed()), why, tale }
    }
}
