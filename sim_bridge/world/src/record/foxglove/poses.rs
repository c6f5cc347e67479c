//! Frames of robots, and their poses.

use super::mcap_file::{McapFile, MessageStamp};
use super::message::{self, FrameTransform, FrameTransforms, PoseInFrame, Time};
use super::schema;
use crate::record::sink::RecordError;
use consort_protocol::ids::RobotId;

/// Frame of the map.
pub(super) const WORLD_FRAME: &str = "world";

/// Name of a robot's frame.
pub(super) fn frame_of(robot: &RobotId) -> String {
    format!("robot/{robot}")
}

/// Writes the positions of robots: each as a pose, and all as frames.
pub(super) fn write_poses<'a>(
    file: &mut McapFile,
    poses: impl Iterator<Item = (&'a RobotId, message::Pose)>,
    at: Time,
) -> Result<(), RecordError> {
    let mut transforms = vec![];
    for (robot, pose) in poses {
        let in_frame = PoseInFrame { timestamp: at, frame_id: WORLD_FRAME.to_owned(), pose };
        file.write(&format!("/robots/{robot}/pose"), &schema::POSE_IN_FRAME, MessageStamp::at(at), &in_frame)?;
        transforms.push(FrameTransform {
            timestamp: at,
            parent_frame_id: WORLD_FRAME.to_owned(),
            child_frame_id: frame_of(robot),
            translation: pose.position,
            rotation: pose.orientation,
        });
    }
    file.write("/tf", &schema::FRAME_TRANSFORMS, MessageStamp::at(at), &FrameTransforms { transforms })
}
