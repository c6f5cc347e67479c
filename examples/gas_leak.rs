//! The laboratory of Consort with parts of its own in the simulator: gas that leaks from a valve, a sensor that
//! measures it, an action that closes the valve, and robots on tracks.

use consort_protocol::{ids::PlaceId, scalar::Scalar};
use consort_skills::actions::{ActionError, ErrorCode, Goal, GoalResult};
use consort_skills::extensions::Extensions;
use consort_tests::behavior::{OwnSteps, expect_that};
use consort_world::extend::nalgebra::{Isometry2, UnitComplex, Vector2};
use consort_world::extend::{
    Chassis, ChassisSettings, ComponentType, Entity, SimState, SimulatorExtension, System, SystemTimer, component_types,
};
use consort_world::world::WorldSetup;

/// The gas in the building, a component of the system below.
struct Gas {
    valve: (f64, f64),
    valve_open: bool,
    /// Concentration at the valve.
    ppm: f64,
}

struct GasSystem;

impl System for GasSystem {
    fn name(&self) -> &'static str {
        "gas"
    }

    fn reads(&self) -> Vec<ComponentType> {
        component_types![]
    }

    fn writes(&self) -> Vec<ComponentType> {
        component_types![Gas]
    }

    fn init_world(&self, state: &mut SimState, _: &WorldSetup) {
        let laboratory = PlaceId::new("Laboratory").expect("a name of a place");
        let Some(place) = state.map().place(&laboratory) else { return };
        let valve = (place.pose.x, place.pose.y);
        state.insert_resource(Gas { valve, valve_open: true, ppm: 2_000.0 });
        let clock = state.spawn();
        state.schedule(1.0, clock, 1);
    }

    /// Each second the gas spreads or disperses, and the sensors measure it.
    fn on_timer(&self, state: &mut SimState, SystemTimer { entity: clock, number }: SystemTimer) {
        let ((x, y), ppm) = {
            let mut gas = state.resource_mut::<Gas>();
            gas.ppm *= if gas.valve_open { 1.0 } else { 0.95 };
            (gas.valve, gas.ppm)
        };
        let robots: Vec<Entity> = state.robots().map(|(_, robot)| robot).collect();
        for robot in robots {
            let pose = state.robot_pose(robot);
            let distance_m = (pose.x - x).hypot(pose.y - y);
            state.set_reading(robot, "gas_ppm", Scalar::Number(ppm / (1.0 + distance_m)));
        }
        state.schedule(f64::from(number as u32 + 1), clock, number + 1);
    }

    /// Plays the actions that name this system: the valve is closed in five seconds, by a robot next to it.
    fn begin_goal(&self, state: &mut SimState, robot: Entity, _: &Goal) -> Option<Result<f64, ActionError>> {
        let (pose, (x, y)) = (state.robot_pose(robot), state.resource::<Gas>().valve);
        let in_reach = (pose.x - x).hypot(pose.y - y) < 1.0;
        let too_far = || ActionError::rejected(ErrorCode::OutOfReach, "the valve is out of reach".to_owned());
        Some(if in_reach { Ok(state.now_s() + 5.0) } else { Err(too_far()) })
    }

    fn finish_goal(&self, state: &mut SimState, _: Entity, _: &Goal) -> Result<GoalResult, ActionError> {
        state.resource_mut::<Gas>().valve_open = false;
        Ok(GoalResult::default())
    }
}

/// A robot on tracks: it turns on the spot, and then drives straight ahead.
#[derive(Debug)]
struct Tracks {
    pose: Isometry2<f64>,
    target: Option<Isometry2<f64>>,
    max_mps: f64,
    speed_mps: f64,
    turn_rps: f64,
}

impl Tracks {
    fn build(settings: &ChassisSettings) -> Result<Box<dyn Chassis>, String> {
        if let Some(name) = settings.numbers.keys().next() {
            return Err(format!("there is no setting {name}"));
        }
        let (pose, max_mps) = (settings.pose, settings.max_mps);
        Ok(Box::new(Tracks { pose, target: None, max_mps, speed_mps: 0.0, turn_rps: 0.0 }))
    }
}

impl Chassis for Tracks {
    fn set_target(&mut self, target: Option<Isometry2<f64>>) {
        self.target = target;
    }

    fn set_max_speed(&mut self, max_mps: f64) {
        self.max_mps = max_mps;
    }

    fn set_heading(&mut self, yaw_rad: f64) {
        self.pose.rotation = UnitComplex::new(yaw_rad);
    }

    fn stop_immediately(&mut self) {
        (self.target, self.speed_mps, self.turn_rps) = (None, 0.0, 0.0);
    }

    fn control_step(&mut self, period_s: f64) -> bool {
        (self.speed_mps, self.turn_rps) = (0.0, 0.0);
        let Some(target) = self.target else { return false };
        let to = target.translation.vector - self.pose.translation.vector;
        let arrived = to.norm() < 0.001;
        let heading = if arrived { target.rotation } else { UnitComplex::new(to.y.atan2(to.x)) };
        let error_rad = (heading * self.pose.rotation.inverse()).angle();
        if error_rad.abs() > 0.001 {
            self.turn_rps = (error_rad / period_s).clamp(-1.0, 1.0);
        } else if arrived {
            self.target = None;
            return true;
        } else {
            self.speed_mps = self.max_mps.min(to.norm() / period_s);
        }
        false
    }

    fn integrate(&mut self, dt_s: f64) {
        self.pose.translation.vector += self.pose.rotation * Vector2::new(self.speed_mps * dt_s, 0.0);
        self.pose.rotation *= UnitComplex::new(self.turn_rps * dt_s);
    }

    fn is_moving(&self) -> bool {
        self.target.is_some() || self.speed_mps != 0.0 || self.turn_rps != 0.0
    }

    fn pose(&self) -> Isometry2<f64> {
        self.pose
    }

    fn remaining_m(&self) -> f64 {
        self.target.map_or(0.0, |target| (target.translation.vector - self.pose.translation.vector).norm())
    }
}

const SIMULATOR: SimulatorExtension =
    SimulatorExtension { systems: &[&GasSystem], chassis: &[("tracks", Tracks::build)] };

pub(crate) const EXTENSIONS: Extensions = Extensions { simulator: Some(&SIMULATOR), ..Extensions::NONE };

/// Steps for scenarios.
pub(crate) fn steps() -> OwnSteps {
    OwnSteps::default()
        .fact("the valve is closed", "the valve is closed", |scenario, _| {
            let open = scenario.with_world(|world| world.state().resource::<Gas>().valve_open);
            expect_that(!open, || "it is open".to_owned())
        })
        .action("the valve bursts", "the valve bursts", async |scenario, _| {
            scenario.with_world(|world| {
                let mut gas = world.state().resource_mut::<Gas>();
                (gas.valve_open, gas.ppm) = (true, 5_000.0);
            });
            Ok(())
        })
}

fn main() -> std::process::ExitCode {
    consort_lab::cli::run_with_steps(EXTENSIONS, steps(), std::env::args_os())
}
