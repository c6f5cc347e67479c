//! Who has what.
//!
//! Each sample knows its holder, and that is the only record: what is in a drawer, in a hand or on a table is asked of
//! the samples, so nothing can be in two places.

use super::World;
use super::components::{PersonInfo, SampleLabel, SimRobot};
use super::event_log::WorldEvent;
use super::location::RobotLocation;
use super::names::{PersonName, SampleId};
use super::sim_state::SimState;
use crate::map::PlaceIndex;
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::units::WorldTime;
use hecs::Entity;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Who or what has a sample.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SampleHolder {
    /// It lies on the table of a place.
    Table(PlaceId),
    /// It lies in a robot's drawer.
    Drawer(RobotId),
    /// A robot's arm holds it.
    Arm(RobotId),
    /// A person holds it.
    Person(PersonName),
}

/// Where a sample is, and where it was.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SampleReport {
    /// Which sample.
    pub id: SampleId,
    /// Who or what has it.
    pub keeper: SampleHolder,
    /// The place it is at, or the last one passed by the robot that carries it.
    pub place: PlaceId,
    /// Each change of hands: when, and who had it before. Oldest first.
    pub history: Vec<(WorldTime, SampleHolder)>,
}

/// Who or what has a sample, as entities.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum HolderEntity {
    Table(PlaceIndex),
    Drawer(Entity),
    Arm(Entity),
    Hands(Entity),
}

/// A sample's holder, now and before.
pub(crate) struct Custody {
    holder: HolderEntity,
    /// Running number of the latest change of hands: what came first goes first.
    since: u64,
    before: VecDeque<(f64, HolderEntity)>,
}

/// What a thing asks of an arm.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PayloadData {
    pub(crate) weight_kg: f64,
    /// How far from where robots stand it lies; 0 once somebody has had it in hand.
    pub(crate) distance_m: f64,
}

/// Running number of changes of hands, of the floor.
#[derive(Default)]
pub(crate) struct HandoverCount(u64);

impl World {
    /// Where each sample is.
    pub fn samples(&self) -> Vec<SampleReport> {
        self.state.samples.iter().map(|(id, sample)| self.state.sample_report(id, *sample)).collect()
    }

    /// Where one sample is; `None` if there is none of this name.
    pub fn sample(&self, id: &SampleId) -> Option<SampleReport> {
        self.state.samples.get(id).map(|sample| self.state.sample_report(id, *sample))
    }
}

impl SimState {
    /// A new thing, which somebody has from the first.
    pub(crate) fn spawn_sample(&mut self, id: SampleId, holder: HolderEntity, load: PayloadData) {
        let since = self.next_handover();
        let sample = self.spawn();
        self.insert(sample, SampleLabel(id.clone()));
        self.insert(sample, load);
        self.insert(sample, Custody { holder, since, before: VecDeque::new() });
        self.samples.insert(id, sample);
    }

    fn next_handover(&mut self) -> u64 {
        let mut handovers = self.resource_mut::<HandoverCount>();
        handovers.0 += 1;
        handovers.0
    }

    fn sample_report(&self, id: &SampleId, sample: Entity) -> SampleReport {
        let custody = self.get::<Custody>(sample);
        let before = custody.before.iter();
        SampleReport {
            id: id.clone(),
            keeper: self.keeper(custody.holder),
            place: self.map.place_at(self.place_of(custody.holder)).id.clone(),
            history: before.map(|(time, holder)| (WorldTime::from_secs(*time), self.keeper(*holder))).collect(),
        }
    }

    fn keeper(&self, holder: HolderEntity) -> SampleHolder {
        match holder {
            HolderEntity::Table(place) => SampleHolder::Table(self.map.place_at(place).id.clone()),
            HolderEntity::Drawer(robot) => SampleHolder::Drawer(self.get::<SimRobot>(robot).0.id.clone()),
            HolderEntity::Arm(robot) => SampleHolder::Arm(self.get::<SimRobot>(robot).0.id.clone()),
            HolderEntity::Hands(person) => SampleHolder::Person(self.get::<PersonInfo>(person).name.clone()),
        }
    }

    fn place_of(&self, holder: HolderEntity) -> PlaceIndex {
        match holder {
            HolderEntity::Table(place) => place,
            HolderEntity::Drawer(robot) | HolderEntity::Arm(robot) => {
                self.get::<RobotLocation>(robot).map_position(self.now).last_place()
            }
            HolderEntity::Hands(person) => self.get::<PersonInfo>(person).place,
        }
    }

    /// What a holder has, what it got first standing first.
    pub(crate) fn held(&self, holder: HolderEntity) -> Vec<Entity> {
        let mut held: Vec<(u64, Entity)> = Vec::new();
        for sample in self.samples.values() {
            let custody = self.get::<Custody>(*sample);
            if custody.holder == holder {
                held.push((custody.since, *sample));
            }
        }
        held.sort_by_key(|(since, _)| *since);
        held.into_iter().map(|(_, sample)| sample).collect()
    }

    /// The names of what a holder has.
    pub(crate) fn held_labels(&self, holder: HolderEntity) -> Vec<SampleId> {
        self.held(holder).into_iter().map(|sample| self.get::<SampleLabel>(sample).0.clone()).collect()
    }

    pub(crate) fn transfer_sample(&mut self, sample: Entity, to: HolderEntity) {
        let since = self.next_handover();
        let from = {
            let mut custody = self.get_mut::<Custody>(sample);
            let from = custody.holder;
            (custody.holder, custody.since) = (to, since);
            custody.before.push_back((self.now, from));
            if custody.before.len() > self.limits.history_kept {
                custody.before.pop_front();
            }
            from
        };
        let id = self.get::<SampleLabel>(sample).0.clone();
        let (from, to) = (self.keeper(from), self.keeper(to));
        self.log_event(WorldEvent::SampleMoved { sample: id, from, to });
    }
}
