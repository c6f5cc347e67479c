//! The robot-actions interface: skills use it to drive a robot, and backends implement its other
//! side.
//!
//! The vocabulary is Nav2's: a *goal* is sent, reports *feedback* while it is executed, and ends
//! with a *result*: succeeded, canceled or aborted with an error code. The backend is a simulated
//! world (in this process or another) or a real robot's adapter. Skills cannot distinguish them.
//!
//! ```text
//!  skill (behavior tree) ── RobotActions ──▶ goals   ┌────────────────┐
//!                        ◀── status, telemetry ──────│  RobotBackend  │  a world, or an adapter
//! ```

mod backend;
mod error;
mod goal;
mod nav2;
mod place_tracker;
mod robot;

pub use backend::{BackendEvent, PersonRequest, PersonResult, RobotBackend};
pub use error::{ActionError, ErrorCode};
pub use goal::{ActionParameters, Feedback, Goal, GoalId, GoalProgress, GoalResult, GoalStatus, JsonObject};
pub use nav2::{Dock, FollowWaypoints, NavigateToPose, Spin, Undock, Wait, Waypoint};
pub use place_tracker::PlaceTracker;
pub use robot::{READINGS_MAX, RobotActions, Telemetry};
