//! Where a body is on the floor.

use crate::units::Metres;
use serde::{Deserialize, Serialize};

/// A place on the plane of the map and a heading: `x` and `y` in metres, `yaw` in radians counter-clockwise from +x.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Pose {
    /// Metres to the east of the map's origin.
    #[serde(rename = "x_m")]
    pub x: f64,
    /// Metres to the north of the map's origin.
    #[serde(rename = "y_m")]
    pub y: f64,
    /// Heading in radians.
    #[serde(rename = "yaw_rad", default)]
    pub yaw: f64,
}

impl Pose {
    /// A pose at `x`, `y` (metres) with heading `yaw` (radians).
    pub const fn new(x: f64, y: f64, yaw: f64) -> Pose {
        Pose { x, y, yaw }
    }

    /// Straight-line distance, headings aside.
    pub fn distance(self, other: Pose) -> Metres {
        Metres::new((self.x - other.x).hypot(self.y - other.y)).unwrap_or(Metres::ZERO)
    }
}
