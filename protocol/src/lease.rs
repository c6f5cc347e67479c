//! Awards as leases with an epoch (after Gray and Cheriton 1989; the epoch is a fencing token).
//!
//! An award names a mission, a role, a robot and an [`Epoch`], which only grows. The robot renews it by reporting. Time
//! is counted from when the *request* for renewal was sent on the robot's side, and from when the *answer* was given on
//! the coordinator's, so that whatever the network delays, the robot stops before the role is given to another:
//!
//! ```text
//! robot        sends report ──────────────────────────── lease ───────────────▶ suspends
//! coordinator          answers ──────────────────────────────── lease + grace ─────────▶ may release
//! ```
//!
//! [`Tenure`] is the robot's side. The coordinator's is [`Watch`].

use crate::ids::{MissionId, RobotId, RoleId};
use crate::mutants::{self, Mutant};
use crate::plan::{LocalPlan, StepIndex};
use crate::units::NodeTime;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::time::Duration;

/// Position of an award in the history of the fleet: term and index of its entry in the ledger.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
pub struct Epoch {
    /// The coordinator's term.
    pub term: u64,
    /// Place in the ledger's log.
    pub index: u64,
}

impl fmt::Display for Epoch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.term, self.index)
    }
}

/// A role given to a robot, with all that it needs in order to begin.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Award {
    /// The mission.
    pub mission: MissionId,
    /// The role in it.
    pub role: RoleId,
    /// Who gets it.
    pub robot: RobotId,
    /// Which award this is.
    pub epoch: Epoch,
    /// What to do.
    pub plan: LocalPlan,
    /// Who holds the mission's managed roles.
    pub holders: BTreeMap<RoleId, Holding>,
}

/// Who holds a role, and by which award: what is said in that role under an older one is not listened to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Holding {
    /// The robot.
    pub robot: RobotId,
    /// The award.
    pub epoch: Epoch,
}

impl Holding {
    /// The robots alone.
    pub fn robots(holders: &BTreeMap<RoleId, Holding>) -> BTreeMap<RoleId, RobotId> {
        holders.iter().map(|(role, holding)| (role.clone(), holding.robot.clone())).collect()
    }
}

/// How long an award lasts without contact. Fleet-wide: all nodes must agree.
///
/// # Clocks
///
/// Leases are measured by each node's monotonic clock. Clocks need not agree on the time; they may even run at different
/// rates, within a bound ([`drift_max`](LeaseTerms::drift_max)). Let the fastest clock of the fleet count `1 + d` seconds
/// while the slowest counts one, and tell all times below in seconds of the slowest, which is the worst that the robot's
/// and the first coordinator's can be. With lease `L`, grace `G`, and `r` for the robot's reaction (the time from the end of
/// its lease until its body has come to rest: its beat, and its body's way to stop):
///
/// - The robot sends a report at `s`. If it is answered, and no later one is, it is at rest by `s + L + r`.
/// - The coordinator answers at `a`, and `a >= s`. A majority had followed it at most `G / 2` before.
/// - A later coordinator has been elected by a majority, one of whom had followed the former at that moment and voted
///   afterwards: it takes over no earlier than `a - G / 2`, and counts from then on. On the fastest clock it has counted
///   `L + G` after `(L + G) / (1 + d)`. It gives the role away no earlier than `a - G / 2 + (L + G) / (1 + d)`.
///
/// Nobody else acts in the role before the robot is at rest if, at worst with `s = a`,
///
/// ```text
/// L + r <= (L + G) / (1 + d) - G / 2      that is      d <= (G / 2 - r) / (L + G / 2 + r)
/// ```
///
/// With the defaults and a reaction of half a second this is 9 %; clocks in use differ by less than 0.1 %. A coordinator
/// that stays counts from `a`, which leaves `d <= (G - r) / (L + r)`: 33 %.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeaseTerms {
    /// The robot suspends this long after it sent the last report that was answered. Raised: longer blackouts are
    /// survived in motion, lost robots are replaced later. Default 4 s: several takeovers long.
    pub lease: Duration,
    /// The coordinator waits this much longer. It covers clock drift and the age to which a coordinator may still
    /// believe in its own leadership. Default 2 s.
    pub grace: Duration,
}

impl Default for LeaseTerms {
    fn default() -> Self {
        LeaseTerms { lease: Duration::from_secs(4), grace: Duration::from_secs(2) }
    }
}

impl LeaseTerms {
    /// By which part a fleet's fastest clock may be faster than its slowest, given a robot's reaction: how long after the
    /// end of its lease its body is at rest. The derivation stands above. Nothing when the grace does not even cover the
    /// reaction.
    pub fn drift_max(&self, reaction: Duration) -> f64 {
        let (lease, half, reaction) =
            (self.lease.as_secs_f64(), self.grace.as_secs_f64() / 2.0, reaction.as_secs_f64());
        ((half - reaction) / (lease + half + reaction)).max(0.0)
    }

    /// How old a coordinator's last contact with a quorum may be for it to renew leases: half the grace. The other half
    /// is for drift.
    pub fn leadership_age_max(&self) -> Duration {
        self.grace / 2
    }
}

/// Something the holder has learned.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Event {
    /// An award for this robot was heard. It is not begun before the coordinator has confirmed it.
    Heard(Box<Award>),
    /// The coordinator answered a report that was sent at `sent`.
    Renewed {
        /// The award it is about.
        epoch: Epoch,
        /// When the report had been sent.
        sent: NodeTime,
        /// Steps that the ledger knows as ended.
        ended: BTreeSet<StepIndex>,
    },
    /// The coordinator said that the role is no longer this robot's.
    Revoked {
        /// The award it is about.
        epoch: Epoch,
        /// Why.
        reason: Ending,
    },
    /// The plan was carried out to its end, or a task of it failed, and the ledger knows.
    Settled {
        /// The award it is about.
        epoch: Epoch,
    },
    /// Time has passed.
    Tick,
}

/// Why a role ended otherwise than by being carried out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ending {
    /// The mission was canceled.
    Canceled,
    /// The mission failed elsewhere.
    Failed,
    /// The mission is over.
    Over,
    /// Another award has replaced this one.
    Replaced,
    /// The role was given up; another robot will take it over.
    Released,
    /// The mission waits for a person: something was left in a robot's hands.
    Rescue,
}

/// Something for the holder to carry out, in the order given.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Action {
    /// Ask the coordinator to confirm the award: send a report now.
    Report,
    /// Begin the plan; the steps named have ended already.
    Start(Box<Award>, BTreeSet<StepIndex>),
    /// Stop safely and keep the place in the plan: the lease has run out.
    Suspend,
    /// Go on.
    Resume,
    /// Stop safely and forget the plan.
    Halt(Ending),
}

/// Why a robot does not take an award that it was told of.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum Declined {
    /// It holds another role. One robot, one role.
    #[error("holds {role} of {mission}")]
    Busy {
        /// The mission it is at work for.
        mission: MissionId,
        /// Its role there.
        role: RoleId,
    },
    /// It has heard of a later award of the same role; ordinary when messages overtake one another.
    #[error("has heard of epoch {known}")]
    Stale {
        /// The later epoch.
        known: Epoch,
    },
    /// The award is for somebody else.
    #[error("is not {robot}")]
    NotMine {
        /// For whom it is.
        robot: RobotId,
    },
    /// The robot takes nothing new: it is about to leave the fleet.
    #[error("leaves the fleet")]
    Leaving,
}

/// The robot's side of an award: at most one at a time.
#[derive(Debug, Clone)]
pub struct Tenure {
    robot: RobotId,
    terms: LeaseTerms,
    held: Option<Held>,
    /// The latest epoch heard of each role, so that an overtaken award is not begun.
    latest: BTreeMap<(MissionId, RoleId), Epoch>,
}

#[derive(Debug, Clone)]
struct Held {
    award: Award,
    phase: Phase,
    /// The end of the lease; before the first confirmation, when to forget about the award.
    until: NodeTime,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// Heard, not confirmed.
    Heard,
    /// Known from a former life, not confirmed in this one. Kept until the coordinator has said something.
    Recalled,
    Active,
    Suspended,
}

/// Of so many roles the latest epoch is remembered. An award that is older than them all has left every queue long ago.
const LATEST_KEPT: usize = 512;

impl Tenure {
    /// No award yet.
    pub fn new(robot: RobotId, terms: LeaseTerms) -> Self {
        Tenure { robot, terms, held: None, latest: BTreeMap::new() }
    }

    /// Takes up an award that a former life of the robot's node had written down. Nothing is done under it before the
    /// coordinator has confirmed it; until it has answered, the award is neither forgotten nor exchanged for another role's.
    pub fn restore(robot: RobotId, terms: LeaseTerms, award: Award) -> Self {
        let latest = BTreeMap::from([((award.mission.clone(), award.role.clone()), award.epoch)]);
        let held = Some(Held { award, phase: Phase::Recalled, until: NodeTime::ZERO });
        Tenure { robot, terms, held, latest }
    }

    /// Forgets which awards it has heard of, but for the one it holds: those of another cluster are counted anew.
    pub fn forget_latest(&mut self) {
        let held = self.held.as_ref().map(|held| (held.award.mission.clone(), held.award.role.clone()));
        self.latest.retain(|role, _| Some(role) == held.as_ref());
    }

    /// The award held or about to be, if any.
    pub fn award(&self) -> Option<&Award> {
        self.held.as_ref().map(|held| &held.award)
    }

    /// Whether the plan may be acted on at this instant: confirmed, and the lease has not run out.
    pub fn may_act(&self, now: NodeTime) -> bool {
        self.held.as_ref().is_some_and(|held| {
            held.phase == Phase::Active && (now < held.until || mutants::is(Mutant::LeaseNotChecked))
        })
    }

    /// Whether the plan is held up: the lease has run out, or the award is a former life's and nobody has confirmed it yet.
    pub fn is_suspended(&self) -> bool {
        self.held.as_ref().is_some_and(|held| matches!(held.phase, Phase::Suspended | Phase::Recalled))
    }

    /// When the lease ends; `None` without an award, or with one of a former life that nobody has confirmed yet.
    pub fn until(&self) -> Option<NodeTime> {
        self.held.as_ref().filter(|held| held.phase != Phase::Recalled).map(|held| held.until)
    }

    /// Whether an award could be taken, and if not, why.
    ///
    /// # Errors
    /// [`Declined`], for the coordinator to hear.
    pub fn consider(&self, award: &Award) -> Result<(), Declined> {
        if award.robot != self.robot {
            return Err(Declined::NotMine { robot: award.robot.clone() });
        }
        let key = (award.mission.clone(), award.role.clone());
        if let Some(&known) = self.latest.get(&key).filter(|&&known| known > award.epoch) {
            return Err(Declined::Stale { known });
        }
        match &self.held {
            Some(held) if held.award.mission != award.mission || held.award.role != award.role => {
                Err(Declined::Busy { mission: held.award.mission.clone(), role: held.award.role.clone() })
            }
            _ => Ok(()),
        }
    }

    /// What follows from an event at an instant.
    pub fn handle(&mut self, event: Event, now: NodeTime) -> Vec<Action> {
        match event {
            Event::Heard(award) => self.hear(*award, now),
            Event::Renewed { epoch, sent, ended } => self.renew(epoch, sent, ended, now),
            Event::Revoked { epoch, reason } => self.revoke(epoch, reason),
            Event::Settled { epoch } => self.settle(epoch),
            Event::Tick => self.lapse(now),
        }
    }

    fn hear(&mut self, award: Award, now: NodeTime) -> Vec<Action> {
        if self.consider(&award).is_err() {
            return vec![];
        }
        let known = self.latest.insert((award.mission.clone(), award.role.clone()), award.epoch);
        while self.latest.len() > LATEST_KEPT {
            let oldest = self.latest.iter().min_by_key(|(_, epoch)| **epoch).map(|(role, _)| role.clone());
            oldest.and_then(|role| self.latest.remove(&role));
        }
        let mut actions = vec![];
        match &self.held {
            Some(held) if held.award.epoch == award.epoch => return vec![Action::Report],
            Some(held) if held.phase != Phase::Heard => actions.push(Action::Halt(Ending::Replaced)),
            Some(_) => {}
            None if known == Some(award.epoch) => return vec![], // an echo of an award that has ended
            None => {}
        }
        self.held = Some(Held { award, phase: Phase::Heard, until: now + self.terms.lease });
        actions.push(Action::Report);
        actions
    }

    fn renew(&mut self, epoch: Epoch, sent: NodeTime, ended: BTreeSet<StepIndex>, now: NodeTime) -> Vec<Action> {
        let Some(held) = self.held.as_mut().filter(|held| held.award.epoch == epoch) else {
            return vec![]; // an award that has ended since the report was sent
        };
        let until = sent + self.terms.lease;
        if until <= now {
            return vec![]; // the answer took longer than the lease
        }
        match held.phase {
            Phase::Heard | Phase::Recalled => {
                held.phase = Phase::Active;
                held.until = until;
                vec![Action::Start(Box::new(held.award.clone()), ended)]
            }
            Phase::Active => {
                held.until = held.until.max(until);
                vec![]
            }
            Phase::Suspended => {
                held.phase = Phase::Active;
                held.until = until;
                vec![Action::Resume]
            }
        }
    }

    /// A robot that never acted has nothing to halt, and nothing to tell: it had told nobody that it began.
    fn revoke(&mut self, epoch: Epoch, reason: Ending) -> Vec<Action> {
        match self.held.take_if(|held| held.award.epoch == epoch) {
            Some(held) if held.phase == Phase::Heard => vec![],
            Some(_) => vec![Action::Halt(reason)],
            None => vec![],
        }
    }

    fn settle(&mut self, epoch: Epoch) -> Vec<Action> {
        self.held.take_if(|held| held.award.epoch == epoch);
        vec![]
    }

    fn lapse(&mut self, now: NodeTime) -> Vec<Action> {
        if mutants::is(Mutant::LeaseNotChecked) {
            return vec![];
        }
        let Some(held) = self.held.as_mut().filter(|held| held.until <= now) else { return vec![] };
        match held.phase {
            Phase::Heard => {
                // Nobody has confirmed it, and nothing was begun: should it be told again, it is as good as new.
                if let Some(held) = self.held.take() {
                    self.latest.remove(&(held.award.mission, held.award.role));
                }
                vec![]
            }
            Phase::Active => {
                held.phase = Phase::Suspended;
                vec![Action::Suspend]
            }
            Phase::Suspended | Phase::Recalled => vec![],
        }
    }
}

/// The coordinator's side: when each award was last in contact. An award that this coordinator has just met, be it new or
/// another coordinator's, counts as in contact at that moment: it may have been renewed just before.
#[derive(Debug, Clone)]
pub struct Watch {
    terms: LeaseTerms,
    contacts: BTreeMap<Epoch, BTreeMap<RobotId, NodeTime>>,
    /// Awards that are about to be taken away, and since when: they are renewed no more, so that their time does run out.
    let_go: BTreeMap<(Epoch, RobotId), NodeTime>,
}

/// How long an award is known to have been let go of after it has left the ledger: longer than a report is answered.
const LET_GO_KEPT: Duration = Duration::from_secs(60);

impl Watch {
    /// Begins with the coordinator's leadership.
    pub fn new(terms: LeaseTerms) -> Self {
        Watch { terms, contacts: BTreeMap::new(), let_go: BTreeMap::new() }
    }

    /// The award stands in the ledger as this coordinator looks at it.
    pub fn meet(&mut self, epoch: Epoch, robot: &RobotId, now: NodeTime) {
        let robots = self.contacts.entry(epoch).or_default();
        if !robots.contains_key(robot) {
            robots.insert(robot.clone(), now);
        }
    }

    /// Asks whether a report of this award may be answered with a renewal at `now`, which then counts as contact. It may
    /// not once the award was let go of: the holder's role may be given to another soon.
    #[must_use]
    pub fn renew(&mut self, epoch: Epoch, robot: &RobotId, now: NodeTime) -> bool {
        let renewed = !self.let_go.contains_key(&(epoch, robot.clone()));
        if renewed {
            self.contacts.entry(epoch).or_default().insert(robot.clone(), now);
        }
        renewed
    }

    /// This award is to be taken away: it is renewed no more. It may be taken once it [is over](Watch::is_over).
    pub fn let_go(&mut self, epoch: Epoch, robot: &RobotId, now: NodeTime) {
        self.let_go.entry((epoch, robot.clone())).or_insert(now);
    }

    /// How long the holder has been out of contact, as far as this coordinator can know; nothing for an award that it has
    /// not met.
    pub fn silence(&self, epoch: Epoch, robot: &RobotId, now: NodeTime) -> Duration {
        let last = self.contacts.get(&epoch).and_then(|robots| robots.get(robot));
        last.map_or(Duration::ZERO, |last| now.since(*last))
    }

    /// Whether the holder has certainly suspended by now, so that its role may go to another.
    pub fn is_over(&self, epoch: Epoch, robot: &RobotId, now: NodeTime) -> bool {
        let sure = self.terms.lease + self.terms.grace;
        self.silence(epoch, robot, now) > if mutants::is(Mutant::EarlyRelease) { sure / 3 } else { sure }
    }

    /// Forgets awards that are none of `live`.
    pub fn retain(&mut self, live: &BTreeSet<Epoch>, now: NodeTime) {
        self.contacts.retain(|epoch, _| live.contains(epoch));
        self.let_go.retain(|(epoch, _), since| live.contains(epoch) || now.since(*since) < LET_GO_KEPT);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> NodeTime {
        NodeTime::at(Duration::from_millis(ms))
    }

    fn award(index: u64) -> Award {
        let role = RoleId::new("r1").unwrap();
        Award {
            mission: MissionId::new("m1").unwrap(),
            role: role.clone(),
            robot: RobotId::new("ada").unwrap(),
            epoch: Epoch { term: 1, index },
            plan: LocalPlan::of(role, vec![]),
            holders: BTreeMap::new(),
        }
    }

    fn tenure() -> Tenure {
        Tenure::new(RobotId::new("ada").unwrap(), LeaseTerms::default())
    }

    fn renewed(index: u64, sent: u64) -> Event {
        Event::Renewed { epoch: Epoch { term: 1, index }, sent: at(sent), ended: BTreeSet::new() }
    }

    #[test]
    fn an_award_begins_only_once_the_coordinator_has_confirmed_it() {
        let mut ada = tenure();
        assert_eq!(ada.handle(Event::Heard(Box::new(award(5))), at(0)), [Action::Report]);
        assert!(!ada.may_act(at(1)));
        assert_eq!(ada.handle(renewed(5, 10), at(20)), [Action::Start(Box::new(award(5)), BTreeSet::new())]);
        assert!(ada.may_act(at(20)));
    }

    #[test]
    fn the_lease_counts_from_when_the_report_was_sent() {
        let mut ada = tenure();
        ada.handle(Event::Heard(Box::new(award(5))), at(0));
        ada.handle(renewed(5, 10), at(3000));
        assert!(ada.may_act(at(4009)));
        assert!(!ada.may_act(at(4010)));
        assert_eq!(ada.handle(Event::Tick, at(4010)), [Action::Suspend]);
        assert_eq!(ada.handle(Event::Tick, at(5000)), []);
        assert_eq!(ada.handle(renewed(5, 4900), at(5000)), [Action::Resume]);
    }

    #[test]
    fn an_answer_that_took_longer_than_the_lease_renews_nothing() {
        let mut ada = tenure();
        ada.handle(Event::Heard(Box::new(award(5))), at(0));
        assert_eq!(ada.handle(renewed(5, 10), at(4010)), []);
        assert!(!ada.may_act(at(4010)));
    }

    #[test]
    fn an_older_epoch_is_somebody_elses_role_by_now() {
        let mut ada = tenure();
        ada.handle(Event::Heard(Box::new(award(5))), at(0));
        assert_eq!(ada.consider(&award(4)), Err(Declined::Stale { known: Epoch { term: 1, index: 5 } }));
        assert_eq!(ada.handle(Event::Heard(Box::new(award(4))), at(1)), []);
        assert_eq!(ada.handle(renewed(4, 0), at(1)), []);
    }

    #[test]
    fn what_comes_under_an_older_epoch_changes_nothing() {
        let old = Epoch { term: 1, index: 4 };
        let acting = || {
            let mut ada = tenure();
            ada.handle(Event::Heard(Box::new(award(5))), at(0));
            ada.handle(renewed(5, 0), at(1));
            ada
        };
        let suspended = || {
            let mut ada = acting();
            assert_eq!(ada.handle(Event::Tick, at(4000)), [Action::Suspend]);
            ada
        };
        let recalled = || Tenure::restore(RobotId::new("ada").unwrap(), LeaseTerms::default(), award(5));
        for (name, make) in
            [("acting", &acting as &dyn Fn() -> Tenure), ("suspended", &suspended), ("recalled", &recalled)]
        {
            let events = [
                Event::Heard(Box::new(award(4))),
                renewed(4, 4000),
                Event::Revoked { epoch: old, reason: Ending::Released },
                Event::Settled { epoch: old },
            ];
            for event in events {
                let mut ada = make();
                let (acts, held_up, until) = (ada.may_act(at(2000)), ada.is_suspended(), ada.until());
                assert_eq!(ada.handle(event.clone(), at(4001)), [], "{name}: {event:?}");
                assert_eq!(ada.award().map(|award| award.epoch.index), Some(5), "{name}: {event:?}");
                assert_eq!((ada.may_act(at(2000)), ada.is_suspended(), ada.until()), (acts, held_up, until), "{name}");
            }
        }
    }

    #[test]
    fn a_robot_that_never_acted_has_nothing_to_halt() {
        let mut ada = tenure();
        ada.handle(Event::Heard(Box::new(award(5))), at(0));
        assert_eq!(
            ada.handle(Event::Revoked { epoch: Epoch { term: 1, index: 5 }, reason: Ending::Canceled }, at(1)),
            []
        );
        assert_eq!(ada.award(), None);
        assert_eq!(ada.handle(renewed(5, 0), at(2)), [], "the word that it no longer holds it was faster");
    }

    /// Whether, at any instant, the old holder may act while a later coordinator finds its lease over. The robot and the
    /// coordinator that answered it have the slowest clocks; the other's counts `1 + drift` times as fast, and it took over
    /// as early as it could. A robot is at rest `reaction` after the end of its lease.
    fn overlaps(terms: LeaseTerms, drift: f64, reaction: Duration) -> bool {
        let (epoch, robot) = (Epoch { term: 1, index: 5 }, RobotId::new("ada").unwrap());
        let (mut ada, mut watch) = (Tenure::new(robot.clone(), terms), Watch::new(terms));
        let slow = |us: u64| NodeTime::at(Duration::from_micros(us));
        let fast = |us: u64| NodeTime::at(Duration::from_micros(us).mul_f64(1.0 + drift));
        let answered = u64::try_from(terms.leadership_age_max().as_micros()).unwrap();
        watch.meet(epoch, &robot, fast(0));
        ada.handle(Event::Heard(Box::new(award(5))), slow(answered));
        ada.handle(Event::Renewed { epoch, sent: slow(answered), ended: BTreeSet::new() }, slow(answered));
        let reaction = u64::try_from(reaction.as_micros()).unwrap();
        let instants = (0..20_000_000).step_by(1_000);
        let mut both =
            instants.filter(|us| ada.may_act(slow(us - reaction.min(*us))) && watch.is_over(epoch, &robot, fast(*us)));
        both.next().is_some()
    }

    #[test]
    fn clocks_that_drift_within_the_bound_never_let_two_act_and_beyond_it_they_do() {
        let seconds = Duration::from_secs_f64;
        let default = LeaseTerms::default();
        assert!((default.drift_max(seconds(0.5)) - 1.0 / 11.0).abs() < 1e-12);
        for terms in [default, LeaseTerms { lease: seconds(10.0), grace: seconds(3.0) }] {
            for reaction in [0.0, 0.25, 0.5].map(seconds) {
                let bound = terms.drift_max(reaction);
                assert!(!overlaps(terms, bound, reaction), "{terms:?} {bound}");
                assert!(overlaps(terms, bound + 0.01, reaction), "{terms:?}: the bound is tight");
                assert!(overlaps(terms, 1.0, reaction), "{terms:?}");
            }
        }
        assert_eq!(default.drift_max(seconds(1.5)), 0.0, "the grace does not even cover the reaction");
    }

    #[test]
    fn a_newer_award_of_the_same_role_replaces_the_old_one() {
        let mut ada = tenure();
        ada.handle(Event::Heard(Box::new(award(5))), at(0));
        ada.handle(renewed(5, 0), at(1));
        let actions = ada.handle(Event::Heard(Box::new(award(6))), at(2));
        assert_eq!(actions, [Action::Halt(Ending::Replaced), Action::Report]);
        assert!(!ada.may_act(at(2)));
    }

    #[test]
    fn an_echo_of_a_settled_award_is_not_begun_again() {
        let mut ada = tenure();
        ada.handle(Event::Heard(Box::new(award(5))), at(0));
        ada.handle(renewed(5, 0), at(1));
        ada.handle(Event::Settled { epoch: Epoch { term: 1, index: 5 } }, at(2));
        assert_eq!(ada.handle(Event::Heard(Box::new(award(5))), at(3)), []);
        assert_eq!(ada.award(), None);
    }

    #[test]
    fn an_award_of_a_former_life_waits_for_the_coordinators_word_however_long_that_takes() {
        let recalled = || Tenure::restore(RobotId::new("ada").unwrap(), LeaseTerms::default(), award(5));
        let mut ada = recalled();
        assert_eq!(ada.handle(Event::Tick, at(60_000)), []);
        assert!(!ada.may_act(at(0)) && ada.until().is_none());
        assert_eq!(ada.award().map(|award| award.epoch), Some(Epoch { term: 1, index: 5 }));
        let actions = ada.handle(renewed(5, 60_000), at(60_010));
        assert_eq!(actions, [Action::Start(Box::new(award(5)), BTreeSet::new())]);
        assert!(ada.may_act(at(60_010)));

        let mut ada = recalled();
        let revoked = Event::Revoked { epoch: Epoch { term: 1, index: 5 }, reason: Ending::Released };
        assert_eq!(ada.handle(revoked, at(10)), [Action::Halt(Ending::Released)]);
        assert_eq!(ada.award(), None);

        let mut ada = recalled();
        assert!(matches!(ada.consider(&award(4)), Err(Declined::Stale { .. })));
        assert_eq!(ada.handle(Event::Heard(Box::new(award(5))), at(1)), [Action::Report]);
        let actions = ada.handle(Event::Heard(Box::new(award(6))), at(2));
        assert_eq!(actions, [Action::Halt(Ending::Replaced), Action::Report]);
    }

    #[test]
    fn the_role_goes_to_another_only_after_the_holder_has_suspended() {
        let epoch = Epoch { term: 1, index: 5 };
        let robot = RobotId::new("ada").unwrap();
        let mut watch = Watch::new(LeaseTerms::default());
        assert!(!watch.is_over(epoch, &robot, at(9_000_000)), "an award that has only just been made");
        watch.meet(epoch, &robot, at(0));
        watch.meet(epoch, &robot, at(3000));
        assert!(!watch.is_over(epoch, &robot, at(6000)), "it may have been renewed just before the takeover");
        assert!(watch.is_over(epoch, &robot, at(6001)));
        assert!(watch.renew(epoch, &robot, at(6000)));
        assert!(!watch.is_over(epoch, &robot, at(12_000)));
        assert!(watch.is_over(epoch, &robot, at(12_001)));
    }

    #[test]
    fn an_award_that_is_let_go_of_is_renewed_no_more() {
        let (epoch, robot) = (Epoch { term: 1, index: 5 }, RobotId::new("ada").unwrap());
        let mut watch = Watch::new(LeaseTerms::default());
        watch.meet(epoch, &robot, at(0));
        assert!(watch.renew(epoch, &robot, at(1000)));
        watch.let_go(epoch, &robot, at(1500));
        assert!(!watch.renew(epoch, &robot, at(2000)));
        assert!(!watch.is_over(epoch, &robot, at(7000)), "its last lease counts from before");
        assert!(watch.is_over(epoch, &robot, at(7001)));
        // A report that was read before the release was carried out is answered after it.
        watch.retain(&BTreeSet::new(), at(8000));
        assert!(!watch.renew(epoch, &robot, at(8000)));
        watch.retain(&BTreeSet::new(), at(61_500));
        assert!(watch.let_go.is_empty());
    }

    #[test]
    fn an_award_that_nobody_confirmed_in_time_may_be_told_again_and_an_older_one_never() {
        let mut ada = tenure();
        ada.handle(Event::Heard(Box::new(award(5))), at(0));
        ada.handle(Event::Tick, at(4000));
        assert_eq!(ada.award(), None);
        assert_eq!(ada.handle(Event::Heard(Box::new(award(5))), at(5000)), [Action::Report]);
        assert_eq!(ada.handle(renewed(5, 5000), at(5010)).len(), 1);
        assert!(matches!(ada.consider(&award(4)), Err(Declined::Stale { .. })));
    }

    #[test]
    fn of_a_long_life_the_latest_awards_are_remembered() {
        let mut ada = tenure();
        for index in 0..2 * LATEST_KEPT as u64 {
            let award = Award { mission: MissionId::new(format!("m{index}")).unwrap(), ..award(index) };
            let epoch = award.epoch;
            ada.handle(Event::Heard(Box::new(award)), at(index));
            ada.handle(Event::Settled { epoch }, at(index));
        }
        assert_eq!(ada.latest.len(), LATEST_KEPT);
        assert!(ada.latest.values().all(|epoch| epoch.index >= LATEST_KEPT as u64));
        ada.forget_latest();
        assert!(ada.latest.is_empty());
    }
}
