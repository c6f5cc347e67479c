//! Consort and ROS 2, over Zenoh in the format of `rmw_zenoh`.
//!
//! Two directions for `NavigateToPose`: [`serve`](serve::serve) offers simulated robots to ROS 2 as `NavigateToPose`
//! action servers, and [`drive`](drive::drive) lets a robot of the fleet drive through such a
//! server, for example a real Nav2.
//!
//! A third way needs no map: [`described`] drives a robot that a file describes, as a driver that its
//! node starts. Messages of any type are those of [`dynamic`]; [`doctor`] compares the graph with such
//! a file.
//!
//! All decisions are made by state machines without network access: [`goals`] (the rules of an
//! action server), [`serve::goal_executor`] (the goals of a robot), [`route_planner`] (from poses
//! to lanes), [`mapping`] (poses, times, errors, names). Keys, liveliness tokens, attachments and
//! CDR are those of [`hiroz`]; the tests compare them with the published formats.

pub mod action_client;
pub mod action_server;
pub mod described;
pub mod doctor;
pub mod drive;
pub mod dynamic;
pub mod goals;
pub mod mapping;
pub mod messages;
pub mod ros;
pub mod route_planner;
pub mod serve;
