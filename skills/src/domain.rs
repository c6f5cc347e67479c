//! The standard domain: the task types of service robots in a hospital, with their parameters. The
//! skills in [`library`](crate::library) and the [services](shipped_domain) execute these tasks, and
//! the missions in [`missions`](crate::missions) use them.

use crate::domain_file::{DomainFile, DomainForm};
use crate::environment::Environment;
use crate::library::SkillLibrary;
use crate::standard_types::standard_types;
use consort_protocol::ids::{RoleId, TaskType};
use consort_protocol::mission::{Domain, IhtnNames};
use consort_protocol::yaml;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::LazyLock;

/// Returns the task types of the standard domain.
pub fn hospital() -> Domain {
    standard_types().with_types(shipped_domain().task_types()).with_ihtn_names(ihtn_names())
}

/// Returns the task types of the standard domain and of these domain files.
pub fn task_types_with<'a>(files: impl IntoIterator<Item = &'a DomainFile>) -> Domain {
    let add = |all: Domain, file: &DomainFile| all.with_types(file.task_types()).with_ihtn_names(file.ihtn_names());
    files.into_iter().fold(hospital(), add)
}

/// Returns the meaning of the names in the published flat iHTNs.
fn ihtn_names() -> IhtnNames {
    let navigation = || TaskType::new("navigation").expect("a slug");
    IhtnNames {
        people: BTreeSet::from([RoleId::new("nurse").expect("a slug")]),
        actions: BTreeMap::from([("navto".to_owned(), navigation())]),
        reaching: BTreeSet::from([navigation()]),
        ..IhtnNames::default()
    }
}

/// Returns the skills of the standard domain, in this environment.
pub fn standard_library(environment: Environment) -> SkillLibrary {
    let mut library = SkillLibrary::standard(environment);
    shipped_domain().extend_library(&mut library).expect("its names are unique");
    library
}

/// Returns the shipped domain file: services that are declared as data.
pub fn shipped_domain() -> &'static DomainFile {
    static SERVICES: LazyLock<DomainFile> = LazyLock::new(|| {
        let form: DomainForm = yaml::parse(include_str!("../domains/services.yaml")).expect("it is tested");
        let trees = BTreeMap::from([("carry.xml".to_owned(), include_str!("../domains/carry.xml").to_owned())]);
        DomainFile::check(form, &trees, &[]).expect("it is tested")
    });
    &SERVICES
}
