//! Files in which a world is to be looked at afterwards.

use crate::config::{Diagnostic, Diagnostics};
use crate::exit::Failure;
use consort_sim::record::{Recorder, RecordingOutputs};
use consort_sim::world::SharedWorld;
use std::path::PathBuf;

/// What is to be made of a world while it runs. By default nothing, and it costs nothing.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Rendering")]
pub struct RenderFlags {
    /// Write what happens in the world to this file, as MCAP: opens in Foxglove. Where robots are, ten times per second of
    /// world time while they move; nothing while they stand
    #[arg(long, value_name = "FILE.mcap")]
    record: Option<PathBuf>,
    /// Draw the paths driven in the world to this file, as SVG, when it ends
    #[arg(long, value_name = "FILE.svg")]
    svg: Option<PathBuf>,
}

impl RenderFlags {
    /// Whether anything is to be made.
    pub fn is_enabled(&self) -> bool {
        self.record.is_some() || self.svg.is_some()
    }

    /// Has a world recorded from now on, if that is wanted.
    ///
    /// # Errors
    /// [`Problems`] of the files.
    pub fn start_recording(&self, world: &SharedWorld) -> Result<(), Diagnostics> {
        let outputs = RecordingOutputs { mcap: self.record.clone(), svg: self.svg.clone() };
        let recorder = Recorder::open(&outputs).map_err(|problem| Diagnostic::for_file("", problem))?;
        if let Some(recorder) = recorder {
            world.record(recorder);
        }
        Ok(())
    }
}

/// Completes what is being recorded of a world, and hands what came of it to `say`, a line for each file.
///
/// # Errors
/// [`Failure::Unsuccessful`] if a file does not hold all that happened.
pub fn finish_recording(world: &SharedWorld, mut say: impl FnMut(&str)) -> Result<(), Failure> {
    let mut problems = vec![];
    for file in world.end_recording() {
        match file {
            Ok(words) => say(&words),
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

    #[test]
    fn a_world_without_the_options_has_no_recorder() {
        let world = SharedWorld::new(build_world(&WorldConfig::default(), &FleetConfig::default()).unwrap());
        let none = RenderFlags::default();
        none.start_recording(&world).unwrap();
        assert!(!none.is_enabled() && !world.is_recorded());
        finish_recording(&world, |words| panic!("{words}")).unwrap();
    }

    #[test]
    fn a_file_that_cannot_be_written_is_told_before_anything_starts() {
        let world = SharedWorld::new(build_world(&WorldConfig::default(), &FleetConfig::default()).unwrap());
        let nowhere = RenderFlags { record: None, svg: Some("/no/such/folder/out.svg".into()) };
        let problem = nowhere.start_recording(&world).unwrap_err().to_string();
        assert!(problem.contains("/no/such/folder/out.svg: the recording cannot be written"), "{problem}");
        assert!(nowhere.is_enabled() && !world.is_recorded());
    }
}
