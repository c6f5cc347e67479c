//! Recordings of a simulated world: MCAP and SVG files.

use crate::diagnostic::{Diagnostic, Diagnostics};
use crate::exit::Failure;
use consort_world::SharedWorld;
use consort_world::record::{Recorder, RecordingOutputs};
use std::path::PathBuf;

/// Flags for recordings of a world. Without them nothing is recorded, and nothing is spent.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Rendering")]
pub(crate) struct RenderFlags {
    /// Record the world to this MCAP file, for Foxglove. Positions of robots are written ten times
    /// per second of world time while they move, and not while they stand
    #[arg(long, value_name = "FILE.mcap")]
    record: Option<PathBuf>,
    /// Draw the driven paths to this SVG file, when the world ends
    #[arg(long, value_name = "FILE.svg")]
    svg: Option<PathBuf>,
}

impl RenderFlags {
    /// Returns true if anything is to be recorded.
    pub(crate) fn is_enabled(&self) -> bool {
        self.record.is_some() || self.svg.is_some()
    }

    /// Starts recording a world, if requested.
    ///
    /// # Errors
    /// [`Diagnostics`] of the files.
    pub(crate) fn start_recording(&self, world: &SharedWorld) -> Result<(), Diagnostics> {
        let outputs = RecordingOutputs { mcap: self.record.clone(), svg: self.svg.clone() };
        let recorder = Recorder::open(&outputs).map_err(|problem| Diagnostic::for_file("", problem))?;
        if let Some(recorder) = recorder {
            world.record(recorder);
        }
        Ok(())
    }
}

/// Completes the recordings of a world, and passes a line for each file to `report`.
///
/// # Errors
/// [`Failure::Unsuccessful`] if a file is incomplete.
pub(crate) fn finish_recording(world: &SharedWorld, mut report: impl FnMut(&str)) -> Result<(), Failure> {
    let mut problems = vec![];
    for file in world.end_recording() {
        match file {
            Ok(words) => report(&words),
            Err(problem) => problems.push(problem.to_string()),
        }
    }
    if problems.is_empty() { Ok(()) } else { Err(Failure::Unsuccessful(problems.join("\n"))) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{FleetConfig, WorldConfig};
    use crate::wiring::build_world;
    use consort_skills::extensions::Extensions;

    #[test]
    fn a_world_without_the_options_has_no_recorder() {
        let world = SharedWorld::new(
            build_world(&WorldConfig::default(), &FleetConfig::default(), Extensions::default()).unwrap(),
        );
        let none = RenderFlags::default();
        none.start_recording(&world).unwrap();
        assert!(!none.is_enabled() && !world.is_recorded());
        finish_recording(&world, |words| panic!("{words}")).unwrap();
    }

    #[test]
    fn an_unwritable_file_is_reported_before_anything_starts() {
        let world = SharedWorld::new(
            build_world(&WorldConfig::default(), &FleetConfig::default(), Extensions::default()).unwrap(),
        );
        let nowhere = RenderFlags { record: None, svg: Some("/no/such/folder/out.svg".into()) };
        let problem = nowhere.start_recording(&world).unwrap_err().to_string();
        assert!(problem.contains("/no/such/folder/out.svg: the recording cannot be written"), "{problem}");
        assert!(nowhere.is_enabled() && !world.is_recorded());
    }
}
