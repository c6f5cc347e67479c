//! A domain of tasks that always fail, each for a cause of another class.

use consort_protocol::cause::CauseClass;
use consort_protocol::yaml;
use consort_skills::domain_file::DomainFile;
use std::collections::BTreeMap;

const DOMAIN: &str = r#"
domain: failing
actions:
  fail_robot: { failures: { worn: { class: robot } }, simulate: { failures: { worn: 1.0 } } }
  fail_task: { failures: { forbidden: { class: task } }, simulate: { failures: { forbidden: 1.0 } } }
  fail_transient: { failures: { jammed: { class: transient } }, simulate: { failures: { jammed: 1.0 } } }
  fail_precondition: { failures: { no_tool: { class: precondition } }, simulate: { failures: { no_tool: 1.0 } } }
tasks:
  fail_robot: { action: fail_robot }
  fail_task: { action: fail_task }
  fail_transient: { action: fail_transient }
  fail_precondition: { action: fail_precondition }
"#;

/// Task types of the domain.
pub const FAILING_TASKS: [&str; 4] = ["fail_robot", "fail_task", "fail_transient", "fail_precondition"];

/// Returns the class of the cause for which a task of the domain fails; `None` for other tasks.
pub(crate) fn failure_class(task: &str) -> Option<CauseClass> {
    match task {
        "fail_robot" => Some(CauseClass::Robot),
        "fail_task" => Some(CauseClass::Task),
        "fail_transient" => Some(CauseClass::Transient),
        "fail_precondition" => Some(CauseClass::Precondition),
        _ => None,
    }
}

/// Returns the domain.
pub fn failing_domain() -> DomainFile {
    DomainFile::check(yaml::parse(DOMAIN).expect("YAML"), &BTreeMap::new(), &[]).expect("a valid domain")
}
