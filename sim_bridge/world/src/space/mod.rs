//! Spatial queries: bodies and walls in grids, and rays between them.
//!
//! Both indexes are uniform grids. Bodies that have moved are placed anew, and all are sorted again
//! when one has strayed far. Each query examines only the cells that it touches, so the total work
//! grows with the number of bodies and not with its square.

mod body_grid;
mod rays;
mod sensor;
mod wall_grid;

pub(crate) use body_grid::{BodyGrid, Disc, NearBody};
pub(crate) use rays::Ray;
pub use sensor::Sensor;
pub use wall_grid::WallGrid;
