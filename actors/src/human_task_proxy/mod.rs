//! The attendant: speaks for those who play unmanaged roles, since they take no orders from the fleet.
//!
//! It follows the missions under way, runs each unmanaged role's local plan as far as the others' signals allow, asks the
//! host of people to do the tasks in it, and tells the others when they have been done. One attendant in a fleet is
//! enough, two do no harm: asks and signals have names of their own and repeating them changes nothing.
//!
//! It remembers nothing beyond its life. What it had asked is asked again by the next one, under the same id, if it is still
//! wanted; else nobody repeats it, and the host of people withdraws it.

mod actor;
mod requests;
mod roles;

pub use actor::{HumanTaskProxy, HumanTaskProxyMessage, HumanTaskProxySettings, HumanTaskProxyState};
