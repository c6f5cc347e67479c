//! A drive and what is on the way: doors to pass, things in the way.

use super::location::{LanePart, StraightDrive};
use super::sim_state::SimState;
use hecs::Entity;

/// A robot waits this far before a door, and has passed it as far behind: room for the leaf and for who comes out.
const CLEARANCE_M: f64 = 0.5;

/// A robot sees from this far that something stands in its way, and stops.
pub(crate) const OBSTACLE_DETECTION_M: f64 = 1.0;

/// Lengths that differ by less are the same: a micrometre.
pub(crate) const LENGTH_EPSILON_M: f64 = 1e-6;

/// A drive under way.
#[derive(Debug, Clone)]
pub(crate) struct DriveProgress {
    /// The drive as it would be if nothing was in the way.
    pub(crate) drive: StraightDrive,
    pub(crate) speed_mps: f64,
    /// How far it has come when the part under way began.
    pub(crate) done_m: f64,
    /// How far it has come when the part under way ends.
    pub(crate) until_m: f64,
    /// Where there is something to do about doors, by how far it is: first things first.
    stops: Vec<(f64, DoorStop)>,
    next: usize,
}

/// Something to do on the way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum DoorStop {
    /// Wait until the door lets one in.
    Enter(Entity),
    /// The door has been passed.
    Leave(Entity),
}

impl DriveProgress {
    pub(crate) fn new(whole: StraightDrive, speed_mps: f64, floor: &SimState) -> DriveProgress {
        let stops = whole.lane.map_or(vec![], |stretch| stops(floor, stretch, whole.length_m()));
        DriveProgress { drive: whole, speed_mps, done_m: 0.0, until_m: 0.0, stops, next: 0 }
    }

    /// What there is to do where the robot is now.
    pub(crate) fn current_stop(&self) -> Option<DoorStop> {
        self.stops.get(self.next).filter(|(at, _)| *at <= self.done_m + LENGTH_EPSILON_M).map(|(_, stop)| *stop)
    }

    pub(crate) fn finish_stop(&mut self) {
        self.next += 1;
    }

    /// How far it has come at the next stop, or at the end.
    pub(crate) fn next_stop_m(&self) -> f64 {
        self.stops.get(self.next).map_or(self.drive.length_m(), |(at, _)| at.min(self.drive.length_m()))
    }

    /// How far it has come where it next has to stand, unless it may go on at once, or at the end.
    pub(crate) fn next_wait_m(&self) -> f64 {
        let ahead = self.stops.iter().skip(self.next);
        let halt = ahead.filter(|(_, stop)| matches!(stop, DoorStop::Enter(_))).map(|(at, _)| *at).next();
        halt.map_or(self.drive.length_m(), |at| at.min(self.drive.length_m()))
    }

    /// Has it come past the next door, if it is in one: which.
    pub(crate) fn leave_door(&mut self) -> Option<Entity> {
        let Some((_, DoorStop::Leave(door))) = self.stops.get(self.next) else { return None };
        self.next += 1;
        Some(*door)
    }

    /// Whether a door is on the way.
    pub(crate) fn passes_door(&self, door: Entity) -> bool {
        self.stops.iter().any(|(_, stop)| *stop == DoorStop::Leave(door))
    }

    pub(crate) fn is_complete(&self) -> bool {
        self.done_m >= self.drive.length_m()
    }
}

/// Where doors on part of a lane are to be entered and left, as distances from the part's beginning.
fn stops(floor: &SimState, (from, to, first, last): LanePart, length_m: f64) -> Vec<(f64, DoorStop)> {
    let lane_m = floor.map.lane_between(from, to).map_or(0.0, |lane| lane.length.get());
    let met = floor.map.doors_on(&floor.map.place_at(from).id, &floor.map.place_at(to).id);
    let doors: Vec<(f64, Entity)> =
        met.iter().filter_map(|met| Some((met.at, floor.door_entity(&met.door.name)?))).collect();
    let reach = CLEARANCE_M / lane_m.max(LENGTH_EPSILON_M);
    let mut stops = Vec::new();
    for (index, (at, door)) in doors.iter().enumerate() {
        // Neither beyond the ends of the lane nor beyond half the way to the next door: nobody is in two doorways at once.
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
        // The doors came in the order of the lane, each entered before it is left.
        stops.reverse();
        stops.chunks_mut(2).for_each(|pair| pair.reverse());
    }
    stops
}
