use crate::auction::{AuctionEntry, AuctionId, AuctionRecord, BidVerdict, RefusalReason};
use crate::codec;
use crate::ids::{MissionId, RobotId, RoleId};
use crate::lease::Epoch;
use crate::ledger::{
    Branch, ChangeCursor, Command, HistoryLimits, Ledger, MissionCancelation, MissionChange, MissionChanges,
    MissionEntry, OrderRequest, Priority, RecoveryBranch, Submission,
};
use crate::mission::test_data::{FETCH_PARCEL, domain};
use crate::mission::{Format, MissionTemplate, RoleKind};
use crate::plan::divide_and_check;
use crate::units::Seconds;
use proptest::collection::vec;
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

const ROBOTS: [&str; 5] = ["ada", "bob", "cyd", "dan", "eve"];

/// A step of a run: its kind, a mission, a robot, and a role or another number. Each counts modulo what there is.
type Step = (u8, usize, usize, usize);

/// A ledger, the index of its next entry, and a mission to submit.
struct Log {
    ledger: Ledger,
    index: u64,
    submission: Submission,
}

impl Log {
    /// Missions have a person, an item and a recovery branch.
    fn new() -> Log {
        let text = FETCH_PARCEL.replace("roles:\n  clerk", "roles:\n  helper: { kind: managed }\n  clerk")
            + "recovery: { task: go_and_look, type: navigation, roles: [helper], parameters: { to: \"${lost.place}\" } }\n";
        let template = MissionTemplate::parse(&text, Format::Yaml).unwrap();
        let (mission, recovery) = template.instantiate_with_recovery(&BTreeMap::new(), &domain()).unwrap();
        let division = divide_and_check(&mission).unwrap();
        let recovery =
            recovery.map(|mission| RecoveryBranch { division: divide_and_check(&mission).unwrap(), mission });
        let submission = Submission { recovery, ..Submission::of("a".parse().unwrap(), mission, division) };
        Log { ledger: Ledger::default(), index: 1, submission }
    }

    fn apply(&mut self, command: Command) {
        self.ledger.apply(Epoch { term: 1, index: self.index }, command);
        self.index += 1;
    }

    /// Applies a command that may fit the ledger, or may be refused.
    fn perform(&mut self, (kind, mission, robot, number): Step) {
        let entries: Vec<&MissionEntry> = self.ledger.missions().collect();
        let Some(entry) = (!entries.is_empty()).then(|| entries[mission % entries.len()]) else {
            return self.submit(number);
        };
        let (id, branch) = (entry.id.clone(), entry.branch);
        let role: RoleId = entry.roles.keys().nth(number % entry.roles.len()).unwrap().clone();
        let epoch = entry.role_robots().get(&role).map(|holder| holder.epoch).unwrap_or_default();
        let (by, at_ms) = ("Nia".to_owned(), self.index);
        let command = match kind % 14 {
            0 | 1 => return self.submit(number),
            2 | 3 => {
                let robots = (robot..).map(|index| ROBOTS[index % ROBOTS.len()].parse().unwrap());
                let holders: BTreeMap<RoleId, RobotId> = entry.open_roles().into_iter().zip(robots).collect();
                let is_promised = |role: &&RoleId| kind % 14 == 3 && **role != holders.keys().next().unwrap().clone();
                let promised = holders.keys().filter(is_promised).map(|role| (role.clone(), Seconds::ZERO)).collect();
                let auction = AuctionId { mission: id.clone(), term: 1, round: 1 };
                let auction = AuctionRecord { promised, ..AuctionRecord::empty(auction) };
                Command::Award { mission: id, branch, holders, auction }
            }
            4 => Command::Accept { mission: id, role, epoch, incarnation: 1, from_checkpoint: false },
            5 => {
                let (ended, outcomes) = ((0..2 * robot as u32).collect(), BTreeMap::new());
                Command::Progress { mission: id, role, epoch, branch, ended, outcomes }
            }
            6 => {
                let (cause, class, place, gave_way) = ("silent".to_owned(), None, Some("P".parse().unwrap()), false);
                Command::Release { mission: id, role, epoch, cause, class, moved_nothing: false, place, gave_way }
            }
            7 => Command::Cancel { mission: id, by, places: BTreeMap::new(), at_ms },
            8 => {
                let change = MissionChange::SetPriority(Priority::new(number as i64).unwrap());
                let order = OrderRequest { change, by, at_ms, request: None };
                Command::ChangeMission { mission: id, order }
            }
            9 => Command::AwardPromised { mission: id, role, epoch },
            10 => Command::Postpone { mission: id, role, epoch },
            11 => {
                let missions = entries.iter().take(2).map(|entry| (entry.id.clone(), BTreeMap::new())).collect();
                let order = OrderRequest { change: MissionCancelation { missions }, by, at_ms, request: None };
                Command::CancelMissions { order }
            }
            12 => Command::Resolve { mission: id, by, at_ms },
            _ => {
                let (role, step) = ("clerk".parse().unwrap(), number as u32);
                Command::AskPerson { mission: id, branch, role, step, asked_ms: at_ms }
            }
        };
        self.apply(command);
    }

    fn submit(&mut self, priority: usize) {
        let request = format!("request-{}", self.index).parse().unwrap();
        let priority = Priority::new(priority as i64).unwrap();
        let submission = Submission { request, priority, ..self.submission.clone() };
        self.apply(Command::Submit(Box::new(submission)));
    }
}

fn ids<'a>(missions: impl IntoIterator<Item = &'a MissionEntry>) -> Vec<&'a MissionId> {
    missions.into_iter().map(|entry| &entry.id).collect()
}

/// Checks that queries return what an examination of all missions finds.
fn check_queries(ledger: &Ledger) {
    let mut active: Vec<&MissionEntry> = ledger.missions().filter(|entry| !entry.state.is_final()).collect();
    active.sort_by_key(|entry| entry.rank());
    assert_eq!(ids(ledger.active_missions()), ids(active.clone()));
    assert!(ledger.has_active(active.len()) && !ledger.has_active(active.len() + 1));
    for (place, entry) in active.iter().enumerate() {
        assert_eq!(ids(ledger.missions_before(entry)), ids(active[..place].iter().copied()));
    }
    let has_robots = |entry: &&MissionEntry| !entry.role_robots().is_empty() || !entry.former_holders.is_empty();
    assert_eq!(ids(ledger.missions_with_robots()), ids(active.iter().copied().filter(has_robots)));
    let is_open = |entry: &MissionEntry| entry.person_requests().any(|(_, request)| request.is_open());
    let has_people =
        |entry: &&MissionEntry| entry.roles.values().any(|role| role.kind == RoleKind::Unmanaged) || is_open(entry);
    assert_eq!(ids(ledger.missions_with_people()), ids(active.iter().copied().filter(has_people)));
    let items: Vec<_> =
        ledger.missions().flat_map(|entry| entry.held_items().into_iter().map(|item| (&entry.id, item))).collect();
    assert_eq!(ledger.held_items().map(|(entry, item)| (&entry.id, item)).collect::<Vec<_>>(), items);
    let mut promises: Vec<_> = active
        .iter()
        .flat_map(|entry| entry.promised_roles().map(move |(role, promise)| (&entry.id, role, promise, entry.rank())))
        .collect();
    promises.sort_by_key(|(_, _, promise, rank)| (rank.priority, promise.position, *rank));
    let promises: Vec<_> = promises.into_iter().map(|(id, role, promise, _)| (id, role, promise)).collect();
    let found = ledger.promises_in_order().into_iter().map(|(entry, role, promise)| (&entry.id, role, promise));
    assert_eq!(found.collect::<Vec<_>>(), promises);
    for robot in ROBOTS.map(|name| RobotId::new(name).unwrap()) {
        let held = ledger.missions().filter(|entry| !entry.state.is_final()).find_map(|entry| {
            let (role, _, holder) = entry.held_roles().find(|(.., holder)| holder.robot == robot)?;
            Some((&entry.id, role, holder.epoch))
        });
        assert_eq!(ledger.held_by(&robot).map(|(entry, role, epoch)| (&entry.id, role, epoch)), held);
        let of_robot = promises.iter().copied().filter(|(.., promise)| promise.robot == robot);
        let found = ledger.promises_of(&robot).into_iter().map(|(entry, role, promise)| (&entry.id, role, promise));
        assert_eq!(found.collect::<Vec<_>>(), of_robot.collect::<Vec<_>>());
    }
}

/// Returns the missions that differ between two ledgers.
fn differing(before: &Ledger, after: &Ledger) -> BTreeSet<MissionId> {
    let all = before.missions().chain(after.missions()).map(|entry| &entry.id);
    all.filter(|id| before.mission(id) != after.mission(id)).cloned().collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    /// After any commands the indexes contain what an examination of all missions finds, a copy that was read from a snapshot
    /// has the same indexes, and each change of a mission is among the changes.
    #[test]
    fn indexes_and_changes_follow_from_the_missions(
        steps in vec((0_u8..14, 0_usize..20, 0_usize..6, 0_usize..6), 1..80),
        has_history in any::<bool>(),
    ) {
        let (mut log, mut cursor) = (Log::new(), ChangeCursor::default());
        if has_history {
            log.apply(Command::first_wire_version(3));
            log.apply(Command::SetHistoryLimits(HistoryLimits { missions_max: 2, ..HistoryLimits::default() }));
        }
        assert_eq!(log.ledger.changes_since(&mut cursor), MissionChanges::All);
        for step in steps {
            let before = log.ledger.clone();
            log.perform(step);
            check_queries(&log.ledger);
            let differing = differing(&before, &log.ledger);
            match log.ledger.changes_since(&mut cursor) {
                MissionChanges::These(changed) => assert!(changed.is_superset(&differing), "{changed:?} {differing:?}"),
                MissionChanges::All => panic!("the changes are known"),
            }
        }
        let read: Ledger = codec::decode_record(&codec::encode_record(&log.ledger).unwrap()).unwrap();
        check_queries(&read);
        assert_eq!(read, log.ledger);
        assert_eq!(read.changes_since(&mut cursor), MissionChanges::All, "another list of changes");
    }
}

#[test]
fn a_refused_command_and_a_copy_leave_the_missions_of_others_alone() {
    let mut log = Log::new();
    (0..3).for_each(|priority| log.submit(priority));
    let (copy, mut cursor) = (log.ledger.clone(), ChangeCursor::default());
    log.ledger.changes_since(&mut cursor);
    let mission = ids(copy.active_missions())[0].clone();
    let (by, places, at_ms) = ("Nia".to_owned(), BTreeMap::new(), 1);
    log.apply(Command::Cancel { mission: mission.clone(), by, places, at_ms });
    let changes = log.ledger.changes_since(&mut cursor);
    assert_eq!(changes, MissionChanges::These([mission.clone()].into()));
    assert_eq!((copy.active_missions().len(), log.ledger.active_missions().len()), (3, 2));
    let shared = ids(copy.missions()).into_iter().filter(|id| {
        let of = |ledger: &Ledger| Arc::clone(ledger.missions.entries.get(id).unwrap());
        Arc::ptr_eq(&of(&copy), &of(&log.ledger))
    });
    assert!(shared.count() == 2, "a change copies the mission, and no other");
    log.apply(Command::AwardPromised { mission, role: "r1".parse().unwrap(), epoch: Epoch::default() });
    check_queries(&log.ledger);
    check_queries(&copy);
    assert_eq!(log.ledger.missions_with_people().len(), 2);
    assert_eq!(copy.mission_state(ids(copy.active_missions())[0]).map(|state| state.as_str()), Some("pending"));
}

#[test]
fn a_waiting_mission_that_twelve_robots_refuse_needs_at_most_20_kb() {
    let mut log = Log::new();
    log.apply(Command::first_wire_version(3));
    (0..500).for_each(|_| log.submit(0));
    let waiting: Vec<MissionEntry> = log.ledger.active_missions().into_iter().cloned().collect();
    for MissionEntry { id, roles, .. } in waiting {
        let problem = "its driver has not replied for 20 s, and a person has to look at it".to_owned();
        let verdict = BidVerdict::Refused { reason: RefusalReason::OutOfService { problem } };
        let robots = (0..12).map(|number| RobotId::new(format!("robot-{number:03}")).unwrap());
        let refusal = |(robot, role): (RobotId, &RoleId)| {
            let (role, verdict, parts) = (role.clone(), verdict.clone(), vec![]);
            AuctionEntry { role, robot, verdict, parts }
        };
        let entries =
            robots.flat_map(|robot| roles.keys().map(move |role| (robot.clone(), role))).map(refusal).collect();
        let auction = AuctionId { mission: id.clone(), term: 1, round: 1 };
        let failure = Some("no robot bids for any role".to_owned());
        let auction = AuctionRecord { entries, failure, ..AuctionRecord::empty(auction) }.for_ledger(false);
        log.apply(Command::Defer { mission: id, branch: Branch::Main, auction });
    }
    assert!(
        log.ledger.missions().all(|entry| entry.auction.as_ref().is_some_and(|auction| !auction.entries.is_empty()))
    );
    let bytes = codec::encode_record(&log.ledger).unwrap().len() / 500;
    assert!(bytes <= 20_000, "{bytes} bytes for each mission");
}
