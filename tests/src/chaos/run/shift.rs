//! A shift under faults: the requests of a [`shift`](crate::shift), the faults of chaos, and the check of all
//! invariants.
//!
//! Faults begin and end as long as missions are requested. Meanwhile a person resolves missions that need
//! intervention, and another replaces empty batteries: otherwise fewer and fewer robots would be left. There are no
//! faults that end missions (drained batteries, failing skills, missions that cannot be completed) or remove nodes
//! for good, and no orders of people. No client reads missions, because the check of a history compares each read of
//! a list with all missions.

use super::{CONVERGENCE_LIMIT, Checker, MISSION_LIMIT, Run, Violation, has_converged, panic_text};
use crate::chaos::chaos_fleet::{ChaosFleet, MISSIONS, ROOMS};
use crate::chaos::dates::DATE_MS;
use crate::chaos::executor::{ActionExecutor, replace_empty_batteries};
use crate::chaos::fault_injector::FaultInjector;
use crate::chaos::fault_kind::FaultKind;
use crate::chaos::generate::{FIRST_MS, LIFTED, generate, lease_terms};
use crate::chaos::invariants::{Invariant, InvariantViolation};
use crate::chaos::quiet_thread::quiet_thread;
use crate::chaos::schedule::{ChaosAction, Schedule, ScheduledAction};
use crate::fleet::NodeOptions;
use crate::shift::record::ShiftRecord;
use crate::shift::{ShiftSetup, work};
use crate::{Fleet, Observation, RobotSpec, paused_runtime};
use consort_evaluation::shift::ShiftFigures;
use consort_protocol::ledger::Ledger;
use consort_skills::workload::Workload;
use consort_world::world::LoggedEvent;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;
use std::thread;
use std::time::{Duration, Instant};

/// Number of entries of the event log that are kept.
const KEPT: usize = 2_000;

/// Factor by which a fleet of a shift may converge later than others: it has more nodes, which an upgrade restarts in
/// turn.
const SIZE_FACTOR: u32 = 4;

/// Interval at which a person replaces empty batteries.
const BATTERY_INTERVAL: Duration = Duration::from_secs(10);

/// A shift under faults.
#[derive(Debug, Clone, PartialEq)]
pub struct FaultyShift {
    /// Its figures.
    pub figures: ShiftFigures,
    /// Number of faults.
    pub faults: usize,
    /// The violated invariant, if any. The shift ends with it.
    pub violation: Option<Violation>,
}

/// Runs a shift under faults, with the policy of the fleet. The seed determines requests and faults.
///
/// # Panics
/// If the fleet has more than 20 carriers, 3 arms or 6 chargers, or if the run panics.
pub fn run_shift(setup: &ShiftSetup) -> FaultyShift {
    thread::scope(|scope| {
        let shift = quiet_thread().spawn_scoped(scope, || paused_runtime().block_on(execute(setup)));
        let shift = shift.expect("a thread can be started").join();
        shift.unwrap_or_else(|problem| panic!("seed {}: {}", setup.seed, panic_text(&*problem)))
    })
}

async fn execute(setup: &ShiftSetup) -> FaultyShift {
    let wall = Instant::now();
    let mut chance = ChaCha8Rng::seed_from_u64(setup.seed);
    let rooms = work::rooms(setup.chargers);
    let composition = ChaosFleet::of_shift(setup.robots, setup.arms);
    let carriers = work::draw_carriers(setup.robots, &rooms, &mut chance).into_iter().zip(&composition.carriers);
    let carriers = carriers.map(|(carrier, name)| RobotSpec { name: (*name).to_owned(), ..carrier });
    let arms = composition.arms.iter().map(|arm| RobotSpec::arm(arm, work::LABORATORY));
    let members: Vec<RobotSpec> = carriers.chain(arms).collect();
    let schedule = schedule(setup, &composition, work::draw_requests(setup, &rooms, &mut chance));
    let faults = schedule.steps.iter().filter(|step| step.action.is_fault()).count();
    let workload = Workload::default();
    let injector = FaultInjector::new(setup.seed, None, &composition, &schedule, workload.extensions);
    injector.use_limits_of_operation();
    let options = NodeOptions {
        world_speed: setup.world_speed,
        charging: work::charging(setup.chargers),
        adjust: injector.adjust(),
        date_ms: DATE_MS,
        ..NodeOptions::default()
    };
    let people = work::nurses(&rooms);
    let fleet = Fleet::hospital_with(setup.seed, members, &composition.stations, people, options).await;
    let record = Rc::new(RefCell::new(ShiftRecord::new(&fleet, composition.carriers.iter().copied())));
    let mut checker = Checker::new(injector.ended_missions_max(), lease_terms(setup.seed).lease, &schedule);
    checker.invariants.push(Box::new(Recorded {
        record: Rc::clone(&record),
        interval: setup.interval(),
        due: Duration::ZERO,
    }));
    checker.kept = Some(KEPT);
    let executor = ActionExecutor::new(composition.clone(), injector, workload).without_repetitions();
    let mut run = Run { fleet, executor, checker };
    for node in composition.nodes() {
        run.fleet.record_leadership(node);
    }
    run.executor.spawn_resolver(&run.fleet);
    let world = run.fleet.world.clone();
    tokio::spawn(async move {
        loop {
            tokio::time::sleep(BATTERY_INTERVAL).await;
            replace_empty_batteries(&world);
        }
    });
    let violation = run.shift_phases(&schedule, setup).await.err();
    let began = Duration::from_millis(FIRST_MS);
    let figures = record.borrow().figures(setup, &run.fleet, began, wall);
    FaultyShift { figures, faults, violation }
}

/// Returns the requests with faults among them.
fn schedule(setup: &ShiftSetup, composition: &ChaosFleet, requests: Vec<work::ShiftRequest>) -> Schedule {
    let node_s = |request: &work::ShiftRequest| request.at_s / setup.world_speed;
    let asked_ms: Vec<u64> = requests.iter().map(|request| FIRST_MS + (node_s(request) * 1000.0) as u64).collect();
    let last_s = requests.last().map_or(0.0, node_s);
    // Of the generated actions only the faults: the requests are those of the shift.
    let kinds: Vec<FaultKind> = FaultKind::FAULTS.into_iter().filter(|kind| !is_excluded(*kind)).collect();
    let generated = generate(setup.seed, composition, last_s / 60.0 / LIFTED, &kinds).steps;
    let mut names = names_of_generated(&generated, &asked_ms);
    let submit = |(number, (request, at_ms)): (usize, (work::ShiftRequest, u64))| ScheduledAction {
        at_ms,
        action: ChaosAction::Submit {
            request: names.remove(&number).unwrap_or_else(|| format!("shift-{number}")),
            unnamed: false,
            mission: MISSIONS[0].to_owned(),
            room: request.room.to_string(),
            priority: 0,
            deadline_s: None,
        },
    };
    let mut steps: Vec<ScheduledAction> = requests.into_iter().zip(asked_ms).enumerate().map(submit).collect();
    steps.extend(generated.into_iter().filter(|step| step.action.is_fault()));
    Schedule { world_speed: setup.world_speed as u32, ..Schedule::of(steps) }.in_order()
}

/// Returns the names of the generated requests, each with the number of the latest request of the shift at that time.
/// Some faults concern the carrier of a generated request.
fn names_of_generated(generated: &[ScheduledAction], asked_ms: &[u64]) -> BTreeMap<usize, String> {
    let mut names = BTreeMap::new();
    for step in generated {
        let asked = asked_ms.partition_point(|at_ms| *at_ms <= step.at_ms).max(1);
        if let Some(name) = step.action.submitted_request()
            && let Some(number) = (0..asked).rev().find(|number| !names.contains_key(number))
        {
            names.insert(number, name);
        }
    }
    names
}

/// Checks whether faults of a kind end missions by themselves, remove nodes for good, or need certificates.
fn is_excluded(kind: FaultKind) -> bool {
    use FaultKind::{Battery, CircularWait, Hostile, Poison, Revoke, Skill};
    matches!(kind, Battery | CircularWait | Hostile | Poison | Revoke | Skill)
}

/// Returns the limit for this number of missions to end, from the limit for the missions of other runs: at most one for
/// each room with a nurse.
fn limit_for(missions: usize) -> Duration {
    MISSION_LIMIT * u32::try_from(missions.div_ceil(ROOMS.len()).max(1)).unwrap_or(u32::MAX)
}

impl Run {
    async fn shift_phases(&mut self, schedule: &Schedule, setup: &ShiftSetup) -> Result<(), Violation> {
        let last_ms = schedule.steps.last().map_or(FIRST_MS, |step| step.at_ms);
        self.schedule(schedule, Duration::from_millis(last_ms)).await?;
        self.executor.end_all_faults(&mut self.fleet).await;
        self.fleet.heal();
        let is_upgraded = self.executor.upgrade_check();
        let what = "a single coordinator, all nodes alive in all views, and the latest version";
        self.until(what, CONVERGENCE_LIMIT * SIZE_FACTOR, |fleet| has_converged(fleet) && is_upgraded(fleet)).await?;
        let (acknowledged, missions) = (self.executor.acknowledged_receiver(), setup.missions);
        let unfinished = self.fleet.ledger(|ledger| ledger.active_missions().len()).unwrap_or(missions);
        self.until("an end of every mission", limit_for(unfinished) * schedule.slowdown(), |fleet| {
            let have_ended = |ledger: &Ledger| ledger.active_missions().is_empty();
            acknowledged.borrow().len() == missions && fleet.ledger(have_ended) == Some(true)
        })
        .await?;
        self.checker.end(&self.fleet)
    }
}

/// Records the shift as an invariant that always holds.
struct Recorded {
    record: Rc<RefCell<ShiftRecord>>,
    /// Interval of measurements.
    interval: Duration,
    /// Time of the next measurement.
    due: Duration,
}

impl Invariant for Recorded {
    fn name(&self) -> &'static str {
        "shift"
    }

    fn observe(&mut self, at: Duration, entry: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        self.record.borrow_mut().observe(at, entry);
        Ok(())
    }

    fn observe_world(&mut self, _: Duration, entry: &LoggedEvent, _: &Fleet) -> Result<(), InvariantViolation> {
        self.record.borrow_mut().observe_world(&entry.event);
        Ok(())
    }

    fn check_state(&mut self, at: Duration, fleet: &Fleet) -> Result<(), InvariantViolation> {
        if at >= self.due {
            self.due = at + self.interval;
            self.record.borrow_mut().measure(fleet);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chaos::FIRST_SEED_WITH_ALARMS;
    use crate::chaos::schedule::CARRIER_OF;

    #[test]
    fn a_backlog_of_missions_has_more_time_to_end() {
        assert_eq!([0, 1, 12].map(limit_for), [MISSION_LIMIT; 3]);
        assert_eq!([13, 30].map(limit_for), [MISSION_LIMIT * 2, MISSION_LIMIT * 3]);
    }

    #[test]
    fn a_shift_has_faults_among_its_requests_and_nothing_else() {
        let setup = ShiftSetup { missions: 200, per_hour: Some(100.0), world_speed: 10.0, ..ShiftSetup::default() };
        let rooms = work::rooms(0);
        let composition = ChaosFleet::of_shift(12, 2);
        let (mut faults, mut of_carriers) = (0, 0);
        // The later seeds generate requests of people of all kinds, too.
        for seed in (1..=10).chain(FIRST_SEED_WITH_ALARMS..FIRST_SEED_WITH_ALARMS + 10) {
            let setup = ShiftSetup { seed, ..setup };
            let mut chance = ChaCha8Rng::seed_from_u64(seed);
            let steps = schedule(&setup, &composition, work::draw_requests(&setup, &rooms, &mut chance)).steps;
            assert!(steps.is_sorted_by_key(|step| step.at_ms));
            let (requests, others): (Vec<_>, Vec<_>) =
                steps.iter().partition(|step| step.action.submitted_request().is_some());
            assert_eq!(requests.len(), setup.missions);
            for step in &others {
                assert!(step.at_ms <= requests[setup.missions - 1].at_ms, "seed {seed}: {step}");
                let is_excluded = matches!(
                    step.action,
                    ChaosAction::Cancel { .. }
                        | ChaosAction::ChangeSchedule { .. }
                        | ChaosAction::Order { .. }
                        | ChaosAction::Closure { .. }
                        | ChaosAction::Alarm { .. }
                        | ChaosAction::SpeedLimit { .. }
                        | ChaosAction::ChangeMission { .. }
                        | ChaosAction::CancelMissions { .. }
                        | ChaosAction::Battery { .. }
                        | ChaosAction::Remove { .. }
                        | ChaosAction::Revoke { .. }
                        | ChaosAction::Hostile { .. }
                );
                assert!(!is_excluded, "seed {seed}: {step}");
                if let ChaosAction::Crash { node, .. } = &step.action
                    && let Some(name) = node.strip_prefix(CARRIER_OF)
                {
                    let is_named =
                        |request: &&&ScheduledAction| request.action.submitted_request().as_deref() == Some(name);
                    let request = requests.iter().find(is_named).expect("a request of the shift");
                    assert!(step.at_ms.abs_diff(request.at_ms) < 60_000, "seed {seed}: {request}, {step}");
                    of_carriers += 1;
                }
            }
            faults += others.len();
        }
        assert!(faults > 100 && of_carriers > 0, "{faults}, {of_carriers}");
    }
}
