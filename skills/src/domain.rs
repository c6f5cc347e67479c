//! The standard domain: service robots in a hospital. It is a [domain file](crate::domain_file) in
//! `skills/domains/`, and the missions in [`missions`](crate::missions) use its task types.

use crate::descriptor::DescriptorRegistry;
use crate::domain_file::{DomainFile, DomainForm, DomainProblem};
use crate::environment::Environment;
use crate::library::SkillLibrary;
use consort_protocol::mission::Domain;
use consort_protocol::yaml;
use std::collections::BTreeMap;
use std::sync::LazyLock;

/// Returns the task types of the standard domain.
pub fn hospital() -> Domain {
    task_types_with([])
}

/// Returns the task types of the standard domain and of these domain files.
pub fn task_types_with<'a>(files: impl IntoIterator<Item = &'a DomainFile>) -> Domain {
    let add = |all: Domain, file: &DomainFile| all.with_types(file.task_types()).with_ihtn_names(file.ihtn_names());
    files.into_iter().fold(add(Domain::default(), standard_domain()), add)
}

/// Returns the standard domain.
pub fn standard_domain() -> &'static DomainFile {
    static STANDARD: LazyLock<DomainFile> = LazyLock::new(|| {
        let form: DomainForm = yaml::parse(include_str!("../domains/standard.yaml")).expect("it is tested");
        let trees = TREES.map(|(name, text)| (name.to_owned(), text.to_owned()));
        let leaves = SkillLibrary::with_leaves(Environment::new());
        DomainFile::check_after(leaves, None, form, &BTreeMap::from(trees), &[]).expect("it is tested")
    });
    &STANDARD
}

/// Returns the actions of the drivers of devices of a building.
pub fn device_domain() -> &'static DomainFile {
    static DEVICES: LazyLock<DomainFile> = LazyLock::new(|| {
        let form: DomainForm = yaml::parse(include_str!("../domains/devices.yaml")).expect("it is tested");
        DomainFile::check(form, &BTreeMap::new(), &[]).expect("it is tested")
    });
    &DEVICES
}

impl DomainFile {
    /// Checks a domain that is used with the standard domain and the `known` domains. `trees` contains the texts
    /// of the [tree files](DomainForm::tree_files), by name.
    ///
    /// # Errors
    /// Every problem, in the order of the file.
    pub fn check(
        form: DomainForm,
        trees: &BTreeMap<String, String>,
        known: &[&DomainFile],
    ) -> Result<DomainFile, Vec<DomainProblem>> {
        let library = SkillLibrary::standard(Environment::new());
        DomainFile::check_after(library, Some(standard_domain()), form, trees, known)
    }
}

impl SkillLibrary {
    /// Creates the library of the standard domain, in this environment.
    pub fn standard(environment: Environment) -> SkillLibrary {
        let mut library = SkillLibrary::with_leaves(environment);
        standard_domain().extend_library(&mut library).expect("its names are unique");
        library
    }
}

impl DescriptorRegistry {
    /// Creates the descriptors of the standard domain, and of the two message steps.
    pub fn standard() -> DescriptorRegistry {
        standard_domain().extend_descriptors(DescriptorRegistry::of_messages())
    }
}

/// The tree files of the standard domain.
const TREES: [(&str, &str); 9] = [
    ("approach_person.xml", include_str!("../domains/approach_person.xml")),
    ("approach_robot.xml", include_str!("../domains/approach_robot.xml")),
    ("authenticate_person.xml", include_str!("../domains/authenticate_person.xml")),
    ("carry.xml", include_str!("../domains/carry.xml")),
    ("deposit.xml", include_str!("../domains/deposit.xml")),
    ("follow_path.xml", include_str!("../domains/follow_path.xml")),
    ("navigation.xml", include_str!("../domains/navigation.xml")),
    ("pick_up.xml", include_str!("../domains/pick_up.xml")),
    ("wait.xml", include_str!("../domains/wait.xml")),
];
