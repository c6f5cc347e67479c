//! Layouts in the Layout Interchange Format (LIF) 1.0 of VDMA and VDA: the JSON files that describe tracks to the control
//! of vehicles of VDA 5050.
//!
//! The reader uses these parts of the file:
//!
//! - **layouts.** Layouts with the same `layoutLevelId` form a level; a layout without one is a level of its own. The format
//!   has no elevations: all are 0.
//! - **nodes** become places with the `nodeName`, if no other node has it, else with the `nodeId`. A node with an action
//!   `startCharging` is a charger; a node of a station is `other`; any other node is a corridor. `theta` is the heading.
//! - **edges** become lanes, two-way if both directions are equal. The types of vehicles of the edge are the navigation
//!   graphs of the lane, if the file has several types. `maxSpeed` is the speed limit, the lowest of all types. A
//!   `vehicleOrientation` of 0 or pi, relative to the edge, is the required heading. A `trajectory` has the length of its
//!   control polygon.
//! - **lifts.** Edges between levels connect the stops of a lift, whose capacity is one vehicle.
//!
//! Restrictions of loads, rotation and height, and actions other than `startCharging`, are ignored, with a note.

mod diagnostic;
mod raw;
mod reader;
#[cfg(test)]
mod tests;

pub(crate) use diagnostic::LifDiagnostic;
pub(crate) use reader::read;
