//! Shared parts of commands that give orders to robots.

use crate::exit::Failure;
use consort_protocol::api::{AllRobots, OrdersReply, RobotSelection, RobotZone, SelectionCondition};
use consort_protocol::ensemble::Eligibility;
use consort_protocol::ids::{RobotId, ZoneId};

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
    /// All robots that are in a zone of the fleet file now. Robots that enter it later are not meant
    #[arg(long, value_name = "ZONE")]
    zone: Option<ZoneId>,
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
        let RobotFlags { robots, condition, zone, .. } = self;
        match (condition, zone) {
            (Some(condition), _) => match Eligibility::compile(&condition) {
                Ok(_) => Ok(RobotSelection::Where(SelectionCondition { condition })),
                Err(problem) => Err(Failure::Usage(format!("--where: {problem}"))),
            },
            (None, Some(zone)) => Ok(RobotSelection::Zone(RobotZone { zone })),
            (None, None) if robots.is_empty() => Ok(RobotSelection::All(AllRobots::All)),
            (None, None) => Ok(RobotSelection::Named(robots.into_iter().collect())),
        }
    }
}

/// Formats the orders of robots, a line for each.
pub(super) fn orders_text(OrdersReply { robots }: &OrdersReply) -> String {
    robots.iter().map(|(robot, orders)| format!("{robot} is {}", orders.state_text())).collect::<Vec<_>>().join("\n")
}
