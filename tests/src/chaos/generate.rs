//! Generation of schedules from a seed.

use super::alarms::{self, add_alarms};
use super::chaos_fleet::{ChaosFleet, MISSIONS, ROOMS, WORLD};
use super::chargers::add_chargers;
use super::closures::add_closures;
use super::control_flow::replace_missions;
use super::fault_kind::{FEW_KINDS, FaultKind};
use super::mission_changes::add_mission_changes;
use super::orders::add_orders;
use super::poison::replace_poison;
use super::recurring::add_schedule;
use super::revocation::add_revocation;
use super::schedule::{ChaosAction, DiskAfterCrash, Schedule, ScheduledAction, SkillFault};
use super::small_limits::{add_burst, has_small_limits};
use super::speed_limits::add_speed_limits;
use super::zones::add_zone_orders;
use crate::disk::DiskFault;
use consort_protocol::lease::LeaseTerms;
use consort_protocol::trust::NodeRole;
use rand::seq::{IndexedMutRandom, IndexedRandom, SliceRandom};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::ops::Range;
use std::time::Duration;

/// Share of a run after which all faults have ended.
pub(crate) const LIFTED: f64 = 0.7;

/// Time of the first possible fault. The cluster usually exists by then.
pub(super) const FIRST_MS: u64 = 4_000;

/// Duration for which a carrier is isolated so that its role is reassigned: longer than lease and
/// grace.
pub(super) const AWAY_MS: Range<u64> = 15_000..30_000;

/// Number of times at which a carrier is isolated and killed at the end of its lease, in each run.
const LEASE_ENDS: usize = 2;

/// Roles in the certificates of hostile nodes.
const HOSTILE_ROLES: [Option<NodeRole>; 5] =
    [Some(NodeRole::Robot), Some(NodeRole::Host), Some(NodeRole::Dashboard), None, Some(NodeRole::Voter)];

/// Share of the runs with each kind of fault that is drawn separately. A run with few kinds has all of
/// them.
const SEPARATE: f64 = 0.2;

/// Share of the runs with the fault `lease-end` in a slow world, and its speed. With few kinds of faults the
/// share is larger.
const SLOW_WORLD: [f64; 2] = [0.25, 0.75];
const SLOW_SPEED: u32 = 2;

/// Leases and graces in milliseconds. All tolerate as much drift of the clocks as the default does.
const LEASES_MS: [(u64, u64); 3] = [(4_000, 2_000), (2_000, 1_700), (1_000, 1_550)];

/// First seed of fleets with the settings of a large fleet. Fleets of smaller seeds keep theirs.
pub const FIRST_LARGE_SEED: u64 = 5001;

/// Checks whether the fleet of the run with this seed has the settings of a large fleet: the motion of robots is sent apart
/// from their records, and some robots do not receive it.
pub(super) fn is_large(seed: u64) -> bool {
    seed >= FIRST_LARGE_SEED
}

/// Returns the lease terms of the run with this seed.
pub(super) fn lease_terms(seed: u64) -> LeaseTerms {
    let number = usize::try_from(seed / 2 % LEASES_MS.len() as u64).expect("a small number");
    let (lease, grace) = LEASES_MS[number];
    LeaseTerms { lease: Duration::from_millis(lease), grace: Duration::from_millis(grace) }
}

/// Checks for a fault that is drawn separately: one or two for each run.
fn is_rare(kind: FaultKind) -> bool {
    matches!(kind, FaultKind::CrashDamaged | FaultKind::Disk(_))
}

/// Generates a schedule with faults of these kinds for a fleet that runs for `minutes`.
pub fn generate(seed: u64, composition: &ChaosFleet, minutes: f64, kinds: &[FaultKind]) -> Schedule {
    let chance = ChaCha8Rng::seed_from_u64(seed ^ 0x5eed_0fc4_a05f);
    let end_ms = u64::try_from(Duration::from_secs_f64(minutes * 60.0 * LIFTED).as_millis()).unwrap_or(u64::MAX);
    let mut draw = Draw {
        chance,
        composition,
        lease_terms: lease_terms(seed),
        end_ms: end_ms.max(FIRST_MS + 2_000),
        steps: vec![],
        lost_disks: vec![],
        drained: vec![],
    };
    draw.requests(minutes);
    // These and rare faults are drawn separately, below.
    let is_own = |kind: &&FaultKind| kind.is_drawn_separately();
    let (rare, kinds_of_faults): (Vec<&FaultKind>, Vec<&FaultKind>) =
        kinds.iter().filter(|kind| !is_own(kind)).partition(|kind| is_rare(**kind));
    if !kinds_of_faults.is_empty() {
        // On average about one fault in twenty seconds; some runs have far fewer, some far more.
        let most = (draw.end_ms / 12_000).max(2);
        let count = draw.chance.random_range(1..=most);
        for _ in 0..count {
            let kind = **kinds_of_faults.choose(&mut draw.chance).expect("there are some");
            draw.fault(kind);
        }
    }
    // A separate generator, so that further draws do not change the times and faults above.
    draw.chance = ChaCha8Rng::seed_from_u64(seed ^ 0xa5_4ed0_0d1f);
    draw.vary();
    if kinds.contains(&FaultKind::Hostile) {
        draw.hostile(seed);
    }
    if kinds.contains(&FaultKind::Partition) {
        draw.isolate_carrier();
    }
    draw.chance = ChaCha8Rng::seed_from_u64(seed ^ 0xd15c_fa17);
    if !rare.is_empty() {
        for _ in 0..draw.chance.random_range(1..=2) {
            let kind = **rare.choose(&mut draw.chance).expect("there are some");
            draw.fault(kind);
        }
    }
    draw.chance = ChaCha8Rng::seed_from_u64(seed ^ 0x1ea5_e0ed);
    if kinds.contains(&FaultKind::LeaseEnd) {
        for _ in 0..LEASE_ENDS {
            draw.lease_end();
        }
    }
    for kind in kinds.iter().filter(|kind| kind.is_drawn_separately()) {
        let salted = kind.name().bytes().fold(seed, |salted, byte| salted.wrapping_mul(257).wrapping_add(byte.into()));
        draw.chance = ChaCha8Rng::seed_from_u64(salted);
        if kinds.len() <= FEW_KINDS || draw.chance.random_bool(SEPARATE) {
            draw.separate(*kind);
        }
    }
    draw.chance = ChaCha8Rng::seed_from_u64(seed ^ 0x510_77ed);
    let is_slow = kinds.contains(&FaultKind::LeaseEnd)
        && draw.chance.random_bool(SLOW_WORLD[usize::from(kinds.len() <= FEW_KINDS)]);
    replace_missions(seed, kinds, &mut draw.steps);
    replace_poison(seed, kinds, &mut draw.steps);
    add_schedule(seed, kinds, draw.end_ms, &mut draw.steps);
    add_orders(seed, kinds, composition, FIRST_MS..draw.end_ms, &mut draw.steps);
    add_closures(seed, kinds, FIRST_MS..draw.end_ms, &mut draw.steps);
    if seed >= alarms::FIRST_SEED && kinds != [FaultKind::Poison] {
        add_zone_orders(seed, FIRST_MS..draw.end_ms, &mut draw.steps);
        add_alarms(seed, FIRST_MS..draw.end_ms, &mut draw.steps);
        add_speed_limits(seed, FIRST_MS..draw.end_ms, &mut draw.steps);
        add_mission_changes(seed, composition, FIRST_MS..draw.end_ms, &mut draw.steps);
    }
    let small_limits = has_small_limits(seed, kinds);
    if small_limits {
        add_burst(&mut draw.steps);
    }
    // The node that is gone for good may be a voter.
    if draw.lost_disks.is_empty() {
        add_revocation(seed, kinds, draw.end_ms, &mut draw.steps);
    }
    let schedule = Schedule::of(draw.steps).in_order();
    let world_speed = if is_slow { SLOW_SPEED } else { schedule.world_speed };
    add_chargers(seed, kinds, Schedule { world_speed, small_limits, ..schedule })
}

pub(super) struct Draw<'a> {
    pub(super) chance: ChaCha8Rng,
    pub(super) composition: &'a ChaosFleet,
    pub(super) lease_terms: LeaseTerms,
    pub(super) end_ms: u64,
    pub(super) steps: Vec<ScheduledAction>,
    /// Nodes with a lost disk.
    pub(super) lost_disks: Vec<&'static str>,
    /// Robots with a drained battery.
    pub(super) drained: Vec<&'static str>,
}

impl Draw<'_> {
    fn requests(&mut self, minutes: f64) {
        // The arm serves one mission at a time and needs about half a minute for it.
        let most = ((minutes * 1.2).ceil() as usize).clamp(1, ROOMS.len());
        let count = self.chance.random_range(most.div_ceil(2)..=most);
        for (number, room) in ROOMS.iter().take(count).enumerate() {
            let at_ms = self.chance.random_range(1_000..self.end_ms * 9 / 10);
            let request = format!("r{number}");
            let priority = *[0, 0, 0, 10, -10].choose(&mut self.chance).expect("five");
            let (request_name, mission) = (request.clone(), MISSIONS[0].to_owned());
            let (room, unnamed, deadline_s) = ((*room).to_owned(), false, None);
            let act = ChaosAction::Submit { request: request_name, unnamed, mission, room, priority, deadline_s };
            self.steps.push(ScheduledAction { at_ms, action: act });
            if self.chance.random_bool(0.1) {
                let at_ms = self.chance.random_range(at_ms..self.end_ms);
                self.steps.push(ScheduledAction { at_ms, action: ChaosAction::Cancel { request } });
            }
        }
    }

    /// Varies the requests: some missions have a recovery branch, some requests have no name, some
    /// have a deadline.
    fn vary(&mut self) {
        let chance = &mut self.chance;
        for step in &mut self.steps {
            if let ChaosAction::Submit { unnamed, mission, deadline_s, .. } = &mut step.action {
                *unnamed = chance.random_bool(0.15);
                *mission = MISSIONS[usize::from(chance.random_bool(0.4))].to_owned();
                // Some deadlines pass while the mission waits, some while it runs, most never.
                *deadline_s = chance.random_bool(0.2).then(|| chance.random_range(10..=180));
            }
        }
    }

    /// Isolates a carrier with its simulated robot right after a request, in half of the runs. The
    /// carrier may have just received the role. It stays isolated long enough for another carrier
    /// to receive the role; otherwise few seeds contain such a reassignment.
    fn isolate_carrier(&mut self) {
        let asked = self.steps.iter().filter(|step| step.action.submitted_request().is_some()).map(|step| step.at_ms);
        let latest = self.end_ms.saturating_sub(AWAY_MS.end);
        let asked: Vec<u64> = asked.filter(|at_ms| (FIRST_MS..latest).contains(at_ms)).collect();
        if self.chance.random_bool(0.5)
            && let Some(asked) = asked.choose(&mut self.chance)
        {
            let at_ms = asked + self.chance.random_range(300..4_000);
            let for_ms = self.chance.random_range(AWAY_MS).min(self.end_ms - at_ms);
            let nodes = self.composition.nodes().into_iter().map(str::to_owned).collect();
            let groups = self.carrier_groups(nodes);
            self.steps.push(ScheduledAction { at_ms, action: ChaosAction::Partition { groups, for_ms } });
        }
    }

    /// Adds a hostile node, each role in turn, from a generator of its own.
    fn hostile(&mut self, seed: u64) {
        let mut chance = ChaCha8Rng::seed_from_u64(seed ^ 0x0b5c_07e5);
        let role = HOSTILE_ROLES[usize::try_from(seed % HOSTILE_ROLES.len() as u64).expect("a small number")];
        let at_ms = chance.random_range(FIRST_MS..self.end_ms - 1_000);
        let for_ms = chance.random_range(1_000..60_000).min(self.end_ms - at_ms);
        let revoked = chance.random_bool(0.3);
        self.steps.push(ScheduledAction { at_ms, action: ChaosAction::Hostile { role, revoked, for_ms } });
    }

    fn fault(&mut self, kind: FaultKind) {
        let at_ms = self.chance.random_range(FIRST_MS..self.end_ms - 1_000);
        let Some(act) = self.act(kind, at_ms) else { return };
        self.steps.push(ScheduledAction { at_ms, action: act });
    }

    /// Draws a node; the world host less often than others.
    fn node(&mut self) -> String {
        let nodes = self.composition.nodes();
        let node = nodes.choose(&mut self.chance).expect("a fleet has nodes");
        let node = if *node == WORLD { nodes.choose(&mut self.chance).expect("a fleet has nodes") } else { node };
        (*node).to_owned()
    }

    pub(super) fn voter(&mut self) -> String {
        (*self.composition.voters().choose(&mut self.chance).expect("a fleet has voters")).to_owned()
    }

    /// Draws a short, medium or long duration that ends before all faults are lifted.
    fn lasting(&mut self, at_ms: u64, longest_ms: u64) -> u64 {
        let longest = match self.chance.random_range(0..3) {
            0 => 1_000,
            1 => 8_000,
            _ => longest_ms,
        };
        self.chance.random_range(100..=longest).min(self.end_ms.saturating_sub(at_ms)).max(50)
    }

    fn act(&mut self, kind: FaultKind, at_ms: u64) -> Option<ChaosAction> {
        let for_ms = self.lasting(at_ms, 40_000);
        Some(match kind {
            FaultKind::Crash => ChaosAction::Crash { node: self.node(), disk: DiskAfterCrash::Kept, for_ms },
            FaultKind::CrashTorn => {
                let node = self.node();
                self.slow_disk_before(&node, at_ms);
                ChaosAction::Crash { node, disk: DiskAfterCrash::Torn, for_ms }
            }
            FaultKind::CrashEmpty => return self.lose_disk(DiskAfterCrash::Empty, for_ms),
            FaultKind::CrashDamaged => return self.lose_disk(DiskAfterCrash::Damaged, for_ms),
            FaultKind::Disk(fault) => {
                // Without syncs, acknowledged writes are lost: the store is replaced.
                let node = if fault == DiskFault::Lies { self.disk_to_lose()? } else { self.voter() };
                ChaosAction::Disk { node, fault, for_ms }
            }
            FaultKind::CoordinatorCrash => {
                let disk = if self.chance.random_bool(0.5) { DiskAfterCrash::Kept } else { DiskAfterCrash::Torn };
                ChaosAction::Crash { node: "coordinator".to_owned(), disk, for_ms }
            }
            FaultKind::Blackout => {
                for voter in self.composition.voters() {
                    self.slow_disk_before(voter, at_ms);
                }
                self.request_just_before(at_ms);
                ChaosAction::Blackout { disk: DiskAfterCrash::Torn, for_ms: for_ms.min(10_000) }
            }
            FaultKind::Pause => ChaosAction::Pause { node: self.node(), for_ms: for_ms.min(20_000) },
            FaultKind::Partition => ChaosAction::Partition { groups: self.groups(), for_ms },
            FaultKind::OneWayCut => {
                let (mut from, mut to) = (self.node(), self.node());
                match self.chance.random_range(0..4) {
                    0 => from = "*".to_owned(),
                    1 => to = "*".to_owned(),
                    _ if from == to => to = "*".to_owned(),
                    _ => {}
                }
                ChaosAction::Cut { from, to, for_ms }
            }
            FaultKind::Loss => self.weather(for_ms, |chance, weather| weather.0 = Self::share(chance, 1, 40)),
            FaultKind::Duplication => self.weather(for_ms, |chance, weather| weather.1 = Self::share(chance, 5, 80)),
            FaultKind::Reordering => self.weather(for_ms, |chance, weather| {
                weather.2 = Self::share(chance, 5, 80);
                weather.3 = 20;
            }),
            FaultKind::Delay => self.weather(for_ms, |chance, weather| weather.3 = chance.random_range(10..400)),
            FaultKind::SlowDisk => {
                ChaosAction::SlowDisk { node: self.voter(), write_ms: self.chance.random_range(10..500), for_ms }
            }
            FaultKind::Drift => {
                let rate = 1.0 + f64::from(self.chance.random_range(-DRIFT_MAX..=DRIFT_MAX)) / 1000.0;
                let node = self.node();
                self.steps.push(ScheduledAction { at_ms: 0, action: ChaosAction::Drift { node, rate } });
                return None;
            }
            FaultKind::Battery => {
                let remaining: Vec<_> =
                    self.composition.carriers.iter().filter(|robot| !self.drained.contains(robot)).collect();
                // Another carrier must be able to continue.
                if remaining.len() < 2 {
                    return None;
                }
                let robot = **remaining.choose(&mut self.chance).expect("two at least");
                self.drained.push(robot);
                ChaosAction::Battery { robot: robot.to_owned() }
            }
            FaultKind::Skill => {
                let robots: Vec<_> = self.composition.carriers.iter().chain(&self.composition.arms).copied().collect();
                let robot = (*robots.choose(&mut self.chance).expect("there is an arm")).to_owned();
                let how = *[SkillFault::Fails, SkillFault::Panics, SkillFault::Hangs]
                    .choose(&mut self.chance)
                    .expect("three");
                ChaosAction::Skill { robot, how, times: self.chance.random_range(1..=3) }
            }
            FaultKind::None
            | FaultKind::Hostile
            | FaultKind::LeaseEnd
            | FaultKind::Suspend
            | FaultKind::WrongDate
            | FaultKind::Leave
            | FaultKind::Upgrade
            | FaultKind::CircularWait
            | FaultKind::StaleMajority
            | FaultKind::BlockedBus
            | FaultKind::Poison
            | FaultKind::Revoke => return None,
        })
    }

    /// Slows the disk of a node down, in some runs, before the crash that loses its last writes.
    fn slow_disk_before(&mut self, node: &str, at_ms: u64) {
        if node != WORLD && self.chance.random_bool(0.6) {
            let begins = at_ms.saturating_sub(self.chance.random_range(500..6_000)).max(FIRST_MS);
            let write_ms = self.chance.random_range(20..300);
            let act =
                ChaosAction::SlowDisk { node: node.to_owned(), write_ms, for_ms: at_ms.saturating_sub(begins) + 100 };
            self.steps.push(ScheduledAction { at_ms: begins, action: act });
        }
    }

    /// Moves a request right before the crash, in most runs, so that an acknowledged request may be
    /// lost.
    pub(super) fn request_just_before(&mut self, at_ms: u64) {
        if !self.chance.random_bool(0.7) {
            return;
        }
        let before = self.chance.random_range(30..400);
        let mut requests: Vec<&mut ScheduledAction> =
            self.steps.iter_mut().filter(|s| s.action.submitted_request().is_some()).collect();
        if let Some(request) = requests.choose_mut(&mut self.chance) {
            request.at_ms = at_ms - before;
        }
    }

    /// Draws the loss of a disk's content.
    fn lose_disk(&mut self, disk: DiskAfterCrash, for_ms: u64) -> Option<ChaosAction> {
        let node = self.disk_to_lose()?;
        Some(ChaosAction::Crash { node, disk, for_ms })
    }

    /// Draws a voter that loses its disk, unless too few disks would be left for a majority of the voters.
    fn disk_to_lose(&mut self) -> Option<String> {
        let voters = self.composition.voters();
        let node = *voters.choose(&mut self.chance).expect("a fleet has voters");
        if self.lost_disks.contains(&node) || (self.lost_disks.len() + 1) * 2 >= voters.len() {
            return None;
        }
        self.lost_disks.push(node);
        Some(node.to_owned())
    }

    fn groups(&mut self) -> Vec<Vec<String>> {
        let mut nodes: Vec<String> = self.composition.nodes().into_iter().map(str::to_owned).collect();
        nodes.shuffle(&mut self.chance);
        if self.chance.random_bool(0.4) {
            return self.carrier_groups(nodes);
        }
        let parts = if self.chance.random_bool(0.7) { 2 } else { 3 };
        let mut groups: Vec<Vec<String>> = vec![vec![]; parts];
        for (number, node) in nodes.into_iter().enumerate() {
            let group = if number < parts { number } else { self.chance.random_range(0..parts) };
            groups[group].push(node);
        }
        let with_client = self.chance.random_range(0..parts);
        groups[with_client].push("client".to_owned());
        groups
    }

    /// Isolates a carrier with its simulated robot: it can act, but its lease is not renewed.
    fn carrier_groups(&mut self, nodes: Vec<String>) -> Vec<Vec<String>> {
        let carrier = *self.composition.carriers.choose(&mut self.chance).expect("a fleet has carriers");
        let away = |name: &str| name == WORLD || name == carrier;
        let (away, mut others): (Vec<String>, Vec<String>) = nodes.into_iter().partition(|name| away(name));
        others.push("client".to_owned());
        vec![others, away]
    }

    /// Draws a share with two decimals.
    fn share(chance: &mut ChaCha8Rng, least: u32, most: u32) -> f64 {
        f64::from(chance.random_range(least..=most)) / 100.0
    }

    fn weather(&mut self, for_ms: u64, set: impl FnOnce(&mut ChaCha8Rng, &mut (f64, f64, f64, u64))) -> ChaosAction {
        let mut weather = (0.0, 0.0, 0.0, 3);
        set(&mut self.chance, &mut weather);
        let (loss, duplication, reordering, delay_ms) = weather;
        ChaosAction::Weather { loss, duplication, reordering, delay_ms, for_ms }
    }
}

/// Largest error of a clock rate, in thousandths.
const DRIFT_MAX: i32 = 50;

/// Returns what `of` selects of the steps of a run with seven nodes.
#[cfg(test)]
pub(super) fn drawn<T>(seed: u64, kinds: &[FaultKind], of: impl Fn(&ScheduledAction) -> Option<T>) -> Vec<T> {
    generate(seed, &ChaosFleet::of(7), 2.0, kinds).steps.iter().filter_map(of).collect()
}

/// Asserts that the schedules of these seeds are valid, and read back unchanged.
#[cfg(test)]
pub(super) fn assert_valid(seeds: Range<u64>) {
    let (composition, workload) = (ChaosFleet::of(7), consort_skills::workload::Workload::default());
    for seed in seeds {
        let schedule = generate(seed, &composition, 2.0, &FaultKind::FAULTS);
        schedule.check(&composition, &workload).unwrap_or_else(|problem| panic!("{problem}"));
        assert!(schedule.steps.is_sorted_by_key(|step| step.at_ms), "seed {seed}");
        let text = serde_json::to_string(&schedule).expect("plain data");
        assert_eq!(serde_json::from_str::<Schedule>(&text).expect("what was written"), schedule);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schedules_are_deterministic_and_faults_end_in_time() {
        let composition = ChaosFleet::of(7);
        for seed in 0..200 {
            let schedule = generate(seed, &composition, 5.0, &FaultKind::FAULTS);
            assert_eq!(schedule, generate(seed, &composition, 5.0, &FaultKind::FAULTS));
            for step in &schedule.steps {
                let over = step.at_ms + step.action.for_ms().unwrap_or(0);
                assert!(over <= 210_050, "seed {seed}: {step}");
            }
        }
    }

    #[test]
    fn all_leases_tolerate_the_drift_of_clocks() {
        use consort_protocol::lease::LEASE_REACTION;
        let tolerated = LeaseTerms::default().drift_max(LEASE_REACTION);
        assert!((0..6).all(|seed| lease_terms(seed).drift_max(LEASE_REACTION) >= tolerated));
    }

    #[test]
    fn requests_of_all_kinds_are_generated() {
        let composition = ChaosFleet::of(7);
        let steps = (0..200).flat_map(|seed| generate(seed, &composition, 5.0, &FaultKind::FAULTS).steps);
        let mut counts = [0; 5];
        for step in steps {
            if let ChaosAction::Submit { unnamed, mission, priority, deadline_s, .. } = step.action {
                let kinds = [true, unnamed, mission == MISSIONS[1], priority != 0, deadline_s.is_some()];
                counts.iter_mut().zip(kinds).for_each(|(count, is)| *count += u32::from(is));
            }
        }
        let [all, others @ ..] = counts;
        assert!(others.into_iter().all(|some| some * 10 > all && some * 2 < all), "{counts:?}");
    }

    #[test]
    fn a_schedule_reads_back_unchanged() {
        let composition = ChaosFleet::of(7);
        for seed in 0..50 {
            let schedule = generate(seed, &composition, 5.0, &FaultKind::FAULTS);
            let text = serde_json::to_string(&schedule).expect("plain data");
            assert_eq!(serde_json::from_str::<Schedule>(&text).expect("what was written"), schedule);
        }
    }

    #[test]
    fn faults_spare_a_majority_of_disks_and_a_carrier() {
        let composition = ChaosFleet::of(7);
        for seed in 0..500 {
            let kinds =
                [FaultKind::CrashEmpty, FaultKind::CrashDamaged, FaultKind::Disk(DiskFault::Lies), FaultKind::Battery];
            let steps = generate(seed, &composition, 5.0, &kinds).steps;
            let lost = |step: &&ScheduledAction| match step.action {
                ChaosAction::Crash { disk, .. } => matches!(disk, DiskAfterCrash::Empty | DiskAfterCrash::Damaged),
                ChaosAction::Disk { fault, .. } => fault == DiskFault::Lies,
                _ => false,
            };
            let drained = |step: &&ScheduledAction| matches!(step.action, ChaosAction::Battery { .. });
            assert!(steps.iter().filter(lost).count() <= 2, "seed {seed}");
            assert!(steps.iter().filter(drained).count() <= 2, "seed {seed}");
        }
    }
}
