//! The map of a building: places, the lanes between them, doors, lifts, levels and walls.
//!
//! A map file is YAML, or JSON if its name ends in `.json`. Unknown fields are rejected.
//!
//! ```yaml
//! name: ward                    # 1 to 64 characters of A-Z a-z 0-9 _ . -
//! levels:                       # optional; default: a single level called ground
//!   - { name: ground }          # elevation_m defaults to 0
//!   - { name: first, elevation_m: 4.0, walls: [[[0, 0], [12, 0]]] }
//! walls:                        # optional, of the first level: open polylines of [x, y] in metres
//!   - [[0, 0], [12, 0], [12, 6]]
//! places:                       # x east, y north, in metres; yaw counter-clockwise from east; default level: the first
//!   - { name: Ward Corridor, kind: corridor, x_m: 2.0, y_m: 3.0 }
//!   - { name: Room 1, kind: room, x_m: 2.0, y_m: 5.0, yaw_rad: 1.57 }
//!   - { name: Hall, kind: corridor, x_m: 2.0, y_m: 3.0, level: first }
//! lanes:                        # where robots may drive; default: two-way, as long as the straight line
//!   - { between: [Ward Corridor, Room 1] }
//!   # - { between: [A, B], length_m: 3.5, one_way: true }            (only from A to B)
//!   # - { between: [A, B], speed_limit_mps: 0.5, facing: backward }  (facing: while driving from A to B)
//! doors:                        # optional: automatic doors, with the lanes through them
//!   - { name: Door 1, on: [[Ward Corridor, Room 1]], opening_s: 3.0 }
//!   # span: [[x, y], [x, y]] gives the two posts; without it the door stands in the middle of its lane
//!   # - { name: Window, on: [], level: first, span: [[0, 0], [1, 0]] }   (without lanes: only drawn)
//! lifts:                        # optional: a robot that enters at a stop may leave at any other stop
//!   - { name: Lift A, stops: [Ward Corridor, Hall], capacity: 1, opening_s: 3.0, speed_mps: 1.0 }
//! ```
//!
//! The kinds of place are `room`, `lab`, `corridor`, `dock`, `charger` and `other`. The opening
//! times, the capacity and the speed in the example are the defaults. Reading a file reports *all*
//! its errors, each with the file and the position; an existing [`Map`] is valid: every place can
//! be reached from every other place, by lanes and lifts. Lanes may name navigation graphs
//! (`graphs: ["0", "1"]`); robots whose files name a graph drive on its lanes only. Then the places
//! of each graph can be reached from each other.
//!
//! The crate `consort-map-import` reads foreign formats as well. [`render`] draws a map.

mod building;
mod check;
mod dead_ends;
mod diagnostic;
mod file;
mod map_view;
mod model;
mod read;
pub mod render;
#[cfg(test)]
mod tests;
mod topology;

pub use building::intersection;
pub use dead_ends::DeadEnd;
pub use diagnostic::{BuildingDiagnostic, Disconnection, LaneName, MapDiagnostic};
pub use file::{DoorEntry, LaneEntry, LevelEntry, LiftEntry, MapFile, PlaceEntry, limits};
pub(crate) use model::PlaceIndex;
pub use model::{DEFAULT_LEVEL, Door, Facing, Lane, LevelIndex, Lift, Map, MapLevel, MapPlace, PlaceKind};
pub use read::{MapError, SHIPPED, read, shipped, shipped_file};
