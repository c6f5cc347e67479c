//! What stands in the way: a trolley in a corridor, a floor that is being cleaned.
//!
//! A robot learns of it when it comes within sight of it (see [`driving`](super::driving)), or when somebody tells it. It
//! remembers for a while ([`Durations::closure_remembered_s`](crate::world::Durations)), then it takes the way to be open
//! again.

use crate::map::PlaceIndex;
use crate::world::World;
use crate::world::environment_setup::Obstacle;
use crate::world::event_log::WorldEvent;
use crate::world::setup::{RobotSetup, SetupError, WorldSetup};
use crate::world::sim_state::SimState;
use crate::world::system::{ComponentType, System, SystemTimer, kinds};
use consort_protocol::ids::{PlaceId, RobotId};
use hecs::Entity;
use std::collections::BTreeMap;

/// What stands in ways now, by name, and what the setup says will.
pub(crate) struct ActiveObstacles {
    standing: BTreeMap<String, Hindrance>,
    foreseen: Vec<(String, Hindrance)>,
}

/// Where something stands: after a share of the way from one place to the other.
#[derive(Debug, Clone, Copy)]
struct Hindrance {
    from: PlaceIndex,
    to: PlaceIndex,
    share: f64,
}

/// The ways that a robot has met closed, or was told are closed: since when it knows, by the two ends in order.
#[derive(Default)]
pub(crate) struct KnownClosures(BTreeMap<(PlaceIndex, PlaceIndex), f64>);

/// See the [module](self).
pub(crate) struct Obstacles;

impl System for Obstacles {
    fn name(&self) -> &'static str {
        "obstacles"
    }

    fn reads(&self) -> Vec<ComponentType> {
        kinds![]
    }

    fn writes(&self) -> Vec<ComponentType> {
        kinds![ActiveObstacles, KnownClosures]
    }

    fn init_world(&self, floor: &mut SimState, setup: &WorldSetup) {
        let foreseen: Vec<_> = setup
            .obstacles
            .iter()
            .map(|obstacle| (obstacle.name.clone(), floor.hindrance(obstacle).expect("checked: the way is on the map")))
            .collect();
        floor.insert_resource(ActiveObstacles { standing: BTreeMap::new(), foreseen });
        for (index, obstacle) in setup.obstacles.iter().enumerate() {
            // Even numbers come, odd ones go.
            let (about, number) = (floor.spawn(), 2 * index as u64);
            if obstacle.from_s > 0.0 {
                floor.schedule(obstacle.from_s, about, number);
            } else {
                let (name, hindrance) = floor.resource::<ActiveObstacles>().foreseen[index].clone();
                floor.put_in_the_way(name, hindrance);
            }
            if let Some(until) = obstacle.until_s {
                floor.schedule(until, about, number + 1);
            }
        }
    }

    fn init_robot(&self, floor: &mut SimState, robot: Entity, _body: &RobotSetup) {
        floor.insert(robot, KnownClosures::default());
    }

    fn on_timer(&self, floor: &mut SimState, SystemTimer { number, .. }: SystemTimer) {
        let foreseen = floor.resource::<ActiveObstacles>().foreseen.get((number / 2) as usize).cloned();
        let Some((name, hindrance)) = foreseen else { return };
        if number % 2 == 0 {
            floor.put_in_the_way(name, hindrance);
        } else {
            floor.clear_away(&name);
        }
    }
}

impl World {
    /// Puts something into a way from now on, in the place of what bears its name; its times are left aside.
    ///
    /// # Errors
    /// [`SetupError`] if it is not on a lane of this map; nothing has changed.
    pub fn add_obstacle(&mut self, obstacle: &Obstacle) -> Result<(), SetupError> {
        obstacle.check(&self.state.map)?;
        let hindrance = self.state.hindrance(obstacle).expect("checked: the way is on the map");
        self.run_as(&Obstacles, |floor| floor.put_in_the_way(obstacle.name.clone(), hindrance));
        Ok(())
    }

    /// Takes away what bears this name; if there is nothing of the kind nothing changes. Robots that know of it find out
    /// when they have forgotten it or are [told](Self::tell_open).
    pub fn remove_obstacle(&mut self, obstacle: &str) {
        self.run_as(&Obstacles, |floor| floor.clear_away(obstacle));
    }

    /// Somebody tells a robot that the way between two places is closed. It believes it. Of strangers nothing is said.
    pub fn report_lane_closed(&mut self, robot: &RobotId, a: &PlaceId, b: &PlaceId) {
        self.tell(robot, a, b, true);
    }

    /// Somebody tells a robot that the way between two places is open.
    pub fn report_lane_open(&mut self, robot: &RobotId, a: &PlaceId, b: &PlaceId) {
        self.tell(robot, a, b, false);
    }

    fn tell(&mut self, robot: &RobotId, a: &PlaceId, b: &PlaceId, closed: bool) {
        let (robot, ends) =
            (self.state.robots.get(robot).copied(), self.state.map.index(a).zip(self.state.map.index(b)));
        let (Some(robot), Some((a, b))) = (robot, ends) else { return };
        self.run_as(&Obstacles, |floor| {
            if closed {
                floor.remember_closure(robot, a, b);
            } else {
                floor.get_mut::<KnownClosures>(robot).0.remove(&(a.min(b), a.max(b)));
            }
        });
    }
}

impl SimState {
    fn hindrance(&self, obstacle: &Obstacle) -> Option<Hindrance> {
        let (a, b) = &obstacle.on;
        Some(Hindrance { from: self.map.index(a)?, to: self.map.index(b)?, share: obstacle.at })
    }

    fn put_in_the_way(&mut self, name: String, hindrance: Hindrance) {
        self.resource_mut::<ActiveObstacles>().standing.insert(name.clone(), hindrance);
        let between = self.ends(hindrance);
        self.log_event(WorldEvent::LaneBlocked { obstacle: name, between });
    }

    fn clear_away(&mut self, name: &str) {
        let gone = self.resource_mut::<ActiveObstacles>().standing.remove(name);
        if let Some(hindrance) = gone {
            let between = self.ends(hindrance);
            self.log_event(WorldEvent::LaneCleared { obstacle: name.to_owned(), between });
        }
    }

    fn ends(&self, Hindrance { from, to, .. }: Hindrance) -> (PlaceId, PlaceId) {
        (self.map.place_at(from).id.clone(), self.map.place_at(to).id.clone())
    }

    /// What stands between two neighbouring places, each with the share of the way at which it does.
    pub(crate) fn obstacles_on(&self, from: PlaceIndex, to: PlaceIndex) -> Vec<(f64, String)> {
        if !self.has_resource::<ActiveObstacles>() {
            return vec![];
        }
        let way = self.resource::<ActiveObstacles>();
        let standing = way.standing.iter().filter_map(|(name, hindrance)| match (hindrance.from, hindrance.to) {
            ends if ends == (from, to) => Some((hindrance.share, name.clone())),
            ends if ends == (to, from) => Some((1.0 - hindrance.share, name.clone())),
            _ => None,
        });
        standing.collect()
    }

    /// From now on a robot knows that a way is closed.
    pub(crate) fn remember_closure(&self, robot: Entity, a: PlaceIndex, b: PlaceIndex) {
        if let Some(mut known) = self.find_mut::<KnownClosures>(robot) {
            known.0.insert((a.min(b), a.max(b)), self.now);
        }
    }

    /// The ways that a robot takes to be closed.
    pub(crate) fn known_closures(&self, robot: Entity) -> Vec<(PlaceId, PlaceId)> {
        let Some(known) = self.find::<KnownClosures>(robot) else { return vec![] };
        let remembered = |since: &f64| self.now - since < self.durations.closure_remembered_s;
        let ends = |((a, b), _): (&(PlaceIndex, PlaceIndex), &f64)| {
            (self.map.place_at(*a).id.clone(), self.map.place_at(*b).id.clone())
        };
        known.0.iter().filter(|(_, since)| remembered(since)).map(ends).collect()
    }
}
