//! What happens on the floor.
//!
//! Bodies, people and samples are entities of an [entity-component store](hecs); what they are is in their components,
//! what happens to them in a handful of systems, each a file:
//!
//! ```text
//!            start, cancel, ask_person            advance(to)
//!  skills ────────────▶ host ──▶ goals ──▶ queue ────────────▶ goals ──▶ events, in order
//!                                 │                             │
//!                       actions: what a goal needs        people: who now has what they waited for
//!                       motion, battery: closed forms     samples: who has what
//! ```
//!
//! **Time** only moves in [`advance`](consort_skills::actions::BodyHost::advance). Nothing ticks: where a robot is and
//! what its battery holds are functions of the time since it last began or ended something, and the only entries in the
//! queue are instants at which something ends. So an idle world costs nothing, and the outcome does not depend on the
//! steps in which time is let pass. Two things due at one instant happen in the order in which they were arranged.
//!
//! **Chance** (how long people take) comes from a generator per person, seeded by the world's seed and the person's
//! position in the setup. Two worlds share nothing.
//!
//! **Preconditions** are checked when a goal begins and again when it ends: a drawer that was closed meanwhile, or a
//! robot that left, aborts it, and nothing has changed.

mod actions;
mod battery;
mod build;
mod components;
mod goals;
mod host;
mod journal;
mod motion;
mod names;
mod people;
mod queue;
mod report;
mod samples;
mod setup;
mod shared;
#[cfg(test)]
mod tests;

pub use battery::{STOPPING_SHARE, default_idle_factor};
pub use journal::{Happening, JournalEntry};
pub use names::{PersonName, SampleId};
pub use report::{BodyReport, PersonReport};
pub use samples::{Keeper, SampleReport};
pub use setup::{Durations, Person, RobotBody, SetupError, SetupErrors, WorldLimits, WorldSetup};
pub use shared::SharedWorld;

use crate::map::Map;
use consort_protocol::ids::RobotId;
use consort_skills::actions::BodyEvent;
use hecs::{Component, Entity, Ref, RefMut};
use journal::Journal;
use people::Asks;
use queue::Queue;
use std::collections::BTreeMap;

/// A world. Made by [`World::new`], driven through [`BodyHost`](consort_skills::actions::BodyHost).
pub struct World {
    map: Map,
    /// Seconds since the world began.
    now: f64,
    store: hecs::World,
    robots: BTreeMap<RobotId, Entity>,
    people: BTreeMap<PersonName, Entity>,
    samples: BTreeMap<SampleId, Entity>,
    asks: Asks,
    queue: Queue<Due>,
    /// Running number of changes of hands.
    handovers: u64,
    durations: Durations,
    limits: WorldLimits,
    journal: Journal,
}

/// What falls due at an instant.
enum Due {
    /// Say what was decided earlier.
    Say(Box<BodyEvent>),
    /// A robot's goal reaches its end.
    GoalEnds(Entity),
    /// A robot's battery crosses the stopping share.
    Strands(Entity),
    /// A person has handed over what an ask is about.
    HandedOver(people::AskNumber),
}

impl World {
    /// The floor.
    pub fn map(&self) -> &Map {
        &self.map
    }

    /// Reads a component of an entity that has it by construction.
    fn get<T: Component>(&self, entity: Entity) -> Ref<'_, T> {
        self.store.get::<&T>(entity).expect("an entity is spawned with all components of its kind")
    }

    /// Writes a component of an entity that has it by construction.
    fn get_mut<T: Component>(&self, entity: Entity) -> RefMut<'_, T> {
        self.store.get::<&mut T>(entity).expect("an entity is spawned with all components of its kind")
    }
}

impl std::fmt::Debug for World {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("World")
            .field("map", &self.map.name())
            .field("now", &self.now)
            .field("robots", &self.robots.len())
            .field("people", &self.people.len())
            .field("due", &self.queue.len())
            .finish_non_exhaustive()
    }
}
