//! `consort reassign`: gives a role to another robot, or pins it to a robot.

use super::change_flags::ChangeFlags;
use crate::exit::Failure;
use consort_protocol::api::{ReassignReply, ReassignRequest};
use consort_protocol::ids::{MissionId, RobotId, RoleId};
use consort_protocol::keys::ApiCall;

/// Give a role to another robot, or pin it to a robot
///
/// The robot of the role returns it once its body is at rest, and the role is auctioned again without that robot, or for
/// the named robot only. The other robot starts the role from its beginning. So the role stays with its robot if that
/// has an item in it, if other roles have acted on its work, or, without --repeat, if a task of it has ended.
/// With --pin a role that waits gets no other robot, from now on.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort reassign lab-samples-1 r1
  consort reassign lab-samples-1 r1 --to birch --by Nia
  consort reassign lab-samples-1 r1 --repeat
  consort reassign lab-samples-2 r1 --pin amber
  consort reassign lab-samples-2 r1 --unpin")]
pub(crate) struct Args {
    /// The mission, as named by `consort missions`
    mission: MissionId,
    /// The role, as named by `consort missions`
    role: RoleId,
    /// The robot that gets the role. Default: any but the present one
    #[arg(long, value_name = "ROBOT", conflicts_with_all = ["pin", "unpin"])]
    to: Option<RobotId>,
    /// For a role that waits: no other robot gets it, also after a loss of this robot
    #[arg(long, value_name = "ROBOT", conflicts_with = "unpin")]
    pin: Option<RobotId>,
    /// End the order about the role: any robot may get it
    #[arg(long)]
    unpin: bool,
    /// The other robot may repeat tasks of the role that have ended
    #[arg(long, conflicts_with_all = ["pin", "unpin"])]
    repeat: bool,
    #[command(flatten)]
    change: ChangeFlags,
}

/// Runs the command.
///
/// # Errors
/// See [`Client::api`](crate::client::Client::api); [`Failure::Unsuccessful`] with the reason if the role stays with its
/// robot.
pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let Args { mission, role, to, pin, unpin, repeat, change } = args;
    let request = |by, request| ReassignRequest { mission, role, to, pin, unpin, repeat, by, request };
    change.send(ApiCall::Reassign, request, reply_text)
}

/// Formats the state of the role: `r1 of rounds-1 is pinned to amber`.
fn reply_text(ReassignReply { mission, role, robot, order, .. }: &ReassignReply) -> String {
    match (order, robot) {
        (Some(order), _) => format!("{role} of {mission} is {order}"),
        (None, Some(robot)) => format!("{role} of {mission} belongs to {robot}"),
        (None, None) => format!("any robot may get {role} of {mission}"),
    }
}
