//! Circular waits: missions that hold robots and wait for each other's.
//!
//! A mission that has lost a robot keeps its other robots while it waits for a replacement, or for the robot of a
//! promise. Several such missions can wait for each other's robots for ever. The deadlock is resolved by rank (wait-die):
//! of the missions in a cycle, the worst-ranked mission with a role in which no step has ended gives up
//! these roles. They are auctioned again after the roles of better-ranked missions. A cycle in which
//! all held roles have ended steps remains until a person or a deadline ends one of its missions.

use super::message::AwardedRole;
use consort_protocol::auction::AuctionEntry;
use consort_protocol::ids::{MissionId, RobotId};
use consort_protocol::ledger::{Ledger, MissionEntry};
use petgraph::algo::tarjan_scc;
use petgraph::graph::DiGraph;
use std::collections::BTreeMap;

/// Returns the roles to be given up, each with the best-ranked mission of its cycle.
pub(super) fn roles_to_give_up(ledger: &Ledger) -> Vec<(AwardedRole, MissionId)> {
    let missions = ledger.missions_with_robots().into_iter();
    let waiting: Vec<&MissionEntry> = missions.filter(|entry| waits_with_robots(entry)).collect();
    // Promises alone form no cycle.
    if waiting.len() < 2 || waiting.iter().all(|entry| entry.open_roles().is_empty()) {
        return vec![];
    }
    let holders: BTreeMap<&RobotId, usize> = (0..)
        .zip(&waiting)
        .flat_map(|(rank, entry)| entry.held_roles().map(move |(.., holder)| (&holder.robot, rank)))
        .collect();
    let waits_for = (0..).zip(&waiting).flat_map(|(rank, entry)| {
        let promised = entry.promised_roles().map(|(_, robot)| &robot.robot);
        let blocking = busy_robots(entry).chain(promised).filter_map(|robot| holders.get(robot).copied());
        blocking.filter(move |other| *other != rank).map(move |other| (rank, other))
    });
    let graph = DiGraph::<(), (), usize>::from_edges(waits_for);
    let cycles = tarjan_scc(&graph).into_iter().filter(|cycle| cycle.len() > 1);
    cycles
        .flat_map(|cycle| {
            let mut ranks: Vec<usize> = cycle.into_iter().map(|node| node.index()).collect();
            ranks.sort_unstable();
            let best = waiting[ranks[0]].id.clone();
            let given_up =
                ranks.iter().rev().map(|rank| untouched_roles(waiting[*rank])).find(|roles| !roles.is_empty());
            given_up.into_iter().flatten().map(move |role| (role, best.clone()))
        })
        .collect()
}

/// Checks whether a mission holds robots while it waits for others. No mission waits for one without robots.
pub(super) fn waits_with_robots(entry: &MissionEntry) -> bool {
    let waits = || !entry.open_roles().is_empty() || entry.promised_roles().next().is_some();
    entry.held_roles().next().is_some() && waits()
}

/// Returns the robots that could not bid for the open roles because they hold a role. The latest auction
/// of the mission, if it failed, names them. Nothing waits for a role of a spread loop while another role can proceed.
fn busy_robots(entry: &MissionEntry) -> impl Iterator<Item = &RobotId> {
    let proceeds = entry.held_roles().any(|(role, ..)| entry.can_proceed(role));
    let mut open = entry.open_roles();
    open.retain(|role| !proceeds || !entry.is_spread(role));
    let failed = entry.auction.iter().filter(|auction| auction.failure.is_some());
    let entries = failed.flat_map(|auction| &auction.entries).filter(move |entry| open.contains(&entry.role));
    entries.filter(|entry| entry.is_busy()).flat_map(AuctionEntry::robots)
}

/// Returns the held roles of a mission in which no step has ended.
fn untouched_roles(entry: &MissionEntry) -> Vec<AwardedRole> {
    let untouched = entry.held_roles().filter(|(_, held, _)| held.ended.is_empty());
    untouched.map(|(role, _, holder)| AwardedRole::of(entry, role, holder)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::auction::{AuctionId, AuctionRecord, BidVerdict, RefusalReason};
    use consort_protocol::cause::CauseClass;
    use consort_protocol::ids::RoleId;
    use consort_protocol::lease::Epoch;
    use consort_protocol::ledger::{Branch, Command, CommandOutcome, Submission};
    use consort_protocol::mission::{Format, MissionTemplate};
    use consort_protocol::plan::divide_and_check;
    use consort_skills::domain::hospital;
    use std::collections::BTreeSet;

    const MISSION: &str = r#"{"mission": "visit", "roles": {"r1": {"kind": "managed"}, "r2": {"kind": "managed"}},
        "root": {"task": "go", "type": "wait", "roles": ["r1", "r2"], "parameters": {"seconds": "5"}}}"#;

    fn at(index: u64) -> Epoch {
        Epoch { term: 1, index }
    }

    /// Returns a ledger with missions of two roles. For each mission: the robot that holds a role, the
    /// robots that refused the open role because they hold another, and whether a step has ended.
    fn ledger(missions: &[(&str, &[&str], bool)]) -> Ledger {
        let (r1, r2) = (RoleId::new("r1").unwrap(), RoleId::new("r2").unwrap());
        let mut ledger = Ledger::default();
        for (number, (holder, busy, touched)) in (1..).zip(missions) {
            let mission = MissionTemplate::parse(MISSION, Format::Json).unwrap();
            let mission = mission.instantiate(&BTreeMap::new(), &hospital()).unwrap();
            let division = divide_and_check(&mission).unwrap();
            let request = format!("request-{number}").parse().unwrap();
            ledger.apply(at(10 * number), Command::Submit(Box::new(Submission::of(request, mission, division))));
            let mission = ledger.missions().last().unwrap().id.clone();
            let record = |failure: Option<&str>, entries| AuctionRecord {
                entries,
                failure: failure.map(str::to_owned),
                ..AuctionRecord::empty(AuctionId { mission: mission.clone(), term: 1, round: 1 })
            };
            let lost = RobotId::new(format!("lost-{number}")).unwrap();
            let holders = BTreeMap::from([(r1.clone(), holder.parse().unwrap()), (r2.clone(), lost)]);
            let (branch, epoch) = (Branch::Main, at(10 * number + 1));
            let award = Command::Award { mission: mission.clone(), branch, holders, auction: record(None, vec![]) };
            assert_eq!(ledger.apply(epoch, award), CommandOutcome::Awarded { epoch });
            if *touched {
                let (role, incarnation, from_checkpoint) = (r1.clone(), 1, false);
                let accept = Command::Accept { mission: mission.clone(), role, epoch, incarnation, from_checkpoint };
                assert_eq!(ledger.apply(at(10 * number + 2), accept), CommandOutcome::Done);
                let (role, ended, outcomes) = (r1.clone(), BTreeSet::from([0]), BTreeMap::new());
                let progress = Command::Progress { mission: mission.clone(), role, epoch, branch, ended, outcomes };
                assert_eq!(ledger.apply(at(10 * number + 2), progress), CommandOutcome::Done);
            }
            let (cause, class, place) = ("silent".to_owned(), Some(CauseClass::Robot), None);
            let release = Command::Release {
                mission: mission.clone(),
                role: r2.clone(),
                epoch,
                cause,
                class,
                moved_nothing: false,
                place,
                gave_way: false,
            };
            assert_eq!(ledger.apply(at(10 * number + 3), release), CommandOutcome::Done);
            let reason = RefusalReason::Busy { mission: mission.clone(), role: r1.clone() };
            let refusals = busy.iter().map(|robot| AuctionEntry {
                robot: robot.parse().unwrap(),
                role: r2.clone(),
                verdict: BidVerdict::Refused { reason: reason.clone() },
                parts: vec![],
            });
            let auction = record(Some("no viable bid"), refusals.collect());
            let defer = Command::Defer { mission, branch, auction };
            assert_eq!(ledger.apply(at(10 * number + 4), defer), CommandOutcome::Done);
        }
        ledger
    }

    /// Returns the robots that give up a role, with the number of the mission that comes first.
    fn given_up(missions: &[(&str, &[&str], bool)]) -> Vec<(String, usize)> {
        let ledger = ledger(missions);
        let number = |first: &MissionId| 1 + ledger.missions().position(|entry| entry.id == *first).unwrap();
        roles_to_give_up(&ledger).iter().map(|(role, first)| (role.robot.to_string(), number(first))).collect()
    }

    #[test]
    fn the_worst_ranked_untouched_mission_of_a_cycle_gives_up_its_roles() {
        let of = |robot: &str, first| vec![(robot.to_owned(), first)];
        assert_eq!(given_up(&[("amber", &["birch"], false), ("birch", &["amber"], false)]), of("birch", 1));
        assert_eq!(given_up(&[("amber", &["birch"], false), ("birch", &["amber"], true)]), of("amber", 1));
        assert_eq!(given_up(&[("amber", &["birch"], true), ("birch", &["amber"], true)]), []);
        let three: [(&str, &[&str], bool); 3] =
            [("amber", &["birch"], false), ("birch", &["fern"], false), ("fern", &["amber"], false)];
        assert_eq!(given_up(&three), of("fern", 1));
        // The second mission waits for the first, which waits for nobody's robot.
        assert_eq!(given_up(&[("amber", &[], false), ("birch", &["amber"], false)]), []);
        // The robot that the first mission waits for has been lost since.
        assert_eq!(given_up(&[("amber", &["elder"], false), ("birch", &["amber"], false)]), []);
    }
}
