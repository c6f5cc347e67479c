//! A fleet, written down as it is heard of, and shown again.
//!
//! ```text
//!  bus ──▶ watcher ──▶ Recorder ──▶ Picture, to know what has changed
//!                         └───────▶ Tape ──▶ run.mcap ──▶ Reel ──▶ Picture, as it was at any time ──▶ the dashboard
//! ```
//!
//! **What a file holds.** An MCAP file, whose messages are JSON, each with its schema:
//!
//! | topic | schema | what |
//! |---|---|---|
//! | `/events` | `consort.Event` | what nodes told: with the node's number for it as sequence number, when it was heard, and when it was said |
//! | `/gaps` | `consort.Gap` | events that a node numbered and that were not heard |
//! | `/coordinator` | `consort.Beacon` | the coordinator's signs of life |
//! | `/robots/NAME/body` | `consort.Body` | reports of bodies: place, pose, battery |
//! | `/links` | `consort.Links` | how many nodes the recorder was linked to |
//! | `/view/fleet` … | `consort.View` | the views, as a node answered; those of single missions on `/view/mission` |
//! | `/view/again` | `consort.Again` | that an answer was the one before, but for its age |
//! | `/log` | `foxglove.Log` | events and gaps in words |
//! | `/map`, `/doors`, `/people`, `/robots` | `foxglove.SceneUpdate` | the same for the 3D panel, |
//! | `/tf`, `/robots/NAME/pose` | `foxglove.FrameTransforms`, `foxglove.PoseInFrame` | whenever it changes |
//!
//! Times are those of the recorder's clock; `publish_time` is when it was said, where that is known. A record `consort.fleet`
//! at the beginning names the fleet.
//!
//! **Why inputs, and not pictures.** The `consort` messages are what the recorder heard: the inputs of [`Picture`](crate::picture),
//! which depends on nothing else. Frames of pictures would be quicker to show, but they are what this version of the program made
//! of what it heard. Inputs can be read by other programs, and are drawn by a later version as that one knows how. They are
//! also written once, where keyframes say everything again and again. What makes jumping cheap is made when the file is
//! opened instead: [`Reel`] plays it once, which it does anyway to find what is to be marked, and keeps a copy of the picture
//! every so often, [`KEYFRAMES`] at most. A jump takes the copy before, and plays on from there.
//!
//! **Ends.** What was heard reaches the file after [`CHUNK`] at the latest. A file without an end, or with a damaged one, is
//! shown as far as it can be read.

mod gaps;
mod parser;
mod player;
mod reader;
mod recorder;
mod schemas;
mod writer;

pub use gaps::{EventGap, GapDetector};
pub use parser::RecordingError;
pub use player::{Player, PlayerCommand, SPEED_RANGE};
pub use reader::{KEYFRAMES_MAX, RecordingReader, TimelineMark, TimelineMarkKind};
pub use recorder::Recorder;
pub use writer::{FLUSH_AFTER, RecordingStats, RecordingWriter};
