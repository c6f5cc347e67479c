//! A world that is hosted in one place and looked at from another.

use super::World;
use crate::record::{RecordError, Recorder};
use consort_protocol::ids::RobotId;
use consort_protocol::units::WorldTime;
use consort_skills::actions::{
    ActionError, BackendEvent, Goal, GoalId, GoalStatus, PersonRequest, RobotBackend, Telemetry,
};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A handle on a world; all clones are one world. It hosts bodies as the world itself does.
#[derive(Clone)]
pub struct SharedWorld(Arc<Mutex<Shared>>);

struct Shared {
    world: World,
    /// Whoever writes down what happens, if anybody does.
    recorder: Option<Recorder>,
}

impl SharedWorld {
    /// Shares a world.
    pub fn new(world: World) -> SharedWorld {
        SharedWorld(Arc::new(Mutex::new(Shared { world, recorder: None })))
    }

    /// Looks at the world, or changes it. Nothing happens in it meanwhile.
    pub fn with<T>(&self, look: impl FnOnce(&mut World) -> T) -> T {
        look(&mut self.lock().world)
    }

    /// Has all written down that happens from now on, in the place of any recorder before.
    pub fn record(&self, mut recorder: Recorder) {
        let mut shared = self.lock();
        recorder.begin(&shared.world);
        shared.recorder = Some(recorder);
    }

    /// Whether what happens is being written down.
    pub fn is_recorded(&self) -> bool {
        self.lock().recorder.is_some()
    }

    /// Has nothing more written down: what each file holds, in words, or why it does not hold all. Empty if nothing was.
    pub fn end_recording(&self) -> Vec<Result<String, RecordError>> {
        let mut shared = self.lock();
        let recorder = shared.recorder.take();
        recorder.map_or(vec![], |recorder| recorder.end(&shared.world))
    }

    fn lock(&self) -> MutexGuard<'_, Shared> {
        // The world's calls either happen or do not; a panic of whoever looked has left nothing half done.
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

    fn person_result(&self, id: GoalId) -> Option<Result<(), ActionError>> {
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
}
