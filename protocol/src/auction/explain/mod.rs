//! Explanation of an auction in text: the reason for which each robot got or did not get each role.
//! Computed from the record of the auction alone, which also names the robots that were not asked.

use super::bid::{BidPart, RefusalReason};
use super::record::{AuctionEntry, AuctionRecord, BidVerdict, NotAskedReason};
use crate::ids::{RobotId, RoleId};
use crate::units::Seconds;
use consort_text::count;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::cmp::Ordering;
use std::collections::BTreeMap;

/// Explanation of an auction.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
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
    /// The robot is not a member of a called ensemble.
    NotMember,
    /// Members of an ensemble that the mission names earlier take its roles.
    NotPreferred,
    /// The robot did not reply in time.
    Silent,
    /// The robot was not asked: by its record its bid could not have changed the result.
    NotAsked,
}

/// Values of a bid that are compared.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
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
    /// `navto_room 37.0 s 2.2 %, approach_clerk 1.0 s 0.1 %`. `None` if the steps are not in the
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
    let mut robots: Vec<RobotExplanation> = entries
        .iter()
        .flat_map(|entry| entry.robots().map(move |robot| explain_robot(record, robot, entry, won)))
        .collect();
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
        Some(winner) => why_won(record, role, winner, won.map(|won| won.price), &robots),
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

/// Returns a text like ` in about 40 s` for a promised role.
fn later_text(record: &AuctionRecord, role: &RoleId) -> String {
    let Some(start) = record.promised.get(role) else { return String::new() };
    let when = match start.get() {
        start if start < 1.0 => " once it can start".to_owned(),
        start => format!(" in about {start:.0} s"),
    };
    let planned = record.planned.get(role);
    let when = match planned.and_then(|planned| planned.charging.as_ref()) {
        Some(stop) => {
            format!("{when}, after charging at {} until it has {}", stop.charger, stop.until.percent())
        }
        None => when,
    };
    match planned.and_then(|planned| Some((planned.before.as_ref()?, planned.delay.get()))) {
        Some((next, delay_s)) => {
            format!("{when} (before {} of {}, which it delays by {delay_s:.0} s)", next.role, next.mission)
        }
        None => when,
    }
}

fn why_won(
    record: &AuctionRecord,
    role: &RoleId,
    winner: &RobotId,
    won: Option<BidCost>,
    robots: &[RobotExplanation],
) -> String {
    let Some(won) = won else { return format!("{winner} gets the role; its bid is not in the record") };
    let rivals: Vec<&RobotExplanation> = robots
        .iter()
        .filter(|robot| matches!(robot.outcome, RobotOutcome::Outbid | RobotOutcome::WonOtherRole))
        .collect();
    let faster: Vec<&&RobotExplanation> =
        rivals.iter().filter(|robot| robot.behind_s.is_some_and(|behind| behind < 0.0)).collect();
    let bid = format!("{winner} gets the role{} with {}", later_text(record, role), won.text());
    let bids = || {
        let stated = count(rivals.len() + 1, "bid", "bids");
        if record.omitted > 0 { format!("at least {stated}") } else { stated }
    };
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
                format!(
                    "{bid}, although {} would be faster: the objective or the allocator of this fleet chose otherwise",
                    rival.robot
                )
            }
        };
    }
    match rivals.first().map(|rival| (rival, rival.behind_s.unwrap_or(0.0))) {
        None if robots.iter().any(|robot| robot.outcome == RobotOutcome::NotAsked) => {
            format!("{bid}: no other robot that was asked has a viable bid")
        }
        None => format!("{bid}: there is no other viable bid"),
        Some((rival, behind)) if behind < 0.05 => {
            format!("{bid}: as fast as {}, of {}", rival.robot, bids())
        }
        Some((rival, behind)) => {
            format!("{bid}: the fastest of {}, {behind:.1} s before {}", bids(), rival.robot)
        }
    }
}

fn explain_robot(
    record: &AuctionRecord,
    robot: &RobotId,
    entry: &AuctionEntry,
    won: Option<ChosenBid<'_>>,
) -> RobotExplanation {
    let role = &entry.role;
    let winner = record.chosen.get(role);
    let elsewhere = record.chosen.iter().find(|(other, chosen)| *other != role && *chosen == robot);
    let (outcome, bid, why) = match &entry.verdict {
        BidVerdict::Viable { time, energy, remaining } => {
            let bid = BidCost::of(*time, *energy, *remaining);
            let words = format!("{robot} bid {}", bid.text());
            let (outcome, why) = match (winner, elsewhere, won) {
                (Some(winner), ..) if winner == robot => {
                    (RobotOutcome::Won, format!("{words}, and gets the role{}", later_text(record, role)))
                }
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
        BidVerdict::NotAsked { reason, cost_min, .. } => {
            let bound = match reason {
                NotAskedReason::NotNeeded => format!(", since it would cost at least {cost_min:.1} s"),
                _ => String::new(),
            };
            (RobotOutcome::NotAsked, None, format!("{robot} was not asked: {reason}{bound}"))
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
        RefusalReason::NotMember { .. } => (RobotOutcome::NotMember, format!("{robot} is {reason}")),
        RefusalReason::Silent { window_ms } => {
            (RobotOutcome::Silent, format!("{robot} was invited and did not reply within {window_ms} ms"))
        }
        RefusalReason::MissingSkills { .. } => (RobotOutcome::Refused, format!("{robot} {reason}")),
        RefusalReason::CarriesItem { .. }
        | RefusalReason::Excluded { .. }
        | RefusalReason::ChargerOutOfReach { .. } => (RobotOutcome::Refused, format!("{robot} {reason}")),
        RefusalReason::NotFeasible { .. } => (RobotOutcome::Refused, format!("{robot} {reason}")),
        RefusalReason::Busy { .. } | RefusalReason::OutOfService { .. } | RefusalReason::NotEligible { .. } => {
            (RobotOutcome::Refused, format!("{robot} is {reason}"))
        }
        RefusalReason::NotPreferred { .. } => {
            (RobotOutcome::NotPreferred, format!("{robot} could take the role, but {reason}"))
        }
    }
}

fn viable_cost(verdict: &BidVerdict) -> Option<BidCost> {
    match verdict {
        BidVerdict::Viable { time, energy, remaining } => Some(BidCost::of(*time, *energy, *remaining)),
        BidVerdict::Unviable { .. } | BidVerdict::Refused { .. } | BidVerdict::NotAsked { .. } => None,
    }
}

#[cfg(test)]
mod tests;
