//! Scales and distances in drawings.

/// Default metres per unit of a drawing: a robot of 30 units is then 0.6 m wide, and a wall of 10
/// units 0.2 m thick.
pub(crate) const METRES_PER_UNIT: f64 = 0.02;
/// Size of the grid cells for points of paths, in units.
pub(crate) const GRID: f64 = 20.0;
/// Greatest distance, in units, at which a place without a path is connected to a path.
pub(crate) const REACH: f64 = 100.0;
