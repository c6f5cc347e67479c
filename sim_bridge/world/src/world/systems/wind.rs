//! Wind: gusts push hovering drones, which have to correct their position (thesis 5.6.1).

use crate::component_types;
use crate::world::setup::{WindSettings, WorldSetup};
use crate::world::sim_state::SimState;
use crate::world::steered::{BodyIndex, Steered};
use crate::world::system::System;
use crate::world::system_access::{ComponentType, SystemTimer};
use hecs::Entity;
use nalgebra::Vector3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// State of the wind.
pub(crate) struct Wind {
    settings: WindSettings,
    rng: ChaCha8Rng,
}

/// Random stream of the wind, separate from the streams of people, which are numbered from 0.
const STREAM: u64 = u64::MAX;

/// See the [module](self).
pub(crate) struct WindSystem;

impl System for WindSystem {
    fn name(&self) -> &'static str {
        "wind"
    }

    fn reads(&self) -> Vec<ComponentType> {
        component_types![]
    }

    fn writes(&self) -> Vec<ComponentType> {
        component_types![Wind, Steered, BodyIndex]
    }

    fn init_world(&self, state: &mut SimState, setup: &WorldSetup) {
        let Some(settings) = setup.wind else { return };
        let mut rng = ChaCha8Rng::seed_from_u64(setup.seed);
        rng.set_stream(STREAM);
        state.insert_resource(Wind { settings, rng });
        let entity = state.spawn();
        state.schedule(settings.interval_s, entity, 1);
    }

    fn on_timer(&self, state: &mut SimState, SystemTimer { entity, number }: SystemTimer) {
        let Wind { settings, mut rng } = {
            let wind = state.resource::<Wind>();
            Wind { settings: wind.settings, rng: wind.rng.clone() }
        };
        let (now, mut pushed) = (state.now, Vec::new());
        let steered = state.query::<(Entity, &mut Steered)>().into_iter();
        for (robot, steered) in steered.filter(|(_, steered)| steered.model.is_hovering()) {
            if rng.random::<f64>() < settings.probability {
                let strength = rng.random_range(-settings.max_speed_change_mps..=settings.max_speed_change_mps);
                let along = if rng.random::<bool>() { Vector3::x() } else { Vector3::y() };
                steered.push(along * strength, now);
                pushed.push(robot);
            }
        }
        state.resource_mut::<Wind>().rng = rng;
        if !pushed.is_empty() {
            state.resource_mut::<BodyIndex>().changed.extend(pushed);
            state.start_stepping();
        }
        state.schedule((number + 1) as f64 * settings.interval_s, entity, number + 1);
    }
}
