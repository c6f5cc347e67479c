//! The library: its content, its errors, and its extension by users.

use super::*;
use consort_skills::bt::xml::{read_xml, write_xml};
use consort_skills::bt::{Cause, Leaf, LeafContext, NodeKind, NodeManifest, NodeStatus};
use consort_skills::domain::hospital;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

fn library() -> SkillLibrary {
    SkillLibrary::standard(environment())
}

fn load_error(task: &TaskSpec) -> String {
    match library().load(task, &context()) {
        Ok(_) => panic!("it was loaded"),
        Err(error) => error.to_string(),
    }
}

fn task_type(name: &str) -> TaskType {
    TaskType::new(name).unwrap()
}

/// Returns the tree files of the standard domain, by the name of their main tree.
fn tree_files() -> BTreeMap<String, String> {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("domains");
    let paths = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let trees = paths.filter(|path| path.extension().is_some_and(|extension| extension == "xml"));
    let name = |path: &Path| path.file_stem().unwrap().to_str().unwrap().to_owned();
    trees.map(|path| (name(&path), std::fs::read_to_string(&path).unwrap())).collect()
}

#[test]
fn every_tree_in_the_folder_is_a_skill_and_survives_being_written() {
    let library = library();
    for (name, file) in tree_files() {
        let spec = read_xml(&name, &file).unwrap();
        assert_eq!(spec.main, name);
        let written = write_xml(&spec, library.registry());
        let again = read_xml(&name, &written).unwrap_or_else(|error| panic!("{error}"));
        library.registry().check(&again).unwrap_or_else(|error| panic!("{error}"));
        assert!(library.task_types().any(|skill| skill.as_str() == name), "{name}");
    }
}

#[test]
fn the_models_in_the_files_are_those_of_the_leaves() {
    let library = library();
    for (name, file) in tree_files() {
        let written = write_xml(&read_xml("file", &file).unwrap(), library.registry());
        let models = |text: &str| -> Vec<String> {
            let (_, models) = text.split_once("<TreeNodesModel>").unwrap();
            let (models, _) = models.split_once("</TreeNodesModel>").unwrap();
            let model = |text: &str| text.split_once("</Action>").map(|(model, _)| format!("<Action{model}</Action>"));
            models.split("<Action").skip(1).filter_map(model).collect()
        };
        for model in models(&file) {
            assert!(models(&written).contains(&model), "{name}: {model}\nis none of\n{written}");
        }
    }
}

#[test]
fn domain_and_skills_require_the_same_parameters() {
    let (library, domain) = (library(), hospital());
    for skill in library.task_types() {
        let schema = domain.get(skill).unwrap_or_else(|| panic!("the domain lacks {skill}"));
        for input in library.parameters(skill).unwrap() {
            let parameter = schema.parameters.get(&input.key);
            let parameter = parameter.unwrap_or_else(|| panic!("the domain's {skill} lacks {}", input.key));
            assert_eq!(parameter.required, input.required, "{skill} {}", input.key);
        }
    }
}

#[test]
fn a_missing_skill_lists_the_known_skills() {
    assert_eq!(
        load_error(&task("juggle", &[])),
        "there is no skill for juggle; skills exist for alert, approach_person, approach_robot, ask_person, attend, \
         authenticate_person, carry, deposit, disinfect, dock, follow_path, grasp, measure_vital_signs, navigation, \
         operate_door, operate_drawer, pick_up, undock, wait"
    );
}

#[test]
fn parameters_are_checked_before_the_body_is_asked_for_anything() {
    assert_eq!(
        load_error(&task("navigation", &[("too", "C"), ("via", "B")])),
        "navigation needs the parameter `to` (a place); the task gives too, via"
    );
    assert_eq!(
        load_error(&task("operate_drawer", &[("action", "shut")])),
        "operate_drawer: {action}: \"shut\" is rejected: allowed are close, open"
    );
    assert!(
        load_error(&task("wait", &[("seconds", "soon")])).starts_with("wait: {seconds}: \"soon\" is not a duration")
    );
    assert!(load_error(&task("approach_robot", &[("robot_role", "a/b")])).contains("is not a role"));
}

/// A custom leaf.
struct Sing {
    verses: i64,
}

impl Leaf for Sing {
    fn tick(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        self.verses -= 1;
        match self.verses {
            0 => Ok(NodeStatus::Success),
            verses if verses < 0 => panic!("sang {} verses too many at {}", -verses, context.now().as_secs()),
            _ => Ok(NodeStatus::Running),
        }
    }

    fn halt(&mut self, _: &mut LeafContext<'_, '_>) {}
}

fn singing(verses: i64) -> SkillLibrary {
    let mut library = library();
    let manifest = NodeManifest::new("Sing", NodeKind::Action, []);
    library.extend(|registry| registry.register(manifest, move |_| Box::new(Sing { verses }))).unwrap();
    let xml = r#"<root BTCPP_format="4"><BehaviorTree ID="serenade">
        <Sequence><FindPerson person_role="{to}" role="{role}"/><approach_person role="{role}"/><Sing/></Sequence>
        </BehaviorTree></root>"#;
    library.register_xml(task_type("serenade"), "serenade.xml", xml).unwrap_or_else(|error| panic!("{error}"));
    library
}

#[test]
fn users_add_skills_of_custom_and_standard_leaves() {
    let library = singing(2);
    assert!(library.task_types().any(|known| known.as_str() == "serenade"));
    let mut skill = library.load(&task("serenade", &[("to", "nurse")]), &context()).unwrap_or_else(|e| panic!("{e}"));
    let mut driver = ScriptedDriver::at("A");
    assert_eq!(run(&mut skill, &mut driver), succeeded());
    assert_eq!(driver.sent(), ["approach person nurse"]);
}

fn with_skill(nodes: &str) -> SkillLibrary {
    let mut library = library();
    let xml = format!("<root BTCPP_format=\"4\"><BehaviorTree ID=\"mine\">{nodes}</BehaviorTree></root>");
    library.register_xml(task_type("mine"), "mine.xml", &xml).unwrap_or_else(|error| panic!("{error}"));
    library
}

#[test]
fn scripts_read_the_parameters_of_the_task() {
    let library = with_skill(r#"<wait time="1" _skipIf="urgent == true || count &gt; 3"/>"#);
    let ended = |urgent: &str, count: &str| {
        let task = task("mine", &[("urgent", urgent), ("count", count)]);
        let mut skill = library.load(&task, &context()).unwrap_or_else(|error| panic!("{error}"));
        let mut driver = ScriptedDriver::at("A");
        let status = run(&mut skill, &mut driver);
        (status, driver.sent().len())
    };
    assert_eq!(ended("false", "3"), (succeeded(), 1));
    assert_eq!(ended("true", "3"), (succeeded(), 0), "a skipped tree is a success");
    assert_eq!(ended("false", "4"), (succeeded(), 0));
    let (status, sent) = ended("maybe", "3");
    let expected = "mine.xml:1: mine/wait: script `_skipIf`: `urgent == true || count > 3`: \"maybe\" is not true or false: allowed are true and false";
    assert_eq!((status, sent), (failed(expected), 0));
    let error = library.load(&task("mine", &[("urgent", "1")]), &context()).err().unwrap().to_string();
    assert_eq!(error, "mine needs the parameter `count` (any value); the task gives urgent");
}

#[test]
fn an_error_of_a_script_cancels_the_goal() {
    let nodes = r#"<Parallel><wait time="9"/><Fallback><ScriptCondition code="'a' &lt; 1"/><wait time="1"/></Fallback></Parallel>"#;
    let mut skill = with_skill(nodes).load(&task("mine", &[]), &context()).unwrap_or_else(|error| panic!("{error}"));
    let mut driver = ScriptedDriver::at("A");
    let SkillStatus::Failed { cause, .. } = skill.tick(&mut driver) else { panic!("it did not fail") };
    assert!(cause.starts_with("mine.xml:1: mine/ScriptCondition: script `code`: `'a' < 1`: "), "{cause}");
    assert_eq!(driver.sent().len(), 1, "the fallback does not continue");
    assert!(driver.is_canceling());
}

#[test]
fn a_panic_in_a_custom_leaf_unwinds_to_the_caller() {
    let mut skill =
        singing(0).load(&task("serenade", &[("to", "nurse")]), &context()).unwrap_or_else(|e| panic!("{e}"));
    let mut driver = ScriptedDriver::at("A");
    assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
    driver.end_goal();
    let caught = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| skill.tick(&mut driver)));
    let message = caught.unwrap_err();
    assert_eq!(message.downcast_ref::<String>().unwrap(), "sang 1 verses too many at 0");
}

#[test]
fn a_tree_with_a_mistake_leaves_the_library_as_it_was() {
    let mut library = library();
    let xml = r#"<root BTCPP_format="4"><BehaviorTree ID="w"><wait/></BehaviorTree></root>"#;
    let error = library.register_xml(task_type("wait"), "mine.xml", xml).unwrap_err().to_string();
    assert_eq!(error, "mine.xml:1: w/wait: port `time` (a duration in seconds) is missing");
    library.load(&task("wait", &[("seconds", "1")]), &context()).unwrap_or_else(|e| panic!("{e}"));
}

#[test]
fn a_library_is_shared_and_a_skill_is_handed_to_another_thread() {
    fn shared<T: Send + Sync + 'static>() {}
    fn sent<T: Send + 'static>() {}
    shared::<SkillLibrary>();
    shared::<consort_skills::descriptor::Estimator>();
    sent::<ActiveSkill>();
}
