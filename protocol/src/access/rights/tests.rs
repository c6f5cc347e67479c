use super::*;
use crate::auction::AuctionId;
use crate::ids::RobotId;
use crate::knowledge::{Knowledge, Record, RecordStamp};
use Operation::{Publish, Query, Reply};
use serde::Serialize;

/// Principals tested: a letter and the identity.
const PRINCIPALS: [(char, &str); 9] = [
    ('r', "node/ada?roles=robot"),
    ('v', "node/ada?roles=voter"),
    ('h', "node/ada?roles=host&serves=ada"),
    ('n', "node/ada?roles="),
    ('R', "node/bob?roles=robot"),
    ('V', "node/bob?roles=voter"),
    ('H', "node/bob?roles=host&serves=bob,a"),
    ('N', "node/bob?roles="),
    ('p', "person/ada?scope=operate"),
];

const ANY: &str = "rvhnRVHN";
const ADA: &str = "rvhn";

/// Keys concerning ada, and the principals that may publish, query and reply on them.
const TABLE: [(&str, [&str; 3]); 47] = [
    ("wire/knowledge/ada", [ADA, "", ""]),
    ("wire/motion/ada", [ADA, "", ""]),
    ("wire/swim/ada", [ANY, "", ""]),
    ("wire/gossip/ada", ["", ANY, ADA]),
    ("wire/certificate/07070707070707070707070707070707", ["", "", ""]),
    ("wire/certificate/07070707070707070707070707070707/known", ["", "", ""]),
    ("wire/raft/0000000000000007/vote", ["", "vV", "vV"]),
    ("wire/bootstrap/ada", ["", "vV", "v"]),
    ("wire/bootstrap/*", ["", "vV", ""]),
    ("wire/beacon", ["vV", "", ""]),
    ("wire/bid/ada", ["", "vV", "r"]),
    ("wire/bid/*", ["", "vV", ""]),
    ("wire/award/ada", ["", "vV", "r"]),
    ("wire/report/ada", ["", "rR", "v"]),
    ("wire/leader/ada", ["", "rR", "v"]),
    ("wire/clock/ada", ["", "vV", "v"]),
    ("wire/signal/lab-1/r1", ["rvRV", "", ""]),
    ("wire/signal_history/lab-1/r1", ["", ANY, "rR"]),
    ("wire/ensemble/icu/ada", ["r", "", ""]),
    ("wire/driver/ada/command", ["", "r", "h"]),
    ("wire/driver/ada/state", ["h", "", ""]),
    ("wire/people/ask", ["", "vV", "hH"]),
    ("wire/people/done", ["hH", "", ""]),
    ("wire/world", ["", ANY, "hH"]),
    ("events/ada", [ADA, "", ""]),
    ("view/fleet", ["", "", ANY]),
    ("view/mission/lab-1", ["", "", ANY]),
    ("seen/ada/health", ["", "", ADA]),
    ("seen/ada/mission/lab-1", ["", "", ADA]),
    ("api/submit", ["", "", "vV"]),
    ("api/cancel", ["", "", "vV"]),
    ("api/cancel_missions", ["", "", "vV"]),
    ("api/priority", ["", "", "vV"]),
    ("api/reassign", ["", "", "vV"]),
    ("api/hold", ["", "", "vV"]),
    ("api/release", ["", "", "vV"]),
    ("api/maintenance", ["", "", "vV"]),
    ("api/close", ["", "", "vV"]),
    ("api/open", ["", "", "vV"]),
    ("api/limit", ["", "", "vV"]),
    ("api/alarm", ["", "", "vV"]),
    ("api/resolve", ["", "", "vV"]),
    ("api/backup", ["", "", "vV"]),
    ("api/explain", ["", "", ANY]),
    ("api/submit/help", ["", "", ANY]),
    ("api/leave/ada", ["", "", ADA]),
    ("alive/node/ada", ["", "", ""]),
];

fn identity(of: &str) -> Identity {
    format!("consort://ward/{of}").parse().unwrap()
}

fn wire<T: Serialize>(message: &T) -> Vec<u8> {
    codec::encode(message).unwrap()
}

fn within<T: Serialize>(message: &T) -> Vec<u8> {
    wire(&ClusterEnvelope { cluster: None, payload: wire(message) })
}

/// Returns a message of a principal with this name, for keys with messages that name their author.
fn message(key: &str, operation: Operation, name: &str) -> Option<Vec<u8>> {
    let (node, robot) = (NodeId::new(name).unwrap(), RobotId::new(name).unwrap());
    let (mission, role) = ("lab-1".parse().unwrap(), "r1".parse().unwrap());
    Some(match (key.split('/').nth(1)?, operation) {
        ("knowledge", Publish) => {
            let knowledge = Knowledge::of(None);
            let record = Record { owner: node, stamp: RecordStamp::default(), knowledge, proof: None };
            codec::encode_for_version(2, RecordUpdate::Record(record)).unwrap()
        }
        ("bootstrap", Query) => wire(&BootstrapRequest { mobile: false, on_battery: false, node }),
        ("beacon", Publish) => {
            within(&Beacon { node, term: 1, voters: BTreeSet::new(), since_ms: 0, cluster: None, wire: None })
        }
        ("bid", Reply) => {
            wire(&BidResponse { robot, auction: AuctionId { mission, term: 1, round: 1 }, replies: vec![] })
        }
        ("report", Query) => within(&Report {
            robot,
            incarnation: 1,
            mission,
            role,
            epoch: Default::default(),
            ended: BTreeSet::new(),
            outcomes: Default::default(),
            current_task: None,
            place: None,
            from_checkpoint: false,
            failure: None,
            question: None,
        }),
        _ if key.starts_with("events/") => format!(r#"{{"node": "{name}", "sequence": 1}}"#).into_bytes(),
        _ => return None,
    })
}

/// Returns the name in an identity of [`PRINCIPALS`].
fn name(of: &str) -> &str {
    of.split(['/', '?']).nth(1).unwrap()
}

#[test]
fn each_principal_may_send_exactly_what_the_table_permits() {
    for (key, allowed) in TABLE {
        for (operation, allowed) in [Publish, Query, Reply].into_iter().zip(allowed) {
            for (letter, of) in PRINCIPALS {
                let payload = message(key, operation, name(of)).unwrap_or_default();
                let checked = authorize(&identity(of), operation, key, &payload);
                assert_eq!(checked.is_ok(), allowed.contains(letter), "{of} {operation:?} {key}: {checked:?}");
            }
        }
    }
}

#[test]
fn only_voters_reply_to_a_call_that_changes_something() {
    for call in ApiCall::ALL.iter().copied() {
        let key = format!("api/{}", call.as_str());
        let allowed = if call.is_read_only() { ANY } else { "vV" };
        for (letter, of) in PRINCIPALS {
            let replies = authorize(&identity(of), Reply, &key, b"{}");
            assert_eq!(replies.is_ok(), allowed.contains(letter), "{of} {key}: {replies:?}");
        }
    }
}

#[test]
fn a_principal_may_refuse_the_queries_that_it_may_reply_to() {
    for (key, [.., allowed]) in TABLE {
        for (letter, of) in PRINCIPALS {
            let checked = authorize(&identity(of), Operation::Refuse, key, b"too busy");
            // A query to all nodes reaches each of them, and each refuses as under its own key.
            let own = TABLE.iter().find(|(own, _)| *own == key.replace('*', "ada"));
            let may = match own.filter(|_| key.contains('*')) {
                Some((_, [.., allowed])) => allowed.contains(letter.to_ascii_lowercase()),
                None => allowed.contains(letter),
            };
            assert_eq!(checked.is_ok(), may, "{of} {key}: {checked:?}");
        }
    }
}

#[test]
fn a_message_must_name_its_principal_as_author() {
    let mut tried = 0;
    for (key, allowed) in TABLE {
        for (operation, allowed) in [Publish, Query, Reply].into_iter().zip(allowed) {
            for (letter, of) in PRINCIPALS {
                let other = if name(of) == "ada" { "bob" } else { "ada" };
                let Some(payload) = message(key, operation, other).filter(|_| allowed.contains(letter)) else {
                    continue;
                };
                tried += 1;
                let denied = authorize(&identity(of), operation, key, &payload).unwrap_err();
                assert!(matches!(&denied, AccessDenied::Impersonation { name, .. } if name == other), "{denied}");
                let denied = authorize(&identity(of), operation, key, b"\xff").unwrap_err();
                assert!(matches!(&denied, AccessDenied::Unreadable { .. }), "{denied}");
            }
        }
    }
    assert_eq!(tried, 17, "number of principals with permissions on these keys");
}

#[test]
fn a_denial_names_the_principal_and_the_key() {
    let denial = |of: &str, operation, key: &str, payload: &[u8]| {
        authorize(&identity(of), operation, key, payload).unwrap_err().to_string()
    };
    assert_eq!(
        denial("node/eve?roles=robot", Reply, "api/submit", b"{}"),
        "node eve (robot) may not reply on api/submit"
    );
    let forged = denial("node/ada?roles=robot", Publish, "events/ada", br#"{"node": "bob"}"#);
    assert_eq!(forged, "node ada (robot) may not send on events/ada in the name of bob");
}
