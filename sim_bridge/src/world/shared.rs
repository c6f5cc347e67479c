//! A world that is hosted in one place and looked at from another.

use super::World;
use consort_protocol::ids::RobotId;
use consort_protocol::units::WorldTime;
use consort_skills::actions::{ActionError, BodyEvent, BodyHost, Goal, GoalId, GoalStatus, PersonAsk, Telemetry};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A handle on a world; all clones are one world. It hosts bodies as the world itself does.
#[derive(Clone)]
pub struct SharedWorld(Arc<Mutex<World>>);

impl SharedWorld {
    /// Shares a world.
    pub fn new(world: World) -> SharedWorld {
        SharedWorld(Arc::new(Mutex::new(world)))
    }

    /// Looks at the world, or changes it. Nothing happens in it meanwhile.
    pub fn with<T>(&self, look: impl FnOnce(&mut World) -> T) -> T {
        look(&mut self.lock())
    }

    fn lock(&self) -> MutexGuard<'_, World> {
        // The world's calls either happen or do not; a panic of whoever looked has left nothing half done.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl BodyHost for SharedWorld {
    fn robots(&self) -> Vec<RobotId> {
        self.lock().robots()
    }

    fn start(&mut self, robot: &RobotId, id: GoalId, goal: Goal) {
        self.lock().start(robot, id, goal);
    }

    fn cancel(&mut self, robot: &RobotId, id: GoalId) {
        self.lock().cancel(robot, id);
    }

    fn ask_person(&mut self, id: GoalId, ask: PersonAsk) {
        self.lock().ask_person(id, ask);
    }

    fn dismiss_person(&mut self, id: GoalId) {
        self.lock().dismiss_person(id);
    }

    fn now(&self) -> WorldTime {
        self.lock().now()
    }

    fn next_due(&self) -> Option<WorldTime> {
        self.lock().next_due()
    }

    fn advance(&mut self, to: WorldTime) -> Vec<BodyEvent> {
        self.lock().advance(to)
    }

    fn goals(&self, robot: &RobotId) -> Vec<GoalId> {
        self.lock().goals(robot)
    }

    fn goal(&self, robot: &RobotId, id: GoalId) -> Option<Goal> {
        self.lock().goal(robot, id)
    }

    fn asks(&self) -> Vec<GoalId> {
        self.lock().asks()
    }

    fn answer(&self, id: GoalId) -> Option<Result<(), ActionError>> {
        self.lock().answer(id)
    }

    fn was_dismissed(&self, id: GoalId) -> bool {
        self.lock().was_dismissed(id)
    }

    fn status(&self, robot: &RobotId, id: GoalId) -> Option<GoalStatus> {
        self.lock().status(robot, id)
    }

    fn telemetry(&self, robot: &RobotId) -> Option<Telemetry> {
        self.lock().telemetry(robot)
    }

    fn report(&self) -> serde_json::Value {
        self.lock().report()
    }
}
