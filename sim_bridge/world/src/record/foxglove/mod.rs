//! An MCAP file for Foxglove: messages of Foxglove's schemas, as JSON.
//!
//! | topic | schema | when |
//! |---|---|---|
//! | `/map` | `foxglove.SceneUpdate` | once: walls, lanes, places, lifts, in the frame `world` |
//! | `/doors`, `/obstacles`, `/people` | `foxglove.SceneUpdate` | at the start, and on each change |
//! | `/robots` | `foxglove.SceneUpdate` | once: each in its own frame, `robot/NAME` |
//! | `/tf` | `foxglove.FrameTransforms` | at the start all robots, then those that have moved |
//! | `/robots/NAME/pose` | `foxglove.PoseInFrame` | likewise |
//! | `/robots/NAME/state` | `consort.RobotState` | at the start, once a second while the robot moves, and on each event that changes its state |
//! | `/log` | `foxglove.Log` | every event, as text |
//!
//! [`McapFile`] is the file. [`FleetScene`] draws an observed fleet instead of a world, on the same
//! topics.

mod event_text;
mod fleet;
mod mcap_file;
mod message;
mod poses;
mod scene;
mod schema;
mod sink;

pub use fleet::{FleetScene, LogMessage, RobotPose};
pub use mcap_file::{CHUNK_S, ExistingFile, McapFile, MessageStamp};
pub use message::Time;
pub use schema::Schema;
pub(super) use sink::FoxgloveSink;
