use super::super::entry::{Branch, RecoveryBranch, Submission};
use super::*;
use crate::auction::{AuctionId, AuctionRecord};
use crate::ids::RequestId;
use crate::lease::RoleHolder;
use crate::ledger::{Command, HISTORY_MAX};
use crate::mission::{Domain, Format, MissionTemplate, shipped};
use crate::plan::{StepIndex, divide_and_check};

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

/// Two robots of which nobody has any item: `b` waits for `a`, which has something left to do afterwards.
const RELAY: &str = r#"{"mission": "relay", "roles": {"a": {"kind": "managed"}, "b": {"kind": "managed"}},
  "root": {"task": "all", "method": "sequential", "tasks": [
    {"task": "t-a", "type": "wait", "roles": ["a"], "parameters": {"seconds": "1"}},
    {"task": "rest", "method": "unordered", "tasks": [
      {"task": "t-b", "type": "wait", "roles": ["b"], "parameters": {"seconds": "1"}},
      {"task": "t-a2", "type": "wait", "roles": ["a"], "parameters": {"seconds": "1"}}]}]}}"#;

/// As lab samples, with somebody who goes and looks if the carrier is lost.
fn with_recovery() -> MissionTemplate {
    let text = std::fs::read_to_string("missions/lab-samples.yaml").unwrap();
    let text = text.replace("roles:\n  nurse", "roles:\n  helper: { kind: managed }\n  nurse")
        + "recovery: { task: go_and_look, type: navigation, roles: [helper], parameters: { to: \"${lost.place}\" } }\n";
    MissionTemplate::parse(&text, Format::Yaml).unwrap()
}

fn submission(request: &str, template: &MissionTemplate) -> Submission {
    let (mission, recovery) = template.instantiate_with_recovery(&BTreeMap::new(), &Domain::hospital()).unwrap();
    let division = divide_and_check(&mission).unwrap();
    let recovery = recovery.map(|mission| RecoveryBranch { division: divide_and_check(&mission).unwrap(), mission });
    Submission { recovery, ..Submission::of(RequestId::new(request).unwrap(), mission, division) }
}

/// A robot that has something, where it is, and whether that is certain.
type Left<'a> = (&'a str, Option<&'a PlaceId>, bool);

/// A ledger with one mission, and the index of its next entry.
struct Log(Ledger, u64, MissionId);

impl Log {
    fn of(template: &MissionTemplate) -> Log {
        let mut log = Log(Ledger::default(), 1, MissionId::new("none").unwrap());
        log.2 = log.submit("a", template);
        log
    }

    /// Lab samples, held by amber and arm under epoch 2, confirmed.
    fn lab_samples() -> Log {
        let mut log = Log::of(&shipped()["lab-samples"]);
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

    fn record(&self) -> AuctionRecord {
        let mission = self.2.clone();
        let auction = AuctionId { mission: mission.clone(), term: 1, round: 1 };
        AuctionRecord { auction, at_ms: 0, entries: vec![], omitted: 0, chosen: BTreeMap::new(), failure: None }
    }

    fn hold(&mut self, holders: &[(&str, &str)]) -> Epoch {
        let CommandOutcome::Awarded { epoch } = self.award(holders) else { panic!("not awarded") };
        for (name, _) in holders {
            let (mission, role) = (self.2.clone(), role(name));
            assert_eq!(
                self.apply(Command::Accept { mission, role, epoch, incarnation: 1, from_checkpoint: false }),
                CommandOutcome::Done
            );
        }
        epoch
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
        self.apply(Command::Progress { mission, role, epoch, branch, ended: steps.collect() })
    }

    fn lose(&mut self, who: &str, epoch: Epoch, blamed: bool) {
        let (mission, role, cause) = (self.2.clone(), role(who), "silent for 7 s".to_owned());
        let release = Command::Release { mission, role, epoch, cause, robot_failed: blamed, place: Some(place()) };
        assert_eq!(self.apply(release), CommandOutcome::Done);
    }

    fn entry(&self) -> &MissionEntry {
        self.0.mission(&self.2).unwrap()
    }

    /// `amber!` for an item that amber has, `amber?` for one that it may have.
    fn keepers(&self) -> Vec<String> {
        let sign = |kept: &HeldItem| format!("{}{}", kept.robot, if kept.certain { '!' } else { '?' });
        self.entry().custody().iter().map(sign).collect()
    }

    fn rescue(&self) -> (&str, Vec<Left<'_>>) {
        let MissionState::NeedsRescue { cause, items } = &self.entry().state else {
            panic!("{:?}", self.entry().state)
        };
        (cause, items.iter().map(|kept| (kept.robot.as_str(), kept.place.as_ref(), kept.certain)).collect())
    }
}

#[test]
fn the_sample_is_followed_from_hand_to_hand() {
    let mut log = Log::lab_samples();
    assert_eq!(log.keepers(), [""; 0]);
    log.ended("r1", epoch(2), 0..3);
    assert_eq!(log.keepers(), [""; 0], "the drawer is not known to be open, so the nurse was not told");
    log.ended("r1", epoch(2), 0..4);
    assert_eq!(log.keepers(), ["amber?"], "she may have been told");
    log.ended("nurse", Epoch::default(), 0..2);
    assert_eq!(log.keepers(), ["amber!"]);
    log.ended("r1", epoch(2), 0..11);
    assert_eq!(log.keepers(), ["amber!"]);
    log.ended("lab_arm", epoch(2), 0..1);
    assert_eq!(log.keepers(), ["amber?", "arm?"]);
    log.ended("lab_arm", epoch(2), 0..2);
    assert_eq!(log.keepers(), ["arm!"]);
    log.ended("lab_arm", epoch(2), 0..3);
    assert_eq!(log.keepers(), [""; 0], "where the mission meant it to be");
}

#[test]
fn what_one_role_has_heard_the_other_has_done() {
    let mut log = Log::lab_samples();
    log.ended("r1", epoch(2), 5..6); // its wait for the nurse's deposit, and nothing else was reported
    assert_eq!(log.keepers(), ["amber!"]);
}

#[test]
fn a_carrier_lost_before_its_guard_is_replaced() {
    let mut log = Log::lab_samples();
    log.ended("r1", epoch(2), 0..3);
    log.lose("r1", epoch(2), false);
    assert_eq!(log.entry().state, MissionState::Pending);
    assert_eq!(log.entry().open_roles(), [role("r1")].into());
}

#[test]
fn a_carrier_lost_with_the_sample_needs_rescue_and_is_kept_until_somebody_closes_it() {
    for (reported, certain, has) in [(0..4, false, "may have"), (0..8, true, "has")] {
        let mut log = Log::lab_samples();
        log.ended("r1", epoch(2), reported);
        log.lose("r1", epoch(2), false);
        let said = format!("amber was lost as r1 and {has} the sample: silent for 7 s");
        assert_eq!(log.rescue(), (said.as_str(), vec![("amber", Some(&place()), certain)]));
        assert!(log.entry().state.is_final());
        for number in 0..HISTORY_MAX + 3 {
            let mission = log.submit(&format!("more{number}"), &shipped()["lab-samples"]);
            let (cause, places) = ("test".to_owned(), BTreeMap::new());
            log.apply(Command::Fail { mission, cause, branch: None, places });
        }
        assert!(log.0.mission(&log.2).is_some(), "what waits for a person is not forgotten");

        // Nobody gives the robot another role meanwhile.
        let waiting = log.2.clone();
        log.2 = log.submit("next", &shipped()["lab-samples"]);
        let full = log.award(&[("r1", "amber"), ("lab_arm", "arm")]);
        assert!(matches!(full, CommandOutcome::Refused(CommandError::CarriesItem { .. })), "{full:?}");
        let by = "Nia".to_owned();
        assert_eq!(log.apply(Command::Resolve { mission: waiting.clone(), by: by.clone() }), CommandOutcome::Done);
        let cause = format!("{said}; rescued by Nia");
        assert_eq!(log.0.mission(&waiting).map(|entry| &entry.state), Some(&MissionState::Failed { cause }));
        assert_eq!(
            log.apply(Command::Resolve { mission: waiting.clone(), by }),
            CommandOutcome::Done,
            "heard, and asked again"
        );
        let again = log.apply(Command::Resolve { mission: waiting, by: "Tom".to_owned() });
        assert!(matches!(again, CommandOutcome::Refused(CommandError::NoInterventionNeeded { .. })), "{again:?}");
        assert!(matches!(log.award(&[("r1", "amber"), ("lab_arm", "arm")]), CommandOutcome::Awarded { .. }));
    }
}

#[test]
fn a_mission_canceled_or_failed_with_the_sample_in_a_drawer_needs_rescue() {
    let places = BTreeMap::from([(robot("amber"), place())]);
    let end = |log: &Log, canceled| match canceled {
        true => Command::Cancel { mission: log.2.clone(), by: "Nia".to_owned(), places: places.clone() },
        false => {
            let (mission, cause, places) = (log.2.clone(), "past its deadline".to_owned(), places.clone());
            Command::Fail { mission, cause, branch: None, places }
        }
    };
    for (canceled, cause) in [(true, "canceled by Nia"), (false, "past its deadline")] {
        let mut log = Log::lab_samples();
        log.ended("r1", epoch(2), 0..8);
        assert_eq!(log.apply(end(&log, canceled)), CommandOutcome::Done);
        let cause = format!("{cause}; the sample is with amber at IC Room 6");
        assert_eq!(log.rescue(), (cause.as_str(), vec![("amber", Some(&place()), true)]));
    }
    // To cancel it again closes nothing: the one who asks may merely not have heard the answer.
    let mut log = Log::lab_samples();
    log.ended("r1", epoch(2), 0..8);
    log.apply(end(&log, true));
    log.apply(end(&log, true));
    assert_eq!(log.rescue().0, "canceled by Nia; the sample is with amber at IC Room 6");
}

#[test]
fn a_carrier_that_has_passed_the_sample_on_has_done_its_part() {
    let mut log = Log::lab_samples();
    log.ended("r1", epoch(2), 0..11);
    log.ended("lab_arm", epoch(2), 0..3);
    log.lose("r1", epoch(2), false); // closing its drawer
    assert_eq!(log.entry().state, MissionState::Completed);
    assert_eq!(log.entry().releases.len(), 1, "and it is seen that it did not");
}

#[test]
fn an_arm_lost_at_the_drawer_needs_rescue_at_both_ends() {
    let mut log = Log::lab_samples();
    log.ended("r1", epoch(2), 0..11);
    log.ended("lab_arm", epoch(2), 0..1);
    log.lose("lab_arm", epoch(2), false);
    let (cause, items) = log.rescue();
    assert_eq!(cause, "arm was lost as lab_arm and may have the sample: silent for 7 s");
    assert_eq!(items, [("amber", None, false), ("arm", Some(&place()), false)]);
}

#[test]
fn an_arm_lost_earlier_is_replaced_while_the_carrier_keeps_the_sample() {
    let mut log = Log::lab_samples();
    log.ended("r1", epoch(2), 0..8);
    log.lose("lab_arm", epoch(2), false);
    assert_eq!(log.entry().open_roles(), [role("lab_arm")].into());
    assert_eq!(log.keepers(), ["amber!"]);
}

#[test]
fn whoever_has_the_item_may_take_part_in_getting_it_back() {
    let mut log = Log::of(&with_recovery());
    log.hold(&[("r1", "amber"), ("lab_arm", "arm")]);
    log.ended("r1", epoch(2), 0..8);
    log.lose("r1", epoch(2), false);
    assert!(matches!(log.award(&[("helper", "amber")]), CommandOutcome::Awarded { .. }));
}

#[test]
fn a_withdrawal_that_is_asked_for_again_has_been_heard() {
    let mut log = Log::lab_samples();
    let cancel =
        |log: &Log, by: &str| Command::Cancel { mission: log.2.clone(), by: by.to_owned(), places: BTreeMap::new() };
    for _ in 0..2 {
        assert_eq!(log.apply(cancel(&log, "Nia")), CommandOutcome::Done);
    }
    let other = log.apply(cancel(&log, "Tom"));
    assert!(matches!(other, CommandOutcome::Refused(CommandError::MissionEnded { .. })), "{other:?}");
}

#[test]
fn a_mission_with_a_recovery_branch_goes_on_with_it() {
    let mut log = Log::of(&with_recovery());
    log.hold(&[("r1", "amber"), ("lab_arm", "arm")]);
    log.ended("r1", epoch(2), 0..8);
    log.lose("r1", epoch(2), false);
    let entry = log.entry();
    assert_eq!((entry.branch, &entry.state), (Branch::Recovery, &MissionState::Pending));
    assert_eq!(entry.open_roles(), [role("helper")].into());
    let (_, spec) = entry.plan(&role("helper")).unwrap().tasks().next().unwrap();
    assert_eq!(spec.parameters["to"], "IC Room 6");
    assert!(log.0.held_by(&robot("arm")).is_none(), "the others are free");
    let arm = RoleHolder { robot: robot("arm"), epoch: epoch(2) };
    assert_eq!(entry.former_holders, [arm], "and may still be at work");

    // Whoever has the sample does nothing else meanwhile, should it come back.
    let recovering = log.2.clone();
    log.2 = log.submit("next", &shipped()["lab-samples"]);
    let full = log.award(&[("r1", "amber"), ("lab_arm", "arm")]);
    assert!(matches!(full, CommandOutcome::Refused(CommandError::CarriesItem { .. })), "{full:?}");
    log.2 = recovering;

    let then = log.hold(&[("helper", "birch")]);
    assert_eq!(log.entry().former_holders, []);
    log.ended("helper", then, 0..1);
    let (cause, items) = log.rescue();
    assert_eq!(cause, "the recovery branch was carried out; the sample is with amber at IC Room 6");
    assert_eq!(items, [("amber", Some(&place()), true)]);
}

#[test]
fn who_is_lost_in_the_recovery_branch_is_replaced_while_it_has_nothing_in_hand() {
    let mut log = Log::of(&with_recovery());
    log.hold(&[("r1", "amber"), ("lab_arm", "arm")]);
    log.ended("r1", epoch(2), 0..8);
    log.lose("r1", epoch(2), false);
    let then = log.hold(&[("helper", "birch")]);
    log.lose("helper", then, false);
    let entry = log.entry();
    assert_eq!((entry.branch, &entry.state), (Branch::Recovery, &MissionState::Pending));
    assert_eq!(entry.open_roles(), [role("helper")].into());
    assert_eq!((log.keepers(), entry.release_count), (vec!["amber!".to_owned()], 2), "the sample is where it was");
    // Who is lost last of all leaves the mission to a person, and the first loss is not forgotten.
    for name in ["cedar", "dogwood", "elm"] {
        let then = log.hold(&[("helper", name)]);
        log.lose("helper", then, true);
    }
    let (cause, items) = log.rescue();
    assert!(cause.starts_with("its roles were given up 5 times: silent for 7 s (r1); "), "{cause}");
    assert!(cause.ends_with("; the sample is with amber at IC Room 6"), "{cause}");
    assert_eq!(items, [("amber", Some(&place()), true)]);
}

#[test]
fn who_is_lost_in_the_recovery_branch_with_the_item_in_hand_needs_rescue_there() {
    let text = std::fs::read_to_string("missions/lab-samples.yaml").unwrap()
        + "recovery: { task: hand_over, type: wait, roles: [lab_arm], parameters: { seconds: \"5\" }, acquires: { sample: lab_arm } }\n";
    let mut log = Log::of(&MissionTemplate::parse(&text, Format::Yaml).unwrap());
    log.hold(&[("r1", "amber"), ("lab_arm", "arm")]);
    log.ended("r1", epoch(2), 0..8);
    log.lose("r1", epoch(2), false);
    let then = log.hold(&[("lab_arm", "arm")]);
    log.lose("lab_arm", then, false);
    let (cause, items) = log.rescue();
    assert_eq!(cause, "arm was lost as lab_arm and may have the sample: silent for 7 s");
    assert_eq!(items, [("amber", Some(&place()), false), ("arm", Some(&place()), false)]);
}

#[test]
fn a_branch_that_asks_for_a_place_that_nobody_knows_is_not_taken() {
    let mut log = Log::of(&with_recovery());
    log.hold(&[("r1", "amber"), ("lab_arm", "arm")]);
    log.ended("r1", epoch(2), 0..8);
    let (mission, role, cause) = (log.2.clone(), role("r1"), "silent".to_owned());
    log.apply(Command::Release { mission, role, epoch: epoch(2), cause, robot_failed: false, place: None });
    assert_eq!(log.rescue().1, [("amber", None, true)]);
}

#[test]
fn what_is_moved_out_of_reach_by_the_recovery_branch_needs_no_rescue() {
    let text = std::fs::read_to_string("missions/lab-samples.yaml").unwrap()
        + "recovery: { task: hand_over, type: wait, roles: [nurse, lab_arm], parameters: { seconds: \"5\" }, releases: [sample] }\n";
    let mut log = Log::of(&MissionTemplate::parse(&text, Format::Yaml).unwrap());
    log.hold(&[("r1", "amber"), ("lab_arm", "arm")]);
    log.ended("r1", epoch(2), 0..8);
    log.lose("r1", epoch(2), false);
    let then = log.hold(&[("lab_arm", "arm")]);
    log.ended("nurse", Epoch::default(), 0..3);
    log.ended("lab_arm", then, 0..3);
    assert_eq!(log.entry().state, MissionState::Completed);
}

#[test]
fn whoever_failed_at_a_role_is_not_asked_for_it_again_and_in_the_end_the_mission_fails_with_all_causes() {
    let mut log = Log::of(&shipped()["lab-samples"]);
    for (count, name) in (1..).zip(["amber", "birch", "cedar", "dogwood", "elm"]) {
        let epoch = log.hold(&[("r1", name), ("lab_arm", "arm")][..if count == 1 { 2 } else { 1 }]);
        assert_eq!(log.entry().excluded(&role("r1")).len(), count - 1);
        log.lose("r1", epoch, true);
    }
    let MissionState::Failed { cause } = &log.entry().state else { panic!("{:?}", log.entry().state) };
    assert!(cause.starts_with("its roles were given up 5 times: silent for 7 s (r1); "), "{cause}");
}

#[test]
fn a_robot_that_never_confirmed_counts_for_little() {
    let mut log = Log::of(&shipped()["lab-samples"]);
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
fn a_role_that_others_have_acted_on_is_begun_anew_if_the_mission_says_so() {
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
fn a_role_without_items_may_have_its_purpose_in_its_last_step() {
    let mut log = Log::of(&MissionTemplate::parse(RELAY, Format::Json).unwrap());
    log.hold(&[("a", "amber"), ("b", "birch")]);
    log.ended("a", epoch(2), 0..2);
    log.ended("b", epoch(2), 0..2);
    log.lose("a", epoch(2), false);
    assert_eq!(log.entry().state.as_str(), "failed");
}

#[test]
fn what_a_person_did_in_the_mission_is_not_counted_in_its_recovery_branch() {
    // The nurse's part in the branch has as many steps as in the mission, and moves the same sample.
    let text = std::fs::read_to_string("missions/lab-samples.yaml").unwrap()
        + "recovery: { task: hand_over, type: wait, roles: [nurse, lab_arm], parameters: { seconds: \"5\" }, releases: [sample] }\n";
    let mut log = Log::of(&MissionTemplate::parse(&text, Format::Yaml).unwrap());
    log.hold(&[("r1", "amber"), ("lab_arm", "arm")]);
    log.ended("r1", epoch(2), 0..8);
    log.ended("nurse", Epoch::default(), 0..2);
    log.lose("r1", epoch(2), false);
    let before = log.0.clone();
    let late = log.ended_in(Branch::Main, "nurse", Epoch::default(), 0..3);
    let refused =
        CommandOutcome::Refused(CommandError::WrongBranch { mission: log.2.clone(), taken: Branch::Recovery });
    assert_eq!(late, refused);
    let (mission, cause, places) = (log.2.clone(), "the nurse has none".to_owned(), BTreeMap::new());
    let late = log.apply(Command::Fail { mission, cause, branch: Some(Branch::Main), places });
    assert_eq!(late, refused);
    assert_eq!(log.0, before, "and nothing has changed");
    assert_eq!(log.ended_in(Branch::Recovery, "nurse", Epoch::default(), 0..1), CommandOutcome::Done);
    assert_eq!(log.entry().roles[&role("nurse")].ended, [0].into());
}

#[test]
fn what_an_auction_of_the_mission_came_to_is_not_counted_in_its_recovery_branch_nor_the_other_way_round() {
    // Both branches ask for an arm; the mission's is lost while another one is sought for it.
    let text = std::fs::read_to_string("missions/lab-samples.yaml").unwrap()
        + "recovery: { task: hand_over, type: wait, roles: [lab_arm], parameters: { seconds: \"5\" } }\n";
    let mut log = Log::of(&MissionTemplate::parse(&text, Format::Yaml).unwrap());
    let auction = |log: &Log, branch| {
        let (mission, auction, places) = (log.2.clone(), log.record(), BTreeMap::new());
        let cause = "nobody is left for lab_arm".to_owned();
        [
            Command::Award {
                mission: mission.clone(),
                branch,
                holders: [(role("lab_arm"), robot("other"))].into(),
                auction: auction.clone(),
            },
            Command::Defer { mission: mission.clone(), branch, auction },
            Command::Fail { mission, cause, branch: Some(branch), places },
        ]
    };
    let refuses = |log: &mut Log, branch, taken| {
        let before = log.0.clone();
        for command in auction(log, branch) {
            let refused = CommandOutcome::Refused(CommandError::WrongBranch { mission: log.2.clone(), taken });
            assert_eq!(log.apply(command.clone()), refused, "{command:?}");
            assert_eq!(log.0, before, "and nothing has changed");
        }
    };
    log.hold(&[("r1", "amber"), ("lab_arm", "arm")]);
    log.ended("r1", epoch(2), 0..8);
    log.ended("nurse", Epoch::default(), 0..2);
    log.lose("lab_arm", epoch(2), false);
    assert_eq!(log.entry().open_roles(), [role("lab_arm")].into());
    refuses(&mut log, Branch::Recovery, Branch::Main);

    log.lose("r1", epoch(2), false);
    assert_eq!((log.entry().branch, log.entry().open_roles()), (Branch::Recovery, [role("lab_arm")].into()));
    refuses(&mut log, Branch::Main, Branch::Recovery);
    let [award, defer, fail] = auction(&log, Branch::Recovery);
    for command in [defer, award, fail] {
        let outcome = log.apply(command);
        assert!(!matches!(outcome, CommandOutcome::Refused(_)), "{outcome:?}");
    }
    assert_eq!(log.entry().state.as_str(), "needs_rescue");
}
