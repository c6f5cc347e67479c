//! Why each robot did or did not get each role, in words: from the record of an auction alone.

use super::bid::{BidPart, RefusalReason};
use super::record::{AuctionEntry, AuctionRecord, BidVerdict};
use crate::count::count;
use crate::ids::{RobotId, RoleId};
use crate::units::Seconds;
use serde::{Deserialize, Serialize};
use std::cmp::Ordering;
use std::collections::BTreeMap;

/// An auction, explained.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Explanation {
    /// Its round.
    pub round: u32,
    /// When it was held: milliseconds on the coordinator's wall clock.
    pub at_ms: u64,
    /// Role by role.
    pub roles: Vec<RoleExplanation>,
    /// Answers that the record has no room for.
    pub omitted: u32,
}

/// What became of one role.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RoleExplanation {
    /// The role.
    pub role: RoleId,
    /// Who gets it; `None` if nobody does.
    pub winner: Option<RobotId>,
    /// Why, in a sentence.
    pub why: String,
    /// Every robot that was asked: the winner, then the others by their price, then those that did not bid.
    pub robots: Vec<RobotExplanation>,
}

/// What became of one robot's answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RobotExplanation {
    /// The robot.
    pub robot: RobotId,
    /// In a word, for programs.
    pub outcome: RobotOutcome,
    /// In a sentence, for people.
    pub why: String,
    /// What it bid, if it did.
    pub bid: Option<BidCost>,
    /// The bid step by step, where the record has it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<BidPart>,
    /// How much longer than the winner it would take, in seconds; negative if it would be quicker.
    pub behind_s: Option<f64>,
}

/// What can become of a robot's answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RobotOutcome {
    /// It gets the role.
    Won,
    /// It gets another role of the mission.
    ElsewhereInMission,
    /// Another bid is taken.
    Outbid,
    /// Its bid could be taken, but nobody gets the role.
    InVain,
    /// Its bid cannot be taken.
    Unviable,
    /// It will not, or cannot.
    Refused,
    /// It is no member of the ensemble.
    NotMember,
    /// It said nothing in time.
    Silent,
}

/// The parts of a bid that were compared.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BidCost {
    /// Time for the plan.
    pub time_s: f64,
    /// Charge used, as a share.
    pub energy: f64,
    /// Charge left, as a share.
    pub remaining: f64,
}

impl BidCost {
    fn of(time: Seconds, energy: f64, remaining: f64) -> BidCost {
        BidCost { time_s: time.get(), energy, remaining }
    }

    /// `99.7 s, 6.0 % of its charge, 84.0 % left`.
    fn words(&self) -> String {
        format!(
            "{:.1} s, {:.1} % of its charge, {:.1} % left",
            self.time_s,
            self.energy * 100.0,
            self.remaining * 100.0
        )
    }
}

/// The bid that was taken.
#[derive(Clone, Copy)]
struct Taken<'a> {
    price: BidCost,
    parts: &'a [BidPart],
}

/// What a step is: a task by its name, a message by whom it goes to or comes from.
fn step_in_words(part: &BidPart) -> String {
    // As `Signal` is written: kind, task, sender, receiver.
    let mut words = part.label.split(':').skip(2);
    match (part.skill.as_str(), words.next(), words.next()) {
        ("send_message", Some(_), Some(to)) => format!("telling {to}"),
        ("wait_message", Some(from), _) => format!("waiting for {from}"),
        _ => part.label.clone(),
    }
}

impl RobotExplanation {
    /// What each step of the bid takes, as far as it takes anything: `navto_room 37.0 s 2.2 %, approach_nurse 1.0 s 0.1 %`.
    /// `None` if the steps are not known.
    pub fn parts_text(&self) -> Option<String> {
        let takes = |part: &&BidPart| part.time.get() >= 0.05 || part.energy >= 0.0005;
        let words =
            |part: &BidPart| format!("{} {:.1} s {:.1} %", step_in_words(part), part.time.get(), part.energy * 100.0);
        let parts: Vec<String> = self.parts.iter().filter(takes).map(words).collect();
        (!parts.is_empty()).then(|| parts.join(", "))
    }
}

impl Explanation {
    /// The same without the bids' parts, for where the record stands beside it.
    pub fn without_parts(mut self) -> Explanation {
        for robot in self.roles.iter_mut().flat_map(|role| &mut role.robots) {
            robot.parts.clear();
        }
        self
    }
}

/// Explains an auction.
pub fn explain(record: &AuctionRecord) -> Explanation {
    let mut by_role: BTreeMap<&RoleId, Vec<&AuctionEntry>> = BTreeMap::new();
    for entry in &record.entries {
        by_role.entry(&entry.role).or_default().push(entry);
    }
    for role in record.chosen.keys() {
        by_role.entry(role).or_default();
    }
    Explanation {
        round: record.auction.round,
        at_ms: record.at_ms,
        roles: by_role.into_iter().map(|(role, entries)| explain_role(record, role, &entries)).collect(),
        omitted: record.omitted,
    }
}

fn explain_role(record: &AuctionRecord, role: &RoleId, entries: &[&AuctionEntry]) -> RoleExplanation {
    let winner = record.chosen.get(role);
    let taken = |robot: &RobotId| {
        let entry = entries.iter().find(|entry| entry.robot == *robot)?;
        Some(Taken { price: viable(&entry.verdict)?, parts: &entry.parts })
    };
    let won = winner.and_then(taken);
    let mut robots: Vec<RobotExplanation> =
        entries.iter().map(|entry| explain_robot(record, role, entry, winner, won)).collect();
    robots.sort_by(|one, other| {
        let time = |robot: &RobotExplanation| robot.bid.map_or(f64::INFINITY, |bid| bid.time_s);
        let won = |robot: &RobotExplanation| robot.outcome != RobotOutcome::Won;
        let unviable = |robot: &RobotExplanation| robot.outcome == RobotOutcome::Unviable;
        (won(one), unviable(one))
            .cmp(&(won(other), unviable(other)))
            .then(time(one).partial_cmp(&time(other)).unwrap_or(Ordering::Equal))
            .then(one.outcome.cmp(&other.outcome))
            .then(one.robot.cmp(&other.robot))
    });
    let why = match winner {
        Some(winner) => why_won(record, winner, won.map(|won| won.price), &robots),
        None => {
            let viable = robots.iter().filter(|robot| robot.outcome == RobotOutcome::InVain).count();
            let cause = record.failure.as_deref().unwrap_or("the auction came to nothing");
            match viable {
                0 => format!(
                    "nobody gets {role}: {cause}; none of {} could take it",
                    count(robots.len(), "robot", "robots")
                ),
                _ => format!(
                    "nobody gets {role}: {cause}; {} could be taken, but a mission is filled whole or not at all",
                    count(viable, "bid", "bids")
                ),
            }
        }
    };
    RoleExplanation { role: role.clone(), winner: winner.cloned(), why, robots }
}

fn why_won(record: &AuctionRecord, winner: &RobotId, won: Option<BidCost>, robots: &[RobotExplanation]) -> String {
    let Some(won) = won else { return format!("{winner} gets it; its bid is not among those that were kept") };
    let rivals: Vec<&RobotExplanation> = robots
        .iter()
        .filter(|robot| matches!(robot.outcome, RobotOutcome::Outbid | RobotOutcome::ElsewhereInMission))
        .collect();
    let quicker: Vec<&&RobotExplanation> =
        rivals.iter().filter(|robot| robot.behind_s.is_some_and(|behind| behind < 0.0)).collect();
    let bid = format!("{winner} gets it with {}", won.words());
    if let Some(rival) = quicker.first() {
        return match rival.outcome {
            RobotOutcome::ElsewhereInMission => {
                let role =
                    record.chosen.iter().find(|(_, robot)| **robot == rival.robot).map(|(role, _)| role.as_str());
                format!(
                    "{bid}: {} would be quicker, but gets {}, and so all roles together take least time",
                    rival.robot,
                    role.unwrap_or("another role")
                )
            }
            _ => format!("{bid}, though {} would be quicker: the rule of this fleet chose otherwise", rival.robot),
        };
    }
    match rivals.first().map(|rival| (rival, rival.behind_s.unwrap_or(0.0))) {
        None => format!("{bid}: no other bid could be taken"),
        Some((rival, behind)) if behind < 0.05 => {
            format!("{bid}: as quick as {}, of {}", rival.robot, count(rivals.len() + 1, "bid", "bids"))
        }
        Some((rival, behind)) => {
            format!(
                "{bid}: the quickest of {}, {behind:.1} s before {}",
                count(rivals.len() + 1, "bid", "bids"),
                rival.robot
            )
        }
    }
}

fn explain_robot(
    record: &AuctionRecord,
    role: &RoleId,
    entry: &AuctionEntry,
    winner: Option<&RobotId>,
    won: Option<Taken<'_>>,
) -> RobotExplanation {
    let robot = &entry.robot;
    let elsewhere = record.chosen.iter().find(|(other, chosen)| *other != role && *chosen == robot);
    let (outcome, bid, why) = match &entry.verdict {
        BidVerdict::Viable { time, energy, remaining } => {
            let bid = BidCost::of(*time, *energy, *remaining);
            let words = format!("{robot} bid {}", bid.words());
            let (outcome, why) = match (winner, elsewhere, won) {
                (Some(winner), ..) if winner == robot => (RobotOutcome::Won, format!("{words}, and gets the role")),
                (_, Some((other, _)), _) => {
                    (RobotOutcome::ElsewhereInMission, format!("{words}; it gets {other} of this mission instead"))
                }
                (Some(winner), None, Some(won)) => {
                    let behind = bid.time_s - won.price.time_s;
                    let more = if behind < 0.0 { "less" } else { "more" };
                    let most = if behind < 0.0 { None } else { most_behind(&entry.parts, won.parts) };
                    let most =
                        most.map(|(step, more)| format!(", most of all in {} ({more:.1} s more)", step_in_words(step)));
                    let most = most.unwrap_or_default();
                    (RobotOutcome::Outbid, format!("{words}: outbid, {:.1} s {more} than {winner}{most}", behind.abs()))
                }
                (Some(winner), None, None) => (RobotOutcome::Outbid, format!("{words}: {winner} was chosen")),
                (None, ..) => (RobotOutcome::InVain, format!("{words}, in vain")),
            };
            (outcome, Some(bid), why)
        }
        BidVerdict::Unviable { time, energy, remaining, why } => {
            let bid = BidCost::of(*time, *energy, *remaining);
            (RobotOutcome::Unviable, Some(bid), format!("{robot} bid {}: not to be taken, {why}", bid.words()))
        }
        BidVerdict::Refused { reason } => {
            let (outcome, why) = refused(robot, reason);
            (outcome, None, why)
        }
    };
    let behind_s = bid.zip(won).map(|(bid, won)| bid.time_s - won.price.time_s);
    RobotExplanation { robot: robot.clone(), outcome, why, bid, parts: entry.parts.clone(), behind_s }
}

/// The step in which a bid falls behind another of the same plan the most, and by how many seconds.
fn most_behind<'a>(parts: &'a [BidPart], won: &[BidPart]) -> Option<(&'a BidPart, f64)> {
    let behind = |part: &'a BidPart| {
        let same = won.iter().find(|other| other.step == part.step)?;
        Some((part, part.time.get() - same.time.get()))
    };
    let most = parts.iter().filter_map(behind).max_by(|one, other| one.1.total_cmp(&other.1))?;
    (most.1 >= 0.05).then_some(most)
}

fn refused(robot: &RobotId, reason: &RefusalReason) -> (RobotOutcome, String) {
    match reason {
        RefusalReason::NotMember { ensemble, why } => {
            (RobotOutcome::NotMember, format!("{robot} is not a member of {ensemble}: {why}"))
        }
        RefusalReason::Silent { window_ms } => {
            (RobotOutcome::Silent, format!("{robot} was asked and did not answer within {window_ms} ms"))
        }
        RefusalReason::MissingSkills { .. } => (RobotOutcome::Refused, format!("{robot} {reason}")),
        RefusalReason::HandsFull { .. } | RefusalReason::Excluded { .. } => {
            (RobotOutcome::Refused, format!("{robot} {reason}"))
        }
        RefusalReason::NotFeasible { .. } => (RobotOutcome::Refused, format!("{robot} {reason}")),
        RefusalReason::Busy { .. } | RefusalReason::OutOfService { .. } => {
            (RobotOutcome::Refused, format!("{robot} is {reason}"))
        }
    }
}

fn viable(verdict: &BidVerdict) -> Option<BidCost> {
    match verdict {
        BidVerdict::Viable { time, energy, remaining } => Some(BidCost::of(*time, *energy, *remaining)),
        BidVerdict::Unviable { .. } | BidVerdict::Refused { .. } => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::auction::{AuctionId, ViabilityError};
    use crate::units::BatteryShare;

    fn slug<T: std::str::FromStr<Err: std::fmt::Debug>>(text: &str) -> T {
        text.parse().unwrap()
    }

    fn bid(role: &str, robot: &str, seconds: f64) -> AuctionEntry {
        let verdict = BidVerdict::Viable { time: Seconds::new(seconds).unwrap(), energy: 0.06, remaining: 0.84 };
        AuctionEntry { role: slug(role), robot: slug(robot), verdict, parts: vec![] }
    }

    /// A bid whose steps are a drive of so many seconds, which uses a thousandth of the charge in a second, a wait, and a
    /// minute with the nurse.
    fn drives(robot: &str, seconds: f64) -> AuctionEntry {
        let part = |step, label: &str, skill, seconds| BidPart {
            step,
            label: label.to_owned(),
            skill: slug(skill),
            time: Seconds::new(seconds).unwrap(),
            energy: seconds / 1000.0,
        };
        let parts = vec![
            part(0, "navto_room", "navigation", seconds),
            part(1, "done:greet:r2:r1", "wait_message", 0.0),
            part(2, "done:deposit:nurse:r1", "wait_message", 2.0),
            part(3, "ready:deposit:r1:nurse", "send_message", 2.0),
            part(4, "authenticate_nurse", "authenticate_person", 60.0),
        ];
        AuctionEntry { parts, ..bid("r1", robot, seconds + 64.0) }
    }

    fn no(role: &str, robot: &str, reason: RefusalReason) -> AuctionEntry {
        AuctionEntry { role: slug(role), robot: slug(robot), verdict: BidVerdict::Refused { reason }, parts: vec![] }
    }

    fn record(entries: Vec<AuctionEntry>, chosen: &[(&str, &str)], failure: Option<&str>) -> AuctionRecord {
        AuctionRecord {
            auction: AuctionId { mission: slug("lab-samples-1"), term: 2, round: 3 },
            at_ms: 7,
            entries,
            omitted: 0,
            chosen: chosen.iter().map(|(role, robot)| (slug(role), slug(robot))).collect(),
            failure: failure.map(str::to_owned),
        }
    }

    fn words(explanation: &Explanation) -> Vec<String> {
        let of = |role: &RoleExplanation| {
            let robots = role.robots.iter().map(|robot| format!("  {}", robot.why)).collect::<Vec<_>>();
            std::iter::once(format!("{}: {}", role.role, role.why)).chain(robots).collect::<Vec<_>>()
        };
        explanation.roles.iter().flat_map(of).collect()
    }

    #[test]
    fn the_quickest_wins_and_everybody_else_hears_why_not() {
        let unviable = BidVerdict::Unviable {
            time: Seconds::new(90.0).unwrap(),
            energy: 0.107,
            remaining: 0.023,
            why: ViabilityError::LowCharge { remaining: 0.023, floor: BatteryShare::new(0.08).unwrap() },
        };
        let entries = vec![
            no("r1", "amber", RefusalReason::NotMember { ensemble: slug("logistics"), why: "too far".to_owned() }),
            bid("r1", "birch", 99.7),
            bid("r1", "cedar", 176.9),
            no("r1", "dune", RefusalReason::MissingSkills { skills: vec![slug("navigation")] }),
            AuctionEntry { role: slug("r1"), robot: slug("ember"), verdict: unviable, parts: vec![] },
            bid("r1", "flint", 160.3),
            no("r1", "gorse", RefusalReason::Busy { mission: slug("m-2"), role: slug("r1") }),
            no("r1", "hazel", RefusalReason::Silent { window_ms: 200 }),
        ];
        let explained = explain(&record(entries, &[("r1", "birch")], None));
        assert_eq!(
            words(&explained),
            [
                "r1: birch gets it with 99.7 s, 6.0 % of its charge, 84.0 % left: the quickest of 3 bids, 60.6 s before \
                 flint",
                "  birch bid 99.7 s, 6.0 % of its charge, 84.0 % left, and gets the role",
                "  flint bid 160.3 s, 6.0 % of its charge, 84.0 % left: outbid, 60.6 s more than birch",
                "  cedar bid 176.9 s, 6.0 % of its charge, 84.0 % left: outbid, 77.2 s more than birch",
                "  dune lacks navigation",
                "  gorse is busy as r1 of m-2",
                "  amber is not a member of logistics: too far",
                "  hazel was asked and did not answer within 200 ms",
                "  ember bid 90.0 s, 10.7 % of its charge, 2.3 % left: not to be taken, 2.3 % charge left is not above \
                 8.0 %",
            ]
        );
        let outcomes: Vec<RobotOutcome> = explained.roles[0].robots.iter().map(|robot| robot.outcome).collect();
        use RobotOutcome::{NotMember, Outbid, Refused, Silent, Won};
        assert_eq!(outcomes, [Won, Outbid, Outbid, Refused, Refused, NotMember, Silent, RobotOutcome::Unviable]);
    }

    #[test]
    fn a_bid_is_told_step_by_step_and_where_a_rival_falls_behind() {
        let entries = vec![drives("birch", 37.04), drives("flint", 92.1), bid("r1", "cedar", 103.0)];
        let explained = explain(&record(entries, &[("r1", "birch")], None));
        let [birch, cedar, flint] = &explained.roles[0].robots[..] else { panic!("three robots") };
        let steps = "navto_room 37.0 s 3.7 %, waiting for nurse 2.0 s 0.2 %, telling nurse 2.0 s 0.2 %, authenticate_nurse \
                     60.0 s 6.0 %";
        assert_eq!(birch.parts_text().as_deref(), Some(steps));
        assert!(cedar.why.ends_with(": outbid, 2.0 s more than birch"), "{}", cedar.why);
        assert_eq!(cedar.parts_text(), None);
        let most = ": outbid, 55.1 s more than birch, most of all in navto_room (55.1 s more)";
        assert!(flint.why.ends_with(most), "{}", flint.why);
        let seen = serde_json::to_value(birch).unwrap();
        assert_eq!(seen["parts"][0]["skill"], "navigation", "{seen}");
        let seen = serde_json::to_value(explained.without_parts()).unwrap();
        assert_eq!(seen["roles"][0]["robots"][0].get("parts"), None, "{seen}");
    }

    #[test]
    fn who_would_be_quicker_and_has_another_role_is_named() {
        let entries = vec![bid("a", "ada", 10.0), bid("a", "bob", 12.0), bid("b", "ada", 11.0), bid("b", "bob", 30.0)];
        let explained = explain(&record(entries, &[("a", "bob"), ("b", "ada")], None));
        assert_eq!(
            words(&explained),
            [
                "a: bob gets it with 12.0 s, 6.0 % of its charge, 84.0 % left: ada would be quicker, but gets b, and so all \
                 roles together take least time",
                "  bob bid 12.0 s, 6.0 % of its charge, 84.0 % left, and gets the role",
                "  ada bid 10.0 s, 6.0 % of its charge, 84.0 % left; it gets b of this mission instead",
                "b: ada gets it with 11.0 s, 6.0 % of its charge, 84.0 % left: the quickest of 2 bids, 19.0 s before bob",
                "  ada bid 11.0 s, 6.0 % of its charge, 84.0 % left, and gets the role",
                "  bob bid 30.0 s, 6.0 % of its charge, 84.0 % left; it gets a of this mission instead",
            ]
        );
    }

    #[test]
    fn an_auction_that_came_to_nothing_says_what_was_missing() {
        let entries = vec![
            bid("a", "ada", 10.0),
            no("b", "ada", RefusalReason::OutOfService { problem: "no charge".to_owned() }),
        ];
        let explained = explain(&record(entries, &[], Some("no viable bid for b")));
        assert_eq!(
            words(&explained),
            [
                "a: nobody gets a: no viable bid for b; 1 bid could be taken, but a mission is filled whole or not at all",
                "  ada bid 10.0 s, 6.0 % of its charge, 84.0 % left, in vain",
                "b: nobody gets b: no viable bid for b; none of 1 robot could take it",
                "  ada is out of service: no charge",
            ]
        );
    }
}
