//! Behavior trees, conditions and features.

use super::frames::text;
use super::scratch;
use consort_protocol::ensemble::{Ensemble, EnsembleSpec};
use consort_protocol::ids::{EnsembleId, NodeId, TaskType};
use consort_protocol::knowledge::{Knowledge, KnowledgeBase, Record, RecordStamp};
use consort_protocol::units::NodeTime;
use consort_skills::bt::xml::{read_xml, write_xml};
use consort_skills::bt::{NodeSpec, TreeSpec};
use consort_skills::library::SkillLibrary;
use consort_tests::behavior::{Features, ScenarioFilter};
use std::collections::BTreeSet;
use std::sync::OnceLock;

fn library() -> &'static SkillLibrary {
    static LIBRARY: OnceLock<SkillLibrary> = OnceLock::new();
    LIBRARY.get_or_init(|| {
        let map = consort_world::map::shipped("hospital").expect("it is shipped");
        SkillLibrary::standard(map.environment().expect("it is sound"))
    })
}

/// Removes the line numbers from a tree.
fn without_positions(spec: &TreeSpec) -> TreeSpec {
    fn strip_positions(node: &NodeSpec) -> NodeSpec {
        NodeSpec { line: None, children: node.children.iter().map(strip_positions).collect(), ..node.clone() }
    }
    let trees = spec.trees.iter().map(|(id, root)| (id.clone(), strip_positions(root)));
    TreeSpec { trees: trees.collect(), ..spec.clone() }
}

/// An accepted tree can be written for its editor; an error contains its location.
pub(super) fn tree(bytes: &[u8]) -> bool {
    let Some(text) = text(bytes) else { return false };
    let spec = match read_xml("a.xml", text) {
        Ok(spec) => spec,
        Err(problem) => {
            assert!(problem.to_string().contains("a.xml"), "{problem}");
            return false;
        }
    };
    match library().registry().check(&spec) {
        Ok(_) => {
            let xml = write_xml(&spec, library().registry());
            let again = read_xml("a.xml", &xml).expect("what was written can be read");
            assert_eq!(without_positions(&again), without_positions(&spec), "it reads back as something else");
            true
        }
        Err(problem) => {
            assert!(problem.to_string().contains("a.xml"), "{problem}");
            false
        }
    }
}

/// Conditions, each on its own line, are rejected by name or apply to every node.
pub(super) fn condition(bytes: &[u8]) -> bool {
    let Some(text) = text(bytes) else { return false };
    let skills = BTreeSet::from([TaskType::new("navigation").expect("a slug")]);
    let spec = EnsembleSpec::with_any_skill_of(EnsembleId::new("all").expect("a slug"), skills);
    let (own, heads): (Vec<&str>, Vec<&str>) = text.lines().take(4).partition(|line| !line.contains("coordinator"));
    let owned = |lines: Vec<&str>| lines.into_iter().map(str::to_owned).collect();
    let spec = EnsembleSpec { membership: owned(own), coordinator: owned(heads), ..spec };
    match Ensemble::compile(spec) {
        Ok(ensemble) => {
            let ada = NodeId::new("ada").expect("a slug");
            let mut base = KnowledgeBase::default();
            base.merge(
                Record { owner: ada.clone(), stamp: RecordStamp::default(), knowledge: station(), proof: None },
                NodeTime::ZERO,
            );
            let believed = ensemble.membership_of(&ada, &ada, &base, NodeTime::ZERO);
            assert!(!believed.reason.is_empty());
            true
        }
        Err(problem) => {
            assert!(problem.to_string().starts_with("ensemble all: condition `"), "{problem}");
            false
        }
    }
}

fn station() -> Knowledge {
    Knowledge { stationary: true, mains_powered: true, replica: Some(1), ..Knowledge::of(None) }
}

/// The problems of a feature contain its file.
pub(super) fn feature(bytes: &[u8]) -> bool {
    let file = scratch::file("a.feature", bytes);
    match Features::read(&[file], &ScenarioFilter::default()) {
        Ok(features) => features.scenarios() > 0,
        Err(bad) => {
            assert!(bad.0.iter().all(|problem| problem.contains("a.feature") || problem.contains("no scenario")));
            false
        }
    }
}
