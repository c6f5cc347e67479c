//! Buildings of Open-RMF: the `.building.yaml` files of its traffic editor.
//!
//! The reader uses these parts of the file:
//!
//! - **coordinates.** `reference_image` (default): pixels with y down, which are flipped. The scale
//!   is the mean of distance divided by length over the `measurements` of the reference level, or
//!   [`ImportOptions::scale_m`]. Other levels are aligned with the reference level by their common
//!   `fiducials`. `cartesian_meters`: metres, unchanged. `wgs84`: longitude and latitude, converted
//!   to metres around the vertex named by the parameter `generate_origin_vertex`, else around the
//!   least longitude and latitude.
//! - **graphs.** Lanes have a `graph_idx`: robots of the same kind drive on the same graph. All graphs
//!   are read, or only [`ImportOptions::graph`]. If there are several, each lane names its graphs, and
//!   the file of a robot names the graph of the robot. The vertices at lanes become places; other
//!   vertices do not.
//! - **places.** A vertex without a name becomes `L1 vertex 7`. A name that occurs on several
//!   levels is followed by its level, as in `lobby (L2)`. A vertex with `is_charger` is a charger;
//!   a vertex with `is_parking_spot` or `dock_name` is a dock. The place keeps the `dock_name`.
//! - **lanes.** `bidirectional`, `speed_limit` (if above 0) and `orientation` (`forward`,
//!   `backward`).
//! - **doors** are placed on the lanes that cross them. A door without such a lane is only drawn. The
//!   format has no opening time.
//! - **lifts** stop at the places in their cabin, on each level with doors (`level_doors`) between
//!   their lowest and highest floor, and at the places with their name in `lift_cabin`.
//! - **robots** stand at vertices with `spawn_robot_name` ([`Drawing::robots`]). A robot whose vertex
//!   has lanes of a single graph has the attribute `graph`.
//!
//! Models, floors, lights and crowds are ignored.
//!
//! [`ImportOptions::scale_m`]: crate::ImportOptions::scale_m
//! [`ImportOptions::graph`]: crate::ImportOptions::graph
//! [`Drawing::robots`]: crate::Drawing::robots

mod coordinates;
mod diagnostic;
mod level;
mod lifts;
mod raw;
mod reader;
#[cfg(test)]
mod tests;

pub(crate) use diagnostic::RmfDiagnostic;
pub(crate) use reader::read;
