//! A world that is shared between its driver and its observers.

use crate::record::{RecordError, Recorder};
use crate::world::World;
use consort_protocol::ids::RobotId;
use consort_protocol::units::WorldTime;
use consort_skills::actions::{
    BackendEvent, Goal, GoalId, GoalStatus, PersonRequest, PersonResult, RobotBackend, Telemetry,
};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A handle on a world. All clones share the world. It is a robot backend like the world itself.
#[derive(Clone)]
pub struct SharedWorld(Arc<Mutex<Shared>>);

struct Shared {
    world: World,
    /// The recorder, if the world is being recorded.
    recorder: Option<Recorder>,
}

impl SharedWorld {
    /// Shares a world.
    pub fn new(world: World) -> SharedWorld {
        SharedWorld(Arc::new(Mutex::new(Shared { world, recorder: None })))
    }

    /// Runs `work` with exclusive access to the world. Time does not advance meanwhile.
    pub fn with<T>(&self, work: impl FnOnce(&mut World) -> T) -> T {
        work(&mut self.lock().world)
    }

    /// Starts a recording, replacing any earlier recorder.
    pub fn record(&self, mut recorder: Recorder) {
        let mut shared = self.lock();
        recorder.begin(&shared.world);
        shared.recorder = Some(recorder);
    }

    /// Checks whether the world is being recorded.
    pub fn is_recorded(&self) -> bool {
        self.lock().recorder.is_some()
    }

    /// Ends the recording. Returns a summary of each file, or the error that interrupted it. Empty
    /// without a recording.
    pub fn end_recording(&self) -> Vec<Result<String, RecordError>> {
        let mut shared = self.lock();
        let recorder = shared.recorder.take();
        recorder.map_or(vec![], |recorder| recorder.end(&shared.world))
    }

    fn lock(&self) -> MutexGuard<'_, Shared> {
        // Calls of the world are atomic: after a caller's panic, no call is half done.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl RobotBackend for SharedWorld {
    fn robots(&self) -> Vec<RobotId> {
        self.lock().world.robots()
    }

    fn start(&mut self, robot: &RobotId, id: GoalId, goal: Goal) {
        self.lock().world.start(robot, id, goal);
    }

    fn cancel(&mut self, robot: &RobotId, id: GoalId) {
        self.lock().world.cancel(robot, id);
    }

    fn request_person(&mut self, id: GoalId, ask: PersonRequest) {
        self.lock().world.request_person(id, ask);
    }

    fn cancel_person_request(&mut self, id: GoalId) {
        self.lock().world.cancel_person_request(id);
    }

    fn now(&self) -> WorldTime {
        self.lock().world.now()
    }

    fn next_due(&self) -> Option<WorldTime> {
        self.lock().world.next_due()
    }

    fn advance(&mut self, to: WorldTime) -> Vec<BackendEvent> {
        let mut shared = self.lock();
        let Shared { world, recorder } = &mut *shared;
        match recorder {
            None => world.advance(to),
            Some(recorder) => recorder.advance(world, to),
        }
    }

    fn goals(&self, robot: &RobotId) -> Vec<GoalId> {
        self.lock().world.goals(robot)
    }

    fn goal(&self, robot: &RobotId, id: GoalId) -> Option<Goal> {
        self.lock().world.goal(robot, id)
    }

    fn open_person_requests(&self) -> Vec<GoalId> {
        self.lock().world.open_person_requests()
    }

    fn person_result(&self, id: GoalId) -> Option<PersonResult> {
        self.lock().world.person_result(id)
    }

    fn was_person_request_canceled(&self, id: GoalId) -> bool {
        self.lock().world.was_person_request_canceled(id)
    }

    fn status(&self, robot: &RobotId, id: GoalId) -> Option<GoalStatus> {
        self.lock().world.status(robot, id)
    }

    fn telemetry(&self, robot: &RobotId) -> Option<Telemetry> {
        self.lock().world.telemetry(robot)
    }

    fn report(&self) -> serde_json::Value {
        self.lock().world.report()
    }

    fn range_readings(&self, robot: &RobotId) -> serde_json::Value {
        self.lock().world.range_readings(robot)
    }
}
