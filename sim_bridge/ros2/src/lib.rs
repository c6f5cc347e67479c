//! Consort and ROS 2, over Zenoh in the format of `rmw_zenoh`.
//!
//! Two directions: [`serve`](serve::serve) offers simulated robots to ROS 2 as `NavigateToPose`
//! action servers, and [`drive`](drive::drive) lets a robot of the fleet drive through such a
//! server, for example a real Nav2.
//!
//! All decisions are made by state machines without network access: [`goals`] (the rules of an
//! action server), [`serve::goal_executor`] (the goals of a robot), [`route_planner`] (from poses
//! to lanes), [`mapping`] (poses, times, errors, names). Keys, liveliness tokens, attachments and
//! CDR are those of [`hiroz`]; the tests compare them with the published formats.

pub mod action_client;
pub mod action_server;
pub mod drive;
pub mod goals;
pub mod mapping;
pub mod messages;
pub mod ros;
pub mod route_planner;
pub mod serve;
