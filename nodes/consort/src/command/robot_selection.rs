//! Shared parts of commands that give orders to robots.

use crate::exit::Failure;
use consort_protocol::api::{AllRobots, OrdersReply, RobotCondition, RobotSelection};
use consort_protocol::ensemble::Eligibility;
use consort_protocol::ids::RobotId;

/// Flags for the robots.
#[derive(Debug, clap::Args)]
#[group(required = true, multiple = false)]
pub(super) struct RobotFlags {
    /// The robots, as named by `consort fleet`
    #[arg(value_name = "ROBOT")]
    robots: Vec<RobotId>,
    /// All robots that meet a condition, in CEL as in `eligible` of a mission: 'robot.attributes.section == "icu"'
    #[arg(long = "where", value_name = "CONDITION")]
    condition: Option<String>,
    /// All robots of the fleet
    #[arg(long)]
    all: bool,
}

impl RobotFlags {
    /// Returns the robots.
    ///
    /// # Errors
    /// [`Failure::Usage`] if the condition cannot be compiled.
    pub(super) fn selection(self) -> Result<RobotSelection, Failure> {
        let RobotFlags { robots, condition, .. } = self;
        match condition {
            Some(condition) => match Eligibility::compile(&condition) {
                Ok(_) => Ok(RobotSelection::Where(RobotCondition { condition })),
                Err(problem) => Err(Failure::Usage(format!("--where: {problem}"))),
            },
            None if robots.is_empty() => Ok(RobotSelection::All(AllRobots::All)),
            None => Ok(RobotSelection::Named(robots.into_iter().collect())),
        }
    }
}

/// Formats the orders of robots, a line for each.
pub(super) fn orders_text(OrdersReply { robots }: &OrdersReply) -> String {
    robots.iter().map(|(robot, orders)| format!("{robot} is {}", orders.state_text())).collect::<Vec<_>>().join("\n")
}
