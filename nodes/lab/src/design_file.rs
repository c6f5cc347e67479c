//! Files of evaluation designs. Their keys are documented in [`consort_evaluation::design`].

use consort_evaluation::design::Design;
use consort_nodes::config::{ConfigFile, join_normalized, resolve_path};
use consort_nodes::map_loader::is_shipped;
use consort_protocol::mission::Domain;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The file of a design.
#[derive(Serialize, Deserialize)]
#[serde(transparent)]
pub struct DesignFile(pub Design);

impl ConfigFile for DesignFile {
    const KIND: &'static str = "design";

    fn resolve_paths(&mut self, folder: &Path) {
        let design = &mut self.0;
        if !is_shipped(&design.map) {
            design.map = join_normalized(folder, Path::new(&design.map)).display().to_string();
        }
        resolve_path(&mut design.travel.legs, folder);
    }

    /// Returns nothing: the design is checked with its mission, which may be another file.
    fn validate(&self, _: &Domain) -> Vec<String> {
        vec![]
    }
}
