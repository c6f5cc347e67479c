//! Position and heading of a robot on the map.

use crate::units::Metres;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Position on the plane of the map and heading: `x` and `y` in metres, `yaw` in radians,
/// counter-clockwise from +x.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct Pose {
    /// East of the map's origin, in metres.
    #[serde(rename = "x_m")]
    pub x: f64,
    /// North of the map's origin, in metres.
    #[serde(rename = "y_m")]
    pub y: f64,
    /// Heading in radians.
    #[serde(rename = "yaw_rad", default)]
    pub yaw: f64,
}

impl Pose {
    /// Creates a pose at `x`, `y` (metres) with heading `yaw` (radians).
    pub const fn new(x: f64, y: f64, yaw: f64) -> Pose {
        Pose { x, y, yaw }
    }

    /// Returns the straight-line distance; headings are ignored.
    pub fn distance(self, other: Pose) -> Metres {
        Metres::new((self.x - other.x).hypot(self.y - other.y)).unwrap_or(Metres::ZERO)
    }
}
