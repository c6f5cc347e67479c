//! Start and target positions of drones.

use crate::kinematics::{AerialSettings, Kinematics};
use crate::map::{LaneEntry, MapError, MapFile, PlaceEntry, PlaceKind};
use crate::world::{RobotSetup, SetupErrors, WindSettings, World, WorldLimits, WorldSetup};
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::num::NonZeroUsize;

/// Radius of a drone. The distances below are in the same proportion to it as in the published
/// scenario.
const RADIUS_M: f64 = 0.25;
/// Distance between neighbouring drones on the field.
const FIELD_M: f64 = 2.0;
/// Greatest random offset from the position on the field.
const ASIDE_M: f64 = 0.2;
/// Distance between circles, and radius of the innermost circle.
const CIRCLE_M: f64 = 2.5;
/// Least distance between positions on a circle.
const ALONG_M: f64 = 1.5;
/// Speed of a drone: a guess for a small quadrotor in company.
const SPEED_MPS: f64 = 3.0;

/// A swarm is impossible: it has no drones, or more than a map has places.
#[derive(Debug, thiserror::Error)]
pub enum SwarmError {
    /// The swarm has no drones.
    #[error("a swarm needs at least 1 drone")]
    NoDrones,
    /// The field of the swarm is not a valid map.
    #[error(transparent)]
    Field(#[from] MapError),
    /// The drones are not a valid world.
    #[error(transparent)]
    Setup(#[from] SetupErrors),
}

/// Configuration of a swarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Swarm {
    /// Number of drones.
    pub drones: usize,
    /// Seed of the random offsets and of the gusts.
    pub seed: u64,
    /// Greatest number of threads. The flight does not depend on it.
    pub threads: NonZeroUsize,
}

impl Swarm {
    /// Creates the world with all drones on the ground.
    ///
    /// # Errors
    /// [`SwarmError`] if there are no drones, or more than a map has places.
    pub(super) fn world(&self) -> Result<World, SwarmError> {
        let map = self.field().check("field")?;
        let mut setup = WorldSetup::new(map, self.seed);
        for n in 0..self.drones {
            let (speed, discharge) = (MetresPerSecond::new(SPEED_MPS), SharePerSecond::new(0.0));
            let (speed, discharge) = (speed.expect("a speed"), discharge.expect("a rate"));
            let drone = RobotSetup::carrier(robot(n), pad(n), speed, BatteryShare::FULL, discharge);
            let kinematics = Some(Kinematics::Aerial(AerialSettings::default()));
            setup.robots.push(RobotSetup { has_drawer: false, radius_m: RADIUS_M, kinematics, ..drone });
        }
        setup.systems = ["steering", "driving", "collisions", "wind"].map(str::to_owned).to_vec();
        (setup.wind, setup.threads) = (Some(WindSettings::default()), self.threads);
        setup.limits = WorldLimits { history_kept: 4 * self.drones.max(1_000), ..WorldLimits::default() };
        Ok(World::new(setup)?)
    }

    /// A field with a pad for each drone, in a square around the origin.
    fn field(&self) -> MapFile {
        let mut chance = ChaCha8Rng::seed_from_u64(self.seed);
        let side = (self.drones as f64).sqrt().ceil().max(1.0);
        let mut file = MapFile { name: "field".to_owned(), ..MapFile::default() };
        for n in 0..self.drones {
            let (column, row) = (n as f64 % side, (n as f64 / side).floor());
            let mut aside = |cell: f64| (cell - (side - 1.0) / 2.0) * FIELD_M + chance.random_range(-ASIDE_M..=ASIDE_M);
            let (x_m, y_m) = (aside(column), aside(row));
            let name = pad(n).as_str().to_owned();
            file.places.push(PlaceEntry { name, kind: PlaceKind::Other, x_m, y_m, ..PlaceEntry::default() });
            if n > 0 {
                let between = (pad(n - 1).as_str().to_owned(), pad(n).as_str().to_owned());
                file.lanes.push(LaneEntry { between, ..LaneEntry::default() });
            }
        }
        file
    }
}

/// Name of a drone.
pub(super) fn robot(n: usize) -> RobotId {
    RobotId::new(format!("d{n}")).expect("a letter and a number are a name")
}

fn pad(n: usize) -> PlaceId {
    PlaceId::new(format!("pad {n}")).expect("a word and a number are a name")
}

/// Returns positions on circles around the origin, in metres: from the innermost circle outwards,
/// equally spaced on each.
pub(crate) fn circles(places: usize) -> Vec<(f64, f64)> {
    let mut found = Vec::with_capacity(places);
    let mut circle = 1.0;
    while found.len() < places {
        let radius = circle * CIRCLE_M;
        let fit = (std::f64::consts::TAU * radius / ALONG_M) as usize;
        let here = fit.min(places - found.len());
        for n in 0..here {
            let (sin, cos) = (std::f64::consts::TAU * n as f64 / here as f64).sin_cos();
            found.push((radius * cos, radius * sin));
        }
        circle += 1.0;
    }
    found
}

/// Assigns to each place, in order, the nearest remaining drone. Returns positions in `drones`.
pub(super) fn assign(places: &[(f64, f64)], drones: &[(f64, f64)]) -> Vec<usize> {
    let mut left: Vec<usize> = (0..drones.len()).collect();
    let distance_2 = |a: (f64, f64), b: (f64, f64)| (a.0 - b.0).powi(2) + (a.1 - b.1).powi(2);
    let nearest = |place: &(f64, f64)| {
        let by_distance = |a: &usize, b: &usize| {
            distance_2(*place, drones[left[*a]]).total_cmp(&distance_2(*place, drones[left[*b]]))
        };
        let found = (0..left.len()).min_by(by_distance)?;
        Some(left.swap_remove(found))
    };
    places.iter().map_while(nearest).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_on_circles_keep_their_distance() {
        let places = circles(300);
        assert_eq!(places.len(), 300);
        for (n, a) in places.iter().enumerate() {
            for b in &places[..n] {
                let apart = (a.0 - b.0).hypot(a.1 - b.1);
                assert!(apart > 2.0 * RADIUS_M + 0.5, "{apart} m between {a:?} and {b:?}");
            }
        }
    }

    #[test]
    fn each_place_gets_the_nearest_drone_that_is_left() {
        let drones = [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)];
        assert_eq!(assign(&[(1.2, 0.0), (1.1, 0.0)], &drones), [1, 2]);
        assert_eq!(assign(&[(9.0, 0.0); 4], &drones), [2, 1, 0]);
    }
}
