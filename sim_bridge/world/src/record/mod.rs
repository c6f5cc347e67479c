//! Recordings of a world while it runs: for Foxglove, and as a picture of the paths driven.
//!
//! ```text
//!  SharedWorld::advance ──▶ Recorder ──▶ World::advance, from one instant to the next
//!                               │ events, and robots that have moved
//!                               ├──▶ foxglove       an MCAP file, chunk by chunk
//!                               └──▶ driven_paths   an SVG, when the recording ends
//! ```
//!
//! A world without a recording has no recorder and no extra cost. A recorded world runs exactly the
//! same, to the last bit: its time advances in smaller steps while a robot moves, which makes no
//! difference to it, and the recorder only reads. While nothing moves and no event occurs, nothing
//! is written.
//!
//! **Time** in a recording is world time, from 0: the same seed and the same requests give the same
//! file.
//!
//! **End.** [`SharedWorld::end_recording`](crate::SharedWorld::end_recording) completes both
//! files. If the process is killed, the SVG is empty, and the MCAP file lacks its index and the
//! events of the last [`foxglove::CHUNK_S`] seconds of world time (or since time was last advanced,
//! if that is longer ago). The rest can be read from the beginning, and the command line tool of
//! MCAP repairs the file (`mcap recover`).

mod driven_paths;
pub mod foxglove;
mod recorder;
mod sink;

pub use recorder::{Recorder, RecordingOutputs};
pub use sink::RecordError;
