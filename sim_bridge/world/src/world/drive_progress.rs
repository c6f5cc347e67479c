//! Progress of a drive, and its doors and obstacles.

use super::location::{LanePart, StraightDrive};
use super::sim_state::SimState;
use hecs::Entity;

/// Distance before a door at which a robot waits, and behind a door at which it has passed: room
/// for the door leaf and for robots coming out.
const CLEARANCE_M: f64 = 0.5;

/// Distance at which a robot detects an obstacle, and stops.
pub(crate) const OBSTACLE_DETECTION_M: f64 = 1.0;

/// Lengths that differ by less are equal: a micrometre.
pub(crate) const LENGTH_EPSILON_M: f64 = 1e-6;

/// A drive in progress.
#[derive(Debug, Clone)]
pub(crate) struct DriveProgress {
    /// The whole drive, as if it were free.
    pub(crate) drive: StraightDrive,
    pub(crate) speed_mps: f64,
    /// Distance covered at the start of the current part.
    pub(crate) done_m: f64,
    /// Distance covered at the end of the current part.
    pub(crate) until_m: f64,
    /// Doors to enter and leave, by distance from the start, in order.
    stops: Vec<(f64, DoorStop)>,
    next: usize,
}

/// A door action on the way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum DoorStop {
    /// Wait until the door admits the robot.
    Enter(Entity),
    /// The door has been passed.
    Leave(Entity),
}

impl DriveProgress {
    pub(crate) fn new(drive: StraightDrive, speed_mps: f64, state: &SimState) -> DriveProgress {
        let stops = drive.lane.map_or(vec![], |stretch| stops(state, stretch, drive.length_m()));
        DriveProgress { drive, speed_mps, done_m: 0.0, until_m: 0.0, stops, next: 0 }
    }

    /// Returns the door action at the robot's current position.
    pub(crate) fn current_stop(&self) -> Option<DoorStop> {
        self.stops.get(self.next).filter(|(at, _)| *at <= self.done_m + LENGTH_EPSILON_M).map(|(_, stop)| *stop)
    }

    pub(crate) fn finish_stop(&mut self) {
        self.next += 1;
    }

    /// Distance from the start to the next door action, or to the end.
    pub(crate) fn next_stop_m(&self) -> f64 {
        self.stops.get(self.next).map_or(self.drive.length_m(), |(at, _)| at.min(self.drive.length_m()))
    }

    /// Distance from the start to the next point at which the robot may have to wait, or to the
    /// end.
    pub(crate) fn next_wait_m(&self) -> f64 {
        let ahead = self.stops.iter().skip(self.next);
        let halt = ahead.filter(|(_, stop)| matches!(stop, DoorStop::Enter(_))).map(|(at, _)| *at).next();
        halt.map_or(self.drive.length_m(), |at| at.min(self.drive.length_m()))
    }

    /// If the next action is to leave a door, completes it and returns the door.
    pub(crate) fn leave_door(&mut self) -> Option<Entity> {
        let Some((_, DoorStop::Leave(door))) = self.stops.get(self.next) else { return None };
        self.next += 1;
        Some(*door)
    }

    /// Checks whether a door is on the way.
    pub(crate) fn passes_door(&self, door: Entity) -> bool {
        self.stops.iter().any(|(_, stop)| *stop == DoorStop::Leave(door))
    }

    pub(crate) fn is_complete(&self) -> bool {
        self.done_m >= self.drive.length_m()
    }
}

/// Returns the door actions on a lane part, as distances from the start of the part.
fn stops(state: &SimState, (from, to, first, last): LanePart, length_m: f64) -> Vec<(f64, DoorStop)> {
    let lane_m = state.map.lane_between(from, to).map_or(0.0, |lane| lane.length.get());
    let doors_met = state.map.doors_on(&state.map.place_at(from).id, &state.map.place_at(to).id);
    let doors: Vec<(f64, Entity)> = doors_met
        .iter()
        .filter_map(|doors_met| Some((doors_met.at, state.door_entity(&doors_met.door.name)?)))
        .collect();
    let reach = CLEARANCE_M / lane_m.max(LENGTH_EPSILON_M);
    let mut stops = Vec::new();
    for (index, (at, door)) in doors.iter().enumerate() {
        // Neither beyond the ends of the lane nor beyond half the distance to the next door: a
        // robot is never in two doorways at once.
        let before = index.checked_sub(1).map_or(0.0, |before| (doors[before].0 + at) / 2.0);
        let behind = doors.get(index + 1).map_or(1.0, |behind| (behind.0 + at) / 2.0);
        let (begins, ends) = ((at - reach).max(before), (at + reach).min(behind));
        let onward = last >= first;
        let [enter, leave] = if onward { [begins, ends] } else { [ends, begins] };
        let way_m = |share: f64| if onward { (share - first) * lane_m } else { (first - share) * lane_m };
        let (enter_m, leave_m) = (way_m(enter), way_m(leave).min(length_m));
        if leave_m > LENGTH_EPSILON_M && enter_m < length_m {
            stops.push((enter_m.max(0.0), DoorStop::Enter(*door)));
            stops.push((leave_m, DoorStop::Leave(*door)));
        }
    }
    if last < first {
        // The doors are in the order of the lane, each entered before it is left.
        stops.reverse();
        stops.chunks_mut(2).for_each(|pair| pair.reverse());
    }
    stops
}
