//! Consort and ROS 2, over Zenoh as `rmw_zenoh` speaks it.
//!
//! Two directions: [`serve`](serve::serve) offers simulated robots to ROS 2 as `NavigateToPose` action servers, and
//! [`drive`](drive::drive) lets a robot of the fleet act through such a server, a real Nav2 for instance.
//!
//! What decides is in values that know no network: [`goals`] (the rules of an action server), [`serve::pursuit`] (one robot's
//! goals), [`itinerary`] (from poses to lanes), [`mapping`] (poses, times, errors, names). Keys, liveliness tokens, attachments
//! and CDR are those of [`hiroz`]; the tests hold them to the published formats.

pub mod action_client;
pub mod action_server;
pub mod drive;
pub mod goals;
pub mod itinerary;
pub mod mapping;
pub mod messages;
pub mod ros;
pub mod serve;
