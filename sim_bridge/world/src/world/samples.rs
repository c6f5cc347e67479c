//! Location of samples.
//!
//! Each sample stores its holder, and there is no other record. The content of a drawer, a hand or
//! a table is derived from the samples, so a sample is never in two places.

use super::components::{PersonInfo, SampleLabel, SimRobot};
use super::event::{SampleHolder, WorldEvent};
use super::location::RobotLocation;
use super::names::SampleId;
use super::setup::environment::sample_kg;
use super::sim_state::SimState;
use crate::map::PlaceIndex;
use consort_protocol::ids::{MAX_CHARS, PlaceId};
use consort_protocol::units::WorldTime;
use consort_skills::actions::{ActionError, ErrorCode};
use hecs::Entity;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Current and earlier holders of a sample.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SampleReport {
    /// Sample.
    pub id: SampleId,
    /// Current holder.
    pub holder: SampleHolder,
    /// Current place, or the last place passed by the robot that carries the sample.
    pub place: PlaceId,
    /// Transfers: time and previous holder. Oldest first.
    pub history: Vec<(WorldTime, SampleHolder)>,
}

/// Holder of a sample, as entities.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum HolderEntity {
    Table(PlaceIndex),
    Drawer(Entity),
    Arm(Entity),
    Hands(Entity),
}

/// Current and earlier holders of a sample.
pub(crate) struct Custody {
    holder: HolderEntity,
    /// Sequence number of the latest transfer: samples leave in the order of arrival.
    since: u64,
    earlier: VecDeque<(f64, HolderEntity)>,
}

/// Properties of an object that limit an arm.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PayloadData {
    pub(crate) weight_kg: f64,
    /// Distance from the position of robots; 0 after the first transfer.
    pub(crate) distance_m: f64,
}

impl PayloadData {
    /// Returns the properties of a sample within reach.
    pub(crate) fn of_sample() -> PayloadData {
        PayloadData { weight_kg: sample_kg(), distance_m: 0.0 }
    }
}

/// Sequence number of transfers in this world.
#[derive(Default)]
pub(crate) struct HandoverCount(u64);

impl SimState {
    /// Creates a sample with its first holder.
    pub(crate) fn spawn_sample(&mut self, id: SampleId, holder: HolderEntity, load: PayloadData) {
        let since = self.next_handover();
        let sample = self.spawn();
        self.insert(sample, SampleLabel(id.clone()));
        self.insert(sample, load);
        self.insert(sample, Custody { holder, since, earlier: VecDeque::new() });
        self.samples.insert(id, sample);
    }

    /// Creates a sample during the run of the world.
    pub(crate) fn create_sample(&mut self, id: SampleId, holder: HolderEntity) {
        self.spawn_sample(id.clone(), holder, PayloadData::of_sample());
        let holder = self.sample_holder(holder);
        self.log_event(WorldEvent::SampleCreated { sample: id, holder });
    }

    /// Removes a sample from the world.
    pub(crate) fn consume_sample(&mut self, sample: Entity) {
        let (id, holder) = (self.get::<SampleLabel>(sample).0.clone(), self.get::<Custody>(sample).holder);
        self.samples.remove(&id);
        self.despawn(sample);
        let from = self.sample_holder(holder);
        self.log_event(WorldEvent::SampleConsumed { sample: id, from });
    }

    /// Returns the first name of this form that no sample has: `name 1`, `name 2` and so on.
    pub(crate) fn free_sample_id(&self, name: &str, first: usize) -> SampleId {
        let id = |number: usize| {
            let number = format!(" {number}");
            let start: String = name.chars().take(MAX_CHARS - number.len()).collect();
            SampleId::from((start + &number).as_str())
        };
        let mut ids = (first..).map(id);
        ids.find(|id| !self.samples.contains_key(id)).expect("the number of samples is bounded")
    }

    fn next_handover(&mut self) -> u64 {
        let mut handovers = self.resource_mut::<HandoverCount>();
        handovers.0 += 1;
        handovers.0
    }

    pub(super) fn sample_report(&self, id: &SampleId, sample: Entity) -> SampleReport {
        let custody = self.get::<Custody>(sample);
        let earlier = custody.earlier.iter();
        SampleReport {
            id: id.clone(),
            holder: self.sample_holder(custody.holder),
            place: self.map.place_at(self.place_of(custody.holder)).id.clone(),
            history: earlier.map(|(time, holder)| (WorldTime::from_secs(*time), self.sample_holder(*holder))).collect(),
        }
    }

    fn sample_holder(&self, holder: HolderEntity) -> SampleHolder {
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

    /// Returns the samples of a holder, in the order of arrival.
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

    /// Returns the sample of this name that a holder has, or without a name the one that it has had for the longest
    /// time.
    pub(crate) fn sample_of(&self, holder: HolderEntity, name: Option<&str>) -> Result<Entity, ActionError> {
        let held = self.held(holder);
        let is_wanted = |sample: &Entity| name.is_none_or(|name| self.label(*sample) == name);
        if let Some(sample) = held.iter().copied().find(is_wanted) {
            return Ok(sample);
        }
        let labels: Vec<String> = held.iter().map(|sample| self.label(*sample)).collect();
        let objects_there = if labels.is_empty() { "nothing".to_owned() } else { labels.join(", ") };
        let wanted = name.map_or("object".to_owned(), |name| format!("{name:?}"));
        let (code, there) = match self.sample_holder(holder) {
            SampleHolder::Table(place) => (ErrorCode::OutOfReach, format!("on the table at {place}")),
            SampleHolder::Drawer(robot) => (ErrorCode::ContainerState, format!("in the drawer of {robot}")),
            SampleHolder::Arm(robot) => (ErrorCode::ContainerState, format!("in the arm of {robot}")),
            SampleHolder::Person(person) => (ErrorCode::OutOfReach, format!("in the hands of {person}")),
        };
        Err(ActionError::rejected(code, format!("no {wanted} is {there}; objects there: {objects_there}")))
    }

    /// Returns the first of these samples that lies on a table.
    pub(crate) fn first_on_a_table(&self, samples: &[Entity]) -> Option<Entity> {
        let on_a_table = |sample: &Entity| matches!(self.get::<Custody>(*sample).holder, HolderEntity::Table(_));
        samples.iter().copied().find(on_a_table)
    }

    /// Returns the labels of a holder's samples.
    pub(crate) fn held_labels(&self, holder: HolderEntity) -> Vec<SampleId> {
        self.held(holder).into_iter().map(|sample| self.get::<SampleLabel>(sample).0.clone()).collect()
    }

    /// Transfers a sample to a holder that has it within reach.
    pub(crate) fn place_sample(&mut self, sample: Entity, to: HolderEntity) {
        self.get_mut::<PayloadData>(sample).distance_m = 0.0;
        self.transfer_sample(sample, to);
    }

    /// Takes all samples off a robot, to the table at its place.
    pub(crate) fn take_samples_off(&mut self, robot: Entity) {
        let table = HolderEntity::Table(self.place_of(HolderEntity::Drawer(robot)));
        for holder in [HolderEntity::Drawer(robot), HolderEntity::Arm(robot)] {
            for sample in self.held(holder) {
                self.place_sample(sample, table);
            }
        }
    }

    pub(crate) fn transfer_sample(&mut self, sample: Entity, to: HolderEntity) {
        let since = self.next_handover();
        let from = {
            let mut custody = self.get_mut::<Custody>(sample);
            let from = custody.holder;
            (custody.holder, custody.since) = (to, since);
            custody.earlier.push_back((self.now, from));
            if custody.earlier.len() > self.limits.history_kept {
                custody.earlier.pop_front();
            }
            from
        };
        let id = self.get::<SampleLabel>(sample).0.clone();
        let (from, to) = (self.sample_holder(from), self.sample_holder(to));
        self.log_event(WorldEvent::SampleMoved { sample: id, from, to });
    }
}
