//! Restriction of a role to robots, by the order of a person.

use super::bid::{BidRefusal, BidResponse, RefusalReason, RoleReply};
use crate::ids::{RobotId, RoleId};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;

/// Robots that may get a role.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum RobotRestriction {
    /// Only this robot, in each award.
    Pinned(RobotId),
    /// Only this robot, in the next award.
    Next(RobotId),
    /// Each robot but this, in the next award.
    Except(RobotId),
}

impl RobotRestriction {
    /// Checks whether a robot may get the role.
    pub fn permits(&self, robot: &RobotId) -> bool {
        match self {
            RobotRestriction::Pinned(only) | RobotRestriction::Next(only) => only == robot,
            RobotRestriction::Except(excluded) => excluded != robot,
        }
    }

    /// Checks whether it permits a single robot.
    pub fn permits_only_one(&self) -> bool {
        matches!(self, RobotRestriction::Pinned(_) | RobotRestriction::Next(_))
    }

    /// Checks whether the restriction stays after an award.
    pub fn outlasts_awards(&self) -> bool {
        matches!(self, RobotRestriction::Pinned(_))
    }
}

impl fmt::Display for RobotRestriction {
    /// Writes the restriction as the state of a role: `pinned to amber`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            RobotRestriction::Pinned(robot) => write!(f, "pinned to {robot}"),
            RobotRestriction::Next(robot) => write!(f, "reassigned to {robot}"),
            RobotRestriction::Except(robot) => write!(f, "reassigned from {robot}"),
        }
    }
}

/// Returns the responses with a refusal in place of each reply of a robot that the restriction of the role excludes.
pub fn restrict_replies<'a>(
    responses: &'a [BidResponse],
    restrictions: &BTreeMap<RoleId, RobotRestriction>,
) -> Cow<'a, [BidResponse]> {
    if restrictions.is_empty() {
        return Cow::Borrowed(responses);
    }
    let restrict = |reply: &RoleReply| {
        let (role, robot) = match reply {
            RoleReply::Bid(bid) => (&bid.role, &bid.robot),
            RoleReply::Refusal(refusal) => (&refusal.role, &refusal.robot),
        };
        match restrictions.get(role) {
            Some(restriction) if !restriction.permits(robot) => {
                let reason = RefusalReason::NotEligible { why: format!("{role} is {restriction}"), permanent: false };
                RoleReply::Refusal(BidRefusal { robot: robot.clone(), role: role.clone(), reason })
            }
            Some(_) | None => reply.clone(),
        }
    };
    let response = |response: &BidResponse| BidResponse {
        robot: response.robot.clone(),
        auction: response.auction.clone(),
        replies: response.replies.iter().map(restrict).collect(),
    };
    Cow::Owned(responses.iter().map(response).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::auction::AuctionId;

    #[test]
    fn only_permitted_robots_reply_for_a_restricted_role() {
        let robot = |name: &str| -> RobotId { name.parse().unwrap() };
        let role = |name: &str| -> RoleId { name.parse().unwrap() };
        let auction = AuctionId { mission: "rounds-1".parse().unwrap(), term: 1, round: 1 };
        let busy = RefusalReason::Silent { window_ms: 7 };
        let response = |name: &str| {
            let reply = |role| RoleReply::Refusal(BidRefusal { robot: robot(name), role, reason: busy.clone() });
            let replies = ["r1", "r2"].map(|name| reply(role(name))).to_vec();
            BidResponse { robot: robot(name), auction: auction.clone(), replies }
        };
        let responses = ["amber", "birch"].map(response);
        let excluded = |restriction: RobotRestriction| {
            let restrictions = BTreeMap::from([(role("r1"), restriction)]);
            let restricted = restrict_replies(&responses, &restrictions).into_owned();
            let replies = restricted.into_iter().flat_map(|response| response.replies);
            let texts = replies.filter_map(|reply| match reply {
                RoleReply::Refusal(BidRefusal { robot, role, reason }) if reason != busy => {
                    Some(format!("{robot} as {role}: {reason}"))
                }
                RoleReply::Refusal(_) | RoleReply::Bid(_) => None,
            });
            texts.collect::<Vec<_>>()
        };
        assert_eq!(
            excluded(RobotRestriction::Pinned(robot("amber"))),
            ["birch as r1: not eligible: r1 is pinned to amber"]
        );
        assert_eq!(excluded(RobotRestriction::Next(robot("cyd"))).len(), 2);
        let former = "amber as r1: not eligible: r1 is reassigned from amber";
        assert_eq!(excluded(RobotRestriction::Except(robot("amber"))), [former]);
    }
}
