//! CDR and attachments, byte by byte.
//!
//! CDR (OMG DDS-XTypes 1.3, 7.4.3, encoding version 1, little endian): four bytes `00 01 00 00`,
//! then the fields in the order of their definition, each number at a multiple of its size counted
//! from after those four bytes. A text is its length including the final zero, then its bytes with
//! the zero. The bytes below were derived by this rule and agree with the output of the Python
//! package `rosbags` 0.11 for the same definitions.

use consort_ros2::messages::{
    Duration, Goal, Header, NavigateResult, NavigateToPose, Point, Pose, PoseStamped, Progress, Quaternion, Time,
};
use hiroz::action::messages::{
    CancelGoalServiceRequest, CancelGoalServiceResponse, FeedbackMessage, GetResultRequest, GetResultResponse,
    GoalStatusInfo, SendGoalRequest, SendGoalResponse, StatusMessage,
};
use hiroz::action::{GoalId, GoalInfo, GoalStatus};
use hiroz::attachment::Attachment;
use hiroz::msg::ZMessage;
use zenoh::bytes::ZBytes;

/// The goal id 00 01 02 … 0f.
pub(crate) const ID: [u8; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];

/// Parses bytes in hexadecimal notation.
pub(crate) fn hex(text: &str) -> Vec<u8> {
    text.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
}

fn assert_bytes<M: ZMessage>(message: &M, expected: &str) {
    let written = ZMessage::serialize(message);
    assert_eq!(written, hex(expected), "written: {written:02x?}");
}

fn stamped() -> PoseStamped {
    PoseStamped {
        header: Header { stamp: Time { sec: 1, nanosec: 2 }, frame_id: "map".to_owned() },
        pose: Pose { position: Point { x: 1.0, y: 2.0, z: 0.0 }, orientation: Quaternion::default() },
    }
}

/// Header, goal id, stamp, frame with its length 4 and its zero, seven numbers at multiples of
/// eight.
pub(crate) const GOAL_AT_1_2: &str = "00 01 00 00
    00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f
    01 00 00 00 02 00 00 00 04 00 00 00 6d 61 70 00
    00 00 00 00 00 00 f0 3f 00 00 00 00 00 00 00 40 00 00 00 00 00 00 00 00
    00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 f0 3f";

#[test]
fn a_goal_contains_its_id_the_pose_and_the_tree() {
    let request = |tree: &str| SendGoalRequest::<NavigateToPose> {
        goal_id: GoalId::from_bytes(ID),
        goal: Goal { pose: stamped(), behavior_tree: tree.to_owned() },
    };
    assert_bytes(&request(""), &format!("{GOAL_AT_1_2} 01 00 00 00 00"));
    assert_bytes(&request("a.xml"), &format!("{GOAL_AT_1_2} 06 00 00 00 61 2e 78 6d 6c 00"));
    let read =
        SendGoalRequest::<NavigateToPose>::deserialize(&hex(&format!("{GOAL_AT_1_2} 06 00 00 00 61 2e 78 6d 6c 00")));
    let read = read.unwrap();
    assert_eq!(
        (*read.goal_id.as_bytes(), read.goal),
        (ID, Goal { pose: stamped(), behavior_tree: "a.xml".to_owned() })
    );
}

#[test]
fn acceptance_has_its_time_at_a_multiple_of_four() {
    let response = SendGoalResponse { accepted: true, stamp_sec: 1, stamp_nanosec: 2 };
    assert_bytes(&response, "00 01 00 00 01 00 00 00 01 00 00 00 02 00 00 00");
}

#[test]
fn a_result_contains_status_aligned_code_and_message() {
    assert_bytes(
        &GetResultRequest { goal_id: GoalId::from_bytes(ID) },
        "00 01 00 00 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f",
    );
    let outcome = NavigateResult { error_code: 208, error_msg: "no way".to_owned() };
    let bytes = "00 01 00 00 06 00 d0 00 07 00 00 00 6e 6f 20 77 61 79 00";
    assert_bytes(&GetResultResponse::<NavigateToPose> { status: 6, result: outcome.clone() }, bytes);
    let read = GetResultResponse::<NavigateToPose>::deserialize(&hex(bytes)).unwrap();
    assert_eq!((read.status, read.result), (6, outcome));
}

#[test]
fn feedback_ends_with_two_aligned_numbers() {
    let feedback = Progress {
        current_pose: stamped(),
        navigation_time: Duration { sec: 3, nanosec: 4 },
        estimated_time_remaining: Duration { sec: 5, nanosec: 6 },
        number_of_recoveries: 7,
        distance_remaining: 8.5,
    };
    let bytes = format!("{GOAL_AT_1_2} 03 00 00 00 04 00 00 00 05 00 00 00 06 00 00 00 07 00 00 00 00 00 08 41");
    let message = FeedbackMessage::<NavigateToPose> { goal_id: GoalId::from_bytes(ID), feedback: feedback.clone() };
    assert_bytes(&message, &bytes);
    assert_eq!(FeedbackMessage::<NavigateToPose>::deserialize(&hex(&bytes)).unwrap().feedback, feedback);
}

fn info(sec: i32, nanosec: u32) -> GoalInfo {
    GoalInfo { goal_id: GoalId::from_bytes(ID), stamp: hiroz::action::Time { sec, nanosec } }
}

#[test]
fn cancel_requests_and_statuses_are_lists_of_goals() {
    let id = "00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f";
    assert_bytes(
        &CancelGoalServiceRequest { goal_info: info(0, 0) },
        &format!("00 01 00 00 {id} 00 00 00 00 00 00 00 00"),
    );
    let canceling = CancelGoalServiceResponse { return_code: 0, goals_canceling: vec![info(1, 2)] };
    assert_bytes(&canceling, &format!("00 01 00 00 00 00 00 00 01 00 00 00 {id} 01 00 00 00 02 00 00 00"));
    let status = |sec, nanosec, status| GoalStatusInfo { goal_info: info(sec, nanosec), status };
    let statuses = [status(1, 2, GoalStatus::Executing), status(3, 4, GoalStatus::Succeeded)];
    assert_bytes(
        &StatusMessage { status_list: statuses.into() },
        &format!("00 01 00 00 02 00 00 00 {id} 01 00 00 00 02 00 00 00 02 {id} 00 00 00 03 00 00 00 04 00 00 00 04"),
    );
}

/// `rmw_zenoh_cpp/src/detail/attachment_helpers.cpp` uses Zenoh's serializer: two numbers of 64
/// bits, little endian, then a length, here 16, and as many bytes.
#[test]
fn an_attachment_contains_two_numbers_and_an_id() {
    let attachment = Attachment { sequence_number: 258, source_timestamp: 1, source_gid: ID };
    let bytes = ZBytes::from(attachment).to_bytes().into_owned();
    let expected =
        hex("02 01 00 00 00 00 00 00 01 00 00 00 00 00 00 00 10 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f");
    assert_eq!(bytes, expected);
    let read = Attachment::try_from(&ZBytes::from(expected)).unwrap();
    assert_eq!((read.sequence_number, read.source_timestamp, read.source_gid), (258, 1, ID));
}
