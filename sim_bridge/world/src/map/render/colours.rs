//! Colours of drawings and recordings.

use crate::map::model::PlaceKind;

pub(crate) const WALL: &str = "#37474f";
pub(crate) const LANE: &str = "#90caf9";
pub(crate) const DOOR: &str = "#e65100";
pub(crate) const LIFT: &str = "#8e24aa";
pub(crate) const INK: &str = "#263238";
pub(crate) const ROBOT: &str = "#d81b60";
pub(crate) const ITEM: &str = "#6d4c41";

/// Colours of robots. They are strong, differ from the colours of the map, and differ from each
/// other also for people with red-green colour blindness (after Okabe and Ito 2008, darkened).
const ROBOTS: [&str; 8] = ["#d55e00", "#0072b2", "#b2457e", "#00795c", "#8a6d00", "#5e35b1", "#c2185b", "#37474f"];

/// Returns the colour of the robot with this index among the drawn robots.
pub(crate) fn robot_colour(place: usize) -> &'static str {
    ROBOTS[place % ROBOTS.len()]
}

/// Returns the colour of a place.
pub(crate) fn place_kind_colour(kind: PlaceKind) -> &'static str {
    match kind {
        PlaceKind::Room => "#2e7d32",
        PlaceKind::Lab => "#00838f",
        PlaceKind::Corridor => "#90a4ae",
        PlaceKind::Dock => "#1565c0",
        PlaceKind::Charger => "#f9a825",
        PlaceKind::Other => "#546e7a",
    }
}
