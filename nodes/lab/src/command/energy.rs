//! `consort-lab experiment energy`: the discharge of tasks and the charging of batteries, by recordings of a fleet.

use super::workload_flags::DomainFlags;
use consort_dashboard::fleet_model::FleetInput;
use consort_dashboard::recording::RecordingReader;
use consort_evaluation::calibration::DEFAULT_QUANTILE;
use consort_evaluation::energy::{
    ChargingFit, ChargingObserver, DischargeRatio, MIN_PASSAGES, TaskUse, discharge_ratios,
};
use consort_nodes::config;
use consort_nodes::exit::Failure;
use consort_nodes::output;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RobotId, TaskId, TaskType};
use consort_protocol::keys::Key;
use consort_protocol::mission::TaskBody;
use consort_protocol::view::{FleetView, MissionView};
use consort_skills::descriptor::{Calibration, DescriptorRegistry};
use consort_skills::extensions::Extensions;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Greatest rise of the charge in a task that counts, as a share: a step of a battery that reports hundredths. With a
/// greater rise the robot was charging.
const RISE_MAX: f64 = 0.0101;

/// Learns the discharge of tasks and the charging of batteries from recordings of a fleet
///
/// Compares the charge that each type of task has used with the estimates of the robots for the same durations, and
/// measures at which charge the batteries charge how fast. Writes both to a calibration file: robots of a fleet whose file
/// names it bid with the measured discharge, and forecast their stops at chargers with the measured charging.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort record --out monday.mcap --for 12h --connect tcp/192.0.2.1:7447
  consort-lab experiment energy monday.mcap tuesday.mcap --out calibration.toml
  consort-lab experiment energy monday.mcap --calibration learned/calibration.toml --out calibration.toml

A type of task counts with at least 5 tasks and a standard error of at most 10 %. A range of 5 % of the charge counts if
robots have charged through it at least 3 times.

Exit codes: 0 success; 1 the recordings contain too few data, or the file could not be written; 2 the flags or the files are
wrong.")]
pub(crate) struct Args {
    /// Recordings of the fleet, as `consort record` makes them
    #[arg(value_name = "FILE.mcap", required = true)]
    recordings: Vec<PathBuf>,
    /// The calibration file to write; an existing file is replaced
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// A calibration file to complete: what the recordings do not show is kept
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    #[command(flatten)]
    domains: DomainFlags,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for wrong flags or files; [`Failure::Unsuccessful`] if the recordings contain too few data, or the
/// calibration cannot be written.
pub(crate) fn run(args: &Args, extensions: Extensions) -> Result<(), Failure> {
    let extensions = args.domains.extend(extensions)?;
    let mut calibration: Calibration = match &args.calibration {
        Some(file) => config::load(file, &extensions.domain())?,
        None => Calibration {
            quantile: DEFAULT_QUANTILE,
            skills: BTreeMap::new(),
            to: BTreeMap::new(),
            from: BTreeMap::new(),
            legs: vec![],
            discharge: BTreeMap::new(),
            charging: None,
        },
    };
    let multiples = extensions.descriptors(DescriptorRegistry::standard()).discharge_multiples();
    let (mut tasks, mut charging) = (vec![], ChargingObserver::default());
    for file in &args.recordings {
        let reader = RecordingReader::open(file).map_err(|problem| Failure::Usage(problem.to_string()))?;
        if let Some(problem) = reader.damage() {
            output::note(format_args!("{}: {problem}; the readable part is used", file.display()));
        }
        let mut observer = TaskObserver::default();
        for input in reader.valid_inputs() {
            observer.apply(input, &mut charging);
        }
        charging.end_sessions();
        tasks.extend(observer.task_uses(&multiples));
    }
    let (ratios, fit) = (discharge_ratios(&tasks), charging.fit());
    output::line(discharge_table(&ratios))?;
    output::line(describe_charging(fit.as_ref()))?;
    let certain: Vec<_> = ratios.iter().filter_map(|(skill, ratio)| Some((skill.clone(), ratio.certain()?))).collect();
    if certain.is_empty() && fit.is_none() {
        return Err(Failure::Unsuccessful("the recordings contain too few data; nothing is written".to_owned()));
    }
    calibration.discharge.extend(certain);
    calibration.charging = fit.map(|fit| fit.charging).or(calibration.charging);
    let text = config::to_toml(&calibration);
    std::fs::write(&args.out, text)
        .map_err(|problem| Failure::Unsuccessful(format!("{} cannot be written: {problem}", args.out.display())))?;
    output::line(format_args!("see {}", args.out.display()))
}

fn discharge_table(ratios: &BTreeMap<TaskType, DischargeRatio>) -> String {
    let head = ["task type", "tasks", "discharge / estimate", "standard error", ""].map(str::to_owned).to_vec();
    let line = |(skill, ratio): (&TaskType, &DischargeRatio)| {
        let DischargeRatio { tasks, ratio: of_estimate, error } = ratio;
        let note = if ratio.certain().is_some() { "" } else { "too few tasks, not used" };
        let [of_estimate, error] = [of_estimate, error].map(|number| format!("{number:.3}"));
        vec![skill.to_string(), tasks.to_string(), of_estimate, error, note.to_owned()]
    };
    output::table(&std::iter::once(head).chain(ratios.iter().map(line)).collect::<Vec<_>>())
}

fn describe_charging(fit: Option<&ChargingFit>) -> String {
    match fit {
        Some(ChargingFit { charging, from, to, passages }) => {
            let (rate, from, to) = (charging.share_per_s.get() * 6000.0, from * 100.0, to * 100.0);
            format!(
                "charging: {rate:.2} % per minute at full power; measured from {from:.0} to {to:.0} % in {passages} \
                 passages of 5 %"
            )
        }
        None => {
            format!("charging: too few data; no 5 % of the charge were charged {MIN_PASSAGES} times without a pause")
        }
    }
}

/// Battery of a robot at an instant.
#[derive(Clone, Copy)]
struct BatteryReport {
    /// Time of the world in seconds.
    time_s: f64,
    charge: f64,
}

/// Task in progress.
struct RunningTask {
    mission: MissionId,
    task: TaskId,
    began: BatteryReport,
}

/// Task that has ended.
struct EndedTask {
    robot: RobotId,
    mission: MissionId,
    task: TaskId,
    time_s: f64,
    used_share: f64,
}

/// Observer of the tasks in a recording. The times of tasks are those of the latest telemetry before their events, so
/// that time and charge belong together.
#[derive(Default)]
struct TaskObserver {
    latest: BTreeMap<RobotId, BatteryReport>,
    running: BTreeMap<RobotId, RunningTask>,
    ended: Vec<EndedTask>,
    /// Types of tasks, from the views of missions.
    task_types: BTreeMap<(MissionId, TaskId), TaskType>,
    /// Discharge rates that the robots publish.
    rates: BTreeMap<RobotId, f64>,
}

impl TaskObserver {
    /// Applies an input of the recording. `charging` receives the charge of the robots.
    fn apply(&mut self, input: FleetInput, charging: &mut ChargingObserver) {
        match input {
            FleetInput::Telemetry { robot, telemetry, .. } => {
                let Ok(robot) = robot.parse::<RobotId>() else { return };
                let (time_s, charge) = (telemetry.time.as_secs(), telemetry.battery.get());
                charging.report(&robot, time_s, charge, &telemetry.place);
                self.latest.insert(robot, BatteryReport { time_s, charge });
            }
            FleetInput::Event(event) => self.apply_event(RobotId::from(event.node), event.kind),
            FleetInput::View { key: Key::ViewFleet, view } => {
                let Ok(view) = serde_json::from_value::<FleetView>(view) else { return };
                for node in view.nodes {
                    if let Some(robot) = node.record.robot {
                        self.rates.insert(RobotId::from(node.node), robot.discharge.get());
                    }
                }
            }
            FleetInput::View { key: Key::ViewMission(mission), view } => {
                let Ok(view) = serde_json::from_value::<MissionView>(view) else { return };
                for task in view.tasks {
                    if let TaskBody::Elementary(spec) = task.body {
                        self.task_types.insert((mission.clone(), task.id), spec.task_type);
                    }
                }
            }
            FleetInput::View { .. } | FleetInput::Beacon(_) | FleetInput::Links(_) => {}
        }
    }

    fn apply_event(&mut self, robot: RobotId, event: EventKind) {
        match event {
            EventKind::TaskBegan { mission, task, .. } => {
                self.running.remove(&robot);
                if let Some(began) = self.latest.get(&robot).copied() {
                    self.running.insert(robot, RunningTask { mission, task, began });
                }
            }
            EventKind::TaskEnded { mission, task, .. } => {
                let running = self.running.remove(&robot);
                let running = running.filter(|running| (&running.mission, &running.task) == (&mission, &task));
                if let Some((running, now)) = running.zip(self.latest.get(&robot)) {
                    let time_s = now.time_s - running.began.time_s;
                    let used_share = running.began.charge - now.charge;
                    self.ended.push(EndedTask { robot, mission, task, time_s, used_share });
                }
            }
            // The robot does not work all the time.
            EventKind::TaskRetried { .. } | EventKind::Suspended { .. } | EventKind::Halted { .. } => {
                self.running.remove(&robot);
            }
            _ => {}
        }
    }

    /// Returns the ended tasks of which the type and the estimate are known. `multiples` are those of the estimates.
    fn task_uses(&self, multiples: &BTreeMap<TaskType, f64>) -> Vec<TaskUse> {
        let task_use = |ended: &EndedTask| {
            let EndedTask { robot, mission, task, time_s, used_share } = ended;
            let skill = self.task_types.get(&(mission.clone(), task.clone()))?;
            let estimated_share = self.rates.get(robot)? * multiples.get(skill)? * time_s;
            let is_sound = *time_s > 0.0 && *used_share >= -RISE_MAX;
            is_sound.then(|| TaskUse { skill: skill.clone(), estimated_share, used_share: *used_share })
        };
        self.ended.iter().filter_map(task_use).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::event::Event;
    use consort_protocol::ids::RoleId;
    use consort_protocol::ledger::MissionState;
    use consort_protocol::mission::{TaskNode, TaskSpec};
    use serde_json::json;

    fn report(time_s: f64, battery: f64) -> FleetInput {
        let telemetry = json!({
            "time": time_s, "pose": { "x_m": 1.0, "y_m": 2.5, "yaw_rad": 0.5 }, "place": "Dock", "battery": battery,
            "able": true, "closed": [],
        });
        let telemetry = serde_json::from_value(telemetry).unwrap();
        FleetInput::Telemetry { robot: "ada".to_owned(), telemetry, feedback: BTreeMap::new() }
    }

    fn event(kind: EventKind) -> FleetInput {
        FleetInput::Event(Box::new(Event { node: "ada".parse().unwrap(), sequence: 1, at_ms: 1, kind }))
    }

    /// Returns a task from one charge to another, which takes 10 s.
    fn task(time_s: f64, charges: [f64; 2], disturbed: bool) -> Vec<FleetInput> {
        let (mission, role): (MissionId, RoleId) = ("m-1".parse().unwrap(), "r1".parse().unwrap());
        let task: TaskId = "go".parse().unwrap();
        let began = EventKind::TaskBegan { mission: mission.clone(), role: role.clone(), task: task.clone() };
        let mut inputs = vec![report(time_s, charges[0]), event(began)];
        if disturbed {
            let (mission, role) = (mission.clone(), role.clone());
            inputs.push(event(EventKind::Suspended { mission, role, lease_left_ms: 0 }));
        }
        inputs.extend([report(time_s + 10.0, charges[1]), event(EventKind::TaskEnded { mission, role, task })]);
        inputs
    }

    #[test]
    fn tasks_are_compared_with_the_published_rate_and_the_declared_multiple() {
        let spec = TaskSpec::of("navigation".parse().unwrap(), vec!["r1".parse().unwrap()]);
        let tasks = vec![TaskNode { id: "go".parse().unwrap(), body: TaskBody::Elementary(spec) }];
        let robot = json!({
            "skills": ["navigation"], "attributes": {}, "place": "Dock",
            "pose": { "x_m": 1.0, "y_m": 2.5, "yaw_rad": 0.5 }, "battery": 0.8, "discharge": 0.001, "useful_charge": 0.08,
            "speed": 0.7, "availability": "free", "estimator": "e",
        });
        let fleet = json!({ "nodes": [{ "node": "ada", "seen_by": "s1", "robot": robot }] });
        let mission = json!({ "mission": "m-1", "detail": MissionState::Running, "tasks": tasks });
        let mut inputs = vec![FleetInput::View { key: Key::ViewFleet, view: fleet }];
        for number in 0..6 {
            let charge = 0.9 - f64::from(number) * 0.03;
            inputs.extend(task(f64::from(number) * 20.0, [charge, charge - 0.03], false));
        }
        inputs.extend(task(200.0, [0.5, 0.4], true));
        inputs.extend(task(220.0, [0.3, 0.4], false));
        inputs.push(FleetInput::View { key: Key::ViewMission("m-1".parse().unwrap()), view: mission });
        let (mut observer, mut charging) = (TaskObserver::default(), ChargingObserver::default());
        for input in inputs {
            observer.apply(input, &mut charging);
        }
        let skill: TaskType = "navigation".parse().unwrap();
        let ratios = discharge_ratios(&observer.task_uses(&BTreeMap::from([(skill.clone(), 2.0)])));
        let ratio = ratios[&skill];
        assert!(ratio.tasks == 6 && (ratio.certain().unwrap() - 1.5).abs() < 1e-9, "{ratio:?}");
        assert_eq!(observer.task_uses(&BTreeMap::new()), [], "the type has an energy of its own");
        let table = discharge_table(&ratios);
        assert!(table.contains("navigation") && !table.contains("too few"), "{table}");
        assert!(describe_charging(charging.fit().as_ref()).contains("too few data"));
    }
}
