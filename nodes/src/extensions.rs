//! What the robots of a program can do, beside what those of `consort` can: how a program with skills of its own is made.
//!
//! Such a program is `consort` itself, with all its commands, and a [`Kit`] put in: see `nodes/docs/tutorials/skill.md`. Nodes
//! of one fleet are to have one kit: whoever coordinates takes missions of the task types that it knows itself.

use crate::config::{Diagnostic, Diagnostics};
use consort_protocol::mission::Domain;
use consort_skills::descriptor::DescriptorRegistry;
use consort_skills::environment::Environment;
use consort_skills::library::SkillLibrary;
use std::error::Error;
use std::sync::OnceLock;

/// What is known of skills, in the three places where each is known: what missions may say of it, what it costs, and how it is
/// done. Each function is given what comes with Consort, and adds to it.
#[derive(Debug, Clone, Copy)]
pub struct Extensions {
    /// Adds the task types, with their parameters.
    pub domain: fn(Domain) -> Domain,
    /// Adds what tasks of these types cost a robot. A skill without a price is never awarded.
    pub descriptors: fn(DescriptorRegistry) -> DescriptorRegistry,
    /// Adds leaves and trees; an error is shown to people as it is.
    pub library: fn(&mut SkillLibrary) -> Result<(), Box<dyn Error>>,
}

/// The kit of this program. It is a matter of the program, like its version, and not of a node: files are judged by it before
/// there are any.
static KIT: OnceLock<Extensions> = OnceLock::new();

impl Default for Extensions {
    /// That of `consort`: nothing beside what is shipped.
    fn default() -> Extensions {
        Extensions { domain: |domain| domain, descriptors: |descriptors| descriptors, library: |_| Ok(()) }
    }
}

impl Extensions {
    /// Makes this the program's kit; called once, before anything else. A second one is not taken.
    pub(crate) fn install(self) {
        // The first one has been judged by already.
        let _ = KIT.set(self);
    }
}

fn kit() -> Extensions {
    KIT.get().copied().unwrap_or_default()
}

/// The task types that missions may use.
pub(crate) fn domain() -> Domain {
    (kit().domain)(Domain::hospital())
}

/// What tasks cost, where `shipped` is what is known of those that come with Consort.
pub(crate) fn descriptors(shipped: DescriptorRegistry) -> DescriptorRegistry {
    (kit().descriptors)(shipped)
}

/// How tasks are done in a place.
///
/// # Errors
/// [`Problems`] of what the program itself adds.
pub(crate) fn library(environment: Environment) -> Result<SkillLibrary, Diagnostics> {
    let mut library = SkillLibrary::standard(environment);
    (kit().library)(&mut library).map_err(|problem| Diagnostic::for_file("this program's own skills", problem))?;
    Ok(library)
}
