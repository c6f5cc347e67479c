//! Maps drawn with diagrams.net (draw.io, mxGraph), by the conventions of HMR Sim.
//!
//! The file is `<mxfile>` with pages, plain or compressed, or a bare `<mxGraphModel>`. Each page is
//! a level. A page without walls and without typed cells is ignored. A unit of the drawing is
//! [`METRES_PER_UNIT`] by default. The attribute `metres_per_unit` of a page (*Edit Data* with
//! nothing selected) sets another scale, and [`ImportOptions::scale_m`] overrides both. The lower
//! left corner of the page is (0, 0); y points north.
//!
//! The data of a cell (*Edit Data*) gives its meaning, first of all `type`. "Ours" marks additions
//! of this project:
//!
//! | `type`     | meaning               | attributes |
//! |------------|-----------------------|------------|
//! | `POI`      | a place, its centre   | `tag`: its name; ours: `kind` (room, lab, corridor, dock, charger, other), `yaw_deg` (counter-clockwise from east) |
//! | `map-path` | lanes, a line         | ours: `one_way` (`true`), `speed_limit_mps` |
//! | `robot`    | a robot               | `name`, `robot_type`, `component_X`: JSON, a component of the robot |
//! | `path`     | a path of a robot     | starts at the robot: its `source` |
//! | `pickable` | an object             | `name`, `weight` in kg |
//! | `person`   | a person (ours)       | `name`, `role` |
//! | `door`     | a door (ours), its longer centre line | `tag`, `opening_s` |
//! | `lift`     | a stop of a lift (ours) | `tag`: the lift, a cell on each of its pages; `capacity`, `opening_s`, `speed_mps` |
//!
//! Cells of other types are kept unchanged ([`Drawing::others`]). Walls are shapes without a type:
//! `mxgraph.floorplan.wall`, `room`, `wallU` (left, top, right) and `wallCorner` (left, top), and
//! plain unlabelled bars up to 15 units thick; the centre line of the shape is the wall.
//! `direction` turns a shape by quarter turns, `flipH` and `flipV` flip it, and `rotation` turns it
//! clockwise about its centre.
//!
//! Points of paths in the same cell of a grid of [`GRID`] units are merged and moved to the centre
//! of the grid cell. A place in that grid cell replaces the point. A `source` or `target` stands
//! for the centre of that cell of the drawing. A path that passes a point runs through it. A place
//! without a path is connected to the nearest point of a path within [`REACH`] units, if no wall is
//! between them.
//!
//! [`ImportOptions::scale_m`]: crate::ImportOptions::scale_m
//! [`Drawing::others`]: crate::Drawing::others

mod conventions;
mod diagnostic;
mod network;
mod page;
mod reader;
mod shape;
#[cfg(test)]
mod tests;
mod xml;

pub(crate) use diagnostic::DrawioDiagnostic;
pub(crate) use reader::read;
