//! Gusts that push at what hovers, so that it has to correct (thesis 5.6.1).

use super::steering::Steered;
use crate::world::setup::{WindSettings, WorldSetup};
use crate::world::sim_state::SimState;
use crate::world::system::{ComponentType, System, SystemTimer, kinds};
use nalgebra::Vector3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// The wind over a floor.
pub(crate) struct Wind {
    gusts: WindSettings,
    chance: ChaCha8Rng,
}

/// Keeps the wind's source of chance apart from those of people, which are numbered from 0.
const STREAM: u64 = u64::MAX;

/// See the [module](self).
pub(crate) struct WindSystem;

impl System for WindSystem {
    fn name(&self) -> &'static str {
        "gusts"
    }

    fn reads(&self) -> Vec<ComponentType> {
        kinds![]
    }

    fn writes(&self) -> Vec<ComponentType> {
        kinds![Wind, Steered]
    }

    fn init_world(&self, floor: &mut SimState, setup: &WorldSetup) {
        let Some(gusts) = setup.gusts else { return };
        let mut chance = ChaCha8Rng::seed_from_u64(setup.seed);
        chance.set_stream(STREAM);
        floor.insert_resource(Wind { gusts, chance });
        let about = floor.spawn();
        floor.schedule(gusts.every_s, about, 1);
    }

    fn on_timer(&self, floor: &mut SimState, SystemTimer { entity, number: sequence }: SystemTimer) {
        let Wind { gusts, mut chance } = {
            let wind = floor.resource::<Wind>();
            Wind { gusts: wind.gusts, chance: wind.chance.clone() }
        };
        let (now, mut pushed) = (floor.now, false);
        for steered in floor.query::<&mut Steered>().into_iter().filter(|steered| steered.model.is_hovering()) {
            if chance.random::<f64>() < gusts.chance {
                let strength = chance.random_range(-gusts.strength_mps..=gusts.strength_mps);
                let along = if chance.random::<bool>() { Vector3::x() } else { Vector3::y() };
                steered.push(along * strength, now);
                pushed = true;
            }
        }
        floor.resource_mut::<Wind>().chance = chance;
        if pushed {
            floor.start_stepping();
        }
        floor.schedule((sequence + 1) as f64 * gusts.every_s, entity, sequence + 1);
    }
}
