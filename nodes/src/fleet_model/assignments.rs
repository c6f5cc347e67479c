//! Who was in which role from when to when, for the chart of all missions, and how long it should have taken.

use super::FleetModel;
use super::state::{MissionModel, RoleAssignment};
use consort_protocol::lease::EndReason;

/// For so long after a change a view does not change a role's holder again, in milliseconds: it may be older than what was
/// heard since.
const SETTLED_MS: u64 = 2000;

/// Tenures of one mission: as many as ever make sense, and no more.
const TENURES: usize = 60;

/// At work, as far as is known.
const AT_WORK: &str = "at work";

/// The role was carried out to its end.
const CARRIED_OUT: &str = "carried out";

/// Another robot is to take the role over.
pub(super) const RELEASED: &str = "given up";

/// The mission ended otherwise.
const BROKEN_OFF: &str = "broken off";

/// How a tenure ended, by the words of whoever put the role down.
pub(super) fn state_after(ending: EndReason) -> &'static str {
    match ending {
        EndReason::Over => CARRIED_OUT,
        EndReason::Replaced | EndReason::Released => RELEASED,
        EndReason::Canceled | EndReason::Failed | EndReason::Rescue => BROKEN_OFF,
    }
}

impl MissionModel {
    /// A robot has a role from now on, unless that is known.
    pub(super) fn start_assignment(&mut self, role: &str, by: &str, at_ms: u64) {
        if self.is_assigned(role, by) || self.ended {
            return;
        }
        self.end_assignment(role, at_ms, RELEASED);
        let (role, by, state) = (role.to_owned(), by.to_owned(), AT_WORK.to_owned());
        self.tenures.push(RoleAssignment { role, by, from_ms: at_ms, to_ms: None, state, planned_ms: None });
        if self.tenures.len() > TENURES {
            self.tenures.remove(0);
        }
    }

    /// Whether a robot has a role, as far as is known.
    pub(super) fn is_assigned(&self, role: &str, by: &str) -> bool {
        self.tenures.iter().any(|one| one.to_ms.is_none() && one.role == role && one.by == by)
    }

    /// Nobody has a role from now on.
    pub(super) fn end_assignment(&mut self, role: &str, at_ms: u64, word: &str) {
        for one in self.tenures.iter_mut().filter(|one| one.to_ms.is_none() && one.role == role) {
            one.end(at_ms, word);
        }
    }

    /// The robot that has a role stands still, or goes on.
    pub(super) fn set_suspended(&mut self, role: &str, by: &str, suspended: bool) {
        let its = |one: &&mut RoleAssignment| one.to_ms.is_none() && one.role == role && one.by == by;
        for one in self.tenures.iter_mut().filter(its) {
            if suspended { "suspended" } else { AT_WORK }.clone_into(&mut one.state);
        }
    }

    /// The mission has ended: nobody has a role of it any more.
    pub(super) fn end_all_assignments(&mut self, at_ms: u64, completed: bool) {
        for one in self.tenures.iter_mut().filter(|one| one.to_ms.is_none()) {
            one.end(at_ms, if completed { CARRIED_OUT } else { BROKEN_OFF });
        }
    }

    /// What the ledger has of its roles, for whoever came late, or did not hear all.
    pub(super) fn apply_holders(&mut self, now_ms: u64) {
        let roles: Vec<_> = self.roles.iter().map(|(role, shown)| (role.clone(), shown.clone())).collect();
        for (role, shown) in roles {
            let Some(holder) = shown.holder else { continue };
            let changes =
                self.tenures.iter().filter(|one| one.role == role).map(|one| one.to_ms.unwrap_or(one.from_ms));
            if changes.max().is_some_and(|changed| changed + SETTLED_MS > now_ms) {
                continue;
            }
            if shown.phase == "ended" {
                let last = self.bars.iter().rfind(|bar| bar.role == role && bar.by == holder);
                self.end_assignment(&role, last.and_then(|bar| bar.to_ms).unwrap_or(now_ms), CARRIED_OUT);
            } else {
                self.start_assignment(&role, &holder, now_ms);
            }
        }
    }
}

impl RoleAssignment {
    fn end(&mut self, at_ms: u64, word: &str) {
        self.to_ms = Some(at_ms.max(self.from_ms));
        word.clone_into(&mut self.state);
    }
}

impl FleetModel {
    /// Finds out how long the roles that robots have now should take: by the winners' own bids, at the pace of their world.
    pub(super) fn update_planned_times(&mut self) {
        let Some(rate) = self.world_rate.rate() else { return };
        let lacking = |mission: &MissionModel| mission.tenures.iter().any(RoleAssignment::lacks_plan);
        let missions: Vec<String> =
            self.missions.iter().filter(|(_, mission)| lacking(mission)).map(|(id, _)| id.clone()).collect();
        for id in missions {
            let rounds = || self.auctions.values().filter(|auction| auction.mission == id);
            let price = |one: &RoleAssignment| {
                let of = rounds().filter(|auction| auction.chosen.get(&one.role) == Some(&one.by));
                let latest = of.max_by_key(|auction| (auction.term, auction.round))?;
                let offer = latest.offers.iter().find(|offer| offer.role == one.role && offer.robot == one.by)?;
                offer.time_s
            };
            let Some(mission) = self.missions.get(&id) else { continue };
            let found: Vec<_> = (0..)
                .zip(&mission.tenures)
                .filter(|(_, one)| one.lacks_plan())
                .filter_map(|(index, one): (usize, &RoleAssignment)| {
                    Some((index, (price(one)? * 1000.0 / rate).round() as u64))
                })
                .collect();
            if found.is_empty() {
                continue;
            }
            let Some(mission) = self.missions.get_mut(&id) else { continue };
            for (index, planned) in found {
                mission.tenures[index].planned_ms = Some(planned);
            }
        }
    }
}

impl RoleAssignment {
    fn lacks_plan(&self) -> bool {
        self.to_ms.is_none() && self.planned_ms.is_none()
    }
}

/// How many seconds of the world pass in one second: bodies say what time it is in theirs. Bids are in seconds of the world.
#[derive(Debug, Clone, Default)]
pub(super) struct WorldRate {
    /// A robot, what time it was in its world, and when it said so.
    from: Option<(String, f64, u64)>,
    rate: Option<f64>,
}

impl WorldRate {
    /// Over so long it is measured at least, in milliseconds.
    const SPAN_MS: u64 = 2000;

    /// After so long without a word of the robot another one is followed, in milliseconds.
    const GONE_MS: u64 = 10_000;

    /// A body has said what time it is in its world.
    pub(super) fn observe(&mut self, robot: &str, world_s: f64, now_ms: u64) {
        match &self.from {
            Some((known, from_s, from_ms)) if known == robot && world_s >= *from_s => {
                let passed = now_ms.saturating_sub(*from_ms);
                if passed < WorldRate::SPAN_MS {
                    return;
                }
                let rate = (world_s - from_s) * 1000.0 / passed as f64;
                self.rate = (rate > 0.0).then_some(rate);
            }
            Some((known, _, from_ms)) if known != robot && now_ms < from_ms + WorldRate::GONE_MS => return,
            // The first, or one whose world began anew.
            Some(_) | None => {}
        }
        self.from = Some((robot.to_owned(), world_s, now_ms));
    }

    fn rate(&self) -> Option<f64> {
        self.rate
    }
}
