//! Names of the nodes of the fleet, and the rooms in which it works.

/// The voters of the ledger.
pub(in super::super) const STATIONS: [&str; 3] = ["s1", "s2", "s3"];

/// The robots that drive.
pub(super) const CARRIERS: [&str; 2] = ["ada", "bob"];

/// The robots.
pub(super) const ROBOTS: [&str; 3] = [CARRIERS[0], CARRIERS[1], "lab-arm"];

/// Host of the simulated world. No fault kills it: the state of its world is only in its memory.
pub(in super::super) const WORLD: &str = "world";

/// Rooms with a nurse and samples.
pub(in super::super) const ROOMS: [&str; 6] =
    ["IC Room 6", "PC Room 1", "IC Room 2", "PC Room 5", "IC Room 4", "PC Room 2"];
