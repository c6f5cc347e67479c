//! The adapter of a rover: a robot driver on the fleet's bus. The rover itself is simulated in
//! `current_pose`.

use consort_fleet::node::{DriverServerPart, NodeSettings};
use consort_nodes::config::{NodeFile, StationConfig, load};
use consort_nodes::wiring::{NodeIncarnation, station_node};
use consort_nodes::{exit::Failure, map_loader, node_runtime};
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, Metres, MetresPerSecond, WorldTime};
use consort_skills::actions::*;
use consort_skills::extensions::Extensions;
use std::collections::BTreeMap;
use std::path::Path;

struct Rover {
    name: RobotId,
    place: PlaceId,
    pose: Pose,
    now: WorldTime,
    work: Option<Work>,
    /// Goals that have ended. Their status can still be queried.
    ended: BTreeMap<GoalId, (Goal, GoalStatus)>,
    /// Events since the last call of `advance`.
    news: Vec<BackendEvent>,
}

#[derive(Clone)]
struct Work {
    id: GoalId,
    goal: Goal,
    from: Pose,
    began: WorldTime,
    due: WorldTime,
}

impl Rover {
    fn end(&mut self, id: GoalId, goal: Goal, status: GoalStatus) {
        self.ended.insert(id, (goal, status.clone()));
        self.news.push(BackendEvent::GoalEnded { robot: self.name.clone(), goal: id, status });
    }

    fn refuse(&mut self, id: GoalId, goal: Goal, code: ErrorCode, message: &str) {
        let message = format!("{}: {message}", self.name);
        self.end(id, goal, GoalStatus::Aborted(ActionError::new(code, message)));
    }

    /// Pose by the odometry. Here it lies on a straight line between both ends of the drive.
    fn where_it_is(&self) -> Pose {
        let Some(Work { goal, from, began, due, .. }) = &self.work else { return self.pose };
        let Some(Ok(NavigateToPose { pose: to, .. })) = goal.read() else { return self.pose };
        let done = ((self.now - *began).get() / (*due - *began).get().max(1e-9)).min(1.0);
        Pose::new(from.x + done * (to.x - from.x), from.y + done * (to.y - from.y), to.yaw)
    }
}

impl RobotBackend for Rover {
    fn robots(&self) -> Vec<RobotId> {
        vec![self.name.clone()]
    }
    fn serves_people(&self) -> bool {
        false
    }
    fn start(&mut self, robot: &RobotId, id: GoalId, goal: Goal) {
        if *robot != self.name || self.goal(robot, id).is_some() {
            return; // somebody else's, or repeated
        }
        if self.work.is_some() {
            return self.refuse(id, goal, ErrorCode::Busy, "it is at work");
        }
        let drive =
            |NavigateToPose { pose, .. }| self.pose.distance(pose).at(MetresPerSecond::new(0.5).expect("a speed"));
        let wait = |Wait { time }| time;
        let time = match goal.read().map(|goal| goal.map(drive)).or_else(|| goal.read().map(|goal| goal.map(wait))) {
            Some(Ok(time)) => time,
            Some(Err(error)) => return self.end(id, goal, GoalStatus::Aborted(error)),
            None => return self.refuse(id, goal, ErrorCode::Unknown, "it can drive and wait, and nothing else"),
        };
        self.work = Some(Work { id, goal, from: self.pose, began: self.now, due: self.now + time });
    }
    fn cancel(&mut self, _: &RobotId, id: GoalId) {
        self.pose = self.where_it_is();
        if let Some(work) = self.work.take_if(|work| work.id == id) {
            self.end(id, work.goal, GoalStatus::Canceled);
        }
    }
    fn now(&self) -> WorldTime {
        self.now
    }
    fn next_due(&self) -> Option<WorldTime> {
        if self.news.is_empty() { self.work.as_ref().map(|work| work.due) } else { Some(self.now) }
    }
    fn advance(&mut self, to: WorldTime) -> Vec<BackendEvent> {
        self.now = to;
        if let Some(work) = self.work.take_if(|work| work.due <= to) {
            if let Some(Ok(NavigateToPose { pose, place, .. })) = work.goal.read() {
                self.pose = pose;
                self.place = place.unwrap_or(self.place.clone());
            }
            self.end(work.id, work.goal, GoalStatus::succeeded());
        }
        std::mem::take(&mut self.news)
    }
    fn status(&self, _: &RobotId, id: GoalId) -> Option<GoalStatus> {
        let left = |work: &Work| {
            let way = match work.goal.read() {
                Some(Ok(NavigateToPose { pose, .. })) => self.where_it_is().distance(pose),
                _ => Metres::ZERO,
            };
            GoalStatus::Executing(Feedback::remaining(way, work.due - self.now))
        };
        let at_work = self.work.as_ref().filter(|work| work.id == id).map(left);
        at_work.or_else(|| self.ended.get(&id).map(|(_, status)| status.clone()))
    }
    fn goals(&self, _: &RobotId) -> Vec<GoalId> {
        self.ended.keys().copied().chain(self.work.iter().map(|work| work.id)).collect()
    }
    fn goal(&self, _: &RobotId, id: GoalId) -> Option<Goal> {
        let at_work = self.work.as_ref().filter(|work| work.id == id).map(|work| work.goal.clone());
        at_work.or_else(|| self.ended.get(&id).map(|(goal, _)| goal.clone()))
    }
    fn telemetry(&self, robot: &RobotId) -> Option<Telemetry> {
        let (time, pose, place, battery) = (self.now, self.where_it_is(), self.place.clone(), BatteryShare::FULL);
        let (closed, readings) = (vec![], BTreeMap::new());
        (*robot == self.name).then_some(Telemetry { time, pose, place, battery, able: true, closed, readings })
    }
    // This adapter has no human tasks.
    fn request_person(&mut self, _: GoalId, _: PersonRequest) {}
    fn cancel_person_request(&mut self, _: GoalId) {}
    fn open_person_requests(&self) -> Vec<GoalId> {
        vec![]
    }
    fn person_result(&self, _: GoalId) -> Option<PersonResult> {
        None
    }
    fn was_person_request_canceled(&self, _: GoalId) -> bool {
        false
    }
}

/// Runs the adapter's node: `rover FILE ROBOT PLACE`.
pub(crate) fn adapt(file: &str, robot: &str, place: &str) -> Result<(), Failure> {
    let wrong = Failure::Usage;
    let extensions = Extensions::default();
    let mut station: StationConfig = load(Path::new(file), &extensions.domain())?;
    let fleet = station.fleet.resolve(&extensions.domain())?;
    let place: PlaceId = place.parse().map_err(|problem| wrong(format!("{problem}")))?;
    let name: RobotId = robot.parse().map_err(|problem| wrong(format!("{problem}")))?;
    let Some(pose) = map_loader::load(&fleet.map)?.topology.places.get(&place).copied() else {
        return Err(wrong(format!("{place} is not on the fleet's map")));
    };
    let (now, work, ended, news) = (WorldTime::ZERO, None, BTreeMap::new(), vec![]);
    let rover = Rover { name, place, pose, now, work, ended, news };
    let node = station.clone();
    node_runtime::run_node(false, &station.common_mut(), &fleet, || {
        let incarnation = NodeIncarnation::start(&node.name, &fleet, node.data_dir.as_deref())?;
        let host = DriverServerPart { world: Box::new(rover), speed: 1.0 };
        Ok(NodeSettings { driver_server: Some(host), ..station_node(&node, &fleet, incarnation, extensions)? })
    })
}

fn main() -> std::process::ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let ended = match args.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [file, robot, place] => adapt(file, robot, place),
        _ => Err(Failure::Usage("rover FILE ROBOT PLACE".to_owned())),
    };
    if let Err(failure) = &ended {
        consort_nodes::output::note(format_args!("rover: {failure}"));
    }
    ended.map_or_else(|failure| failure.code(), |()| std::process::ExitCode::SUCCESS)
}
