//! A Consort program with an extra skill: the robot turns in four steps, with a pause after each.

use consort_nodes::cli;
use consort_protocol::mission::{TaskSchema, TaskSpec, ValueKind};
use consort_protocol::{ids::TaskType, units::Seconds};
use consort_skills::descriptor::{Estimate, EstimateContext, EstimateError, SkillDescriptor};
use consort_skills::{actions, bt, environment::Environment, extensions::Extensions, skill};

const TREE: &str = r#"<root BTCPP_format="4"><BehaviorTree ID="look_around">
  <Repeat num_cycles="4"><Sequence><Turn degrees="90"/><wait time="{pause}"/></Sequence></Repeat>
</BehaviorTree></root>"#;

struct Price(TaskType);
impl SkillDescriptor for Price {
    fn task_type(&self) -> &TaskType {
        &self.0
    }
    fn required_descriptors(&self) -> Vec<&'static str> {
        vec![] // no map: it stays where it is
    }
    fn estimate(&self, task: &TaskSpec, robot: &EstimateContext, _: &Environment) -> Result<Estimate, EstimateError> {
        let pause = task.parameters.get("pause").and_then(|text| text.parse::<f64>().ok());
        let time = pause.and_then(|pause| Seconds::new(4.0 * (1.0 + pause)).ok());
        let lacks = EstimateError::MissingParameter { task_type: self.0.clone(), parameter: "pause".to_owned() };
        Ok(Estimate::of_duration(time.ok_or(lacks)?, robot, robot.place.clone()))
    }
}

fn look_around() -> TaskType {
    TaskType::new("look_around").expect("a slug")
}

fn main() -> std::process::ExitCode {
    cli::run_with(EXTENSIONS, std::env::args_os())
}

pub(crate) const EXTENSIONS: Extensions = Extensions {
    domain: |domain| domain.with(look_around(), TaskSchema::default().required("pause", ValueKind::Seconds)),
    descriptors: |descriptors| descriptors.with(Price(look_around())),
    library: |library| {
        let ports = [bt::PortSpec::input("degrees", bt::PortType::Number)];
        library.extend(|leaves| {
            skill::GoalLeaf::register(leaves, "Turn", ports, |_: &skill::TaskContext, leaf| {
                Ok(actions::Goal::from(actions::Spin { angle_rad: leaf.read::<f64>("degrees")?.to_radians() }))
            })
        })?;
        Ok(library.register_xml(look_around(), "look_around.xml", TREE)?)
    },
    ..Extensions::NONE
};
