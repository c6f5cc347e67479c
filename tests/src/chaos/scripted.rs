//! Faults that meet a request at a moment at which they matter: drawn by themselves, not in place of others.

use super::chaos_fleet::{ARM, MISSIONS, ROOMS, ROOMS_WITHOUT_NURSE, WORLD};
use super::dates::millis;
use super::fault_kind::FaultKind;
use super::generate::{AWAY_MS, Draw, FIRST_MS};
use super::schedule::{CARRIER_OF, ChaosAction, DiskAfterCrash, ScheduledAction, WAITING};
use consort_protocol::lease::LeaseTerms;
use rand::RngExt;
use rand::seq::{IndexedMutRandom, IndexedRandom, SliceRandom};

/// Largest error of a date: a day.
const WRONG_DATE_S: i64 = 86_400;

/// Time for which the scripted faults last, in milliseconds.
const SCRIPT_MS: u64 = 35_000;

impl Draw<'_> {
    /// Draws a fault of a kind that is drawn separately.
    pub(super) fn separate(&mut self, kind: FaultKind) {
        match kind {
            FaultKind::Suspend => self.suspend(),
            FaultKind::WrongDate => {
                let first = self.composition.voters()[0].to_owned();
                let node = if self.chance.random_bool(0.7) { first } else { self.voter() };
                let ahead_s = self.chance.random_range(-WRONG_DATE_S / 4..=WRONG_DATE_S);
                let requested = self.late_request();
                let at_ms = requested.unwrap_or(FIRST_MS) + self.chance.random_range(500..15_000);
                let for_ms = self.end_ms.saturating_sub(at_ms).max(50);
                self.steps.push(ScheduledAction { at_ms, action: ChaosAction::WrongDate { node, ahead_s, for_ms } });
            }
            FaultKind::Leave => self.leave(),
            FaultKind::Upgrade => {
                let at_ms = self.chance.random_range(FIRST_MS..self.end_ms - 1_000);
                let interval_ms = self.chance.random_range(200..6_000);
                self.steps.push(ScheduledAction { at_ms, action: ChaosAction::Upgrade { interval_ms } });
            }
            FaultKind::CircularWait => self.circular_wait(),
            FaultKind::StaleMajority => self.stale_majority(),
            FaultKind::BlockedBus => self.block_buses(),
            FaultKind::Poison => self.poison(),
            _ => {}
        }
    }

    /// Requests missions that cannot be completed.
    fn poison(&mut self) {
        for number in 0..self.chance.random_range(1..=3) {
            let at_ms = self.chance.random_range(FIRST_MS..self.end_ms);
            let room = *ROOMS_WITHOUT_NURSE.choose(&mut self.chance).expect("there are two");
            let mission = *MISSIONS.choose(&mut self.chance).expect("there are two");
            let action = ChaosAction::Submit {
                request: format!("poison-{number}"),
                unnamed: false,
                mission: mission.to_owned(),
                room: room.to_owned(),
                priority: *[0, 10].choose(&mut self.chance).expect("there are two"),
                deadline_s: None,
            };
            self.steps.push(ScheduledAction { at_ms, action });
        }
    }

    /// Gives a request a deadline that it should meet. Returns the time of the request in milliseconds.
    fn late_request(&mut self) -> Option<u64> {
        let mut requests: Vec<&mut ScheduledAction> =
            self.steps.iter_mut().filter(|step| step.action.submitted_request().is_some()).collect();
        let request = requests.choose_mut(&mut self.chance)?;
        if let ChaosAction::Submit { deadline_s, .. } = &mut request.action {
            *deadline_s = Some(180);
        }
        Some(request.at_ms)
    }

    /// Draws a request with at least [`AWAY_MS`] of the run after it. Returns its time and the name of its
    /// carrier.
    fn carried_request(&mut self) -> Option<(u64, String)> {
        let latest = self.end_ms.saturating_sub(AWAY_MS.end);
        let requests = self.steps.iter().filter(|step| step.at_ms < latest);
        let requests: Vec<(u64, String)> =
            requests.filter_map(|step| Some((step.at_ms, step.action.submitted_request()?))).collect();
        let (asked, request) = requests.choose(&mut self.chance)?;
        Some((*asked, format!("{CARRIER_OF}{request}")))
    }

    /// Makes a node leave: any node, or a carrier on its way that its driver server does not hear.
    fn leave(&mut self) {
        let carried = self.carried_request().filter(|_| self.chance.random_bool(0.5));
        let (at_ms, node) = match carried {
            Some((asked, node)) => {
                let at_ms = asked + self.chance.random_range(700..4_000);
                let (from, to) = (node.clone(), WORLD.to_owned());
                let cut = ChaosAction::Cut { from, to, for_ms: self.chance.random_range(2_000..5_000) };
                self.steps.push(ScheduledAction { at_ms, action: cut });
                (at_ms, node)
            }
            None => {
                let nodes: Vec<_> = self.composition.nodes().into_iter().filter(|node| *node != WORLD).collect();
                let node = (*nodes.choose(&mut self.chance).expect("a fleet has nodes")).to_owned();
                (self.chance.random_range(FIRST_MS..self.end_ms - 1_000), node)
            }
        };
        let for_ms = self.chance.random_range(5_000..40_000).min(self.end_ms.saturating_sub(at_ms)).max(50);
        self.steps.push(ScheduledAction { at_ms, action: ChaosAction::Leave { node, for_ms } });
    }

    /// Suspends the machine of a carrier while it executes a request, for longer than lease and grace.
    fn suspend(&mut self) {
        let Some((asked, _)) = self.carried_request() else { return };
        let at_ms = asked + self.chance.random_range(1_000..15_000);
        let for_ms = self.chance.random_range(6_500..20_000).min(self.end_ms.saturating_sub(at_ms)).max(50);
        let node = (*self.composition.carriers.choose(&mut self.chance).expect("a fleet has carriers")).to_owned();
        self.steps.push(ScheduledAction { at_ms, action: ChaosAction::Suspend { node, for_ms } });
    }

    /// Blocks the buses of nodes, of carriers more often than of others: for a moment, or for longer than
    /// lease and grace.
    fn block_buses(&mut self) {
        for _ in 0..self.chance.random_range(1..=3) {
            let at_ms = self.chance.random_range(FIRST_MS..self.end_ms - 1_000);
            let for_ms = self.chance.random_range(500..10_000).min(self.end_ms - at_ms);
            let nodes = match self.chance.random_bool(0.5) {
                true => self.composition.carriers.clone(),
                false => self.composition.nodes(),
            };
            let node = (*nodes.choose(&mut self.chance).expect("a fleet has nodes")).to_owned();
            self.steps.push(ScheduledAction { at_ms, action: ChaosAction::Block { node, for_ms } });
        }
        if self.chance.random_bool(0.5) {
            self.block_driver_server();
        }
    }

    /// Blocks the bus of the driver server, and kills the carrier of a request meanwhile: the driver server must
    /// stop the body in time although it can neither publish nor query.
    fn block_driver_server(&mut self) {
        let Some((asked, carrier)) = self.carried_request() else { return };
        let at_ms = asked + self.chance.random_range(500..6_000);
        let killed_at = at_ms + self.chance.random_range(100..1_500);
        let down_ms = self.chance.random_range(AWAY_MS);
        if killed_at + down_ms >= self.end_ms {
            return;
        }
        let block = ChaosAction::Block { node: WORLD.to_owned(), for_ms: self.chance.random_range(5_000..10_000) };
        let crash = ChaosAction::Crash { node: carrier, disk: DiskAfterCrash::Kept, for_ms: down_ms };
        self.steps.push(ScheduledAction { at_ms, action: block });
        self.steps.push(ScheduledAction { at_ms: killed_at, action: crash });
    }

    /// Draws the beginning of a scripted fault. `None` if the run is too short, or if too many disks are
    /// lost for a further loss of a node.
    fn script(&mut self) -> Option<u64> {
        let latest = self.end_ms.checked_sub(SCRIPT_MS).filter(|latest| *latest > FIRST_MS)?;
        self.lost_disks.is_empty().then(|| self.chance.random_range(FIRST_MS..latest))
    }

    /// Lets two missions hold what the other waits for, with a single carrier left for both: the first
    /// loses the arm to the second, and the second loses its carrier for good.
    fn circular_wait(&mut self) {
        let used = self.steps.iter().filter(|step| step.action.submitted_request().is_some()).count();
        let Some((&[.., first, second], at_ms)) = Some(&ROOMS[..]).zip(self.script()) else { return };
        if used + WAITING.len() > ROOMS.len() || !self.drained.is_empty() {
            return;
        }
        let mut carriers = self.composition.carriers.clone();
        carriers.shuffle(&mut self.chance);
        let [_, _, others @ ..] = &carriers[..] else { return };
        for node in others {
            let action = ChaosAction::Remove { node: (*node).to_owned() };
            self.steps.push(ScheduledAction { at_ms, action });
        }
        let submit = |request: &str, room: &str, priority| ChaosAction::Submit {
            request: request.to_owned(),
            unnamed: false,
            mission: MISSIONS[0].to_owned(),
            room: room.to_owned(),
            priority,
            deadline_s: None,
        };
        let at_ms = at_ms + 9_000;
        let arm = ChaosAction::Crash { node: ARM.to_owned(), disk: DiskAfterCrash::Kept, for_ms: 8_500 };
        let removed = ChaosAction::Remove { node: format!("{CARRIER_OF}{}", WAITING[1]) };
        let script = [
            (0, submit(WAITING[0], first, 20)),
            (1_500, arm),
            (3_000, submit(WAITING[1], second, 30)),
            (12_500 + self.chance.random_range(0..1_500), removed),
        ];
        self.steps.extend(script.map(|(after_ms, action)| ScheduledAction { at_ms: at_ms + after_ms, action }));
    }

    /// Lets a voter lose its store right after a majority with it has committed a request, and leaves it
    /// with the voters that lack the request.
    fn stale_majority(&mut self) {
        let mut voters: Vec<String> = self.composition.voters().into_iter().map(str::to_owned).collect();
        let Some(at_ms) = self.script().filter(|_| voters.len() == 5) else { return };
        voters.shuffle(&mut self.chance);
        let is_other = |node: &&str| !voters.iter().any(|voter| voter == node);
        let others = self.composition.nodes().into_iter().filter(is_other).chain(["client"]).map(str::to_owned);
        let others: Vec<String> = others.collect();
        let with_others = |part: &[String]| part.iter().chain(&others).cloned().collect::<Vec<_>>();
        let before = vec![with_others(&voters[..3]), voters[3..].to_vec()];
        let after = vec![with_others(&voters[2..]), voters[..2].to_vec()];
        let changed_at = at_ms + 8_000;
        let crash = ChaosAction::Crash { node: voters[2].clone(), disk: DiskAfterCrash::Damaged, for_ms: 500 };
        self.request_just_before(changed_at);
        let script = [
            (at_ms, ChaosAction::Partition { groups: before, for_ms: 8_000 }),
            (changed_at, crash),
            (changed_at, ChaosAction::Partition { groups: after, for_ms: 15_000 }),
        ];
        let known = self.composition.voters().into_iter().find(|node| *node == voters[2]);
        self.lost_disks.extend(known);
        self.steps.extend(script.map(|(at_ms, action)| ScheduledAction { at_ms, action }));
    }

    /// Isolates the carrier of a request with its driver, and kills the carrier's node shortly before its
    /// lease ends. Only the driver can stop the body then. The drivers come back before the role may pass on,
    /// so that another carrier can begin at once.
    pub(super) fn lease_end(&mut self) {
        let Some((asked, carrier)) = self.carried_request() else { return };
        let at_ms = asked + self.chance.random_range(100..2_500);
        let LeaseTerms { lease, grace } = self.lease_terms;
        let (lease_ms, grace_ms) = (millis(lease), millis(grace));
        let killed_at = at_ms + self.chance.random_range(lease_ms * 6 / 10..lease_ms);
        let for_ms = self.chance.random_range(lease_ms..lease_ms + grace_ms / 3);
        let down_ms = self.chance.random_range(AWAY_MS);
        if killed_at + down_ms >= self.end_ms {
            return;
        }
        let others = self.composition.nodes().into_iter().filter(|node| *node != WORLD).chain(["client"]);
        let groups = vec![others.map(str::to_owned).collect(), vec![carrier.clone(), WORLD.to_owned()]];
        let crash = ChaosAction::Crash { node: carrier, disk: DiskAfterCrash::Kept, for_ms: down_ms };
        self.steps.push(ScheduledAction { at_ms, action: ChaosAction::Partition { groups, for_ms } });
        self.steps.push(ScheduledAction { at_ms: killed_at, action: crash });
    }
}
