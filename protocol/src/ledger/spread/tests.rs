use super::super::command::{Command, CommandOutcome};
use super::super::{Branch, Submission};
use super::*;
use crate::auction::{AuctionId, AuctionRecord, BidVerdict, RefusalReason};
use crate::lease::Epoch;
use crate::mission::test_data::domain;
use crate::mission::{Format, MissionTemplate};
use crate::plan::divide_and_check;

/// Each escort takes a visitor to the clerk, who receives them in the order of the file.
const VISITS: &str = r#"
mission: reception
roles: { escort: { kind: managed }, clerk: { kind: unmanaged }, head: { kind: managed } }
root:
  task: all
  method: sequential
  tasks:
    - task: rounds
      for: number
      in: [a, b, c]
      spread: true
      do:
        task: visit
        method: sequential
        tasks:
          - { task: go, type: wait, roles: [escort], parameters: { seconds: "5" } }
          - { task: meet, type: wait, roles: [escort, clerk], parameters: { seconds: "5" } }
    - { task: file, type: wait, roles: [clerk], parameters: { seconds: "5" } }
    - { task: report, type: wait, roles: [head], parameters: { seconds: "5" } }
"#;

struct Log(Ledger, u64);

impl Log {
    fn of(text: &str) -> Log {
        let mission = MissionTemplate::parse(text, Format::Yaml).unwrap();
        let mission = mission.instantiate(&BTreeMap::new(), &domain()).unwrap();
        let division = divide_and_check(&mission).unwrap();
        let mut log = Log(Ledger::default(), 0);
        log.apply(Command::Submit(Box::new(Submission::of("a".parse().unwrap(), mission, division))));
        log
    }

    fn apply(&mut self, command: Command) -> CommandOutcome {
        self.1 += 1;
        self.0.apply(Epoch { term: 1, index: self.1 }, command)
    }

    fn entry(&self) -> &MissionEntry {
        self.0.missions().next().unwrap()
    }

    fn to_return(&self) -> Option<String> {
        self.0.iteration_to_return(self.entry()).map(|(role, _)| role.to_string())
    }

    /// Records an auction of a role that these robots refused: they hold roles.
    fn defer(&mut self, role: &str, busy: &[&str]) {
        let mission = self.entry().id.clone();
        let reason = RefusalReason::Busy { mission: mission.clone(), role: role.parse().unwrap() };
        let entries = busy.iter().map(|robot| AuctionEntry {
            role: role.parse().unwrap(),
            robot: robot.parse().unwrap(),
            verdict: BidVerdict::Refused { reason: reason.clone() },
            parts: vec![],
        });
        let auction = AuctionRecord {
            entries: entries.collect(),
            failure: Some(format!("no viable bid for {role}")),
            ..AuctionRecord::empty(AuctionId { mission: mission.clone(), term: 1, round: 2 })
        };
        let outcome = self.apply(Command::Defer { mission, branch: Branch::Main, auction });
        assert_eq!(outcome, CommandOutcome::Done);
    }

    /// Ends the first steps of a held role.
    fn end(&mut self, role: &str, steps: StepIndex) {
        let (entry, role): (_, RoleId) = (self.entry(), role.parse().unwrap());
        let (mission, epoch) = (entry.id.clone(), entry.role_robots()[&role].epoch);
        let (branch, ended, outcomes) = (Branch::Main, (0..steps).collect(), BTreeMap::new());
        let outcome = self.apply(Command::Progress { mission, role, epoch, branch, ended, outcomes });
        assert_eq!(outcome, CommandOutcome::Done);
    }

    fn to_auction(&self) -> Vec<String> {
        self.entry().roles_to_auction().iter().map(ToString::to_string).collect()
    }

    fn award(&mut self, roles: &[&str]) {
        let mission = self.entry().id.clone();
        let holders = roles.iter().map(|role| (role.parse().unwrap(), format!("robot-{role}").replace('_', "-")));
        let holders = holders.map(|(role, robot)| (role, robot.parse().unwrap())).collect();
        let auction = AuctionRecord::empty(AuctionId { mission: mission.clone(), term: 1, round: 1 });
        let outcome = self.apply(Command::Award { mission, branch: Branch::Main, holders, auction });
        assert!(matches!(outcome, CommandOutcome::Awarded { .. }), "{outcome:?}");
    }

    /// Ends a held role, or lets it be lost.
    fn leave(&mut self, role: &str, ends: bool) {
        let (entry, role): (_, RoleId) = (self.entry(), role.parse().unwrap());
        let (mission, epoch) = (entry.id.clone(), entry.role_robots()[&role].epoch);
        let steps = entry.plan(&role).unwrap().steps.len();
        let (branch, outcomes, ended) = (Branch::Main, BTreeMap::new(), (0..steps as StepIndex).collect());
        let (incarnation, from_checkpoint) = (1, false);
        self.apply(Command::Accept {
            mission: mission.clone(),
            role: role.clone(),
            epoch,
            incarnation,
            from_checkpoint,
        });
        let (cause, class, moved_nothing, place, gave_way) = ("lost".to_owned(), None, false, None, false);
        let outcome = self.apply(match ends {
            true => Command::Progress { mission, role, epoch, branch, ended, outcomes },
            false => Command::Release { mission, role, epoch, cause, class, moved_nothing, place, gave_way },
        });
        assert_eq!(outcome, CommandOutcome::Done);
    }
}

#[test]
fn iterations_are_auctioned_in_the_order_of_a_role_outside() {
    let mut log = Log::of(VISITS);
    assert_eq!(log.to_auction(), ["escort_1"]);
    log.award(&["escort_1"]);
    assert_eq!(log.to_auction(), ["escort_2"]);
    log.award(&["escort_2"]);
    assert_eq!(log.to_auction(), ["escort_3"]);
    log.leave("escort_1", false);
    assert_eq!(log.to_auction(), ["escort_1"], "the others wait for it");
    log.award(&["escort_1"]);
    log.leave("escort_1", true);
    assert_eq!(log.to_auction(), ["escort_3"]);
}

/// The first visitor is lost on the way, while the other escorts wait for it at the clerk.
#[test]
fn a_robot_that_waits_for_an_open_iteration_returns_its_own() {
    let mut log = Log::of(VISITS);
    for escort in ["escort_1", "escort_2", "escort_3"] {
        log.award(&[escort]);
    }
    log.end("escort_2", 1);
    log.end("escort_3", 1);
    assert_eq!(log.to_return(), None, "every iteration has a robot");
    log.leave("escort_1", false);
    assert_eq!(log.to_return(), None, "other robots have not been asked");
    log.defer("escort_1", &["robot-escort-2", "robot-escort-3"]);
    assert_eq!(log.to_return().as_deref(), Some("escort_3"), "the last");
    log.leave("escort_3", false);
    assert_eq!(log.to_auction(), ["escort_1"]);
    assert_eq!(log.to_return(), None, "its robot is free");
    log.defer("escort_1", &["robot-escort-2"]);
    assert_eq!(log.to_return().as_deref(), Some("escort_2"), "the free robot cannot do it");
}

#[test]
fn a_robot_that_can_continue_keeps_its_iteration() {
    let mut log = Log::of(VISITS);
    log.award(&["escort_1"]);
    log.award(&["escort_2"]);
    log.leave("escort_1", false);
    log.defer("escort_1", &["robot-escort-2"]);
    assert_eq!(log.to_return(), None, "it is on its way");
    log.end("escort_2", 1);
    assert_eq!(log.to_return().as_deref(), Some("escort_2"));
}

#[test]
fn iterations_without_an_order_are_auctioned_together() {
    let mut log = Log::of(&VISITS.replace("[escort, clerk]", "[escort]"));
    assert_eq!(log.to_auction(), ["escort_1", "escort_2", "escort_3"]);
    log.award(&["escort_2"]);
    assert_eq!(log.to_auction(), ["escort_1", "escort_3"]);
}

/// The role after the loop waits for a person, who waits for the loop.
#[test]
fn a_role_that_waits_for_the_loop_by_way_of_a_person_is_auctioned_after_it() {
    let mut log = Log::of(&VISITS.replace("[escort, clerk]", "[escort]"));
    let head: RoleId = "head".parse().unwrap();
    let escorts = ["escort_1", "escort_2", "escort_3"];
    assert!(!log.entry().can_proceed(&head));
    log.award(&escorts);
    for escort in escorts {
        assert!(!log.entry().can_proceed(&head), "{escort} has not ended");
        log.leave(escort, true);
    }
    assert!(log.entry().can_proceed(&head), "the clerk waits for nobody");
    assert_eq!(log.to_auction(), ["head"]);
}
