mod energy;
mod recovery_branch;

use super::super::branch::Branch;
use super::super::entry::RELEASES_KEPT;
use super::super::submission::{RecoveryBranch, Submission};
use super::*;
use crate::auction::{AuctionEntry, AuctionId, AuctionRecord, BidVerdict};
use crate::cause::CauseClass;
use crate::ids::RequestId;
use crate::lease::RoleHolder;
use crate::ledger::Command;
use crate::ledger::HistoryLimits;
use crate::ledger::history::HISTORY_SINCE;
use crate::message::OrdersNotice;
use crate::mission::test_data::{FETCH_PARCEL, domain};
use crate::mission::{Format, MissionTemplate};
use crate::plan::{StepIndex, divide_and_check};
use crate::units::Seconds;

fn role(name: &str) -> RoleId {
    RoleId::new(name).unwrap()
}

fn robot(name: &str) -> RobotId {
    RobotId::new(name).unwrap()
}

fn place() -> PlaceId {
    PlaceId::new("IC Room 6").unwrap()
}

fn epoch(index: u64) -> Epoch {
    Epoch { term: 1, index }
}

/// Two robots without items: `b` waits for `a`, which has a task left afterwards.
const RELAY: &str = r#"{"mission": "relay", "roles": {"a": {"kind": "managed"}, "b": {"kind": "managed"}},
  "root": {"task": "all", "method": "sequential", "tasks": [
    {"task": "t-a", "type": "wait", "roles": ["a"], "parameters": {"seconds": "1"}},
    {"task": "rest", "method": "unordered", "tasks": [
      {"task": "t-b", "type": "wait", "roles": ["b"], "parameters": {"seconds": "1"}},
      {"task": "t-a2", "type": "wait", "roles": ["a"], "parameters": {"seconds": "1"}}]}]}}"#;

fn fetch_parcel() -> MissionTemplate {
    MissionTemplate::parse(FETCH_PARCEL, Format::Yaml).unwrap()
}

fn submission(request: &str, template: &MissionTemplate) -> Submission {
    let (mission, recovery) = template.instantiate_with_recovery(&BTreeMap::new(), &domain()).unwrap();
    let division = divide_and_check(&mission).unwrap();
    let recovery = recovery.map(|mission| RecoveryBranch { division: divide_and_check(&mission).unwrap(), mission });
    Submission { recovery, ..Submission::of(RequestId::new(request).unwrap(), mission, division) }
}

/// Robot with an item, its place, and whether custody is certain.
type Left<'a> = (&'a str, Option<&'a PlaceId>, bool);

/// A ledger with a mission, and the index of its next entry.
struct Log(Ledger, u64, MissionId);

impl Log {
    fn of(template: &MissionTemplate) -> Log {
        let mut log = Log(Ledger::default(), 1, MissionId::new("none").unwrap());
        log.2 = log.submit("a", template);
        log
    }

    /// The mission `fetch-parcel`, held by amber and arm under epoch 2, confirmed.
    fn held_by_two() -> Log {
        let mut log = Log::of(&fetch_parcel());
        log.hold(&[("r1", "amber"), ("lab_arm", "arm")]);
        log
    }

    fn apply(&mut self, command: Command) -> CommandOutcome {
        let at = epoch(self.1);
        self.1 += 1;
        self.0.apply(at, command)
    }

    fn submit(&mut self, request: &str, template: &MissionTemplate) -> MissionId {
        match self.apply(Command::Submit(Box::new(submission(request, template)))) {
            CommandOutcome::Submitted { mission, .. } => mission,
            other => panic!("{other:?}"),
        }
    }

    fn award(&mut self, holders: &[(&str, &str)]) -> CommandOutcome {
        let branch = self.entry().branch;
        self.award_in(branch, holders)
    }

    fn award_in(&mut self, branch: Branch, holders: &[(&str, &str)]) -> CommandOutcome {
        let (mission, auction) = (self.2.clone(), self.record());
        let holders = holders.iter().map(|(of, who)| (role(of), robot(who))).collect();
        self.apply(Command::Award { mission, branch, holders, auction })
    }

    /// Awards open roles to robots that have estimated this energy.
    fn award_with_energy(&mut self, holders: &[(&str, &str, f64)]) -> Epoch {
        let (mission, branch, record) = (self.2.clone(), self.entry().branch, self.record());
        let entry = |(of, who, energy): &(&str, &str, f64)| AuctionEntry {
            role: role(of),
            robot: robot(who),
            verdict: BidVerdict::Viable { time: Seconds::ZERO, energy: *energy, remaining: 0.5 },
            parts: vec![],
        };
        let auction = AuctionRecord { entries: holders.iter().map(entry).collect(), ..record };
        let holders = holders.iter().map(|(of, who, _)| (role(of), robot(who))).collect();
        match self.apply(Command::Award { mission, branch, holders, auction }) {
            CommandOutcome::Awarded { epoch } => epoch,
            other => panic!("{other:?}"),
        }
    }

    fn record(&self) -> AuctionRecord {
        let mission = self.2.clone();
        let auction = AuctionId { mission: mission.clone(), term: 1, round: 1 };
        AuctionRecord::empty(auction)
    }

    fn hold(&mut self, holders: &[(&str, &str)]) -> Epoch {
        let CommandOutcome::Awarded { epoch } = self.award(holders) else { panic!("not awarded") };
        self.confirm(&holders.iter().map(|(name, _)| *name).collect::<Vec<_>>(), epoch);
        epoch
    }

    /// Confirms awarded roles.
    fn confirm(&mut self, names: &[&str], epoch: Epoch) {
        for name in names {
            let (mission, role) = (self.2.clone(), role(name));
            assert_eq!(
                self.apply(Command::Accept { mission, role, epoch, incarnation: 1, from_checkpoint: false }),
                CommandOutcome::Done
            );
        }
    }

    /// Returns the estimated energy of all awards.
    fn energy(&self) -> f64 {
        self.entry().estimated_energy().get()
    }

    fn ended(&mut self, who: &str, epoch: Epoch, steps: std::ops::Range<StepIndex>) {
        let branch = self.entry().branch;
        assert_eq!(self.ended_in(branch, who, epoch, steps), CommandOutcome::Done);
    }

    fn ended_in(
        &mut self,
        branch: Branch,
        who: &str,
        epoch: Epoch,
        steps: std::ops::Range<StepIndex>,
    ) -> CommandOutcome {
        let (mission, role) = (self.2.clone(), role(who));
        self.apply(Command::Progress {
            mission,
            role,
            epoch,
            branch,
            ended: steps.collect(),
            outcomes: BTreeMap::new(),
        })
    }

    fn lose(&mut self, who: &str, epoch: Epoch, robot_failed: bool) {
        self.release(who, epoch, robot_failed.then_some(CauseClass::Robot), false);
    }

    fn release(&mut self, who: &str, epoch: Epoch, class: Option<CauseClass>, moved_nothing: bool) {
        let (mission, role, cause) = (self.2.clone(), role(who), "silent for 7 s".to_owned());
        let (place, gave_way) = (Some(place()), false);
        let release = Command::Release { mission, role, epoch, cause, class, moved_nothing, place, gave_way };
        assert_eq!(self.apply(release), CommandOutcome::Done);
    }

    /// The robot returns a role that it has confirmed.
    fn give_way(&mut self, who: &str, epoch: Epoch) {
        let (mission, role, cause) = (self.2.clone(), role(who), "it gives way to b".to_owned());
        let (class, moved_nothing, place, gave_way) = (None, true, Some(place()), true);
        let release = Command::Release { mission, role, epoch, cause, class, moved_nothing, place, gave_way };
        assert_eq!(self.apply(release), CommandOutcome::Done);
    }

    fn entry(&self) -> &MissionEntry {
        self.0.mission(&self.2).unwrap()
    }

    /// Formats custody: `amber!` for an item that amber has, `amber?` for an item that it may have.
    fn custodians(&self) -> Vec<String> {
        let sign = |held: &HeldItem| format!("{}{}", held.robot, if held.certain { '!' } else { '?' });
        self.entry().custody().iter().map(sign).collect()
    }

    fn intervention(&self) -> (&str, Vec<Left<'_>>) {
        let MissionState::NeedsIntervention { cause, items, .. } = &self.entry().state else {
            panic!("{:?}", self.entry().state)
        };
        (cause, items.iter().map(|held| (held.robot.as_str(), held.place.as_ref(), held.certain)).collect())
    }
}

#[test]
fn custody_of_the_parcel_follows_the_reports() {
    let mut log = Log::held_by_two();
    assert_eq!(log.custodians(), [""; 0]);
    log.ended("r1", epoch(2), 0..3);
    assert_eq!(log.custodians(), [""; 0], "the ledger does not contain the open box, so the clerk was not signalled");
    log.ended("r1", epoch(2), 0..4);
    assert_eq!(log.custodians(), ["amber?"], "the clerk may have been signalled");
    log.ended("clerk", Epoch::default(), 0..2);
    assert_eq!(log.custodians(), ["amber!"]);
    log.ended("r1", epoch(2), 0..11);
    assert_eq!(log.custodians(), ["amber!"]);
    log.ended("lab_arm", epoch(2), 0..1);
    assert_eq!(log.custodians(), ["amber?", "arm?"]);
    log.ended("lab_arm", epoch(2), 0..2);
    assert_eq!(log.custodians(), ["arm!"]);
    log.ended("lab_arm", epoch(2), 0..3);
    assert_eq!(log.custodians(), [""; 0], "the item is where the mission requires it");
}

#[test]
fn a_reported_wait_implies_the_awaited_step() {
    let mut log = Log::held_by_two();
    log.ended("r1", epoch(2), 5..6); // only its wait for the clerk's deposit was reported
    assert_eq!(log.custodians(), ["amber!"]);
}

#[test]
fn a_carrier_lost_before_its_guard_is_replaced() {
    let mut log = Log::held_by_two();
    log.ended("r1", epoch(2), 0..3);
    log.lose("r1", epoch(2), false);
    assert_eq!(log.entry().state, MissionState::Pending);
    assert_eq!(log.entry().open_roles(), [role("r1")].into());
}

#[test]
fn a_carrier_lost_with_the_parcel_needs_intervention_until_resolved() {
    for (reported, certain, has) in [(0..4, false, "may have"), (0..8, true, "has")] {
        let mut log = Log::held_by_two();
        log.ended("r1", epoch(2), reported);
        log.lose("r1", epoch(2), false);
        let lost_cause = format!("amber was lost as r1 and {has} the parcel: silent for 7 s");
        assert_eq!(log.intervention(), (lost_cause.as_str(), vec![("amber", Some(&place()), certain)]));
        assert!(log.entry().state.is_final());
        for number in 0..HistoryLimits::LARGEST.missions_max + 3 {
            let mission = log.submit(&format!("more{number}"), &fetch_parcel());
            let (cause, places, class) = ("test".to_owned(), BTreeMap::new(), CauseClass::Task);
            log.apply(Command::Fail { mission, cause, branch: None, places, class });
        }
        assert!(log.0.mission(&log.2).is_some(), "a mission that waits for a person is not dropped");

        // Meanwhile the robot gets no other role.
        let waiting = log.2.clone();
        log.2 = log.submit("next", &fetch_parcel());
        let full = log.award(&[("r1", "amber"), ("lab_arm", "arm")]);
        assert!(matches!(full, CommandOutcome::Refused(CommandError::CarriesItem { .. })), "{full:?}");
        let by = "Nia".to_owned();
        assert_eq!(
            log.apply(Command::Resolve { mission: waiting.clone(), by: by.clone(), at_ms: 7 }),
            CommandOutcome::Done
        );
        let cause = format!("{lost_cause}; resolved by Nia");
        let failed = MissionState::Failed { cause, class: CauseClass::Robot };
        assert_eq!(log.0.mission(&waiting).map(|entry| &entry.state), Some(&failed));
        assert_eq!(
            log.apply(Command::Resolve { mission: waiting.clone(), by, at_ms: 7 }),
            CommandOutcome::Done,
            "a repeated request"
        );
        let again = log.apply(Command::Resolve { mission: waiting, by: "Tom".to_owned(), at_ms: 7 });
        assert!(matches!(again, CommandOutcome::Refused(CommandError::NoInterventionNeeded { .. })), "{again:?}");
        assert!(matches!(log.award(&[("r1", "amber"), ("lab_arm", "arm")]), CommandOutcome::Awarded { .. }));
    }
}

#[test]
fn a_robot_lost_with_the_parcel_stays_until_a_person_has_it() {
    let mut log = Log::of(&fetch_parcel());
    log.apply(Command::first_wire_version(HISTORY_SINCE));
    let awarded = log.hold(&[("r1", "amber"), ("lab_arm", "arm")]);
    log.ended("r1", awarded, 0..8);
    let notice = |log: &Log, name: &str| OrdersNotice::of(&log.0, &robot(name), None);
    assert_eq!(notice(&log, "amber"), OrdersNotice::default(), "it carries the parcel in its role");
    log.lose("r1", awarded, false);
    let stays = notice(&log, "amber");
    assert_eq!(stays.stay.map(|stay| stay.text), Some(format!("has the parcel of {}", log.2)));
    assert_eq!(notice(&log, "arm").stay, None);
    let (mission, by) = (log.2.clone(), "Nia".to_owned());
    assert_eq!(log.apply(Command::Resolve { mission, by, at_ms: 7 }), CommandOutcome::Done);
    let free = notice(&log, "amber");
    assert!(free.is_empty() && Epoch::default() < stays.as_of && stays.as_of < free.as_of, "{free:?}");
}

#[test]
fn a_mission_that_ends_with_the_parcel_in_a_box_needs_intervention() {
    let places = BTreeMap::from([(robot("amber"), place())]);
    let end = |log: &Log, canceled| match canceled {
        true => Command::Cancel { mission: log.2.clone(), by: "Nia".to_owned(), places: places.clone(), at_ms: 7 },
        false => {
            let (mission, cause, places) = (log.2.clone(), "past its deadline".to_owned(), places.clone());
            Command::Fail { mission, cause, branch: None, places, class: CauseClass::Task }
        }
    };
    for (canceled, cause, class) in
        [(true, "canceled by Nia", CauseClass::Transient), (false, "past its deadline", CauseClass::Task)]
    {
        let mut log = Log::held_by_two();
        log.ended("r1", epoch(2), 0..8);
        assert_eq!(log.apply(end(&log, canceled)), CommandOutcome::Done);
        let cause = format!("{cause}; the parcel is with amber at IC Room 6");
        assert_eq!(log.intervention(), (cause.as_str(), vec![("amber", Some(&place()), true)]));
        let resolved = Command::Resolve { mission: log.2.clone(), by: "Nia".to_owned(), at_ms: 0 };
        assert_eq!(log.apply(resolved), CommandOutcome::Done);
        let cause = format!("{cause}; resolved by Nia");
        assert_eq!(log.entry().state, MissionState::Failed { cause, class });
    }
    // A repeated cancellation does not close the mission: the client may have missed the reply.
    let mut log = Log::held_by_two();
    log.ended("r1", epoch(2), 0..8);
    log.apply(end(&log, true));
    log.apply(end(&log, true));
    assert_eq!(log.intervention().0, "canceled by Nia; the parcel is with amber at IC Room 6");
}

#[test]
fn a_carrier_that_has_passed_the_parcel_on_counts_as_ended() {
    let mut log = Log::held_by_two();
    log.ended("r1", epoch(2), 0..11);
    log.ended("lab_arm", epoch(2), 0..3);
    log.lose("r1", epoch(2), false); // closing its box
    assert_eq!(log.entry().state, MissionState::Running, "the clerk has not ended");
    log.ended("clerk", Epoch::default(), 0..3);
    assert_eq!(log.entry().state, MissionState::Completed);
    assert_eq!(log.entry().releases.len(), 1, "the release is recorded");
}

#[test]
fn an_arm_lost_at_the_box_makes_custody_uncertain() {
    let mut log = Log::held_by_two();
    log.ended("r1", epoch(2), 0..11);
    log.ended("lab_arm", epoch(2), 0..1);
    log.lose("lab_arm", epoch(2), false);
    let (cause, items) = log.intervention();
    assert_eq!(cause, "arm was lost as lab_arm and may have the parcel: silent for 7 s");
    assert_eq!(items, [("amber", None, false), ("arm", Some(&place()), false)]);
}

#[test]
fn an_arm_that_has_moved_nothing_is_replaced_at_the_box() {
    let mut log = Log::held_by_two();
    log.ended("r1", epoch(2), 0..11);
    log.ended("lab_arm", epoch(2), 0..1);
    assert_eq!(log.custodians(), ["amber?", "arm?"]);
    log.release("lab_arm", epoch(2), Some(CauseClass::Robot), true);
    assert_eq!(log.entry().open_roles(), [role("lab_arm")].into());
    assert_eq!(log.custodians(), ["amber!"]);
    assert_eq!(log.entry().excluded(&role("lab_arm")).len(), 1);
    // The next arm may have it again.
    let awarded = log.hold(&[("lab_arm", "claw")]);
    log.ended("lab_arm", awarded, 0..1);
    assert_eq!(log.custodians(), ["amber?", "claw?"]);
}

/// A report in the ledger counts, also if the robot later reports otherwise.
#[test]
fn a_move_in_the_ledger_has_happened() {
    let mut log = Log::held_by_two();
    log.ended("r1", epoch(2), 0..11);
    log.ended("lab_arm", epoch(2), 0..3);
    log.release("r1", epoch(2), None, true);
    assert_eq!(log.entry().state, MissionState::Running, "only the clerk has not ended");
}

#[test]
fn a_mission_that_no_robot_can_do_fails_at_once() {
    let mut log = Log::held_by_two();
    log.release("r1", epoch(2), Some(CauseClass::Task), true);
    let (cause, class) = ("silent for 7 s".to_owned(), CauseClass::Task);
    assert_eq!(log.entry().state, MissionState::Failed { cause, class });
    // With an item in a robot a person is needed.
    let mut log = Log::held_by_two();
    log.ended("r1", epoch(2), 0..8);
    log.release("lab_arm", epoch(2), Some(CauseClass::Task), true);
    let (cause, items) = log.intervention();
    assert_eq!(cause, "silent for 7 s; the parcel is with amber");
    assert_eq!(items, [("amber", None, true)]);
}

#[test]
fn a_robot_with_a_transient_failure_may_bid_again() {
    let mut log = Log::of(&fetch_parcel());
    for count in 1..RELEASES_MAX {
        let epoch = log.hold(&[("r1", "amber"), ("lab_arm", "arm")][..if count == 1 { 2 } else { 1 }]);
        log.release("r1", epoch, Some(CauseClass::Transient), true);
        assert!(log.entry().excluded(&role("r1")).is_empty());
    }
    let epoch = log.hold(&[("r1", "amber")]);
    log.release("r1", epoch, Some(CauseClass::Transient), true);
    let MissionState::Failed { cause, class } = &log.entry().state else { panic!("{:?}", log.entry().state) };
    assert!(cause.starts_with("its roles were given up 5 times: "), "{cause}");
    assert_eq!(*class, CauseClass::Transient);
}

#[test]
fn an_arm_lost_earlier_is_replaced_while_the_carrier_keeps_the_parcel() {
    let mut log = Log::held_by_two();
    log.ended("r1", epoch(2), 0..8);
    log.lose("lab_arm", epoch(2), false);
    assert_eq!(log.entry().open_roles(), [role("lab_arm")].into());
    assert_eq!(log.custodians(), ["amber!"]);
}

#[test]
fn a_repeated_cancellation_has_the_same_outcome() {
    let mut log = Log::held_by_two();
    let cancel = |log: &Log, by: &str| Command::Cancel {
        mission: log.2.clone(),
        by: by.to_owned(),
        places: BTreeMap::new(),
        at_ms: 7,
    };
    for _ in 0..2 {
        assert_eq!(log.apply(cancel(&log, "Nia")), CommandOutcome::Done);
    }
    let other = log.apply(cancel(&log, "Tom"));
    assert!(matches!(other, CommandOutcome::Refused(CommandError::MissionEnded { .. })), "{other:?}");
}

#[test]
fn robots_that_failed_are_excluded_until_the_mission_fails() {
    let mut log = Log::of(&fetch_parcel());
    for (count, name) in (1..).zip(["amber", "birch", "cedar", "dogwood", "elm"]) {
        let epoch = log.hold(&[("r1", name), ("lab_arm", "arm")][..if count == 1 { 2 } else { 1 }]);
        assert_eq!(log.entry().excluded(&role("r1")).len(), count - 1);
        log.lose("r1", epoch, true);
    }
    let MissionState::Failed { cause, .. } = &log.entry().state else { panic!("{:?}", log.entry().state) };
    assert!(cause.starts_with("its roles were given up 5 times: silent for 7 s (r1); "), "{cause}");
}

#[test]
fn releases_before_confirmation_are_not_counted() {
    let mut log = Log::of(&fetch_parcel());
    for _ in 0..3 * RELEASES_MAX {
        let CommandOutcome::Awarded { epoch } = log.award(&[("r1", "amber"), ("lab_arm", "arm")]) else {
            panic!("no award")
        };
        log.lose("r1", epoch, false);
        log.lose("lab_arm", epoch, false);
    }
    assert_eq!(log.entry().state, MissionState::Pending);
    assert_eq!(log.entry().releases.len(), RELEASES_KEPT);
}

#[test]
fn a_robot_that_failed_stays_excluded_whatever_is_released_since() {
    let mut log = Log::of(&fetch_parcel());
    for count in 0..=RELEASES_KEPT {
        let CommandOutcome::Awarded { epoch } = log.award(&[("r1", "amber"), ("lab_arm", "arm")]) else {
            panic!("no award")
        };
        log.lose("r1", epoch, count == 0);
        log.lose("lab_arm", epoch, false);
    }
    assert_eq!(log.entry().excluded(&role("r1")).len(), 1);
}

#[test]
fn roles_returned_to_give_way_are_not_counted() {
    let mut log = Log::of(&fetch_parcel());
    for count in 0..3 * RELEASES_MAX {
        let epoch = log.hold(&[("r1", "amber"), ("lab_arm", "arm")][..if count == 0 { 2 } else { 1 }]);
        log.give_way("r1", epoch);
        assert_eq!(log.entry().state, MissionState::Pending, "returned {} times", count + 1);
    }
    // Releases of the other kind still count, and are kept instead.
    for _ in 0..RELEASES_MAX {
        let epoch = log.hold(&[("r1", "amber")]);
        log.lose("r1", epoch, false);
    }
    let MissionState::Failed { cause, .. } = &log.entry().state else { panic!("{:?}", log.entry().state) };
    assert!(cause.starts_with("its roles were given up 5 times: silent for 7 s (r1); "), "{cause}");
}

#[test]
fn a_role_with_on_loss_restart_is_restarted() {
    let restart = RELAY.replace(r#""a": {"kind": "managed"}"#, r#""a": {"kind": "managed", "on_loss": "restart"}"#);
    for (text, expected) in [(RELAY, "failed"), (restart.as_str(), "pending")] {
        let mut log = Log::of(&MissionTemplate::parse(text, Format::Json).unwrap());
        log.hold(&[("a", "amber"), ("b", "birch")]);
        log.ended("a", epoch(2), 0..2);
        log.ended("b", epoch(2), 0..1);
        log.lose("a", epoch(2), false);
        assert_eq!(log.entry().state.as_str(), expected, "{:?}", log.entry().state);
    }
}

#[test]
fn a_role_without_items_is_not_ended_before_its_last_step() {
    let mut log = Log::of(&MissionTemplate::parse(RELAY, Format::Json).unwrap());
    log.hold(&[("a", "amber"), ("b", "birch")]);
    log.ended("a", epoch(2), 0..2);
    log.ended("b", epoch(2), 0..2);
    log.lose("a", epoch(2), false);
    assert_eq!(log.entry().state.as_str(), "failed");
}
