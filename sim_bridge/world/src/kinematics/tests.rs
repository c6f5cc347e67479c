//! Tests of the models alone: arrival, limits, and independence of the size of time steps.

use super::dubins::DubinsPath;
use super::motion_math::drive_arc;
use super::pid::{Pid, PidGains};
use super::*;
use nalgebra::{Isometry2, Vector2, Vector3};
use proptest::prelude::*;

const MAX_MPS: f64 = 1.2;

fn all() -> [(&'static str, Kinematics); 4] {
    [
        ("differential", Kinematics::Differential(DifferentialSettings::default())),
        ("omnidirectional", Kinematics::Omnidirectional(OmnidirectionalSettings::default())),
        ("ackermann", Kinematics::Ackermann(AckermannSettings::default())),
        ("aerial", Kinematics::Aerial(AerialSettings::default())),
    ]
}

fn pose(x: f64, y: f64, yaw: f64) -> Isometry2<f64> {
    Isometry2::new(Vector2::new(x, y), yaw)
}

fn built(kinematics: &Kinematics, max_mps: f64, radius_m: f64, pose: Isometry2<f64>) -> KinematicModel {
    KinematicModel::new(kinematics, max_mps, radius_m, pose, &[])
}

fn still(kinematics: &Kinematics) -> KinematicModel {
    built(kinematics, MAX_MPS, 0.25, Isometry2::identity())
}

/// Drives to the poses in turn with time steps of `dt_s`; returns the arrival time at the last.
fn course(mover: &mut KinematicModel, poses: &[Isometry2<f64>], dt_s: f64) -> f64 {
    let mut now = 0.0;
    for target in poses {
        mover.set_target(*target);
        let (began, mut arrived) = (now, None);
        while arrived.is_none() {
            assert!(now < began + 300.0, "never reached {target}: {:?}", mover.pose());
            arrived = mover.advance(dt_s, &[]).map(|after| now + after);
            now += dt_s;
        }
        let missed = (mover.pose().translation.vector - target.translation.vector).norm();
        assert!(missed < 0.03, "{missed} m beside {target}");
        let turned = (mover.pose().rotation / target.rotation).angle();
        assert!(turned.abs() < 0.03, "{turned} rad beside {target}");
        now = arrived.unwrap().max(now);
    }
    now
}

#[test]
fn a_course_takes_as_long_at_10_hz_as_at_60() {
    for (name, kinematics) in all() {
        let poses = [pose(8.0, 0.0, 0.0), pose(8.0, 5.0, 2.0), pose(-3.0, 1.0, -1.0), pose(0.0, 0.0, 0.0)];
        let [slow, fast, odd] = [0.1, 1.0 / 60.0, 0.037].map(|dt| course(&mut still(&kinematics), &poses, dt));
        assert!((slow - fast).abs() < 0.01 * fast, "{name}: {slow} s at 10 Hz, {fast} s at 60");
        assert!((odd - fast).abs() < 0.01 * fast, "{name}: {odd} s at 27 Hz, {fast} s at 60");
        assert!((20.0..90.0).contains(&fast), "{name}: {fast} s");
    }
}

#[test]
fn a_leg_ends_alike_with_any_time_step() {
    for (name, kinematics) in all() {
        let run = |dt: f64| {
            let mut mover = still(&kinematics);
            mover.set_target(pose(6.0, 4.0, 1.0));
            let (mut now, mut arrived) = (0.0, None);
            while arrived.is_none() && now < 60.0 {
                arrived = mover.advance(dt, &[]).map(|after| now + after);
                now += dt;
            }
            (arrived.unwrap_or(f64::NAN), mover.pose())
        };
        let (slow, slow_pose) = run(0.1);
        for dt in [1.0 / 60.0, 0.037, 1.7] {
            let (other, other_pose) = run(dt);
            assert!((slow - other).abs() < 1e-6, "{name}: {slow} s in steps of 0.1, {other} s in steps of {dt}");
            let apart = (slow_pose.translation.vector - other_pose.translation.vector).norm();
            assert!(apart < 0.025, "{name}: {apart} m apart");
        }
    }
}

#[test]
fn a_model_moves_only_with_a_target_and_brakes_to_standstill() {
    for (name, kinematics) in all() {
        let mut mover = still(&kinematics);
        assert!(!mover.is_moving());
        assert_eq!((mover.advance(10.0, &[]), mover.pose()), (None, Isometry2::identity()), "{name}");
        mover.set_target(pose(20.0, 0.0, 0.0));
        mover.advance(4.0, &[]);
        assert!(mover.is_moving());
        mover.brake();
        let at = mover.pose().translation.vector;
        assert_eq!(mover.advance(20.0, &[]), None);
        let rolled = (mover.pose().translation.vector - at).norm();
        assert!((0.01..MAX_MPS * MAX_MPS / 2.0 / 0.8 + 0.1).contains(&rolled), "{name} rolled {rolled} m");
        let there = mover.pose();
        mover.advance(1.0, &[]);
        assert_eq!((mover.pose(), mover.is_moving()), (there, false), "{name}");
    }
}

#[test]
fn a_straight_drive_takes_the_time_of_the_closed_form() {
    let (length, ramp) = (12.0, ProfileLimits { speed_mps: MAX_MPS, acceleration_mps2: 0.8, deceleration_mps2: 0.8 });
    let closed = TrapezoidProfile::new(length, ramp).duration_s();
    for (name, kinematics) in all().into_iter().filter(|(name, _)| *name != "aerial") {
        let took = course(&mut still(&kinematics), &[pose(length, 0.0, 0.0)], 0.02);
        let late = if name == "differential" { 2.5 } else { 0.05 };
        assert!((-0.05..late).contains(&(took - closed)), "{name}: {took} s, {closed} s in closed form");
    }
}

#[test]
fn a_drone_climbs_at_its_rate_and_holds_its_position() {
    let settings = AerialSettings { climb_mps: 0.5, height_m: 3.0, ..AerialSettings::default() };
    let mut mover = still(&Kinematics::Aerial(settings));
    let took = course(&mut mover, &[pose(1.0, 0.0, 0.0)], 0.05);
    assert!((6.0..6.5).contains(&took), "3 m up at 0.5 m/s: {took} s");
    mover.push(Vector3::new(0.0, 0.5, 0.0));
    mover.advance(0.1, &[]);
    let pushed = mover.position().y;
    assert!((0.01..0.1).contains(&pushed), "{pushed} m");
    assert_eq!(mover.advance(3.0, &[]), None, "it has arrived before");
    assert!((mover.position() - Vector3::new(1.0, 0.0, 3.0)).norm() < 0.001, "{:?}", mover.position());
}

#[test]
fn two_drones_pass_each_other_and_both_arrive() {
    let kinematics = Kinematics::Aerial(AerialSettings::default());
    let mut drones =
        [built(&kinematics, 3.0, 0.25, pose(0.0, 0.0, 0.0)), built(&kinematics, 3.0, 0.25, pose(12.0, 0.0, 0.0))];
    drones[0].set_target(pose(12.0, 0.0, 0.0));
    drones[1].set_target(pose(0.0, 0.0, 0.0));
    let mut arrived = [false; 2];
    for _ in 0..400 {
        let [a, b] = [drones[0].position(), drones[1].position()];
        assert!((a - b).norm() > 0.5, "crashed at {a} and {b}");
        for (n, offset) in [(0, b - a), (1, a - b)] {
            arrived[n] |= drones[n].advance(0.05, &[Neighbour { offset, radius_m: 0.25 }]).is_some();
        }
    }
    assert_eq!(arrived, [true, true]);
}

#[test]
fn an_invalid_setting_is_named() {
    let settings = DifferentialSettings { acceleration_mps2: 0.0, ..DifferentialSettings::default() };
    let said = Kinematics::Differential(settings).check().unwrap_err().to_string();
    assert_eq!(said, "acceleration_mps2 is 0, allowed is a number from 0.001 to 1000");
    assert!(all().iter().all(|(_, kinematics)| kinematics.check().is_ok()));
}

#[test]
fn the_integral_removes_the_steady_state_error() {
    // A plant that drifts by 0.5 a second regardless of its input.
    let settles = |ki| {
        let (mut pid, mut value) = (Pid::new(PidGains { kp: 2.0, ki, kd: 0.0 }), 0.0);
        for _ in 0..2000 {
            value += (pid.output(1.0 - value, 0.01, 5.0) - 0.5) * 0.01;
        }
        value
    };
    assert!((settles(0.0) - 0.75_f64).abs() < 0.01);
    assert!((settles(1.0) - 1.0_f64).abs() < 0.01);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn models_respect_limits_and_reach_every_pose(
        x in -8.0..8.0, y in -8.0..8.0, yaw in -3.0..3.0, changed in 0.0..6.0,
    ) {
        for (name, kinematics) in all() {
            let mut mover = still(&kinematics);
            mover.set_target(pose(-4.0, 3.0, 1.0));
            let period = if name == "aerial" { 0.05 } else { 0.02 };
            let (mut before, mut now, mut arrived) = (mover.copy(), 0.0, false);
            let mut told = false;
            while !(told && arrived) && now < 120.0 {
                if !told && now >= changed {
                    mover.set_target(pose(x, y, yaw));
                    told = true;
                }
                arrived = mover.advance(period, &[]).is_some();
                check_limits(name, &before, &mover, period)?;
                (before, now) = (mover.copy(), now + period);
            }
            prop_assert!(arrived, "{name} never arrived");
            let missed = (mover.pose().translation.vector - Vector2::new(x, y)).norm();
            prop_assert!(missed < 0.03, "{name}: {missed} m");
        }
    }

    #[test]
    fn an_arc_driven_backwards_leads_back(speed in -3.0..3.0, turn in -3.0..3.0, dt in 0.0..5.0, cut in 0.0..1.0) {
        let from = pose(1.0, -2.0, 0.5);
        let there = drive_arc(&from, speed, turn, dt);
        let back = drive_arc(&there, -speed, -turn, dt);
        prop_assert!((back.translation.vector - from.translation.vector).norm() < 1e-9);
        let halves = drive_arc(&drive_arc(&from, speed, turn, dt * cut), speed, turn, dt * (1.0 - cut));
        prop_assert!((halves.translation.vector - there.translation.vector).norm() < 1e-9);
    }

    #[test]
    fn an_omnidirectional_chassis_takes_equal_times_both_ways(x in -8.0..8.0, y in -8.0..8.0, yaw in -3.0..3.0) {
        let (kinematics, target) = (all()[1].1.clone(), pose(x, y, yaw));
        let there = course(&mut still(&kinematics), &[target], 0.02);
        let mut back = built(&kinematics, MAX_MPS, 0.25, target);
        let back = course(&mut back, &[Isometry2::identity()], 0.02);
        prop_assert!((there - back).abs() < 0.05, "{there} s there, {back} s back");
    }

    #[test]
    fn the_shortest_path_reaches_the_pose_within_the_radius(
        x in -6.0..6.0, y in -6.0..6.0, yaw in -3.1..3.1, radius in 0.3..2.0,
    ) {
        let end = pose(x, y, yaw);
        let path = DubinsPath::shortest(Isometry2::identity(), end, radius);
        let reached = path.pose_at(path.length_m());
        prop_assert!((reached.translation.vector - end.translation.vector).norm() < 1e-6, "{reached} for {end}");
        prop_assert!((reached.rotation / end.rotation).angle().abs() < 1e-6);
        prop_assert!(path.length_m() >= x.hypot(y) - 1e-9);
        let step = 0.01;
        for n in 0..(path.length_m() / step) as usize {
            let (a, b) = (path.pose_at(n as f64 * step), path.pose_at((n + 1) as f64 * step));
            prop_assert!((b.rotation / a.rotation).angle().abs() <= step / radius + 1e-9);
        }
    }

    #[test]
    fn a_straight_run_is_consistent(length in 0.0..50.0, speed in 0.1..4.0, up in 0.1..5.0, down in 0.1..5.0, share in 0.0..1.0) {
        let run = TrapezoidProfile::new(length, ProfileLimits { speed_mps: speed, acceleration_mps2: up, deceleration_mps2: down });
        let time = share * run.duration_s();
        prop_assert!((run.distance_at(run.duration_s()) - length).abs() < 1e-9);
        prop_assert!(run.speed_at(time) <= speed + 1e-9);
        // The distance is the integral of the speed.
        let parts = 2000;
        let sum: f64 = (0..parts).map(|n| run.speed_at((f64::from(n) + 0.5) * time / f64::from(parts))).sum();
        let driven = sum * time / f64::from(parts);
        prop_assert!((driven - run.distance_at(time)).abs() < 1e-3 * (1.0 + length), "{driven} m");
        // With the limits swapped, it is the same run backwards in time.
        let back = TrapezoidProfile::new(length, ProfileLimits { speed_mps: speed, acceleration_mps2: down, deceleration_mps2: up });
        prop_assert!((back.duration_s() - run.duration_s()).abs() < 1e-9);
        prop_assert!((length - back.distance_at(run.duration_s() - time) - run.distance_at(time)).abs() < 1e-6);
    }
}

fn check_limits(name: &str, before: &KinematicModel, after: &KinematicModel, period: f64) -> Result<(), TestCaseError> {
    let hair = 1e-9;
    if let (Some(a), Some(b)) = (before.as_differential(), after.as_differential()) {
        let (settings, (v0, w0), (v1, w1)) = (DifferentialSettings::default(), a.speeds(), b.speeds());
        prop_assert!(v1.abs() <= MAX_MPS + hair && w1.abs() <= settings.turn_rate_rps + hair, "{name}: {v1}, {w1}");
        prop_assert!((v1 - v0).abs() <= settings.acceleration_mps2 * period + hair, "{name}: from {v0} to {v1}");
        prop_assert!((w1 - w0).abs() <= settings.turn_acceleration_rps2 * period + hair, "{name}: from {w0} to {w1}");
    }
    if let (Some(a), Some(b)) = (before.as_omnidirectional(), after.as_omnidirectional()) {
        let (settings, (v0, w0), (v1, w1)) = (OmnidirectionalSettings::default(), a.velocity(), b.velocity());
        prop_assert!(v1.norm() <= MAX_MPS + hair && w1.abs() <= settings.turn_rate_rps + hair, "{name}: {v1}, {w1}");
        prop_assert!((v1 - v0).norm() <= settings.acceleration_mps2 * period + hair, "{name}: from {v0} to {v1}");
        prop_assert!((w1 - w0).abs() <= settings.turn_acceleration_rps2 * period + hair, "{name}: from {w0} to {w1}");
    }
    if let (Some(a), Some(b)) = (before.as_ackermann(), after.as_ackermann()) {
        let settings = AckermannSettings::default();
        prop_assert!((0.0..=MAX_MPS + hair).contains(&b.speed_mps()), "{name}: {}", b.speed_mps());
        let change = (b.speed_mps() - a.speed_mps()).abs();
        prop_assert!(change <= settings.acceleration_mps2 * period + hair, "{name}: by {change}");
        let turned = (b.pose().rotation / a.pose().rotation).angle().abs();
        prop_assert!(turned <= b.speed_mps() * period / settings.turning_radius_m + 1e-6, "{name}: turned {turned}");
    }
    if let (Some(a), Some(b)) = (before.as_aerial(), after.as_aerial()) {
        let (settings, v0, v1) = (AerialSettings::default(), a.velocity(), b.velocity());
        prop_assert!(v1.xy().norm() <= MAX_MPS + hair && v1.z.abs() <= settings.climb_mps + hair, "{name}: {v1}");
        let (level, climb) = ((v1.xy() - v0.xy()).norm(), (v1.z - v0.z).abs());
        prop_assert!(level <= settings.acceleration_mps2 * period + hair, "{name}: from {v0} to {v1}");
        prop_assert!(climb <= settings.climb_acceleration_mps2 * period + hair, "{name}: from {v0} to {v1}");
    }
    Ok(())
}

#[test]
fn a_constant_speed_run_takes_length_over_speed() {
    let run = TrapezoidProfile::constant_speed(6.0, 0.5);
    assert_eq!((run.duration_s(), run.distance_at(3.0)), (12.0, 1.5));
    assert_eq!((run.speed_at(0.1), run.speed_at(11.9), run.distance_at(99.0)), (0.5, 0.5, 6.0));
    let nowhere = TrapezoidProfile::constant_speed(0.0, 0.5);
    assert_eq!((nowhere.duration_s(), nowhere.distance_at(1.0)), (0.0, 0.0));
}
