//! Explanation of an auction in text: the reason for which each robot got or did not get each role.
//! Computed from the record of the auction alone.

use super::bid::{BidPart, RefusalReason};
use super::record::{AuctionEntry, AuctionRecord, BidVerdict};
use crate::count::count;
use crate::ids::{RobotId, RoleId};
use crate::units::Seconds;
use serde::{Deserialize, Serialize};
use std::cmp::Ordering;
use std::collections::BTreeMap;

/// Explanation of an auction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Explanation {
    /// Round of the auction.
    pub round: u32,
    /// Time on the coordinator's wall clock, in milliseconds.
    pub at_ms: u64,
    /// Explanation of each role.
    pub roles: Vec<RoleExplanation>,
    /// Number of replies that the record omits.
    pub omitted: u32,
}

/// Explanation for a single role.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RoleExplanation {
    /// The role.
    pub role: RoleId,
    /// Robot that gets the role, if any.
    pub winner: Option<RobotId>,
    /// Reason, as a sentence.
    pub why: String,
    /// Every invited robot: the winner, then the others by cost, then robots without a bid.
    pub robots: Vec<RobotExplanation>,
}

/// Explanation for a single robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RobotExplanation {
    /// The robot.
    pub robot: RobotId,
    /// Outcome, for programs.
    pub outcome: RobotOutcome,
    /// Reason as a sentence, for people.
    pub why: String,
    /// Cost of its bid, if it sent a bid.
    pub bid: Option<BidCost>,
    /// Cost of each step, if the record contains it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<BidPart>,
    /// Additional time compared to the winner, in seconds; negative if it would be faster.
    pub behind_s: Option<f64>,
}

/// Outcome of a robot's reply.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RobotOutcome {
    /// The robot gets the role.
    Won,
    /// The robot gets another role of the mission.
    WonOtherRole,
    /// Another bid was chosen.
    Outbid,
    /// The bid is viable, but no robot gets the role.
    RoleUnfilled,
    /// The bid is outside the limits.
    Unviable,
    /// The robot refused the role.
    Refused,
    /// The robot is not a member of the ensemble.
    NotMember,
    /// The robot did not reply in time.
    Silent,
}

/// Values of a bid that are compared.
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

    /// Formats the cost: `99.7 s, 6.0 % of its charge, 84.0 % left`.
    fn text(&self) -> String {
        format!(
            "{:.1} s, {:.1} % of its charge, {:.1} % left",
            self.time_s,
            self.energy * 100.0,
            self.remaining * 100.0
        )
    }
}

/// Bid that was chosen.
#[derive(Clone, Copy)]
struct ChosenBid<'a> {
    price: BidCost,
    parts: &'a [BidPart],
}

/// Describes a step: a task by its name, a signal by its sender or receiver.
fn step_text(part: &BidPart) -> String {
    // Format of `Signal`: kind, task, sender, receiver.
    let mut words = part.label.split(':').skip(2);
    match (part.skill.as_str(), words.next(), words.next()) {
        ("send_message", Some(_), Some(to)) => format!("signal to {to}"),
        ("wait_message", Some(from), _) => format!("wait for {from}"),
        _ => part.label.clone(),
    }
}

impl RobotExplanation {
    /// Formats the cost of each step that is not negligible:
    /// `navto_room 37.0 s 2.2 %, approach_nurse 1.0 s 0.1 %`. `None` if the steps are not in the
    /// record.
    pub fn parts_text(&self) -> Option<String> {
        let takes = |part: &&BidPart| part.time.get() >= 0.05 || part.energy >= 0.0005;
        let words =
            |part: &BidPart| format!("{} {:.1} s {:.1} %", step_text(part), part.time.get(), part.energy * 100.0);
        let parts: Vec<String> = self.parts.iter().filter(takes).map(words).collect();
        (!parts.is_empty()).then(|| parts.join(", "))
    }
}

impl Explanation {
    /// Removes the parts of the bids, for use next to the record that contains them.
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
        Some(ChosenBid { price: viable_cost(&entry.verdict)?, parts: &entry.parts })
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
            let viable = robots.iter().filter(|robot| robot.outcome == RobotOutcome::RoleUnfilled).count();
            let cause = record.failure.as_deref().unwrap_or("the auction assigned no role");
            match viable {
                0 => format!(
                    "{role} is not assigned: {cause}; {} considered",
                    count(robots.len(), "robot was", "robots were")
                ),
                _ => format!(
                    "{role} is not assigned: {cause}; {} within the limits, but a mission is filled completely or not at all",
                    count(viable, "bid is", "bids are")
                ),
            }
        }
    };
    RoleExplanation { role: role.clone(), winner: winner.cloned(), why, robots }
}

fn why_won(record: &AuctionRecord, winner: &RobotId, won: Option<BidCost>, robots: &[RobotExplanation]) -> String {
    let Some(won) = won else { return format!("{winner} gets the role; its bid is not in the record") };
    let rivals: Vec<&RobotExplanation> = robots
        .iter()
        .filter(|robot| matches!(robot.outcome, RobotOutcome::Outbid | RobotOutcome::WonOtherRole))
        .collect();
    let faster: Vec<&&RobotExplanation> =
        rivals.iter().filter(|robot| robot.behind_s.is_some_and(|behind| behind < 0.0)).collect();
    let bid = format!("{winner} gets the role with {}", won.text());
    if let Some(rival) = faster.first() {
        return match rival.outcome {
            RobotOutcome::WonOtherRole => {
                let role =
                    record.chosen.iter().find(|(_, robot)| **robot == rival.robot).map(|(role, _)| role.as_str());
                format!(
                    "{bid}: {} would be faster, but gets {}, which minimises the total time of all roles",
                    rival.robot,
                    role.unwrap_or("another role")
                )
            }
            _ => {
                format!("{bid}, although {} would be faster: the allocator of this fleet chose otherwise", rival.robot)
            }
        };
    }
    match rivals.first().map(|rival| (rival, rival.behind_s.unwrap_or(0.0))) {
        None => format!("{bid}: there is no other viable bid"),
        Some((rival, behind)) if behind < 0.05 => {
            format!("{bid}: as fast as {}, of {}", rival.robot, count(rivals.len() + 1, "bid", "bids"))
        }
        Some((rival, behind)) => {
            format!(
                "{bid}: the fastest of {}, {behind:.1} s before {}",
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
    won: Option<ChosenBid<'_>>,
) -> RobotExplanation {
    let robot = &entry.robot;
    let elsewhere = record.chosen.iter().find(|(other, chosen)| *other != role && *chosen == robot);
    let (outcome, bid, why) = match &entry.verdict {
        BidVerdict::Viable { time, energy, remaining } => {
            let bid = BidCost::of(*time, *energy, *remaining);
            let words = format!("{robot} bid {}", bid.text());
            let (outcome, why) = match (winner, elsewhere, won) {
                (Some(winner), ..) if winner == robot => (RobotOutcome::Won, format!("{words}, and gets the role")),
                (_, Some((other, _)), _) => {
                    (RobotOutcome::WonOtherRole, format!("{words}; it gets {other} of this mission instead"))
                }
                (Some(winner), None, Some(won)) => {
                    let behind = bid.time_s - won.price.time_s;
                    let more = if behind < 0.0 { "less" } else { "more" };
                    let most = if behind < 0.0 { None } else { most_behind(&entry.parts, won.parts) };
                    let most = most.map(|(step, more)| format!(", mostly in {} ({more:.1} s more)", step_text(step)));
                    let most = most.unwrap_or_default();
                    (RobotOutcome::Outbid, format!("{words}: outbid, {:.1} s {more} than {winner}{most}", behind.abs()))
                }
                (Some(winner), None, None) => (RobotOutcome::Outbid, format!("{words}: {winner} was chosen")),
                (None, ..) => (RobotOutcome::RoleUnfilled, format!("{words}, but the role is not assigned")),
            };
            (outcome, Some(bid), why)
        }
        BidVerdict::Unviable { time, energy, remaining, why } => {
            let bid = BidCost::of(*time, *energy, *remaining);
            (RobotOutcome::Unviable, Some(bid), format!("{robot} bid {}: outside the limits, {why}", bid.text()))
        }
        BidVerdict::Refused { reason } => {
            let (outcome, why) = explain_refusal(robot, reason);
            (outcome, None, why)
        }
    };
    let behind_s = bid.zip(won).map(|(bid, won)| bid.time_s - won.price.time_s);
    RobotExplanation { robot: robot.clone(), outcome, why, bid, parts: entry.parts.clone(), behind_s }
}

/// Returns the step with the largest additional time compared to another bid of the same plan, and
/// that time in seconds.
fn most_behind<'a>(parts: &'a [BidPart], won: &[BidPart]) -> Option<(&'a BidPart, f64)> {
    let behind = |part: &'a BidPart| {
        let same = won.iter().find(|other| other.step == part.step)?;
        Some((part, part.time.get() - same.time.get()))
    };
    let most = parts.iter().filter_map(behind).max_by(|one, other| one.1.total_cmp(&other.1))?;
    (most.1 >= 0.05).then_some(most)
}

fn explain_refusal(robot: &RobotId, reason: &RefusalReason) -> (RobotOutcome, String) {
    match reason {
        RefusalReason::NotMember { ensemble, why } => {
            (RobotOutcome::NotMember, format!("{robot} is not a member of {ensemble}: {why}"))
        }
        RefusalReason::Silent { window_ms } => {
            (RobotOutcome::Silent, format!("{robot} was invited and did not reply within {window_ms} ms"))
        }
        RefusalReason::MissingSkills { .. } => (RobotOutcome::Refused, format!("{robot} {reason}")),
        RefusalReason::CarriesItem { .. } | RefusalReason::Excluded { .. } => {
            (RobotOutcome::Refused, format!("{robot} {reason}"))
        }
        RefusalReason::NotFeasible { .. } => (RobotOutcome::Refused, format!("{robot} {reason}")),
        RefusalReason::Busy { .. } | RefusalReason::OutOfService { .. } => {
            (RobotOutcome::Refused, format!("{robot} is {reason}"))
        }
    }
}

fn viable_cost(verdict: &BidVerdict) -> Option<BidCost> {
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

    /// A bid with these steps: a drive of `seconds`, which uses 0.001 of the charge per second, a
    /// wait, and 60 s with the nurse.
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

    fn refusal(role: &str, robot: &str, reason: RefusalReason) -> AuctionEntry {
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
    fn the_fastest_wins_and_every_other_robot_has_a_reason() {
        let unviable = BidVerdict::Unviable {
            time: Seconds::new(90.0).unwrap(),
            energy: 0.107,
            remaining: 0.023,
            why: ViabilityError::LowCharge { remaining: 0.023, floor: BatteryShare::new(0.08).unwrap() },
        };
        let entries = vec![
            refusal("r1", "amber", RefusalReason::NotMember { ensemble: slug("logistics"), why: "too far".to_owned() }),
            bid("r1", "birch", 99.7),
            bid("r1", "cedar", 176.9),
            refusal("r1", "dune", RefusalReason::MissingSkills { skills: vec![slug("navigation")] }),
            AuctionEntry { role: slug("r1"), robot: slug("ember"), verdict: unviable, parts: vec![] },
            bid("r1", "flint", 160.3),
            refusal("r1", "gorse", RefusalReason::Busy { mission: slug("m-2"), role: slug("r1") }),
            refusal("r1", "hazel", RefusalReason::Silent { window_ms: 200 }),
        ];
        let explained = explain(&record(entries, &[("r1", "birch")], None));
        assert_eq!(
            words(&explained),
            [
                "r1: birch gets the role with 99.7 s, 6.0 % of its charge, 84.0 % left: the fastest of 3 bids, 60.6 s before \
                 flint",
                "  birch bid 99.7 s, 6.0 % of its charge, 84.0 % left, and gets the role",
                "  flint bid 160.3 s, 6.0 % of its charge, 84.0 % left: outbid, 60.6 s more than birch",
                "  cedar bid 176.9 s, 6.0 % of its charge, 84.0 % left: outbid, 77.2 s more than birch",
                "  dune lacks navigation",
                "  gorse is busy as r1 of m-2",
                "  amber is not a member of logistics: too far",
                "  hazel was invited and did not reply within 200 ms",
                "  ember bid 90.0 s, 10.7 % of its charge, 2.3 % left: outside the limits, 2.3 % charge left is not above \
                 8.0 %",
            ]
        );
        let outcomes: Vec<RobotOutcome> = explained.roles[0].robots.iter().map(|robot| robot.outcome).collect();
        use RobotOutcome::{NotMember, Outbid, Refused, Silent, Won};
        assert_eq!(outcomes, [Won, Outbid, Outbid, Refused, Refused, NotMember, Silent, RobotOutcome::Unviable]);
    }

    #[test]
    fn an_explanation_lists_steps_and_the_largest_difference() {
        let entries = vec![drives("birch", 37.04), drives("flint", 92.1), bid("r1", "cedar", 103.0)];
        let explained = explain(&record(entries, &[("r1", "birch")], None));
        let [birch, cedar, flint] = &explained.roles[0].robots[..] else { panic!("three robots") };
        let steps = "navto_room 37.0 s 3.7 %, wait for nurse 2.0 s 0.2 %, signal to nurse 2.0 s 0.2 %, authenticate_nurse \
                     60.0 s 6.0 %";
        assert_eq!(birch.parts_text().as_deref(), Some(steps));
        assert!(cedar.why.ends_with(": outbid, 2.0 s more than birch"), "{}", cedar.why);
        assert_eq!(cedar.parts_text(), None);
        let most = ": outbid, 55.1 s more than birch, mostly in navto_room (55.1 s more)";
        assert!(flint.why.ends_with(most), "{}", flint.why);
        let seen = serde_json::to_value(birch).unwrap();
        assert_eq!(seen["parts"][0]["skill"], "navigation", "{seen}");
        let seen = serde_json::to_value(explained.without_parts()).unwrap();
        assert_eq!(seen["roles"][0]["robots"][0].get("parts"), None, "{seen}");
    }

    #[test]
    fn a_faster_robot_with_another_role_is_named() {
        let entries = vec![bid("a", "ada", 10.0), bid("a", "bob", 12.0), bid("b", "ada", 11.0), bid("b", "bob", 30.0)];
        let explained = explain(&record(entries, &[("a", "bob"), ("b", "ada")], None));
        assert_eq!(
            words(&explained),
            [
                "a: bob gets the role with 12.0 s, 6.0 % of its charge, 84.0 % left: ada would be faster, but gets b, which \
                 minimises the total time of all roles",
                "  bob bid 12.0 s, 6.0 % of its charge, 84.0 % left, and gets the role",
                "  ada bid 10.0 s, 6.0 % of its charge, 84.0 % left; it gets b of this mission instead",
                "b: ada gets the role with 11.0 s, 6.0 % of its charge, 84.0 % left: the fastest of 2 bids, 19.0 s before bob",
                "  ada bid 11.0 s, 6.0 % of its charge, 84.0 % left, and gets the role",
                "  bob bid 30.0 s, 6.0 % of its charge, 84.0 % left; it gets a of this mission instead",
            ]
        );
    }

    #[test]
    fn an_auction_without_assignment_states_the_missing_bid() {
        let entries = vec![
            bid("a", "ada", 10.0),
            refusal("b", "ada", RefusalReason::OutOfService { problem: "no charge".to_owned() }),
        ];
        let explained = explain(&record(entries, &[], Some("no viable bid for b")));
        assert_eq!(
            words(&explained),
            [
                "a: a is not assigned: no viable bid for b; 1 bid is within the limits, but a mission is filled completely or not at all",
                "  ada bid 10.0 s, 6.0 % of its charge, 84.0 % left, but the role is not assigned",
                "b: b is not assigned: no viable bid for b; 1 robot was considered",
                "  ada is out of service: no charge",
            ]
        );
    }
}
