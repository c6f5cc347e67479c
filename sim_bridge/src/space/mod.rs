//! Where things are, for whoever asks what is near: bodies and walls in grids, rays between them.
//!
//! Both indexes are uniform grids; that of bodies is laid out anew whenever they have moved. Each question looks only at
//! the cells that it touches, so that the work for all bodies together grows with their number and not with its square.

mod body_grid;
mod rays;
mod sensor;
mod wall_grid;

pub use body_grid::{BodyGrid, Disc};
pub use rays::{Ray, Segment};
pub use sensor::Sensor;
pub use wall_grid::WallGrid;
