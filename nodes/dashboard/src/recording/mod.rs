//! Records the messages of a fleet, and replays them.
//!
//! ```text
//!  bus ──▶ subscriber ──▶ Recorder ──▶ FleetModel, to detect changes
//!                            └───────▶ RecordingWriter ──▶ run.mcap ──▶ RecordingReader ──▶ FleetModel at any time ──▶ the dashboard
//! ```
//!
//! **Contents of a file.** An MCAP file with JSON messages, each with its schema:
//!
//! | topic | schema | what |
//! |---|---|---|
//! | `/events` | `consort.Event` | events of nodes, with the node's number as sequence number, the time of receipt, and the time of publication |
//! | `/gaps` | `consort.Gap` | missed events, by the numbers of their node |
//! | `/coordinator` | `consort.Beacon` | the coordinator's beacons |
//! | `/robots/NAME/body` | `consort.Body` | telemetry of robots: place, pose, battery; with the feedback of their goals |
//! | `/links` | `consort.Links` | number of nodes linked to the recorder |
//! | `/view/fleet` … | `consort.View` | the views, as returned by a node; those of single missions on `/view/mission` |
//! | `/view/again` | `consort.Again` | a view with the same content as the last, except for its age |
//! | `/log` | `foxglove.Log` | events and gaps as text |
//! | `/map`, `/doors`, `/people`, `/robots` | `foxglove.SceneUpdate` | the same for the 3D panel, |
//! | `/tf`, `/robots/NAME/pose` | `foxglove.FrameTransforms`, `foxglove.PoseInFrame` | whenever it changes |
//!
//! Times are those of the recorder's clock; `publish_time` is the time of publication, if known. A
//! record `consort.fleet` at the beginning names the fleet.
//!
//! **Inputs instead of rendered models.** The `consort` messages are the received inputs of the
//! [`FleetModel`](crate::fleet_model), which depends on nothing else. Rendered models would be
//! quicker to show, but they are specific to the version of the program that recorded them. Inputs
//! can be read by other programs, and a later version renders them in its own way. They are also
//! written once, while keyframes repeat everything. Seeking is made fast when the file is opened
//! instead: [`RecordingReader`] plays it once, which is needed anyway to find the marks, and keeps
//! up to [`KEYFRAMES_MAX`] copies of the model. A seek takes the copy before, and plays on from
//! there.
//!
//! **Incomplete files.** Received messages reach the file after [`FLUSH_AFTER`] at the latest. A
//! file without an end, or with a damaged end, is shown as far as it can be read.

mod gaps;
mod parser;
mod player;
mod reader;
mod recorder;
mod schemas;
mod writer;

pub use parser::RecordingError;
pub use player::{Player, PlayerCommand, SpeedError};
pub use reader::{KEYFRAMES_MAX, RecordingReader, TimelineMark, TimelineMarkKind};
pub use recorder::Recorder;
pub use writer::{FLUSH_AFTER, RecordingStats, RecordingWriter};
