//! Gusts that push at what hovers, so that it has to correct (thesis 5.6.1).

use super::steering::Steered;
use crate::world::floor::Floor;
use crate::world::setup::{Gusts, WorldSetup};
use crate::world::system::{Kind, System, Wake, kinds};
use nalgebra::Vector3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// The wind over a floor.
pub(crate) struct Wind {
    gusts: Gusts,
    chance: ChaCha8Rng,
}

/// Keeps the wind's source of chance apart from those of people, which are numbered from 0.
const STREAM: u64 = u64::MAX;

/// See the [module](self).
pub(crate) struct Gusting;

impl System for Gusting {
    fn name(&self) -> &'static str {
        "gusts"
    }

    fn reads(&self) -> Vec<Kind> {
        kinds![]
    }

    fn writes(&self) -> Vec<Kind> {
        kinds![Wind, Steered]
    }

    fn furnish(&self, floor: &mut Floor, setup: &WorldSetup) {
        let Some(gusts) = setup.gusts else { return };
        let mut chance = ChaCha8Rng::seed_from_u64(setup.seed);
        chance.set_stream(STREAM);
        floor.furnish(Wind { gusts, chance });
        let about = floor.spawn();
        floor.arrange(gusts.every_s, about, 1);
    }

    fn wake(&self, floor: &mut Floor, Wake { about, number }: Wake) {
        let Wind { gusts, mut chance } = {
            let wind = floor.own::<Wind>();
            Wind { gusts: wind.gusts, chance: wind.chance.clone() }
        };
        let (now, mut pushed) = (floor.now, false);
        for steered in floor.each::<&mut Steered>().into_iter().filter(|steered| steered.mover.is_hovering()) {
            if chance.random::<f64>() < gusts.chance {
                let strength = chance.random_range(-gusts.strength_mps..=gusts.strength_mps);
                let along = if chance.random::<bool>() { Vector3::x() } else { Vector3::y() };
                steered.push(along * strength, now);
                pushed = true;
            }
        }
        floor.own_mut::<Wind>().chance = chance;
        if pushed {
            floor.step_on();
        }
        floor.arrange((number + 1) as f64 * gusts.every_s, about, number + 1);
    }
}
