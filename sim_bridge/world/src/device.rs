//! A simulated door, lift or other device of a building, as the backend of its driver.

use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::pose::Pose;
use consort_protocol::scalar::Scalar;
use consort_protocol::units::{BatteryShare, Metres, Seconds, WorldTime};
use consort_skills::actions::{
    ActionError, BackendEvent, ErrorCode, Feedback, Goal, GoalId, GoalStatus, PersonRequest, PersonResult,
    RobotBackend, Telemetry,
};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Goals that have ended and are remembered.
const ENDED_MAX: usize = 16;

/// Cuts a simulated device from its node, for tests and demonstrations.
#[derive(Debug, Clone, Default)]
pub struct DeviceSwitch(Arc<AtomicBool>);

impl DeviceSwitch {
    /// Lets the device be silent, or respond again.
    pub fn set_silent(&self, is_silent: bool) {
        self.0.store(is_silent, Ordering::SeqCst);
    }

    fn is_silent(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}

/// A device that takes some time to become ready, and as long to return. It performs the actions `serve` and `alarm`: the
/// feedback `ready` is true from then on, until the goal is canceled. A silent device stays as it is.
pub struct SimulatedDevice {
    name: RobotId,
    place: PlaceId,
    moving: Seconds,
    now: WorldTime,
    switch: DeviceSwitch,
    /// The goal in progress, with the time at which it is ready.
    active: Option<(GoalId, Goal, WorldTime)>,
    /// A canceled goal, with the time at which the device is back.
    returning: Option<(GoalId, Goal, WorldTime)>,
    ended: BTreeMap<GoalId, (Goal, GoalStatus)>,
    events: Vec<BackendEvent>,
}

impl SimulatedDevice {
    /// Creates the device at rest. It becomes ready, and returns, in the time `moving`.
    ///
    /// # Panics
    /// Never: the name of a device is a place, too.
    pub fn new(name: RobotId, moving: Seconds, switch: DeviceSwitch) -> SimulatedDevice {
        SimulatedDevice {
            place: name.as_str().parse().expect("a name of a device is a label"),
            name,
            moving,
            now: WorldTime::ZERO,
            switch,
            active: None,
            returning: None,
            ended: BTreeMap::new(),
            events: vec![],
        }
    }

    fn is_known(&self, id: GoalId) -> bool {
        let is_it = |goal: &Option<(GoalId, Goal, WorldTime)>| goal.as_ref().is_some_and(|(known, ..)| *known == id);
        is_it(&self.active) || is_it(&self.returning) || self.ended.contains_key(&id)
    }

    fn end(&mut self, id: GoalId, goal: Goal, status: GoalStatus) {
        self.events.push(BackendEvent::GoalEnded { robot: self.name.clone(), goal: id, status: status.clone() });
        self.ended.insert(id, (goal, status));
        while self.ended.len() > ENDED_MAX {
            self.ended.pop_first();
        }
    }
}

impl RobotBackend for SimulatedDevice {
    fn robots(&self) -> Vec<RobotId> {
        vec![self.name.clone()]
    }

    fn serves_people(&self) -> bool {
        false
    }

    fn start(&mut self, robot: &RobotId, id: GoalId, goal: Goal) {
        if *robot != self.name || self.switch.is_silent() || self.is_known(id) {
            return;
        }
        let is_action = matches!(goal.action.as_str(), "serve" | "alarm");
        if !is_action || self.active.is_some() || self.returning.is_some() {
            let error = ActionError::rejected(ErrorCode::Busy, format!("{} cannot {} now", self.name, goal.action));
            return self.end(id, goal, GoalStatus::Aborted(error));
        }
        self.active = Some((id, goal, self.now + self.moving));
    }

    fn cancel(&mut self, robot: &RobotId, id: GoalId) {
        if *robot != self.name || self.switch.is_silent() {
            return;
        }
        if let Some((id, goal, _)) = self.active.take_if(|(active, ..)| *active == id) {
            self.returning = Some((id, goal, self.now + self.moving));
        }
    }

    fn request_person(&mut self, id: GoalId, _request: PersonRequest) {
        let error = ActionError::rejected(ErrorCode::Unknown, "a device has no people".to_owned());
        self.events.push(BackendEvent::PersonRequestEnded { request: id, result: Err(error) });
    }

    fn cancel_person_request(&mut self, _id: GoalId) {}

    fn now(&self) -> WorldTime {
        self.now
    }

    fn next_due(&self) -> Option<WorldTime> {
        let times = [&self.active, &self.returning].into_iter().flatten().map(|(_, _, at)| *at);
        times.filter(|at| *at > self.now).min_by(|a, b| a.as_secs().total_cmp(&b.as_secs()))
    }

    fn advance(&mut self, to: WorldTime) -> Vec<BackendEvent> {
        self.now = WorldTime::from_secs(to.as_secs().max(self.now.as_secs()));
        let now = self.now.as_secs();
        if let Some((id, goal, _)) = self.returning.take_if(|(_, _, at)| at.as_secs() <= now) {
            self.end(id, goal, GoalStatus::Canceled);
        }
        std::mem::take(&mut self.events)
    }

    fn status(&self, robot: &RobotId, id: GoalId) -> Option<GoalStatus> {
        if *robot != self.name || self.switch.is_silent() {
            return None;
        }
        let executing = |is_ready: bool| {
            let remaining = Feedback::remaining(Metres::ZERO, Seconds::ZERO);
            let values = BTreeMap::from([("ready".to_owned(), Scalar::Bool(is_ready))]);
            GoalStatus::Executing(Feedback { values, ..remaining })
        };
        match (&self.active, &self.returning) {
            (Some((active, _, at)), _) if *active == id => Some(executing(at.as_secs() <= self.now.as_secs())),
            (_, Some((returning, ..))) if *returning == id => Some(executing(false)),
            _ => self.ended.get(&id).map(|(_, status)| status.clone()),
        }
    }

    fn goals(&self, robot: &RobotId) -> Vec<GoalId> {
        let present = [&self.returning, &self.active].into_iter().flatten().map(|(id, ..)| *id);
        if *robot == self.name { self.ended.keys().copied().chain(present).collect() } else { vec![] }
    }

    fn goal(&self, robot: &RobotId, id: GoalId) -> Option<Goal> {
        let mut present = [&self.returning, &self.active].into_iter().flatten();
        let found = present.find(|(known, ..)| *known == id).map(|(_, goal, _)| goal);
        found.or_else(|| self.ended.get(&id).map(|(goal, _)| goal)).filter(|_| *robot == self.name).cloned()
    }

    fn open_person_requests(&self) -> Vec<GoalId> {
        vec![]
    }

    fn person_result(&self, _id: GoalId) -> Option<PersonResult> {
        None
    }

    fn was_person_request_canceled(&self, _id: GoalId) -> bool {
        false
    }

    fn telemetry(&self, robot: &RobotId) -> Option<Telemetry> {
        let responds = *robot == self.name && !self.switch.is_silent();
        responds.then(|| Telemetry {
            time: self.now,
            pose: Pose::default(),
            place: self.place.clone(),
            battery: BatteryShare::FULL,
            able: true,
            closed: vec![],
            readings: BTreeMap::new(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_is_ready_after_its_movement_and_ends_after_its_return() {
        let (name, switch) = ("door".parse::<RobotId>().unwrap(), DeviceSwitch::default());
        let mut door = SimulatedDevice::new(name.clone(), Seconds::new(3.0).unwrap(), switch.clone());
        let serve = Goal {
            action: "serve".parse().unwrap(),
            parameters: serde_json::Map::new(),
            repeatable: true,
            hands_over: Some(false),
            since: None,
        };
        let id = GoalId(5);
        let is_ready = |door: &SimulatedDevice| match door.status(&name, id) {
            Some(GoalStatus::Executing(feedback)) => feedback.values.get("ready") == Some(&Scalar::Bool(true)),
            status => panic!("{status:?}"),
        };
        door.start(&name, id, serve);
        door.advance(WorldTime::from_secs(2.9));
        assert!(!is_ready(&door));
        door.advance(WorldTime::from_secs(3.0));
        assert!(is_ready(&door));
        switch.set_silent(true);
        assert_eq!((door.status(&name, id), door.telemetry(&name)), (None, None));
        switch.set_silent(false);
        door.cancel(&name, id);
        assert!(door.advance(WorldTime::from_secs(5.9)).is_empty());
        assert_eq!(door.advance(WorldTime::from_secs(6.0)).len(), 1);
        assert_eq!(door.status(&name, id), Some(GoalStatus::Canceled));
    }
}
