//! Keys and bytes as sent and received by a stock Zenoh client, written out here. The formats are
//! those of `docs/design.md` of `rmw_zenoh` ("Topic and Service name mapping", "Graph Cache"), of
//! `qos_to_keyexpr` in `liveliness_utils.cpp`, and of the QoS profiles of `rmw` and `rcl_action`.

use crate::formats::{GOAL_AT_1_2, ID, hex};
use crate::support::{Offered, carrier, until, within};
use std::collections::BTreeSet;
use std::time::Duration;
use zenoh::bytes::ZBytes;
use zenoh::sample::Sample;

const SEND_GOAL: &str = "0/ada/navigate_to_pose/_action/send_goal/nav2_msgs::action::dds_::NavigateToPose_SendGoal_/RIHS01_a4fcb3bee1bf32e21a0e541a943b221aa0826996e2c98f079b47022b256f48b5";
const GET_RESULT: &str = "0/ada/navigate_to_pose/_action/get_result/nav2_msgs::action::dds_::NavigateToPose_GetResult_/RIHS01_c407920357d566771e8882b4ef4d1f1a84ee922d609920ccd57faa6d6e391dc5";
const CANCEL_GOAL: &str = "0/ada/navigate_to_pose/_action/cancel_goal/action_msgs::srv::dds_::CancelGoal_/RIHS01_573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a";
const FEEDBACK: &str = "0/ada/navigate_to_pose/_action/feedback/nav2_msgs::action::dds_::NavigateToPose_FeedbackMessage_/RIHS01_9d1f6fa2eb975ce733b419ac2e97b134d8ff92b6478b6559feed9a50bdfd82b3";
const STATUS: &str = "0/ada/navigate_to_pose/_action/status/action_msgs::msg::dds_::GoalStatusArray_/RIHS01_6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e";

/// Request 7 at nanosecond 1 from aa aa … aa.
const ATTACHMENT: &str = "07 00 00 00 00 00 00 00 01 00 00 00 00 00 00 00 10 \
    aa aa aa aa aa aa aa aa aa aa aa aa aa aa aa aa";

async fn query(session: &zenoh::Session, key: &str, payload: Vec<u8>) -> Option<Sample> {
    let get = session.get(key).payload(payload).attachment(hex(ATTACHMENT)).timeout(Duration::from_secs(30));
    let replies = get.await.unwrap();
    let reply = replies.recv_async().await.ok()?;
    reply.into_result().ok()
}

fn bytes(payload: &ZBytes) -> Vec<u8> {
    payload.to_bytes().into_owned()
}

/// Returns the tokens without the ids of sessions, nodes and entities, which are arbitrary numbers.
async fn tokens(session: &zenoh::Session) -> BTreeSet<String> {
    let replies = session.liveliness().get("@ros2_lv/0/**").await.unwrap();
    let mut tokens = BTreeSet::new();
    while let Ok(reply) = replies.recv_async().await {
        let sample = reply.into_result().unwrap();
        let mut parts: Vec<&str> = sample.key_expr().as_str().split('/').collect();
        let (session, node, entity) = (parts[2], parts[3], parts[4]);
        assert!(session.chars().all(|digit| digit.is_ascii_hexdigit()), "{session}");
        assert!([node, entity].iter().all(|id| id.parse::<u32>().is_ok()), "{node} {entity}");
        parts.drain(2..5);
        tokens.insert(parts.join("/"));
    }
    tokens
}

#[tokio::test(flavor = "multi_thread")]
async fn the_graph_has_a_node_and_five_parts_per_action_server() {
    let offered = Offered::with(vec![carrier("ada", "Dock", 1.0)]).await;
    let part = |kind: &str, name: &str, key: &str, qos: &str| {
        let typed = key.split_once(&format!("{name}/")).unwrap().1;
        format!("@ros2_lv/0/{kind}/%/%/consort_bridge/%ada%navigate_to_pose%_action%{name}/{typed}/{qos}")
    };
    let expected: BTreeSet<String> = [
        "@ros2_lv/0/NN/%/%/consort_bridge".to_owned(),
        part("SS", "send_goal", SEND_GOAL, "::,10:,:,:,,"),
        part("SS", "get_result", GET_RESULT, "::,10:,:,:,,"),
        part("SS", "cancel_goal", CANCEL_GOAL, "::,10:,:,:,,"),
        part("MP", "feedback", FEEDBACK, "::,10:,:,:,,"),
        // Transient local is 1, and the depth is 1.
        part("MP", "status", STATUS, ":1:,1:,:,:,,"),
    ]
    .into();
    let mut seen = BTreeSet::new();
    until(&format!("tokens {expected:#?}"), async || {
        seen = tokens(offered.router.session()).await;
        seen.len() >= expected.len()
    })
    .await;
    assert_eq!(seen, expected);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stock_client_sends_a_goal_and_receives_its_result() {
    let offered = Offered::with(vec![carrier("ada", "Dock", 1.0)]).await;
    let session = offered.router.session();
    let feedback = session.declare_subscriber(FEEDBACK).await.unwrap();
    let status = session.declare_subscriber(STATUS).await.unwrap();
    let goal = hex(&format!("{GOAL_AT_1_2} 01 00 00 00 00"));
    let mut accepted = None;
    until("a reply to a goal", async || {
        accepted = query(session, SEND_GOAL, goal.clone()).await;
        accepted.is_some()
    })
    .await;
    let accepted = accepted.unwrap();
    assert_eq!(accepted.key_expr().as_str(), SEND_GOAL);
    let reply = bytes(accepted.payload());
    assert_eq!((reply.len(), &reply[..8]), (16, hex("00 01 00 00 01 00 00 00").as_slice()), "{reply:02x?}");
    // The reply names its request: the sequence number and the client.
    let attachment = bytes(accepted.attachment().unwrap());
    let request = hex(ATTACHMENT);
    assert_eq!((attachment.len(), &attachment[..8], &attachment[16..]), (33, &request[..8], &request[16..]));

    let message = within("feedback", feedback.recv_async()).await.unwrap();
    let (message, attachment) = (bytes(message.payload()), bytes(message.attachment().unwrap()));
    assert_eq!((message.len(), &message[..4], &message[4..20]), (116, hex("00 01 00 00").as_slice(), ID.as_slice()));
    assert_eq!(&message[28..36], hex("04 00 00 00 6d 61 70 00"), "the frame is map");
    assert_eq!((attachment.len(), attachment[16]), (33, 16));
    // A single goal in progress: an accepted goal is reported as executing at once.
    let first = bytes(within("a status", status.recv_async()).await.unwrap().payload());
    assert_eq!((first.len(), &first[..8], first[32]), (33, hex("00 01 00 00 01 00 00 00").as_slice(), 2));

    // (1, 2) on the hospital's map is five metres from the dock, without walls in between.
    let result = within(
        "the result",
        query(session, GET_RESULT, hex("00 01 00 00 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f")),
    );
    let result = bytes(result.await.unwrap().payload());
    assert_eq!(&result[..8], hex("00 01 00 00 04 00 00 00"), "succeeded, without error");
}

#[tokio::test(flavor = "multi_thread")]
async fn unknown_and_unreadable_requests_do_no_harm() {
    let offered = Offered::with(vec![carrier("ada", "Dock", 1.0)]).await;
    let session = offered.router.session();
    let id = "00 01 00 00 0f 0e 0d 0c 0b 0a 09 08 07 06 05 04 03 02 01 00";
    let mut reply = None;
    until("a reply about an unknown goal", async || {
        reply = query(session, GET_RESULT, hex(id)).await;
        reply.is_some()
    })
    .await;
    let unknown = hex("00 01 00 00 00 00 00 00 01 00 00 00 00");
    assert_eq!(bytes(reply.unwrap().payload()), unknown, "status unknown, an empty result");
    let canceled = query(session, CANCEL_GOAL, hex(&format!("{id} 00 00 00 00 00 00 00 00"))).await.unwrap();
    assert_eq!(bytes(canceled.payload()), hex("00 01 00 00 02 00 00 00 00 00 00 00"), "unknown goal, no goal canceled");

    for broken in [vec![], vec![0, 1, 0, 0, 1, 2, 3], vec![0xff; 64]] {
        assert!(query(session, SEND_GOAL, broken.clone()).await.is_none(), "{broken:02x?}");
    }
    let bare = session.get(SEND_GOAL).payload(hex(&format!("{GOAL_AT_1_2} 01 00 00 00 00"))).await.unwrap();
    assert!(bare.recv_async().await.is_err(), "a request without attachment has no reply");
    let goal = hex(&format!("{GOAL_AT_1_2} 01 00 00 00 00"));
    let accepted = query(session, SEND_GOAL, goal.clone()).await.unwrap();
    assert_eq!(bytes(accepted.payload())[4], 1, "it still works");
    let again = query(session, SEND_GOAL, goal).await.unwrap();
    assert_eq!(bytes(again.payload())[4], 0, "the same goal again is rejected");
}
